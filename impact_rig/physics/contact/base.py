"""What a contact law is: a name, a restitution, and a force that every phase of the motion can use.

A law says its force in a compiled function of its own, and the numbers that function is called with in a `Force`:

    force(stiffness, factor, per_v0, deepest, w, rate) -> (elastic, lossy, stored, ∂F/∂w, ∂F/∂δ'),   F = elastic + lossy

    w        √δ [m^0.5], the variable in which contacts are integrated; rate: δ' [m/s], positive when pressing further
    deepest  the largest w of this contact so far: w >= deepest is loading anew, and a law with a memory branches there
    per_v0   1 / approach speed of this contact, floored [s/m]
    elastic  the part of F [N] that the stored energy gives back
    lossy    the rest: lossy · δ' [W] is what the contact loses at this instant
    stored   that energy [J], ∫ elastic dδ; where the contact lets go, what is left of it is lost

Between w = 0, δ' = 0 and w = deepest the force must be smooth in w and δ'. Nothing else of the package asks which law
it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol

import attrs
from numba import cfunc
from numba.core import types

from impact_rig.config import Contact
from impact_rig.errors import ConfigError
from impact_rig.physics import restitution as closed_form

_FORCE = types.UniTuple(types.float64, 5)(*6 * (types.float64,))  # type: ignore[attr-defined]  # made on demand

ForceFunction = Callable[[float, float, float, float, float, float], tuple[float, float, float, float, float]]


def compiled_force(function: ForceFunction) -> Any:  # Numba's function pointers have no type to name
    """Compile a law's force so that one event loop calls them all: they are pointers of one type."""
    return cfunc(_FORCE, cache=True)(function)


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
        remembers: whether the force depends on `deepest`; such a law may ring undamped, and is averaged once slow.
        rigid: whether a contact takes no time, and the force is never asked for.
    """

    function: Any
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


class ContactLaw(Protocol):
    """A contact law with its nominal restitution; registered by `name`."""

    name: ClassVar[str]

    @property
    def restitution(self) -> float:
        """Nominal coefficient of restitution e, 0 < e <= 1."""

    def force(self, pair: ContactPair) -> Force:
        """Return the force between the bodies of `pair`."""

    def realised_restitution(self) -> float:
        """Return the restitution this law really gives, from its closed form."""

    @classmethod
    def from_config(cls, contact: Contact) -> ContactLaw:
        """Build the law from the configuration's `contact` section."""


def check_restitution(law: object, attribute: attrs.Attribute[float], value: float) -> None:
    """Attrs validator: 0 < e <= 1."""
    if not (math.isfinite(value) and 0.0 < value <= 1.0):
        raise ConfigError(f"{type(law).__name__}.{attribute.name} must be > 0 and <= 1, got {value!r}")


@compiled_force
def _hertz_damped(stiffness, factor, per_v0, deepest, w, rate):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """F = K w³ (1 + a δ'/v0)."""
    hertz = stiffness * w * w * w
    damping = factor * per_v0
    pressing = 1.0 + damping * rate
    return hertz, hertz * damping * rate, 0.4 * hertz * w * w, 3.0 * stiffness * w * w * pressing, hertz * damping


@attrs.frozen
class HystereticLaw:
    """Hunt–Crossley form F = K δ^1.5 (1 + a δ'/v0); a law of this family says only what `a` is."""

    name: ClassVar[str]
    restitution: float = attrs.field(validator=check_restitution)

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

    @classmethod
    def from_config(cls, contact: Contact) -> HystereticLaw:
        """Build the law from the configuration's `contact` section."""
        return cls(contact.restitution)
