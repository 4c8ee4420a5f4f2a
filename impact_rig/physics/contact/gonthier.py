# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
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
