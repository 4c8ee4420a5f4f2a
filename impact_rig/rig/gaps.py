# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Gap of a rig as one number: the distance that the sphere can move between the barriers [m], or 0 without a sphere."""

from __future__ import annotations

import math

from impact_rig.config.tree import Value

NO_SPHERE = 0.0
"""Gap value that represents a rig without the sphere, also in labels of the analysis; a campaign file says `none`."""


def case_of(gap_m: float) -> str:
    """Return a gap [m] as text for users: `gap 6 mm`, `no sphere` for `NO_SPHERE`, or `gap unknown` for NaN."""
    if math.isnan(gap_m):
        return "gap unknown"
    return "no sphere" if gap_m == NO_SPHERE else f"gap {gap_m * 1e3:g} mm"


def gap_values(gap_m: float) -> dict[str, Value]:
    """Return the configuration values, by full name, that give a rig this gap [m], or no sphere for `NO_SPHERE`.

    Without the sphere, the gap between the barriers has no effect and is left out.
    """
    return {"sphere.present": False} if gap_m == NO_SPHERE else {"sphere.present": True, "barriers.gap_m": gap_m}
