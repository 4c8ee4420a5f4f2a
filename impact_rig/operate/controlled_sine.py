# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Controlled sine: a stepped sine that holds an amplitude, by setting the current anew until the measured one is right.

At each point: measure settled, compare, correct the current by the slope that the last two measurements show (in
logarithms; 1 to begin with, which is exact on a linear rig), measure again. What is held is what the instruments say.
"""

from __future__ import annotations

import enum
import math

import attrs
import numpy as np
from numpy.lib import recfunctions
from numpy.typing import NDArray

from impact_rig.blocks import HELD, TRANSMISSIBILITY
from impact_rig.errors import ConfigError
from impact_rig.operate.plan import Plan, Setpoint
from impact_rig.operate.stepped_sine import SteppedSine


class Hold(enum.StrEnum):
    """What is held."""

    CURRENT = "current"
    BASE = "base"
    SUPERIOR = "superior"


COLUMN = {Hold.CURRENT: "current_amplitude", Hold.BASE: "base_amplitude", Hold.SUPERIOR: "laser_amplitude"}
"""Where a row of `transmissibility/table` has it."""
LARGEST_STEP = 3.0
"""Factor by which the current changes at once, at most."""
SLOPES = (0.3, 3.0)
"""Bounds of d ln amplitude / d ln current that a correction believes."""


def _positive(_: object, attribute: attrs.Attribute[float], value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise ConfigError(f"{attribute.name} must be > 0 and finite, got {value!r}")


@attrs.frozen(kw_only=True)
class HoldPlan:
    """What is held, and how far a point may go for it.

    Attributes:
        hold: base, superior or current.
        target: its amplitude, peak [m or A].
        tolerance: relative error up to which it counts as held.
        corrections: of the current per point; then the point is kept as it is, with its error.
        current_limit_a: a correction beyond it aborts the sweep.
        superior_limit_m: a measured superior base beyond it aborts the sweep.

    Raises:
        ConfigError: a value that cannot work; the message names it.
    """

    hold: Hold = attrs.field(converter=Hold)
    target: float = attrs.field(validator=_positive)
    tolerance: float = attrs.field(default=2e-3, validator=_positive)
    corrections: int = 8
    current_limit_a: float = attrs.field(default=15.0, validator=_positive)
    superior_limit_m: float = attrs.field(default=0.05, validator=_positive)


class ControlledSine(SteppedSine):
    """Walks through a plan with an amplitude held.

    Args:
        plan: the points; its current is what the first one begins with.
        hold: what is held there.
    """

    def __init__(self, plan: Plan, hold: HoldPlan) -> None:
        self._hold = hold
        self._current_a = plan.current_a
        super().__init__(plan)

    @property
    def current_a(self) -> float:
        """Current of the present try."""
        return self._current_a

    @property
    def held(self) -> NDArray[np.void]:
        """The curve so far with target, error and corrections: rows of `blocks.HELD`."""
        rows = self.rows
        found = np.zeros(len(rows), HELD)
        recfunctions.assign_fields_by_name(found, rows)
        found["target"], found["corrections"] = self._hold.target, self._tries[: len(rows)]
        found["error"] = rows[COLUMN[self._hold.hold]] / self._hold.target - 1.0
        found["held"] = np.abs(found["error"]) <= self._hold.tolerance
        return found

    def _reset(self) -> None:
        super()._reset()
        self._current_a = self._plan.current_a
        self._tries: list[int] = []
        self._corrected = 0
        self._before: tuple[float, float] | None = None  # logarithms of current and amplitude at this point

    def on_measurement(self, row: np.void, now_ns: int) -> Setpoint | None:
        """Take a row of `transmissibility/table`; one of a current before the present one is ignored."""
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
            if self._taken + 1 >= self._plan.measurements_per_point:
                self._corrected, self._before = 0, None
            return None
        wanted = self._corrected_current(reached)
        if wanted > self._hold.current_limit_a:
            limit = self._hold.current_limit_a
            return self._abort(f"{self.frequency_hz:g} Hz needs {wanted:.3g} A, more than the limit of {limit:g} A")
        self._current_a = wanted
        self._corrected += 1
        return self._go(now_ns)

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
