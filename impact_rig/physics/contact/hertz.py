# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
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
