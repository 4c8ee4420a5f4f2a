# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Everything the rig node publishes, and in which order."""

from __future__ import annotations

from typing import Any  # rclpy publishers

from rclpy.duration import Duration
from std_msgs.msg import String

from impact_rig import codec, topics
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.monitors import CLOCK, Monitors
from impact_rig.nodes.topics import MONITORS, TOPICS
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig, dump
from impact_rig.rig.description import robot_description

PUBLISHED = [topic for topic in TOPICS if topic.publisher == "rig"]
LEAST_DEPTH = 100
"""Blocks kept for a slow subscriber: twice what comes in a second, but at least this."""
DELIVERY = Duration(seconds=0.2)
"""Longest wait for the delivery of a change; only a subscriber that died without a word takes so long."""


class Publishers:
    """The rig's publishers.

    Args:
        node: owner.
        config: decides how deep the queues are, and whether `/clock` is published.
    """

    def __init__(self, node: ManagedNode[RigConfig], config: RigConfig) -> None:
        self._node = node
        per_second = config.daq.rate_hz // config.daq.block_scans
        depth = max(LEAST_DEPTH, 2 * per_second)  # for a slow subscriber, without holding seconds of large blocks
        bulky = (topics.SCAN, topics.TRUTH_SCAN)
        fitted = {instrument.name for instrument in config.instruments.fitted()}
        absent = [topic for name, topic in MONITORS.items() if name not in fitted]
        self._publishers = {
            t.name: node.publisher(t, depth if t in bulky else None)
            for t in PUBLISHED
            if t not in absent and (t is not topics.CLOCK or config.time.publishes_clock)
        }
        self._listened_to: set[str] = set()
        self._info = b""
        self._description = ""
        self._monitors: Monitors | None = None

    @property
    def scan(self) -> Any:
        """The publisher of daq/scan."""
        return self._publishers[topics.SCAN.name]

    def names(self) -> list[str]:
        """Return the topics that are published now, and that nobody else may publish."""
        return [name for name in self._publishers if name != topics.ROBOT_DESCRIPTION.name]

    def destroy(self) -> None:
        """Destroy the publishers."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)

    def look(self) -> None:
        """Look which topics anybody listens to, before some blocks are published."""
        self._listened_to = {name for name, publisher in self._publishers.items() if publisher.get_subscription_count()}

    def block(self, block: Block) -> None:
        """Publish a block: scans first, then what is true about them, then the monitors."""
        if not block.lost:
            self.scan.publish(codec.encode(block.scan))
        for topic, table in (
            (topics.IMPACTS_TRUTH, block.impacts),
            (topics.FAULTS, block.faults),
            (topics.TRUTH_SCAN, block.truth),
        ):
            if table is not None and (topic.qos.transient_local or self._heard(topic)):
                self._publishers[topic.name].publish(codec.encode(table))
        assert self._monitors is not None
        for topic, data in self._monitors.messages(block, self._heard):
            self._publishers[topic.name].publish(data)

    def _heard(self, topic: topics.Topic) -> bool:
        """Whether anybody listens: what nobody hears is not even made."""
        return topic.name in self._listened_to

    def stream(self, rig: Rig) -> None:
        """Publish which sample is wanted next, where the drive is a stream."""
        if rig.takes_samples:
            self._publishers[topics.STREAM.name].publish(codec.encode(rig.stream_state()))

    def clock(self, now_ns: int) -> None:
        """Publish rig time; a rig that does not has no publisher either, since a clock must have only one."""
        if topics.CLOCK.name not in self._publishers:
            self._publishers[topics.CLOCK.name] = self._node.publisher(topics.CLOCK)
        self._publishers[topics.CLOCK.name].publish(CLOCK.render(now_ns))

    def changes(self, rig: Rig) -> bool:
        """Publish the new rows of rig/journal and shaker/applied, causes before effects; return whether any came."""
        changed = False
        for topic, tables in ((topics.JOURNAL, rig.take_journal()), (topics.APPLIED, rig.take_applied())):
            for table in tables:
                self._publishers[topic.name].publish(codec.encode(table))
            if tables:
                self._settle(topic)
                changed = True
        return changed

    def configuration(self, rig: Rig) -> None:
        """Publish the configuration, and the calibration if it is another; take both for the monitors."""
        info = rig.info()
        noise = dict(zip(info.rows["name"].astype(str).tolist(), info.rows["noise"].tolist(), strict=True))
        self._monitors = Monitors(rig.config, noise, self._monitors)
        encoded = codec.encode(info)
        if encoded != self._info:
            self._info = encoded
            self._publishers[topics.INFO.name].publish(encoded)
            self._settle(topics.INFO)
        self.announce(rig.config)

    def announce(self, config: RigConfig) -> None:
        """Publish what a recorder opens its file by before there is a rig: the configuration, the rig as it looks."""
        self._publishers[topics.CONFIGURATION.name].publish(String(data=dump(config)))
        description = robot_description(config)
        if description != self._description:
            self._description = description
            self._publishers[topics.ROBOT_DESCRIPTION.name].publish(String(data=description))

    def settle_history(self) -> None:
        """Wait until subscribers that have just come have what was published before."""
        for topic in (topics.INFO, topics.APPLIED, topics.JOURNAL):
            self._publishers[topic.name].wait_for_all_acked(DELIVERY)

    def forget(self) -> None:
        """Publish the calibration again when next asked: a new rig begins."""
        self._info = b""

    def _settle(self, topic: topics.Topic) -> None:
        """Wait until every matched subscriber has what was published on a topic.

        Topics overtake each other. In realtime they do so by milliseconds, for which a measurement can wait; in the
        other modes that is many blocks, and results would depend on it.
        """
        if self._node.settings.time.mode != "realtime":
            self._publishers[topic.name].wait_for_all_acked(DELIVERY)
