# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Gonthier et al. contact, close to the asked restitution over the whole range."""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import HystereticLaw


@attrs.frozen
class Gonthier(HystereticLaw):
    """Hysteresis factor a = (1 − e²) / e."""

    name = "gonthier"
    formula = "(1 − e²)/e"
    source = "Gonthier, McPhee, Lange & Piedbœuf (2004), Multibody Syst. Dyn. 11, 209–233"
    returns = 0.352

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return (1.0 - e * e) / e
