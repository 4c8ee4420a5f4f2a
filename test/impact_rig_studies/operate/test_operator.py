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
"""Operator loop: what it sets, where it ends and what it reports, with a rig that follows a script."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rig.blocks import APPLIED, TRANSMISSIBILITY, Table
from impact_rig.errors import CommandError
from impact_rig.simtime import NS_PER_S
from impact_rig_studies.operate.operator import Applied, Operator, Update, operate
from impact_rig_studies.operate.plans import SweepPlan
from impact_rig_studies.operate.stepped_sine import Setpoint, SteppedSine, SweepState

PLAN = SweepPlan(frequencies_hz=(9.0, 8.0), current_a=0.5, measurements_per_point=2)


def measurement(frequency_hz, status="ok"):
    row = np.zeros(1, TRANSMISSIBILITY)
    row["frequency"], row["status"], row["settled"] = frequency_hz, status, status == "ok"
    return row[0]


class Script:
    """A rig that accepts everything at once, and its analysis that measures every second.

    Args:
        stops_s: when it stops.
        refuses: a frequency it refuses.
        repeats: measurements a second, all of the present frequency.
        status: of its measurements.
    """

    def __init__(self, stops_s=None, refuses=None, repeats=1, status="ok"):
        self.stops_s, self.refuses, self.repeats, self.status = stops_s, refuses, repeats, status
        self.seconds = 0
        self.done = []

    @property
    def now_ns(self):
        return self.seconds * NS_PER_S

    @property
    def stopped(self):
        return "the fuse blew" if self.stops_s == self.seconds else ""

    def command(self, frequency_hz, current_a):
        if frequency_hz == self.refuses:
            raise CommandError("no")
        self.done.append(Setpoint(frequency_hz, current_a))

    def clear(self):
        pass

    def step(self):
        self.seconds += 1

    def rows(self, topic):
        assert topic == "transmissibility/table"
        return [measurement(self.done[-1].frequency_hz, self.status)] * self.repeats


def test_every_point_is_set_measured_and_reported():
    sweep, script, noted = SteppedSine(PLAN), Script(), []
    operate(sweep, script, lambda sweep: noted.append(sweep.measured))
    assert script.done == [Setpoint(8.0, 0.5), Setpoint(9.0, 0.5)], "a rig that is given up is not commanded"
    assert noted == [0, 1, 2, 3, 4], "at the begin, and after each measurement"
    assert sweep.rows["time"].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert sweep.state is SweepState.FINISHED


def test_a_measurement_that_ends_a_point_does_not_count_for_the_next():
    sweep, script = SteppedSine(PLAN), Script(repeats=3)
    operate(sweep, script)
    assert sweep.rows["frequency"].tolist() == [8.0, 8.0, 9.0, 9.0]


def test_a_rig_that_stops_ends_the_sweep_which_keeps_its_measurements():
    sweep, script = SteppedSine(PLAN), Script(stops_s=2)
    operate(sweep, script)
    assert (sweep.state, sweep.reason) == (SweepState.ABORTED, "the fuse blew")
    assert sweep.measured == 2


def test_measurements_are_processed_before_a_simultaneous_trip():
    """A sweep whose last measurement arrived together with the trip is complete."""
    sweep = SteppedSine(PLAN)
    operate(sweep, Script(stops_s=4))
    assert (sweep.state, sweep.reason, sweep.measured) == (SweepState.FINISHED, "", 4)


def test_a_rejected_point_is_an_error_that_keeps_earlier_points():
    sweep = SteppedSine(PLAN)
    with pytest.raises(CommandError, match="no"):
        operate(sweep, Script(refuses=9.0))
    assert sweep.rows["frequency"].tolist() == [8.0, 8.0]


def test_a_point_that_is_never_measured_is_given_up():
    sweep, script = SteppedSine(PLAN), Script(repeats=0)
    operate(sweep, script)
    assert sweep.reason.startswith(f"8 Hz was not measured within {PLAN.dwell_limit_s:g} s of rig time (dwell_limit_s)")
    assert script.seconds == PLAN.dwell_limit_s + 1


def test_an_aborted_operator_sets_the_current_to_zero_once():
    done = []
    operator = Operator(SteppedSine(PLAN), done.append, lambda _sweep: None)
    operator.begin(0)
    assert operator.busy
    operator.abort("enough")
    operator.abort("really")
    operator.handle(Update(now_ns=NS_PER_S, rows=[measurement(8.0)]))
    assert not operator.busy
    assert done == [Setpoint(8.0, 0.5), Setpoint(8.0, 0.0)]
    assert operator.run.reason == "enough"


def test_an_accepted_change_is_confirmed_by_shaker_applied():
    rows = np.zeros(2, APPLIED)
    rows["frequency"], rows["current"], rows["time"] = [8.0, 9.0], [0.5, 0.25], [0.0, 0.02]
    table = Table(5_000_000, rows)
    assert Applied.of(table) == [Applied(Setpoint(8.0, 0.5), 5_000_000), Applied(Setpoint(9.0, 0.25), 25_000_000)]
    assert [one.at_ns for one in Applied.of(table, 7)] == [7, 7]
