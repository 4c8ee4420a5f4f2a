# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Who else is in a rig's place.

A rig's domain and namespace belong to one rig of a machine at a time. The graph knows of another rig only after seconds
where an announcement was missed; a lock tells at once, but only on this machine. Where discovery ends at this machine,
nobody has to wait for the graph.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Mapping

from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier

from impact_rig.system import files

OBEDIENT = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp")
"""Middleware that keeps to `ROS_AUTOMATIC_DISCOVERY_RANGE`."""
LOOK_S = 0.5
"""Least time between two looks at the publishers of a rig's topics."""


def ends_here(environment: Mapping[str, str], middleware: str) -> bool:
    """Return whether discovery surely ends at this machine."""
    near = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() in ("LOCALHOST", "OFF")
    far = environment.get("ROS_STATIC_PEERS") or environment.get("ROS_DISCOVERY_SERVER")
    return near and not far and middleware in OBEDIENT


class NamespaceLock:
    """Takes a rig's domain and namespace, and leaves them."""

    def __init__(self, node: Node) -> None:
        self._name = files.place(node.context.get_domain_id(), node.get_namespace())
        self._held: int | None = None
        here = ends_here(os.environ, get_rmw_implementation_identifier())
        self.decides = here and files.can_hold(files.PLACES, self._name)
        """Whether no rig can be in this namespace unseen; False: only the graph tells."""

    def take(self) -> bool:
        """Return whether the namespace is ours now; true as well where only the graph tells."""
        if self._held is None and self.decides:
            self._held = files.hold(files.PLACES, self._name)
        return self._held is not None or not self.decides

    def leave(self) -> None:
        """Leave the namespace to others."""
        if self._held is not None:
            os.close(self._held)
            self._held = None


class DuplicatePublishers:
    """Other publishers of topics that one node alone may publish, as the graph tells it.

    Args:
        node: whose topics they are.
        names: returns the topics it publishes now, each from one publisher.
    """

    def __init__(self, node: Node, names: Callable[[], Iterable[str]]) -> None:
        self._node = node
        self._names = names
        self._looked_at = -LOOK_S
        self._sentence = ""

    def sentence(self) -> str:
        """Return who publishes what as well, or nothing; looks at most twice a second, and logs changes."""
        now = time.monotonic()
        if now - self._looked_at >= LOOK_S:
            self._looked_at = now
            before, self._sentence = self._sentence, self._look()
            if self._sentence != before:
                logger = self._node.get_logger()
                logger.error(self._sentence) if self._sentence else logger.info("nobody else publishes here any more")
        return self._sentence

    def _look(self) -> str:
        found: dict[str, list[str]] = {}
        for name in self._names():
            if self._node.count_publishers(name) > 1:
                for other in self._others(name):
                    found.setdefault(other, []).append(name)
        return "; ".join(f"{other} publishes {', '.join(names)} as well" for other, names in found.items())

    def _others(self, name: str) -> set[str]:
        own = self._node.get_fully_qualified_name()
        publishers = [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(name))
        ]
        others = {publisher for publisher in publishers if publisher != own}
        return others | {f"another {own}"} if publishers.count(own) > 1 else others
