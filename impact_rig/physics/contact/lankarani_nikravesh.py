# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Lankarani and Nikravesh contact: the usual choice of multibody codes, meant for high restitution."""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import HystereticLaw


@attrs.frozen
class LankaraniNikravesh(HystereticLaw):
    """Hysteresis factor a = 3 (1 − e²) / 4."""

    name = "lankarani_nikravesh"
    formula = "3(1 − e²)/4"
    source = "Lankarani & Nikravesh (1990), J. Mech. Des. 112, 369–376"
    returns = 0.692

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 0.75 * (1.0 - e * e)
