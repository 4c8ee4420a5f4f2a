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
"""Phase lock with an operator: blocks and accepted commands go in, setpoints come out, with any failure in between."""

from __future__ import annotations

import math

import numpy as np
import pytest

from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S
from impact_rig_studies.operate.operator import Applied, Operator, Update
from impact_rig_studies.operate.phase_lock import LockedSine
from impact_rig_studies.operate.plans import LockPlan, SweepPlan
from impact_rig_studies.operate.stepped_sine import Setpoint, SweepState

LINEAR = from_flat(RigConfig(), {"sphere.present": False, "daq.block_scans": 500})
PLAN = LockPlan(start_hz=8.9, current_a=0.3, dwell_s=2.0)
TRUE_HZ = 9.105 / math.sqrt(1.0 - 4.0 * LINEAR.structure.damping_ratio**2)


class Running:
    """Rig whose time passes by itself, with an operator."""

    def __init__(self, plan: LockPlan = PLAN) -> None:
        self.rig = Rig(LINEAR)
        self.rested = False
        self.noted: list[int] = []
        self.lock = LockedSine(plan, self.rig.info().rows, SweepPlan().accept_limit_s)
        self.operator = Operator(self.lock, self.drive, lambda lock: self.noted.append(lock.measured))

    def now_ns(self) -> int:
        return self.rig.next_block_ns

    def drive(self, setpoint: Setpoint) -> None:
        if self.operator.busy:
            self.rig.accept(frequency_hz=setpoint.frequency_hz)
        else:
            self.rested = True
        self.rig.accept(amplitude=setpoint.current_a)

    def begin(self) -> None:
        self.operator.begin(self.now_ns())

    def block(self, lost: bool = False, accepted: bool = True) -> None:
        """Let a block pass, and inform the operator of it."""
        blocks = self.rig.advance(self.rig.block_end_ns(1))
        applied = [one for table in self.rig.take_applied() for one in Applied.of(table)] if accepted else []
        scans = [] if lost else [block.scan for block in blocks]
        self.operator.handle(Update(now_ns=self.now_ns(), applied=applied, scans=scans))

    def run(self, seconds: float = 60.0) -> None:
        end_ns = self.now_ns() + round(seconds * NS_PER_S)
        while self.operator.busy and self.now_ns() < end_ns:
            self.block()


def test_the_lock_finds_the_resonance_despite_lost_scans_and_stops_after_the_dwell() -> None:
    running = Running()
    assert running.lock.describe() == "idle"
    running.begin()
    assert running.lock.describe() == "seeking at 8.9 Hz"
    running.run(1.0)
    running.block(lost=True)
    assert running.lock.measured == 0, "the stretch restarts"
    running.run()
    assert (running.lock.state, running.rested) == (SweepState.FINISHED, True)
    rows = running.lock.rows
    assert rows["time"][0] > 1.0 + 1.5
    assert rows["frequency"][-1] == pytest.approx(TRUE_HZ, abs=0.003)
    assert np.degrees(rows["phase"][-1]) == pytest.approx(-90.0, abs=0.5)
    published = running.lock.sweep_from(len(rows) - 1)
    assert [published[name][0] for name in rows.dtype.names] == [*rows[-1]]
    assert published["status"][0] == b"ok"
    assert np.isnan(published["error"][0])
    assert running.noted == list(range(len(rows) + 1))
    assert running.lock.describe().startswith("finished, the resonance is at 9.10")
    assert running.lock.figures()["phase_deg"] == pytest.approx(-90.0, abs=0.5)


def test_a_locked_stretch_begins_when_the_setpoint_is_active() -> None:
    running = Running()
    running.begin()
    running.block(accepted=False)
    running.rig.take_applied()
    running.run(3.0)
    assert running.lock.measured == 0, "the command has not been confirmed"
    assert running.operator.busy
    running.run(3.0)
    wanted = "8.9 Hz and the amplitude 0.3"
    assert running.lock.reason == f"the rig did not accept {wanted} within 5 s of rig time (accept_limit_s)"
    assert running.rested


def test_a_command_of_another_client_or_silence_ends_the_lock() -> None:
    running = Running()
    running.begin()
    running.run(2.0)
    running.rig.accept(frequency_hz=12.0)
    running.run(1.0)
    found = "12 Hz and the amplitude 0.3"
    assert running.lock.reason == f"another client set {found}; only one client may command the drive"
    silent = Running()
    silent.begin()
    silent.run(1.0)
    while silent.operator.busy:
        silent.block(lost=True)
    assert silent.lock.reason.startswith("no scans received for 5 s of rig time (accept_limit_s); check")
    assert silent.lock.on_scans(silent.rig.advance(silent.rig.block_end_ns(1))[0].scan) is None
    assert silent.operator.abort("late") is None
    assert silent.lock.reason.startswith("no scans received")
