# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Scans at monitor rate, for plotters.

Scans at 10 kS/s shown at 50 Hz would fold every pulse into nonsense, so readings go through a low-pass first: a
windowed sinc (Kaiser, beta 5; Oppenheim and Schafer, Discrete-Time Signal Processing, section 7.5) as long as eight
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

from impact_rig.blocks import joined

HALF_PERIODS = 4  # half the filter's length, in monitor periods: how much later than its stamp a message comes
CUTOFF = 0.4  # middle of the transition, over the monitor rate
BETA = 5.0


@functools.lru_cache(maxsize=4)
def taps(step: int) -> NDArray[np.float64]:
    """Return the filter for a monitor of every `step`-th scan, shape (8 step + 1,), of sum 1."""
    if step == 1:
        return np.ones(1)
    offsets = np.arange(-HALF_PERIODS * step, HALF_PERIODS * step + 1)
    weights = np.sinc(2.0 * CUTOFF * offsets / step) * np.kaiser(len(offsets), BETA)
    found: NDArray[np.float64] = weights / weights.sum()
    return found


@attrs.frozen
class Smoothed:
    """A monitor instant: its scan since the start, the filtered channels, and the channels that were over range."""

    sample: int
    values: dict[str, float]
    status: int


class AntiAlias:
    """Filters a stream of scans at the monitor instants.

    Blocks are kept as they came, and joined only for an instant that is wanted.

    Args:
        step: scans per monitor period.
    """

    def __init__(self, channels: Iterable[str], step: int) -> None:
        self.channels, self.step = tuple(channels), step
        self._taps = taps(step)
        self.half = len(self._taps) // 2  # scans on either side of an instant that the filter weighs
        self._kept: deque[NDArray[np.void]] = deque()
        self._begin = self._end = -1  # numbers of the first scan that is kept, and of the one after the last
        self._due: deque[int] = deque()

    def feed(
        self, first: int, rows: NDArray[np.void], instants: Iterable[int], wanted: bool = True
    ) -> Iterator[Smoothed]:
        """Yield the instants that a block completes; after a gap, as after a reset, a new stream begins.

        At the beginning of a stream the filter is cut where there are no scans, and weighs what there is.

        Args:
            first: number of the block's first scan.
            rows: of daq/scan.
            instants: monitor instants in the block, numbered like the scans.
            wanted: whether anybody wants them; otherwise the block is only kept for instants to come.
        """
        if first != self._end:
            self._due.clear()
            self._kept.clear()
            self._begin = first
        self._kept.append(rows)
        self._end = first + len(rows)
        self._due.extend(instants)
        while self._due and self._due[0] + self.half < self._end:
            sample = self._due.popleft()
            if wanted:
                yield self._smoothed(sample)
        oldest = (self._due[0] if self._due else self._end) - self.half - self.step
        while self._begin + len(self._kept[0]) <= oldest:
            self._begin += len(self._kept.popleft())

    def _smoothed(self, sample: int) -> Smoothed:
        kept, centre = joined(self._kept), sample - self._begin
        left = max(0, centre - self.half)
        weights = self._taps[left - centre + self.half :]
        part = kept[left : centre + self.half + 1]
        columns = np.empty((len(self.channels), len(part)))
        for column, name in zip(columns, self.channels, strict=True):
            np.multiply(part[name], weights, out=column)
        sums = np.add.reduce(columns, axis=1) / np.add.reduce(weights)
        near = kept["status"][max(0, centre - self.step + 1) : centre + self.step]
        return Smoothed(sample, dict(zip(self.channels, sums.tolist(), strict=True)), int(np.bitwise_or.reduce(near)))
