# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
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
