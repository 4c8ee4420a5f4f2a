"""The factor that returns exactly the asked restitution.

    F = K δ^(3/2) (1 + a δ'/v0),   ln[(1 + a) / (1 − a e)] = a (1 + e)        δ [m], δ', v0 [m/s], F [N] positive in
    compression

Source: closed form of the Hunt–Crossley family, see `impact_rig.physics.restitution`.
Returns e: 0.350 for e = 0.35, with a = 2.52338.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.base import HystereticLaw
from impact_rig.physics.restitution import factor_returning


@attrs.frozen
class Exact(HystereticLaw):
    """Hysteresis factor ln[(1 + a) / (1 − a e)] = a (1 + e)."""

    name = "exact"

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return factor_returning(e)
