"""Lee and Wang contact.

    F = K δ^(3/2) (1 + a δ'/v0),   a = 3 (1 − e) / 4        δ [m], δ', v0 [m/s], F [N] positive in compression

Source: Lee & Wang (1983), J. Mech. Trans. Autom. Des. 105, 534–540.
Returns 0.753 for e = 0.35.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.base import HystereticLaw


@attrs.frozen
class LeeWang(HystereticLaw):
    """Hysteresis factor a = 3 (1 − e) / 4."""

    name = "lee_wang"

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 0.75 * (1.0 - e)
