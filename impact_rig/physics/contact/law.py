# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a contact law is: a name, its origin, a restitution, and a force that every phase of the motion can use.

A law says its force in a plain function of numbers, which is compiled when it is first used, and the numbers that
function is called with in a `Force`:

    force(stiffness, factor, per_v0, turned_at, w, speed) -> (elastic, lossy, stored, ∂F/∂w, ∂F/∂δ')
    F = elastic + lossy

    w          √δ [m^0.5], the variable in which contacts are integrated
    speed      δ' [m/s], positive while the indentation grows
    turned_at  the largest w so far [m^0.5] once the indentation has shrunk from there, 0 while it still grows: a law
               with a memory has one branch for each
    per_v0     1 / approach speed of this contact, floored [s/m]
    elastic    the part of F [N] that the stored energy gives back
    lossy      the rest: lossy · δ' [W] is what the contact loses at this instant
    stored     that energy [J], ∫ elastic dδ; where the contact lets go, what is left of it is lost

On either branch the force must be smooth in w and δ', also a little beyond w = 0, where a step may try it.
Nothing else of the package asks which law it is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import attrs

from impact_rig.config.fields import Origin, quantity
from impact_rig.physics import restitution as closed_form

ForceFunction = Callable[[float, float, float, float, float, float], tuple[float, float, float, float, float]]


class Force(NamedTuple):
    """A law's force for one pair of bodies.

    Attributes:
        function: see above.
        stiffness: its first argument, K of F ~ K δ^exponent [N/m^exponent].
        factor: its second argument.
        exponent: of the indentation, for the scales of a contact.
        restitution: nominal; what a rigid law rebounds with.
        clipped: whether a force that would pull lets go.
        scale_free: whether every contact is the same in units of its own: `factor` has no dimension.
        remembers: whether the force depends on `turned_at`; such a law may ring undamped, and is averaged once slow.
        rigid: whether a contact takes no time, and the force is never asked for.
    """

    function: ForceFunction
    stiffness: float
    factor: float
    exponent: float
    restitution: float
    clipped: bool = True
    scale_free: bool = False
    remembers: bool = False
    rigid: bool = False


class ContactPair(NamedTuple):
    """The two bodies that meet: Hertz stiffness [N/m^1.5] and effective mass [kg]."""

    hertz_stiffness: float
    effective_mass: float


LEAST_RESTITUTION = 0.01
"""A sphere dropped from 1 m rebounds by e², 0.1 mm then: a drop test measures no less, and a smaller e says that the
bodies stick, which no law here models. The tests hold the laws from here on."""


def restitution() -> Any:
    """Return the attrs field of the nominal coefficient of restitution e."""
    about = "Coefficient of restitution e of the drop test."
    return quantity(0.35, "-", about, Origin.PAPER, at_least=LEAST_RESTITUTION, at_most=1)


def contact_time_s() -> Any:
    """Return the attrs field of t_c, which linear laws take in place of the Hertz stiffness."""
    return quantity(45e-6, "s", "Contact time of laws that take it for a stiffness.", at_least=1e-6, at_most=0.01)


@attrs.frozen
class ContactLaw:
    """A contact law; its fields are the values of the configuration's `contact` section that it reads.

    A field that the section has not got, made by `impact_rig.config.fields`, becomes a part of it.

    Attributes:
        name: by which it is chosen.
        formula: its row in the table of laws, without `|`.
        source: who published it, where.
        returns: the restitution it gives for a nominal 0.35, to three digits.
        adjustable: whether `calibration: exact` puts the law `exact` in its place.
    """

    name: ClassVar[str]
    formula: ClassVar[str]
    source: ClassVar[str]
    returns: ClassVar[float]
    adjustable: ClassVar[bool] = False
    restitution: float = restitution()

    def force(self, pair: ContactPair) -> Force:
        """Return the force between the bodies of `pair`."""
        raise NotImplementedError

    def realised_restitution(self) -> float:
        """Return the restitution this law really gives, from its closed form."""
        raise NotImplementedError


def _hertz_damped(
    stiffness: float,
    factor: float,
    per_v0: float,
    turned_at: float,  # noqa: ARG001  # this force has no memory
    w: float,
    speed: float,
) -> tuple[float, float, float, float, float]:
    """F = K w³ (1 + a δ'/v0)."""
    hertz = stiffness * w * w * w
    damping = factor * per_v0
    pressing = 1.0 + damping * speed
    return hertz, hertz * damping * speed, 0.4 * hertz * w * w, 3.0 * stiffness * w * w * pressing, hertz * damping


@attrs.frozen
class HystereticLaw(ContactLaw):
    """Hunt–Crossley form F = K δ^1.5 (1 + a δ'/v0); a law of this family says only what `a` is."""

    adjustable = True

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless; c = a K / v0 with the approach speed of each contact."""
        raise NotImplementedError

    def force(self, pair: ContactPair) -> Force:
        """Return the force between the bodies of `pair`."""
        return Force(
            _hertz_damped, pair.hertz_stiffness, self.hysteresis_factor(), 1.5, self.restitution, scale_free=True
        )

    def realised_restitution(self) -> float:
        """Return e_out from ln[(1 + a)/(1 − a e_out)] = a (1 + e_out)."""
        return closed_form.realised(self.hysteresis_factor())
