# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""The factor that returns exactly the asked restitution.

For e = 0.35 the factor is 2.52338.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import HystereticLaw
from impact_rig.physics.restitution import factor_returning


@attrs.frozen
class Exact(HystereticLaw):
    """Hysteresis factor ln[(1 + a) / (1 − a e)] = a (1 + e)."""

    name = "exact"
    formula = "root of ln[(1 + a)/(1 − a e)] = a (1 + e)"
    source = "closed form of the Hunt–Crossley family"
    returns = 0.350

    def hysteresis_factor(self) -> float:
        """Return a, dimensionless."""
        e = self.restitution
        return factor_returning(e)
