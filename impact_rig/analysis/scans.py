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
"""Scans in the form that the analysis needs: four channels in a fixed order, and buffers that join successive blocks.

A run may have more channels than these four, in any order. An imported measurement may lack some of the four;
`daq/info` and `daq/scan` then do not contain them. Transmissibility needs `laser` and `base`. Without `accelerometer`,
no impacts are counted. Without `current`, there is no current amplitude.
"""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Collection
from typing import Any  # rows of records

import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.blocks import Column, Table, joined, row_type
from impact_rig.errors import ConfigError
from impact_rig.kernels import BYTES, REALS_2D, entry, for_kernels
from impact_rig.simtime import NS_PER_S

CHANNELS = ("accelerometer", "laser", "base", "current")  # by name; arrays over channels have this order
ACCELEROMETER, LASER, BASE, CURRENT = range(len(CHANNELS))
_TIME, _STATUS = topics.SCAN.fields
SCAN_COLUMNS = (_TIME, *(Column(name, "SI", "Its reading.") for name in CHANNELS), _STATUS)
SCAN = row_type(SCAN_COLUMNS)
"""Row type of `daq/scan` with exactly the channels of `CHANNELS`, in this order."""
PUBLISHER_REMEDY = "correct the program that publishes it (a recording of it must be made again)"
"""End of error messages about an invalid table."""
_FRAME = (_TIME.name, _STATUS.name)
_IN_ORDER = tuple((bit, bit) for bit in range(len(CHANNELS)))


def status_of(rows: NDArray[np.void]) -> NDArray[np.uint8]:
    """Return the status bits of scans in the order of `CHANNELS`, shape (n,).

    Bit j is set if channel j of `CHANNELS` is over range or clipped. The bits in the scans themselves follow the order
    of the columns of the scans, which may differ.
    """
    status: NDArray[np.uint8] = rows["status"]
    places = _places(rows.dtype)
    if places == _IN_ORDER:
        return status
    ours = np.zeros(len(rows), np.uint8)
    for bit, place in places:
        ours |= (status >> place & 1) << bit
    return ours


@functools.lru_cache(maxsize=64)  # few types of rows exist
def _places(dtype: np.dtype[np.void]) -> tuple[tuple[int, int], ...]:
    """Return the bit of each channel in the status of scans of a row type.

    The result has one pair for each channel of `CHANNELS` that the row type contains: (index in `CHANNELS`, bit). The
    bit is the index of the channel among the columns except time and status.
    """
    found = [name for name in dtype.names or () if name not in _FRAME]
    return tuple((bit, found.index(name)) for bit, name in enumerate(CHANNELS) if name in found)


def _as_scans(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Convert scans of any row type to rows of `SCAN`, shape (n,).

    Channels that were not measured are filled with zeros.
    """
    scans = np.zeros(len(rows), SCAN)
    for name in set(CHANNELS).intersection(rows.dtype.names or ()):
        scans[name] = rows[name]
    scans["status"] = status_of(rows)
    return scans


@entry(SCAN, REALS_2D, BYTES, int)
def _copy(rows: Any, samples: NDArray[np.float64], status: NDArray[np.uint8], at: int) -> None:
    """Copy scans to the arrays of a `ScanBuffer`, from column `at` on.

    `samples` has shape (4, capacity of the buffer), `status` has shape (capacity of the buffer,).
    """
    for i in range(len(rows)):
        samples[0, at + i] = rows[i].accelerometer
        samples[1, at + i] = rows[i].laser
        samples[2, at + i] = rows[i].base
        samples[3, at + i] = rows[i].current
        status[at + i] = rows[i].status


def samples_of(rows: NDArray[np.void], name: str) -> NDArray[np.float64]:
    """Return the samples of one channel of scans [unit of the channel], shape (n,); zeros if it was not measured."""
    present = name in (rows.dtype.names or ())
    return np.array(rows[name], dtype=np.float64) if present else np.zeros(len(rows))


def need_columns(
    table: Table, wanted: np.dtype[np.void], topic: str, later: Collection[str] = (), why: str = ""
) -> None:
    """Check that a table has the columns of the row type `wanted`, each with numbers or text as that type requires.

    The columns named in `later` may be missing. `topic` and `why` are used in the error message: the name of the table,
    and the reason for the columns.

    Raises:
        ConfigError: a column is missing, or holds text instead of numbers, or numbers instead of text.
    """
    found = table.rows.dtype
    if found == wanted:
        return
    names = found.names or ()
    missing = [name for name in wanted.names or () if name not in names and name not in later]
    if missing:
        raise ConfigError(f"{topic} lacks the column {', '.join(missing)}{why and f' ({why})'}; {PUBLISHER_REMEDY}")
    for name in set(names).intersection(wanted.names or ()):
        is_text = found[name].kind == "S"
        if is_text != (wanted[name].kind == "S"):
            has = "text instead of numbers" if is_text else "numbers instead of text"
            raise ConfigError(f"{topic} has {has} in the column {name}; {PUBLISHER_REMEDY}")


class ScanBuffer:
    """Buffer of consecutive scans, stored channel by channel, in arrays that grow as needed.

    Attributes:
        samples: samples by channel of `CHANNELS` and by scan, in SI units as in `daq/scan`, shape (4, capacity).
        status: status bits of the scans, shape (capacity,).
        first: index of the scan in column 0.
        end: index after the newest scan.
    """

    def __init__(self) -> None:
        self.samples = np.empty((len(CHANNELS), 0))
        self.status = np.empty(0, dtype=np.uint8)
        self._kind = SCAN
        self.first = 0
        self.end = 0

    def restart(self, index: int) -> None:
        """Drop all scans after a gap in the stream; the next scan to append has the index `index`."""
        self.first = self.end = index

    def renumber(self, index: int) -> None:
        """Renumber the scans after a reset of the rig, so that scan `index` becomes scan 0."""
        self.first -= index
        self.end -= index

    def append(self, rows: NDArray[np.void], keep: int) -> None:
        """Append scans that directly follow the newest one.

        Scans with an index below `keep` may be dropped to make room.
        """
        used, new = self.end - self.first, len(rows)
        if used + new > len(self.status):
            self._make_room(keep, new)
            used = self.end - self.first
        if rows.dtype is not self._kind and rows.dtype == SCAN:
            self._kind = rows.dtype  # to compare two such types takes longer than everything else
        if rows.dtype is not self._kind or not rows.flags.c_contiguous:
            rows = _as_scans(rows)
        _copy(for_kernels(rows), self.samples, self.status, used)
        self.end += new

    def column(self, index: int) -> int:
        """Return the column of `samples` that holds the scan `index`; it is also the index of that scan in `status`."""
        return index - self.first

    def _make_room(self, keep: int, new: int) -> None:
        left, right = keep - self.first, self.end - self.first
        need = right - left + new
        samples, status = self.samples, self.status
        if 4 * need > len(status):  # at least four times the need: then room is made at most at every third block
            self.samples = np.empty((len(CHANNELS), 8 * need))
            self.status = np.empty(8 * need, dtype=np.uint8)
        self.samples[:, : right - left] = samples[:, left:right].copy()
        self.status[: right - left] = status[left:right].copy()
        self.first = keep


class Recent:
    """Buffer of the newest blocks of `daq/scan`: as few blocks as hold at least `length` scans.

    A gap between two blocks empties the buffer. It holds all blocks until `length` scans have arrived since the gap.
    """

    def __init__(self, rate_hz: float, length: int) -> None:
        self._rate_hz = rate_hz
        self._length = length
        self._blocks: deque[Table] = deque()
        self.count = 0  # scans that are kept

    def follows(self, scan: Table) -> bool:
        """Return whether a block directly follows the last kept scan, within half a scan; False if no scan is kept."""
        return bool(self._blocks) and abs(scan.stamp_ns - self.next_ns()) <= 0.5 * NS_PER_S / self._rate_hz

    def add(self, scan: Table) -> None:
        """Add a block; if it does not directly follow the newest kept block, drop all earlier blocks."""
        if not self.follows(scan):
            self.clear()
        self._blocks.append(scan)
        self.count += len(scan.rows)
        while self.count - len(self._blocks[0].rows) >= self._length:
            self.count -= len(self._blocks.popleft().rows)

    def clear(self) -> None:
        """Drop all scans."""
        self._blocks.clear()
        self.count = 0

    def next_ns(self) -> int:
        """Return the expected stamp of the next scan [ns]; at least one scan must be kept."""
        return self.stamp_ns(self.count)

    def stamp_ns(self, number: int) -> int:
        """Return the stamp [ns] of the scan `number`, counted from 0 at the oldest kept scan.

        `number` may also belong to a future scan. At least one block must have been added.
        """
        return self._blocks[0].stamp_ns + int(number * NS_PER_S / self._rate_hz)

    def rows(self) -> NDArray[np.void]:
        """Return a copy of the rows of all kept scans, oldest first; at least one block must have been added."""
        return joined([block.rows for block in self._blocks])
