"""Instantaneous restitution: no contact time, the relative speed jumps from v to −e v.

Source: Newton (1687), Principia; the usual model of the impact damper literature before contact forces (Masri 1969).
The sphere's momentum goes to the structure in no time; a sphere that no longer bounces rides on the wall.
"""

from __future__ import annotations

from typing import ClassVar

import attrs

from impact_rig.config import Contact
from impact_rig.physics.contact.base import ContactPair, Force, check_restitution, compiled_force


@compiled_force
def _never(stiffness, factor, per_v0, turned_at, w, speed):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Return no force: a rigid wall is never indented."""
    return 0.0, 0.0, 0.0, 0.0, 0.0


@attrs.frozen
class Restitution:
    """Coefficient of restitution e."""

    name: ClassVar[str] = "restitution"
    restitution: float = attrs.field(validator=check_restitution)

    def force(self, pair: ContactPair) -> Force:  # noqa: ARG002  # an impulse needs no stiffness
        """Return a rigid wall."""
        return Force(_never, 0.0, 0.0, 1.0, self.restitution, rigid=True)

    def realised_restitution(self) -> float:
        """Return e."""
        return self.restitution

    @classmethod
    def from_config(cls, contact: Contact) -> Restitution:
        """Build the law from the configuration's `contact` section."""
        return cls(contact.restitution)
