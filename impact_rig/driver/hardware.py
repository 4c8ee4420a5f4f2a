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
"""Buffered analog output and input of a rig, for programs that play samples and read the response.

`AnalogOutput` plays samples, `Acquisition` reads scans, and `Hardware` combines both for a program with one thread.
Output and acquisition can also run in two processes, each with its own `RosRig`, or in two threads that share one rig.
Threads cannot share a `RosRig` in lockstep: its step waits for samples, while the thread that writes them waits for the
step. Every call that waits has a time limit, and takes or returns any number of samples or scans.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_rig.blocks import Table
from impact_rig.driver.driver import RigDriver, StreamLevel
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments.registry import INSTRUMENTS
from impact_rig.instruments.section import SCAN
from impact_rig.simtime import NS_PER_S, stamp_ns
from impact_rig.topics import INFO

TIMEOUT_S = 10.0
SLICE_S = 0.1  # longest wait for a block before another thread has its turn
UNREAD_S = 60.0  # duration of the scans that an acquisition keeps for its reader


class UnderrunError(CommandError):
    """Underrun of an analog output: samples were not written in time, so the rig continued without them.

    Attributes:
        samples: number of missed samples: those that arrived too late and were dropped, and those not written in time.
    """

    def __init__(self, message: str, samples: int) -> None:
        super().__init__(message)
        self.samples = samples


class AnalogOutput:
    """Buffered output: the rig plays the samples that are written, without a gap between the calls that write them.

    Args:
        rig: rig with `drive.waveform: stream`; calls drop the tables that it keeps, except calibrations, commands and
            journal.
        buffer_s: longest time by which samples are written ahead of the rig [s], which is the latency of a controller
            (default: `drive.stream_buffer_s`).
        raise_underrun: whether `write` raises `UnderrunError` when samples were not written in time; otherwise it
            returns their number and continues at the rig's present time.

    Attributes:
        next_sample: number of the next sample to be written, counted from scan 0; None before the start.

    Raises:
        CommandError: the drive of the rig is not a stream.
        ConfigError: the buffer is shorter than two blocks of scans, or longer than that of the rig.
    """

    def __init__(self, rig: RigDriver, *, buffer_s: float | None = None, raise_underrun: bool = True) -> None:
        self._rig, self._raises = rig, raise_underrun
        self.next_sample: int | None = None
        self._playing = False
        self._waiting: list[NDArray[np.float64]] = []  # written before the start
        self._before = self._counted = self._level()
        self._block = math.ceil(rig.block_scans * rig.stream_rate_hz / rig.rate_hz)
        self._size = self._before.capacity
        if buffer_s is not None:
            least, most = 2 * self._block / rig.stream_rate_hz, self._size / rig.stream_rate_hz
            if not least <= buffer_s <= most:
                raise ConfigError(
                    f"buffer_s must be from {least:g} (two blocks) to {most:g} s (drive.stream_buffer_s), "
                    f"got {buffer_s:g}"
                )
            self._size = int(buffer_s * rig.stream_rate_hz)

    @property
    def buffered(self) -> int:
        """Number of samples that were written and have not been played yet.

        While the output is not playing, only samples that wait for the next `start` count.
        """
        if self.next_sample is None or not self._playing:
            return sum(map(len, self._waiting))
        return max(0, self.next_sample - self._level().sample)

    @property
    def space(self) -> int:
        """Number of samples that can be written now without waiting."""
        return self._size - self.buffered

    @property
    def late(self) -> int:
        """Number of samples since the last `start` that reached the rig too late, so they were not played."""
        return self._level().late - self._before.late

    @property
    def missing(self) -> int:
        """Number of samples since the last `start` that had not arrived when the rig needed them.

        `drive.on_underrun` sets what the rig plays instead.
        """
        return self._level().missing - self._before.missing

    def ready(self, count: int) -> bool:
        """Return whether `count` samples can be written now without waiting."""
        return count <= self.space

    def start(self, lead_s: float | None = None) -> int:
        """Begin to play the samples written so far.

        Args:
            lead_s: pause before the first of these samples [s of rig time]. It begins now or, if the rig still has
                earlier samples to play, after the last of them. Default: the shortest pause with which the first
                sample arrives in time, `rig.lead_s`.

        Returns:
            Number of the first of these samples, counted from scan 0 at the rate of the stream.
        """
        rig = self._rig
        with rig.turns:
            level = self._before = self._counted = self._level()
            at = max(level.sample + level.buffered, self.next_sample or 0)
            lead = round((rig.lead_s if lead_s is None else lead_s) * rig.stream_rate_hz)
            first = at + lead
            self.next_sample, self._playing = first, True
            if lead and not rig.lead_s:  # a rig that waits for samples waits for these, too
                rig.feed(at, np.zeros(lead))
            for values in self._waiting:
                self._feed(values)
            self._waiting.clear()
        return first

    def write(self, samples: ArrayLike, timeout_s: float = TIMEOUT_S) -> int:
        """Append samples, and return once the buffer has accepted them.

        Before `start`, samples are kept until `start`. If the buffer is full, a rig that does not run by itself is
        advanced. If another thread calls `stop` meanwhile, the samples not accepted yet are dropped.

        Args:
            samples: samples [A, m or V by `drive.kind`], shape (n,).
            timeout_s: longest wait for space in the buffer [s of wall time].

        Returns:
            Number of missed samples since the last call: those that came too late, and the sample numbers skipped to
            catch up with the rig; always 0 with `raise_underrun`.

        Raises:
            TimeoutError: the buffer had no space in time; the samples before `next_sample` were accepted.
            UnderrunError: samples came too late to be played, and `raise_underrun` is set; call `start` to continue.
            CommandError: the rig rejects the samples or has stopped, or more samples were written before the start than
                the buffer holds.
        """
        values = np.asarray(samples, np.float64)
        deadline, lost = time.monotonic() + timeout_s, 0
        if not self._playing:
            self._keep(values)
            return 0
        while len(values):
            with self._rig.turns:
                if not self._playing:  # another thread has stopped it
                    break
                lost += self._lost()
                space = self.space
                if space >= min(len(values), self._block, self._size):
                    self._feed(values[:space])
                    values = values[space:]
                    continue
            _advance(self._rig, deadline, f"room for {len(values)} samples")
        return lost

    def stop(self) -> None:
        """End the stream after the written samples: the drive ramps to zero, and the rig waits for no more samples.

        Samples that wait for `start` are dropped. It is no error if the output is not playing or the rig has stopped.
        """
        with self._rig.turns:
            if self._playing and self.next_sample is not None:
                with contextlib.suppress(CommandError, TimeoutError):  # a rig that is gone plays nothing, either
                    self._rig.feed(self.next_sample, np.empty(0))
                self._rig.fed.set()
            self._playing = False
            self._waiting.clear()

    def _keep(self, values: NDArray[np.float64]) -> None:
        if not self.ready(len(values)):
            raise CommandError(
                f"{len(values)} samples before the start do not fit: the buffer has room for {self.space}; "
                "call `start` first, or write fewer"
            )
        self._waiting.append(values)

    def _feed(self, values: NDArray[np.float64]) -> None:
        assert self.next_sample is not None
        self._rig.feed(self.next_sample, values)
        self._rig.fed.set()
        self.next_sample += len(values)

    def _lost(self) -> int:
        """Return the number of samples missed since the last call.

        If the rig has already passed `next_sample`, `next_sample` is increased to the first sample that can arrive in
        time. The skipped numbers count as missed, too.

        Raises:
            UnderrunError: samples were missed, and `raise_underrun` is set; the output then stops playing.
        """
        assert self.next_sample is not None
        level = self._level()
        lost = level.late - self._counted.late
        self._counted = level
        behind = level.sample - self.next_sample
        if behind > 0:
            skipped = behind + round(self._rig.lead_s * self._rig.stream_rate_hz)
            self.next_sample += skipped
            lost += skipped
        if lost and self._raises:
            self._playing = False
            raise UnderrunError(
                f"underrun: {lost} samples were not written in time, the rig is at sample {level.sample}, counted "
                "from scan 0; write earlier or with a larger buffer (buffer_s, drive.stream_buffer_s), and call "
                "`start` again",
                lost,
            )
        return lost

    def _level(self) -> StreamLevel:
        with self._rig.turns:
            _refresh(self._rig)
            return self._rig.stream_level()


class Acquisition:
    """Buffered input: it keeps the scans of a rig, from the call of `start` on, until they are read.

    Args:
        rig: rig to read; calls drop the tables that it keeps, except calibrations, commands and journal.
        buffer_s: duration of the scans that are kept for the reader [s]; older scans are lost.

    Attributes:
        next_scan: number of the next scan to be read; None until the number of the first scan is known.
        lost: number of scans since the last `start` that were not published, did not arrive or were not read in time.
    """

    def __init__(self, rig: RigDriver, *, buffer_s: float = UNREAD_S) -> None:
        self._rig = rig
        self._most = max(rig.block_scans, round(buffer_s * rig.rate_hz))
        self._kept: deque[tuple[int, NDArray[np.void]]] = deque()
        self.next_scan: int | None = None
        self.lost = 0
        self._end = 0  # number of the scan after the last one that arrived
        self._started = False
        self._is_waiting = False  # whether a `read` waits; no scan that arrives meanwhile is lost

    @property
    def available(self) -> int:
        """Number of scans that `read` returns without waiting: from `next_scan` to the newest that has arrived.

        Lost scans among them count, too, although `read` leaves them out.
        """
        with self._rig.turns:
            _refresh(self._rig)
            self._count_withheld()
            return 0 if self.next_scan is None else max(0, self._end - self.next_scan)

    def start(self, scan: int | None = None) -> None:
        """Start to keep scans, from number `scan` on, or by default from the next scan that arrives.

        The count `lost` restarts at 0. Of the scans kept earlier, those from number `scan` on can still be read; the
        rest is dropped.
        """
        with self._rig.turns:
            if not self._started:
                self._rig.connect(self._on_block)
            self._started = True
            self._kept = deque(part for part in self._kept if scan is not None and part[0] + len(part[1]) > scan)
            self.next_scan, self.lost = scan, 0
            self._end = self._kept[-1][0] + len(self._kept[-1][1]) if self._kept else scan or 0

    def stop(self) -> None:
        """Stop keeping scans; scans that have arrived can still be read, and a `read` of more scans starts again."""
        with self._rig.turns:
            if self._started:
                self._rig.disconnect(self._on_block)
            self._started = False

    def delay_s(self, sample: int, scan: int) -> float:
        """Return how much later in rig time a scan is taken than an output sample is played [s]; negative if earlier.

        Args:
            sample: number of the sample, counted from scan 0 at the rate of the stream.
            scan: number of the scan, counted from scan 0.
        """
        rig = self._rig
        return (stamp_ns(scan, rig.rate_hz) - stamp_ns(sample, rig.stream_rate_hz)) / NS_PER_S

    def read(self, count: int, timeout_s: float = TIMEOUT_S) -> NDArray[np.void]:
        """Return the next `count` scans as soon as they have arrived; start the acquisition if necessary.

        A rig that does not run by itself is advanced until they have arrived.

        Args:
            count: number of scans.
            timeout_s: longest time without a new scan [s of wall time].

        Returns:
            Rows with a field for each channel, shape (count,); fewer if some of these scans were lost.

        Raises:
            TimeoutError: no scan arrived within `timeout_s`, also if the rig lacked samples of the output.
            CommandError: the shaker was stopped, so the rig did not advance.
        """
        # first: scans that arrived before this call count against the buffer
        if self.available < count and not self._started:
            self.start(self.next_scan)
        deadline, before = time.monotonic() + timeout_s, self._end
        self._is_waiting = True
        try:
            while self.available < count:
                _advance(self._rig, deadline, f"{count} scans")
                if self._end > before:
                    deadline, before = time.monotonic() + timeout_s, self._end
            return self._cut(count)
        finally:
            self._is_waiting = False

    def read_remaining(self) -> NDArray[np.void]:
        """Return the scans that have arrived and have not been read, without waiting."""
        return self._cut(self.available)

    def _on_block(self, table: Table) -> None:
        first, rows = self._rig.first_scan(table), table.rows
        if self.next_scan is None:
            self.next_scan = self._end = first
        if first + len(rows) <= self.next_scan:
            return
        self.lost += max(0, first - self._end)
        self._end = first + len(rows)
        self._kept.append((first, rows))
        while self._end - self.next_scan > self._most and not self._is_waiting:
            oldest, rows = self._kept[0]
            if self.next_scan < oldest:  # lost scans need no room, and are counted already
                self.next_scan = oldest
                continue
            self._kept.popleft()
            self.lost += oldest + len(rows) - self.next_scan
            self.next_scan = oldest + len(rows)

    def _count_withheld(self) -> None:
        """Count the scans that a fault withholds in `lost`, if the rig advances only in `step`.

        The next block would also show the gap. But such a rig may wait for samples before that block, and the program
        may write them only after its `read` has passed the withheld scans.
        """
        taken = self._rig.sample
        if self._started and self._rig.step_delivers and self.next_scan is not None and taken > self._end:
            self.lost += taken - self._end
            self._end = taken

    def _cut(self, count: int) -> NDArray[np.void]:
        with self._rig.turns:
            first = self.next_scan or 0
            parts = [rows[max(0, first - at) : max(0, first + count - at)] for at, rows in self._kept]
            self.next_scan = first + count if self.next_scan is not None else None
            while self._kept and self._kept[0][0] + len(self._kept[0][1]) <= first + count:
                self._kept.popleft()
        return np.concatenate([part for part in parts if len(part)] or [np.empty(0, SCAN)])


class Hardware:
    """Analog output and acquisition of one rig, for a program that plays samples and reads the response.

    Args:
        rig: rig with `drive.waveform: stream`; calls drop the tables that it keeps, except calibrations, commands and
            journal.
        abort: largest absolute reading that is allowed, in the unit of its channel, by channel. A larger reading raises
            a `CommandError` in the call that receives it; the output continues.

    Attributes:
        rig: the rig.
        output: buffered output of the rig, which plays samples.
        acquisition: buffered input of the rig, which reads scans.
    """

    def __init__(self, rig: RigDriver, abort: Mapping[str, float] = MappingProxyType({})) -> None:
        self.rig, self._abort = rig, abort
        self.output, self.acquisition = AnalogOutput(rig), Acquisition(rig)
        if abort:
            rig.connect(self._check)

    def info(self) -> NDArray[np.void]:
        """Return the last published calibration of the rig: rows of `daq/info`, one per channel."""
        self.rig.newest(INFO.name, 1)  # waits until it has arrived
        return self.rig.tables(INFO.name)[-1].rows

    def respond(self, samples: ArrayLike, rest: int = 0) -> NDArray[np.void]:
        """Play samples; return the scans taken while the samples were played, and `rest` further scans.

        The stream ends after the last sample, so the drive ramps to zero during the further scans. Lost scans are
        missing from the result.

        Raises:
            ConfigError: samples and scans have different rates.
            TimeoutError: the rig did not advance in time.
            CommandError: a reading exceeds the limit of `abort`, samples were rejected or came too late, or the shaker
                was stopped.
        """
        _check_rates(self.rig)
        values = np.asarray(samples, np.float64)
        begin = self.output.start()
        self.acquisition.start(begin)
        parts, size = [], self.rig.stream_level().capacity // 4
        for at in range(0, len(values), size):
            self.output.write(values[at : at + size])
            parts.append(self.acquisition.read_remaining())
        self.output.stop()
        left = begin + len(values) + rest - (self.acquisition.next_scan or begin)
        parts.append(self.acquisition.read(max(0, left)))
        return np.concatenate(parts)[: len(values) + rest]

    def _check(self, table: Table) -> None:
        for channel, limit in self._abort.items():
            beyond = np.flatnonzero(np.abs(table.rows[channel]) > limit)
            if len(beyond):
                scan = self.rig.first_scan(table) + int(beyond[0])
                reading, unit = table.rows[channel][beyond[0]], INSTRUMENTS[channel].unit
                raise CommandError(
                    f"aborted: {channel} reads {reading:.6g} {unit}, beyond the limit ±{limit:g} {unit}, at scan "
                    f"{scan}; reduce the drive, or raise this limit"
                )


class Exchange:
    """Gapless exchange of samples and scans: each call plays samples and reads as many scans.

    The scans of a call belong to samples that were written `lag` samples earlier. When a call returns, the rig still
    has `lag` samples to play, so the caller has that time until the next call. The constructor starts output and
    acquisition.

    Args:
        hardware: output and acquisition, with equal rates.
        lag: number of samples that are written ahead of the scans read, at least 1; the first ones are zeros. It is
            limited to a quarter of the rig's buffer.

    Raises:
        ConfigError: samples and scans have different rates, or the lag is less than 1.
    """

    def __init__(self, hardware: Hardware, lag: int) -> None:
        _check_rates(hardware.rig)
        if lag < 1:
            raise ConfigError(f"lag of an Exchange must be at least 1 sample, got {lag}")
        self._hardware = hardware
        self.lag = min(lag, hardware.rig.stream_level().capacity // 4)
        self._ahead = np.zeros(self.lag)
        hardware.acquisition.start(hardware.output.start())
        hardware.output.write(self._ahead)

    def exchange(self, samples: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.void]]:
        """Write samples and read as many scans.

        Returns:
            The samples that were played during these scans (`lag` samples before the samples written now), and the
            scans. If scans were lost, there are fewer scans than samples.
        """
        parts = []
        for at in range(0, len(samples), self.lag):
            block = samples[at : at + self.lag]
            self._hardware.output.write(block)
            parts.append(self._hardware.acquisition.read(len(block)))
        played = np.concatenate([self._ahead, samples])
        self._ahead = played[len(samples) :]
        return played[: len(samples)], np.concatenate(parts)


def _check_rates(rig: RigDriver) -> None:
    """Raise a ConfigError if the rates of samples and scans differ, so that they are not one to one."""
    if rig.stream_rate_hz != rig.rate_hz:
        raise ConfigError(
            f"the rate of the output must be that of the scans, got drive.stream_rate_hz = {rig.stream_rate_hz} Hz and "
            f"daq.rate_hz = {rig.rate_hz} Hz"
        )


def _refresh(rig: RigDriver) -> None:
    """Process the messages that have arrived from a rig that runs by itself, and free the tables that it keeps.

    The rig's listeners receive the new scans. For a rig that advances only in `step`, the call has no effect.
    """
    if rig.runs_by_itself:
        rig.poll()
        rig.clear()


def _advance(rig: RigDriver, deadline: float, what: str) -> None:
    """Advance the rig by one block, and drop its tables, except those of `ESSENTIAL`.

    For a rig that runs by itself, wait at most 0.1 s (`SLICE_S`) for a block. If another rig lacks samples for the
    block, wait until another thread writes some, or until the deadline. In both cases, the call can return without a
    new block.

    Args:
        rig: the rig.
        deadline: end of the wait [s, monotonic clock].
        what: what is awaited, for the error message.

    Raises:
        TimeoutError: the rig did not advance, and the deadline has passed.
        CommandError: the rig did not advance, because its shaker is stopped.
    """
    left = max(0.0, deadline - time.monotonic())
    with rig.turns:
        rig.fed.clear()
        try:
            rig.step(1, min(left, SLICE_S) if rig.runs_by_itself else left)
        except TimeoutError as error:
            if stopped := rig.stopped:
                raise CommandError(stopped) from error
            if time.monotonic() >= deadline:
                raise TimeoutError(
                    f"timeout: waiting for {what}{_drive_stream(rig)}; check that the rig advances"
                ) from error
            if rig.runs_by_itself:
                rig.fed.set()
        else:
            rig.fed.set()
        finally:
            rig.clear()
    rig.fed.wait(deadline - time.monotonic())


def _drive_stream(rig: RigDriver) -> str:
    """Return the state of the rig's stream as the end of an error message; empty if the drive is not a stream."""
    try:
        return f"; drive stream: {rig.stream_level()}"
    except CommandError:
        return ""
