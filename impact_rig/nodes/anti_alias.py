# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
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
        self._blocks: deque[tuple[Array, NDArray[np.uint8]]] = deque()  # channels (channel, scan), status
        self._first = self._next = 0
        self._due: deque[int] = deque()

    def feed(self, first: int, rows: NDArray[np.void], instants: Iterable[int]) -> Iterator[Smoothed]:
        """Yield the instants that a block completes; after a gap, as after a reset, a new stream begins.

        At the beginning of a stream the filter is cut where there are no scans, and weighs what there is.

        Args:
            first: number of the block's first scan.
            rows: of daq/scan.
            instants: monitor instants in the block, numbered like the scans.
        """
        if first != self._next or not self._blocks:
            self._blocks.clear()
            self._due.clear()
            self._first = first
        self._blocks.append((np.array([rows[name] for name in self._channels]), rows["status"].copy()))
        self._next = first + len(rows)
        self._due.extend(instants)
        if self._due and self._due[0] + self._half < self._next:
            scans = np.concatenate([values for values, _ in self._blocks], axis=1)
            status = np.concatenate([flags for _, flags in self._blocks])
            while self._due and self._due[0] + self._half < self._next:
                yield self._smoothed(scans, status, self._due.popleft())
        oldest = (self._due[0] if self._due else self._next) - self._half - self._step
        while len(self._blocks) > 1 and self._first + len(self._blocks[0][1]) <= oldest:
            self._first += len(self._blocks.popleft()[1])

    def _smoothed(self, scans: Array, status: NDArray[np.uint8], sample: int) -> Smoothed:
        centre = sample - self._first
        left = max(0, centre - self._half)
        weights = self._taps[left - centre + self._half :]
        sums = (scans[:, left : centre + self._half + 1] * weights).sum(axis=1) / weights.sum()
        near = status[max(0, centre - self._step + 1) : centre + self._step]
        return Smoothed(sample, dict(zip(self._channels, sums.tolist(), strict=True)), int(np.bitwise_or.reduce(near)))
