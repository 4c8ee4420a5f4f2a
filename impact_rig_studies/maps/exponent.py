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
"""Largest Lyapunov exponent by the two-particle method: the rate at which neighbours separate, with exact events.

A second state at a small distance follows the motion. After each return the distance is measured and reset (Benettin,
Galgani & Strelcyn 1976). No derivative is needed, so impacts are no exception. The exponent is the mean over windows,
and its standard uncertainty follows from their scatter: windows longer than the memory of the motion count as
independent.

G. Benettin, L. Galgani & J.-M. Strelcyn (1976), "Kolmogorov entropy and numerical experiments", Phys. Rev. A 14, 2338.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from impact_rig.analysis.calibration import Real

APART = 1e-7  # distance of the two states at the beginning of a return, in dimensionless coordinates
_OUT_OF_SIGHT = 64  # consecutive undetermined returns after which a motion counts as never determined


class Exponent(NamedTuple):
    """Largest exponent per return."""

    value: float  # mean over the windows; NaN if the states are always undetermined
    uncertainty: float  # standard uncertainty, from the windows' scatter
    windows: tuple[float, ...]  # of each window


def largest(f: Callable[[Real, int], Real], z: Real, returns: int, windows: int = 20) -> Exponent:
    """Return the largest exponent of the motion from z on, which should have settled.

    Args:
        f: coordinates after a number of returns; NaN if they are undetermined then.
        z: coordinates, shape (n,).
        returns: returns in each window.
        windows: number of windows; one more at the beginning only turns the distance to the growing direction.
    """
    apart = np.full(len(z), APART / math.sqrt(len(z)))
    found = []
    for _ in range(windows + 1):
        total, done = 0.0, 0
        while done < returns:
            for steps in range(1, _OUT_OF_SIGHT + 1):
                here, there = f(z, steps), f(z + apart, steps)
                if np.isfinite(here).all() and np.isfinite(there).all():
                    break
            else:
                return Exponent(math.nan, math.nan, ())
            distance = float(np.linalg.norm(there - here))
            total += math.log(max(distance, 1e-300) / APART)
            if distance > 0.0:
                apart = (there - here) * (APART / distance)
            z, done = here, done + steps
        found.append(total / done)
    kept = np.array(found[1:])
    return Exponent(float(kept.mean()), float(kept.std(ddof=1) / math.sqrt(len(kept))), tuple(kept.tolist()))
