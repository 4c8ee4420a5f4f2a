# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The channels that the analysis needs of a run; a run may have more of them, in any order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.columns import Column, row_type

CHANNELS = ("accelerometer", "laser", "base", "current")
"""By name; arrays over channels have this order."""
ACCELEROMETER, LASER, BASE, CURRENT = range(len(CHANNELS))
_TIME, _STATUS = topics.SCAN.fields
SCAN = row_type((_TIME, *(Column(name, "SI", "") for name in CHANNELS), _STATUS))
"""What a row of `daq/scan` must at least have."""
_FRAME = (_TIME.name, _STATUS.name)


def status_of(rows: NDArray[np.void]) -> NDArray[np.uint8]:
    """Return the status of scans with bit j for channel j of `CHANNELS`, shape (n,), whatever their place in a scan."""
    status: NDArray[np.uint8] = rows["status"]
    found = tuple(name for name in rows.dtype.names or () if name not in _FRAME)
    if found[: len(CHANNELS)] == CHANNELS:
        return status
    ours = np.zeros(len(rows), np.uint8)
    for bit, name in enumerate(CHANNELS):
        ours |= (status >> found.index(name) & 1) << bit
    return ours
