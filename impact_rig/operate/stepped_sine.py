# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Stepped sine: which setpoint comes next, as a pure state machine; `operator` asks it and does what it says.

    idle ── start ──► running ── all points measured ──► finished
                         └────── rule broken ──────────► aborted

It sees what an operator sees — accepted commands, measurements, the time — and answers with the next setpoint.
The last one of a sweep, finished or aborted, always sets the current to zero.
"""

from __future__ import annotations

import enum
import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.words import Status
from impact_rig.blocks import TRANSMISSIBILITY, Table
from impact_rig.operate.plan import Plan, Setpoint
from impact_rig.simtime import NS_PER_S

SAME = 1e-9
"""Relative difference up to which two frequencies or currents are one."""

PASSING = frozenset({Status.COMMAND_CHANGED, Status.LABEL_CHANGED, Status.CALIBRATION_CHANGED, Status.NO_FREQUENCY})
"""Words that only say that a change came through."""


class State(enum.StrEnum):
    """Where a sweep stands."""

    IDLE = "idle"
    RUNNING = "running"
    FINISHED = "finished"
    ABORTED = "aborted"


class SteppedSine:
    """Walks through a plan.

    Attributes:
        state: where the sweep stands.
        reason: why it was aborted, in words; empty otherwise.
        skipped: frequencies left out [Hz].
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._points = plan.points()
        self._accepted = False
        self._reset()

    @property
    def rows(self) -> NDArray[np.void]:
        """The curve so far: rows of `transmissibility/table` in the order of the visit, `time` from the start."""
        return np.concatenate(self._rows) if self._rows else np.zeros(0, dtype=TRANSMISSIBILITY)

    @property
    def measured(self) -> int:
        """How many rows the curve has so far."""
        return len(self._rows)

    @property
    def progress(self) -> tuple[int, int]:
        """Points done and points in all."""
        return self._at, len(self._points)

    def describe(self) -> str:
        """Say what it does, for people."""
        done, count = self.progress
        running = f"point {done + 1} of {count}: {self.frequency_hz:g} Hz"
        return running if self.state is State.RUNNING else f"finished, {count} points"

    def figures(self) -> dict[str, object]:
        """Return how far it is, for programs."""
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
        """Begin, or begin again from the first point.

        Args:
            now_ns: rig time.
        """
        self._reset()
        self._start_ns = now_ns
        self.state = State.RUNNING
        return self._go(now_ns)

    def on_applied(self, frequency_hz: float, current_a: float, now_ns: int) -> Setpoint | None:
        """Take an accepted change of the drive; one that is not ours aborts the sweep."""
        if self.state is not State.RUNNING:
            return None
        ours = math.isclose(frequency_hz, self.frequency_hz, rel_tol=SAME)
        full = math.isclose(current_a, self.current_a, rel_tol=SAME)
        if ours and full:
            if not self._accepted:
                self._accepted, self._since_ns = True, now_ns
            return None
        if self._accepted:
            return self._abort(f"somebody else set {frequency_hz:g} Hz and {current_a:g} A")
        return None  # frequency and current come one after the other

    def on_measurement(self, row: np.void, now_ns: int) -> Setpoint | None:
        """Take a row of `transmissibility/table`; rows of other frequencies are ignored."""
        if self.state is not State.RUNNING or not math.isclose(
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
        """Leave scans to the analysis: a sweep goes by what it measures."""
        del table
        return None

    def on_time(self, now_ns: int) -> Setpoint | None:
        """Take the rig time; aborts when a point takes too long."""
        if self.state is not State.RUNNING:
            return None
        waited = (now_ns - self._since_ns) / NS_PER_S
        if not self._accepted and waited > self._plan.accept_limit_s:
            return self._abort(f"{self.frequency_hz:g} Hz was not accepted within {self._plan.accept_limit_s:g} s")
        if waited > self._plan.dwell_limit_s:
            return self._abort(f"no measurement at {self.frequency_hz:g} Hz within {self._plan.dwell_limit_s:g} s")
        return None

    def abort(self, reason: str) -> Setpoint | None:
        """End a sweep under way: the rig tripped, or the operator wants it."""
        return self._abort(reason) if self.state is State.RUNNING else None

    def _reset(self) -> None:
        self.state = State.IDLE
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
        """Return with what to try again because this measurement is not what is wanted; None: it is."""
        del row, now_ns
        return None

    def _next(self, now_ns: int) -> Setpoint:
        before = self.frequency_hz
        self._at += 1
        if self._at == len(self._points):
            self.state = State.FINISHED
            return Setpoint(before, 0.0)
        setpoint = self._go(now_ns)
        # between up and down nothing changes, so nothing is accepted anew
        self._accepted = setpoint.frequency_hz == before
        return setpoint

    def _abort(self, reason: str) -> Setpoint:
        self.state, self.reason = State.ABORTED, reason
        return Setpoint(self.frequency_hz, 0.0)
