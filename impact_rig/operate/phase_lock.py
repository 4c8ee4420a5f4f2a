# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Resonance search, track and dwell: which setpoint comes next, as a pure state machine.

    idle ── start ──► seeking ── phase crosses −90° ──► tracking ⇄ locked ── dwelt ──► finished
                         └──────────────── rule broken ─────────────┴───────────────► aborted

Seeking steps the frequency coarsely towards the side that the phase says, until it has crossed. Tracking turns the
frequency by the detuning that each look shows, a part at a time, for ever: an integral controller. Against the base
the detuning is known, whatever the damping: 1/T = 1 − r² + 2iζr, so it is f/2 Re(X_b/X_1). Against the current it is
tan φ' (φ' = phase + 90°) times the resonance's own slope, which the search has shown and which is corrected under way:
where the detuning changes sign from look to look it was taken for too large, where it keeps its sign for too small.
"""

from __future__ import annotations

import cmath
import enum
import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import PHASE_LOCK
from impact_rig.errors import ConfigError
from impact_rig.operate.phasors import Look
from impact_rig.operate.plan import Setpoint
from impact_rig.operate.stepped_sine import State
from impact_rig.simtime import NS_PER_S

STEEPEST = 4.0
"""tan φ' that is believed: beyond, the phase says only on which side the resonance is."""
MEAN_S = 1.0
"""The phase that counts is a mean over so long."""
SMALLER, LARGER = 0.6, 1.25
"""Factors of the slope when the detuning overshoots, and when it stays."""
SLUGGISH = 4
"""Looks with a detuning of one sign, none of them within the bound, after which the slope counts as too small."""
DIGITS = 6  # of a commanded frequency [Hz]


class Reference(enum.StrEnum):
    """What the superior base's phase is measured against."""

    BASE = "base"
    CURRENT = "current"


def _positive(_: object, attribute: attrs.Attribute[float], value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise ConfigError(f"{attribute.name} must be > 0 and finite, got {value!r}")


def _amount(default: float) -> float:
    value: float = attrs.field(default=default, validator=_positive)
    return value


@attrs.frozen(kw_only=True)
class LockPlan:
    """A search, and what follows it.

    Attributes:
        start_hz: where the search begins.
        current_a: peak current.
        low_hz: the frequency goes no lower.
        high_hz: nor higher.
        reference: of the phase; against the base, −90° is where the structure on a fixed base would resonate.
        step_hz: of the coarse search.
        seek_s: each of them is held so long.
        look_s: when tracking, the frequency is held so long between two corrections.
        time_constant_s: in which a detuning is corrected; longer than the structure's answer takes.
        within_deg: bound of the mean phase of a second that counts as locked.
        seek_limit_s: rig time until the first lock after which it is given up.
        lose_limit_s: rig time without lock after which it is given up.
        dwell_s: rig time to stay, counted from the first lock.
        superior_limit_m: a superior base beyond it aborts.

    Raises:
        ConfigError: a value that cannot work; the message names it.
    """

    start_hz: float = attrs.field(validator=_positive)
    current_a: float = attrs.field(validator=_positive)
    low_hz: float = _amount(5.0)
    high_hz: float = _amount(20.0)
    reference: Reference = attrs.field(default=Reference.BASE, converter=Reference)
    step_hz: float = _amount(0.2)
    seek_s: float = _amount(1.5)
    look_s: float = _amount(0.5)
    time_constant_s: float = _amount(3.0)
    within_deg: float = _amount(2.0)
    seek_limit_s: float = _amount(60.0)
    lose_limit_s: float = _amount(20.0)
    dwell_s: float = _amount(30.0)
    superior_limit_m: float = _amount(0.05)

    def __attrs_post_init__(self) -> None:
        if not self.low_hz < self.start_hz < self.high_hz:
            raise ConfigError(
                f"start_hz must be within low_hz = {self.low_hz:g} and high_hz = {self.high_hz:g}, "
                f"got {self.start_hz:g}"
            )


class Stage(enum.StrEnum):
    """What a running lock does."""

    SEEKING = "seeking"
    TRACKING = "tracking"
    LOCKED = "locked"


class PhaseLock:
    """Seeks a resonance, tracks it, dwells there.

    Attributes:
        state: running, finished, aborted.
        stage: of a running one.
        reason: why it was aborted, in words; empty otherwise.
        frequency_hz: commanded.
        current_a: commanded.
        locked_ns: rig time of the first lock, or None.
    """

    def __init__(self, plan: LockPlan) -> None:
        self._plan = plan
        self.state, self.stage, self.reason = State.IDLE, Stage.SEEKING, ""
        self.frequency_hz, self.current_a = plan.start_hz, plan.current_a
        self.locked_ns: int | None = None
        self.u_gain = 0.0
        self._began_ns = self._held_ns = 0
        self._rows: list[tuple[float, ...]] = []
        self._slope = 0.0  # Hz per tan φ'
        self._before: tuple[float, float] | None = None
        self._looks: list[tuple[int, complex]] = []
        self._signs = 0  # looks in a row with a detuning of one sign, negative for a negative one

    @property
    def look_s(self) -> float:
        """How long the next look is to be [s]."""
        return self._plan.seek_s if self.stage is Stage.SEEKING else self._plan.look_s

    @property
    def rows(self) -> NDArray[np.void]:
        """Every look so far: rows of `blocks.PHASE_LOCK`, `time` from the start."""
        return np.array(self._rows, PHASE_LOCK)

    @property
    def newest(self) -> NDArray[np.void]:
        """The last look, shape (1,); (0,) before the first."""
        return np.array(self._rows[-1:], PHASE_LOCK)

    @property
    def locked(self) -> bool:
        """Whether the phase is held now."""
        return self.state is State.RUNNING and self.stage is Stage.LOCKED

    def start(self, now_ns: int) -> Setpoint:
        """Begin."""
        self._began_ns = self._held_ns = now_ns
        self.state = State.RUNNING
        return self._setpoint()

    def set_current(self, current_a: float, now_ns: int) -> Setpoint:
        """Go on with another current; what was locked must lock again within the limit."""
        self.current_a = current_a
        self.unlock(now_ns)
        return self._setpoint()

    def unlock(self, now_ns: int) -> None:
        """Forget the lock: something was changed, the phase must be found again."""
        if self.stage is Stage.LOCKED:
            self.stage = Stage.TRACKING
        self._held_ns = now_ns
        self._looks.clear()

    def on_look(self, look: Look) -> Setpoint:
        """Take what the rig does; return what to set next, the same as before where nothing is to change."""
        if self.state is not State.RUNNING:
            return self._setpoint()
        if not look.sound:
            return self.abort("base or current do not move")
        if abs(look.superior) > self._plan.superior_limit_m:
            return self.abort(f"the superior base swings {abs(look.superior) * 1e3:.3g} mm")
        turned = look.superior / (look.base if self._plan.reference is Reference.BASE else look.current)
        if self.stage is Stage.SEEKING:
            self._seek(turned)
        else:
            self._track(look.end_ns, turned)
        self.u_gain = look.u_gain
        self._note(look, turned)
        self._watch(look.end_ns)
        return self._setpoint()

    def abort(self, reason: str) -> Setpoint:
        """End: the rig tripped, or the operator wants it."""
        if self.state is State.RUNNING:
            self.state, self.reason = State.ABORTED, reason
        return self._setpoint()

    def _setpoint(self) -> Setpoint:
        return Setpoint(self.frequency_hz, self.current_a if self.state is State.RUNNING else 0.0)

    def _seek(self, turned: complex) -> None:
        detuned = _detuning(turned)  # > 0: the resonance is above
        if self._before is not None and (self._before[1] > 0.0) != (detuned > 0.0):
            other, was = self._before
            self._slope = (self.frequency_hz - other) / (was - detuned)
            self.stage = Stage.TRACKING
            self._turn_to(self.frequency_hz + self._slope * detuned)
            return
        self._before = self.frequency_hz, detuned
        self._turn_to(self.frequency_hz + math.copysign(self._plan.step_hz, detuned))

    def _track(self, now_ns: int, turned: complex) -> None:
        share = min(1.0, self._plan.look_s / self._plan.time_constant_s)
        self._turn_to(self.frequency_hz + share * self._detuning_hz(turned))
        self._looks.append((now_ns, turned / abs(turned)))
        first = now_ns - round(MEAN_S * NS_PER_S)
        self._looks = [one for one in self._looks if one[0] > first]
        whole = len(self._looks) * self._plan.look_s >= MEAN_S * 0.999
        mean = sum(one for _, one in self._looks)
        if whole and abs(math.degrees(_turn_from_quarter(mean))) <= self._plan.within_deg:
            self.stage, self._held_ns = Stage.LOCKED, now_ns
            if self.locked_ns is None:
                self.locked_ns = now_ns
        elif whole:
            self.stage = Stage.TRACKING

    def _detuning_hz(self, turned: complex) -> float:
        """Return how far above the present frequency the resonance is, at most a step of the search."""
        if self._plan.reference is Reference.BASE:
            detuning = 0.5 * self.frequency_hz * (1.0 / turned).real
        else:
            detuned = _detuning(turned)
            if abs(detuned) > math.tan(math.radians(self._plan.within_deg)):
                self._adapt(detuned)
            detuning = self._slope * detuned
        return min(max(detuning, -self._plan.step_hz), self._plan.step_hz)

    def _adapt(self, detuned: float) -> None:
        """Correct the slope by what the detunings' signs say of it."""
        if self._signs * detuned < 0.0:
            self._slope *= SMALLER
            self._signs = 0
        self._signs += 1 if detuned > 0.0 else -1
        if abs(self._signs) >= SLUGGISH:
            self._slope *= LARGER
            self._signs = 0

    def _turn_to(self, frequency_hz: float) -> None:
        self.frequency_hz = round(min(max(frequency_hz, self._plan.low_hz), self._plan.high_hz), DIGITS)

    def _note(self, look: Look, turned: complex) -> None:
        time_s = (look.end_ns - self._began_ns) / NS_PER_S
        self._rows.append((
            time_s, look.frequency_hz, cmath.phase(turned), look.dt, abs(look.superior), abs(look.base),
            abs(look.current), float(self.stage is Stage.LOCKED),
        ))  # fmt: skip

    def _watch(self, now_ns: int) -> None:
        plan, waited = self._plan, (now_ns - self._held_ns) / NS_PER_S
        if self.locked_ns is None:
            if waited > plan.seek_limit_s:
                self.abort(f"no resonance was found from {plan.start_hz:g} Hz within {plan.seek_limit_s:g} s")
        elif waited > plan.lose_limit_s:
            self.abort(f"the phase was not held for {plan.lose_limit_s:g} s")
        elif now_ns - self.locked_ns >= plan.dwell_s * NS_PER_S and self.stage is Stage.LOCKED:
            self.state = State.FINISHED


def _turn_from_quarter(turned: complex) -> float:
    """Return φ' = phase + 90°, in (−π, π]."""
    return cmath.phase(turned * 1j)


def _detuning(turned: complex) -> float:
    """Return tan φ', bounded: what a resonance is detuned, in units of its slope."""
    angle = _turn_from_quarter(turned)
    if abs(angle) >= math.atan(STEEPEST):
        return math.copysign(STEEPEST, angle)
    return math.tan(angle)
