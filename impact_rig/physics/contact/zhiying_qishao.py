# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
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
