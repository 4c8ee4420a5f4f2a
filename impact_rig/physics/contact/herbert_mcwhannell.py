"""Herbert and McWhannell contact.

    F = K δ^(3/2) (1 + a δ'/v0),   a = 6 (1 − e) / [(2e − 1)² + 3]        δ [m], δ', v0 [m/s], F [N] positive in
    compression

Source: Herbert & McWhannell (1977), J. Eng. Ind. 99, 671–674.
Returns 0.534 for e = 0.35.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.base import HystereticLaw


@attrs.frozen
class HerbertMcWhannell(HystereticLaw):
    """Hysteresis factor a = 6 (1 − e) / [(2e − 1)² + 3]."""

    name = "herbert_mcwhannell"

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 6.0 * (1.0 - e) / ((2.0 * e - 1.0) * (2.0 * e - 1.0) + 3.0)
