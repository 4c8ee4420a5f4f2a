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
"""Loop of every operator here: set, wait until applied, settle, measure, report, and repeat.

`Operator` processes updates: a node with callbacks passes on what arrives. `operate` drives a rig and its analysis
block by block, for campaigns and the demo.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar

import attrs
import numpy as np

from impact_rig import topics
from impact_rig.blocks import Table
from impact_rig.driver import RigDriver
from impact_rig.simtime import NS_PER_S
from impact_rig_studies.operate.phase_lock import LockedSine
from impact_rig_studies.operate.stepped_sine import Setpoint, SteppedSine, SweepState

OnUpdate = Callable[[SteppedSine], None]  # receives the sweep at its start and whenever its curve has grown


@attrs.frozen
class Applied:
    """Change of the drive that the rig has accepted."""

    setpoint: Setpoint  # frequency and current from that time on
    at_ns: int  # rig time

    @classmethod
    def of(cls, table: Table, at_ns: int | None = None) -> list[Applied]:
        """Return the changes in a table of `shaker/applied`; `at_ns` replaces their own times."""
        return [
            cls(
                Setpoint(float(row["frequency"]), float(row["current"])),
                table.stamp_ns + round(float(row["time"]) * NS_PER_S) if at_ns is None else at_ns,
            )
            for row in table.rows
        ]


@attrs.frozen(eq=False, kw_only=True)
class Update:
    """Events of a rig since the last update; processed in the order of the attributes."""

    now_ns: int  # rig time
    applied: Sequence[Applied] = ()  # accepted changes of the drive
    rows: Iterable[np.void] = ()  # measurements, rows of `transmissibility/table`
    scans: Iterable[Table] = ()  # blocks of `daq/scan`, for a run that requires them
    stopped: str = ""  # reason why the shaker is stopped; empty otherwise


ControllerRun = SteppedSine | LockedSine
"""Controller run, such as a sweep or a phase lock: it answers updates with the next setpoint."""
R = TypeVar("R", bound=ControllerRun)


class Operator(Generic[R]):
    """Connection of a controller run to a drive: it passes updates to the run and setpoints to the drive.

    Args:
        run: decides the next setpoint, and keeps the measurements.
        drive: sets frequency and current; the last setpoint, when the run is no longer busy, has zero current.
        on_update: receives the run at its start and after every measurement.
    """

    def __init__(self, run: R, drive: Callable[[Setpoint], None], on_update: Callable[[R], None]) -> None:
        self.run = run
        self._drive = drive
        self._on_update = on_update

    @property
    def busy(self) -> bool:
        """Return whether the run is still going on."""
        return self.run.state is SweepState.RUNNING

    def begin(self, now_ns: int) -> None:
        """Set the first point."""
        self._follow(self.run.start(now_ns))
        self._on_update(self.run)

    def handle(self, update: Update) -> None:
        """Pass on an update, and set what the run requests."""
        run, measured = self.run, self.run.measured
        for applied in update.applied:
            self._follow(run.on_applied(applied.setpoint.frequency_hz, applied.setpoint.current_a, applied.at_ns))
        for row in update.rows:
            self._follow(run.on_measurement(row, update.now_ns))
        for table in update.scans:
            self._follow(run.on_scans(table))
        if run.measured > measured:
            self._on_update(run)
        if update.stopped:
            self.abort(update.stopped)
        self._follow(run.on_time(update.now_ns))

    def abort(self, reason: str) -> None:
        """End a run in progress."""
        self._follow(self.run.abort(reason))

    def _follow(self, setpoint: Setpoint | None) -> None:
        if setpoint is not None:
            self._drive(setpoint)


def ignore(_sweep: SteppedSine) -> None:
    """Do nothing on an update."""


def operate(sweep: SteppedSine, rig: RigDriver, on_update: OnUpdate = ignore) -> None:
    """Take a rig through a whole sweep until it ends, and leave the drive in its final state.

    Args:
        sweep: decides the next setpoint.
        rig: new rig with its analysis; a block is the interval between two updates.
        on_update: receives the sweep at its start and after every measurement.

    Raises:
        ImpactRigError: the rig rejected a command, or failed; the sweep keeps its measurements.
    """
    applied: list[Applied] = []

    def drive(setpoint: Setpoint) -> None:
        if operator.busy:
            rig.command(setpoint.frequency_hz, setpoint.current_a)
            applied.append(Applied(setpoint, rig.now_ns))

    operator = Operator(sweep, drive, on_update)
    operator.begin(rig.now_ns)
    while operator.busy:
        rig.clear()
        rig.step()
        done, applied = applied, []
        rows = rig.rows(topics.TRANSMISSIBILITY_TABLE.name)
        operator.handle(Update(now_ns=rig.now_ns, applied=done, rows=rows, stopped=rig.stopped))
