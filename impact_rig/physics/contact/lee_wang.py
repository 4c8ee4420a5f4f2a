# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Lee and Wang contact."""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import HystereticLaw


@attrs.frozen
class LeeWang(HystereticLaw):
    """Hysteresis factor a = 3 (1 − e) / 4."""

    name = "lee_wang"
    formula = "3(1 − e)/4"
    source = "Lee & Wang (1983), J. Mech. Trans. Autom. Des. 105, 534–540"
    returns = 0.753

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 0.75 * (1.0 - e)
