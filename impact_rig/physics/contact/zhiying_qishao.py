"""Zhiying and Qishao contact: Lankarani–Nikravesh corrected for low restitution.

    F = K δ^(3/2) (1 + a δ'/v0),   a = ¾ (1 − e²) exp[2 (1 − e)]        δ [m], δ', v0 [m/s], F [N] positive in
    compression

Source: Qin & Lu (2006), J. Dynamics and Control 4(4), 294–298.
Returns 0.361 for e = 0.35.
"""

from __future__ import annotations

import attrs

from impact_rig.arithmetic.elementary import exp
from impact_rig.physics.contact.base import HystereticLaw


@attrs.frozen
class ZhiyingQishao(HystereticLaw):
    """Hysteresis factor a = ¾ (1 − e²) exp[2 (1 − e)]."""

    name = "zhiying_qishao"

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 0.75 * (1.0 - e * e) * float(exp(2.0 * (1.0 - e)))
