"""Stepped sine: which command comes next, as a pure state machine that a node or an offline campaign drives.

    idle ── start ──► running ── all points measured ──► finished
                         └────── rule broken ──────────► aborted

It sees what an operator sees — accepted commands, measurements, the time — and answers with the next command.
The last command of a sweep, finished or aborted, always sets the current to zero.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.words import Status
from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.errors import ConfigError
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


class Direction(enum.StrEnum):
    """Order in which the frequencies are visited; up_down keeps the state of the rig at the turn."""

    UP = "up"
    DOWN = "down"
    UP_DOWN = "up_down"


@attrs.frozen
class Command:
    """What to set: frequency [Hz] and peak current [A]."""

    frequency_hz: float
    current_a: float


def _positive(_: object, attribute: attrs.Attribute[float], value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise ConfigError(f"{attribute.name} must be > 0 and finite, got {value!r}")


def _frequencies(_: object, attribute: attrs.Attribute[tuple[float, ...]], value: tuple[float, ...]) -> None:
    if not value or not all(math.isfinite(one) and one > 0.0 for one in value):
        raise ConfigError(f"{attribute.name} must be one or more finite numbers > 0, got {value!r}")
    if len(set(value)) != len(value):
        raise ConfigError(f"{attribute.name} must not repeat a frequency, got {value!r}")


def _at_least(lowest: int) -> Callable[[object, attrs.Attribute[int], int], None]:
    def check(_: object, attribute: attrs.Attribute[int], value: int) -> None:
        if value < lowest:
            raise ConfigError(f"{attribute.name} must be >= {lowest}, got {value!r}")

    return check


@attrs.frozen(kw_only=True)
class Plan:
    """A stepped sweep.

    Attributes:
        frequencies_hz: the points; visited in ascending or descending order, whatever their order here.
        current_a: peak current at all of them.
        direction: order of the visit.
        measurements_per_point: rows taken at each point.
        dwell_limit_s: rig time at one point after which the sweep is aborted; longer than the tracker's own bound.
        accept_limit_s: rig time within which a command must be accepted.
        retries: refused measurements (lost blocks, silence, …) borne per point.
        skip_over_range: leave out a point where a sensor goes over range, instead of aborting.
        keep_unsettled: take a row of a point whose response did not settle in the tracker's bound (its `settled` is 0).

    Raises:
        ConfigError: a value that cannot work; the message names it.
    """

    frequencies_hz: tuple[float, ...] = attrs.field(converter=tuple, validator=_frequencies)
    current_a: float = attrs.field(validator=_positive)
    direction: Direction = attrs.field(default=Direction.UP, converter=Direction)
    measurements_per_point: int = attrs.field(default=1, validator=_at_least(1))
    dwell_limit_s: float = attrs.field(default=150.0, validator=_positive)
    accept_limit_s: float = attrs.field(default=5.0, validator=_positive)
    retries: int = attrs.field(default=2, validator=_at_least(0))
    skip_over_range: bool = True
    keep_unsettled: bool = True

    def points(self) -> tuple[float, ...]:
        """Return the frequencies in the order of the visit."""
        up = tuple(sorted(self.frequencies_hz))
        down = up[::-1]
        return {Direction.UP: up, Direction.DOWN: down, Direction.UP_DOWN: up + down}[self.direction]


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
    def progress(self) -> tuple[int, int]:
        """Points done and points in all."""
        return self._at, len(self._points)

    @property
    def frequency_hz(self) -> float:
        """Frequency of the present point, or of the last one."""
        return self._points[min(self._at, len(self._points) - 1)]

    def start(self, now_ns: int) -> Command:
        """Begin, or begin again from the first point.

        Args:
            now_ns: rig time.
        """
        self._reset()
        self._start_ns = now_ns
        self.state = State.RUNNING
        return self._go(now_ns)

    def on_applied(self, frequency_hz: float, current_a: float, now_ns: int) -> Command | None:
        """Take an accepted change of the drive; one that is not ours aborts the sweep."""
        if self.state is not State.RUNNING:
            return None
        ours = math.isclose(frequency_hz, self.frequency_hz, rel_tol=SAME)
        full = math.isclose(current_a, self._plan.current_a, rel_tol=SAME)
        if ours and full:
            if not self._accepted:
                self._accepted, self._since_ns = True, now_ns
            return None
        if self._accepted:
            return self._abort(f"somebody else set {frequency_hz:g} Hz and {current_a:g} A")
        return None  # frequency and current come one after the other

    def on_measurement(self, row: np.void, now_ns: int) -> Command | None:
        """Take a row of `transmissibility/table`; rows of other frequencies are ignored."""
        if self.state is not State.RUNNING or not math.isclose(
            float(row["frequency"]), self.frequency_hz, rel_tol=SAME
        ):
            return None
        status = Status(bytes(row["status"]).decode())
        settled = bool(row["settled"] == 1.0)
        if settled or (status is Status.NOT_SETTLED and self._plan.keep_unsettled):
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

    def on_time(self, now_ns: int) -> Command | None:
        """Take the rig time; aborts when a point takes too long."""
        if self.state is not State.RUNNING:
            return None
        waited = (now_ns - self._since_ns) / NS_PER_S
        if not self._accepted and waited > self._plan.accept_limit_s:
            return self._abort(f"{self.frequency_hz:g} Hz was not accepted within {self._plan.accept_limit_s:g} s")
        if waited > self._plan.dwell_limit_s:
            return self._abort(f"no measurement at {self.frequency_hz:g} Hz within {self._plan.dwell_limit_s:g} s")
        return None

    def abort(self, reason: str) -> Command | None:
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

    def _go(self, now_ns: int) -> Command:
        self._since_ns, self._accepted, self._taken, self._failures = now_ns, False, 0, 0
        return Command(self.frequency_hz, self._plan.current_a)

    def _next(self, now_ns: int) -> Command:
        before = self.frequency_hz
        self._at += 1
        if self._at == len(self._points):
            self.state = State.FINISHED
            return Command(before, 0.0)
        command = self._go(now_ns)
        self._accepted = command.frequency_hz == before  # at the turn nothing changes, so nothing is accepted anew
        return command

    def _abort(self, reason: str) -> Command:
        self.state, self.reason = State.ABORTED, reason
        return Command(self.frequency_hz, 0.0)
