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
"""Controlled sine: its commands for a rig of known gain, its limits, and its curve on the rig."""

from __future__ import annotations

import attrs
import numpy as np
import pytest

from impact_rig.analysis.uncertainty_budget import combined
from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.errors import ConfigError
from impact_rig.physics.linear_response import transmissibility
from impact_rig.rig.config import RigConfig
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig.simtime import NS_PER_S
from impact_rig.states import Status
from impact_rig_studies.campaign.job import execute
from impact_rig_studies.operate.operator import operate
from impact_rig_studies.operate.plans import Hold, HoldPlan, SweepPlan
from impact_rig_studies.operate.stepped_sine import ControlledSine, Setpoint, SweepState
from qualification import prediction as by_test
from qualification.closed_loop import hold

PLAN = SweepPlan(frequencies_hz=(8.0, 9.0), current_a=0.3, direction="up_down")
HELD = HoldPlan(hold=Hold.BASE, target=1e-4)


class Bench:
    """Rig that accepts everything and measures a base amplitude of 2e-4 (current/1 A)^power every second."""

    stopped = ""

    def __init__(self, power=1.0, floor_m=0.0):
        self.power, self.floor_m, self.seconds = power, floor_m, 0
        self.set_ = []

    @property
    def now_ns(self):
        return self.seconds * NS_PER_S

    def command(self, frequency_hz, current_a):
        self.set_.append(Setpoint(frequency_hz, current_a))

    def clear(self):
        pass

    def step(self):
        self.seconds += 1

    def rows(self, _topic):
        row = np.zeros(1, TRANSMISSIBILITY)
        now = self.set_[-1]
        row["frequency"], row["status"], row["settled"] = now.frequency_hz, "ok", 1.0
        row["base_amplitude"] = max(2e-4 * now.current_a**self.power, self.floor_m)
        row["laser_amplitude"] = 50.0 * row["base_amplitude"]
        return row


def walked(bench, plan=PLAN, hold_plan=HELD):
    sweep = ControlledSine(plan, hold_plan)
    operate(sweep, bench)
    return sweep


@pytest.mark.parametrize("power", [0.7, 1.0, 1.6])
def test_every_point_of_the_sweep_is_held_up_and_down(power):
    bench = Bench(power)
    sweep = walked(bench)
    assert sweep.state is SweepState.FINISHED
    assert sweep.controlled["frequency"].tolist() == [8.0, 9.0, 9.0, 8.0]
    assert np.all(np.abs(sweep.controlled["error"]) <= HELD.tolerance)
    assert sweep.controlled["held"].tolist() == [1.0] * 4
    assert sweep.controlled["corrections"][0] >= 1
    assert sweep.controlled["corrections"][1:].tolist() == [0.0] * 3
    assert sweep.controlled["target"].tolist() == [1e-4] * 4


def test_a_point_that_cannot_be_held_keeps_its_error():
    sweep = walked(Bench(floor_m=1.5e-4))
    assert sweep.state is SweepState.FINISHED
    assert sweep.controlled["held"].tolist() == [0.0] * 4
    assert sweep.controlled["error"] == pytest.approx(0.5)
    assert sweep.controlled["corrections"].tolist() == [8.0] * 4


def test_a_skipped_point_uses_no_corrections_of_the_next():
    """The next point must have all of its corrections, not the rest of the previous point's."""

    class OverRangeOnce(Bench):
        def rows(self, topic):
            rows = super().rows(topic)
            row = rows[0]
            if row["frequency"] == 8.0 and len(self.set_) > 1:  # after a correction a sensor is over range
                row["status"], row["settled"] = Status.OVER_RANGE.value, 0.0
            return rows

    sweep = walked(
        OverRangeOnce(), attrs.evolve(PLAN, direction="up", current_a=0.1), attrs.evolve(HELD, corrections=1)
    )
    assert sweep.skipped == [8.0]
    assert sweep.controlled["frequency"].tolist() == [9.0]
    assert sweep.controlled["corrections"].tolist() == [1.0]
    assert sweep.controlled["held"].tolist() == [1.0]


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"current_limit_a": 0.4, "target": 2e-4}, "more than the limit of 0.4 A"),
        ({"superior_limit_m": 1e-3}, "swings 3 mm"),
    ],
)
def test_a_limit_ends_the_sweep(limits, words):
    bench = Bench()
    sweep = walked(bench, hold_plan=attrs.evolve(HELD, **limits))
    assert sweep.state is SweepState.ABORTED
    assert words in sweep.reason


@pytest.mark.parametrize("values", [{"target": 0.0}, {"tolerance": -1.0}, {"current_limit_a": float("inf")}])
def test_impossible_settings_are_rejected(values):
    with pytest.raises(ConfigError, match=next(iter(values))):
        attrs.evolve(HELD, **values)


@pytest.mark.heavy
@pytest.mark.parametrize(("what", "target"), [("base", 60e-6), ("superior", 3e-3)])
def test_the_base_of_the_linear_rig_is_held_and_dt_is_the_closed_form(what, target):
    job = attrs.evolve(
        by_test.job(9.0, 6e-3), changes={"sphere.present": False}, gap_m=NO_SPHERE, frequencies_hz=(8.8, 9.2)
    )
    found = hold(job, HoldPlan(hold=what, target=target))
    assert found.reason == ""
    assert np.all(np.abs(found.controlled["error"]) <= 0.005)
    for row in found.controlled:
        wanted = abs(complex(transmissibility(RigConfig(), float(row["frequency"]))))
        assert abs(row["transmissibility"] - wanted) <= 2.0 * row["transmissibility_uncertainty"], row


@pytest.mark.heavy
def test_a_held_base_yields_the_dt_of_a_prescribed_drive():
    """All gaps and frequencies are checked by `python -m qualification.closed_loop`."""
    job = by_test.job(9.4, 10e-3)
    found = hold(job, HoldPlan(hold=Hold.BASE, target=60e-6))
    assert found.controlled["held"].tolist() == [1.0]
    prescribed = attrs.evolve(job, changes={**job.changes, "drive.kind": "prescribed"}, current_a=60e-6)
    rows = execute(prescribed).rows
    assert combined(rows) > 0.0
    assert found.rows["transmissibility"][0] == pytest.approx(rows["transmissibility"][0], rel=0.01)
