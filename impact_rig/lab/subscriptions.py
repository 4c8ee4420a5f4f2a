# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a live page hears: a rig's topics, into rings and parts of the snapshot.

Blocks and joint states come by the hundred per second: nobody is woken for them. They are taken in their bytes, some
at a time, by whoever draws, and only while somebody looks. A queue that overflows meanwhile loses pictures only.
A message that makes no sense costs that message: it is counted under its topic, and the page says so.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any  # rclpy handles; message classes have no common base

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.errors import ImpactRigError
from impact_rig.lab.motion import Motion
from impact_rig.lab.scope import Scope
from impact_rig.lab.state import Curve, Faults, JournalView, scan_rate, start_ns
from impact_rig.nodes import messages
from impact_rig.nodes.guard import describe
from impact_rig.rig.config import parameters_in

MOST_PER_LOOK = 300
"""Messages taken of one topic at once: a picture must come out between."""
MOST_APPLIED = 100
PICTURES = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=256, reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)  # fmt: skip
Take = Callable[[Table], None]


class Subscriptions:
    """Subscribes to one rig.

    Args:
        node: spun by its owner; for what is rare and must not be lost.
        view: spun by nobody; for what is drawn.
        refused: messages that made no sense, by topic: how many, and the last reason.
    """

    def __init__(self, node: Node, view: Node, refused: dict[str, list[Any]]) -> None:
        self.scope: Scope | None = None
        self.motion = Motion()
        self.journal = JournalView()
        self.faults = Faults()
        self.curve = Curve()
        self.epoch = 0
        self.start_ns = 0
        self.newest_ns = 0
        self.configuration = ""
        """What is in force, as a ROS 2 parameter file."""
        self.knobs: dict[str, Any] = {}
        """The same by name."""
        self.applied: list[dict[str, float]] = []
        """The newest changes of the drive."""
        self.changes = 0
        """How many there were."""
        self.lock = threading.Lock()
        self._refused = refused
        self._node, self._view = node, view
        self._of_instruments = (topics.SCAN, self._on_scan), (topics.IMPACTS, self._on_detected)
        self._of_truth = (topics.JOINT_STATES, self._on_joint_state), (topics.IMPACTS_TRUTH, self._on_impacts)
        self._looks: dict[str, tuple[Any, Callable[[bytes], None]]] = {}
        tables: list[tuple[topics.Topic, Take]] = [
            (topics.INFO, self._on_info),
            (topics.APPLIED, self._on_applied),
            (topics.JOURNAL, self.journal.add),
            (topics.FAULTS, self._on_faults),
            (topics.TRANSMISSIBILITY_TABLE, self.curve.add),
        ]
        for topic, take in tables:
            self._subscribe(topic, functools.partial(_decoded, topic, take))
        self._subscribe(topics.CONFIGURATION, self._on_configuration)
        self._subscribe(topics.NOTES, lambda message: self.journal.remark(message.data, self.newest_ns))

    def _subscribe(self, topic: topics.Topic, take: Callable[[Any], None]) -> None:
        def guarded(*message: Any) -> None:
            self.guard(topic.name, take, message[0][0] if isinstance(message[0], tuple) else message[0])

        kind, profile = messages.class_of(topic), messages.profile(topic.qos)
        self._node.create_subscription(kind, topic.name, guarded, profile, raw=topic.columns is not None)

    def guard(self, what: str, take: Callable[[Any], None], message: Any) -> None:
        """Do something with a message; where that fails, count it."""
        try:
            take(message)
        except Exception as error:  # whatever others publish, the rig must stay in hand: STOP comes from here
            count = self._refused.setdefault(what, [0, ""])
            count[0] += 1
            count[1] = str(error) if isinstance(error, ImpactRigError) else describe(error)

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
        for name, (subscription, take) in self._looks.items():
            with subscription.handle:
                found: list[bytes] = []
                while len(found) < MOST_PER_LOOK:
                    one = subscription.handle.take_message(subscription.msg_type, True)
                    if one is None:
                        break
                    found.append(one[0])
            with self.lock:
                for data in found:
                    self.guard(name, take, data)

    def _on_scan(self, data: bytes) -> None:
        table = codec.decode(data, topics.SCAN)
        if not len(table.rows):
            return
        if self.scope is not None:
            self.scope.add(table, self.start_ns)
        self.newest_ns = max(self.newest_ns, table.stamp_ns)

    def _on_joint_state(self, data: bytes) -> None:
        self.motion.add_state(data, self.start_ns)

    def _on_impacts(self, data: bytes) -> None:
        table = codec.decode(data, topics.IMPACTS_TRUTH)
        self.motion.add_impacts(table.stamp_ns, table.rows, self.start_ns)

    def _on_detected(self, data: bytes) -> None:
        table = codec.decode(data, topics.IMPACTS)
        self.motion.add_detected(table.stamp_ns, table.rows, self.start_ns)

    # What is kept

    def _on_info(self, table: Table) -> None:
        rate, begin = scan_rate(table), start_ns(table)
        if begin == self.start_ns and self.scope is not None and self.scope.rate_hz == rate:
            return
        with self.lock:
            self.start_ns = begin
            self.scope, self.motion = Scope(rate), Motion()
            self.epoch += 1

    def _on_applied(self, table: Table) -> None:
        rows = [{"frequency": float(row["frequency"]), "current": float(row["current"])} for row in table.rows]
        self.applied = (self.applied + rows)[-MOST_APPLIED:]
        self.changes += len(rows)

    def _on_faults(self, table: Table) -> None:
        self.faults.add(table)
        self.journal.fault(table)

    def _on_configuration(self, message: Any) -> None:
        self.knobs = parameters_in(message.data)
        self.configuration = message.data


def _decoded(topic: topics.Topic, take: Take, data: bytes) -> None:
    take(codec.decode(data, topic))


def _ignore(_message: Any) -> None:
    """Nobody spins the node whose callback this is."""
