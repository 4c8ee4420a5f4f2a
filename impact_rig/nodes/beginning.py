# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What keeps a rig from beginning: somebody else publishes its topics, or a peer it was told of is not there yet."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from rclpy.node import Node

from impact_rig import states
from impact_rig.nodes.diagnostics import State
from impact_rig.nodes.place import Place
from impact_rig.nodes.readers import Readers

LOOK_S = 0.5
"""Least time between two looks at the publishers of a rig's topics."""


class Rivals:
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


class Beginning:
    """Decides when scan 0 may be.

    A rig that finds others at its topics waits until they are gone: two rigs in one place would drive each other's
    shaker and fill one recording. Whoever is there already goes on.

    Args:
        node: the rig's.
        place: where it is to be.
        rivals: of its topics.
        readers: of its scans; None: nobody is waited for (other modes wait block by block).
        patience_s: how long readers are waited for.
    """

    def __init__(self, node: Node, place: Place, rivals: Rivals, readers: Readers | None, patience_s: float) -> None:
        self._place = place
        self._rivals = rivals
        self._readers = readers
        self._patience_s = patience_s
        if readers is not None and readers.missing():
            names = ", ".join(readers.missing())
            node.get_logger().info(f"scan 0 waits for {names}, at most {patience_s:g} s")

    def obstacle(self) -> State | None:
        """Return what it waits for; None: it may begin."""
        rivals = self._rivals.sentence()
        if rivals:
            return State(states.Rig.RIVAL, f"waiting to be alone: {rivals}")
        if not self._place.take():
            return State(states.Rig.RIVAL, "waiting to be alone: another rig of this machine is in this namespace")
        readers = self._readers
        if readers is None or readers.all_matched() or readers.overdue(self._patience_s):
            return None
        names = ", ".join(readers.missing())
        return State(states.Rig.NO_PEER, f"waiting for peer {names}, at most {self._patience_s:g} s")
