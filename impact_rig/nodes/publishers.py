# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Publishers of the rig node: blocks, changes, configuration, and standard messages for plotters.

`Session` decides when each of them is published.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping

import attrs
from rclpy.duration import Duration
from std_msgs.msg import String

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.instruments.fault import FaultPlan
from impact_rig.instruments.instrument import Instrument
from impact_rig.instruments.section import row_type_of
from impact_rig.nodes import messages
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.messages import MONITORS, TOPICS, Template, put
from impact_rig.rig import Block, Rig, journal
from impact_rig.rig.config import RigConfig, dump
from impact_rig.rig.description import JOINTS, joints, robot_description
from impact_rig.rig.monitors import AntiAlias
from impact_rig.rig.truth import monitor_step
from impact_rig.simtime import stamp_ns

PUBLISHED = [topic for topic in TOPICS if topic.publisher == "rig"]
KEPT_S, KEPT_BYTES = 25.0, 16_000_000
"""Limits [s, bytes] of the scans kept for a subscriber that does not answer; the one reached first applies.

A killed process can block messages to other subscribers until the middleware drops it, about 20 s later. Scans that are
kept until then still reach those subscribers.
"""
LEAST_S, LEAST_BLOCKS = 2.0, 100
"""Duration [s] and number of blocks of the scans that are kept at least, even beyond `KEPT_S` and `KEPT_BYTES`."""
GRAPH_POLL_S = 0.1
"""Minimum interval [s] between two checks for subscribers in real time.

A check takes a twentieth of the processor time of a block of scans.
"""
QUEUE = 256
"""Number of messages to one process that the middleware can certainly hold.

It is half of the queue of a shared-memory port of Fast DDS. Messages beyond the queue are dropped, and sent again
seconds later.
"""
DELIVERY = Duration(seconds=0.2)
"""Longest wait until all subscribers have received a change of the rig, before blocks that depend on it are published.

Only a subscriber that ended without notice takes this long.
"""

Reading = Callable[[int, float, int], bytes]  # renders an instrument's message from (stamp [ns], reading, status bits)


def noise_of(info: Table) -> dict[str, float]:
    """Return the rms noise of each channel, in its unit, from a `daq/info` table."""
    return dict(zip(info.rows["name"].astype(str).tolist(), info.rows["noise"].tolist(), strict=True))


class Monitors:
    """Renderer of the monitor topics: readings at a low rate and true joint states, computed from blocks of scans.

    Args:
        config: active configuration, for ranges and variances.
        noise: rms noise by channel, as returned by `noise_of`.
        before: the monitors of the previous configuration. If channels and rates are the same, their low-pass filter
            continues without a gap.
    """

    def __init__(self, config: RigConfig, noise: dict[str, float], before: Monitors | None = None) -> None:
        self._rate_hz = config.daq.rate_hz
        self._readings: dict[str, tuple[topics.Topic, Reading]] = {}
        for bit, instrument in enumerate(config.instruments.fitted()):
            if instrument.name in MONITORS:
                topic = MONITORS[instrument.name]
                self._readings[instrument.name] = topic, _reading(config, instrument, 1 << bit, noise[instrument.name])
        still = {"name": JOINTS, **{name: [0.0] * len(JOINTS) for name in ("position", "velocity", "effort")}}
        places = [f"{name}.{joint}" for name in list(still)[1:] for joint in range(len(JOINTS))]
        self._joint_states = _template(config, topics.JOINT_STATES, still, places)
        self._filter = AntiAlias(self._readings, monitor_step(config.daq.rate_hz, config.output.monitor_rate_hz))
        if before is not None:
            same = (before._filter.step, before._filter.channels) == (self._filter.step, self._filter.channels)
            self._filter = before._filter if same else self._filter

    def messages(self, block: Block, wanted: Callable[[topics.Topic], bool]) -> Iterator[tuple[topics.Topic, bytes]]:
        """Yield (topic, CDR bytes) of the monitor messages that are ready after this block, in order within each topic.

        Readings pass a low-pass filter, so they are ready four monitor periods after the time in their stamp. The true
        joint states are not filtered, and neither are readings at the full scan rate.

        Args:
            block: next block of the rig; pass every block in order, otherwise the low-pass filter starts again.
            wanted: returns whether a topic has subscribers; messages of other topics are not rendered.
        """
        start_ns = block.scan.stamp_ns - stamp_ns(block.first_scan, self._rate_hz)
        if wanted(topics.JOINT_STATES):
            for scan, truth in zip(block.monitor_scans.tolist(), block.monitor_states, strict=True):
                stamp = stamp_ns(block.first_scan + scan, self._rate_hz, start_ns)
                yield topics.JOINT_STATES, self._joint_states.render(stamp, *itertools.chain(*joints(truth)))
        readings = {name: reading for name, reading in self._readings.items() if wanted(reading[0])}
        for smoothed in self._filter.feed(block.first_scan, block.scan.rows):
            stamp = stamp_ns(smoothed.sample, self._rate_hz, start_ns)
            for name, (topic, render) in readings.items():
                yield topic, render(stamp, smoothed.values[name], smoothed.status)


def _reading(config: RigConfig, instrument: Instrument, bit: int, noise: float) -> Reading:
    """Return a fast function that renders the monitor messages of one instrument.

    The function replaces only the numbers in a prepared message.

    Args:
        config: configuration of the rig.
        instrument: the instrument.
        bit: mask of the instrument's bit in the status of a scan, which is set if the reading was at an end of the
            range.
        noise: rms noise of the channel, in its unit.
    """
    fields = instrument.message(0.0, False, noise)
    changing = [path for path, value in fields.items() if isinstance(value, float)]
    template = _template(config, MONITORS[instrument.name], fields, changing)

    def render(stamp: int, reading: float, status: int) -> bytes:
        values = instrument.message(reading, bool(status & bit), noise)
        return template.render(stamp, *(values[path] for path in changing))

    return render


def _template(config: RigConfig, topic: topics.Topic, fields: Mapping[str, object], changing: list[str]) -> Template:
    message = messages.class_of(topic)()
    message.header.frame_id = config.output.frame_prefix + topic.frame_id
    for path, value in fields.items():
        put(message, path, value)
    return Template(message, *changing)


class Publishers:
    """Publishers of the rig node, created with queues that suit the configuration.

    Args:
        node: node that owns the publishers.
        config: configuration; decides the length of the queues, and whether `/clock` is published.

    Attributes:
        kept_blocks: number of blocks of scans (messages on `daq/scan`) kept for a slow subscriber; a subscriber that
            is further behind loses scans.
    """

    def __init__(self, node: ManagedNode[RigConfig], config: RigConfig) -> None:
        self._node = node
        block_bytes = config.daq.block_scans * row_type_of(config.instruments).itemsize
        per_second = config.daq.rate_hz / config.daq.block_scans
        kept = min(math.ceil(KEPT_S * per_second), KEPT_BYTES // block_bytes)
        depth = max(kept, math.ceil(LEAST_S * per_second), LEAST_BLOCKS)
        self.kept_blocks = depth
        fitted = {instrument.name for instrument in config.instruments.fitted()}
        absent = [topic for name, topic in MONITORS.items() if name not in fitted]
        # enough for all blocks that may be published and not acknowledged, so that none is overwritten
        in_window = (config.time.ack_window + 1) * math.ceil(config.output.monitor_rate_hz / per_second + 1)
        often = [topics.JOINT_STATES, *MONITORS.values()]
        depths = dict.fromkeys(topics.BULKY, depth)
        depths |= dict.fromkeys(often, max(topics.DATA_DEPTH, in_window))
        node.outputs |= {
            t.name: node.publisher(t, depths.get(t))
            for t in PUBLISHED
            if t not in absent and (t is not topics.CLOCK or config.time.publishes_clock)
        }
        self._listened_to: set[str] = set()
        self._polled_at = -GRAPH_POLL_S
        self._info = b""
        self._description = ""
        self._monitors: Monitors | None = None
        self._decides_monitors: object = None

    def names(self) -> list[str]:
        """Return the names of the topics that this rig publishes now and that no other node may publish.

        Only `robot_description` and `/diagnostics` are left out. The names are relative to the rig's namespace, except
        `/clock`.
        """
        return [name for name in self._node.outputs if name != topics.ROBOT_DESCRIPTION.name]

    def poll(self, often: bool) -> None:
        """Check which topics have subscribers; call this before `block`.

        With `often`, every call checks, otherwise at most one call in 0.1 s (`GRAPH_POLL_S`).
        """
        now = time.monotonic()
        if now - self._polled_at < GRAPH_POLL_S and not often:
            return
        self._polled_at = now
        self._listened_to = {
            name for name, publisher in self._node.outputs.items() if publisher.get_subscription_count()
        }

    def block(self, block: Block) -> None:
        """Publish the messages of a block, its scans last: a subscriber that has the scans has the complete block.

        Topics without a subscriber at the last `poll` are left out, except the scans and latched topics. If an
        instrument fault withholds the scans of a block, only its other messages are published.
        """
        assert self._monitors is not None
        rendered = {
            topic: codec.encode(table, self._node.frame_prefix)
            for topic, table in block.tables()
            if topic is topics.SCAN or topic.qos.transient_local or self._heard(topic)
        }
        scans = rendered.pop(topics.SCAN, None)
        messages = (*rendered.items(), *self._monitors.messages(block, self._heard))
        may_overflow = _may_overflow(self._node.settings)
        for number, (topic, data) in enumerate(messages, 1):
            self._node.send(topic, data)
            if may_overflow and (number % QUEUE == 0 or number == len(messages)):
                for sent in {one: None for one, _ in messages[:number]}:
                    self._settle(sent)
        if scans is not None:
            self._node.send(topics.SCAN, scans)

    def _heard(self, topic: topics.Topic) -> bool:
        """Return whether a topic had subscribers at the last `poll`."""
        return topic.name in self._listened_to

    def stream(self, rig: Rig) -> None:
        """Publish the state of the drive's sample stream on `shaker/stream`; nothing if the drive is not a stream."""
        if rig.takes_samples:
            self._node.send_table(topics.STREAM, rig.stream_state())

    def clock(self, now_ns: int) -> None:
        """Publish the rig time `now_ns` [ns] on `/clock`.

        The publisher is created at the first call if it does not exist yet.
        """
        if topics.CLOCK.name not in self._node.outputs:
            self._node.offer(topics.CLOCK)
        self._node.send(topics.CLOCK, messages.CLOCK.render(now_ns))

    def changes(self, rig: Rig) -> bool:
        """Publish the new entries of `rig/journal`, and then the new rows of `shaker/applied` that they caused.

        Returns:
            Whether there was an entry or a row.
        """
        entries, applied = rig.take_journal(), rig.take_applied()
        for entry in entries:
            self._node.send(topics.JOURNAL, journal.encode(entry))
        if entries:
            self._settle(topics.JOURNAL)
        for table in applied:
            self._node.send_table(topics.APPLIED, table)
        if applied:
            self._settle(topics.APPLIED)
        return bool(entries or applied)

    def configuration(self, rig: Rig) -> None:
        """Publish the rig's calibration (`daq/info`) if it has changed, and its configuration as `announce` does.

        The method also adapts the monitors to the configuration.
        """
        info = rig.info()
        noise = noise_of(info)
        decides = rig.config.daq, rig.config.output, attrs.evolve(rig.config.instruments, faults=FaultPlan()), noise
        if decides != self._decides_monitors:
            self._decides_monitors = decides
            self._monitors = Monitors(rig.config, noise, self._monitors)
        encoded = codec.encode(info, self._node.frame_prefix)
        if encoded != self._info:
            self._info = encoded
            self._node.send(topics.INFO, encoded)
            self._settle(topics.INFO)
        self.announce(rig.config)

    def announce(self, config: RigConfig) -> None:
        """Publish the configuration of the rig, and its appearance (URDF) if that has changed.

        You can call this before the rig starts.
        """
        self._node.send(topics.CONFIGURATION, String(data=dump(config)))
        description = robot_description(config)
        if description != self._description:
            self._description = description
            self._node.send(topics.ROBOT_DESCRIPTION, String(data=description))

    def settle_history(self) -> None:
        """Wait until new subscribers have the latched calibration, drive and journal, at most 0.2 s per topic."""
        for topic in (topics.INFO, topics.APPLIED, topics.JOURNAL):
            self._node.outputs[topic.name].wait_for_all_acked(DELIVERY)

    def forget(self) -> None:
        """Prepare for the start of a new rig.

        The next `configuration` then publishes the calibration even if it is the same, and the next `poll` checks the
        subscribers at once.
        """
        self._info = b""
        self._polled_at = -GRAPH_POLL_S

    def _settle(self, topic: topics.Topic) -> None:
        """Wait until all subscribers have received the messages of a topic, at most 0.2 s; return at once in real time.

        Messages of different topics can overtake each other. Outside of real time, the difference can be many blocks of
        scans, and results would depend on it.
        """
        if self._node.settings.time.mode != "realtime":
            self._node.outputs[topic.name].wait_for_all_acked(DELIVERY)


def _may_overflow(config: RigConfig) -> bool:
    """Return whether the unacknowledged blocks can contain more messages than `QUEUE`.

    The middleware can certainly hold `QUEUE` messages to one process. If there can be more, `Publishers.block` waits
    for their delivery. The result is False in real time, where the rig does not wait for acknowledgements.
    """
    if config.time.mode == "realtime":
        return False
    blocks = config.time.ack_window
    if config.time.mode == "lockstep":  # at most one step is under way
        blocks = min(blocks, config.step.blocks)
    per_block = config.output.monitor_rate_hz * config.daq.block_scans / config.daq.rate_hz
    return blocks * (1.0 + (1 + len(MONITORS)) * per_block) > QUEUE
