# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""How long a point cannot reach a target: the stride of the search for the next touch.

With speed r and acceleration b towards the target and |jerk| <= j, the point covers within any h at most

    r τ + (b + j h / 3) τ² / 2,   0 <= τ <= h

The first τ at which that is the distance is safe if it comes before h, and h itself is safe otherwise. Repeated
strides close in on the first touch from before it and cannot step over it, however short or grazing the crossing.
"""

from __future__ import annotations

import math

from impact_rig.arithmetic.elementary import power
from impact_rig.kernels import kernel

_THIRD = 1.0 / 3.0
_ROUNDS = 12
_CLOSE = 0.8  # how near to the best horizon is good enough


@kernel
def stride(distance, speed, acceleration, jerk, horizon):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return a time, at most `horizon` [s], in which a point cannot cover `distance` [m]."""
    h = horizon
    if jerk > 0.0:
        h = min(
            h,
            3.0 * abs(acceleration) / jerk + math.sqrt(6.0 * abs(speed) / jerk) + power(6.0 * distance / jerk, _THIRD),
        )
    safe = 0.0
    for _ in range(_ROUNDS):
        half = 0.5 * (acceleration + jerk * h / 3.0)
        under = speed * speed + 4.0 * half * distance
        reach = math.inf
        if speed > 0.0:
            if under >= 0.0:
                reach = 2.0 * distance / (speed + math.sqrt(under))
        elif half > 0.0:
            reach = (math.sqrt(under) - speed) / (2.0 * half)
        if reach >= h:
            if h >= horizon:
                return horizon
            safe = h
            h = min(2.0 * h, reach, horizon)
        else:
            safe = max(safe, reach)
            if reach > _CLOSE * h or reach <= 0.0:
                break
            h = math.sqrt(h * reach)
    return safe
