"""Gonthier et al. contact, close to the asked restitution over the whole range.

    F = K δ^(3/2) (1 + a δ'/v0),   a = (1 − e²) / e        δ [m], δ', v0 [m/s], F [N] positive in compression

Source: Gonthier, McPhee, Lange & Piedbœuf (2004), Multibody Syst. Dyn. 11, 209–233.
Returns 0.352 for e = 0.35.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.base import HystereticLaw


@attrs.frozen
class Gonthier(HystereticLaw):
    """Hysteresis factor a = (1 − e²) / e."""

    name = "gonthier"

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return (1.0 - e * e) / e
