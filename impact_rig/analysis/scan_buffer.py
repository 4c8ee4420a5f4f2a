# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Scans held back for a short while, by their index: where blocks of any length become one stream."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.channels import CHANNELS, status_of
from impact_rig.simtime import NS_PER_S


def scan_index(stamp_ns: int, rate_hz: int, start_ns: int) -> int:
    """Return the index of the scan with this stamp: the inverse of `simtime.stamp_ns`."""
    return ((stamp_ns - start_ns) * rate_hz + NS_PER_S // 2) // NS_PER_S


def first_scan_at(time_ns: int, rate_hz: int, start_ns: int) -> int:
    """Return the index of the first scan at or after an instant (a stamp is its scan's instant)."""
    return -(-(time_ns - start_ns) * rate_hz // NS_PER_S)


class ScanBuffer:
    """Consecutive scans, contiguous in memory per channel; grows to what is held back and the longest block.

    Attributes:
        samples: shape (4, capacity).
        status: shape (capacity,).
        first: index of the scan in column 0.
        end: index after the newest scan.
    """

    def __init__(self) -> None:
        self.samples = np.empty((len(CHANNELS), 0))
        self.status = np.empty(0, dtype=np.uint8)
        self.first = 0
        self.end = 0

    def restart(self, index: int) -> None:
        """Drop everything; the next scan is `index`."""
        self.first = self.end = index

    def renumber(self, index: int) -> None:
        """Call scan `index` scan 0, and what is kept after it accordingly."""
        self.first -= index
        self.end -= index

    def append(self, rows: NDArray[np.void], keep: int) -> None:
        """Add scans; those before index `keep` may be dropped to make room."""
        used, new = self.end - self.first, len(rows)
        if used + new > len(self.status):
            self._make_room(keep, new)
            used = self.end - self.first
        measured = rows.dtype.names or ()
        for j, name in enumerate(CHANNELS):
            self.samples[j, used : used + new] = rows[name] if name in measured else 0.0
        self.status[used : used + new] = status_of(rows)
        self.end += new

    def column(self, index: int) -> int:
        """Return where scan `index` is kept."""
        return index - self.first

    def _make_room(self, keep: int, new: int) -> None:
        left, right = keep - self.first, self.end - self.first
        need = right - left + new
        samples, status = self.samples, self.status
        if 4 * need > len(status):  # at least four times the need: then room is made every third block at most
            self.samples = np.empty((len(CHANNELS), 8 * need))
            self.status = np.empty(8 * need, dtype=np.uint8)
        self.samples[:, : right - left] = samples[:, left:right].copy()
        self.status[: right - left] = status[left:right].copy()
        self.first = keep
