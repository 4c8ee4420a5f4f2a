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
"""A faulty channel gives no row without a warning: one fault after another during a measurement."""

from __future__ import annotations

import numpy as np
import pytest
from kits.records import BASE_M, blocks, feed_all, info_rows, linear_transmissibility, steady_record
from kits.tracker import RATE, record, tracker

from impact_rig.analysis.transmissibility import measure_record
from impact_rig.states import Status

FAULT_AT = 14 * RATE + 77
LASER_M = BASE_M * abs(linear_transmissibility(9.1))


def silent(channel):
    def spoil(rows, rng):
        rows[channel][FAULT_AT:] = 1e-7 * rng.standard_normal(len(rows) - FAULT_AT)

    return spoil


def stuck(channel):
    def spoil(rows, _):
        rows[channel][FAULT_AT:] = rows[channel][FAULT_AT]

    return spoil


def gain(channel, factor):
    def spoil(rows, _):
        rows[channel][FAULT_AT:] *= factor

    return spoil


def level(channel, size):
    def spoil(rows, _):
        rows[channel][FAULT_AT:] += size

    return spoil


def spikes(channel, size):
    def spoil(rows, rng):
        at = rng.choice(np.arange(FAULT_AT, len(rows)), 200, replace=False)
        rows[channel][at] += size * rng.choice([-1.0, 1.0], 200)

    return spoil


def noise(channel, rms):
    def spoil(rows, rng):
        rows[channel][FAULT_AT:] += rms * rng.standard_normal(len(rows) - FAULT_AT)

    return spoil


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("spoil", "status", "channel"),
    [
        pytest.param(silent("base"), "no_signal", "base", id="base silent"),
        pytest.param(silent("laser"), "no_signal", "laser", id="laser silent"),
        pytest.param(silent("accelerometer"), "accelerometer_unsound", None, id="accelerometer silent"),
        pytest.param(stuck("base"), "constant", "base", id="base stuck"),
        pytest.param(stuck("laser"), "constant", "laser", id="laser stuck"),
        pytest.param(gain("base", 1.05), "implausible", "base", id="base gain"),
        pytest.param(gain("laser", 0.95), "implausible", "laser", id="laser gain"),
        pytest.param(gain("accelerometer", 1.2), "accelerometer_unsound", None, id="accelerometer gain"),
        pytest.param(level("base", 2e-4), "level_jump", "base", id="base level"),
        pytest.param(level("laser", 2e-3), "level_jump", "laser", id="laser level"),
        pytest.param(spikes("base", 1e-4), "spikes", "base", id="base spikes"),
        pytest.param(spikes("laser", 2e-3), "spikes", "laser", id="laser spikes"),
        pytest.param(noise("base", 1e-4), "noisy", "base", id="base noise"),
        pytest.param(noise("laser", 5e-4), "noisy", "laser", id="laser noise"),
        pytest.param(silent("current"), "current_unsound", None, id="current silent"),
        pytest.param(stuck("current"), "current_unsound", None, id="current stuck"),
        pytest.param(gain("current", 1.05), "current_unsound", None, id="current gain"),
        pytest.param(level("current", 0.5), "current_unsound", None, id="current level"),
        pytest.param(spikes("current", 0.5), "current_unsound", None, id="current spikes"),
        pytest.param(noise("current", 0.5), "current_unsound", None, id="current noise"),
    ],
)
def test_a_fault_during_a_measurement_is_named_and_no_wrong_row_looks_good(spoil, status, channel):
    rows, truth = record(seconds=40.0), linear_transmissibility(9.1)
    spoil(rows, np.random.default_rng(8))
    found = [table.rows[0] for table in feed_all(tracker(), blocks(rows, RATE, 20))[0]]
    assert found[0]["status"] == b"ok"
    named = [row for row in found if row["status"].decode() == status]
    assert named, [row["status"] for row in found]
    assert channel is None or {row["channel"].decode() for row in named} == {channel}
    for row in found:
        if row["settled"] == 1:
            assert abs(row["transmissibility"] - abs(truth)) < 3 * row["transmissibility_uncertainty"]
            assert abs(row["phase"] - np.angle(truth)) < 3 * row["phase_uncertainty"] + 1e-4
    if status == "accelerometer_unsound":
        assert np.isnan(named[-1]["impacts_per_cycle"])
        assert {row["regime"] for row in named} == {b"unknown"}, "impacts could show that it does not repeat"
        assert found[0]["regime"] == b"periodic"
    if status == "current_unsound":
        assert all(np.isnan(row["current_amplitude"]) for row in named)


@pytest.mark.heavy
def test_an_absent_current_is_nan_and_a_restored_current_is_reported_again():
    """Otherwise, a closed loop that controls the current would raise it to its limit."""
    rows = record(seconds=30.0)
    rows["current"][: 10 * RATE] = 1e-3 * np.random.default_rng(5).standard_normal(10 * RATE)
    dead, *later = [table.rows[0] for table in feed_all(tracker(), blocks(rows, RATE, 20))[0]]
    assert (dead["status"], np.isnan(dead["current_amplitude"])) == (b"ok", True)
    assert later[-1]["status"] == b"ok"
    assert np.isfinite(later[-1]["current_amplitude"])


@pytest.mark.heavy
def test_a_gain_that_returns_to_normal_is_trusted_again():
    rows = record(seconds=45.0)
    rows["base"][FAULT_AT : FAULT_AT + 8 * RATE] *= 1.05
    found = [table.rows[0]["status"].decode() for table in feed_all(tracker(), blocks(rows, RATE, 20))[0]]
    assert "implausible" in found
    assert found[-1] == "ok"


@pytest.mark.heavy
def test_a_channel_of_pure_noise_is_not_called_miswired():
    """With x_1 of 0.6 µm and noise of 3 µm, any phase is possible: the channel must not be called inverted."""
    rng, words = np.random.default_rng(4), set()
    for _ in range(60):
        rows = steady_record(20.0, 2.5, rate_hz=RATE, rng=rng, base_m=2e-6)
        words.add(measure_record(rows, info_rows(RATE), 20.0).status)
    assert words.isdisjoint({Status.INVERTED_CHANNEL, Status.SWAPPED_CHANNELS}), words


@pytest.mark.heavy
def test_a_lightly_damped_structure_is_not_called_miswired():
    """With ζ = 1e-5, x_1 is opposite to x_b to within noise of 0.6°, so it leads in half of the draws."""
    rng, leads = np.random.default_rng(4), 0
    for _ in range(40):
        rows = steady_record(
            15.0, 5.0, rate_hz=RATE, rng=rng, base_m=10e-6, ratio=linear_transmissibility(15.0, zeta=1e-5)
        )
        found = measure_record(rows, info_rows(RATE), 15.0)
        assert found.status is Status.OK
        leads += 0.0 < np.degrees(found.phase_rad) < 179.5
    assert leads >= 5, "these were called inverted"


def test_a_laser_with_a_wrong_gain_from_the_start_contradicts_the_accelerometer():
    rows = record(seconds=7.0)
    rows["laser"] *= 1.1
    found = measure_record(rows, info_rows(RATE), 9.1)
    assert (found.status, found.channel) == (Status.IMPLAUSIBLE, "laser")
    assert LASER_M > 5e-3


def test_an_acceleration_below_one_converter_step_does_not_contradict_the_laser():
    """With 0.2 m/s² and steps of 0.85, the reading is zero, or twice the true value, depending on the zero error."""
    step, info = 0.85, info_rows(RATE)
    info["converter_step"][0] = info["resolution"][0] = step
    for offset in np.linspace(0.0, 1.0, 11):
        rows = record(seconds=7.0, base_m=BASE_M / 100.0)
        clean = -((2 * np.pi * 9.1) ** 2) * LASER_M / 100.0 * np.cos(2 * np.pi * 9.1 * np.arange(len(rows)) / RATE)
        rows["accelerometer"] = step * np.round(clean / step + offset) - step * offset
        assert measure_record(rows, info, 9.1).status is Status.OK, offset


def test_sensors_with_uncertain_sensitivities_do_not_contradict_each_other():
    info, rows = info_rows(RATE), record(seconds=7.0)
    rows["accelerometer"] *= 1.08
    assert measure_record(rows, info, 9.1).status is Status.IMPLAUSIBLE
    info["sensitivity_uncertainty"][0] = 0.05
    assert measure_record(rows, info, 9.1).status is Status.OK
