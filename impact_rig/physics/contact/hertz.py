# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Hertz contact without damping: the elastic limit and an oracle.

It returns 1 whatever the nominal restitution.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import HystereticLaw


@attrs.frozen
class Hertz(HystereticLaw):
    """Hysteresis factor a = 0."""

    name = "hertz"
    formula = "0"
    source = "Hertz (1882), J. Reine Angew. Math. 92, 156–171"
    returns = 1.0
    adjustable = False

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        return 0.0
