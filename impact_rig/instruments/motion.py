# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""What an instrument needs to see of a motion: `impact_rig.physics.Motion` has it, and any analytic motion can."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Motion(Protocol):
    """Quantities of the rig as functions of (segment, offset within it); a segment is one 10 ms tick."""

    @property
    def impacts(self) -> NDArray[np.void]:
        """Contacts, with fields segment, offset [s], wall (-1 left, +1 right), impulse [N s] and duration [s]."""

    def quantities(
        self, names: tuple[str, ...], segment: NDArray[np.int64], offset_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return some quantities (SI) at each instant, shape (names, n)."""

    def breakpoints(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the instants (segment, offset [s]), in order, between which every quantity is smooth."""
