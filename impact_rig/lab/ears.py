# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a live page hears: a rig's topics, into rings and parts of the snapshot.

Blocks and joint states come by the hundred per second: nobody is woken for them. They are taken in their bytes, some
at a time, by whoever draws, and only while somebody looks. A queue that overflows meanwhile loses pictures only.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any  # rclpy handles; message classes have no common base

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.errors import CodecError
from impact_rig.lab.motion import Motion
from impact_rig.lab.parts import Curve, Ledger, start_ns
from impact_rig.lab.scope import Scope
from impact_rig.nodes import messages
from impact_rig.nodes.guard import guarded

MOST_PER_LOOK = 300
"""Messages taken of one topic at once: a picture must come out between."""
PICTURES = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=256, reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)  # fmt: skip


class Ears:
    """Subscribes to one rig.

    Args:
        node: spun by its owner; for what is rare and must not be lost.
        view: spun by nobody; for what is drawn.
        on_failure: called with place and words of what went wrong.
    """

    def __init__(self, node: Node, view: Node, on_failure: Callable[[str, str], None]) -> None:
        self.scope: Scope | None = None
        self.motion = Motion()
        self.ledger = Ledger()
        self.curve = Curve()
        self.epoch = 0
        self.start_ns = 0
        self.newest_ns = 0
        self.configured = 0
        """How often a configuration has come: the knobs are to be read again."""
        self.refused = 0
        """Messages that could not be understood."""
        self.applied: list[dict[str, float]] = []
        self.lock = threading.Lock()
        self._node, self._view = node, view
        self._of_instruments = (topics.SCAN, self._on_scan), (topics.IMPACTS, self._on_detected)
        self._of_truth = (topics.JOINT_STATES, self._on_joint_state), (topics.IMPACTS_TRUTH, self._on_impacts)
        self._looks: dict[str, tuple[Any, Callable[[bytes], None]]] = {}
        rare: list[tuple[topics.Topic, Callable[[Any], None]]] = [
            (topics.INFO, self._table(self._on_info)),
            (topics.APPLIED, self._table(self._on_applied)),
            (topics.JOURNAL, self._table(self.ledger.add)),
            (topics.FAULTS, self._table(self.ledger.fault)),
            (topics.TRANSMISSIBILITY_TABLE, self._table(self.curve.add)),
            (topics.CONFIGURATION, self._on_configuration),
            (topics.NOTES, lambda message: self.ledger.remark(message.data, self.newest_ns)),
        ]
        for topic, callback in rare:
            node.create_subscription(
                messages.class_of(topic), topic.name, _named(guarded(_one(callback), on_failure), topic.name),
                messages.profile(topic.qos), raw=topic.columns is not None,
            )  # fmt: skip

    # What is drawn

    def listen(self, scans: bool, motion: bool) -> None:
        """Begin or end to receive what is drawn; scans without the motion: what was known of that is forgotten."""
        wanted: dict[str, tuple[topics.Topic, Callable[[bytes], None]]] = {}
        if scans:
            wanted |= {one.name: (one, take) for one, take in self._of_instruments}
        if scans and motion:
            wanted |= {one.name: (one, take) for one, take in self._of_truth}
        for name in self._looks.keys() - wanted.keys():
            self._view.destroy_subscription(self._looks.pop(name)[0])
            if scans and name == topics.JOINT_STATES.name:
                with self.lock:
                    self.motion = Motion()
                    self.epoch += 1
        for name in wanted.keys() - self._looks.keys():
            topic, take = wanted[name]
            self._looks[name] = (
                self._view.create_subscription(messages.class_of(topic), name, _ignore, PICTURES, raw=True),
                take,
            )

    def look(self) -> None:
        """Take what has come since the last look."""
        for subscription, take in self._looks.values():
            with subscription.handle:
                found: list[bytes] = []
                while len(found) < MOST_PER_LOOK:
                    one = subscription.handle.take_message(subscription.msg_type, True)
                    if one is None:
                        break
                    found.append(one[0])
            with self.lock:
                for data in found:
                    try:
                        take(data)
                    except CodecError:
                        self.refused += 1

    def _on_scan(self, data: bytes) -> None:
        table = codec.decode(data)
        if not len(table.rows):
            return
        self.newest_ns = max(self.newest_ns, table.stamp_ns)
        if self.scope is not None:
            self.scope.add(table, self.start_ns)

    def _on_joint_state(self, data: bytes) -> None:
        self.motion.add_state(data, self.start_ns)

    def _on_impacts(self, data: bytes) -> None:
        table = codec.decode(data)
        self.motion.add_impacts(table.stamp_ns, table.rows, self.start_ns)

    def _on_detected(self, data: bytes) -> None:
        table = codec.decode(data)
        self.motion.add_detected(table.stamp_ns, table.rows, self.start_ns)

    # What is kept

    def _table(self, take: Callable[[Table], None]) -> Callable[[bytes], None]:
        def decode(data: bytes) -> None:
            try:
                take(codec.decode(data))
            except (CodecError, ValueError, KeyError):  # not the columns of ours
                self.refused += 1

        return decode

    def _on_info(self, table: Table) -> None:
        rate, begin = float(table.rows["rate"][0]), start_ns(table)
        if begin == self.start_ns and self.scope is not None and self.scope.rate_hz == rate:
            return
        with self.lock:
            self.start_ns = begin
            self.scope, self.motion = Scope(rate), Motion()
            self.epoch += 1

    def _on_applied(self, table: Table) -> None:
        self.ledger.changed_ns = max(self.ledger.changed_ns, table.stamp_ns)
        for row in table.rows:
            self.applied.append({"frequency": float(row["frequency"]), "current": float(row["current"])})
        del self.applied[:-100]

    def _on_configuration(self, _message: Any) -> None:
        self.configured += 1


def _ignore(_message: Any) -> None:
    """Nobody spins the node whose callback this is."""


def _one(callback: Callable[[Any], None]) -> Callable[[Any], None]:
    def take(message: Any) -> None:
        callback(message)

    return take


def _named(callback: Callable[..., Any], name: str) -> Callable[..., Any]:
    callback.__name__ = name
    return callback
