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
"""Drive of a shaker as a stream of samples: the buffer, the samples in effect, and the replacement of missing samples.

Sample k is k · 10⁹ // rate nanoseconds after scan 0. Between samples the drive is a straight line (first-order hold) or
constant at the sample before (zero-order hold). A drive segment ends at each sample and at each tick of the command
grid. When a tick is simulated, the samples that have arrived take effect in it, and missing samples are replaced. The
division of the samples into blocks, their order of arrival and repeated arrivals have no effect.
"""

from __future__ import annotations

import binascii
import copy
import enum
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import PI
from impact_rig.config import Drive, Shaker
from impact_rig.errors import CommandError
from impact_rig.physics.flight import SEGMENT
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S

SUM_TICKS = 100
"""Number of ticks (10 ms each) after which the checksum of the samples that took effect is reported: one second."""


class Event(enum.StrEnum):
    """Kind of an event in a stream: samples begin or cease to take effect, or a checksum of samples is reported."""

    BEGIN = "begin"
    END = "end"
    SUM = "crc32"


class Happened(NamedTuple):
    """Event in a stream.

    Attributes:
        event: kind of event.
        sample: number of a sample: the first that takes effect (BEGIN), the first that no longer does (END), or the
            first that the checksum covers (SUM).
        text: for an END its reason: underrun, ended or stopped. For a SUM `count crc`: the number of samples that the
            checksum covers, and their CRC-32 in hexadecimal. Otherwise empty.
    """

    event: Event
    sample: int
    text: str = ""


UNDERRUN, ENDED, STOPPED = "underrun", "ended", "stopped"
"""Reasons for the end of a stream, given in its END event: a sample did not arrive in time, the controller ended the
stream, or the shaker was stopped.
"""


class StreamState(enum.Enum):
    """State of a stream; the value of each member describes it."""

    RESTING = "no sample has taken effect yet"
    PLAYING = "samples are in effect"
    MISSING = "no sample arrived in time"
    OVER = "the controller has ended the stream, or the shaker was stopped"


class Buffer:
    """Ring buffer of a stream's samples by number; a sample can be replaced until the simulation has used it."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.ends: set[int] = set()
        """Numbers of samples at which the controller has ended the stream: the first one that does not exist."""
        self._values = np.zeros(capacity)
        self._tags = np.zeros(capacity, np.int64)  # number + 1
        self._whole_to = 0  # all samples are present from the first one played to here

    def put(self, first: int, values: NDArray[np.float64]) -> None:
        """Store samples, numbered from `first` on; an empty array marks the end of the stream at `first`.

        If the sample at a marked end arrives later, it cancels the mark. Samples with larger numbers do not. The caller
        must check that the samples are at most as many as the capacity, that none has been played, and that none is
        further ahead of the next sample to play than the capacity.
        """
        self.ends = {end for end in self.ends if not first <= end < first + len(values)}
        if len(values) == 0:
            self.ends.add(first)
        numbers = np.arange(first, first + len(values))
        self._values[numbers % self.capacity] = values
        self._tags[numbers % self.capacity] = numbers + 1

    def clear(self) -> None:
        """Remove all samples, and all ends of the stream that the controller has marked."""
        self._tags[:] = 0
        self._whole_to = 0
        self.ends.clear()

    def there(self, first: int, end: int) -> NDArray[np.bool_]:
        """Return for each of the samples `first` to `end` − 1 whether it is in the buffer, shape (end − first,).

        A played sample stays in the buffer until a later sample overwrites it.
        """
        numbers = np.arange(first, end)
        found: NDArray[np.bool_] = self._tags[numbers % self.capacity] == numbers + 1
        return found

    def values(self, first: int, end: int) -> NDArray[np.float64]:
        """Return the values of the samples `first` to `end` − 1; samples not in the buffer have arbitrary values."""
        found: NDArray[np.float64] = self._values[np.arange(first, end) % self.capacity]
        return found

    def first_missing(self, first: int) -> int:
        """Return the number of the first sample, from `first` on, that is not in the buffer."""
        at = max(first, self._whole_to)
        missing = np.flatnonzero(~self.there(at, first + self.capacity))
        self._whole_to = at + int(missing[0]) if len(missing) else first + self.capacity
        return self._whole_to

    def first_there(self, first: int) -> int | None:
        """Return the number of the first sample, from `first` on, that is in the buffer, or None if there is none."""
        found = np.flatnonzero(self.there(first, first + self.capacity))
        return first + int(found[0]) if len(found) else None


class Stream:
    """Player of a stream: turns buffered samples into drive segments, tick by tick. Copies share the buffer.

    To play a sample means to use it in the drive segments of a tick. A missing sample is replaced by a ramp to zero or
    by the last value.

    Attributes:
        rate_hz: samples per second.
        capacity: number of samples that the buffer holds.
        buffer: buffered samples, by number.
        played: number of the next sample to play, counted from 0; all earlier samples have taken effect or were
            replaced.
        state: state of the stream.
        missing: number of samples that did not arrive in time and were replaced. Samples that are missing before the
            first sample, after a stop, or after the controller ended the stream, do not count.
        events: events that the owner of the stream has not collected yet.
    """

    def __init__(self, drive: Drive, shaker: Shaker) -> None:
        self.rate_hz, self._buffer_s = drive.stream_rate_hz, drive.stream_buffer_s
        self.capacity = math.ceil(self._buffer_s * self.rate_hz) + 1
        self.buffer = Buffer(self.capacity)
        self.played = 0
        self.state = StreamState.RESTING
        self.missing = 0
        self.events: list[Happened] = []
        self._linear = drive.stream_hold == "first_order"
        self._holds_on_underrun = drive.on_underrun == "hold"
        self._recent = np.zeros(2)  # the last two samples in effect
        self._last_value = 0.0  # the last value in effect, which is held or ramped down
        self._ramped = 0  # number of missing samples since then, at most the length of a ramp
        self._ramps_down = True  # whether missing samples ramp to zero, or hold the value
        self._end_reason = UNDERRUN  # reason for the end at a missing sample, unless the controller ends it there
        self._crc_first, self._crc_count, self._crc = 0, 0, 0
        self._ramp_samples = 1  # number of samples of a ramp to zero
        self.set_ramp(shaker.ramp_s)

    def set_ramp(self, ramp_s: float) -> None:
        """Set the time [s] of the ramp to zero at missing samples, rounded up to whole samples, at least one sample.

        A ramp under way starts again at the present value.
        """
        if self.state is not StreamState.PLAYING and self._ramps_down and self._ramped:
            # from the present value, because the drive must not jump
            self._last_value, self._ramped = self._last_value * (1.0 - self._ramped / self._ramp_samples), 0
        self._ramp_samples = max(1, math.ceil(ramp_s * self.rate_hz - 1e-9))

    def copy(self) -> Stream:
        """Return a copy of this stream that continues from the same state on its own.

        Only the buffer is shared: samples that are put into one copy, or dropped from it, are so in the other one as
        well.
        """
        twin = copy.copy(self)
        twin.events = list(self.events)
        return twin

    def time_ns(self, sample: int) -> int:
        """Return the time of a sample after scan 0 [ns]; sample 0 is at scan 0, even if the stream begins later."""
        return sample * NS_PER_S // self.rate_hz

    def put(self, first: int, values: NDArray[np.float64]) -> int:
        """Store a block of samples, numbered from `first` on; return how many arrived too late and were ignored.

        A sample is too late if its number is below `played`. Other samples replace stored samples of the same number.
        An empty block ends the stream at `first`, or at `played` if `played` is later.

        Raises:
            CommandError: the block reaches further ahead than the buffer does; nothing is stored.
        """
        if first + len(values) > self.played + self.capacity:
            ahead = (self.time_ns(first + len(values)) - self.time_ns(self.played)) / NS_PER_S
            raise CommandError(
                f"the block of samples is rejected, because it reaches {ahead:.6g} s ahead of the rig, beyond "
                f"drive.stream_buffer_s = {self._buffer_s:g} s: send fewer samples, and the others later"
            )
        self.buffer.ends = {end for end in self.buffer.ends if end >= self.played}  # the others have taken effect
        late = min(len(values), max(0, self.played - first))
        if late < len(values) or len(values) == 0:
            self.buffer.put(max(first, self.played), values[late:])
        if len(values) == 0 and self.state is not StreamState.PLAYING and self.buffer.first_there(self.played) is None:
            self.state = StreamState.OVER
        return late

    def stop(self, tick: int) -> float:
        """Drop all buffered samples, and return the value of the drive at the start of `tick`, the next tick.

        From this instant on the stream is zero until new samples take effect. The caller must add a ramp from the
        returned value to zero, so that the drive does not jump.
        """
        value = self._value_at(tick)
        self.buffer.clear()
        self._recent = np.zeros(2)
        self._last_value, self._ramps_down = 0.0, True
        self._end_reason = STOPPED
        if self.state is not StreamState.PLAYING:
            self.state = StreamState.OVER
        return value

    def _value_at(self, tick: int) -> float:
        """Return the value of the drive at the start of `tick`, the next tick, from the samples played so far."""
        before, last = map(float, self._recent)
        if not self._linear or self.played == 0:
            return last
        at_ns, start_ns, end_ns = tick * COMMAND_GRID_NS, self.time_ns(self.played - 2), self.time_ns(self.played - 1)
        return last if end_ns <= at_ns else before + (last - before) * ((at_ns - start_ns) / (end_ns - start_ns))

    def buffered(self) -> int:
        """Return how many samples are in the buffer from the next one to play up to the first missing one."""
        return self.buffer.first_missing(self.played) - self.played

    def ticks_until_event(self, tick: int) -> int:
        """Return how many ticks to play from `tick` on, so that the next event of the stream is in the last of them.

        The next event is one of three: the first sample takes effect, the first sample is missing while others take
        effect, or a checksum is due at a full second. So the result is at most one second (`SUM_TICKS`).
        """
        ahead = SUM_TICKS - tick % SUM_TICKS
        at = self._first_missing() if self.state is StreamState.PLAYING else self.buffer.first_there(self.played)
        return ahead if at is None else min(ahead, max(1, self._tick_of(at) - tick + 1))

    def whole_ticks(self) -> int | None:
        """Return the number of the first tick that needs a sample which is not in the buffer.

        All ticks before it can be played without replacing a sample. The result is None if no more samples are due,
        because the controller has ended the stream or the shaker was stopped.
        """
        missing = self._first_missing()
        over = self.state is StreamState.OVER or self._end_reason == STOPPED
        if missing in self.buffer.ends or (over and missing == self.played):
            return None
        return self._tick_of(missing)

    def segments(self, tick: int, count: int, tick_s: float) -> NDArray[np.void]:
        """Play the samples of the ticks `tick` to `tick` + `count` − 1; return their drive segments, dtype `SEGMENT`.

        `tick_s` is the duration of one tick [s]. `_without` describes how missing samples are replaced.
        """
        begin_ns, end_ns = tick * COMMAND_GRID_NS, (tick + count) * COMMAND_GRID_NS
        first = -(-(begin_ns + 1) * self.rate_hz // NS_PER_S) - 1  # the last one not after the start
        first_new, end = self.played, -(-end_ns * self.rate_hz // NS_PER_S) + self._linear
        values = self._play(end)
        values = np.concatenate([self._recent[2 - first_new + first :], values]) if first < first_new else values
        self._recent = np.concatenate([self._recent, values])[-2:]
        numbers = np.arange(first, end)
        times_ns = numbers // self.rate_hz * NS_PER_S + numbers % self.rate_hz * NS_PER_S // self.rate_hz
        inside = (times_ns >= begin_ns) & (times_ns < end_ns)
        edges = np.concatenate([times_ns[inside], np.arange(begin_ns, end_ns, COMMAND_GRID_NS)])
        edges.sort(kind="stable")  # merges two sorted parts; numpy's `union1d` takes five times as long
        edges = edges[np.diff(edges, prepend=-1) > 0]
        at = np.searchsorted(times_ns, edges, side="right") - 1
        rows = np.zeros(len(edges), SEGMENT)
        rows["begin"] = edges % COMMAND_GRID_NS / COMMAND_GRID_NS * tick_s
        rows["duration"] = np.diff(edges, append=end_ns) / COMMAND_GRID_NS * tick_s
        rows["phase"] = PI / 2.0
        rows["amplitude"] = values[at]
        if self._linear:
            progress = (edges - times_ns[at]) / (times_ns[at + 1] - times_ns[at])
            rise = values[at + 1] - values[at]
            rows["amplitude"] += rise * progress
            rows["growth"] = rise / ((times_ns[at + 1] - times_ns[at]) / COMMAND_GRID_NS * tick_s)
        if (tick + count) % SUM_TICKS == 0:
            self._sum_up()
        return rows

    def _first_missing(self) -> int:
        return self.buffer.first_missing(self.played)

    def _tick_of(self, sample: int) -> int:
        """Return the number of the first tick whose drive depends on a given sample."""
        return self.time_ns(max(0, sample - self._linear)) // COMMAND_GRID_NS

    def _play(self, end: int) -> NDArray[np.float64]:
        """Play the samples from number `played` to `end` − 1, and return their values.

        `_without` describes how missing samples are replaced.
        """
        parts = [np.empty(0)]
        while self.played < end:
            there = self.buffer.there(self.played, end)
            change = np.flatnonzero(there != there[0])
            count = int(change[0]) if len(change) else end - self.played
            parts.append(self._samples(count) if there[0] else self._without(count))
            self.played += count
        return np.concatenate(parts)

    def _samples(self, count: int) -> NDArray[np.float64]:
        if self.state is not StreamState.PLAYING:
            self.state = StreamState.PLAYING
            self.events.append(Happened(Event.BEGIN, self.played))
        self._end_reason = UNDERRUN
        values = self.buffer.values(self.played, self.played + count)
        if self._crc_count == 0:
            self._crc_first = self.played
        self._crc, self._crc_count = binascii.crc32(values.tobytes(), self._crc), self._crc_count + count
        self._last_value = float(values[-1])
        return values

    def _without(self, count: int) -> NDArray[np.float64]:
        """Return values that replace `count` missing samples: a straight ramp from the last value to zero, then zeros.

        The ramp takes the time set with `set_ramp`. After an underrun with `drive.on_underrun: hold`, the last value is
        repeated instead. If samples have taken effect until now, the event END is added.
        """
        if self.state is StreamState.PLAYING:
            self._sum_up()
            why = ENDED if self._end_reason == UNDERRUN and self.played in self.buffer.ends else self._end_reason
            self.events.append(Happened(Event.END, self.played, why))
            self.state = StreamState.MISSING if why == UNDERRUN else StreamState.OVER
            self._ramped, self._ramps_down = 0, why != UNDERRUN or not self._holds_on_underrun
        self.missing += count * (self.state is StreamState.MISSING)
        ramped = np.arange(self._ramped + 1, self._ramped + count + 1)
        self._ramped = min(self._ramped + count, self._ramp_samples)
        if not self._ramps_down:
            return np.full(count, self._last_value)
        return np.asarray(self._last_value * (1.0 - np.minimum(ramped, self._ramp_samples) / self._ramp_samples))

    def _sum_up(self) -> None:
        if self._crc_count:
            self.events.append(Happened(Event.SUM, self._crc_first, f"{self._crc_count} {self._crc:08x}"))
        self._crc_count = self._crc = 0
