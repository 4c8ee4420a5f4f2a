# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Hu and Guo contact."""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import HystereticLaw


@attrs.frozen
class HuGuo(HystereticLaw):
    """Hysteresis factor a = 3 (1 − e) / (2 e)."""

    name = "hu_guo"
    formula = "3(1 − e)/(2e)"
    source = "Hu & Guo (2015), Multibody Syst. Dyn. 35, 131–151"
    returns = 0.325

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 1.5 * (1.0 - e) / e
