# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Herbert and McWhannell contact."""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import HystereticLaw


@attrs.frozen
class HerbertMcWhannell(HystereticLaw):
    """Hysteresis factor a = 6 (1 − e) / [(2e − 1)² + 3]."""

    name = "herbert_mcwhannell"
    formula = "6(1 − e)/((2e − 1)² + 3)"
    source = "Herbert & McWhannell (1977), J. Eng. Ind. 99, 671–674"
    returns = 0.534

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 6.0 * (1.0 - e) / ((2.0 * e - 1.0) * (2.0 * e - 1.0) + 3.0)
