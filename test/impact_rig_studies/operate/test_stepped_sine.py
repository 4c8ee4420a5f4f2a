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
"""The stepped sine as a state machine, alone and in closed loop with the tracker."""

from __future__ import annotations

import numpy as np
import pytest
from kits.records import applied, blocks, info_rows, linear_transmissibility, steady_record

from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import TRANSMISSIBILITY, Table
from impact_rig.errors import ConfigError
from impact_rig.simtime import NS_PER_S
from impact_rig_studies.operate.plans import Direction, SweepPlan
from impact_rig_studies.operate.stepped_sine import Setpoint, SteppedSine, SweepState

S = NS_PER_S
POINTS = (9.0, 8.0, 10.0)


def row(frequency_hz, status="ok", settled=None):
    made = np.zeros(1, TRANSMISSIBILITY)
    made["frequency"], made["status"] = frequency_hz, status
    made["settled"] = status == "ok" if settled is None else settled
    return made[0]


def sweep(**changes):
    return SteppedSine(SweepPlan(**{"frequencies_hz": POINTS, "current_a": 0.5, **changes}))


@pytest.mark.parametrize(
    ("direction", "visited"),
    [("up", [8.0, 9.0, 10.0]), ("down", [10.0, 9.0, 8.0]), ("up_down", [8.0, 9.0, 10.0, 10.0, 9.0, 8.0])],
)
def test_points_are_visited_in_order_and_the_drive_ends_at_zero(direction, visited):
    one = sweep(direction=direction)
    assert (one.state, one.describe()) == (SweepState.IDLE, "idle")
    commands = [one.start(0)]
    now = 0
    while one.state is SweepState.RUNNING:
        now += 10 * S
        one.on_applied(one.frequency_hz, 0.5, now)
        assert one.on_time(now + S) is None
        commands.append(one.on_measurement(row(one.frequency_hz), now + 5 * S))
    assert [c.frequency_hz for c in commands[:-1]] == visited
    assert all(c.current_a == 0.5 for c in commands[:-1])
    assert commands[-1] == Setpoint(visited[-1], 0.0)
    assert (one.state, one.describe()) == (SweepState.FINISHED, f"finished, {len(visited)} points")
    assert one.rows["frequency"].tolist() == visited
    assert one.progress == (len(visited), len(visited))


def test_several_measurements_per_point_and_rows_of_other_points_are_ignored():
    one = sweep(measurements_per_point=2)
    one.start(0)
    assert one.on_measurement(row(9.0), S) is None, "a row still under way from the point before"
    assert one.on_measurement(row(8.0), S) is None
    assert one.on_measurement(row(8.0, "command_changed"), S) is None
    assert one.on_measurement(row(8.0), 2 * S) == Setpoint(9.0, 0.5)
    assert len(one.rows) == 2


@pytest.mark.parametrize("keep", [True, False])
def test_an_unsettled_point_is_kept_or_skipped_as_configured(keep):
    one = sweep(keep_unsettled=keep, retries=0)
    one.start(0)
    answer = one.on_measurement(row(8.0, "not_settled"), S)
    assert answer == (Setpoint(9.0, 0.5) if keep else Setpoint(8.0, 0.0))
    assert one.state is (SweepState.RUNNING if keep else SweepState.ABORTED)


@pytest.mark.parametrize("status", ["lost_blocks", "silence", "swapped_channels", "not_finite"])
def test_failed_measurements_are_retried_a_limited_number_of_times(status):
    one = sweep(retries=2)
    one.start(0)
    assert one.on_measurement(row(8.0, status), S) is None
    assert one.on_measurement(row(8.0, status), 2 * S) is None
    assert one.on_measurement(row(8.0, status), 3 * S) == Setpoint(8.0, 0.0)
    assert one.state is SweepState.ABORTED
    start = "the measurement at 8 Hz failed 3 times, more than retries allows (2), the last one with status"
    assert one.reason.startswith(f"{start} {status}: ")


@pytest.mark.parametrize("skip", [True, False])
def test_a_point_over_range_is_skipped_or_ends_the_sweep(skip):
    one = sweep(retries=0, skip_over_range=skip)
    one.start(0)
    answer = one.on_measurement(row(8.0, "over_range"), S)
    assert answer == (Setpoint(9.0, 0.5) if skip else Setpoint(8.0, 0.0))
    assert one.skipped == ([8.0] if skip else [])


def test_the_wait_for_a_measurement_is_bounded():
    one = sweep(dwell_limit_s=30.0, accept_limit_s=2.0)
    one.start(0)
    assert one.on_time(2 * S) is None
    assert one.on_time(3 * S) == Setpoint(8.0, 0.0)
    assert one.reason == "the rig did not accept 8 Hz and the amplitude 0.5 within 2 s of rig time (accept_limit_s)"
    one.start(0)
    one.on_applied(8.0, 0.5, S)
    assert one.on_time(31 * S) is None
    assert one.on_time(32 * S) == Setpoint(8.0, 0.0)
    assert one.reason.startswith("8 Hz was not measured within 30 s of rig time (dwell_limit_s); raise this limit")


def test_a_trip_or_a_command_of_another_client_ends_the_sweep():
    one = sweep()
    one.start(0)
    assert one.abort("over-travel") == Setpoint(8.0, 0.0)
    assert one.reason == "over-travel"
    assert one.abort("again") is None
    assert one.on_measurement(row(8.0), S) is None
    one.start(0)
    assert one.state is SweepState.RUNNING
    assert one.reason == ""
    assert one.on_applied(8.0, 0.0, 0) is None, "the frequency is set first, then the current"
    one.on_applied(8.0, 0.5, 0)
    assert one.on_applied(8.5, 0.5, S) == Setpoint(8.0, 0.0)
    assert one.reason == "another client set 8.5 Hz and the amplitude 0.5; only one client may command the drive"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frequencies_hz": ()}, "frequencies_hz must be one or more"),
        ({"frequencies_hz": (9.0, np.nan)}, "frequencies_hz must be > 0"),
        ({"frequencies_hz": (9.0, 9.0)}, "must not repeat"),
        ({"current_a": 0.0}, "current_a must be > 0"),
        ({"current_a": np.inf}, "current_a must be > 0"),
        ({"measurements_per_point": 0}, "measurements_per_point must be >= 1"),
        ({"retries": -1}, "retries must be >= 0"),
        ({"dwell_limit_s": -1.0}, "dwell_limit_s must be > 0"),
    ],
)
def test_an_impossible_plan_is_rejected(changes, message):
    with pytest.raises(ConfigError, match=message):
        sweep(**changes)


@pytest.mark.heavy
def test_a_closed_loop_with_the_tracker_measures_the_curve():
    """This is a small campaign: the tracker's rows drive the sweep, and its commands drive the closed-form rig."""
    rate, block = 2000, 200
    rng = np.random.default_rng(1)
    one = sweep(direction=Direction.UP_DOWN)
    tracker = Tracker(TrackerSettings(window_s=0.1))
    tracker.configure(Table(0, info_rows(rate, gain_u=0.0)))
    command = one.start(0)
    records = {
        frequency: list(blocks(steady_record(frequency, 8.0, rate_hz=rate, rng=rng), rate, block))
        for frequency in POINTS
    }
    at = 0
    while one.state is SweepState.RUNNING:
        now = at * S // rate
        if command:
            tracker.on_applied(applied(command.frequency_hz, command.current_a, at_ns=now))
            one.on_applied(command.frequency_hz, command.current_a, now)
            current, played = records[command.frequency_hz], 0
            command = None
        findings = tracker.feed(Table(now, current[played % len(current)].rows))
        played, at = played + 1, at + block
        for table in findings.measurements:
            command = one.on_measurement(table.rows[0], now) or command
        command = one.on_time(now) or command
    assert one.state is SweepState.FINISHED, one.reason
    assert one.rows["frequency"].tolist() == [8.0, 9.0, 10.0, 10.0, 9.0, 8.0]
    truth = np.abs(linear_transmissibility(one.rows["frequency"]))
    assert np.all(np.abs(one.rows["transmissibility"] - truth) < 4 * one.rows["transmissibility_uncertainty"])
    assert np.all(one.rows["settled"] == 1)
