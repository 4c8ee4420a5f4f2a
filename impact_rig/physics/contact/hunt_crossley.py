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
"""Contact laws of the Hunt–Crossley form: Hertz's force with a damping that vanishes with the indentation.

    F = K δ^1.5 (1 + a δ'/v0)        v0: approach speed of the contact; a: hysteresis factor, the laws differ in a

δ is the indentation and K the Hertz stiffness. The laws differ in the formula for a as a function of the nominal
restitution. The restitution e that such a law really gives between two free bodies depends only on a, and solves this
equation:

    ln[(1 + a) / (1 − a e)] = a (1 + e)

To derive the equation, integrate δ' dδ' = −(K/m)(1 + a δ'/v0) δⁿ dδ inwards from v0 and outwards from −e v0; the δⁿ
cancels. The equation is solved by bisection, with many digits in portable arithmetic.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from decimal import Decimal

import attrs

from impact_rig.arithmetic.elementary import exp
from impact_rig.arithmetic.precise import ONE, TWO, ZERO, with_70_digits
from impact_rig.physics.contact.law import ContactLaw, ContactPair, Force

_CLOSE = Decimal("1e-20")
_SMALL = 1e-9
"""Hysteresis factor a below which the restitution is 1 − 2a/3 to the resolution of a float: the next term of the series
is 4a²/9.
"""


@functools.lru_cache(maxsize=1024)  # 20 ms, and a study asks for few values again and again
@with_70_digits
def realised(hysteresis_factor: float) -> float:
    """Return the restitution that a Hunt–Crossley contact really gives with the hysteresis factor `a` ≥ 0 [-].

    Raises:
        ValueError: the factor is negative or not finite.
    """
    if hysteresis_factor < 0.0 or not math.isfinite(hysteresis_factor):
        raise ValueError(
            f"dimensionless hysteresis factor of a contact law must be finite and >= 0, got {hysteresis_factor!r}"
        )
    if hysteresis_factor < _SMALL:
        return 1.0 - hysteresis_factor * 2.0 / 3.0
    a = Decimal(hysteresis_factor)
    return _root(ONE / max(ONE, a), lambda e: _imbalance(a, e))


@functools.lru_cache(maxsize=1024)
@with_70_digits
def factor_returning(restitution: float) -> float:
    """Return the hysteresis factor `a` [-] with which a Hunt–Crossley contact really gives `restitution`.

    Raises:
        ValueError: the restitution is not in (0, 1].
    """
    if not 0.0 < restitution <= 1.0:
        raise ValueError(f"restitution must be > 0 and <= 1, got {restitution!r}")
    if restitution == 1.0:
        return 0.0
    e = Decimal(restitution)
    return _root(ONE / e, lambda a: _imbalance(a, e))


def _imbalance(a: Decimal, e: Decimal) -> Decimal:
    """Return ln[(1 + a) / (1 − a e)] − a (1 + e), which is zero where the hysteresis factor a gives the restitution e.

    The product a e must be < 1. As a function of either argument, the result is negative below the root and positive
    above it.
    """
    return ((ONE + a) / (ONE - a * e)).ln() - a * (ONE + e)


def _root(high: Decimal, imbalance: Callable[[Decimal], Decimal]) -> float:
    """Return the root of the function `imbalance` in the interval (0, high), by bisection.

    The function must be negative below the root and positive above it.
    """
    low = ZERO
    while high - low > _CLOSE * high:
        middle = (low + high) / TWO
        low, high = (low, middle) if imbalance(middle) > ZERO else (middle, high)
    return float(low)


def _hertz_damped(
    stiffness: float,
    factor: float,
    per_v0: float,
    turned_at: float,  # noqa: ARG001  # this force has no memory
    w: float,
    speed: float,
) -> tuple[float, float, float, float, float]:
    """Return the Hunt–Crossley force F = K w³ (1 + a δ'/v0) in the form that `contact.law` describes.

    K is `stiffness`, a `factor`, 1/v0 `per_v0`, δ' `speed`, and w the square root of the indentation δ. The results are
    the elastic and the lossy part of F [N], the stored energy [J], ∂F/∂w and ∂F/∂δ'.
    """
    hertz = stiffness * w * w * w
    damping = factor * per_v0
    pressing = 1.0 + damping * speed
    return hertz, hertz * damping * speed, 0.4 * hertz * w * w, 3.0 * stiffness * w * w * pressing, hertz * damping


@attrs.frozen
class HystereticLaw(ContactLaw):
    """Contact law F = K δ^1.5 (1 + a δ'/v0) with Hertz stiffness K.

    A subclass defines the hysteresis factor a, and the class attributes of `ContactLaw`.
    """

    adjustable = True

    def hysteresis_factor(self) -> float:
        """Return the dimensionless hysteresis factor a that this law's formula gives for the nominal restitution.

        With it, the damping force of a contact with the approach speed v0 is (a K / v0) δ^1.5 δ'.
        """
        raise NotImplementedError

    def force(self, pair: ContactPair) -> Force:
        """Return the force K δ^1.5 (1 + a δ'/v0).

        K is the Hertz stiffness of the bodies `pair`, and a is the hysteresis factor of this law.
        """
        return Force(
            _hertz_damped, pair.hertz_stiffness, self.hysteresis_factor(), 1.5, self.restitution, scale_free=True
        )

    def realised_restitution(self) -> float:
        """Return the restitution that the law really gives with its `hysteresis_factor`, see `realised`."""
        return realised(self.hysteresis_factor())


def _published(
    name: str, formula: str, returns: float, source: str, factor: Callable[[float], float], *, adjustable: bool = True
) -> type[HystereticLaw]:
    """Return the class of a Hunt–Crossley law from its published formula: `factor` computes a from the nominal e.

    The other arguments become class attributes, see `ContactLaw`. `returns` is the restitution that the law really
    gives for a nominal restitution of 0.35. `adjustable` tells whether the law `exact` can replace this one.
    """
    row = {"name": name, "formula": formula, "returns": returns, "source": source, "adjustable": adjustable}
    law = type(name, (HystereticLaw,), {
        **row, "hysteresis_factor": lambda self: factor(self.restitution), "__module__": __name__,
        "__doc__": f"Hysteresis factor a = {formula}.",
    })  # fmt: skip
    return attrs.frozen(law)


Hertz = _published(
    "hertz", "0", 1.0, "Hertz (1882), J. Reine Angew. Math. 92, 156–171", lambda _: 0.0, adjustable=False
)
"""Law without damping (a = 0), used as a reference: it gives the restitution 1, whatever the nominal one is."""
HuntCrossley = _published(
    "hunt_crossley",
    "3(1 − e)/2",
    0.600,
    "Hunt & Crossley (1975), J. Appl. Mech. 42, 440–445",
    lambda e: 1.5 * (1.0 - e),
)
"""The first published law whose damping vanishes with the indentation; its formula is derived for e close to 1."""
HerbertMcWhannell = _published(
    "herbert_mcwhannell",
    "6(1 − e)/((2e − 1)² + 3)",
    0.534,
    "Herbert & McWhannell (1977), J. Eng. Ind. 99, 671–674",
    lambda e: 6.0 * (1.0 - e) / ((2.0 * e - 1.0) * (2.0 * e - 1.0) + 3.0),
)
LeeWang = _published(
    "lee_wang",
    "3(1 − e)/4",
    0.753,
    "Lee & Wang (1983), J. Mech. Trans. Autom. Des. 105, 534–540",
    lambda e: 0.75 * (1.0 - e),
)
LankaraniNikravesh = _published(
    "lankarani_nikravesh",
    "3(1 − e²)/4",
    0.692,
    "Lankarani & Nikravesh (1990), J. Mech. Des. 112, 369–376",
    lambda e: 0.75 * (1.0 - e * e),
)
"""The law that multibody programs usually offer; its formula is meant for a restitution close to 1."""
Gonthier = _published(
    "gonthier",
    "(1 − e²)/e",
    0.352,
    "Gonthier, McPhee, Lange & Piedbœuf (2004), Multibody Syst. Dyn. 11, 209–233",
    lambda e: (1.0 - e * e) / e,
)
"""A law whose realised restitution is close to the nominal one over the whole range from 0 to 1."""
ZhiyingQishao = _published(
    "zhiying_qishao",
    "¾(1 − e²) exp(2(1 − e))",
    0.361,
    "Qin & Lu (2006), J. Dynamics and Control 4(4), 294–298",
    lambda e: 0.75 * (1.0 - e * e) * float(exp(2.0 * (1.0 - e))),
)
"""The law of Lankarani and Nikravesh with a correction factor for low restitution."""
Flores = _published(
    "flores",
    "8(1 − e)/(5e)",
    0.309,
    "Flores, Machado, Silva & Martins (2011), Multibody Syst. Dyn. 25, 357–375; the paper's Eq. (5)",
    lambda e: 8.0 * (1.0 - e) / (5.0 * e),
)
"""The law of the paper about this rig. It gives a restitution of 0.309 for the nominal 0.35 of the paper's drop test.
The sphere also rebounded less in the paper's own simulation than in the drop test.
"""
HuGuo = _published(
    "hu_guo", "3(1 − e)/(2e)", 0.325, "Hu & Guo (2015), Multibody Syst. Dyn. 35, 131–151", lambda e: 1.5 * (1.0 - e) / e
)
Exact = _published(
    "exact",
    "root of ln[(1 + a)/(1 − a e)] = a (1 + e)",
    0.350,
    "closed form of the Hunt–Crossley family",
    factor_returning,
)
"""The law whose factor gives exactly the nominal restitution: a = 2.52338 for e = 0.35."""
