"""Instantaneous restitution: no contact time, the relative speed jumps from v to −e v.

Source: Newton (1687), Principia; the usual model of the impact damper literature before contact forces (Masri 1969).
The sphere's momentum goes to the structure in no time; a sphere that no longer bounces rides on the wall.
"""

from __future__ import annotations

from typing import ClassVar

import attrs

from impact_rig.config import Contact
from impact_rig.physics.contact.base import ContactPair, ForceKind, ForceModel, check_restitution


@attrs.frozen
class Restitution:
    """Coefficient of restitution e."""

    name: ClassVar[str] = "restitution"
    restitution: float = attrs.field(validator=check_restitution)

    def force_model(self, pair: ContactPair) -> ForceModel:  # noqa: ARG002  # an impulse needs no stiffness
        """Return the jump of the relative speed."""
        return ForceModel(ForceKind.IMPULSIVE, 0.0, 0.0, self.restitution, True)

    def realised_restitution(self) -> float:
        """Return e."""
        return self.restitution

    @classmethod
    def from_config(cls, contact: Contact) -> Restitution:
        """Build the law from the configuration's `contact` section."""
        return cls(contact.restitution)
