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
"""Stepped sine, optionally with a controlled amplitude: a state machine that decides the next setpoint of the drive.

    idle ── start ──► running ── all points measured ──► finished
                         └── time limit, other command, failed measurement, stop ──► aborted

The state machine has no access to a rig. `operator` passes events of the rig to it (accepted commands, measurements,
the time), and it returns the next setpoint. The last setpoint of a sweep, finished or aborted, always has zero current.

`ControlledSine` controls a measured amplitude: that of the current, or of the inferior or superior base. At each point
it compares the settled response with the target, corrects the current and measures again. A correction uses the slope
d ln(amplitude) / d ln(current) of the last two measurements. The first correction assumes a slope of 1, which is exact
for a linear rig.
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
    """Frequency and current that a sweep or phase lock requests for the drive."""

    frequency_hz: float
    current_a: float  # peak current [A] (m or V by `drive.kind`)


SAME = 1e-9  # relative difference up to which two frequencies or currents are equal

PASSING = frozenset({Status.COMMAND_CHANGED, Status.LABEL_CHANGED, Status.CALIBRATION_CHANGED, Status.NO_FREQUENCY})
"""Statuses of rows that do not count as failed measurements, and that a sweep ignores.

They are due to a change of command, label or calibration, or to a drive frequency that is not known yet.
"""


def sweep_rows(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Convert rows of a measurement to rows of `blocks.SWEEP`, which has the columns of a sweep's file and topic.

    Missing floating-point columns are filled with NaN. Other missing columns, and `waited`, are filled with 0 or empty
    texts.

    Args:
        rows: structured array with some of these columns, shape (n,).
    """
    found = np.zeros(len(rows), SWEEP)
    for name in set(SWEEP.names or ()) - {"waited"}:  # which cannot be NaN
        if SWEEP[name].kind == "f":
            found[name] = np.nan
    recfunctions.assign_fields_by_name(found, rows, zero_unassigned=False)
    return found


class SweepState(enum.StrEnum):
    """State of a sweep or phase lock: finished means complete; aborted means ended early, with a reason."""

    IDLE = "idle"
    RUNNING = "running"
    FINISHED = "finished"
    ABORTED = "aborted"


class SteppedSine:
    """State machine of a stepped sine: one frequency after the other at a constant commanded current.

    Each `on_…` method processes one kind of event of the rig and returns the next setpoint of the drive, or None if
    the drive stays as it is. Times are rig times [ns].

    Args:
        plan: points and limits of the sweep.

    Attributes:
        state: state of the sweep.
        reason: reason why the sweep was aborted; empty otherwise.
        skipped: frequencies that were skipped because a sensor was over range [Hz].
    """

    def __init__(self, plan: SweepPlan) -> None:
        self._plan = plan
        self._points = plan.points()
        self._accepted = False
        self._reset()

    @property
    def rows(self) -> NDArray[np.void]:
        """Accepted measurements so far: rows of `transmissibility/table` in the order of measurement.

        The column `time` is the rig time since the start of the sweep [s].
        """
        return np.concatenate(self._rows) if self._rows else np.zeros(0, dtype=TRANSMISSIBILITY)

    def sweep_from(self, first: int) -> NDArray[np.void]:
        """Return the accepted measurements from index `first` on, as rows of `blocks.SWEEP`."""
        return sweep_rows(self.rows[first:])

    @property
    def measured(self) -> int:
        """Number of accepted measurements so far, of which a point may have several (`measurements_per_point`)."""
        return len(self._rows)

    @property
    def progress(self) -> tuple[int, int]:
        """Number of completed points (measured or skipped), and number of all points of the sweep."""
        return self._at, len(self._points)

    def describe(self) -> str:
        """Return the progress of the sweep as text for the user, such as "point 3 of 10: 8.5 Hz".

        If the sweep is idle or aborted, the text is only "idle" or "aborted", without the `reason`.
        """
        done, count = self.progress
        running = f"point {done + 1} of {count}: {self.frequency_hz:g} Hz"
        texts = {SweepState.RUNNING: running, SweepState.FINISHED: f"finished, {count} points"}
        return texts.get(self.state, str(self.state))

    def figures(self) -> dict[str, object]:
        """Return points done, all points, present frequency and skipped frequencies [Hz] by key, for diagnostics."""
        done, count = self.progress
        return {"points_done": done, "points": count, "frequency_hz": self.frequency_hz, "skipped": self.skipped}

    @property
    def frequency_hz(self) -> float:
        """Frequency of the present point, or of the last point if the sweep has finished."""
        return self._points[min(self._at, len(self._points) - 1)]

    @property
    def current_a(self) -> float:
        """Peak current of the plan for all points [A] (m or V by `drive.kind`), also while no sweep runs."""
        return self._plan.current_a

    def start(self, now_ns: int) -> Setpoint:
        """Start the sweep at its first point, and return the setpoint of this point.

        Measurements of an earlier start are discarded. `now_ns` is the present rig time [ns].
        """
        self._reset()
        self._start_ns = now_ns
        self.state = SweepState.RUNNING
        return self._go(now_ns)

    def on_applied(self, frequency_hz: float, current_a: float, now_ns: int) -> Setpoint | None:
        """Process a change of the drive that the rig has accepted at rig time `now_ns` [ns].

        The wait for a measurement begins once the rig has accepted the requested setpoint. A different setpoint after
        that aborts the sweep, because another client must have commanded it. A different setpoint before that is
        ignored. Returns the setpoint with zero current after an abort, else None.
        """
        if self.state is not SweepState.RUNNING:
            return None
        ours = math.isclose(frequency_hz, self.frequency_hz, rel_tol=SAME)
        full = math.isclose(current_a, self.current_a, rel_tol=SAME)
        if ours and full:
            if not self._accepted:
                self._accepted, self._since_ns = True, now_ns
            return None
        if self._accepted:
            return self._abort(
                f"another client set {frequency_hz:g} Hz and the amplitude {current_a:g}; only one client may command "
                "the drive"
            )
        return None  # frequency and current are applied one after the other

    def on_measurement(self, row: np.void, now_ns: int) -> Setpoint | None:
        """Process a row of `transmissibility/table`, and return the setpoint to command now, or None.

        The setpoint is that of the next point if the present point is complete. It has zero current if the sweep has
        finished or is aborted. None means that the present point continues.

        A settled measurement is accepted. A measurement with the status `not_settled` is accepted if the plan has
        `keep_unsettled`. Rows at another frequency, and rows that only report a change (`PASSING`), are ignored. All
        other rows are failed measurements. More than the plan's `retries` of them at a point abort the sweep. A point
        at which a sensor is over range is skipped instead if the plan has `skip_over_range`.
        """
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
        return self._abort(
            f"the measurement at {self.frequency_hz:g} Hz failed {self._failures} times, more than retries allows "
            f"({self._plan.retries}), the last one with status {status.value}: {status.doc}"
        )

    def on_scans(self, table: Table) -> Setpoint | None:
        """Ignore scans, and return None: a sweep uses the measurements of the analysis."""
        del table
        return None

    def on_time(self, now_ns: int) -> Setpoint | None:
        """Abort the sweep if a command was not accepted, or a point was not measured, in time.

        `now_ns` is the present rig time [ns]. The limits are `accept_limit_s` and `dwell_limit_s` of the plan. Returns
        the setpoint with zero current after an abort, else None.
        """
        if self.state is not SweepState.RUNNING:
            return None
        waited = (now_ns - self._since_ns) / NS_PER_S
        if not self._accepted and waited > self._plan.accept_limit_s:
            return self._abort(
                f"the rig did not accept {self.frequency_hz:g} Hz and the amplitude {self.current_a:g} within "
                f"{self._plan.accept_limit_s:g} s of rig time (accept_limit_s)"
            )
        if waited > self._plan.dwell_limit_s:
            return self._abort(
                f"{self.frequency_hz:g} Hz was not measured within {self._plan.dwell_limit_s:g} s of rig time "
                "(dwell_limit_s); raise this limit if the response needs longer to settle"
            )
        return None

    def abort(self, reason: str) -> Setpoint | None:
        """End a running sweep as aborted because of an event outside of it, such as a trip of the rig.

        Returns the setpoint with zero current, or None if the sweep is not running.

        Args:
            reason: reason for the user, which becomes `reason`.
        """
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
        """Return a corrected setpoint if a measured response is too far from its target, or None to accept it.

        A stepped sine without control accepts every response. An override may also abort the sweep and return zero
        current.
        """
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
"""Column of `transmissibility/table` that contains each quantity that can be controlled."""
LARGEST_STEP = 3.0  # largest factor by which one correction changes the current, either way
SLOPES = (0.3, 3.0)  # range of d ln amplitude / d ln current that a correction uses


class ControlledSine(SteppedSine):
    """State machine of a stepped sine whose current is corrected until a measured amplitude is near its target.

    The amplitude at a point is accepted within the tolerance of `hold`, or after the maximum number of corrections. An
    amplitude of 0 or NaN is accepted as well, since it cannot be corrected. The column `held` of `controlled` says
    which measurements are within the tolerance. The sweep is aborted if the next current or the measured superior base
    exceeds its limit in `hold`.

    Args:
        plan: points and limits of the sweep. Its current is the initial value at the first point. Each later point
            begins with the last current of the point before.
        hold: controlled quantity, its target and limits.
    """

    def __init__(self, plan: SweepPlan, hold: HoldPlan) -> None:
        self._hold = hold
        self._current_a = plan.current_a
        super().__init__(plan)

    @property
    def current_a(self) -> float:
        """Commanded peak current [A] (m or V by `drive.kind`) at the present point, after its corrections so far.

        Before the start it is the current of the plan.
        """
        return self._current_a

    @property
    def controlled(self) -> NDArray[np.void]:
        """Accepted measurements so far as rows of `blocks.SWEEP`, with the columns of the control.

        These are the target, the error of the amplitude (measured / target − 1), whether it is within the tolerance
        (`held`), and the number of corrections of the current at the point.
        """
        rows = self.rows
        found = sweep_rows(rows)
        found["target"], found["corrections"] = self._hold.target, self._tries[: len(rows)]
        found["error"] = rows[COLUMN[self._hold.hold]] / self._hold.target - 1.0
        found["held"] = np.abs(found["error"]) <= self._hold.tolerance
        return found

    def sweep_from(self, first: int) -> NDArray[np.void]:
        """Return the accepted measurements from index `first` on, as rows of `blocks.SWEEP`."""
        return self.controlled[first:]

    def _reset(self) -> None:
        super()._reset()
        self._current_a = self._plan.current_a
        self._tries: list[int] = []
        self._corrected = 0
        self._before: tuple[float, float] | None = None  # logarithms of current and amplitude at this point

    def on_measurement(self, row: np.void, now_ns: int) -> Setpoint | None:
        """Process a row of `transmissibility/table` like `SteppedSine.on_measurement`.

        Rows from before the rig accepted the present command are ignored, because they belong to an earlier current.
        `now_ns` is the rig time of the row [ns].
        """
        if self._accepted and now_ns >= self._since_ns:
            return super().on_measurement(row, now_ns)
        return None

    def _adjusted(self, row: np.void, now_ns: int) -> Setpoint | None:
        superior, reached = float(row["laser_amplitude"]), float(row[COLUMN[self._hold.hold]])
        if superior > self._hold.superior_limit_m:
            return self._abort(
                f"the superior base swings {superior * 1e3:.3g} mm at {self.frequency_hz:g} Hz, more than the limit of "
                f"{self._hold.superior_limit_m * 1e3:g} mm (superior_limit_m); lower the target or raise the limit"
            )
        close = abs(reached / self._hold.target - 1.0) <= self._hold.tolerance
        if close or self._taken or self._corrected >= self._hold.corrections or not reached > 0.0:
            self._tries.append(self._corrected)
            return None
        wanted = self._corrected_current(reached)
        if wanted > self._hold.current_limit_a:
            limit = self._hold.current_limit_a
            return self._abort(
                f"the target amplitude at {self.frequency_hz:g} Hz needs {wanted:.3g} A peak, more than the limit of "
                f"{limit:g} A (current_limit_a); lower the target or raise the limit"
            )
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
