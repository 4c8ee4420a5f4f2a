# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
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
