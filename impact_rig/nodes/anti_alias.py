# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The low-pass ahead of the monitor topics: scans at 10 kS/s shown at 50 Hz would fold every pulse into nonsense.

A windowed sinc (Kaiser, beta 5; Oppenheim and Schafer, Discrete-Time Signal Processing, section 7.5) as long as eight
monitor periods, centred at the scan whose stamp the message has: no phase is lost, and the message comes four periods
later. With f_m the monitor rate the gain is within 0.5 % of 1 up to 0.2 f_m and below 0.4 % from 0.6 f_m on, so that
nothing folds to below 0.4 f_m. The truth is never filtered.
"""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Iterable, Iterator

import attrs
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HALF_PERIODS = 4
"""Half the filter's length, in monitor periods: how much later than its stamp a message comes."""
CUTOFF = 0.4
"""Middle of the transition, over the monitor rate."""
BETA = 5.0


@functools.lru_cache(maxsize=4)
def taps(step: int) -> Array:
    """Return the filter for a monitor of every `step`-th scan, shape (8 step + 1,), of sum 1."""
    if step == 1:
        return np.ones(1)
    offsets = np.arange(-HALF_PERIODS * step, HALF_PERIODS * step + 1)
    weights = np.sinc(2.0 * CUTOFF * offsets / step) * np.kaiser(len(offsets), BETA)
    found: Array = weights / weights.sum()
    return found


@attrs.frozen
class Smoothed:
    """A monitor instant: its scan since the start, the filtered channels, and the channels that were over range."""

    sample: int
    values: dict[str, float]
    status: int


class AntiAlias:
    """Filters a stream of scans at the monitor instants.

    Args:
        channels: columns that are wanted.
        step: scans per monitor period.
    """

    def __init__(self, channels: Iterable[str], step: int) -> None:
        self._channels = tuple(channels)
        self._step = step
        self._taps = taps(step)
        self._half = len(self._taps) // 2
        self._scans = np.zeros((len(self._channels), 0))
        self._status = np.zeros(0, np.uint8)
        self._first = self._next = 0  # numbers of the first scan that is kept, and of the one after the last
        self._due: deque[int] = deque()

    def feed(self, first: int, rows: NDArray[np.void], instants: Iterable[int]) -> Iterator[Smoothed]:
        """Yield the instants that a block completes; after a gap, as after a reset, a new stream begins.

        At the beginning of a stream the filter is cut where there are no scans, and weighs what there is.

        Args:
            first: number of the block's first scan.
            rows: of daq/scan.
            instants: monitor instants in the block, numbered like the scans.
        """
        if first != self._next:
            self._due.clear()
            self._first = self._next = first
        self._make_room(len(rows))
        begin, end = self._next - self._first, self._next - self._first + len(rows)
        for kept, name in zip(self._scans, self._channels, strict=True):
            kept[begin:end] = rows[name]
        self._status[begin:end] = rows["status"]
        self._next += len(rows)
        self._due.extend(instants)
        while self._due and self._due[0] + self._half < self._next:
            yield self._smoothed(self._due.popleft())

    def _make_room(self, count: int) -> None:
        """Forget what no instant needs any more, once the room for so many more scans is used up."""
        if self._next - self._first + count <= len(self._status):
            return
        oldest = (self._due[0] if self._due else self._next) - self._half - self._step
        used, begin = self._next - self._first, max(0, oldest - self._first)
        kept, flags = self._scans[:, begin:used], self._status[begin:used]
        room = 2 * (used - begin + count)
        self._scans, self._status = np.zeros((len(self._channels), room)), np.zeros(room, np.uint8)
        self._scans[:, : used - begin], self._status[: used - begin] = kept, flags
        self._first += begin

    def _smoothed(self, sample: int) -> Smoothed:
        centre = sample - self._first
        left = max(0, centre - self._half)
        weights = self._taps[left - centre + self._half :]
        sums = (self._scans[:, left : centre + self._half + 1] * weights).sum(axis=1) / weights.sum()
        near = self._status[max(0, centre - self._step + 1) : centre + self._step]
        return Smoothed(sample, dict(zip(self._channels, sums.tolist(), strict=True)), int(np.bitwise_or.reduce(near)))
