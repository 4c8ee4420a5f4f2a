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
"""Detection of a periodic motion in a short record with one row per drive cycle.

A row holds the complex amplitudes x_b and x_1 of both bases at the drive frequency. It also holds position x_2 and
velocity v_2 of the sphere at the start of the cycle. A motion has settled when every number of a row changes little
from one period to the next, and the sum of all later changes is as small. This sum is extrapolated as a geometric
series. Changes of x_b are relative to the mean amplitude of the inferior base. Changes of x_1, x_2 and v_2/ω are
relative to that of the superior base.
"""

from __future__ import annotations

import math

from impact_rig.analysis.spread import LONGEST_PERIOD, shortest_period
from impact_rig.arithmetic.elementary import modulus, power
from impact_rig.kernels import BYTES_2D, REALS_2D, Bytes, Reals, entry, kernel

LASTING = 0.98  # difference in the later half of a record over that in the earlier one, above which it does not decay
_QUANTITIES = 4  # x_b, x_1, x_2 and v_2
_ROUNDING = 1e-9  # relative change of a cycle that counts as none


@entry(REALS_2D, BYTES_2D, float, float, float, int, REALS_2D, returns=int)
def settled_period(
    rows: Reals, strikes: Bytes, omega: float, tolerance: float, repetition: float, longest: int, scaled: Reals
) -> int:
    """Return the period [drive cycles] of a motion that has settled, or 0 if the motion has not settled.

    Args:
        rows: Re x_b, Im x_b, Re x_1 and Im x_1 of each cycle, and x_2 and v_2 of the sphere at its start, SI, shape
            (n, 6).
        strikes: 1 for each part of each cycle that has an impact, else 0, shape (n, parts).
        omega: angular frequency of the drive [rad/s].
        tolerance: limit of the relative change in the last period, and of the sum of all later changes, which are
            extrapolated as a geometric series.
        repetition: largest rms deviation of x_1, relative to its mean, at which x_1 counts as repeating. Both x_1 and
            the impacts must also repeat.
        longest: longest period considered [cycles].
        scaled: scratch memory of the shape of `rows`.
    """
    if not _scale(rows, omega, scaled):
        return 0
    n = rows.shape[0]
    for period in range(1, longest + 1):
        last_change = 0.0
        for quantity in range(_QUANTITIES):
            last_change = max(last_change, _change(scaled, quantity, period, n - period - 1))
        if last_change <= tolerance and _is_over(scaled, period, tolerance):
            found, _ = shortest_period(scaled[:, 2:4], strikes, repetition * repetition, min(LONGEST_PERIOD, n // 4))
            if found == 0 or period % found:
                return 0
            # if the structure repeats earlier, either the sphere does so in the end, or it never will
            return period if found == period or _lasts(scaled, found) else 0
    return 0


@kernel
def _scale(rows: Reals, omega: float, scaled: Reals) -> bool:
    """Fill `scaled` with the rows in dimensionless form, and return whether this was possible.

    The result is False, with `scaled` unchanged, if the mean amplitude of x_b or x_1 is not positive and finite.
    """
    n = rows.shape[0]
    x_b, x_1 = 0.0j, 0.0j
    for k in range(n):
        x_b += complex(rows[k, 0], rows[k, 1])
        x_1 += complex(rows[k, 2], rows[k, 3])
    base, superior = modulus(x_b) / n, modulus(x_1) / n
    if not (0.0 < base < math.inf and 0.0 < superior < math.inf):
        return False
    for k in range(n):
        scaled[k, 0], scaled[k, 1] = rows[k, 0] / base, rows[k, 1] / base
        scaled[k, 2], scaled[k, 3] = rows[k, 2] / superior, rows[k, 3] / superior
        scaled[k, 4], scaled[k, 5] = rows[k, 4] / superior, rows[k, 5] / (omega * superior)
    return True


@kernel
def _change(scaled: Reals, quantity: int, period: int, k: int) -> float:
    """Return the magnitude of the change of a scaled quantity from cycle `k` to cycle `k` + `period`.

    The numbers 0 to 3 of `quantity` mean x_b, x_1, x_2 and v_2.
    """
    after, place = k + period, 2 * quantity if quantity < 2 else quantity + 2  # the first two are complex
    imag = scaled[after, place + 1] - scaled[k, place + 1] if quantity < 2 else 0.0
    return modulus(complex(scaled[after, place] - scaled[k, place], imag))


@kernel
def _largest_changes(scaled: Reals, quantity: int, period: int) -> tuple[float, float]:
    """Return the largest change of a scaled quantity over `period` cycles in each half of the record.

    The result is (first half, second half). The numbers 0 to 3 of `quantity` mean x_b, x_1, x_2 and v_2.
    """
    count = scaled.shape[0] - period
    early, late = 0.0, 0.0
    for k in range(count // 2):
        early = max(early, _change(scaled, quantity, period, k))
    for k in range(count // 2, count):
        late = max(late, _change(scaled, quantity, period, k))
    return early, late


@kernel
def _is_over(scaled: Reals, period: int, tolerance: float) -> bool:
    """Return whether all changes after the end of the record are together at most `tolerance`, for every quantity.

    The changes are extrapolated as a geometric series. If they do not decay, or exceed `tolerance` in the second half
    of the record, the result is False. Changes as small as rounding errors do not count.
    """
    half = (scaled.shape[0] - period) // 2
    for quantity in range(_QUANTITIES):
        early, late = _largest_changes(scaled, quantity, period)
        if late > _ROUNDING:
            if late >= early or late > tolerance:
                return False
            ratio = power(late / early, period / half)
            if late * ratio > tolerance * (1.0 - ratio):
                return False
    return True


@kernel
def _lasts(scaled: Reals, period: int) -> bool:
    """Return whether the changes over `period` cycles persist: they do not decay from the first to the second half."""
    early, late = 0.0, 0.0
    for quantity in range(_QUANTITIES):
        early_one, late_one = _largest_changes(scaled, quantity, period)
        early, late = max(early, early_one), max(late, late_one)
    return late > LASTING * early
