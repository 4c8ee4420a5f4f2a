# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""What a contact law of the Hunt–Crossley form really returns, in closed form.

For F = K δⁿ (1 + a δ'/v0) between two free bodies, whatever K, n, the masses and v0:

    ln[(1 + a) / (1 − a e)] = a (1 + e),   e = [1 + W0(−(1 + a) exp(−(1 + a)))] / a      (W0: Lambert W)

Integrate δ' dδ' = −(K/m)(1 + a δ'/v0) δⁿ dδ from v0 in and from −e v0 out; the δⁿ cancels.
"""

from __future__ import annotations

import math
from decimal import Decimal

from impact_rig.arithmetic.precise import ONE, TWO, ZERO, precise

_SERIES_BELOW = (
    1e-3  # the closed form loses digits as a -> 0, where the series e = 1 − 2a/3 + 4a²/9 − … is exact enough
)


_CLOSE = Decimal("1e-20")


def realised(hysteresis_factor: float) -> float:
    """Return the restitution that the dimensionless damping factor `a` ≥ 0 gives."""
    from scipy.special import lambertw  # noqa: PLC0415  # heavy, and no configuration needs it

    a = hysteresis_factor
    if a < 0.0 or not math.isfinite(a):
        raise ValueError(f"hysteresis factor must be >= 0, got {a!r}")
    if a < _SERIES_BELOW:
        return 1.0 - a * (2.0 / 3.0 - a * (4.0 / 9.0 - a * 44.0 / 135.0))
    x = 1.0 + a
    return float((1.0 + lambertw(-x * math.exp(-x)).real) / a)


@precise
def factor_returning(restitution: float) -> float:
    """Return the factor `a` whose realised restitution is `restitution` in (0, 1].

    The simulation runs on it, so it is found in portable arithmetic: by bisection between 0 and 1/e of the equation
    above, whose two sides agree to many digits where e is close to 1.
    """
    if not 0.0 < restitution <= 1.0:
        raise ValueError(f"restitution must be > 0 and <= 1, got {restitution!r}")
    if restitution == 1.0:
        return 0.0
    e = Decimal(restitution)
    low, high = ZERO, ONE / e
    while high - low > _CLOSE * high:
        a = (low + high) / TWO
        if ((ONE + a) / (ONE - a * e)).ln() > a * (ONE + e):
            high = a
        else:
            low = a
    return float(low)
