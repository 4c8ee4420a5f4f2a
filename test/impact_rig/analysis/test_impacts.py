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
"""Impacts from the accelerometer alone: all are found with time and sign, and nothing else counts as an impact."""

from __future__ import annotations

import numpy as np
import pytest
from kits.records import RMS, add_impacts, info_rows

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.cycles import PHASE_BINS, Accumulator, Cycles
from impact_rig.analysis.impacts import IMPACT, ImpactDetector, counted
from impact_rig.analysis.settings import ImpactSettings

FAST = 50_000


def detector(rate_hz=FAST, **changes):
    info = info_rows(rate_hz)
    return ImpactDetector(Calibration.from_info(info), ImpactSettings(**changes))


def background(seconds, rate_hz, *, frequency_hz=9.1, amplitude=20.0, seed=1):
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    noise = RMS["accelerometer"] * np.random.default_rng(seed).standard_normal(len(time))
    return amplitude * np.sin(2 * np.pi * frequency_hz * time) + noise


def drawn_impacts(count, seconds, seed, apart_s=4e-3, slowest=0.02, fastest=0.7):
    """Impacts at random instants on either wall; their speeds are spread evenly on a logarithmic scale."""
    rng = np.random.default_rng(seed)
    free = seconds - 0.1 - count * apart_s
    times = 0.05 + np.sort(rng.random(count)) * free + apart_s * np.arange(count)
    speeds = np.exp(rng.uniform(np.log(slowest), np.log(fastest), count))
    return times, speeds, rng.choice([-1, 1], count)


def matched(found, times, rate_hz, tolerance_s=0.5e-3):
    """Return for each true impact the timing error [scans] of its detection, NaN if missed, and the false alarms."""
    errors = np.full(len(times), np.nan)
    taken = np.zeros(len(found), bool)
    for i, instant in enumerate(times * rate_hz):
        if len(found):
            j = int(np.argmin(np.abs(found["scan"] - instant)))
            if abs(found["scan"][j] - instant) <= tolerance_s * rate_hz and not taken[j]:
                taken[j], errors[i] = True, found["scan"][j] - instant
    return errors, taken


@pytest.mark.parametrize("rate_hz", [250_000, 500_000, 1_000_000])
def test_impacts_are_timed_correctly_at_the_rates_of_the_fastest_boards(rate_hz):
    """The look-ahead is long at 430 kS/s and more; a shorter history would shift onsets by 12 µs to 12 ms."""
    times = np.arange(0.05, 0.25, 0.0137)
    acceleration = background(0.3, rate_hz)
    add_impacts(acceleration, rate_hz, times, np.full(len(times), 0.4), np.resize([1, -1], len(times)))
    errors, taken = matched(detector(rate_hz).feed(acceleration), times, rate_hz)
    assert taken.all()
    assert np.abs(errors).max() < 10e-6 * rate_hz


@pytest.mark.heavy
def test_default_instruments_at_50_ks_find_the_impacts_above_0_02_m_s():
    """Acceptance figures: ≥ 99 % found, ≤ 1 % false, timing within one scan; here for 600 impacts from 0.02 m/s on."""
    times, speeds, signs = drawn_impacts(600, 12.0, seed=2)
    acceleration = background(12.0, FAST)
    add_impacts(acceleration, FAST, times, speeds, signs)
    found = detector().feed(acceleration)
    errors, taken = matched(found, times, FAST)
    assert np.mean(np.isfinite(errors)) >= 0.99
    assert np.sum(~taken) <= 0.01 * len(times)
    assert np.nanmax(np.abs(errors)) <= 1.0
    assert np.array_equal(found["sign"][taken], signs[np.isfinite(errors)])


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("rate_hz", "share", "false_share", "worst_scans"), [(25_600, 0.99, 0.02, 2.0), (10_000, 0.85, 0.03, 5.0)]
)
def test_lower_rates_find_the_documented_share_of_impacts(rate_hz, share, false_share, worst_scans):
    """At 10 kS/s, a pulse of 40 µs may fall between two scans; the figures are in docs/explanation/analysis.md."""
    times, speeds, signs = drawn_impacts(600, 12.0, seed=3)
    acceleration = background(12.0, rate_hz)
    add_impacts(acceleration, rate_hz, times, speeds, signs)
    errors, taken = matched(detector(rate_hz).feed(acceleration), times, rate_hz)
    assert np.mean(np.isfinite(errors)) >= share
    assert np.sum(~taken) <= false_share * len(times)
    assert np.nanmax(np.abs(errors)) <= worst_scans


@pytest.mark.parametrize(("frequency_hz", "amplitude"), [(9.1, 20.0), (5.0, 5.0), (200.0, 20.0), (9.1, 0.0)], ids=str)
@pytest.mark.parametrize("rate_hz", [10_000, 50_000])
def test_vibration_and_noise_are_not_detected_as_impacts(rate_hz, frequency_hz, amplitude):
    for seed in range(3):
        quiet = background(4.0, rate_hz, frequency_hz=frequency_hz, amplitude=amplitude, seed=seed)
        assert len(detector(rate_hz).feed(quiet)) == 0


def test_an_offset_or_a_sudden_start_is_not_detected_as_an_impact():
    assert len(detector().feed(background(1.0, FAST) + 100.0)) == 0


def test_an_impact_with_a_ringing_sensor_is_counted_once():
    acceleration = background(2.0, FAST, amplitude=0.0)
    add_impacts(acceleration, FAST, [0.5, 1.0, 1.5], [0.9, 0.9, 0.9], [1, -1, 1])
    found = detector().feed(acceleration)
    assert len(found) == 3
    assert found["sign"].tolist() == [1, -1, 1]


def test_the_threshold_rises_with_the_noise_of_the_sensor():
    rng = np.random.default_rng(4)
    noisy = background(3.0, FAST) + 1.0 * rng.standard_normal(3 * FAST)
    info = info_rows(FAST)
    info["noise"][0] = 1.0
    assert len(ImpactDetector(Calibration.from_info(info)).feed(noisy)) == 0


def test_an_accelerometer_exchanged_during_a_run_is_used_with_its_own_calibration():
    """After a new calibration, lag and noise are those of the new accelerometer."""
    acceleration = background(1.0, FAST)
    add_impacts(acceleration, FAST, [0.3, 0.8], [0.3, 0.3], [1, 1])
    known, exchanged = detector(), detector()
    info = info_rows(FAST)
    info["lag"][0] += 100e-6
    info["noise"][0] = 100.0
    exchanged.recalibrate(FAST // 2, Calibration.from_info(info))
    earlier = exchanged.feed(acceleration)["scan"] - known.feed(acceleration)["scan"]
    assert earlier == pytest.approx([0.0, -5.0])
    exchanged.restart(FAST)
    exchanged.feed(np.zeros(10))
    assert exchanged._state[2] == 100.0**2


@pytest.mark.heavy
def test_results_do_not_depend_on_the_division_into_blocks():
    times, speeds, signs = drawn_impacts(100, 2.0, seed=5)
    acceleration = background(2.0, FAST)
    add_impacts(acceleration, FAST, times, speeds, signs)
    whole = detector().feed(acceleration)
    for size in (1, 13, 500, 30_011):
        one = detector()
        parts = [one.feed(acceleration[at : at + size]) for at in range(0, len(acceleration), size)]
        assert np.concatenate(parts).tobytes() == whole.tobytes()


def test_detection_stops_at_nan_and_recovers_afterwards():
    acceleration = background(1.0, FAST)
    acceleration[10_000:10_100] = np.nan
    acceleration[20_000] = np.inf
    add_impacts(acceleration, FAST, [0.3, 0.8], [0.3, 0.3], [1, 1])
    found = detector().feed(acceleration)
    assert np.allclose(found["scan"] / FAST, [0.3, 0.8], atol=2e-5)


def test_a_restart_sets_the_number_of_the_next_scan():
    one = detector()
    one.feed(background(0.1, FAST))
    one.restart(1_000_000)
    acceleration = background(0.2, FAST)
    add_impacts(acceleration, FAST, [0.1], [0.3], [1])
    assert one.feed(acceleration)["scan"] == pytest.approx([1_000_000 + 0.1 * FAST], abs=1.0)


def test_a_rate_that_is_too_low_yields_no_detections():
    assert len(detector(1000).feed(1e3 * np.random.default_rng(6).standard_normal(5000))) == 0


def test_impacts_are_counted_in_their_cycles():
    accumulator = Accumulator(10_000, 10.0, 1, 0, np.full(4, -np.inf), np.full(4, np.inf))
    accumulator.add(np.ones((4, 3000)), np.zeros(3000, np.uint8), 0, 3000)
    cycles = accumulator.take(3)
    acceleration = background(0.35, 10_000, amplitude=0.0)
    add_impacts(acceleration, 10_000, [0.05, 0.12, 0.17, 0.25], [0.4] * 4, [1, -1, 1, 1])
    filled = counted(cycles, detector(10_000).feed(acceleration), 0, accumulator.period)
    assert filled.impacts.tolist() == [1, 2, 1]
    assert filled.strikes.sum(axis=1).tolist() == [1, 2, 1]


def test_an_impact_on_the_first_scan_of_a_cycle_belongs_to_that_cycle():
    first = np.array([100, 200, 300])
    empty = np.zeros((3, 4))
    cycles = Cycles(first, np.full(3, 100), np.zeros((3, 4, 1), complex), empty, empty, empty, np.zeros(3, int), empty,
                    np.full(3, np.nan), np.zeros((3, PHASE_BINS), np.uint8))  # fmt: skip
    impacts = np.zeros(4, IMPACT)
    impacts["scan"] = [99.9, 200.0, 299.9, 400.0]
    assert counted(cycles, impacts, 100, 100.0).impacts.tolist() == [0.0, 2.0, 0.0]
