# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Flores et al. contact: Hertz stiffness with damping set by the approach speed of each contact.

It returns 0.309 for e = 0.35: the paper's own simulation rebounded less than its drop test.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import HystereticLaw


@attrs.frozen
class Flores(HystereticLaw):
    """Hysteresis factor a = 8 (1 − e) / (5 e)."""

    name = "flores"
    formula = "8(1 − e)/(5e)"
    source = "Flores, Machado, Silva & Martins (2011), Multibody Syst. Dyn. 25, 357–375; the paper's Eq. (5)"
    returns = 0.309

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 8.0 * (1.0 - e) / (5.0 * e)
