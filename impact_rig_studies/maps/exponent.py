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
"""Largest Lyapunov exponent by the two-particle method: the mean rate at which neighbouring motions separate.

A second motion starts at a small distance from the first. After each return to the section of the motion, the distance
is measured and reset to its initial size (Benettin, Galgani & Strelcyn 1976). No derivative is needed, so the method
also applies to impacts. The exponent is the mean over windows of several returns. Its standard uncertainty follows from
the scatter of the windows, which must be longer than the memory of the motion.

G. Benettin, L. Galgani & J.-M. Strelcyn (1976), "Kolmogorov entropy and numerical experiments", Phys. Rev. A 14, 2338.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from impact_rig.analysis.calibration import Real

APART = 1e-7  # distance of the two states at the beginning of a return, in dimensionless coordinates
_OUT_OF_SIGHT = 64  # number of consecutive returns with a contact after which the exponent is given up as NaN
CERTAIN = {6: 6.0, 9: 5.0, 12: 4.0, 16: 2.0, 64: 2.0}
"""Absolute exponent, in standard uncertainties, above which `sign` is certain, by number of windows.

With few windows the limit is higher, because their uncertainty is uncertain itself and the sign is judged repeatedly.
"""


class Exponent(NamedTuple):
    """Largest Lyapunov exponent of a motion, per return to the section; a positive value means a chaotic motion."""

    value: float  # mean over the windows; NaN if the sphere is in contact at `_OUT_OF_SIGHT` returns in a row
    uncertainty: float  # standard uncertainty of value, from the scatter of the windows; NaN with it
    windows: tuple[float, ...]  # mean exponent per return in each window; empty with a NaN


def largest(f: Callable[[Real, int], Real], z: Real, returns: int, windows: int = 20) -> Exponent:
    """Return the largest Lyapunov exponent of the settled motion that starts at z.

    The exponent is NaN if the sphere is in contact with a wall at `_OUT_OF_SIGHT` returns in a row.

    Args:
        f: map of the motion: `f(z, count)` returns the coordinates `count` returns after z, or NaN if the sphere is in
            contact with a wall there. Such returns are skipped.
        z: dimensionless coordinates at the section, shape (n,).
        returns: number of returns in each window. A window is longer if its last returns are skipped.
        windows: number of averaged windows, at least 2. One more window precedes them and is not averaged.
    """
    return summary(list(itertools.islice(in_windows(f, z, returns), windows)))


def in_windows(f: Callable[[Real, int], Real], z: Real, returns: int) -> Iterator[float]:
    """Yield the mean exponent per return in one window after the other, without end.

    The first window is not yielded. The arguments are those of `largest`. If the sphere is in contact with a wall at
    `_OUT_OF_SIGHT` returns in a row, NaN is yielded, and the iteration ends.
    """
    apart = np.full(len(z), APART / math.sqrt(len(z)))
    for number in itertools.count():
        total, done = 0.0, 0
        while done < returns:
            for steps in range(1, _OUT_OF_SIGHT + 1):
                here, there = f(z, steps), f(z + apart, steps)
                if np.isfinite(here).all() and np.isfinite(there).all():
                    break
            else:
                yield math.nan
                return
            distance = float(np.linalg.norm(there - here))
            total += math.log(max(distance, 1e-300) / APART)
            if distance > 0.0:
                apart = (there - here) * (APART / distance)
            z, done = here, done + steps
        if number > 0:
            yield total / done


def summary(windows: list[float]) -> Exponent:
    """Return the exponent of a motion from its mean exponents in at least two windows; NaN if the last is NaN."""
    n = len(windows)
    if math.isnan(windows[-1]):
        return Exponent(math.nan, math.nan, ())
    mean = math.fsum(windows) / n
    scatter = math.fsum((window - mean) ** 2 for window in windows) / (n - 1)
    return Exponent(mean, math.sqrt(scatter / n), tuple(windows))


def sign(windows: Iterable[float]) -> int:
    """Return the sign of the exponent, 1 or -1, or 0 if the sign is not certain or the exponent is NaN.

    `windows` are the results of `in_windows`. Windows are taken until the sign is certain, at most the largest number
    in `CERTAIN`.
    """
    taken: list[float] = []
    for window in itertools.islice(windows, max(CERTAIN)):
        taken.append(window)
        if len(taken) in CERTAIN:
            found = summary(taken)
            if abs(found.value) > CERTAIN[len(taken)] * found.uncertainty:
                return 1 if found.value > 0.0 else -1
    return 0
