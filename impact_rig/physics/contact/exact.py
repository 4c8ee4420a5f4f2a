# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The factor that returns exactly the asked restitution.

For e = 0.35 the factor is 2.52338.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import HystereticLaw
from impact_rig.physics.restitution import factor_returning


@attrs.frozen
class Exact(HystereticLaw):
    """Hysteresis factor ln[(1 + a) / (1 − a e)] = a (1 + e)."""

    name = "exact"
    formula = "root of ln[(1 + a)/(1 − a e)] = a (1 + e)"
    source = "closed form of the Hunt–Crossley family"
    returns = 0.350

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return factor_returning(e)
