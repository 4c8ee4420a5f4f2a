# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A phase lock as what an operator walks through: fed by blocks of scans, it looks at stretches of constant drive.

`looking.follow` does the same with a rig that lets rig time pass only when it is looked at; here time passes by itself:
a stretch begins where the rig says that a setpoint is in force, and lasts until enough consecutive scans are there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import Table
from impact_rig.operate.phase_lock import LockPlan, PhaseLock
from impact_rig.operate.phasors import PhasorMeter
from impact_rig.operate.plan import Setpoint
from impact_rig.operate.stepped_sine import SAME, State
from impact_rig.simtime import NS_PER_S


class LockedSine:
    """Seeks a resonance, tracks it, dwells there.

    Args:
        plan: of the lock.
        info: rows of `daq/info`.
        accept_limit_s: rig time within which a command must be accepted, and the next scans must come.
    """

    def __init__(self, plan: LockPlan, info: NDArray[np.void], accept_limit_s: float = 5.0) -> None:
        self._lock, self._meter = PhaseLock(plan), PhasorMeter(info)
        self._rate_hz, self._limit_s = float(info["rate"][0]), accept_limit_s
        self._wanted = Setpoint(plan.start_hz, plan.current_a)
        self._since_ns: int | None = None  # from when the setpoint is in force
        self._heard_ns = 0
        self._scans: list[NDArray[np.void]] = []
        self._end_ns = 0
        self.measured = 0
        """Looks so far."""

    @property
    def state(self) -> State:
        """Where the lock stands."""
        return self._lock.state

    @property
    def reason(self) -> str:
        """Why it was aborted, in words; empty otherwise."""
        return self._lock.reason

    @property
    def rows(self) -> NDArray[np.void]:
        """Every look so far: rows of `blocks.PHASE_LOCK`."""
        return self._lock.rows

    @property
    def newest(self) -> NDArray[np.void]:
        """The last of them, shape (1,); (0,) before the first."""
        return self._lock.newest

    def describe(self) -> str:
        """Say what it does, for people."""
        at = f"{self._lock.frequency_hz:.6g} Hz"
        return f"{self._lock.stage} at {at}" if self.state is State.RUNNING else f"finished, the resonance is at {at}"

    def figures(self) -> dict[str, float]:
        """Return how far it is, for programs."""
        phase = math.degrees(float(self.newest["phase"][0])) if self.measured else math.nan
        locked = float(self._lock.locked)
        return {"looks": self.measured, "frequency_hz": self._lock.frequency_hz, "phase_deg": phase, "locked": locked}

    def start(self, now_ns: int) -> Setpoint:
        """Begin."""
        return self._ask(self._lock.start(now_ns), now_ns)

    def on_applied(self, frequency_hz: float, current_a: float, now_ns: int) -> Setpoint | None:
        """Take an accepted change of the drive; one that is not ours ends the lock."""
        if self.state is not State.RUNNING:
            return None
        wanted = self._wanted
        if math.isclose(frequency_hz, wanted.frequency_hz, rel_tol=SAME) and math.isclose(
            current_a, wanted.current_a, rel_tol=SAME
        ):
            if self._since_ns is None:
                self._since_ns = self._heard_ns = now_ns
            return None
        if self._since_ns is not None:
            return self.abort(f"somebody else set {frequency_hz:g} Hz and {current_a:g} A")
        return None  # frequency and current come one after the other

    def on_measurement(self, row: np.void, now_ns: int) -> Setpoint | None:
        """Leave a settled measurement to others: a lock is quicker."""
        del row, now_ns
        return None

    def on_scans(self, table: Table) -> Setpoint | None:
        """Take a block of `daq/scan`; return what to set next once a stretch is whole."""
        rows, step_ns = table.rows, NS_PER_S / self._rate_hz
        if self.state is not State.RUNNING or self._since_ns is None or not len(rows):
            return None
        if self._scans and abs(table.stamp_ns - self._end_ns) > step_ns / 2.0:
            self._scans.clear()  # scans are missing: the stretch begins anew
        self._heard_ns = self._end_ns = table.stamp_ns + round(len(rows) * step_ns)
        early = max(0, math.ceil((self._since_ns - table.stamp_ns) / step_ns - 0.5))
        self._scans.append(rows[early:])
        if sum(map(len, self._scans)) < round(self._lock.look_s * self._rate_hz):
            return None
        look = self._meter.look(np.concatenate(self._scans), self._wanted.frequency_hz, self._end_ns)
        if look is None:
            return None  # a very low frequency: more scans are needed
        self._scans.clear()
        setpoint = self._lock.on_look(look)
        self.measured += 1
        if self.state is State.RUNNING and setpoint == self._wanted:
            return None
        return self._ask(setpoint, self._end_ns)

    def on_time(self, now_ns: int) -> Setpoint | None:
        """Take the rig time; ends the lock when a command is not accepted, or no scans come."""
        if self.state is not State.RUNNING or (now_ns - self._heard_ns) / NS_PER_S <= self._limit_s:
            return None
        if self._since_ns is None:
            return self.abort(f"{self._wanted.frequency_hz:g} Hz was not accepted within {self._limit_s:g} s")
        return self.abort(f"no scans came for {self._limit_s:g} s")

    def abort(self, reason: str) -> Setpoint | None:
        """End a lock under way: the rig tripped, or the operator wants it."""
        return self._lock.abort(reason) if self.state is State.RUNNING else None

    def _ask(self, setpoint: Setpoint, now_ns: int) -> Setpoint:
        self._wanted, self._since_ns, self._heard_ns = setpoint, None, now_ns
        self._scans.clear()
        return setpoint
