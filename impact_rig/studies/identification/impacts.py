# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated reductions, and their derivatives along one orbit: the mechanics alone, settled to 1e-6.

ln(DT with / DT without) is smooth in the constants of the rig as long as the sphere strikes in the same pattern; where
the pattern changes it has a kink or a jump, and a difference across one is no derivative. So a difference counts only
where the motion on its sides repeats after as many cycles, with as many impacts, as the motion between, and where both
sides give one slope.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from impact_rig.analysis.words import Regime
from impact_rig.errors import SimulationError
from impact_rig.maps.measure import FAILED, MapRig, Settings
from impact_rig.physics.prediction import transmissibility
from impact_rig.rig.config import RigConfig, from_flat

SETTLED = Settings(settle_tolerance=1e-6, settle_cycles=1200, cycles=400)
STEPS = (1e-3, 3e-4, 1e-4)
"""For differences; the next one where the one before crosses a change of orbit."""
SAME_SLOPE, LEAST_SLOPE = 0.1, 0.05
"""The slopes of both sides differ by at most this share of them, plus this."""


class Motion(NamedTuple):
    """What the rig settles to with its sphere.

    Attributes:
        log_ratio: ln(DT with sphere / DT without).
        regime: periodic, modulated or chaotic.
        period: cycles after which it repeats; NaN if it does not.
        impacts: that many in a period.
    """

    log_ratio: float
    regime: str
    period: float
    impacts: float

    def orbit(self) -> tuple[float, int] | None:
        """Return period and impacts of an orbit, None of a motion that does not repeat."""
        if self.regime != Regime.PERIODIC.value:
            return None
        return self.period, round(self.impacts)


def simulated(config: RigConfig, gap_m: float, frequency_hz: float, current_a: float) -> Motion:
    """Return the motion of a rig, from its reset on; without the sphere DT is known in closed form.

    Raises:
        SimulationError: it could not be resolved.
    """
    config = from_flat(config, {"sphere.present": True, "barriers.gap_m": gap_m})
    found = MapRig(config, SETTLED).measure(frequency_hz, current_a)
    if found.regime == FAILED or not found.dt > 0.0:
        raise SimulationError(f"gap {gap_m * 1e3:g} mm, {frequency_hz:g} Hz: the motion cannot be resolved")
    without = abs(complex(transmissibility(config, frequency_hz)))
    return Motion(math.log(found.dt / without), found.regime, found.period, found.impacts_per_cycle * found.period)


def slope(at: Callable[[float], Motion], here: Motion) -> float | None:
    """Return the derivative of `log_ratio` along the orbit of `here`, or None where its neighbours have no such one.

    Args:
        at: the motion a step away; the step is of the order of a relative change.
        here: the motion at step 0.
    """
    orbit = here.orbit()
    if orbit is None:
        return None
    one_sided = None
    for step in STEPS:
        sides = [
            ((other.log_ratio - here.log_ratio) / h, other.orbit() == orbit)
            for h in (step, -step)
            for other in (at(h),)
        ]
        (right, right_same), (left, left_same) = sides
        if right_same and left_same and abs(right - left) <= SAME_SLOPE * (abs(right) + abs(left)) + LEAST_SLOPE:
            return 0.5 * (right + left)
        if right_same != left_same:
            one_sided = right if right_same else left
    return one_sided
