# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`Block`: what the rig hands out, one per `daq.block_scans` scans."""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import Table


@attrs.frozen(eq=False)
class Block:
    """Consecutive scans and what is true about them.

    Attributes:
        number: blocks since the start or reset.
        first_sample: index of the first scan since the start or reset.
        end_ns: stamp of the first scan after the block: when it is complete.
        scan: `daq/scan`.
        impacts: `truth/impacts`: the contacts that ended in this block; None if there were none.
        monitor: true state at the monitor instants, rows of `blocks.TRUTH_SCAN`, time since the stamp of `scan`.
        monitor_scans: rows of `scan` at the monitor instants.
        truth: `truth/scan`, if asked for.
        faults: `truth/faults`: faults that start or end in this block; None if there are none.
        lost: a lost_block fault is active: the block is numbered but must not be published.
    """

    number: int
    first_sample: int
    end_ns: int
    scan: Table
    impacts: Table | None
    monitor: NDArray[np.void]
    monitor_scans: NDArray[np.int64]
    truth: Table | None
    faults: Table | None
    lost: bool
