"""Walton–Braun contact: loading along one line, unloading along a steeper one; no damping, a loss by plastic yielding.

    loading    F = k_1 δ
    unloading  F = k_2 (δ − δ_p),   k_2 = k_1 / e²,   δ_p = (1 − e²) δ_max        below the largest indentation δ_max

Source: Walton & Braun (1986), J. Rheology 30, 949–980, with a constant coefficient of restitution. Returns e, whatever
the speed: the areas under the two lines are as 1 : e². The sphere lets go at δ_p, where the force is gone, and flies on
from there; the dent belongs to one contact. k_1 follows from the contact time, a quarter period on each line:
t_c = (π/2) (1 + e) √(m_eff / k_1).

A pressed sphere rings on the unloading line for ever. Below `contact.speed_floor_m_s` the ringing is averaged: sphere
and base go on as one body, and its energy is booked as lost.
"""

from __future__ import annotations

from typing import ClassVar

import attrs

from impact_rig.arithmetic.elementary import PI
from impact_rig.config import Contact
from impact_rig.physics.contact.base import ContactPair, Force, check_restitution, compiled_force


@compiled_force
def _elastoplastic(stiffness, factor, per_v0, turned_at, w, speed):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """F on the loading line, or on the unloading line from where it turned; factor is e²."""
    if turned_at == 0.0:
        force = stiffness * w * w
        return factor * force, (1.0 - factor) * force, 0.5 * factor * force * w * w, 2.0 * stiffness * w, 0.0
    unloading = stiffness / factor
    pressed = w * w - (1.0 - factor) * turned_at * turned_at
    return unloading * pressed, 0.0, 0.5 * unloading * pressed * pressed, 2.0 * unloading * w, 0.0


@attrs.frozen
class WaltonBraun:
    """Elastoplastic contact with restitution e and contact time t_c [s]."""

    name: ClassVar[str] = "walton_braun"
    restitution: float = attrs.field(validator=check_restitution)
    contact_time_s: float = attrs.field(default=45e-6, validator=attrs.validators.gt(0.0))

    def loading_stiffness(self, pair: ContactPair) -> float:
        """Return k_1 [N/m]."""
        per_root = 2.0 * self.contact_time_s / (PI * (1.0 + self.restitution))
        return pair.effective_mass / (per_root * per_root)

    def force(self, pair: ContactPair) -> Force:
        """Return the force between the bodies of `pair`."""
        squared = self.restitution * self.restitution
        return Force(_elastoplastic, self.loading_stiffness(pair), squared, 1.0, self.restitution, remembers=True)

    def realised_restitution(self) -> float:
        """Return e."""
        return self.restitution

    @classmethod
    def from_config(cls, contact: Contact) -> WaltonBraun:
        """Build the law from the configuration's `contact` section."""
        return cls(contact.restitution, contact.contact_time_s)
