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
"""Losses of a recording: messages that never reached the recorder, and gaps between the stamps of scans.

rclpy provides the sequence number of a message but not its sender. The numbers of a topic are therefore sorted into
streams, one per publisher. A message continues the stream whose next number it has. Without such a stream, the message
starts a new stream if the graph has a publisher without a stream, or if no stream has a smaller number. Otherwise the
message continues the stream with the largest smaller number, and the numbers in between count as lost messages.

The stamp of scan i is `start_ns + i * 10**9 // rate_hz`: exact integers, so one missing scan in an hour is detected.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence

import attrs
import numpy as np

from impact_rig import topics
from impact_rig.blocks import Table
from impact_rig.recording.records import DamageError
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S, first_scan_at, scan_index, stamp_ns

RECORD_NAME = "impact_rig/losses"  # metadata record of received and lost messages, written when a file is finished
REPLACED = frozenset(topic.name for topic in topics.COMMON if topic.qos is topics.Qos.LATCHED)
"""Relative names of the latched topics, whose publishers keep only the newest message.

A message that was replaced by a newer one before the recorder received it does not count as lost.
"""
_LONGEST_BLOCK_S = 1e6  # a larger `time` (or NaN) in a row is invalid, because no block lasts so long
WHOLE = 1e-6  # tolerance within which a rate counts as a whole number, relative: times are rounded
# maximum number of streams per topic: if publishers come and go for days, only the last ones are still alive
MAX_STREAMS = 64

Publishers = Callable[[str], Mapping[str, str]]
"""Type of a function that returns the present publishers of a topic: unique identifier -> readable name."""


@attrs.define
class PublisherStream:
    """Counts of the received and lost messages of one publisher on one topic."""

    publisher: str  # name of the publisher if it is certain, else empty
    first: int  # sequence number of its first message; earlier messages do not count as lost
    newest: int  # sequence number of its newest message
    received: int = 1
    lost: int = 0  # number of missing messages between `first` and `newest`

    def take(self, sequence: int) -> None:
        """Count the message with this sequence number as received.

        The messages between `newest` and this number count as lost. The number must be larger than `newest`.
        """
        self.lost += sequence - self.newest - 1
        self.received += 1
        self.newest = sequence


@attrs.define
class _Topic:
    streams: list[PublisherStream] = attrs.field(factory=list)  # the longest inactive one first
    count: int = 0  # number of streams, including dropped ones
    known: dict[str, str] = attrs.field(factory=dict)  # publishers seen in the graph so far
    unnumbered: int = 0
    forgotten: PublisherStream | None = None  # sum of the dropped streams

    def take(self, place: int, sequence: int) -> str:
        """Count a message for the stream at an index of `streams`, and return its publisher."""
        stream = self.streams[place]
        stream.take(sequence)
        if place < len(self.streams) - 1:
            self.streams.append(self.streams.pop(place))
        return stream.publisher


class Account:
    """Account of the messages that a recorder has received and missed, by topic and publisher.

    Args:
        publishers: function that returns the present publishers of a topic. None means that they are unknown: a topic
            then has one publisher, and a further one each time that the sequence numbers start again.
    """

    def __init__(self, publishers: Publishers | None = None) -> None:
        self._publishers = publishers
        self._topics: dict[str, _Topic] = {}

    def take(self, topic: str, sequence: int) -> str:
        """Count a message and return the name of its publisher, or an empty text if the publisher is uncertain.

        Args:
            topic: fully qualified name of the topic.
            sequence: publication sequence number; 0 means none, so losses cannot be detected.
        """
        known = self._topics.get(topic) or self._topics.setdefault(topic, _Topic())
        if sequence <= 0:
            known.unnumbered += 1
            return ""
        for place in range(len(known.streams) - 1, -1, -1):  # the last active one first
            if known.streams[place].newest + 1 == sequence:
                return known.take(place, sequence)
        return self._take_unexpected(topic, known, sequence)

    def lost(self) -> dict[str, int]:
        """Return the number of missing messages by topic; topics without losses are left out."""
        return lost({name: self._streams(name) for name in self._topics})

    def writers(self, topic: str) -> list[str]:
        """Return the sorted names of the publishers of a topic that were found in the graph.

        The list is empty unless messages of several publishers arrived. It may contain publishers without messages. The
        graph is read only when a message does not continue the numbers of a known publisher.
        """
        known = self._topics.get(topic)
        return sorted(set(known.known.values())) if known is not None and len(known.streams) > 1 else []

    def to_record(self) -> dict[str, str]:
        """Return the content of the metadata record `RECORD_NAME`: topic -> JSON list of its publishers' counts.

        An entry whose `first` is 0 does not belong to a single publisher: it counts messages without a number, or is
        the sum of the oldest publishers' counts.
        """
        return {name: json.dumps([attrs.asdict(s) for s in self._streams(name)]) for name in self._topics}

    def _take_unexpected(self, topic: str, known: _Topic, sequence: int) -> str:
        present = dict(self._publishers(topic)) if self._publishers is not None else {}
        new = [name for identifier, name in present.items() if identifier not in known.known]
        known.known |= present
        earlier = {stream.newest: place for place, stream in enumerate(known.streams) if stream.newest < sequence}
        if earlier and known.count >= max(len(known.known), 1):
            return known.take(earlier[max(earlier)], sequence)
        stream = PublisherStream(new[0] if len(new) == 1 else "", sequence, sequence)
        known.streams.append(stream)
        known.count += 1
        if len(known.streams) > MAX_STREAMS:
            gone, before = known.streams.pop(0), known.forgotten or PublisherStream("", 0, 0, 0)
            known.forgotten = PublisherStream("", 0, 0, before.received + gone.received, before.lost + gone.lost)
        return stream.publisher

    def _streams(self, name: str) -> list[PublisherStream]:
        known = self._topics[name]
        plain = [PublisherStream("", 0, 0, known.unnumbered)] if known.unnumbered else []
        return [*([known.forgotten] if known.forgotten else []), *known.streams, *plain]


def lost(streams: Mapping[str, Sequence[PublisherStream]]) -> dict[str, int]:
    """Return the number of lost messages by topic, from the counts of its publishers.

    Topics without losses are left out.
    """
    return {name: count for name, found in streams.items() if (count := sum(stream.lost for stream in found))}


def read_record(record: Mapping[str, str]) -> dict[str, list[PublisherStream]]:
    """Return the counts of the publishers of each topic from a metadata record that `Account.to_record` made.

    Raises:
        DamageError: the record is invalid.
    """
    try:
        return {name: [_stream(entry) for entry in json.loads(text)] for name, text in record.items()}
    except (ValueError, TypeError, RecursionError) as error:
        raise DamageError(
            f"the metadata record {RECORD_NAME!r}, the recorder's account of received and lost messages, is damaged or "
            f"of a later version of impact_rig: {error}; impact-rig recover writes a run without it"
        ) from error


def _stream(entry: dict[str, object]) -> PublisherStream:
    stream = PublisherStream(**entry)  # type: ignore[arg-type]  # checked below
    if not isinstance(stream.publisher, str) or any(
        type(number) is not int or number < 0 for number in (stream.first, stream.newest, stream.received, stream.lost)
    ):
        raise ValueError(
            f"{entry} does not count the messages of a publisher: publisher must be a text, and first, newest, "
            "received and lost must be integers >= 0"
        )
    return stream


@attrs.frozen
class Gap:
    """Gap between two successive recorded blocks of scans, or a stamp that goes back or is not that of a scan."""

    block: int  # number of the block after the gap, counted from 0
    expected_ns: int  # stamp that the block after the gap should have: that of the first missing scan
    stamp_ns: int  # stamp that the block has; for scans missing before a reset, the time of scan 0 after the reset
    missing_scans: int
    """Number of scans that are missing between the two blocks.

    It is negative if the stamps go back (a reset, a duplicate or out-of-order block). It is 0 if the second block
    follows the first, but its stamp is not exactly that of a scan.
    """


@attrs.frozen
class Contiguity:
    """Result of `check_contiguity`: numbers of blocks and scans, and the gaps between the blocks."""

    blocks: int
    scans: int
    gaps: tuple[Gap, ...]
    lost_blocks: int
    """Number of blocks that would fill the gaps, each as long as the block before its gap.

    The number of a gap is rounded up, that of a gap before a reset down.
    """
    lost_scans: int
    restarts: int  # number of times the stamps went back

    @property
    def whole(self) -> bool:
        """Return whether `check_contiguity` found no gap.

        A gap is a missing or duplicate scan, or a stamp that does not belong to a scan. Scans missing before the first
        block, or a few scans missing before a reset, are no gap.
        """
        return not self.gaps


def check_contiguity(
    blocks: Iterable[tuple[int, int]],
    rate_hz: float,
    start_ns: int | None = None,
    starts: Iterable[int] = (),
    resets: Iterable[int] = (),
) -> Contiguity:
    """Find the gaps between blocks of scans, by their stamps and lengths.

    Scans missing before the first block are no gap.

    Args:
        blocks: stamp [ns] and number of scans of each block, in the order to check.
        rate_hz: scans per second.
        start_ns: rig time of scan 0 [ns]. None means unknown: scans are then counted from the first block. A block
            whose stamp is not a whole number of scan periods later starts a new count, so a restarted rig causes one
            gap only. If the scan period is not a whole number of nanoseconds, a stamp may then differ by one
            nanosecond.
        starts: rig times of scan 0 of further rigs in the same recording [ns]. The time between the last block of one
            rig and the first block of the next rig is no gap.
        resets: rig times of scan 0 after each reset [ns]. A reset drops the scans that do not fill a block yet. So
            scans missing before a reset are a gap only if they are at least as many as in a block plus 10 ms, one tick
            of commands.
    """
    over, under = rate_hz.as_integer_ratio()
    period_exact = NS_PER_S * under % over == 0
    slack = 0 if start_ns is not None or period_exact else 1
    count = scans = lost_blocks = lost_scans = restarts = 0
    gaps: list[Gap] = []
    anchor_ns = start_ns
    index = before = 0  # index of the next scan, counted from the first block; number of scans in the previous block
    dropped = dict.fromkeys(starts, True) | dict.fromkeys(resets, False)
    begins, newest = deque(sorted(dropped)), 0
    for stamp, length in blocks:
        while begins and begins[0] <= stamp:
            if (begin := begins.popleft()) > newest and count:
                if not dropped[begin] and anchor_ns is not None:
                    expected = stamp_ns(index, rate_hz, anchor_ns)
                    missing = (begin - expected) * over // (under * NS_PER_S)
                    if missing >= before + first_scan_at(COMMAND_GRID_NS, rate_hz):
                        gaps.append(Gap(count, expected, begin, missing))
                        lost_scans += missing
                        lost_blocks += missing // max(before, 1)
                anchor_ns, index = begin, 0
        newest = stamp
        if anchor_ns is None:
            anchor_ns = stamp
        elif count == 0:
            index = scan_index(stamp, rate_hz, anchor_ns)
        expected = stamp_ns(index, rate_hz, anchor_ns)
        if abs(stamp - expected) > slack:
            found = scan_index(stamp, rate_hz, anchor_ns)
            missing = found - index
            gaps.append(Gap(count, expected, stamp, missing))
            if missing > 0:
                lost_scans += missing
                lost_blocks += -(-missing // max(before or length, 1))
            elif missing < 0:
                restarts += 1
            index = found
            if start_ns is None and abs(stamp - stamp_ns(found, rate_hz, anchor_ns)) > slack:
                anchor_ns, index = stamp, 0
        count, scans, index, before = count + 1, scans + length, index + length, length
    return Contiguity(count, scans, tuple(gaps), lost_blocks, lost_scans, restarts)


def has_times(table: Table) -> bool:
    """Return whether a table has a numeric column `time`, as every valid table of scans has."""
    return "time" in (table.rows.dtype.names or ()) and table.rows.dtype["time"].kind in "iuf"


def last_scan_ns(table: Table) -> int:
    """Return the stamp of the last scan of a block [ns].

    If the block has no rows or no valid `time`, the result is the stamp of the block.
    """
    if not len(table.rows) or not has_times(table):
        return table.stamp_ns
    last_s = float(table.rows["time"][-1])
    return table.stamp_ns + (round(last_s * NS_PER_S) if abs(last_s) < _LONGEST_BLOCK_S else 0)


def scan_rate_hz(table: Table) -> float | None:
    """Return the scan rate of a block [Hz], computed from its first and last `time`; None if it cannot be computed.

    A rate within a relative 1e-6 of a whole number is returned as that int. The result is None with fewer than two
    scans, without a column `time`, or if the last time is not after the first.
    """
    if not has_times(table) or len(table.rows) < 2:
        return None
    times = table.rows["time"].astype(np.float64)
    span = float(times[-1] - times[0])
    rate_hz = (len(times) - 1) / span if span > 0 else math.nan
    if not math.isfinite(rate_hz):
        return None
    whole = round(rate_hz)
    return whole if abs(rate_hz - whole) <= WHOLE * rate_hz else rate_hz
