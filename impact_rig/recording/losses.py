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
"""What is missing in a recording: messages that never reached the recorder, and scans whose stamps leave a gap.

rclpy tells the sequence number of a message and not who sent it. So the numbers of a topic are sorted into streams, one
per publisher: a message continues the stream whose next number it has. Where it continues none, it begins the stream of
a publisher that has not been heard yet, if the graph has one; otherwise the numbers in between are lost.

The stamp of scan i is `start_ns + i * 10**9 // rate_hz`: exact integers, so that one missing scan in an hour shows.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence

import attrs
import numpy as np

from impact_rig.blocks import Table
from impact_rig.recording.records import DamageError
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S

RECORD_NAME = "impact_rig/losses"  # metadata record with what was received and lost, written when a file is finished
_LONGEST_BLOCK_S = 1e6  # a `time` beyond this (or NaN) is no instant of a block
WHOLE = 1e-6  # relative departure of a rate from a whole number that rounded times have
MAX_STREAMS = 64  # streams kept per topic: of publishers that come and go for days only the last ones can still speak

Publishers = Callable[[str], Mapping[str, str]]
"""Returns who publishes a topic now: an identifier that is never used twice -> a name for people."""


@attrs.define
class PublisherStream:
    """The messages of one publisher on one topic."""

    publisher: str  # its name where it is certain, else empty
    first: int  # sequence number of its first message; what was published before is no loss
    newest: int  # sequence number of its newest message
    received: int = 1
    lost: int = 0  # messages between `first` and `newest` that did not

    def take(self, sequence: int) -> None:
        """Count a message, and those that should have come before it."""
        self.lost += sequence - self.newest - 1
        self.received += 1
        self.newest = sequence


@attrs.define
class _Topic:
    streams: list[PublisherStream] = attrs.field(factory=list)
    begun: int = 0  # streams, those that were dropped included
    known: dict[str, str] = attrs.field(factory=dict)  # publishers seen in the graph so far
    unnumbered: int = 0
    forgotten: PublisherStream | None = None  # sum of the streams that were dropped


class Account:
    """Counts what arrives, and finds what did not.

    Args:
        publishers: looks into the graph; None: one publisher per topic, as long as its numbers go up.
    """

    def __init__(self, publishers: Publishers | None = None) -> None:
        self._publishers = publishers
        self._topics: dict[str, _Topic] = {}

    def take(self, topic: str, sequence: int) -> str:
        """Count a message and return the publisher's name, empty where it is not certain.

        Args:
            topic: fully qualified name.
            sequence: publication sequence number; 0: there is none, so that nothing can be found missing.
        """
        known = self._topics.get(topic) or self._topics.setdefault(topic, _Topic())
        if sequence <= 0:
            known.unnumbered += 1
            return ""
        for stream in known.streams:
            if stream.newest + 1 == sequence:
                stream.take(sequence)
                return stream.publisher
        return self._take_unexpected(topic, known, sequence)

    def lost(self) -> dict[str, int]:
        """Return how many messages are missing, by topic; only topics that lack any."""
        return lost({name: self._streams(name) for name in self._topics})

    def writers(self, topic: str) -> list[str]:
        """Return the publishers of a topic on which more than one has written, as far as the graph has named them."""
        known = self._topics.get(topic)
        return sorted(set(known.known.values())) if known is not None and len(known.streams) > 1 else []

    def to_record(self) -> dict[str, str]:
        """Return the content of the metadata record: by topic a JSON list of its streams."""
        return {name: json.dumps([attrs.asdict(s) for s in self._streams(name)]) for name in self._topics}

    def _take_unexpected(self, topic: str, known: _Topic, sequence: int) -> str:
        present = dict(self._publishers(topic)) if self._publishers is not None else {}
        new = [name for identifier, name in present.items() if identifier not in known.known]
        known.known |= present
        earlier = [stream for stream in known.streams if stream.newest < sequence]
        if earlier and known.begun >= max(len(known.known), 1):
            stream = max(earlier, key=lambda one: one.newest)
            stream.take(sequence)
            return stream.publisher
        stream = PublisherStream(new[0] if len(new) == 1 else "", sequence, sequence)
        known.streams.append(stream)
        known.begun += 1
        if len(known.streams) > MAX_STREAMS:
            gone, before = known.streams.pop(0), known.forgotten or PublisherStream("", 0, 0, 0)
            known.forgotten = PublisherStream("", 0, 0, before.received + gone.received, before.lost + gone.lost)
        return stream.publisher

    def _streams(self, name: str) -> list[PublisherStream]:
        known = self._topics[name]
        plain = [PublisherStream("", 0, 0, known.unnumbered)] if known.unnumbered else []
        return [*([known.forgotten] if known.forgotten else []), *known.streams, *plain]


def lost(streams: Mapping[str, Sequence[PublisherStream]]) -> dict[str, int]:
    """Return how many messages are missing in streams by topic; only topics that lack any."""
    return {name: count for name, found in streams.items() if (count := sum(stream.lost for stream in found))}


def read_record(record: Mapping[str, str]) -> dict[str, list[PublisherStream]]:
    """Return what `Account.to_record` wrote.

    Raises:
        DamageError: the record holds something else.
    """
    try:
        return {name: [_stream(entry) for entry in json.loads(text)] for name, text in record.items()}
    except (ValueError, TypeError, RecursionError) as error:
        raise DamageError(f"the metadata record {RECORD_NAME!r} cannot be understood: {error}") from error


def _stream(entry: dict[str, object]) -> PublisherStream:
    stream = PublisherStream(**entry)  # type: ignore[arg-type]  # checked below
    if not isinstance(stream.publisher, str) or any(
        type(number) is not int or number < 0 for number in (stream.first, stream.newest, stream.received, stream.lost)
    ):
        raise ValueError(f"{entry} is no count of messages")
    return stream


@attrs.frozen
class Gap:
    """A place where blocks do not follow each other."""

    block: int  # number of the block after the gap, counted from 0
    expected_ns: int
    stamp_ns: int
    missing_scans: int
    """Scans between the two; negative if the stamp went back (a reset, a block twice or out of order); 0 if the stamp
    is none a scan can have."""


@attrs.frozen
class Contiguity:
    """What the stamps of a sequence of blocks say."""

    blocks: int
    scans: int
    gaps: tuple[Gap, ...]
    lost_blocks: int
    """Blocks that would fill the gaps, counted in blocks as long as the one before each gap, rounded up."""
    lost_scans: int
    restarts: int  # how often the stamps went back

    @property
    def whole(self) -> bool:
        """Whether nothing is missing and nothing comes twice."""
        return not self.gaps


def check_contiguity(
    blocks: Iterable[tuple[int, int]],
    rate_hz: float,
    start_ns: int | None = None,
    starts: Iterable[int] = (),
    resets: Iterable[int] = (),
) -> Contiguity:
    """Check that blocks follow each other.

    Args:
        blocks: stamp [ns] and number of scans of each, in the order they are to be judged.
        rate_hz: scans per second.
        start_ns: rig time of scan 0. None: unknown; then the first block anchors the index (and again one whose stamp
            does not fit, so that a rig started anew counts as one gap), and where the scan period is no whole number of
            nanoseconds a stamp may be off by the one nanosecond that its unknown index leaves open.
        starts: rig times of scan 0 of further rigs: between the last block of one and that of the next nothing is
            missing.
        resets: rig times of scan 0 after each reset. A reset drops the scans that do not fill a block: fewer than a
            block and a tick of commands.
    """
    over, under = rate_hz.as_integer_ratio()
    period_exact = NS_PER_S * under % over == 0
    slack = 0 if start_ns is not None or period_exact else 1
    count = scans = lost_blocks = lost_scans = restarts = 0
    gaps: list[Gap] = []
    anchor_ns = start_ns
    index = before = 0  # of the next scan, counted from the anchor; scans of the block before
    dropped = dict.fromkeys(starts, True) | dict.fromkeys(resets, False)
    begins, newest = deque(sorted(dropped)), 0
    for stamp, length in blocks:
        while begins and begins[0] <= stamp:
            if (begin := begins.popleft()) > newest and count:
                if not dropped[begin] and anchor_ns is not None:
                    expected = anchor_ns + index * NS_PER_S * under // over
                    missing = (begin - expected) * over // (under * NS_PER_S)
                    if missing >= before + -(-COMMAND_GRID_NS * over // (under * NS_PER_S)):
                        gaps.append(Gap(count, expected, begin, missing))
                        lost_scans += missing
                        lost_blocks += missing // max(before, 1)
                anchor_ns, index = begin, 0
        newest = stamp
        if anchor_ns is None:
            anchor_ns = stamp
        elif count == 0:
            index = _nearest_index(stamp - anchor_ns, rate_hz)
        expected = anchor_ns + index * NS_PER_S * under // over
        if abs(stamp - expected) > slack:
            found = _nearest_index(stamp - anchor_ns, rate_hz)
            missing = found - index
            gaps.append(Gap(count, expected, stamp, missing))
            if missing > 0:
                lost_scans += missing
                lost_blocks += -(-missing // max(before or length, 1))
            elif missing < 0:
                restarts += 1
            index = found
            if start_ns is None and abs(stamp - (anchor_ns + found * NS_PER_S * under // over)) > slack:
                anchor_ns, index = stamp, 0
        count, scans, index, before = count + 1, scans + length, index + length, length
    return Contiguity(count, scans, tuple(gaps), lost_blocks, lost_scans, restarts)


def has_times(table: Table) -> bool:
    """Return whether a table, which may be anybody's, has a column `time` of numbers."""
    return "time" in (table.rows.dtype.names or ()) and table.rows.dtype["time"].kind in "iuf"


def last_scan_ns(table: Table) -> int:
    """Return the stamp of the last scan of a block [ns]; that of the block where its `time` column says nothing."""
    if not len(table.rows) or not has_times(table):
        return table.stamp_ns
    last_s = float(table.rows["time"][-1])
    return table.stamp_ns + (round(last_s * NS_PER_S) if abs(last_s) < _LONGEST_BLOCK_S else 0)


def scan_rate_hz(table: Table) -> float | None:
    """Return the rate of a block from its `time` column, an int where it is whole; None with fewer than two scans."""
    if not has_times(table) or len(table.rows) < 2:
        return None
    times = table.rows["time"].astype(np.float64)
    span = float(times[-1] - times[0])
    rate_hz = (len(times) - 1) / span if span > 0 else math.nan
    if not math.isfinite(rate_hz):
        return None
    whole = round(rate_hz)
    return whole if abs(rate_hz - whole) <= WHOLE * rate_hz else rate_hz


def _nearest_index(elapsed_ns: int, rate_hz: float) -> int:
    """Return the scan index whose stamp is nearest to `elapsed_ns` after the anchor."""
    over, under = rate_hz.as_integer_ratio()
    return (2 * elapsed_ns * over + under * NS_PER_S) // (2 * under * NS_PER_S)
