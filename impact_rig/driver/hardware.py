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
whether the rig is in this process (`LocalRig`) or behind topics (`RosRig`), in real time or not.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_rig.driver.driver import RigDriver
from impact_rig.errors import CommandError
from impact_rig.simtime import NS_PER_S, stamp_ns
from impact_rig.topics import INFO

TIMEOUT_S = 10.0


class Hardware:
    """Output and acquisition of one rig.

    Args:
        rig: its drive is a stream; what it has published so far is forgotten as it is read here.
        abort: by channel, the largest reading of either sign that is tolerated.

    Attributes:
        output: plays.
        acquisition: reads.
    """

    def __init__(self, rig: RigDriver, abort: Mapping[str, float] = MappingProxyType({})) -> None:
        self.rig, self._abort = rig, abort
        self.output, self.acquisition = AnalogOutput(self), Acquisition(self)

    def info(self) -> NDArray[np.void]:
        """Return the calibration as last published: rows of `daq/info`."""
        return self.rig.tables(INFO.name)[-1].rows

    def turn(self, deadline: float, what: str) -> None:
        """Let rig time pass until scans arrive.

        Raises:
            TimeoutError: none arrived; names what was waited for.
            CommandError: a reading is beyond its limit, or the rig has stopped.
        """
        rig = self.rig
        try:
            rig.step(1, max(0.0, deadline - time.monotonic()))
        except TimeoutError as error:
            if stopped := rig.stopped:
                raise CommandError(stopped) from error
            raise TimeoutError(f"waited in vain for {what}: {rig.stream_level()}") from error
        found = [(rig.first_scan(table), table.rows) for table in rig.tables()]
        rig.clear()
        for first, rows in found:
            self.acquisition.take(first, rows)
            self._check(first, rows)

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
        self.acquisition.start(first * self.rig.rate_hz // self.rig.stream_rate_hz)
        size = self.rig.stream_level().capacity // 4
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
        self._hardware, self._rig = hardware, hardware.rig
        self.next_sample: int | None = None

    def start(self, lead_s: float | None = None) -> int:
        """Begin `lead_s` after the sample that is wanted next, or as early as it comes in time; return its number."""
        level = self._rig.stream_level()
        at = max(level.sample + level.buffered, self.next_sample or 0)
        self.next_sample = at + round((self._rig.lead_s if lead_s is None else lead_s) * self._rig.stream_rate_hz)
        return self.next_sample

    def ready(self, count: int) -> bool:
        """Whether the buffer takes so many samples more now."""
        level = self._rig.stream_level()
        return self._next() + count <= level.sample + level.capacity

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
        self._rig.feed(self._next(), values)
        self.next_sample = self._next() + len(values)

    def stop(self) -> None:
        """End the stream after what was written: the drive then ramps to zero, and nobody waits for more.

        Not started, or stopped by the rig itself: nothing happens.
        """
        if self.next_sample is not None:
            with contextlib.suppress(CommandError):
                self._rig.feed(self.next_sample, np.empty(0))

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
        rig = self._hardware.rig
        return (stamp_ns(scan, rig.rate_hz) - stamp_ns(sample, rig.stream_rate_hz)) / NS_PER_S

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
        self.lag = min(lag, hardware.rig.stream_level().capacity // 4)
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
