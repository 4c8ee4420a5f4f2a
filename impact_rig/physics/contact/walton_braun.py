# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Walton–Braun contact: loading along one line, unloading along a steeper one; no damping, a loss by plastic yielding.

    loading    F = k_1 δ
    unloading  F = k_2 (δ − δ_p),   k_2 = k_1 / e²,   δ_p = (1 − e²) δ_max        below the largest indentation δ_max

With a constant coefficient of restitution, which it returns whatever the speed: the areas under the two lines are as
1 : e². The sphere lets go at δ_p, where the force is gone, and flies on from there; the dent belongs to one contact.
k_1 follows from the contact time, a quarter period on each line: t_c = (π/2) (1 + e) √(m_eff / k_1).

A pressed sphere rings on the unloading line for ever. Below `contact.speed_floor_m_s` the ringing is averaged: sphere
and base go on as one body, and its energy is booked as lost.
"""

from __future__ import annotations

import attrs

from impact_rig.arithmetic.scalars import PI
from impact_rig.physics.contact.law import ContactLaw, ContactPair, Force, contact_time_s


def _elastoplastic(
    stiffness: float,
    factor: float,
    per_v0: float,  # noqa: ARG001  # this force knows no speed
    turned_at: float,
    w: float,
    speed: float,  # noqa: ARG001  # as above
) -> tuple[float, float, float, float, float]:
    """F on the loading line, or on the unloading line from where it turned; factor is e²."""
    if turned_at == 0.0:
        force = stiffness * w * w
        return factor * force, (1.0 - factor) * force, 0.5 * factor * force * w * w, 2.0 * stiffness * w, 0.0
    unloading = stiffness / factor
    pressed = w * w - (1.0 - factor) * turned_at * turned_at
    return unloading * pressed, 0.0, 0.5 * unloading * pressed * pressed, 2.0 * unloading * w, 0.0


@attrs.frozen
class WaltonBraun(ContactLaw):
    """Elastoplastic contact with restitution e and contact time t_c [s]."""

    name = "walton_braun"
    formula = "loading along k_1 δ, unloading along k_1/e² (δ − δ_p), no damping"
    source = "Walton & Braun (1986), J. Rheology 30, 949–980"
    returns = 0.350
    contact_time_s: float = contact_time_s()

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
