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
"""Sine fits of IEEE 1057: exact for their own model, with valid uncertainties for white and coloured noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kits.coverage import assert_covers
from scipy import optimize, signal

from impact_rig.analysis.sine import fit_sine, fit_sine_frequency, noise_density
from impact_rig.states import Status


def sine(n, rate_hz, frequency_hz, amplitude, phase, offset=0.0):
    return offset + amplitude * np.cos(2 * np.pi * frequency_hz * np.arange(n) / rate_hz + phase)


@pytest.mark.heavy
@settings(max_examples=40)
@given(
    frequency_hz=st.floats(3.0, 400.0),
    amplitude=st.floats(1e-9, 1e3),
    phase=st.floats(-3.1, 3.1),
    offset=st.floats(-10.0, 10.0),
)
def test_both_fits_recover_a_pure_sine(frequency_hz, amplitude, phase, offset):
    y = sine(2000, 1000.0, frequency_hz, amplitude, phase, offset * amplitude)
    for fit in (fit_sine(y, 1000.0, frequency_hz), fit_sine_frequency(y, 1000.0, frequency_hz * (1 + 1e-5))):
        assert fit.status is Status.OK
        assert fit.amplitude == pytest.approx(amplitude, rel=1e-8)
        assert fit.offset == pytest.approx(offset * amplitude, abs=1e-8 * amplitude)
        assert abs(np.exp(1j * fit.phase_rad) - np.exp(1j * phase)) < 1e-7
        assert fit.frequency_hz == pytest.approx(frequency_hz, rel=1e-10)


def test_four_parameter_fits_converge_from_a_third_of_a_cycle_off():
    y = sine(5000, 1000.0, 9.1, 1.0, 0.4)
    assert fit_sine_frequency(y, 1000.0, 9.1 + 0.3 / 5.0).frequency_hz == pytest.approx(9.1, rel=1e-11)


def test_harmonics_are_fitted_separately():
    rate, n, wanted = 1000.0, 1234, np.array([2.0, 0.3j, -0.05 + 0.01j])
    t = np.arange(n) / rate
    y = 0.7 + sum(np.real(w * np.exp(2j * np.pi * h * 7.3 * t)) for h, w in enumerate(wanted, start=1))
    assert np.allclose(fit_sine(y, rate, 7.3, 3).phasors, wanted, rtol=0, atol=1e-10)
    assert np.allclose(fit_sine_frequency(y, rate, 7.31, 3).phasors, wanted, rtol=0, atol=1e-8)


def test_fits_agree_with_the_general_purpose_fit_of_scipy():
    rng = np.random.default_rng(4)
    rate, n = 1000.0, 3000
    y = sine(n, rate, 9.1, 1.0, 0.5, 0.2) + 0.1 * rng.standard_normal(n)
    t = np.arange(n) / rate
    (a, b, c, f), covariance = optimize.curve_fit(
        lambda t, a, b, c, f: c + a * np.cos(2 * np.pi * f * t) + b * np.sin(2 * np.pi * f * t), t, y, (1, 0, 0, 9.12)
    )
    fit = fit_sine_frequency(y, rate, 9.12)
    assert fit.phasors[0] == pytest.approx(a - 1j * b, rel=1e-6)
    assert fit.frequency_hz == pytest.approx(f, rel=1e-9)
    assert fit.offset == pytest.approx(c, rel=1e-5)
    # the noise density near the line is itself an estimate from 32 lines: within a third of the white formula
    assert fit.u_frequency_hz == pytest.approx(np.sqrt(covariance[3, 3]), rel=0.35)


@pytest.mark.parametrize("colour", ["white", "low-passed"])
@pytest.mark.repeats
def test_uncertainties_cover_the_truth(colour):
    """300 seeded repetitions; for low-passed noise, the formula for white noise is wrong by a factor of five."""
    rng = np.random.default_rng(5)
    n, rate, frequency = 2000, 1000.0, 9.1
    deviations = []
    for _ in range(300):
        noise = rng.standard_normal(n + 200)
        if colour == "low-passed":
            noise = signal.lfilter([0.06], [1, -0.94], noise)
        y = sine(n, rate, frequency, 1.0, 0.5, 0.3) + 0.05 * noise[200:]
        fit = fit_sine(y, rate, frequency)
        deviations.append(((fit.amplitude - 1.0) / fit.u_amplitudes[0], (fit.phase_rad - 0.5) / fit.u_phases_rad[0]))
    assert_covers(deviations)


@pytest.mark.repeats
def test_four_parameter_uncertainties_cover_the_truth():
    rng = np.random.default_rng(6)
    n, rate, frequency = 1000, 500.0, 9.1
    deviations = []
    for _ in range(300):
        fit = fit_sine_frequency(sine(n, rate, frequency, 1.0, 0.5) + 0.05 * rng.standard_normal(n), rate, 9.15)
        deviations.append(
            (
                (fit.amplitude - 1.0) / fit.u_amplitudes[0],
                (fit.phase_rad - 0.5) / fit.u_phases_rad[0],
                (fit.frequency_hz - frequency) / fit.u_frequency_hz,
            )
        )
    assert_covers(deviations)


def test_noise_density_is_the_variance_of_white_noise_and_local_for_coloured():
    rng = np.random.default_rng(7)
    white = rng.standard_normal(200_000)
    assert noise_density(white, 100.0, 1000.0) == pytest.approx(1.0, rel=0.6)
    b, a = signal.butter(2, 50.0, fs=1000.0)
    low = signal.lfilter(b, a, white)
    assert noise_density(low, 5.0, 1000.0) > 100 * noise_density(low, 300.0, 1000.0)


@pytest.mark.parametrize("fit", [fit_sine, fit_sine_frequency])
@pytest.mark.parametrize(
    ("y", "frequency_hz", "status"),
    [
        (np.zeros(1000), 9.1, Status.CONSTANT),
        (np.full(1000, 3.3), 9.1, Status.CONSTANT),
        (np.append(sine(999, 1000.0, 9.1, 1, 0), np.nan), 9.1, Status.NOT_FINITE),
        (np.append(sine(999, 1000.0, 9.1, 1, 0), np.inf), 9.1, Status.NOT_FINITE),
        (sine(110, 1000.0, 9.1, 1, 0), 9.1, Status.TOO_FEW_CYCLES),
        (np.ones(0), 9.1, Status.TOO_FEW_CYCLES),
        (sine(1000, 1000.0, 9.1, 1, 0), 0.0, Status.NO_FREQUENCY),
        (sine(1000, 1000.0, 9.1, 1, 0), -9.1, Status.NO_FREQUENCY),
        (sine(1000, 1000.0, 9.1, 1, 0), np.nan, Status.NO_FREQUENCY),
        (sine(1000, 1000.0, 9.1, 1, 0), 500.0, Status.NO_FREQUENCY),
    ],
)
def test_invalid_records_yield_a_status_and_no_number(fit, y, frequency_hz, status):
    found = fit(y, 1000.0, frequency_hz)
    assert found.status is status
    assert np.isnan(found.amplitude)
    assert np.isnan(found.u_amplitudes[0])
    assert np.isnan(found.offset)
