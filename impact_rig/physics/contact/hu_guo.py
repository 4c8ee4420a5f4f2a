"""Hu and Guo contact.

    F = K δ^(3/2) (1 + a δ'/v0),   a = 3 (1 − e) / (2 e)        δ [m], δ', v0 [m/s], F [N] positive in compression

Source: Hu & Guo (2015), A dissipative contact force model for impact analysis in multibody dynamics, Multibody Syst.
Dyn. 35, 131–151.
Returns 0.325 for e = 0.35.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.base import HystereticLaw


@attrs.frozen
class HuGuo(HystereticLaw):
    """Hysteresis factor a = 3 (1 − e) / (2 e)."""

    name = "hu_guo"

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 1.5 * (1.0 - e) / e
