# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Hunt and Crossley contact: the first damping term that vanishes with the indentation.

Derived for e close to 1.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import HystereticLaw


@attrs.frozen
class HuntCrossley(HystereticLaw):
    """Hysteresis factor a = 3 (1 − e) / 2."""

    name = "hunt_crossley"
    formula = "3(1 − e)/2"
    source = "Hunt & Crossley (1975), J. Appl. Mech. 42, 440–445"
    returns = 0.600

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return 1.5 * (1.0 - e)
