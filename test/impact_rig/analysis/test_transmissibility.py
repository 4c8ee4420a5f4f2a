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
"""DT of records with a closed form: value, phase with sign, THD, uncertainty, and a status for invalid records."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kits.coverage import assert_covers
from kits.records import (
    BASE_M,
    F_N,
    PAPER_FREQUENCIES_HZ,
    RMS,
    ZETA,
    channel_response,
    info_rows,
    linear_transmissibility,
    steady_record,
)

from impact_rig.analysis.calibration import LAG_MODELS, Calibration
from impact_rig.analysis.cycles import distinct_phases
from impact_rig.analysis.scans import BASE, LASER
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.transmissibility import measure_record
from impact_rig.errors import ConfigError
from impact_rig.instruments.section import CHANNELS
from impact_rig.states import Method, Regime, Status

EXACT_RTOL = 1e-8


@pytest.mark.parametrize("frequency_hz", PAPER_FREQUENCIES_HZ)
@pytest.mark.parametrize("rate_hz", [10_000, 25_600])
def test_a_noiseless_record_yields_the_closed_form(frequency_hz, rate_hz):
    """Lag and skew of the channels are corrected exactly."""
    info = info_rows(rate_hz)
    found = measure_record(steady_record(frequency_hz, 1.5, rate_hz=rate_hz, noise=0), info, frequency_hz)
    truth = linear_transmissibility(frequency_hz)
    assert found.status is Status.OK
    assert found.transmissibility == pytest.approx(abs(truth), rel=EXACT_RTOL)
    assert found.phase_rad == pytest.approx(np.angle(truth), abs=EXACT_RTOL)
    assert found.base_m == pytest.approx(BASE_M, rel=EXACT_RTOL)
    assert found.current_a == pytest.approx(0.5, rel=EXACT_RTOL)
    assert (found.regime, found.period, found.method) == (Regime.PERIODIC, 1, Method.GUM)


def test_a_negative_phase_means_that_the_structure_lags():
    """At resonance, x_1 lags x_b by slightly less than 90°; a record delayed by a quarter of a cycle must give −90°."""
    info = info_rows(ideal=True)
    rows = steady_record(9.1, 2.0, info=info, noise=0, ratio=np.exp(-0.5j * np.pi))
    later = np.cos(2 * np.pi * 9.1 * rows["time"] + 0.3 - np.pi / 2)
    assert np.allclose(rows["laser"], BASE_M * later, atol=1e-12)
    assert measure_record(rows, info, 9.1).phase_rad == pytest.approx(-np.pi / 2, abs=1e-8)
    at_resonance = measure_record(steady_record(F_N, 2.0, noise=0), info_rows(), F_N).phase_rad
    assert at_resonance == pytest.approx(-(np.pi / 2 - np.arctan(2 * ZETA)), abs=1e-8)


def test_thd_is_the_overtones_of_x_1_before_the_lag():
    rows = steady_record(9.1, 3.0, noise=0, harmonics=(0.03, 0.0, 0.04))
    assert measure_record(rows, info_rows(), 9.1).thd == pytest.approx(0.05, rel=1e-6)


def test_noise_that_repeats_in_every_cycle_counts_as_white():
    """At a hundred times the drive frequency, noise is the same in each cycle: σ √(2 / N) of each amplitude remains."""
    info = info_rows(ideal=True)
    rows = steady_record(10.0, 3.0, info=info, noise=0)
    peak_m = 1e-6
    rows["laser"] += peak_m * np.cos(2 * np.pi * 1000.0 * rows["time"])
    found = measure_record(rows, info, 10.0)
    expected_m = peak_m / np.sqrt(1000 * found.cycles)
    assert found.spread < 1e-9
    assert found.amplitudes.u[LASER] == pytest.approx(expected_m, rel=0.01)
    assert found.u_transmissibility == pytest.approx(expected_m / BASE_M, rel=0.01)


def test_an_error_of_the_clock_does_not_affect_the_ratio():
    """A DAQ clock off by 500 ppm turns the phase by a third of a cycle in 75 s: DT stays, the deviation is reported."""
    true_hz = 9.1 * (1 + 500e-6)
    rng = np.random.default_rng(1)
    rows = steady_record(true_hz, 75.0, rate_hz=1000, rng=rng)
    found = measure_record(rows, info_rows(1000), 9.1)
    assert found.frequency_deviation_hz == pytest.approx(9.1 * 500e-6, rel=1e-2)
    assert found.transmissibility == pytest.approx(abs(linear_transmissibility(true_hz)), rel=1e-3)
    assert found.laser_m == pytest.approx(BASE_M * abs(linear_transmissibility(true_hz)), rel=1e-3)


@pytest.mark.heavy
@settings(max_examples=25)
@given(
    ratio=st.floats(0.05, 150.0),
    phase=st.floats(-3.0, -0.1),
    base_um=st.floats(30.0, 60.0),
    frequency_hz=st.floats(5.0, 100.0),
)
def test_any_ratio_is_measured_correctly(ratio, phase, base_um, frequency_hz):
    truth = ratio * np.exp(1j * phase)
    rows = steady_record(frequency_hz, 1.2, noise=0, ratio=truth, base_m=base_um * 1e-6)
    found = measure_record(rows, info_rows(), frequency_hz)
    assert found.transmissibility == pytest.approx(ratio, rel=1e-7)
    assert found.phase_rad == pytest.approx(phase, abs=1e-7)


def _deviations(gain_u, noise, colour, count, seed=2, lag_u=0.02):
    """Return (DT − truth)/u and (phase − truth)/u with new noise, gains and lags for each draw."""
    rng = np.random.default_rng(seed)
    rate, frequency = 1000, 9.1
    truth = linear_transmissibility(frequency)
    info = info_rows(rate, gain_u=gain_u)
    clean = steady_record(frequency, 48.5 / 9.1, rate_hz=rate, info=info, noise=0)
    gains = 1 + gain_u * rng.standard_normal((count, 2))
    lags = 1 + lag_u * rng.standard_normal((count, 2))
    results = []
    for gain, lag in zip(gains, lags, strict=True):
        rows = clean.copy()
        real = info.copy()
        real["lag"][[LASER, BASE]] *= lag
        for channel, name in ((LASER, "laser"), (BASE, "base")):
            change = channel_response(real, name, frequency) / channel_response(info, name, frequency)
            values = clean[name]
            quadrature = -np.gradient(values, 1 / rate) / (2 * np.pi * frequency)
            random = rng.standard_normal(len(rows) + 50)
            if colour:
                random = np.convolve(random, np.ones(20) / np.sqrt(20))[: len(random)]
            rows[name] = (
                gain[channel - 1] * (np.real(change) * values + np.imag(change) * quadrature)
                + noise * RMS[name] * random[50:]
            )
        found = measure_record(rows, info, frequency, TrackerSettings(lag_uncertainty=lag_u))
        results.append(
            (
                (found.transmissibility - abs(truth)) / found.u_transmissibility,
                (found.phase_rad - np.angle(truth)) / found.u_phase_rad,
            )
        )
    return np.array(results)


@pytest.mark.parametrize(
    ("gain_u", "noise", "colour", "lag_u"),
    [
        pytest.param(2e-3, 1.0, False, 0.02, id="calibration and noise"),
        pytest.param(0.0, 3.0, False, 0.0, id="white noise alone"),
        pytest.param(0.0, 1.0, True, 0.0, id="coloured noise alone"),
    ],
)
@pytest.mark.repeats
def test_the_stated_uncertainty_covers_the_truth(gain_u, noise, colour, lag_u):
    """Noise and calibration are drawn 300 times: the errors agree with the stated uncertainty."""
    assert_covers(_deviations(gain_u, noise, colour, 300, lag_u=lag_u))


@pytest.mark.heavy
def test_a_modulated_response_is_measured_from_batches_and_labelled():
    """A slow modulation of 5 % is labelled with its spread; the uncertainty is far above that of the noise."""
    rng = np.random.default_rng(3)
    k = 2 * np.pi * 0.437
    ratio = linear_transmissibility(9.2)
    rows = steady_record(9.2, 21.0, rng=rng, transient=lambda t: ratio * (1 + 0.05 * np.cos(k * t)))
    assert measure_record(rows, info_rows(gain_u=0.0), 9.2).regime is Regime.UNKNOWN, (
        "without impacts it is no such thing"
    )
    rows["accelerometer"][:: len(rows) // 400] += 500.0
    found = measure_record(rows, info_rows(gain_u=0.0), 9.2, TrackerSettings(lag_uncertainty=0.0))
    assert (found.status, found.regime, found.method) == (Status.OK, Regime.MODULATED, Method.BATCH_MEANS)
    assert found.spread / found.transmissibility == pytest.approx(0.05 / np.sqrt(2), rel=0.05)
    steady = measure_record(
        steady_record(9.2, 21.0, rng=rng), info_rows(gain_u=0.0), 9.2, TrackerSettings(lag_uncertainty=0.0)
    )
    assert found.u_transmissibility > 5 * steady.u_transmissibility


@pytest.mark.repeats
def test_batch_means_cover_the_mean_of_a_chaotic_response():
    """The amplitude varies like noise from cycle to cycle: the labelled uncertainty roughly covers the true mean."""
    rng = np.random.default_rng(4)
    ratio, rate = linear_transmissibility(9.2), 500
    info = info_rows(rate, gain_u=0.0, ideal=True)
    inside = []
    for _ in range(150):
        wander = np.convolve(rng.standard_normal(30 * rate), np.ones(200) / np.sqrt(200), "same")
        rows = steady_record(
            9.2, 21.0, rate_hz=rate, info=info, rng=rng, transient=lambda t, w=wander: ratio * (1 + 0.03 * w[: len(t)])
        )
        found = measure_record(rows, info, 9.2)
        assert found.method is Method.BATCH_MEANS
        inside.append(abs(found.transmissibility - abs(ratio)) < 2 * found.u_transmissibility)
    assert 0.85 < np.mean(inside) <= 1.0


def nonsense():
    """Invalid records: name, scans, frequency, expected status."""
    rng = np.random.default_rng(5)
    good = steady_record(9.1, 2.0, rng=rng)

    def changed(**columns):
        rows = good.copy()
        for name, value in columns.items():
            rows[name] = value
        return rows

    one_nan = good.copy()
    one_nan["base"][777] = np.nan
    clipped = good.copy()
    clipped["laser"] = np.clip(2 * clipped["laser"], -0.01, 0.01)
    flagged = good.copy()
    flagged["status"][5000] = 1 << LASER
    swapped = changed(laser=good["base"], base=good["laser"])
    still = changed(**{name: RMS[name] * rng.standard_normal(len(good)) for name in CHANNELS})
    stuck = good.copy()
    stuck["base"][9000:] = stuck["base"][9000]
    yield "silence", still, 9.1, Status.SILENCE
    yield "dead", changed(accelerometer=0, laser=0, base=0, current=0), 9.1, Status.SILENCE
    yield "constant laser", changed(laser=1.234e-3), 9.1, Status.CONSTANT
    yield "constant base", changed(base=0.0), 9.1, Status.CONSTANT
    yield "base stuck half way", stuck, 9.1, Status.CONSTANT
    yield "all NaN", changed(laser=np.nan), 9.1, Status.NOT_FINITE
    yield "one NaN", one_nan, 9.1, Status.NOT_FINITE
    yield "infinite", changed(base=np.inf), 9.1, Status.NOT_FINITE
    yield "one cycle", good[:1200], 9.1, Status.TOO_FEW_CYCLES
    yield "nothing", good[:0], 9.1, Status.TOO_FEW_CYCLES
    yield "frequency zero", good, 0.0, Status.NO_FREQUENCY
    yield "frequency negative", good, -9.1, Status.NO_FREQUENCY
    yield "frequency NaN", good, np.nan, Status.NO_FREQUENCY
    yield "frequency beyond the rate", good, 6000.0, Status.NO_FREQUENCY
    yield "clipped", clipped, 9.1, Status.OVER_RANGE
    yield "flagged", flagged, 9.1, Status.OVER_RANGE
    yield "swapped", swapped, 9.1, Status.SWAPPED_CHANNELS
    yield "swapped, no accelerometer", np.copy(_without_accelerometer(swapped, rng)), 9.1, Status.SWAPPED_CHANNELS
    yield "laser inverted", changed(laser=-good["laser"]), 9.1, Status.INVERTED_CHANNEL
    yield "base inverted", changed(base=-good["base"]), 9.1, Status.INVERTED_CHANNEL
    yield "laser and accelerometer swapped", changed(laser=good["accelerometer"]), 9.1, Status.OVER_RANGE
    yield "base and current swapped", changed(base=good["current"], current=good["base"]), 9.1, Status.OVER_RANGE


def _without_accelerometer(rows, rng):
    rows = rows.copy()
    rows["accelerometer"] = 0.049 * rng.standard_normal(len(rows))
    return rows


@pytest.mark.parametrize(
    ("rows", "frequency_hz", "status"), [n[1:] for n in nonsense()], ids=[n[0] for n in nonsense()]
)
def test_invalid_records_yield_a_status_and_no_number(rows, frequency_hz, status):
    found = measure_record(rows, info_rows(), frequency_hz)
    assert found.status is status
    for value in (found.transmissibility, found.phase_rad, found.u_transmissibility, found.laser_m, found.thd):
        assert np.isnan(value)


def test_an_overloaded_accelerometer_does_not_affect_the_displacements():
    rows = steady_record(9.1, 2.0, noise=0)
    rows["status"][100] = 1
    found = measure_record(rows, info_rows(), 9.1)
    assert found.status is Status.ACCELEROMETER_OVER_RANGE
    assert found.transmissibility == pytest.approx(abs(linear_transmissibility(9.1)), rel=EXACT_RTOL)


@pytest.mark.parametrize("model", LAG_MODELS.values())
def test_lag_is_the_group_delay_at_low_frequency(model):
    step = 1e-6
    phase = np.angle(model(np.array(step)))
    assert -phase / step == pytest.approx(1.0, rel=1e-6)
    assert abs(model(np.array(0.0))) == 1.0


def test_lag_sensitivity_is_the_derivative():
    calibration = Calibration.from_info(info_rows())
    omega_lag = 2 * np.pi * 9.1 * 0.7e-3
    assert calibration.lag_sensitivity(LASER, 9.1) == pytest.approx(-1j * omega_lag / (1 + 1j * omega_lag), rel=1e-6)
    assert calibration.lag_sensitivity(BASE, 9.1) == pytest.approx(-1j * 2 * np.pi * 9.1 * 0.225e-3, rel=1e-6)


def curved(values, c_2, c_3, linearity, half_range):
    u = values / half_range
    return values + linearity * (c_2 * (3 * u**2 - 1) / 2 + c_3 * (5 * u**3 - 3 * u) / 2)


@pytest.mark.parametrize("amplitude", [1e-5, 2e-3, 6e-3, 9e-3])
def test_gain_uncertainty_follows_the_curve_of_the_sensor(amplitude):
    """A sine through a sensor with unit c_3 agrees with the closed form; 1/√6 makes the limit a standard one."""
    info = info_rows(gain_u=0.0)
    info["linearity"][LASER] = 30e-6
    info["sensitivity_uncertainty"][LASER] = np.hypot(1e-3, 1.5 * 30e-6 / 0.01 / np.sqrt(6))
    angle = 2 * np.pi * np.arange(1000) / 1000
    through = curved(amplitude * np.cos(angle), 0.3, 1.0, 30e-6, 0.01)
    gain_error = 2 * np.mean(through * np.cos(angle)) / amplitude - 1
    found = Calibration.from_info(info).gain_uncertainty_at(LASER, amplitude)
    assert found == pytest.approx(np.hypot(1e-3, gain_error / np.sqrt(6)), rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rate": 0.0}, "rate must be > 0 and <= "),
        ({"rate": np.nan}, "rate must be > 0 and <= "),
        ({"rate": [1e4, 1e4, 2e4, 1e4]}, "rate must be the same for all channels, got "),
        ({"range_low": 1e9}, "range_low must be < range_high"),
        ({"lag_order": 3.0}, "lag_order must be one of 0, 1, 2"),
        ({"name": b"laser"}, "or more of the channels accelerometer, laser, base, current, each once"),
    ],
)
def test_an_impossible_calibration_is_rejected_by_name(change, message):
    info = info_rows()
    for column, value in change.items():
        info[column] = value
    with pytest.raises(ConfigError, match=message):
        Calibration.from_info(info)


def test_rows_of_daq_info_may_come_in_any_order():
    info, rows = info_rows(), steady_record(9.1, 2.0, noise=0)
    ordered, reversed_ = (measure_record(rows, one, 9.1) for one in (info, info[::-1].copy()))
    assert ordered.transmissibility == reversed_.transmissibility
    assert ordered.phase_rad == reversed_.phase_rad


def rounded(values, rng, step, noise):
    return step * np.rint((values + noise * rng.standard_normal(len(values))) / step) if step else values


@pytest.mark.parametrize(
    ("r", "q", "noise_r", "noise_q"),
    [(8e-6, 0.0, 0.0, 0.0), (8e-6, 0.0, 2e-6, 0.0), (0.0, 6.1e-6, 0.0, 1e-6), (8e-6, 9.8e-6, 2e-6, 0.6e-6)],
    ids=["no noise", "some noise", "converter", "two steps that beat"],
)
@pytest.mark.parametrize("amplitude", [6e-6, 50e-6, 1e-3, 5.8e-3])
def test_the_error_of_converter_steps_is_within_two_uncertainties(r, q, noise_r, noise_q, amplitude):
    """Amplitudes and positions between the steps are random: hardly any error exceeds 2u, and some are close to it."""
    info = info_rows()
    names = ("output_step", "output_noise", "converter_step", "converter_noise")
    info[list(names)][LASER] = 0.0
    for name, value in zip(names, (r, noise_r, q, noise_q), strict=True):
        info[name][LASER] = value
    calibration = Calibration.from_info(info)
    rng, off = np.random.default_rng(3), []
    turn = np.exp(2j * np.pi * (np.arange(8_000) + rng.random()) / 8_000)
    for _ in range(30):
        true = amplitude * (1.0 + 0.01 * rng.random())
        first = rounded(true * turn.real + 1e-4 * rng.random(), rng, r, noise_r)
        read = abs(2.0 * np.mean(rounded(first, rng, q, noise_q) * np.conj(turn)))
        u = calibration.steps_uncertainty(LASER, read)
        if u < TrackerSettings().worst_relative_uncertainty * read:  # or it would be no number
            off.append((read - true) / u)
    white = np.sqrt(2.0 * (noise_r**2 + noise_q**2 + (r**2 + q**2) / 12.0) / len(turn))
    least = white / calibration.steps_uncertainty(LASER, amplitude)
    assert len(off) == 30 or amplitude < r + q
    assert np.all(np.abs(off) < 2.0 + 4.0 * least), off
    assert len(off) < 30 or np.max(np.abs(off)) > 0.3, off


def test_samples_at_recurring_phases_count_once():
    assert distinct_phases(10_000, 100.0) == 100
    assert distinct_phases(10_000, 100.0 / 3.0) == 100
    assert distinct_phases(52_747, 10_000 / 9.1) == 10_989  # in ten cycles, to 0.01 of a scan
    assert distinct_phases(5_000, 1000.37) == 5_000


def test_a_certificate_that_omits_steps_uses_its_resolution_as_the_step():
    """A recording of an earlier version has only `resolution`, which is the step, blurred by `noise`."""
    info = info_rows()
    info["resolution"][LASER] = 8e-6
    old = info[[name for name in info.dtype.names if not name.startswith(("output_", "converter_"))]]
    calibration = Calibration.from_info(old)
    assert calibration.converter_step[LASER] == 8e-6
    assert calibration.output_noise[LASER] == info["noise"][LASER]
    assert 0.0 < calibration.steps_uncertainty(LASER, 20e-6) < 1e-6


def test_the_uncertainty_covers_steps_that_truncate():
    """Nothing states how the steps are made: if they are rounded towards zero, an amplitude loses 2/π of a step."""
    info = info_rows()
    for name in ("output_step", "output_noise", "converter_step", "converter_noise", "noise"):
        info[name][LASER] = 0.0
    info["resolution"][LASER] = step = 8e-6
    calibration = Calibration.from_info(info)
    phase = np.linspace(0.0, 200.0 * np.pi, 100_000, endpoint=False)
    for amplitude in (400e-6, 1e-3):
        read = step * np.trunc(amplitude * np.sin(phase + 0.1) / step)
        lost = amplitude - abs(np.mean(2.0 * read * np.exp(-1j * phase)))
        assert lost == pytest.approx(2.0 / np.pi * step, rel=0.1)
        assert lost < 2.0 * calibration.steps_uncertainty(LASER, amplitude) < 1.5 * lost
