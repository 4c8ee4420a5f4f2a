"""Hunt and Crossley contact: the first damping term that vanishes with the indentation.

    F = K δ^(3/2) (1 + a δ'/v0),   a = 3 (1 − e) / 2        δ [m], δ', v0 [m/s], F [N] positive in compression

Source: Hunt & Crossley (1975), J. Appl. Mech. 42, 440–445.
Derived for e close to 1; returns 0.600 for e = 0.35.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.base import HystereticLaw


@attrs.frozen
class HuntCrossley(HystereticLaw):
    """Hysteresis factor a = 3 (1 − e) / 2."""

    name = "hunt_crossley"

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 1.5 * (1.0 - e)
