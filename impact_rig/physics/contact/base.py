"""What a contact law is: a name, a restitution, and a force that every phase of the motion can use.

A law says its force in a compiled function of its own, and the numbers that function is called with in a `Force`:

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

import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol

import attrs
from numba import cfunc, from_dtype, njit
from numba.core import config, types

from impact_rig.config import Contact
from impact_rig.errors import ConfigError
from impact_rig.physics import restitution as closed_form
from impact_rig.physics.collocation import STAGES
from impact_rig.physics.parameters import PARAMETERS
from impact_rig.physics.state import PRESS

_ONE = types.UniTuple(types.float64, 5)(*6 * (types.float64,))  # type: ignore[attr-defined]  # made on demand
_AT_STAGES = types.void(from_dtype(PARAMETERS), types.float64, from_dtype(PRESS))

ForceFunction = Callable[[float, float, float, float, float, float], tuple[float, float, float, float, float]]


class CompiledForce(NamedTuple):
    """A law's force as function pointers, which have one type whatever the law: one event loop calls them all.

    Attributes:
        one: the law's function itself.
        at_stages: called with (parameters, per_v0, press), fills the step's force, lossy, force_by_w, force_by_speed.
    """

    one: Any
    at_stages: Any


def compiled_force(function: ForceFunction) -> CompiledForce:
    """Compile a law's force."""
    inner: Any = njit(cache=True, error_model="numpy")(function)

    def at_stages(p, per_v0, k):  # type: ignore[no-untyped-def]  # compiled: types are declared
        for i in range(STAGES):
            elastic, lossy, _, by_w, by_speed = inner(p.stiffness, p.factor, per_v0, k.turned_at, k.w[i], k.speed[i])
            k.force[i], k.lossy[i] = elastic + lossy, lossy
            k.force_by_w[i], k.force_by_speed[i] = by_w, by_speed

    if config.DISABLE_JIT:
        return CompiledForce(function, at_stages)
    # by default it is random, and code that calls the function would never be found in the cache again
    inner._set_uuid(f"{function.__module__}.{function.__qualname__}")
    return CompiledForce(cfunc(_ONE, cache=True)(function), cfunc(_AT_STAGES, cache=True)(at_stages))


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

    function: CompiledForce
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
def _hertz_damped(stiffness, factor, per_v0, turned_at, w, speed):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """F = K w³ (1 + a δ'/v0)."""
    hertz = stiffness * w * w * w
    damping = factor * per_v0
    pressing = 1.0 + damping * speed
    return hertz, hertz * damping * speed, 0.4 * hertz * w * w, 3.0 * stiffness * w * w * pressing, hertz * damping


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
