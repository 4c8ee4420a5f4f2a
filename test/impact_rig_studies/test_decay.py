# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Free decay and drop test: exact for their model, valid uncertainties in noise, a reason for invalid records."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kits.coverage import assert_covers
from kits.records import F_N, ZETA, add_impacts, info_rows

from impact_rig.instruments.section import SCAN
from impact_rig.states import Status
from impact_rig_studies.decay import bent, fit_decay, log_decrement, measure_decay, restitution_of_drops

COVERAGE = (0.93, 0.975)
METHODS = pytest.mark.parametrize("method", [fit_decay, log_decrement])


def decay(seconds=20.0, rate_hz=500.0, *, f_n=F_N, zeta=ZETA, amplitude=5e-3, phase=0.1, offset=1e-4, drift=0.0):
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    omega = 2 * np.pi * f_n
    oscillation = np.cos(omega * np.sqrt(1 - zeta**2) * time + phase)
    return offset + drift * time + amplitude * np.exp(-zeta * omega * time) * oscillation


@pytest.mark.heavy
@METHODS
@settings(max_examples=15)
@given(f_n=st.floats(4.0, 40.0), zeta=st.floats(1e-3, 0.03), phase=st.floats(-3.0, 3.0), amplitude=st.floats(1e-9, 1.0))
def test_a_noiseless_decay_yields_its_parameters(method, f_n, zeta, phase, amplitude):
    y = decay(10.0, 2000.0, f_n=f_n, zeta=zeta, phase=phase, amplitude=amplitude, offset=0.1 * amplitude)
    found = method(y, 2000.0)
    assert found.status is Status.OK
    exact = method is fit_decay
    assert found.natural_frequency_hz == pytest.approx(f_n, rel=1e-9 if exact else 1e-4)
    assert found.damping_ratio == pytest.approx(zeta, rel=1e-6 if exact else 5e-3)


@METHODS
@pytest.mark.parametrize("rate_hz", [19.0, 30.0, 40.0, 45.0, 46.0])
def test_a_rate_with_too_few_samples_per_cycle_yields_no_fit(method, rate_hz):
    """With fewer than five samples in a cycle, the fit has a singular matrix; the user must get the reason instead."""
    rng = np.random.default_rng(3)
    y = decay(20.0, rate_hz) + 1e-6 * rng.standard_normal(round(20 * rate_hz))
    found = method(y, rate_hz)
    assert found.status is (Status.NO_FIT if rate_hz < 46.0 else Status.OK)


@pytest.mark.heavy
@METHODS
def test_a_decay_with_a_locked_base_meets_the_acceptance_limits(method):
    """f_n within 0.02 % and ζ within 2 %, with laser steps of 8 µm, 3 µm of noise, 10 kS/s and 5 mm."""
    rng = np.random.default_rng(1)
    y = decay(20.0, 10_000.0) + 3e-6 * rng.standard_normal(200_000)
    found = method(8e-6 * np.round(y / 8e-6), 10_000.0)
    assert found.natural_frequency_hz == pytest.approx(F_N, rel=2e-4)
    assert found.damping_ratio == pytest.approx(ZETA, rel=0.02)


@METHODS
@pytest.mark.repeats
def test_uncertainties_cover_the_truth(method):
    """300 decays with different noise, gain, offset, drift and clock."""
    rng = np.random.default_rng(2)
    clock_u = 2e-6
    deviations = []
    for _ in range(300):
        clock = 1 + clock_u * rng.standard_normal()
        y = (1 + 2e-3 * rng.standard_normal()) * decay(
            12.0, 200.0, f_n=F_N * clock, phase=rng.uniform(-3, 3), offset=5e-5 * rng.standard_normal()
        )
        found = method(y + 5e-6 * rng.standard_normal(len(y)), 200.0, clock_u)
        deviations.append(
            (
                (found.natural_frequency_hz - F_N) / found.u_natural_frequency_hz,
                (found.damping_ratio - ZETA) / found.u_damping_ratio,
            )
        )
    assert_covers(deviations)


def scans(y):
    rows = np.zeros(len(y), SCAN)
    rows["laser"] = y
    return rows


@METHODS
@pytest.mark.repeats
def test_the_uncertainty_of_the_damping_includes_sensor_nonlinearity(method):
    """300 rigs with different gain and curve (Legendre, |c_2| + |c_3| <= 1); noise alone would give a tenth of u."""
    rng = np.random.default_rng(6)
    rate = 190
    info = info_rows(rate, gain_u=2e-3)
    info["linearity"][1] = 30e-6
    clean, off, too_sure = decay(10.0, rate), [], []
    for _ in range(300):
        p, q = rng.uniform(-1, 1, 2)
        u = clean / 0.01
        curve = 30e-6 * (0.5 * (p + q) * (3 * u**2 - 1) / 2 + 0.5 * (p - q) * (5 * u**3 - 3 * u) / 2)
        y = (1 + 2e-3 * rng.standard_normal()) * clean + curve + 3e-6 * rng.standard_normal(len(clean))
        found = measure_decay(scans(y), info, method)
        off.append([(found.damping_ratio - ZETA) / found.u_damping_ratio])
        if len(too_sure) < 150:
            too_sure.append(abs(found.damping_ratio - ZETA) < 2 * method(y, rate).u_damping_ratio)
    assert_covers(off)
    assert np.mean(too_sure) < 0.9


def _bent_by_sums(decay_per_s, seconds):
    time = np.linspace(0, seconds, 4000)
    power = np.exp(-2 * decay_per_s * time)
    slope = np.polyfit(time, -decay_per_s * time + 1e-6 * power, 1, w=np.sqrt(power))[0]
    return (-slope / decay_per_s - 1) / 1e-6


def test_a_record_of_the_complete_decay_is_affected_half_as_much_by_nonlinearity():
    """For a short record the factor is 2: ln(1 + κe^{−2λt}) then falls by 2κλ per second."""
    assert bent(0.25, 100.0) == pytest.approx(0.5, rel=1e-9)
    assert bent(0.25, 0.01) == pytest.approx(2.0, rel=1e-2)
    assert bent(0.25, 8.0) == pytest.approx(_bent_by_sums(0.25, 8.0), rel=1e-3)


def test_a_clipped_or_invalid_decay_yields_its_status():
    y = decay()
    info = info_rows(500)
    assert measure_decay(scans(3 * y), info).status is Status.OVER_RANGE
    flagged = scans(y)
    flagged["status"][3] = 2
    assert measure_decay(flagged, info).status is Status.OVER_RANGE
    assert measure_decay(scans(np.full(5000, np.nan)), info).status is Status.NOT_FINITE
    assert measure_decay(scans(y), info).status is Status.OK


def test_a_decay_with_amplitude_dependent_damping_is_rejected():
    """For example, impacts that no accelerometer measures double the damping while the amplitude is large."""
    rate = 500
    time = np.arange(20 * rate) / rate
    envelope = np.exp(-np.cumsum(np.where(time < 3.0, 0.5, 0.25)) / rate)
    y = 5e-3 * envelope * np.cos(2 * np.pi * F_N * time) + 3e-6 * np.random.default_rng(1).standard_normal(len(time))
    assert measure_decay(scans(y), info_rows(rate)).status is Status.NOT_EXPONENTIAL


def test_a_decay_with_impacts_is_rejected():
    rate, rng = 10_000, np.random.default_rng(1)
    rows = scans(decay(5.0, rate) + 3e-6 * rng.standard_normal(5 * rate))
    rows["accelerometer"] = -((2 * np.pi * F_N) ** 2) * rows["laser"] + 0.05 * rng.standard_normal(len(rows))
    assert measure_decay(rows, info_rows(rate)).status is Status.OK
    add_impacts(rows["accelerometer"], rate, [0.5, 0.61, 0.83], [0.3, 0.2, 0.2], [1, -1, 1])
    assert measure_decay(rows, info_rows(rate)).status is Status.IMPACTS


def test_the_two_methods_agree_within_their_uncertainty():
    rng = np.random.default_rng(3)
    y = decay() + 5e-6 * rng.standard_normal(10_000)
    fit, decrement = fit_decay(y, 500.0), log_decrement(y, 500.0)
    assert abs(fit.damping_ratio - decrement.damping_ratio) < 3 * decrement.u_damping_ratio
    assert abs(fit.natural_frequency_hz - decrement.natural_frequency_hz) < 3 * decrement.u_natural_frequency_hz


@METHODS
def test_a_drifting_offset_does_not_affect_the_result(method):
    found = method(decay(drift=1e-5), 500.0)
    assert found.damping_ratio == pytest.approx(ZETA, rel=1e-3)


@METHODS
@pytest.mark.parametrize(
    ("y", "status"),
    [
        (np.zeros(5000), Status.CONSTANT),
        (np.full(5000, 2.0), Status.CONSTANT),
        (np.append(decay(), np.nan), Status.NOT_FINITE),
        (np.random.default_rng(4).standard_normal(5000), Status.SILENCE),
        (decay(0.1), Status.TOO_FEW_CYCLES),
        (decay(0.3), Status.TOO_FEW_CYCLES),
        (np.ones(0), Status.TOO_FEW_CYCLES),
        (decay(zeta=-0.001), Status.NO_FIT),
    ],
    ids=["zeros", "constant", "nan", "noise", "one cycle", "three cycles", "nothing", "growing"],
)
def test_invalid_records_yield_a_status_and_no_number(method, y, status):
    found = method(y, 500.0)
    assert found.status is status
    assert np.isnan(found.natural_frequency_hz)
    assert np.isnan(found.damping_ratio)


@given(h0=st.floats(1e-3, 10.0), e=st.floats(0.01, 1.0), u=st.floats(1e-9, 1e-4))
def test_a_drop_test_yields_the_closed_form(h0, e, u):
    found = restitution_of_drops(np.array([h0]), np.array([e**2 * h0]), u, u)
    assert found.restitution == pytest.approx(e)
    assert found.u_restitution == pytest.approx(e / 2 * np.hypot(u / h0, u / (e**2 * h0)), rel=1e-6, abs=1e-12)


@pytest.mark.heavy
@pytest.mark.parametrize("drops", [1, 10])
def test_the_uncertainty_of_a_drop_test_covers_the_truth(drops):
    """1500 tests of e = 0.35 from 0.2 m, with different readings of the heights to 0.5 mm."""
    rng = np.random.default_rng(5)
    inside = []
    for _ in range(1500):
        h0 = 0.2 + 5e-4 * rng.standard_normal(drops)
        h1 = 0.35**2 * 0.2 + 5e-4 * rng.standard_normal(drops)
        found = restitution_of_drops(h0, h1, 5e-4, 5e-4)
        inside.append(abs(found.restitution - 0.35) < 2 * found.u_restitution)
    assert COVERAGE[0] <= np.mean(inside) <= COVERAGE[1], np.mean(inside)


@pytest.mark.parametrize(
    ("h0", "h1", "u", "status"),
    [
        (0.2, np.nan, 1e-3, Status.NOT_FINITE),
        (np.inf, 0.1, 1e-3, Status.NOT_FINITE),
        (0.0, 0.1, 1e-3, Status.NO_FIT),
        (0.2, -0.1, 1e-3, Status.NO_FIT),
        (0.2, 0.3, 1e-3, Status.NO_FIT),
        (0.2, 0.1, -1e-3, Status.NO_FIT),
    ],
)
def test_impossible_drops_yield_a_status_and_no_number(h0, h1, u, status):
    found = restitution_of_drops(np.array([h0]), np.array([h1]), u, u)
    assert found.status is status
    assert np.isnan(found.restitution)


def test_unpaired_heights_raise_an_error():
    with pytest.raises(ValueError, match="equal length"):
        restitution_of_drops(np.ones(3), np.ones(2), 0.0, 0.0)
