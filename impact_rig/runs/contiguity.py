# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Whether the blocks of `daq/scan` follow each other without a gap, judged by their stamps alone.

The stamp of scan i is `start_ns + i * 10**9 // rate_hz`: exact integers, so that one missing scan in an hour shows.
"""

from __future__ import annotations

from collections.abc import Iterable

import attrs
import numpy as np

from impact_rig.blocks import Table
from impact_rig.simtime import NS_PER_S


@attrs.frozen
class Gap:
    """A place where blocks do not follow each other.

    Attributes:
        block: number of the block after the gap, counted from 0.
        expected_ns: stamp it should have.
        stamp_ns: stamp it has.
        missing_scans: scans between the two; negative if the stamp went back (a reset, a block twice or out of order);
            0 if the stamp is none a scan can have.
    """

    block: int
    expected_ns: int
    stamp_ns: int
    missing_scans: int


@attrs.frozen
class Contiguity:
    """What the stamps of a sequence of blocks say.

    Attributes:
        blocks: how many there are.
        scans: how many scans they hold.
        gaps: where they do not follow each other, in order.
        lost_blocks: blocks that would fill the gaps, counted in blocks as long as the one before each gap, rounded up.
        lost_scans: scans that would fill the gaps.
        restarts: how often the stamps went back.
    """

    blocks: int
    scans: int
    gaps: tuple[Gap, ...]
    lost_blocks: int
    lost_scans: int
    restarts: int

    @property
    def whole(self) -> bool:
        """Whether nothing is missing and nothing comes twice."""
        return not self.gaps


def check_contiguity(blocks: Iterable[tuple[int, int]], rate_hz: int, start_ns: int | None = None) -> Contiguity:
    """Check that blocks follow each other.

    Args:
        blocks: stamp [ns] and number of scans of each, in the order they are to be judged.
        rate_hz: scans per second.
        start_ns: rig time of scan 0. None: unknown; then the first block anchors the index (and again one whose stamp
            does not fit, so that a rig started anew counts as one gap), and where the scan period is no whole number of
            nanoseconds a stamp may be off by the one nanosecond that its unknown index leaves open.
    """
    period_exact = NS_PER_S % rate_hz == 0
    slack = 0 if start_ns is not None or period_exact else 1
    count = scans = lost_blocks = lost_scans = restarts = 0
    gaps: list[Gap] = []
    anchor_ns = start_ns
    index = before = 0  # of the next scan, counted from the anchor; scans of the block before
    for stamp, length in blocks:
        if anchor_ns is None:
            anchor_ns = stamp
        elif count == 0:
            index = _nearest_index(stamp - anchor_ns, rate_hz)
        expected = anchor_ns + index * NS_PER_S // rate_hz
        if abs(stamp - expected) > slack:
            found = _nearest_index(stamp - anchor_ns, rate_hz)
            missing = found - index
            gaps.append(Gap(count, expected, stamp, missing))
            if missing > 0:
                lost_scans += missing
                lost_blocks += -(-missing // max(before or length, 1))
            elif missing < 0:
                restarts += 1
            index = found
            if start_ns is None and abs(stamp - (anchor_ns + found * NS_PER_S // rate_hz)) > slack:
                anchor_ns, index = stamp, 0
        count, scans, index, before = count + 1, scans + length, index + length, length
    return Contiguity(count, scans, tuple(gaps), lost_blocks, lost_scans, restarts)


def scan_rate_hz(table: Table) -> int | None:
    """Return the rate of a block from its `time` column, or None with fewer than two scans."""
    names = table.rows.dtype.names or ()
    if "time" not in names or len(table.rows) < 2:
        return None
    times = table.rows["time"].astype(np.float64)
    span = float(times[-1] - times[0])
    return round((len(times) - 1) / span) if span > 0 else None


def _nearest_index(elapsed_ns: int, rate_hz: int) -> int:
    """Return the scan index whose stamp is nearest to `elapsed_ns` after the anchor."""
    return (2 * elapsed_ns * rate_hz + NS_PER_S) // (2 * NS_PER_S)
