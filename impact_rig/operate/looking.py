# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The loop of a phase lock: set, let a stretch of scans pass, look, set again; and the backbone, a ladder of them.

`LoopApparatus` is what it is done with: a rig in this process, or one behind topics that is stepped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.spread import student_factor, variance_of_mean
from impact_rig.operate.phase_lock import LockPlan, Look, PhaseLock
from impact_rig.operate.stepped_sine import Setpoint, State
from impact_rig.simtime import NS_PER_S

FEWEST = 6  # looks from which their scatter says something
NEVER_S = 1e9  # rig time that no test takes


class LoopApparatus(Protocol):
    """A rig that lets rig time pass only when it is looked at."""

    def now_ns(self) -> int:
        """Return the rig time."""

    def set(self, setpoint: Setpoint) -> None:
        """Command frequency, then current."""

    def look(self, seconds: float) -> Look | str:
        """Let so much rig time pass and return what the rig did in it, or why it goes on no more."""


def follow(lock: PhaseLock, apparatus: LoopApparatus, until: Callable[[PhaseLock], bool]) -> None:
    """Go on with a lock until it ends, or until a condition holds; it must have been started."""
    while lock.state is State.RUNNING and not until(lock):
        now = apparatus.look(lock.look_s)
        setpoint = lock.abort(now) if isinstance(now, str) else lock.on_look(now)
        apparatus.set(setpoint)


def lock_on(plan: LockPlan, apparatus: LoopApparatus) -> PhaseLock:
    """Search, track and dwell; return the lock as it ended."""
    lock = PhaseLock(plan)
    apparatus.set(lock.start(apparatus.now_ns()))
    follow(lock, apparatus, lambda _: False)
    return lock


class Mean(NamedTuple):
    """A locked stretch: means with standard uncertainties."""

    frequency_hz: float  # of the resonance
    u_frequency_hz: float
    """By the scatter of the looks, correlation included, and by the mean phase's distance from −90°."""
    dt: float  # |X_1| / |X_b|
    u_dt: float  # by the scatter of the looks and by the sensitivities, which are common to all that a rig measures


def mean(rows: NDArray[np.void], u_gain: float) -> Mean:
    """Return the means of looks (`PHASE_LOCK`), shape (n,); uncertainties are NaN for fewer than `FEWEST`.

    Against the base the resonance lies (f/2) Re(X_b/X_1) above the frequency of a look, whatever the damping; where the
    mean phase is not −90°, that much is uncertain.
    """
    frequency = float(np.mean(rows["frequency"]))
    dt = float(np.mean(rows["laser_amplitude"]) / np.mean(rows["base_amplitude"]))
    if len(rows) < FEWEST:
        return Mean(frequency, math.nan, dt, math.nan)
    widened = student_factor(len(rows))
    left = 0.5 * frequency * float(np.mean(np.cos(rows["phase"]) / rows["transmissibility"]))
    u_frequency = math.sqrt(variance_of_mean(rows["frequency"].astype(float)) * widened)
    u_dt = math.sqrt(variance_of_mean(rows["transmissibility"].astype(float)) * widened)
    return Mean(frequency, math.hypot(u_frequency, left), dt, math.hypot(u_dt, dt * u_gain))


@attrs.frozen(kw_only=True)
class Ladder:
    """A backbone: the locked loop over currents, visited up, then down."""

    currents_a: tuple[float, ...]  # ascending
    lock: LockPlan  # of the loop; its current and dwell are not used, and its bound of lost locks is that of each rung
    wait_s: float = 8.0
    """Rig time on each rung, locked or given up, before it is measured; bounds what a transient leaves."""
    mean_s: float = 6.0  # rig time over which a rung is averaged
    jump: float = 0.25  # relative change of DT from one rung to the next that is told as a jump, not joined by a line


@attrs.frozen(kw_only=True)
class Rung:
    """One amplitude of a backbone."""

    direction: str  # up or down
    current_a: float  # commanded
    frequency_hz: float  # mean; u_frequency_hz: its standard uncertainty, see `Mean`
    u_frequency_hz: float
    dt: float  # ratio of the mean amplitudes; u_dt likewise
    u_dt: float
    spread: float  # relative standard deviation of DT from look to look
    superior_m: float  # mean amplitude
    base_m: float  # mean amplitude
    phase_deg: float  # mean
    locked: bool  # whether the phase was held in every look; where not, the numbers are means of a motion that wanders
    jumped: bool  # the response is another one than on the rung before: DT jumped, or the lock came or went


def climb(ladder: Ladder, apparatus: LoopApparatus) -> tuple[list[Rung], str]:
    """Follow the backbone up and down; return its rungs, and why it ended early ("" if it did not)."""
    currents, bound = ladder.currents_a, ladder.lock
    lock = PhaseLock(attrs.evolve(bound, current_a=currents[0], dwell_s=NEVER_S, lose_limit_s=NEVER_S))
    apparatus.set(lock.start(apparatus.now_ns()))
    rungs: list[Rung] = []
    steps = [("up", current) for current in currents] + [("down", current) for current in currents[-2::-1]]
    for number, (direction, current) in enumerate(steps):
        if number:
            apparatus.set(lock.set_current(current, apparatus.now_ns()))
        limit_s = bound.lose_limit_s if number else bound.seek_limit_s
        _pass(lock, apparatus, limit_s, lambda one: one.locked)
        _pass(lock, apparatus, ladder.wait_s)
        first = len(lock.rows)
        _pass(lock, apparatus, ladder.mean_s)
        if lock.state is not State.RUNNING:
            return rungs, lock.reason
        rungs.append(_rung(direction, current, lock.rows[first:], lock.u_gain, rungs[-1:], ladder.jump))
    lock.abort("done")
    apparatus.set(Setpoint(lock.frequency_hz, 0.0))
    return rungs, ""


def _pass(
    lock: PhaseLock, apparatus: LoopApparatus, seconds: float, until: Callable[[PhaseLock], bool] = lambda _: False
) -> None:
    """Follow a lock for so much rig time, or until a condition holds."""
    end_ns = apparatus.now_ns() + round(seconds * NS_PER_S)
    follow(lock, apparatus, lambda one: until(one) or apparatus.now_ns() >= end_ns)


def _rung(
    direction: str, current: float, rows: NDArray[np.void], u_gain: float, before: Sequence[Rung], jump: float
) -> Rung:
    ratio = np.mean(rows["transmissibility"] * np.exp(1j * rows["phase"]))
    means = mean(rows, u_gain)
    dt = means.dt
    locked = bool(np.all(rows["locked"] == 1.0))
    jumped = any(abs(math.log(dt / one.dt)) > math.log1p(jump) or one.locked != locked for one in before)
    return Rung(
        direction=direction,
        current_a=current,
        frequency_hz=means.frequency_hz,
        u_frequency_hz=means.u_frequency_hz,
        dt=dt,
        u_dt=means.u_dt,
        spread=float(np.std(rows["transmissibility"]) / dt),
        superior_m=float(np.mean(rows["laser_amplitude"])),
        base_m=float(np.mean(rows["base_amplitude"])),
        phase_deg=math.degrees(float(np.angle(ratio))),
        locked=locked,
        jumped=jumped,
    )
