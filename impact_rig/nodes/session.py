# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A rig on the graph: the device itself, what it publishes, who follows it, and how far each of them is."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Sequence
from typing import Any  # values of parameters

from impact_rig import codec, topics
from impact_rig.errors import CodecError, CommandError
from impact_rig.instruments.scan import channels_of
from impact_rig.nodes.acknowledgements import AckWindow, Readers
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.pacing import Pacer
from impact_rig.nodes.publishers import Publishers
from impact_rig.nodes.start import DuplicatePublishers, NamespaceLock, StartGate
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import NS_PER_S

RATE_WINDOW_S = 2.0


class Counts:
    """What has gone out since the activation."""

    def __init__(self) -> None:
        self.blocks = 0
        self.lost_blocks = 0
        self.impacts = 0
        self.other_acks = 0
        self.over_range: Counter[str] = Counter()
        self.faults: dict[int, str] = {}
        """The instrument faults that act now."""
        self._rates: deque[tuple[float, int]] = deque([(time.monotonic(), 0)])

    def take(self, block: Block) -> None:
        """Count one published block."""
        self.blocks += 1
        self.lost_blocks += block.lost
        if block.impacts is not None:
            self.impacts += len(block.impacts.rows)
        status = block.scan.rows["status"]
        if status.any():
            for bit, name in enumerate(channels_of(block.scan.rows)):
                self.over_range[name] += int(((status >> bit) & 1).sum())
        if block.faults is not None:
            for row in block.faults.rows:
                number = int(row["id"])
                if row["active"]:
                    self.faults[number] = f"{row['kind'].decode()}/{row['channel'].decode()}".rstrip("/")
                else:
                    self.faults.pop(number, None)

    def block_rate_hz(self) -> float:
        """Return blocks per second of wall time over about the last two seconds."""
        now = time.monotonic()
        self._rates.append((now, self.blocks))
        while len(self._rates) > 2 and now - self._rates[1][0] > RATE_WINDOW_S:
            self._rates.popleft()
        then, before = self._rates[0]
        return (self.blocks - before) / (now - then) if now > then else 0.0


class Session:
    """Everything of a rig node that begins and ends with its activations.

    Args:
        node: the rig's.
    """

    def __init__(self, node: ManagedNode[RigConfig]) -> None:
        self.node = node
        self.lock = NamespaceLock(node)
        self.rig: Rig | None = None
        """The device; None before it has begun."""
        self.readers: Readers | None = None
        self.duplicates: DuplicatePublishers | None = None
        self.gate: StartGate | None = None
        """Whether it may begin; None once it has."""
        self.pacer = Pacer(time.monotonic_ns)
        self.window = AckWindow((), 1, NS_PER_S, time.monotonic_ns)
        self.counts = Counts()
        self.realised_restitution = math.nan
        """What the contact law really returns: with the paper's law 0.309 for 0.35."""
        self.paused = False
        """Whether rig time stands still, but for steps that are asked for meanwhile."""
        self.starved_at: float | None = None
        """Since when (monotonic) a rig ahead of time waits for samples of a stream."""
        self.base_ns = self.clock_offset_ns = 0
        self.history_settled = False
        self._publishers: Publishers | None = None

    @property
    def publishers(self) -> Publishers:
        """What it publishes; only while the node is configured."""
        assert self._publishers is not None
        return self._publishers

    @property
    def is_realtime(self) -> bool:
        """Whether blocks are due by the clock."""
        return self.node.settings.time.mode == "realtime"

    # Begin and end

    def configure(self) -> None:
        """Create the publishers."""
        self._publishers = Publishers(self.node, self.node.settings)

    def activate(self) -> None:
        """Look who else is there, and let the gate decide when scan 0 may be."""
        config, publishers = self.node.settings, self.publishers
        self.readers = Readers(self.node, publishers.scan)
        self.readers.expect(config.time.peers)
        self.duplicates = DuplicatePublishers(self.node, publishers.names)
        awaited = self.readers if self.is_realtime else None
        self.gate = StartGate(self.node, self.lock, self.duplicates, awaited, config.time.start_wait_s)
        publishers.forget()
        self.history_settled = False
        self.starved_at = None
        self.counts = Counts()

    def begin(self) -> Rig:
        """Start a new rig: scan 0 is now in realtime, at 0 otherwise."""
        config = self.node.settings
        timing = config.time
        self.clock_offset_ns = time.time_ns() - time.monotonic_ns()
        self.base_ns = time.time_ns() if self.is_realtime else 0
        self.pacer = Pacer(time.monotonic_ns, timing.factor)  # beside the stamp: both mean the same instant
        self.rig = rig = Rig(config, self.base_ns)
        self.gate = None
        timeout_ns = round(timing.peer_timeout_s * NS_PER_S)
        self.window = AckWindow(timing.peers, timing.ack_window, timeout_ns, time.monotonic_ns)
        self.flush()
        self.publish_configuration()
        if timing.peers and self.is_realtime:
            self.publishers.settle_history()
        return rig

    def deactivate(self) -> None:
        """End the rig; what was not published is dropped."""
        self.rig = self.readers = self.duplicates = self.gate = None
        self.lock.leave()

    def cleanup(self) -> None:
        """Destroy the publishers."""
        if self._publishers is not None:
            self._publishers.destroy()
            self._publishers = None

    def running(self) -> Rig:
        """Return the rig.

        Raises:
            CommandError: there is none, and why.
        """
        if self.rig is None:
            raise CommandError(self.why_not())
        return self.rig

    def why_not(self) -> str:
        """Return why there is no rig to talk to."""
        obstacle = self.gate.obstacle() if self.gate is not None else None
        if obstacle is not None:
            return f"the rig has not begun, {obstacle.reason}"
        return f"the rig is {self.node.state}, activate it first"

    def starving(self) -> bool:
        """Whether the rig has been waiting for samples of a stream for as long as it waits for a peer."""
        patience_s = self.node.settings.time.peer_timeout_s
        return self.starved_at is not None and time.monotonic() - self.starved_at > patience_s

    def controllers(self) -> str:
        """Return who could send samples of a stream, in words."""
        found = self.node.get_publishers_info_by_topic(self.node.resolve_topic_name(topics.WAVEFORM.name))
        return " and ".join(sorted({info.node_name for info in found})) or "nobody"

    # Publishing

    def publish(self, blocks: Sequence[Block]) -> None:
        """Publish blocks, after the changes that act on them."""
        assert self.rig is not None
        if self.publishers.changes(self.rig):
            self.node.report_change()  # a trip, for one
        if blocks:
            self.publishers.look()
        for block in blocks:
            self.publishers.block(block)
            if not block.lost:
                self.window.published(block.scan.stamp_ns)
            if not self.paused:
                self.pacer.published(block.end_ns - self.base_ns)
            self.counts.take(block)
        if blocks:
            self.starved_at = None
            self.publishers.stream(self.rig)
        if blocks and self.node.settings.time.publishes_clock:
            self.publishers.clock(blocks[-1].end_ns)

    def flush(self) -> None:
        """Publish what an input has changed."""
        assert self.rig is not None
        self.publishers.changes(self.rig)

    def publish_configuration(self) -> None:
        """Publish the configuration in force, and the calibration if it is another."""
        assert self.rig is not None
        self.publishers.configuration(self.rig)
        self.publishers.stream(self.rig)
        self.realised_restitution = self.rig.simulation.realised_restitution

    # What comes from outside

    def change(self, settings: RigConfig, changes: dict[str, Any]) -> None:
        """Give the rig there is new settings, which the validator has accepted.

        Raises:
            ImpactRigError: it refuses them; nothing is changed.
        """
        if self.readers is None:
            return
        if "time.peers" in changes:
            self.readers.expect(settings.time.peers)
            self.history_settled = False
        if self.rig is None:
            return
        self.rig.adopt(settings, changes)
        self.flush()
        if any(name.startswith(("time.peers", "time.ack_window", "time.peer_timeout")) for name in changes):
            self.window.set_peers(settings.time.peers)
            self.window.window = settings.time.ack_window
            self.window.timeout_ns = round(settings.time.peer_timeout_s * NS_PER_S)
        if "time.factor" in changes:
            self.pacer.rebase(self.rig.next_block_ns - self.base_ns, settings.time.factor)
        self.publish_configuration()

    def acknowledged(self, data: bytes) -> bool:
        """Take an acknowledgement, which every reader may send in every mode; return whether it is a peer's."""
        if self.readers is None:
            return False
        try:
            stamp, name = codec.header(data)
        except CodecError as error:
            self.node.refuse(topics.ACK.name, str(error))
            return False
        window = self.window
        if window.newest_ns is None or stamp > window.newest_ns:
            self.node.refuse(topics.ACK.name, f"{name!r} acknowledged {stamp} ns, which was never published")
            return False
        if name not in window.readers:
            if not self.readers.knows(name):
                self.counts.other_acks += 1
                return False
            window.watch(name)
        window.acknowledge(name, stamp)
        return name in window.peers
