"""Who reads `daq/scan`, how far each reader is and what it missed, in every mode: told by the acknowledgements.

The rig waits for `time.peers` only (`AckWindow`); this looks after everybody who acknowledges. A name counts when a
node of that name subscribes to daq/scan, so nobody can fill memory with made-up names.
"""

from __future__ import annotations

import bisect
import time
from collections.abc import Iterable
from typing import Any  # rclpy publishers

import attrs
from rclpy.node import Node

LOOK_S = 0.5
"""Least time between two looks at the graph."""
KEPT = 4096
"""Blocks whose stamps are remembered, at least: a reader further behind counts as this far behind."""


@attrs.define
class _Reader:
    acknowledged: int  # blocks, counted from the start
    lost: int = 0


class Audience:
    """Counts blocks out and blocks acknowledged, by reader.

    Args:
        node: whose view of the graph is taken.
        publisher: that of daq/scan.
    """

    def __init__(self, node: Node, publisher: Any) -> None:
        self._node = node
        self._publisher = publisher
        self._published = 0
        self._stamps: list[int] = []  # of the newest blocks; the last one is number self._published
        self._readers: dict[str, _Reader] = {}
        self._subscribed: set[str] = set()
        self._looked_at = -LOOK_S
        self.others = 0
        """Acknowledgements in the name of nobody who subscribes."""

    @property
    def subscribers(self) -> int:
        """Matched subscriptions, whether they acknowledge or not."""
        return int(self._publisher.get_subscription_count())

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest block that is out."""
        return self._stamps[-1] if self._stamps else None

    def published(self, stamp_ns: int) -> None:
        """Note that the block with this stamp is out."""
        self._published += 1
        self._stamps.append(stamp_ns)
        if len(self._stamps) >= 2 * KEPT:
            del self._stamps[:KEPT]

    def acknowledge(self, name: str, stamp_ns: int) -> None:
        """Take an acknowledgement of a block that is out."""
        if not self._knows(name):
            self.others += 1
            return
        index = bisect.bisect_right(self._stamps, stamp_ns)
        count = self._published - len(self._stamps) + index
        reader = self._readers.get(name)
        if reader is None:
            self._readers[name] = _Reader(count)
        elif count > reader.acknowledged:
            reader.lost += count - reader.acknowledged - 1
            reader.acknowledged = count

    def behind(self) -> dict[str, int]:
        """Return the blocks each reader has not acknowledged."""
        return {name: self._published - reader.acknowledged for name, reader in self._readers.items()}

    def lost(self) -> dict[str, int]:
        """Return the blocks each reader has passed over."""
        return {name: reader.lost for name, reader in self._readers.items()}

    def forget_the_gone(self) -> Iterable[str]:
        """Forget readers that have left the graph, and return their names."""
        self._look()
        gone = [name for name in self._readers if name not in self._subscribed]
        for name in gone:
            del self._readers[name]
        return gone

    def _knows(self, name: str) -> bool:
        if name not in self._subscribed:
            self._look()
        return name in self._subscribed

    def _look(self) -> None:
        now = time.monotonic()
        if now - self._looked_at >= LOOK_S:
            self._looked_at = now
            found = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
            self._subscribed = {info.node_name for info in found}
