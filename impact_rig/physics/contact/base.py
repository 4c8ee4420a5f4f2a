"""What a contact law is: a name, a restitution, and the force model that the event loop integrates."""

from __future__ import annotations

import enum
import math
from typing import ClassVar, NamedTuple, Protocol

import attrs

from impact_rig.config import Contact
from impact_rig.errors import ConfigError
from impact_rig.physics import restitution as closed_form


class ForceKind(enum.IntEnum):
    """The three shapes of force the event loop knows."""

    HERTZIAN = 0  # F = stiffness δ^1.5 (1 + damping δ'/v0), never tensile
    LINEAR = 1  # F = stiffness δ + damping δ'
    IMPULSIVE = 2  # δ' jumps to −restitution δ'


class ForceModel(NamedTuple):
    """Numbers of one contact; units by kind: N/m^1.5 and 1 for HERTZIAN, N/m and N s/m for LINEAR."""

    kind: int
    stiffness: float
    damping: float
    restitution: float  # used by IMPULSIVE only
    clipped: bool  # whether a tensile force is cut to zero


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

    def force_model(self, pair: ContactPair) -> ForceModel:
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


@attrs.frozen
class HystereticLaw:
    """Hunt–Crossley form F = K δ^1.5 (1 + a δ'/v0); a law of this family says only what `a` is."""

    name: ClassVar[str]
    restitution: float = attrs.field(validator=check_restitution)

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless; the event loop turns it into c = a K / v0 when a contact starts."""
        raise NotImplementedError

    def force_model(self, pair: ContactPair) -> ForceModel:
        """Return the force between the bodies of `pair`."""
        return ForceModel(ForceKind.HERTZIAN, pair.hertz_stiffness, self.hysteresis_factor(), self.restitution, True)

    def realised_restitution(self) -> float:
        """Return e_out from ln[(1 + a)/(1 − a e_out)] = a (1 + e_out)."""
        return closed_form.realised(self.hysteresis_factor())

    @classmethod
    def from_config(cls, contact: Contact) -> HystereticLaw:
        """Build the law from the configuration's `contact` section."""
        return cls(contact.restitution)
