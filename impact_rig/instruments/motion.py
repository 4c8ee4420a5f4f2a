# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
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
