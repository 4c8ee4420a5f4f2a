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
"""Data of the scope (the oscilloscope on the page): the newest scans, and pictures of any window of them.

A picture has the minimum and maximum of the scans in each of its columns. Therefore a pulse of a single scan is visible
at any zoom.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any  # an array of either type

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import Table
from impact_rig.errors import CodecError
from impact_rig.instruments.section import CHANNELS, channels_of
from impact_rig.simtime import NS_PER_S

LONGEST_S = 10.0  # longest window that can be drawn [s]
HELD_S = 12.0  # duration of the scans kept: the longest window, and a margin in which to find a trigger [s]
COARSE_S = 0.002  # length of a group of scans at the coarsest level [s]
FINER = 10
"""Length of a group of scans at the coarsest level over that at the finer one.

Both levels have the minimum and maximum of each group, so that a picture of a long window need not read every scan.
"""
MOST_SCANS = 4_000_000  # largest number of scans kept
CURRENT = CHANNELS.index("current")


@attrs.frozen(eq=False)
class Trace:
    """Picture of a window of the scope: minimum and maximum of the scans in each of n columns."""

    begin_s: float  # start time of the first column [s since scan 0]
    column_s: float  # length of a column [s]
    low: NDArray[np.float32]
    """Minima per channel and column, NaN in a column without a scan, shape (4, n).

    If a stream drives the rig, the commanded current is added as a fifth row, shape (5, n).
    """
    high: NDArray[np.float32]  # maxima, of the same shape
    status: NDArray[np.uint8]  # for each column, the over-range bits of its scans; bit i: `CHANNELS[i]`; shape (n,)
    trigger_s: float  # time of the trigger, with which the window begins [s since scan 0]; NaN if there is none


class ScopeLevel:
    """Ring buffer of pairs: minimum and maximum of each channel over a group of consecutive scans.

    Args:
        fine: number of scans per group; with 1, the level is the ring buffer of the scans themselves.
        size: number of pairs.
    """

    def __init__(self, fine: int, size: int) -> None:
        self.fine, self.size = fine, size
        self.low = np.full((len(CHANNELS), size), np.nan, np.float32)
        self.high = self.low if fine == 1 else self.low.copy()
        self.status = np.zeros(size, np.uint8)
        self.end = 0  # number of the pair after the last complete one

    def widen(self) -> None:
        """Add a row for the commanded current, as one more channel; its values are NaN at first."""
        same = self.high is self.low
        self.low = np.vstack([self.low, np.full((1, self.size), np.nan, np.float32)])
        self.high = self.low if same else np.vstack([self.high, np.full((1, self.size), np.nan, np.float32)])

    def places(self, begin: int, end: int) -> list[slice]:
        """Return the slices of the ring buffer that hold the pairs `begin` to `end` − 1, at most `size` pairs.

        There are two slices if the pairs continue at the beginning of the buffer, and no slice if there are no pairs.
        """
        if end <= begin:
            return []
        first, last = begin % self.size, (end - 1) % self.size + 1
        return [slice(first, last)] if first < last else [slice(first, self.size), slice(0, last)]

    def blank(self, begin: int, end: int) -> None:
        """Set the pairs `begin` to `end` − 1 to NaN, and their status bits to 0."""
        for place in self.places(begin, end):
            self.low[:, place] = self.high[:, place] = np.nan
            self.status[place] = 0

    def gather(self, below: ScopeLevel, end: int) -> None:
        """Compute the pairs (minimum, maximum) of this level whose groups have become complete since the last call.

        Args:
            below: level with smaller groups of scans, from which the pairs are computed.
            end: number of the scan after the newest one.
        """
        ratio, whole = self.fine // below.fine, end // self.fine
        for place in self.places(max(self.end, whole - self.size), whole):
            source = slice(place.start * ratio, place.stop * ratio)
            self.low[:, place] = np.fmin.reduce(_columns(below.low[:, source], ratio))
            self.high[:, place] = np.fmax.reduce(_columns(below.high[:, source], ratio))
            self.status[place] = np.bitwise_or.reduce(_columns(below.status[source], ratio))
        self.end = max(whole, self.end)


class Scope:
    """Ring buffer of the newest scans of a rig, from which pictures and spectra are computed; missing scans are NaN.

    It keeps `HELD_S` seconds of scans, but at most `MOST_SCANS`.

    Args:
        rate_hz: scans per second.
    """

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        finer = max(1, round(COARSE_S * rate_hz / FINER))
        coarse = FINER * finer
        blocks = max(1, min(math.ceil(HELD_S * rate_hz), MOST_SCANS) // coarse)
        self._size = blocks * coarse
        self._levels = [ScopeLevel(fine, self._size // fine) for fine in sorted({1, finer, coarse})]
        self._scans = self._levels[0]
        self._commanded: NDArray[np.float32] | None = None  # for future scans; None if none was ever sent
        self.begin = self.end = 0  # numbers of the first scan kept, and of the one after the last

    @property
    def end_s(self) -> float:
        """Return the time of the end of the newest scan [s since scan 0]; 0 without scans."""
        return self.end / self.rate_hz

    def clear(self) -> None:
        """Forget all scans and commanded samples, so that there is no picture until new scans are added."""
        self.begin = self.end = 0
        if self._commanded is not None:
            self._commanded[:] = np.nan

    def add(self, table: Table, start_ns: int) -> None:
        """Add a block of scans; missing scans between the kept scans and the block become NaN.

        If the block begins before the end of the kept scans, or later than the length of the buffer after it, the kept
        data are dropped first. A block that begins before scan 0 is ignored.

        Args:
            table: table of `daq/scan`.
            start_ns: stamp of scan 0.

        Raises:
            CodecError: a channel is not numeric.
        """
        rows = table.rows[-self._size :]
        for name in channels_of(rows):
            if rows.dtype[name].kind not in "fiu":
                raise CodecError(f"channel {name} of daq/scan is not numeric, so no channel of this block is drawn")
        first = round((table.stamp_ns - start_ns) * self.rate_hz / NS_PER_S) + len(table.rows) - len(rows)
        if first < 0 or not len(rows):
            return
        if self.end > self.begin and not 0 <= first - self.end < self._size:
            self.clear()
        if self.end == self.begin:
            self.begin = self.end = first
            for level in self._levels:
                level.end = first // level.fine
            self._scans.blank(self._levels[-1].end * self._levels[-1].fine, first)
        else:
            self._scans.blank(self.end, first)
            if self._commanded is not None:  # samples for missing scans would be drawn one buffer length later
                self._commanded[np.arange(self.end, first) % self._size] = np.nan
        self._write(first, rows)
        self.end = first + len(rows)
        self.begin = max(self.begin, self.end - self._size)

    def command(self, table: Table, rate_hz: float, start_ns: int) -> None:
        """Add commanded samples of a stream [A], which are drawn together with the scans at the same times.

        Samples for times up to the newest scan are dropped.

        Args:
            table: table of `shaker/waveform` of a rig whose `drive.kind` is `current`.
            rate_hz: samples of the stream per second; the samples are interpolated at the times of the scans.
            start_ns: stamp of scan 0.
        """
        if self._commanded is None:
            self._commanded = np.full(self._size, np.nan, np.float32)
            for level in self._levels:
                level.widen()
        values, step = table.rows["value"], self.rate_hz / rate_hz
        first = (table.stamp_ns - start_ns) * self.rate_hz / NS_PER_S
        begin = max(math.ceil(first), self.end)
        numbers = np.arange(begin, min(math.ceil(first + len(values) * step), begin + self._size))
        if len(numbers):
            self._commanded[numbers % self._size] = np.interp(numbers, first + step * np.arange(len(values)), values)

    def _write(self, first: int, rows: NDArray[np.void]) -> None:
        done = 0
        for place in self._scans.places(first, first + len(rows)):
            part = rows[done : done + place.stop - place.start]
            self._scans.status[place] = 0
            there = channels_of(rows)
            for number, name in enumerate(CHANNELS):
                self._scans.low[number, place] = part[name] if name in there else np.nan
                if name in there:  # the bits are in the order of the existing channels
                    self._scans.status[place] |= (part["status"] >> there.index(name) & 1) << number
            if self._commanded is not None:
                self._scans.low[len(CHANNELS), place] = self._commanded[place]
                self._commanded[place] = np.nan
            done += len(part)

    def window(self, span_s: float, columns: int, *, trigger: bool = False) -> Trace | None:
        """Return a picture of the newest scans; None if there are none.

        Args:
            span_s: length of the window [s], at most `LONGEST_S`; a longer one is shortened.
            columns: approximate number of columns; the picture may have fewer, or up to twice as many.
            trigger: whether the window begins where the current crosses zero upwards, so that successive pictures of a
                periodic motion coincide. The window moves back by at most 0.25 s. Without such a crossing, it does not
                move.
        """
        if self.end <= self.begin:
            return None
        count = max(2, round(min(span_s, LONGEST_S) * self.rate_hz))
        begin = self.end - count
        crossing = self._crossing(begin) if trigger else math.nan
        if not math.isnan(crossing):
            begin = int(crossing)
        step = max(1, count // columns)
        for below, upper in itertools.pairwise(self._levels):  # computed only now, because not every block is drawn
            upper.gather(below, self.end)
        level = next(level for level in reversed(self._levels) if level.fine == 1 or step >= 2 * level.fine)
        return self._trace(level, begin // level.fine, count // level.fine, step // level.fine, crossing)

    def _crossing(self, begin: int) -> float:
        """Return the number of the last scan before scan `begin` at which the current crosses zero upwards.

        The result is NaN if there is no crossing in the quarter of a second before, or if the current is too small
        there. Means over a millisecond decide, because of noise.
        """
        low = max(self.begin, begin - round(0.25 * self.rate_hz), 0)
        found = self._read(low, begin + 1)[CURRENT]
        if not len(found):
            return math.nan
        # the noise of the monitor crosses zero many times, so use means over a millisecond and require some amplitude
        width = max(1, round(1e-3 * self.rate_hz))
        rest = len(found) % width
        means = np.nan_to_num(found[rest:]).reshape(-1, width).mean(axis=1)
        if not len(means) or np.abs(means).max() < 0.01:
            return math.nan
        up = np.flatnonzero((means[:-1] < 0.0) & (means[1:] >= 0.0))
        if not len(up):
            return math.nan
        before, after = means[up[-1]], means[up[-1] + 1]
        return float(low + rest + round((up[-1] + 0.5 + before / (before - after)) * width))

    def _read(self, begin: int, end: int) -> NDArray[np.float32]:
        parts = [self._scans.low[:, p] for p in self._scans.places(max(begin, self.begin), min(end, self.end))]
        return np.concatenate(parts, axis=1) if parts else self._scans.low[:, :0]

    def stretch(self, span_s: float) -> NDArray[np.float32]:
        """Return the scans of the newest `span_s` seconds, or all kept scans if there are fewer.

        The shape is (channels, scans), with channels as in `Trace.low`.
        """
        return self._read(self.end - round(span_s * self.rate_hz), self.end)

    def _trace(self, level: ScopeLevel, begin: int, count: int, step: int, crossing: float) -> Trace:
        """Return a picture; each of its columns has the minimum and maximum of `step` pairs of a level.

        Args:
            level: level to read.
            begin: index of the first pair.
            count: number of pairs in the window; the newest ones that do not fill a column are left out.
            step: number of pairs in a column.
            crossing: index of the scan of the trigger, or NaN.
        """
        columns = count // step
        low, high = np.full((2, len(level.low), columns * step), np.nan, np.float32)
        status = np.zeros(columns * step, np.uint8)
        first = max(begin, -(-self.begin // level.fine))
        at = first - begin
        for place in level.places(first, min(begin + columns * step, self.end // level.fine)):
            to = slice(at, at + place.stop - place.start)
            low[:, to], high[:, to], status[to] = level.low[:, place], level.high[:, place], level.status[place]
            at = to.stop
        return Trace(
            begin * level.fine / self.rate_hz,
            step * level.fine / self.rate_hz,
            np.fmin.reduce(_columns(low, step)),
            np.fmax.reduce(_columns(high, step)),
            np.bitwise_or.reduce(_columns(status, step)),
            crossing / self.rate_hz,
        )


def _columns(values: NDArray[Any], step: int) -> NDArray[Any]:
    """Rearrange a copy of the values so that a reduction over the first axis reduces groups of `step` neighbours.

    The shape (…, n · step) becomes (step, …, n). NumPy reduces a long first axis much faster than a short last one.
    """
    return np.ascontiguousarray(np.moveaxis(values.reshape(*values.shape[:-1], -1, step), -1, 0))


def spectrum(values: NDArray[np.float32], rate_hz: float, top_hz: float) -> tuple[float, NDArray[np.float32]]:
    """Return the amplitude spectrum of a channel for the page, without its mean.

    Args:
        values: consecutive scans, shape (n,); NaN counts as 0, before the mean is subtracted.
        rate_hz: scans per second.
        top_hz: highest frequency of the result, rounded up to a line; the lines end at half the scan rate.

    Returns:
        Distance of the lines [Hz], and peak amplitudes at the lines from 0 Hz on. A Hann window is used, and the
        amplitudes are corrected for it. There are no amplitudes for fewer than 16 scans.
    """
    count = len(values)
    if count < 16:
        return 1.0, np.zeros(0, np.float32)
    clean = np.nan_to_num(values.astype(np.float64))
    lines = np.fft.rfft((clean - clean.mean()) * _hann(count))[: math.ceil(top_hz * count / rate_hz) + 1]
    return rate_hz / count, np.abs(lines).astype(np.float32)


@functools.lru_cache(maxsize=4)  # every page requests it four times a second, usually with the same length
def _hann(count: int) -> NDArray[np.float64]:
    """Return a Hann window of `count` samples, scaled for `rfft` so that the result is a peak amplitude.

    This holds for a sine with the frequency of a line of the spectrum.
    """
    window = np.hanning(count)
    return window * (2.0 / window.sum())
