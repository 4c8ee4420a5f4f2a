"""Hertz contact without damping: the elastic limit and an oracle.

    F = K δ^(3/2) (1 + a δ'/v0),   a = 0        δ [m], δ', v0 [m/s], F [N] positive in compression

Source: Hertz (1882), J. Reine Angew. Math. 92, 156–171.
Returns 1 whatever the nominal restitution.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.base import HystereticLaw


@attrs.frozen
class Hertz(HystereticLaw):
    """Hysteresis factor a = 0."""

    name = "hertz"

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        return 0.0
