# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Zhiying and Qishao contact: Lankarani–Nikravesh corrected for low restitution."""

from __future__ import annotations

import attrs

from impact_rig.arithmetic.scalars import exp
from impact_rig.physics.contact.law import HystereticLaw


@attrs.frozen
class ZhiyingQishao(HystereticLaw):
    """Hysteresis factor a = ¾ (1 − e²) exp[2 (1 − e)]."""

    name = "zhiying_qishao"
    formula = "¾(1 − e²) exp(2(1 − e))"
    source = "Qin & Lu (2006), J. Dynamics and Control 4(4), 294–298"
    returns = 0.361

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 0.75 * (1.0 - e * e) * exp(2.0 * (1.0 - e))
