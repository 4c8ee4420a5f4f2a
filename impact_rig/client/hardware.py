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
"""A rig as a controller's hardware: an output that plays blocks of samples, and an acquisition that reads scans.

The two halves that any vibration controller needs, blocking, with time-outs, for blocks of any size. They are the same
whether the rig is in this process (`InProcess`) or behind topics (`impact_rig_studies.apparatus`), in real time or not.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_rig.errors import CommandError
from impact_rig.rig import Block, Rig
from impact_rig.simtime import NS_PER_S, stamp_ns

TIMEOUT_S = 10.0


class Wanted(NamedTuple):
    """What `shaker/stream` says: the sample wanted next, how many are there from it on, how many may be."""

    sample: int
    buffered: int
    capacity: int


class Wire(Protocol):
    """What joins both halves to a rig."""

    rate_hz: int  # samples per second of the output
    scan_rate_hz: int  # scans per second of the acquisition
    lead_s: float
    """How far ahead of what is wanted next a first sample must be to come in time: 0 where rig time waits for it."""

    def info(self) -> NDArray[np.void]:
        """Return the calibration: rows of daq/info."""

    def feed(self, first: int, samples: NDArray[np.float64]) -> None:
        """Send a block, from sample number `first` on; none at all: the stream ends there."""

    def wanted(self) -> Wanted:
        """Return how far the output is, as far as is known."""

    def turn(self, timeout_s: float) -> tuple[int, NDArray[np.void]] | None:
        """Let time pass until scans come, and return the number of the first and their rows; None: none came."""


class InProcess:
    """A wire to a rig in this process, whose time passes only while somebody waits.

    Args:
        rig: its drive is a stream.
    """

    lead_s = 0.0

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.rate_hz, self.scan_rate_hz = rig.stream.rate_hz, rig.rate_hz

    def info(self) -> NDArray[np.void]:
        """Return the calibration in force."""
        return self.rig.info().rows

    def feed(self, first: int, samples: NDArray[np.float64]) -> None:
        """Feed the rig."""
        self.rig.feed(first, samples)

    def wanted(self) -> Wanted:
        """Return how far the rig is."""
        stream = self.rig.stream
        return Wanted(stream.played, stream.buffered(), stream.capacity)

    def turn(self, timeout_s: float) -> tuple[int, NDArray[np.void]] | None:  # noqa: ARG002  # nothing to wait for
        """Advance by one block, if there are samples for it."""
        if self.rig.blocks_with_samples(1) == 0:
            return None
        block = self.advance()
        return block.first_scan, block.scan.rows

    def advance(self) -> Block:
        """Advance the rig by one block."""
        return self.rig.advance(self.rig.block_end_ns(1))[0]


class Hardware:
    """Output and acquisition on one wire.

    Args:
        abort: by channel, the largest reading of either sign that is borne.

    Attributes:
        output: plays.
        acquisition: reads.
    """

    def __init__(self, wire: Wire, abort: Mapping[str, float] = MappingProxyType({})) -> None:
        self.wire, self._abort = wire, abort
        self.output, self.acquisition = AnalogOutput(self), Acquisition(self)

    def turn(self, deadline: float, what: str) -> None:
        """Let time pass until scans come.

        Raises:
            TimeoutError: none did; names what was waited for.
            CommandError: a reading is beyond what is borne.
        """
        while True:
            found = self.wire.turn(max(0.0, deadline - time.monotonic()))
            if found is not None:
                self.acquisition.take(*found)
                self._check(*found)
                return
            if isinstance(self.wire, InProcess) or time.monotonic() >= deadline:
                raise TimeoutError(f"waited in vain for {what}: {self.wire.wanted()}")

    def _check(self, first: int, rows: NDArray[np.void]) -> None:
        for channel, limit in self._abort.items():
            beyond = np.flatnonzero(np.abs(rows[channel]) > limit)
            if len(beyond):
                scan = first + int(beyond[0])
                raise CommandError(f"aborted: {channel} {rows[channel][beyond[0]]:.6g} beyond {limit:g} at scan {scan}")

    def respond(self, samples: ArrayLike, rest: int = 0) -> NDArray[np.void]:
        """Play samples and return the scans from the first of them on, and of `rest` scans more after the last.

        The stream ends with the last sample. Both rates must be the same.

        Raises:
            TimeoutError: the rig did not go on.
        """
        values = np.asarray(samples, np.float64)
        first = self.output.start()
        self.acquisition.start(first * self.wire.scan_rate_hz // self.wire.rate_hz)
        size = self.wire.wanted().capacity // 4
        for at in range(0, len(values), size):
            self.output.write(values[at : at + size])
        self.output.stop()
        return self.acquisition.read(len(values) + rest)


class AnalogOutput:
    """The half that plays: set up by the rig's configuration, started, written to block by block, stopped.

    Attributes:
        next_sample: number of the next sample to be written; None before the start.
    """

    def __init__(self, hardware: Hardware) -> None:
        self._hardware, self._wire = hardware, hardware.wire
        self.next_sample: int | None = None

    def start(self, lead_s: float | None = None) -> int:
        """Begin `lead_s` after the sample that is wanted next, or as early as it comes in time; return its number."""
        wanted = self._wire.wanted()
        at = max(wanted.sample + wanted.buffered, self.next_sample or 0)
        self.next_sample = at + round((self._wire.lead_s if lead_s is None else lead_s) * self._wire.rate_hz)
        return self.next_sample

    def ready(self, count: int) -> bool:
        """Whether the buffer takes so many samples more now."""
        wanted = self._wire.wanted()
        return self._next() + count <= wanted.sample + wanted.capacity

    def write(self, samples: ArrayLike, timeout_s: float = TIMEOUT_S) -> None:
        """Append a block, as soon as the buffer takes it.

        Args:
            samples: A, m or V by `drive.kind`, shape (n,).
            timeout_s: how long the rig may take to play what is in the way.

        Raises:
            TimeoutError: it took longer.
            CommandError: the rig (in this process) refuses the block; behind topics diagnostics tell that.
        """
        values = np.asarray(samples, np.float64)
        deadline = time.monotonic() + timeout_s
        while not self.ready(len(values)):
            self._hardware.turn(deadline, f"room for {len(values)} samples")
        self._wire.feed(self._next(), values)
        self.next_sample = self._next() + len(values)

    def stop(self) -> None:
        """End the stream after what was written: the drive then ramps to zero, and nobody waits for more.

        Not started, or stopped by the rig itself: nothing happens.
        """
        if self.next_sample is not None:
            with contextlib.suppress(CommandError):
                self._wire.feed(self.next_sample, np.empty(0))

    def _next(self) -> int:
        assert self.next_sample is not None, "start() comes first"
        return self.next_sample


class Acquisition:
    """The half that reads: scans are kept from its start on until they are read.

    Attributes:
        next_scan: number of the next scan to be read.
    """

    def __init__(self, hardware: Hardware) -> None:
        self._hardware = hardware
        self._kept: list[tuple[int, NDArray[np.void]]] = []
        self.next_scan: int | None = None

    def start(self, scan: int | None = None) -> None:
        """Keep scans from number `scan` on; None: from the next one that comes."""
        self.next_scan = scan
        self._kept = [part for part in self._kept if scan is not None and part[0] + len(part[1]) > scan]

    def take(self, first: int, rows: NDArray[np.void]) -> None:
        """Take rows as they come."""
        if self.next_scan is None:
            self.next_scan = first
        self._kept.append((first, rows))

    def delay_s(self, sample: int, scan: int) -> float:
        """Return how much later a scan was taken than a sample was played [s]: both are on one clock, so exactly."""
        wire = self._hardware.wire
        return (stamp_ns(scan, wire.scan_rate_hz) - stamp_ns(sample, wire.rate_hz)) / NS_PER_S

    def read(self, count: int, timeout_s: float = TIMEOUT_S) -> NDArray[np.void]:
        """Return the next `count` scans, rows with a field a channel, as soon as they are there.

        Raises:
            TimeoutError: they did not come in time, or the output had no samples for them.
        """
        deadline = time.monotonic() + timeout_s
        while self.next_scan is None or not self._kept or self._end() < self.next_scan + count:
            before = len(self._kept)
            self._hardware.turn(deadline, f"{count} scans")
            if len(self._kept) > before:
                deadline = time.monotonic() + timeout_s
        return self._cut(count)

    def read_remaining(self) -> NDArray[np.void]:
        """Return what has come and was not read."""
        return self._cut(max(0, self._end() - (self.next_scan or 0)))

    def _end(self) -> int:
        return self._kept[-1][0] + len(self._kept[-1][1]) if self._kept else 0

    def _cut(self, count: int) -> NDArray[np.void]:
        first = self.next_scan or 0
        parts = [rows[max(0, first - at) : max(0, first + count - at)] for at, rows in self._kept]
        self.next_scan = first + count
        self._kept = [part for part in self._kept if part[0] + len(part[1]) > self.next_scan]
        return np.concatenate([part for part in parts if len(part)] or [np.empty(0, np.dtype([]))])


class Exchange:
    """Plays without a gap and reads what came meanwhile: each scan read belongs to a sample written a lag ago.

    Between two calls the rig has samples for the lag, so that the next ones need not come at once.

    Args:
        hardware: output and acquisition, of one rate.
        lag: samples that are ahead of what is read: zeros, at first.
    """

    def __init__(self, hardware: Hardware, lag: int) -> None:
        self._hardware = hardware
        self.lag = min(lag, hardware.wire.wanted().capacity // 4)
        self._ahead = np.zeros(self.lag)
        hardware.acquisition.start(hardware.output.start())
        hardware.output.write(self._ahead)

    def exchange(self, samples: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.void]]:
        """Write samples and read as many scans; return the samples that were played meanwhile, and the scans."""
        parts = []
        for at in range(0, len(samples), self.lag):
            block = samples[at : at + self.lag]
            self._hardware.output.write(block)
            parts.append(self._hardware.acquisition.read(len(block)))
        played = np.concatenate([self._ahead, samples])
        self._ahead = played[len(samples) :]
        return played[: len(samples)], np.concatenate(parts)
