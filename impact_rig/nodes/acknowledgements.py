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
"""Flow control for `daq/scan`: subscriber discovery, the window of unacknowledged blocks, and acknowledgements.

A block is one message on `daq/scan`, by default the scans of 10 ms. Peers are the nodes that the rig must wait for. A
rig that is not paced by the wall clock may be only a limited number of blocks (the window) ahead of its slowest peer.
An acknowledgement is a message on `daq/ack` that covers all blocks up to its stamp. `Session` decides what to do about
a peer that does not acknowledge.
"""

from __future__ import annotations

import bisect
import time
from collections.abc import Callable, Iterable
from typing import Any  # rclpy publishers, settings of any node

import attrs
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Header

from impact_rig import topics
from impact_rig.nodes.managed import ManagedNode, guarded
from impact_rig.nodes.messages import Template
from impact_rig.nodes.pacing import Clock
from impact_rig.simtime import NS_PER_S

KEPT = 4096  # minimum number of blocks whose stamps are remembered
POLL_S = 0.02  # minimum interval between two graph queries for the peers that a free-running rig waits for
GRAPH_POLL_S = 0.5  # minimum interval between two graph queries for all readers
REALTIME_S = 0.05
"""Interval [s] at which a reader acknowledges the blocks of a rig in real time.

Such a rig waits for no peer; it only uses acknowledgements to detect readers that are behind.
"""
PRESENT_NS = 86_400 * NS_PER_S
"""A block counts as one of a rig in real time if its stamp differs from the system time by less than this [ns]: a day.

In the other time modes, stamps begin at 0. The limit is wide because a rig that cannot keep real time stays behind the
system time.
"""
REPEATED_S = 3.25
"""Time [s] after a reader resumes within which Fast DDS delivers what it missed while suspended.

Fast DDS sends a heartbeat, which reveals missing messages, every 3 s.
"""
ALONE_S = 0.004  # a block that arrives this long after the last acknowledgement is acknowledged at once
MOST = 16  # maximum number of blocks per acknowledgement: the default window of a rig


@attrs.define
class _Reader:
    forgiven: int  # blocks up to this number need no acknowledgement
    heard_ns: int  # clock time of its last progress, or of the last time at which it had acknowledged every block
    acknowledged: int | None = None  # count of blocks since the start; None before its first acknowledgement
    waived: bool = False  # whether the rig continues without it until it acknowledges again


class AckWindow:
    """Record of the blocks that each reader has acknowledged, which limits how many blocks the rig may publish.

    A block is one message on `daq/scan`. An acknowledgement contains the stamp of a block, and covers this block and
    all earlier blocks. The rig may publish `room` more blocks. Readers that are no peers are only observed.

    Args:
        peers: node names of the peers, which they also use in their acknowledgements.
        window: maximum number of published blocks that the slowest peer has not acknowledged.
        timeout_ns: time [ns] after which a peer counts as silent, if it has blocks to acknowledge but acknowledges
            none.
        clock: monotonic clock [ns] for the timeout.
    """

    def __init__(self, peers: Iterable[str], window: int, timeout_ns: int, clock: Clock) -> None:
        self.window = window
        self.timeout_ns = timeout_ns
        self._clock = clock
        self._published = 0
        self._stamps: list[int] = []  # stamps of the newest blocks; the last one is number self._published
        self._readers: dict[str, _Reader] = {}
        self.peers: tuple[str, ...] = ()  # changed by `set_peers`
        self.set_peers(peers)

    @property
    def readers(self) -> tuple[str, ...]:
        """Names of all nodes whose acknowledgements are accepted: the peers and the observed readers."""
        return tuple(self._readers)

    @property
    def newest_ns(self) -> int | None:
        """Stamp [ns of rig time] of the newest published block of scans; None before the first."""
        return self._stamps[-1] if self._stamps else None

    def set_peers(self, peers: Iterable[str]) -> None:
        """Replace the peers that the rig waits for.

        A new peer need not acknowledge blocks that were published before. Any other reader, such as a former peer, is
        still observed if it has acknowledged a block. Otherwise it is dropped. If only waived peers remain (see
        `waive`), the rig waits for them again.
        """
        before, self.peers = self.peers, tuple(peers)
        for name in set(self.peers).difference(before):
            reader = self._readers.setdefault(name, _Reader(self._published, self._clock()))
            reader.forgiven, reader.heard_ns, reader.waived = self._published, self._clock(), False
        for name in set(self._readers).difference(self.peers):
            if self._readers[name].acknowledged is None:
                del self._readers[name]
        if self.waived() == self.peers:  # without a peer to wait for, the rig would run on without limit
            for name in self.peers:
                self._readers[name].waived = False
            self.forgive(self.peers)

    def watch(self, name: str) -> None:
        """Accept acknowledgements of one more reader, to observe how far it is behind; the rig does not wait for it.

        Until its first acknowledgement, it is behind by all blocks of this record. A known reader stays unchanged.
        """
        self._readers.setdefault(name, _Reader(0, self._clock()))

    def published(self, stamp_ns: int) -> None:
        """Count a block of scans with this stamp [ns of rig time] as published: the peers must now acknowledge it."""
        now = self._clock()
        for reader in self._readers.values():
            if self._owed(reader) == 0:
                reader.heard_ns = now  # it had acknowledged every block so far: its silence starts here
        self._published += 1
        self._stamps.append(stamp_ns)
        if len(self._stamps) >= 2 * KEPT:
            del self._stamps[:KEPT]

    def acknowledge(self, name: str, stamp_ns: int) -> bool:
        """Count all blocks up to this stamp [ns of rig time] as acknowledged by the reader `name`.

        If `waive` let the rig continue without this peer, the rig now waits for it again.

        Returns:
            Whether the acknowledgement is valid. An invalid one is ignored: the reader is unknown, the stamp is later
            than that of the newest published block, or no block was published yet.
        """
        reader = self._readers.get(name)
        if reader is None or self.newest_ns is None or stamp_ns > self.newest_ns:
            return False
        count = self._published - len(self._stamps) + bisect.bisect_right(self._stamps, stamp_ns)
        if reader.acknowledged is None or count > reader.acknowledged:
            reader.acknowledged = count
            reader.heard_ns = self._clock()
        reader.waived = False
        return True

    def room(self) -> int:
        """Return how many more blocks may be published before the slowest peer must acknowledge one.

        Without peers, the result is the whole window. It can be negative, for example after the window was reduced.
        """
        return self.window - self.outstanding()

    def outstanding(self) -> int:
        """Return how many published blocks the slowest peer has not acknowledged; 0 without peers to wait for."""
        return max((self._owed(self._readers[name]) for name in self.peers), default=0)

    def behind(self) -> dict[str, int]:
        """Return the number of published blocks that each reader, peer or not, has not acknowledged, by name.

        Blocks from which `forgive` or `set_peers` has exempted the reader do not count. A waived peer has 0 (see
        `waive`).
        """
        return {name: self._owed(reader) for name, reader in self._readers.items()}

    def heard(self) -> tuple[str, ...]:
        """Return the names of the readers that have acknowledged at least one block."""
        return tuple(name for name, reader in self._readers.items() if reader.acknowledged is not None)

    def silent(self) -> tuple[str, ...]:
        """Return the names of the peers that are silent.

        A silent peer has had blocks to acknowledge for longer than the timeout, but has acknowledged none. Waived peers
        are left out (see `waive`).
        """
        limit = self._clock() - self.timeout_ns
        owing = (name for name in self.peers if self._owed(self._readers[name]) > 0)
        return tuple(name for name in owing if self._readers[name].heard_ns < limit)

    def forgive(self, names: Iterable[str]) -> None:
        """Count all blocks published so far as acknowledged by these peers, and restart their timeout.

        The rig still waits for these peers to acknowledge later blocks, unless they are waived. Each name must be one
        of `readers`.
        """
        for name in names:
            self._readers[name].forgiven, self._readers[name].heard_ns = self._published, self._clock()

    def heard_ns(self, name: str) -> int:
        """Return the time from which the silence of a reader is measured [ns of the clock given to this window].

        This is usually the time at which the reader was added, or last acknowledged a further block. It is later if the
        reader had no block to acknowledge since, or if its timeout was restarted.
        """
        return self._readers[name].heard_ns

    def waive(self) -> None:
        """Let the rig continue without its silent peers until they acknowledge again.

        All blocks published so far count as acknowledged by all peers. If the rig has no other peer to wait for, it
        continues only for one more window of blocks.
        """
        silent = self.silent()
        for name in silent if set(silent) != set(self.peers) - set(self.waived()) else ():
            self._readers[name].waived = True
        self.forgive(self.peers)

    def waived(self) -> tuple[str, ...]:
        """Return the names of the peers that the rig does not wait for, because `waive` found them silent."""
        return tuple(name for name in self.peers if self._readers[name].waived)

    def excuse(self) -> None:
        """Restart the timeout of every peer; for use after this process was suspended and received no messages."""
        for name in self.peers:
            self._readers[name].heard_ns = self._clock()

    def forget(self, name: str) -> None:
        """Drop the acknowledgements of a reader that no longer subscribes.

        `name` must be one of `readers`. If the reader is a peer, its name remains a peer: the rig waits for a new node
        of this name to acknowledge the outstanding blocks, unless the peer was waived (see `waive`).
        """
        reader = self._readers.pop(name)
        if name in self.peers:
            self._readers[name] = _Reader(self._published - self._owed(reader), reader.heard_ns, waived=reader.waived)

    def _owed(self, reader: _Reader) -> int:
        return 0 if reader.waived else self._published - max(reader.acknowledged or 0, reader.forgiven)


class Readers:
    """Subscribers of one publisher's topic, to find out when all expected peers are connected.

    A message that is sent before a peer is connected is lost to that peer. Peers that the ROS graph lists count as
    connected once the publisher is matched with as many subscriptions as the graph lists. Nodes are distinguished by
    their names without namespace.
    """

    def __init__(self, node: Node, publisher: Any) -> None:
        self._node = node
        self._publisher = publisher
        self._missing: set[str] = set()
        self._expected_at = 0.0
        self._present: dict[str, set[bytes]] = {}  # subscriptions by node name
        self._came_ns: dict[str, int] = {}  # discovery of the newest of these [ns of the monotonic clock]
        self._polled_at = -GRAPH_POLL_S
        self._matched = 0

    @property
    def subscribers(self) -> int:
        """Number of subscriptions that the publisher is matched with, also of nodes that do not acknowledge."""
        return int(self._publisher.get_subscription_count())

    def expect(self, names: Iterable[str]) -> None:
        """Set the names of the peers that must be connected; each counts as missing until `all_matched` finds it."""
        self._missing = set(names)
        self._expected_at = time.monotonic()
        self._polled_at = -GRAPH_POLL_S

    def missing(self) -> tuple[str, ...]:
        """Return the names of the expected peers that `all_matched` has not found connected yet, sorted."""
        return tuple(sorted(self._missing))

    def overdue(self, patience_s: float) -> bool:
        """Return whether an expected peer is still missing more than `patience_s` seconds after `expect`."""
        return bool(self._missing) and time.monotonic() - self._expected_at > patience_s

    def all_matched(self) -> bool:
        """Return whether every expected peer has been found connected since `expect`, even if it is gone by now.

        While a peer is missing, a call queries the graph, at most every 20 ms.
        """
        if self._missing and self._due(POLL_S):
            # taken from the graph: the publisher's own profile has 0 where the graph has infinite
            offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(self._publisher.topic_name)]
            matching = [
                info
                for info in self._poll()
                if any(qos_check_compatible(one, info.qos_profile)[0] != QoSCompatibility.ERROR for one in offered)
            ]
            if self.subscribers >= len(matching):
                self._missing -= {info.node_name for info in matching}
        return not self._missing

    def knows(self, name: str) -> bool:
        """Return whether a node of this name (without namespace) subscribes to the publisher's topic.

        The result True may be outdated. The result False is at most 0.5 s old.
        """
        if name not in self._present and (self._due(GRAPH_POLL_S) or self.subscribers != self._matched):
            self._poll()
        return name in self._present

    def gone(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return those of the named nodes that do not subscribe to the topic; the information is at most 0.5 s old."""
        if self._due(GRAPH_POLL_S):
            self._poll()
        return tuple(name for name in names if name not in self._present)

    def came_ns(self, name: str) -> int:
        """Return when this node's newest subscription was discovered [ns of the monotonic clock], or 0 if never."""
        return self._came_ns.get(name, 0)

    def _due(self, period_s: float) -> bool:
        return time.monotonic() - self._polled_at >= period_s

    def _poll(self) -> list[TopicEndpointInfo]:
        found: list[TopicEndpointInfo] = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
        self._polled_at, self._matched = time.monotonic(), self.subscribers
        before, self._present = self._present, {}
        for info in found:
            self._present.setdefault(info.node_name, set()).add(bytes(info.endpoint_gid))
        now_ns = time.monotonic_ns()
        joined = (name for name, ids in self._present.items() if not ids <= before.get(name, set()))
        self._came_ns |= dict.fromkeys(joined, now_ns)
        return found


class Acknowledgements:
    """Sender of a reader's acknowledgements of `daq/scan`, as messages on `daq/ack`.

    A block (one message on `daq/scan`) that arrives alone is acknowledged at once. The blocks of a burst, at most 16,
    are acknowledged together. The blocks of a rig in real time are acknowledged by a timer, every 50 ms. A rig counts
    as one in real time if its stamps differ from the system time by less than a day.

    Args:
        node: node that reads the scans and has created the publisher of `daq/ack`; acknowledgements carry its name.
        may_send: called before each acknowledgement; returns whether the node has secured the acknowledged data. If it
            returns False, this acknowledgement is not sent, and the next one covers its blocks.
        catch_up: called by the timer before each acknowledgement, to process the blocks that the node has queued.
    """

    def __init__(
        self,
        node: ManagedNode[Any],
        may_send: Callable[[], bool] = lambda: True,
        catch_up: Callable[[], None] = lambda: None,
    ) -> None:
        self.is_timed = False
        """True if the newest processed block came from a rig in real time; a timer then sends the acknowledgements."""
        self._node = node
        self._may_send = may_send
        self._catch_up = catch_up
        self._later = guarded(self._send, node.report_failure)
        self._message = Template(Header(frame_id=node.get_name()))
        self._newest_ns = 0
        self._waiting = 0
        self._sent_at = 0.0
        self._has_timer = False

    def processed(self, stamp_ns: int) -> None:
        """Register that the node has processed the block of scans with this stamp [ns], and acknowledge the block.

        The acknowledgement may be sent later: together with those of other blocks or, in real time, by the timer.
        """
        self._newest_ns = stamp_ns
        self._waiting += 1
        self.is_timed = abs(time.time_ns() - stamp_ns) < PRESENT_NS
        if self.is_timed:
            if not self._has_timer:
                self._node.every(REALTIME_S, self._on_timer)
            self._has_timer = True
            return
        executor = self._node.executor
        if self._waiting >= MOST or executor is None:
            self._send()
        elif self._waiting == 1:
            if time.monotonic() - self._sent_at > ALONE_S:
                self._send()
            else:
                executor.create_task(self._later)

    def flush(self) -> None:
        """Acknowledge all processed blocks of `daq/scan` now, if `may_send` allows it.

        Call this when the node is deactivated, which also ends the timer of the acknowledgements in real time.
        """
        self.is_timed = self._has_timer = False
        if self._node.context.ok():
            self._send()

    def _on_timer(self) -> None:
        self._catch_up()
        self._send()

    def _send(self) -> None:
        waiting, self._waiting = self._waiting, 0  # an acknowledgement that is refused now is not retried
        if waiting and self._may_send():
            self._sent_at = time.monotonic()
            self._node.send(topics.ACK, self._message.render(self._newest_ns))
