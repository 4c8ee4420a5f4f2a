"""Whether the peers that freewheel waits for are connected: a block sent before that would be lost to them."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any  # rclpy publishers

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible

POLL_S = 0.02


class Peers:
    """Looks for the peers' subscriptions in the graph, and for their match at the publisher.

    A peer is found by its node name. The graph knows a subscription before the publisher is matched with it; the
    publisher counts its matches, so all that can match must have (one that asks for other qualities of service cannot).

    Args:
        node: whose view of the graph is taken.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._missing: set[str] = set()
        self._looked_at = self._expected_at = 0.0

    def expect(self, names: Iterable[str]) -> None:
        """Set who must be connected; all are looked for again."""
        self._missing = set(names)
        self._looked_at = 0.0
        self._expected_at = time.monotonic()

    def missing(self) -> tuple[str, ...]:
        """Return the peers not seen yet."""
        return tuple(sorted(self._missing))

    def overdue(self, patience_s: float) -> bool:
        """Whether a peer has not been there for so long."""
        return bool(self._missing) and time.monotonic() - self._expected_at > patience_s

    def all_matched(self, publisher: Any) -> bool:
        """Look again, at most every 20 ms; true from when every peer was matched once."""
        if not self._missing:
            return True
        now = time.monotonic()
        if now - self._looked_at < POLL_S:
            return False
        self._looked_at = now
        topic = publisher.topic_name
        # as the graph tells it: the publisher's own profile says 0 where the graph says infinite
        offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(topic)]
        found = [
            info
            for info in self._node.get_subscriptions_info_by_topic(topic)
            if any(qos_check_compatible(one, info.qos_profile)[0] != QoSCompatibility.ERROR for one in offered)
        ]
        absent = self._missing - {info.node_name for info in found}
        if not absent and publisher.get_subscription_count() >= len(found):
            self._missing = set()
        return not self._missing
