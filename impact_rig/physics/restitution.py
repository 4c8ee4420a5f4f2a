# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a contact law of the Hunt–Crossley form really returns.

For F = K δⁿ (1 + a δ'/v0) between two free bodies, whatever K, n, the masses and v0:

    ln[(1 + a) / (1 − a e)] = a (1 + e)

Integrate δ' dδ' = −(K/m)(1 + a δ'/v0) δⁿ dδ from v0 in and from −e v0 out; the δⁿ cancels.

Solved in portable arithmetic, since the simulation runs on such factors; by bisection, since the two sides agree to
many digits where e is close to 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal

from impact_rig.arithmetic.precise import ONE, TWO, ZERO, precise

_CLOSE = Decimal("1e-20")
_SMALL = 1e-9
"""Below this factor the next term of the series, 4a²/9, is less than a float can tell."""


@precise
def realised(hysteresis_factor: float) -> float:
    """Return the restitution that the dimensionless damping factor `a` ≥ 0 gives."""
    if hysteresis_factor < 0.0 or not math.isfinite(hysteresis_factor):
        raise ValueError(f"hysteresis factor must be >= 0, got {hysteresis_factor!r}")
    if hysteresis_factor < _SMALL:
        return 1.0 - hysteresis_factor * 2.0 / 3.0
    a = Decimal(hysteresis_factor)
    return _root(ONE / max(ONE, a), lambda e: _imbalance(a, e))


@precise
def factor_returning(restitution: float) -> float:
    """Return the factor `a` whose realised restitution is `restitution` in (0, 1]."""
    if not 0.0 < restitution <= 1.0:
        raise ValueError(f"restitution must be > 0 and <= 1, got {restitution!r}")
    if restitution == 1.0:
        return 0.0
    e = Decimal(restitution)
    return _root(ONE / e, lambda a: _imbalance(a, e))


def _imbalance(a: Decimal, e: Decimal) -> Decimal:
    """Return the left side of the equation less the right one: it grows with both."""
    return ((ONE + a) / (ONE - a * e)).ln() - a * (ONE + e)


def _root(high: Decimal, growing: Callable[[Decimal], Decimal]) -> float:
    """Return the number in (0, high) where a growing function is zero."""
    low = ZERO
    while high - low > _CLOSE * high:
        middle = (low + high) / TWO
        low, high = (low, middle) if growing(middle) > ZERO else (middle, high)
    return float(low)
