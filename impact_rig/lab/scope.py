# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""What the scope draws: the newest scans in a ring, and any window of them as minimum and maximum per picture column.

Every scan is in the pair of exactly one column, so a pulse of one scan is seen at any zoom.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import Table
from impact_rig.instruments.scan import CHANNELS
from impact_rig.simtime import NS_PER_S

LONGEST_S = 10.0
"""The longest window that can be drawn."""
HELD_S = 12.0
"""Scans kept: the longest window, and some to find a trigger in."""
COARSE_S = 0.002
"""Pairs of this length are kept beside the scans, so that long windows need not look at every scan."""
MOST_SCANS = 4_000_000
CURRENT = CHANNELS.index("current")


@attrs.frozen(eq=False)
class Trace:
    """One window of the scope.

    Attributes:
        begin_s: time of the first column's begin [s].
        column_s: length of a column [s].
        low: minima per channel and column, NaN where there is no scan, shape (4, n).
        high: maxima, shape (4, n).
        status: bits of all scans of a column, shape (n,).
        trigger_s: the instant the window is aligned to; NaN where there is none.
    """

    begin_s: float
    column_s: float
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    status: NDArray[np.uint8]
    trigger_s: float


class Scope:
    """A ring of scans of contiguous numbers; scans that never came are NaN.

    Args:
        rate_hz: scans per second.
    """

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self._fine = max(1, round(COARSE_S * rate_hz))
        blocks = max(1, min(math.ceil(HELD_S * rate_hz), MOST_SCANS) // self._fine)
        self._size = blocks * self._fine
        self._scans = np.full((4, self._size), np.nan, np.float32)
        self._status = np.zeros(self._size, np.uint8)
        self._low = np.full((4, blocks), np.nan, np.float32)
        self._high = np.full((4, blocks), np.nan, np.float32)
        self._bits = np.zeros(blocks, np.uint8)
        self._coarse_end = 0
        self.begin = self.end = 0
        """Numbers of the first scan held, and of the one after the last."""

    @property
    def end_s(self) -> float:
        """Return the end of the newest scan [s since scan 0]."""
        return self.end / self.rate_hz

    def clear(self) -> None:
        """Forget everything."""
        self.begin = self.end = self._coarse_end = 0

    def add(self, table: Table, start_ns: int) -> None:
        """Take a block of `daq/scan`.

        Args:
            table: the block.
            start_ns: stamp of scan 0.
        """
        rows = table.rows[-self._size :]
        first = round((table.stamp_ns - start_ns) * self.rate_hz / NS_PER_S) + len(table.rows) - len(rows)
        if first < 0 or not len(rows):
            return
        if self.end == self.begin or not 0 <= first - self.end < self._size:
            self.begin = self.end = first
            self._coarse_end = first - first % self._fine
            self._blank(self._coarse_end, first)
        else:
            self._blank(self.end, first)
        self._write(first, rows)
        self.end = first + len(rows)
        self.begin = max(self.begin, self.end - self._size)
        self._coarsen()

    def _blank(self, begin: int, end: int) -> None:
        for place in self._places(begin, end):
            self._scans[:, place] = np.nan
            self._status[place] = 0

    def _write(self, first: int, rows: NDArray[np.void]) -> None:
        done = 0
        for place in self._places(first, first + len(rows)):
            count = place.stop - place.start
            part = rows[done : done + count]
            for number, name in enumerate(CHANNELS):
                self._scans[number, place] = part[name]
            self._status[place] = part["status"]
            done += count

    def _places(self, begin: int, end: int) -> list[slice]:
        """Return where scans are in the ring: one stretch, or two around its end."""
        if end <= begin:
            return []
        first, last = begin % self._size, (end - 1) % self._size + 1
        return [slice(first, last)] if first < last else [slice(first, self._size), slice(0, last)]

    def _coarsen(self) -> None:
        end = self.end - self.end % self._fine
        begin = max(self._coarse_end, end - self._size)
        for place in self._places(begin, end):
            part = self._scans[:, place].reshape(4, -1, self._fine)
            to = slice(place.start // self._fine, place.stop // self._fine)
            np.fmin.reduce(part, axis=2, out=self._low[:, to])
            np.fmax.reduce(part, axis=2, out=self._high[:, to])
            np.bitwise_or.reduce(self._status[place].reshape(-1, self._fine), axis=1, out=self._bits[to])
        self._coarse_end = max(end, self._coarse_end)

    def window(self, span_s: float, columns: int, *, trigger: bool = False, end_s: float | None = None) -> Trace | None:
        """Return the newest window of a length, or the one that ends at an instant; None: there is nothing.

        Args:
            span_s: its length [s].
            columns: of the picture; there may be fewer.
            trigger: move the window back, until it begins where the current passes zero upwards.
            end_s: the instant at which it ends.
        """
        if self.end <= self.begin:
            return None
        end = self.end if end_s is None else min(max(round(end_s * self.rate_hz), self.begin), self.end)
        count = max(2, round(min(span_s, LONGEST_S) * self.rate_hz))
        begin = end - count
        crossing = self._crossing(begin, end) if trigger else math.nan
        if not math.isnan(crossing):
            begin = int(crossing)
        step = max(1, count // columns)
        pairs = self._coarse_pairs if step >= 2 * self._fine else self._pairs
        return pairs(begin, count, step, crossing / self.rate_hz)

    def _crossing(self, begin: int, end: int) -> float:
        """Return the last scan before `begin` at which the current passes zero upwards; NaN: there is none."""
        low = max(self.begin, begin - round(0.25 * self.rate_hz), 0)
        found = self._read(self._scans[CURRENT], low, min(begin + 1, end))
        if not len(found):
            return math.nan
        # the noise of the monitor crosses zero many times: smooth over a millisecond, and ask for some amplitude
        width = max(1, round(1e-3 * self.rate_hz))
        smooth = np.convolve(np.nan_to_num(found), np.full(width, 1.0 / width), "valid")
        if not len(smooth) or np.abs(smooth).max() < 0.01:
            return math.nan
        up = np.flatnonzero((smooth[:-1] < 0.0) & (smooth[1:] >= 0.0))
        return float(low + up[-1] + width // 2 + 1) if len(up) else math.nan

    def _read(self, ring: NDArray[np.float32], begin: int, end: int) -> NDArray[np.float32]:
        places = self._places(max(begin, self.begin), min(end, self.end))
        parts = [ring[..., place] for place in places]
        return np.concatenate(parts, axis=-1) if parts else ring[..., :0]

    def stretch(self, span_s: float, end_s: float | None = None) -> NDArray[np.float32]:
        """Return the newest scans, or those before an instant, shape (4, n)."""
        end = self.end if end_s is None else min(round(end_s * self.rate_hz), self.end)
        return self._read(self._scans, end - round(span_s * self.rate_hz), end)

    def _pairs(self, begin: int, count: int, step: int, trigger_s: float) -> Trace:
        columns = count // step
        values = np.full((4, columns * step), np.nan, np.float32)
        status = np.zeros(columns * step, np.uint8)
        low, high = max(begin, self.begin), min(begin + columns * step, self.end)
        if high > low:
            values[:, low - begin : high - begin] = self._read(self._scans, low, high)
            status[low - begin : high - begin] = np.concatenate([self._status[p] for p in self._places(low, high)])
        cut = values.reshape(4, columns, step)
        return Trace(
            begin / self.rate_hz,
            step / self.rate_hz,
            np.fmin.reduce(cut, axis=2),
            np.fmax.reduce(cut, axis=2),
            np.bitwise_or.reduce(status.reshape(columns, step), axis=1),
            trigger_s,
        )

    def _coarse_pairs(self, begin: int, count: int, step: int, trigger_s: float) -> Trace:
        """Make columns of whole coarse pairs; the window begins up to a pair earlier than asked."""
        fine, blocks = self._fine, len(self._bits)
        per_column = step // fine
        columns = count // (per_column * fine)
        first = begin // fine
        numbers = np.arange(first, first + columns * per_column)
        held = (numbers * fine >= self.begin) & ((numbers + 1) * fine <= self._coarse_end)
        places = numbers % blocks
        low = np.where(held, self._low[:, places], np.nan).reshape(4, columns, per_column)
        high = np.where(held, self._high[:, places], np.nan).reshape(4, columns, per_column)
        bits = np.where(held, self._bits[places], 0).astype(np.uint8).reshape(columns, per_column)
        return Trace(
            first * fine / self.rate_hz,
            per_column * fine / self.rate_hz,
            np.fmin.reduce(low, axis=2),
            np.fmax.reduce(high, axis=2),
            np.bitwise_or.reduce(bits, axis=1),
            trigger_s,
        )


def spectrum(values: NDArray[np.float32], rate_hz: float, top_hz: float) -> tuple[float, NDArray[np.float32]]:
    """Return the resolution [Hz] and the amplitude spectrum (Hann window, peak values) up to a frequency.

    Args:
        values: scans of one channel, shape (n,); what never came counts as zero.
        rate_hz: scans per second.
        top_hz: highest frequency.
    """
    count = len(values)
    if count < 16:
        return 1.0, np.zeros(0, np.float32)
    window = np.hanning(count)
    clean = np.nan_to_num(values.astype(np.float64))
    amplitudes = 2.0 / window.sum() * np.abs(np.fft.rfft((clean - clean.mean()) * window))
    return rate_hz / count, amplitudes[: math.ceil(top_hz * count / rate_hz) + 1].astype(np.float32)
