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
"""The loop of every operator here: set, wait until applied, settle, measure, note, and set again.

`Operator` takes news and acts; whoever has callbacks (a node) hands it what comes in. `operate` waits for the news
itself, the way of campaigns and of the demo. What differs between rigs is behind `Apparatus`: a reset rig with a new
analysis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, Protocol, TypeVar

import attrs
import numpy as np

from impact_rig.blocks import Table
from impact_rig.simtime import NS_PER_S
from impact_rig_studies.operate.phase_lock import LockedSine
from impact_rig_studies.operate.stepped_sine import Setpoint, SteppedSine, SweepState

Note = Callable[[SteppedSine], None]  # told of the sweep at its begin and whenever its curve has grown


@attrs.frozen
class Applied:
    """A change of the drive that the rig has accepted."""

    setpoint: Setpoint  # frequency and current from then on
    at_ns: int  # rig time

    @classmethod
    def of(cls, table: Table, at_ns: int | None = None) -> list[Applied]:
        """Return the changes in a table of `shaker/applied`; `at_ns` stands for their own instants."""
        return [
            cls(
                Setpoint(float(row["frequency"]), float(row["current"])),
                table.stamp_ns + round(float(row["time"]) * NS_PER_S) if at_ns is None else at_ns,
            )
            for row in table.rows
        ]


@attrs.frozen(eq=False, kw_only=True)
class News:
    """What an operator hears at once; taken up in the order of the attributes."""

    now_ns: int  # rig time
    applied: Sequence[Applied] = ()  # accepted changes of the drive
    rows: Iterable[np.void] = ()  # measurements, rows of `transmissibility/table`
    scans: Iterable[Table] = ()  # blocks of `daq/scan`, where somebody looks at them
    stopped: str | None = None  # why the rig goes on no more, or None


Walk = SteppedSine | LockedSine
"""What an operator walks through: a sweep, or the lock on a resonance; it answers news with the next setpoint."""
W = TypeVar("W", bound=Walk)


class Apparatus(Protocol):
    """A reset rig with a new analysis, as an operator has them in hand."""

    def now_ns(self) -> int:
        """Return the rig time."""
        ...

    def set(self, setpoint: Setpoint) -> None:
        """Command frequency, then current; that they are applied is news.

        Raises:
            ImpactRigError: the rig refused.
        """
        ...

    def rest(self) -> None:
        """End, in order or not: what drives a shaker sets its current to zero."""
        ...


class PatientApparatus(Apparatus, Protocol):
    """An apparatus that can be waited for."""

    def wait(self) -> News:
        """Let rig time pass until there may be something to do, and return what happened."""
        ...


class Operator(Generic[W]):
    """Walks an apparatus through a sweep, or a lock.

    Args:
        sweep: decides what comes next, and keeps what was measured.
        note: told when it begins and of every measurement.
    """

    def __init__(self, sweep: W, apparatus: Apparatus, note: Callable[[W], None]) -> None:
        self.sweep = sweep
        self._apparatus = apparatus
        self._note = note

    @property
    def busy(self) -> bool:
        """Whether a sweep is under way."""
        return self.sweep.state is SweepState.RUNNING

    def begin(self) -> None:
        """Set the first point."""
        self._follow(self.sweep.start(self._apparatus.now_ns()))
        self._note(self.sweep)

    def hear(self, news: News) -> None:
        """Take up what happened, and do what it asks for."""
        sweep, measured = self.sweep, self.sweep.measured
        for applied in news.applied:
            self._follow(sweep.on_applied(applied.setpoint.frequency_hz, applied.setpoint.current_a, applied.at_ns))
        for row in news.rows:
            self._follow(sweep.on_measurement(row, news.now_ns))
        for table in news.scans:
            self._follow(sweep.on_scans(table))
        if sweep.measured > measured:
            self._note(sweep)
        if news.stopped is not None:
            self.abort(news.stopped)
        self._follow(sweep.on_time(news.now_ns))

    def abort(self, reason: str) -> None:
        """End a sweep under way."""
        self._follow(self.sweep.abort(reason))

    def _follow(self, setpoint: Setpoint | None) -> None:
        if setpoint is None:
            return
        if self.busy:
            self._apparatus.set(setpoint)
        else:
            self._apparatus.rest()


def silent(_sweep: SteppedSine) -> None:
    """Note nothing."""


def operate(sweep: SteppedSine, apparatus: PatientApparatus, note: Note = silent) -> None:
    """Walk through a whole sweep, however it ends.

    Raises:
        ImpactRigError: the apparatus refused, or failed; the sweep has what was measured before.
    """
    operator = Operator(sweep, apparatus, note)
    operator.begin()
    while operator.busy:
        operator.hear(apparatus.wait())
