"""Whether the peers that freewheel waits for are connected: a block sent before that would be lost to them."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any  # rclpy publishers

from rclpy.node import Node

POLL_S = 0.02


class Peers:
    """Looks for the peers' subscriptions in the graph, and for their match at the publisher.

    A peer is found by its node name. The graph knows a subscription before the publisher is matched with it; the
    publisher counts its matches.

    Args:
        node: whose view of the graph is taken.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._missing: set[str] = set()
        self._looked_at = 0.0

    def expect(self, names: Iterable[str]) -> None:
        """Set who must be connected; all are looked for again."""
        self._missing = set(names)
        self._looked_at = 0.0

    def missing(self) -> tuple[str, ...]:
        """Return the peers not seen yet."""
        return tuple(sorted(self._missing))

    def all_matched(self, publisher: Any) -> bool:
        """Look again, at most every 20 ms; true from when every peer was matched once."""
        if not self._missing:
            return True
        now = time.monotonic()
        if now - self._looked_at < POLL_S:
            return False
        self._looked_at = now
        found = self._node.get_subscriptions_info_by_topic(publisher.topic_name)
        absent = self._missing - {info.node_name for info in found}
        if not absent and publisher.get_subscription_count() >= len(found):
            self._missing = set()
        return not self._missing
