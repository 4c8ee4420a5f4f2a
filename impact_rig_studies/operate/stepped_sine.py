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
"""Stepped sine, optionally with a held amplitude: the next setpoint, as a pure state machine called by `operator`.

    idle ── start ──► running ── all points measured ──► finished
                         └────── rule broken ──────────► aborted

It receives what an operator sees (accepted commands, measurements, the time) and answers with the next setpoint. The
last setpoint of a sweep, finished or aborted, always sets the current to zero.

`ControlledSine` holds an amplitude: at each point it measures the settled response, compares, corrects the current by
the slope of the last two measurements (in logarithms; initially 1, which is exact for a linear rig) and measures again.
The held quantity is a reading of the instruments.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping

import attrs
import numpy as np
from numpy.lib import recfunctions
from numpy.typing import NDArray

from impact_rig.blocks import SWEEP, TRANSMISSIBILITY, Table
from impact_rig.simtime import NS_PER_S
from impact_rig.states import Status
from impact_rig_studies.operate.plans import Hold, HoldPlan, SweepPlan


@attrs.frozen
class Setpoint:
    """Setpoint of the drive: frequency [Hz] and peak current [A]."""

    frequency_hz: float
    current_a: float


SAME = 1e-9  # relative difference up to which two frequencies or currents are equal

PASSING = frozenset({Status.COMMAND_CHANGED, Status.LABEL_CHANGED, Status.CALIBRATION_CHANGED, Status.NO_FREQUENCY})
"""Statuses that only report that a change was applied."""


def sweep_rows(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Return rows as rows of `blocks.SWEEP`; columns that they lack are NaN, 0 or empty."""
    found = np.zeros(len(rows), SWEEP)
    for name in set(SWEEP.names or ()) - {"waited"}:  # which cannot be NaN
        if SWEEP[name].kind == "f":
            found[name] = np.nan
    recfunctions.assign_fields_by_name(found, rows, zero_unassigned=False)
    return found


class SweepState(enum.StrEnum):
    """State of a sweep."""

    IDLE = "idle"
    RUNNING = "running"
    FINISHED = "finished"
    ABORTED = "aborted"


class SteppedSine:
    """State machine of a stepped sweep.

    Attributes:
        state: state of the sweep.
        reason: why it was aborted; empty otherwise.
        skipped: skipped frequencies [Hz].
    """

    def __init__(self, plan: SweepPlan) -> None:
        self._plan = plan
        self._points = plan.points()
        self._accepted = False
        self._reset()

    @property
    def rows(self) -> NDArray[np.void]:
        """Curve so far: rows of `transmissibility/table` in the order of measurement, `time` from the start."""
        return np.concatenate(self._rows) if self._rows else np.zeros(0, dtype=TRANSMISSIBILITY)

    def sweep_from(self, first: int) -> NDArray[np.void]:
        """Return the curve from a row on: rows of `blocks.SWEEP`."""
        return sweep_rows(self.rows[first:])

    @property
    def measured(self) -> int:
        """Number of rows of the curve so far."""
        return len(self._rows)

    @property
    def progress(self) -> tuple[int, int]:
        """Number of completed points, and of all points."""
        return self._at, len(self._points)

    def describe(self) -> str:
        """Return a readable description of the state."""
        done, count = self.progress
        running = f"point {done + 1} of {count}: {self.frequency_hz:g} Hz"
        return running if self.state is SweepState.RUNNING else f"finished, {count} points"

    def figures(self) -> dict[str, object]:
        """Return the progress for programs."""
        done, count = self.progress
        return {"points_done": done, "points": count, "frequency_hz": self.frequency_hz, "skipped": self.skipped}

    @property
    def frequency_hz(self) -> float:
        """Frequency of the present point, or of the last one."""
        return self._points[min(self._at, len(self._points) - 1)]

    @property
    def current_a(self) -> float:
        """Current of the present point."""
        return self._plan.current_a

    def start(self, now_ns: int) -> Setpoint:
        """Start, or start again from the first point."""
        self._reset()
        self._start_ns = now_ns
        self.state = SweepState.RUNNING
        return self._go(now_ns)

    def on_applied(self, frequency_hz: float, current_a: float, now_ns: int) -> Setpoint | None:
        """Process an accepted change of the drive; a change by another client aborts the sweep."""
        if self.state is not SweepState.RUNNING:
            return None
        ours = math.isclose(frequency_hz, self.frequency_hz, rel_tol=SAME)
        full = math.isclose(current_a, self.current_a, rel_tol=SAME)
        if ours and full:
            if not self._accepted:
                self._accepted, self._since_ns = True, now_ns
            return None
        if self._accepted:
            return self._abort(f"another client set {frequency_hz:g} Hz and {current_a:g} A")
        return None  # frequency and current are applied one after the other

    def on_measurement(self, row: np.void, now_ns: int) -> Setpoint | None:
        """Process a row of `transmissibility/table`; rows of other frequencies are ignored."""
        if self.state is not SweepState.RUNNING or not math.isclose(
            float(row["frequency"]), self.frequency_hz, rel_tol=SAME
        ):
            return None
        status = Status(bytes(row["status"]).decode())
        settled = bool(row["settled"] == 1.0)
        if settled or (status is Status.NOT_SETTLED and self._plan.keep_unsettled):
            again = self._adjusted(row, now_ns)
            if again is not None:
                return again
            self._accepted = True
            taken = np.array([row], dtype=TRANSMISSIBILITY)
            taken["time"] = (now_ns - self._start_ns) / NS_PER_S
            self._rows.append(taken)
            self._taken += 1
            return self._next(now_ns) if self._taken >= self._plan.measurements_per_point else None
        if status in PASSING:
            return None
        self._failures += 1
        if self._failures <= self._plan.retries:
            return None
        if status is Status.OVER_RANGE and self._plan.skip_over_range:
            self.skipped.append(self.frequency_hz)
            return self._next(now_ns)
        return self._abort(f"{status.value} at {self.frequency_hz:g} Hz, {self._failures} times")

    def on_scans(self, table: Table) -> Setpoint | None:
        """Ignore scans: a sweep uses the measurements of the analysis."""
        del table
        return None

    def on_time(self, now_ns: int) -> Setpoint | None:
        """Process the rig time; abort if a point takes too long."""
        if self.state is not SweepState.RUNNING:
            return None
        waited = (now_ns - self._since_ns) / NS_PER_S
        if not self._accepted and waited > self._plan.accept_limit_s:
            return self._abort(f"{self.frequency_hz:g} Hz was not accepted within {self._plan.accept_limit_s:g} s")
        if waited > self._plan.dwell_limit_s:
            return self._abort(f"no measurement at {self.frequency_hz:g} Hz within {self._plan.dwell_limit_s:g} s")
        return None

    def abort(self, reason: str) -> Setpoint | None:
        """End a running sweep, because the rig tripped or the operator requests it."""
        return self._abort(reason) if self.state is SweepState.RUNNING else None

    def _reset(self) -> None:
        self.state = SweepState.IDLE
        self.reason = ""
        self.skipped: list[float] = []
        self._at = 0
        self._start_ns = self._since_ns = 0
        self._accepted = False
        self._taken = 0
        self._failures = 0
        self._rows: list[NDArray[np.void]] = []

    def _go(self, now_ns: int) -> Setpoint:
        self._since_ns, self._accepted, self._taken, self._failures = now_ns, False, 0, 0
        return Setpoint(self.frequency_hz, self.current_a)

    def _adjusted(self, row: np.void, now_ns: int) -> Setpoint | None:
        """Return a new setpoint if this measurement is not acceptable, or None if it is."""
        del row, now_ns
        return None

    def _next(self, now_ns: int) -> Setpoint:
        before = self.frequency_hz
        self._at += 1
        if self._at == len(self._points):
            self.state = SweepState.FINISHED
            return Setpoint(before, 0.0)
        setpoint = self._go(now_ns)
        # nothing changes between up and down, so no new acceptance follows
        self._accepted = setpoint.frequency_hz == before
        return setpoint

    def _abort(self, reason: str) -> Setpoint:
        self.state, self.reason = SweepState.ABORTED, reason
        return Setpoint(self.frequency_hz, 0.0)


COLUMN: Mapping[str, str] = {
    Hold.CURRENT: "current_amplitude",
    Hold.BASE: "base_amplitude",
    Hold.SUPERIOR: "laser_amplitude",
}
"""Column of `transmissibility/table` for each quantity."""
LARGEST_STEP = 3.0  # largest factor of a single change of the current
SLOPES = (0.3, 3.0)  # range of d ln amplitude / d ln current that a correction uses


class ControlledSine(SteppedSine):
    """State machine of a stepped sweep with a held amplitude.

    Args:
        plan: plan of the points; its current is the initial value of the first one.
    """

    def __init__(self, plan: SweepPlan, hold: HoldPlan) -> None:
        self._hold = hold
        self._current_a = plan.current_a
        super().__init__(plan)

    @property
    def current_a(self) -> float:
        """Current of the present attempt."""
        return self._current_a

    @property
    def controlled(self) -> NDArray[np.void]:
        """The curve so far with target, error and corrections: rows of `blocks.SWEEP`."""
        rows = self.rows
        found = sweep_rows(rows)
        found["target"], found["corrections"] = self._hold.target, self._tries[: len(rows)]
        found["error"] = rows[COLUMN[self._hold.hold]] / self._hold.target - 1.0
        found["held"] = np.abs(found["error"]) <= self._hold.tolerance
        return found

    def sweep_from(self, first: int) -> NDArray[np.void]:
        """Return the curve from a row on: rows of `blocks.SWEEP`."""
        return self.controlled[first:]

    def _reset(self) -> None:
        super()._reset()
        self._current_a = self._plan.current_a
        self._tries: list[int] = []
        self._corrected = 0
        self._before: tuple[float, float] | None = None  # logarithms of current and amplitude at this point

    def on_measurement(self, row: np.void, now_ns: int) -> Setpoint | None:
        """Process a row of `transmissibility/table`; a row of an earlier current is ignored."""
        if self._accepted and now_ns >= self._since_ns:
            return super().on_measurement(row, now_ns)
        return None

    def _adjusted(self, row: np.void, now_ns: int) -> Setpoint | None:
        superior, reached = float(row["laser_amplitude"]), float(row[COLUMN[self._hold.hold]])
        if superior > self._hold.superior_limit_m:
            return self._abort(f"the superior base swings {superior * 1e3:.3g} mm at {self.frequency_hz:g} Hz")
        close = abs(reached / self._hold.target - 1.0) <= self._hold.tolerance
        if close or self._taken or self._corrected >= self._hold.corrections or not reached > 0.0:
            self._tries.append(self._corrected)
            return None
        wanted = self._corrected_current(reached)
        if wanted > self._hold.current_limit_a:
            limit = self._hold.current_limit_a
            return self._abort(f"{self.frequency_hz:g} Hz needs {wanted:.3g} A, more than the limit of {limit:g} A")
        self._current_a = wanted
        self._corrected += 1
        return self._go(now_ns)

    def _next(self, now_ns: int) -> Setpoint:
        self._corrected, self._before = 0, None  # also for a skipped point
        return super()._next(now_ns)

    def _corrected_current(self, reached: float) -> float:
        current, amplitude = math.log(self._current_a), math.log(reached)
        slope = 1.0
        if self._before is not None and abs(current - self._before[0]) > 1e-6:
            slope = (amplitude - self._before[1]) / (current - self._before[0])
            slope = min(max(slope, SLOPES[0]), SLOPES[1])
        self._before = current, amplitude
        step = (math.log(self._hold.target) - amplitude) / slope
        bound = math.log(LARGEST_STEP)
        return math.exp(current + min(max(step, -bound), bound))


assert set(COLUMN.values()) <= set(TRANSMISSIBILITY.names or ())
