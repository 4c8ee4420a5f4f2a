# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Low-pass filter that reduces scans to the monitor rate, for the topics that plotters show.

Without a filter, pulses in the scans would alias at the low monitor rate. The filter is a windowed sinc (Kaiser, beta
5; Oppenheim and Schafer, Discrete-Time Signal Processing, section 7.5). Its window is eight monitor periods long and
centred at the scan whose stamp the message has. It therefore causes no phase error, but a message is published four
periods after its stamp. With f_m the monitor rate, the gain is within 0.5 % of 1 up to 0.2 f_m. From 0.6 f_m on it is
below 0.4 %, so that nothing is aliased to below 0.4 f_m. The truth is never filtered.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import PI, sincos
from impact_rig.kernels import BYTES, INTEGERS, REALS, REALS_2D, Bytes, Integers, Reals, entry

HALF_PERIODS = 4  # half the filter's length in monitor periods: the delay of a message after its stamp
CUTOFF = 0.4  # middle of the transition, as a part of the monitor rate
BETA = 5.0
_WINDOWS = 2 * HALF_PERIODS + 1  # number of windows that contain one scan
_BESSEL_TERMS = 20  # of I_0 up to BETA: the remainder is below rounding


@functools.lru_cache(maxsize=4)
def taps(step: int) -> NDArray[np.float64]:
    """Return the weights of the low-pass filter for a monitor that shows every `step`-th scan.

    Their sum is 1. Their shape is (8 step + 1,), or (1,) for step 1, which needs no filter.
    """
    if step == 1:
        return np.ones(1)
    offsets = np.arange(-HALF_PERIODS * step, HALF_PERIODS * step + 1)
    angles = [2.0 * PI * CUTOFF * (offset / step) for offset in offsets.tolist()]
    sinc = np.array([sincos(angle)[0] / angle if angle else 1.0 for angle in angles])
    share = offsets / (HALF_PERIODS * step)
    square = 0.25 * BETA * BETA * (1.0 - share * share)
    term, window = np.ones(len(offsets)), np.ones(len(offsets))  # Kaiser's window up to a factor: I_0(2 √square)
    for k in range(1, _BESSEL_TERMS):
        term *= square / (k * k)
        window += term
    weights = sinc * window
    found: NDArray[np.float64] = weights / math.fsum(weights)
    return found


@attrs.frozen
class Smoothed:
    """Filtered readings at one instant of the monitor topics.

    Attributes:
        sample: index of the scan at this instant, since the start or reset.
        values: filtered reading by channel.
        status: bit j is set if the channel of row j of `daq/info` was over range or clipped in a scan between the
            previous and the next monitor instant.
    """

    sample: int
    values: dict[str, float]
    status: int


class AntiAlias:
    """Low-pass filter of consecutive scans, which gives readings at the monitor instants: every `step`-th scan.

    The filter works block by block and keeps no scans.

    Args:
        channels: columns to filter.
        step: scans per monitor period.
    """

    def __init__(self, channels: Iterable[str], step: int) -> None:
        self.channels, self.step = tuple(channels), step
        self._weights = taps(step)
        self.half = len(self._weights) // 2  # number of scans on either side of an instant that the filter weights
        self._sums = np.zeros((_WINDOWS, 1 + len(self.channels)))
        self._statuses = np.zeros(_WINDOWS, np.int64)
        self._begin = self._end = -1  # numbers of the stream's first scan, and of the one after the last
        self._type: np.dtype[np.void] | None = None  # type of the rows, and offsets of the columns in one
        self._layout = np.zeros(0, np.int64)

    def feed(self, first: int, rows: NDArray[np.void]) -> list[Smoothed]:
        """Filter a block of scans, and return the readings at the monitor instants whose windows it completes.

        If the block does not directly follow the previous block, for example after lost scans or a reset, the filter
        restarts. The first windows after a restart are truncated to the scans that exist.

        Args:
            first: number of the block's first scan.
            rows: rows of daq/scan.
        """
        if first != self._end:
            self._begin = first
            self._sums[:], self._statuses[:] = 0.0, 0
        if rows.dtype is not self._type:
            columns = rows.dtype.fields
            assert columns is not None
            self._type = rows.dtype
            self._layout = np.array([rows.itemsize, *(columns[name][1] for name in ("status", *self.channels))])
        self._end = first + len(rows)
        done = np.empty((len(rows) // self.step + 1, 2 + len(self.channels)))
        data: NDArray[np.uint8] = np.ndarray((rows.nbytes,), np.uint8, rows)
        scans = max(self._begin, first - self.half), first, self.step
        count = _weigh(data, self._layout, *scans, self._weights, self._sums, self._statuses, done)
        return [
            Smoothed(int(sample), dict(zip(self.channels, values, strict=True)), int(status))
            for sample, status, *values in done[:count].tolist()
        ]


@entry(BYTES, INTEGERS, int, int, int, REALS, REALS_2D, INTEGERS, REALS_2D, returns=int)
def _weigh(
    rows: Bytes,
    layout: Integers,
    least: int,
    first: int,
    step: int,
    weights: Reals,
    sums: Reals,
    statuses: Integers,
    done: Reals,
) -> int:
    """Add a block of scans to the filter windows that contain them; return how many windows end in the block.

    Args:
        rows: rows of scans as bytes.
        layout: bytes per row, byte position of the status in a row, and byte positions of the channels.
        least: number of the first scan that can be the centre of an unfinished window; windows around earlier scans are
            ignored.
        first: number of the first scan of the block.
        step: scans per monitor period.
        weights: weights of a window's scans.
        sums: for each window the sum of the weights used so far, followed by the weighted sum of each channel; updated.
            Window k is in row k modulo the number of rows.
        statuses: for each window the status bits that any scan less than one monitor period from its centre has set;
            updated.
        done: output for each window that ends in the block: number of the scan at its centre, status, means by channel.
    """
    half = weights.shape[0] // 2
    end = first + rows.shape[0] // layout[0]
    count = 0
    for window in range(-(-least // step), (end - 1 + half) // step + 1):
        centre, total = window * step, sums[window % sums.shape[0]]
        for scan in range(max(first, centre - half), min(end, centre + half + 1)):
            place, weight = (scan - first) * layout[0], weights[scan - centre + half]
            total[0] += weight
            for j in range(1, total.shape[0]):
                begin = place + layout[1 + j]
                total[j] += weight * rows[begin : begin + 8].view(np.float64)[0]
            if abs(scan - centre) < step:
                statuses[window % sums.shape[0]] |= rows[place + layout[1]]
        if centre + half < end:
            done[count, 0], done[count, 1] = centre, statuses[window % sums.shape[0]]
            for j in range(1, total.shape[0]):
                done[count, 1 + j] = total[j] / total[0]
            total[:] = 0.0
            statuses[window % sums.shape[0]] = 0
            count += 1
    return count
