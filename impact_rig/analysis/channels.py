# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The channels that the analysis knows of a run; a run may have more of them, in any order, or lack some.

A measurement of somebody's own rig may lack a channel: neither `daq/info` nor `daq/scan` has it then. Transmissibility
needs `laser` and `base`; without `accelerometer` no impacts are counted, without `current` it has no amplitude.
"""

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
"""A row of `daq/scan` with every one of them."""
_FRAME = (_TIME.name, _STATUS.name)


def status_of(rows: NDArray[np.void]) -> NDArray[np.uint8]:
    """Return the status of scans with bit j for channel j of `CHANNELS`, shape (n,), whatever their place in a scan."""
    status: NDArray[np.uint8] = rows["status"]
    found = tuple(name for name in rows.dtype.names or () if name not in _FRAME)
    if found[: len(CHANNELS)] == CHANNELS:
        return status
    ours = np.zeros(len(rows), np.uint8)
    for bit, name in enumerate(CHANNELS):
        if name in found:
            ours |= (status >> found.index(name) & 1) << bit
    return ours


def samples_of(rows: NDArray[np.void], name: str) -> NDArray[np.float64]:
    """Return a channel of scans, shape (n,): zeros where it was not measured."""
    present = name in (rows.dtype.names or ())
    return np.array(rows[name], dtype=np.float64) if present else np.zeros(len(rows))
