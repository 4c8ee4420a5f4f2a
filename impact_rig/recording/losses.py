# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a recorder did not get: publication sequence numbers, counted per topic and publisher.

rclpy tells the sequence number of a message and not who sent it. So the numbers of a topic are sorted into streams, one
per publisher: a message continues the stream whose next number it has. Where it continues none, it begins the stream of
a publisher that has not been heard yet, if the graph has one; otherwise the numbers in between are lost.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence

import attrs

from impact_rig.recording.records import DamageError

RECORD_NAME = "impact_rig/losses"
"""Metadata record with what was received and lost, written when a file is finished."""
MAX_STREAMS = 64
"""Streams kept per topic: of publishers that come and go for days only the last ones can still speak."""

Publishers = Callable[[str], Mapping[str, str]]
"""Returns who publishes a topic now: an identifier that is never used twice -> a name for people."""


@attrs.define
class Stream:
    """The messages of one publisher on one topic.

    Attributes:
        publisher: its name where it is certain, else empty.
        first: sequence number of its first message; what was published before is no loss.
        newest: sequence number of its newest message.
        received: messages that arrived.
        lost: messages between `first` and `newest` that did not.
    """

    publisher: str
    first: int
    newest: int
    received: int = 1
    lost: int = 0

    def take(self, sequence: int) -> None:
        """Count a message, and those that should have come before it."""
        self.lost += sequence - self.newest - 1
        self.received += 1
        self.newest = sequence


@attrs.define
class _Topic:
    streams: list[Stream] = attrs.field(factory=list)
    known: dict[str, str] = attrs.field(factory=dict)  # publishers seen in the graph so far
    unnumbered: int = 0
    forgotten: Stream | None = None  # sum of the streams that were dropped


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
        known = self._topics.setdefault(topic, _Topic())
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
        known = self._topics.get(topic, _Topic())
        return sorted(set(known.known.values())) if len(known.streams) > 1 else []

    def to_record(self) -> dict[str, str]:
        """Return the content of the metadata record: by topic a JSON list of its streams."""
        return {name: json.dumps([attrs.asdict(s) for s in self._streams(name)]) for name in self._topics}

    def _take_unexpected(self, topic: str, known: _Topic, sequence: int) -> str:
        present = dict(self._publishers(topic)) if self._publishers is not None else {}
        new = [name for identifier, name in present.items() if identifier not in known.known]
        known.known |= present
        earlier = [stream for stream in known.streams if stream.newest < sequence]
        if earlier and len(known.streams) >= max(len(known.known), 1):
            stream = max(earlier, key=lambda one: one.newest)
            stream.take(sequence)
            return stream.publisher
        stream = Stream(new[0] if len(new) == 1 else "", sequence, sequence)
        known.streams.append(stream)
        if len(known.streams) > MAX_STREAMS:
            _forget_first(known)
        return stream.publisher

    def _streams(self, name: str) -> list[Stream]:
        known = self._topics[name]
        plain = [Stream("", 0, 0, known.unnumbered)] if known.unnumbered else []
        return [*([known.forgotten] if known.forgotten else []), *known.streams, *plain]


def lost(streams: Mapping[str, Sequence[Stream]]) -> dict[str, int]:
    """Return how many messages are missing in streams by topic; only topics that lack any."""
    return {name: count for name, found in streams.items() if (count := sum(stream.lost for stream in found))}


def read_record(record: Mapping[str, str]) -> dict[str, list[Stream]]:
    """Return what `Account.to_record` wrote.

    Raises:
        DamageError: the record holds something else.
    """
    try:
        return {name: [_stream(entry) for entry in json.loads(text)] for name, text in record.items()}
    except (ValueError, TypeError, RecursionError) as error:
        raise DamageError(f"the metadata record {RECORD_NAME!r} cannot be understood: {error}") from error


def _stream(entry: dict[str, object]) -> Stream:
    stream = Stream(**entry)  # type: ignore[arg-type]  # checked below
    if not isinstance(stream.publisher, str) or any(
        type(number) is not int or number < 0 for number in (stream.first, stream.newest, stream.received, stream.lost)
    ):
        raise ValueError(f"{entry} is no count of messages")
    return stream


def _forget_first(topic: _Topic) -> None:
    gone, topic.streams = topic.streams[0], topic.streams[1:]
    before = topic.forgotten or Stream("", 0, 0, 0)
    topic.forgotten = attrs.evolve(before, received=before.received + gone.received, lost=before.lost + gone.lost)
