"""Lankarani and Nikravesh contact: the usual choice of multibody codes, meant for high restitution.

    F = K δ^(3/2) (1 + a δ'/v0),   a = 3 (1 − e²) / 4        δ [m], δ', v0 [m/s], F [N] positive in compression

Source: Lankarani & Nikravesh (1990), J. Mech. Des. 112, 369–376.
Returns 0.692 for e = 0.35.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.base import HystereticLaw


@attrs.frozen
class LankaraniNikravesh(HystereticLaw):
    """Hysteresis factor a = 3 (1 − e²) / 4."""

    name = "lankarani_nikravesh"

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 0.75 * (1.0 - e * e)
