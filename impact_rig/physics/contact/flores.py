"""Flores et al. contact: Hertz stiffness with damping set by the approach speed of each contact.

    F = K δ^(3/2) (1 + a δ'/v0),   a = 8 (1 − e) / (5 e)        δ [m], δ', v0 [m/s], F [N] positive in compression

Source: Flores, Machado, Silva & Martins (2011), Multibody Syst. Dyn. 25, 357–375; the paper's Eq. (5).
Returns 0.309 for e = 0.35: the paper's own simulation rebounded less than its drop test.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.base import HystereticLaw


@attrs.frozen
class Flores(HystereticLaw):
    """Hysteresis factor a = 8 (1 − e) / (5 e)."""

    name = "flores"

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 8.0 * (1.0 - e) / (5.0 * e)
