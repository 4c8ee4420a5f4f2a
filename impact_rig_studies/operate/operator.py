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
"""Connection of a controller run (`SteppedSine` or `LockedSine`) to the drive of a rig.

`Operator` passes events of the rig to the run, and sets the drive to the setpoints that the run requests. A node calls
`Operator` from its callbacks. `operate` is a complete loop around it, which also advances the rig and its analysis.
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
    """Frequency and current of the drive after a change that the rig has applied, with the rig time of the change."""

    setpoint: Setpoint  # frequency and current from that time on
    at_ns: int  # rig time of the change

    @classmethod
    def of(cls, table: Table, at_ns: int | None = None) -> list[Applied]:
        """Return the changes of the drive in a received table of `shaker/applied`, one for each row.

        Args:
            table: the table.
            at_ns: rig time that replaces the times in the table; None means that the times of the table count.
        """
        return [
            cls(
                Setpoint(float(row["frequency"]), float(row["current"])),
                table.stamp_ns + round(float(row["time"]) * NS_PER_S) if at_ns is None else at_ns,
            )
            for row in table.rows
        ]


@attrs.frozen(eq=False, kw_only=True)
class Update:
    """Events of a rig since the previous update.

    `Operator.handle` processes them in the order of the fields, and the present time last.
    """

    now_ns: int  # present rig time
    applied: Sequence[Applied] = ()  # accepted changes of the drive
    rows: Iterable[np.void] = ()  # measurements, rows of `transmissibility/table`
    scans: Iterable[Table] = ()  # blocks of `daq/scan`, which only a phase lock requires
    stopped: str = ""  # reason why the shaker is stopped, which aborts the run; empty if it is not


ControllerRun = SteppedSine | LockedSine
"""State machine of one sweep or phase lock: it returns the next setpoint for each event of the rig, or None."""
R = TypeVar("R", bound=ControllerRun)


class Operator(Generic[R]):
    """Connection of a controller run to a drive: it passes updates to the run and setpoints to the drive.

    Args:
        run: controller run, which decides the next setpoint and keeps the measurements.
        drive: function that sets frequency and current of the rig. When the run ends, it is called a last time, with
            zero current; `busy` is then already False.
        on_update: function that receives the run at its start, and after each update with new measurements.
    """

    def __init__(self, run: R, drive: Callable[[Setpoint], None], on_update: Callable[[R], None]) -> None:
        self.run = run
        self._drive = drive
        self._on_update = on_update

    @property
    def busy(self) -> bool:
        """Return whether the run has begun, and has neither finished nor been aborted."""
        return self.run.state is SweepState.RUNNING

    def begin(self, now_ns: int) -> None:
        """Start the run, set the drive to its first point, and call `on_update`.

        Args:
            now_ns: present rig time.
        """
        self._follow(self.run.start(now_ns))
        self._on_update(self.run)

    def handle(self, update: Update) -> None:
        """Pass the events of an update to the run one after the other, and set the drive to each requested setpoint.

        `on_update` is called once if the run has accepted a measurement of this update.
        """
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
        """Abort the run, and set the current of the drive to zero; do nothing if no run is in progress.

        Args:
            reason: reason for the user, which becomes `run.reason`.
        """
        self._follow(self.run.abort(reason))

    def _follow(self, setpoint: Setpoint | None) -> None:
        if setpoint is not None:
            self._drive(setpoint)


def ignore(_sweep: SteppedSine) -> None:
    """Ignore an update: default of `on_update` for callers that do not show the progress of a sweep."""


def operate(sweep: SteppedSine, rig: RigDriver, on_update: OnUpdate = ignore) -> None:
    """Run a complete sweep on a rig until the sweep has finished or is aborted.

    Afterwards, `sweep.state` and `sweep.reason` describe the end. The drive keeps its last setpoint, unless the shaker
    was stopped.

    Args:
        sweep: the sweep, which decides the next setpoint and keeps the measurements.
        rig: new rig with its analysis; the sweep is updated after each block of scans.
        on_update: function that receives the sweep at its start, and after each block with new measurements.

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
