# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The last scans of a stream of blocks, without a gap: what envelopes and spectra for plotters are made of."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import Table, joined
from impact_rig.simtime import NS_PER_S


class Recent:
    """Keeps as many scans as asked for; forgets all when blocks do not follow on one another.

    Args:
        rate_hz: scans per second, from daq/info.
        length: scans that are kept, at least.
    """

    def __init__(self, rate_hz: float, length: int) -> None:
        self._rate_hz = rate_hz
        self._length = length
        self._blocks: deque[Table] = deque()
        self.count = 0
        """Scans that are kept."""

    def follows(self, scan: Table) -> bool:
        """Whether a block goes on where the one before ended; false of the first."""
        return bool(self._blocks) and abs(scan.stamp_ns - self.next_ns()) <= 0.5 * NS_PER_S / self._rate_hz

    def add(self, scan: Table) -> None:
        """Take a block; where it does not follow on the one before, those before are forgotten."""
        if not self.follows(scan):
            self.clear()
        self._blocks.append(scan)
        self.count += len(scan.rows)
        while self.count - len(self._blocks[0].rows) >= self._length:
            self.count -= len(self._blocks.popleft().rows)

    def clear(self) -> None:
        """Forget everything."""
        self._blocks.clear()
        self.count = 0

    def next_ns(self) -> int:
        """Return the stamp of the scan that would come next [ns]."""
        return self.stamp_ns(self.count)

    def stamp_ns(self, number: int) -> int:
        """Return when scan `number` of those that are kept was, or will be [ns]."""
        return self._blocks[0].stamp_ns + int(number * NS_PER_S / self._rate_hz)

    def rows(self) -> NDArray[np.void]:
        """Return the scans that are kept, oldest first."""
        return joined([block.rows for block in self._blocks])
