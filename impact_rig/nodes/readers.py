# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Who reads `daq/scan`, as the graph tells it: are the peers connected, and is an acknowledgement a reader's."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any  # rclpy publishers

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo

POLL_S = 0.02
"""Least time between two looks for peers that freewheel waits for."""
LOOK_S = 0.5
"""Least time between two looks for everybody."""


class Readers:
    """Looks for the subscriptions of a publisher in the graph; a reader is known by its node name.

    A block sent before a peer is connected would be lost to it. The graph knows a subscription before the publisher is
    matched with it; the publisher counts its matches, so all that can match must have (one that asks for other
    qualities of service cannot).

    Args:
        node: whose view of the graph is taken.
        publisher: of the blocks.
    """

    def __init__(self, node: Node, publisher: Any) -> None:
        self._node = node
        self._publisher = publisher
        self._missing: set[str] = set()
        self._expected_at = 0.0
        self._present: set[str] = set()
        self._looked_at = -LOOK_S
        self._matched = 0

    @property
    def subscribers(self) -> int:
        """Matched subscriptions, whether they acknowledge or not."""
        return int(self._publisher.get_subscription_count())

    def expect(self, names: Iterable[str]) -> None:
        """Set the peers that must be connected; all are looked for again."""
        self._missing = set(names)
        self._expected_at = time.monotonic()
        self._looked_at = -LOOK_S

    def missing(self) -> tuple[str, ...]:
        """Return the peers not seen yet."""
        return tuple(sorted(self._missing))

    def overdue(self, patience_s: float) -> bool:
        """Whether a peer has not been there for so long."""
        return bool(self._missing) and time.monotonic() - self._expected_at > patience_s

    def all_matched(self) -> bool:
        """Look again, at most every 20 ms; true from when every peer was matched once."""
        if self._missing and self._due(POLL_S):
            # as the graph tells it: the publisher's own profile says 0 where the graph says infinite
            offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(self._publisher.topic_name)]
            matching = [
                info
                for info in self._look()
                if any(qos_check_compatible(one, info.qos_profile)[0] != QoSCompatibility.ERROR for one in offered)
            ]
            if self.subscribers >= len(matching):
                self._missing -= {info.node_name for info in matching}
        return not self._missing

    def knows(self, name: str) -> bool:
        """Whether a node of this name reads: nobody can fill memory with made-up names."""
        if name not in self._present and (self._due(LOOK_S) or self.subscribers != self._matched):
            self._look()
        return name in self._present

    def gone(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return which of these are no longer there."""
        if self._due(LOOK_S):
            self._look()
        return tuple(name for name in names if name not in self._present)

    def _due(self, period_s: float) -> bool:
        return time.monotonic() - self._looked_at >= period_s

    def _look(self) -> list[TopicEndpointInfo]:
        found: list[TopicEndpointInfo] = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
        self._looked_at, self._matched = time.monotonic(), self.subscribers
        self._present = {info.node_name for info in found}
        return found
