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
"""Who follows `daq/scan`, and how far: readers in the graph, the window of what they acknowledge, acknowledging.

A rig that runs ahead of time goes as far as its peers have acknowledged, whom it knows from the graph. A peer says up
to which block it is: of a rig that waits a single one at once, those of a burst together; in real time now and then.
What is done about a peer that is silent: `Session`.
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

KEPT = 4096  # blocks whose stamps are remembered, at least
POLL_S = 0.02  # least time between two looks for peers that a free-running rig waits for
LOOK_S = 0.5  # least time between two looks for everybody
REALTIME_S = 0.05
"""Time between acknowledgements of a rig in real time, which waits for nobody and only wants to know who is late."""
PRESENT_NS = NS_PER_S
"""Stamps this near to the system's time are those of a rig in real time; in the other modes they begin at 0."""
REPEATED_S = 3.25
"""Time within which Fast DDS repeats what a suspended reader has missed: with heartbeats, which are 3 s apart."""
ALONE_S = 0.004  # a block that comes this long after the last acknowledgement is acknowledged at once
MOST = 16  # blocks acknowledged together, at most: as many as a rig runs ahead by default


@attrs.define
class _Reader:
    forgiven: int  # blocks up to here are owed no more
    heard_ns: int  # clock when it last said something new, or when it had nothing to say
    acknowledged: int | None = None  # blocks, counted from the start; None before it has acknowledged any
    waived: bool = False  # it is not waited for until it acknowledges again


class AckWindow:
    """How far every reader of the blocks is, and how far ahead of its slowest peer the rig may run.

    A reader acknowledges by the stamp of the last block it processed, one or several at a time. Blocks are counted, so
    that "ahead" has one meaning for all. Peers are the readers that are waited for; others are only watched.

    Args:
        peers: names the acknowledgements carry.
        window: blocks that may be out and not acknowledged.
        timeout_ns: clock time after which a peer that owes an acknowledgement counts as silent.
    """

    def __init__(self, peers: Iterable[str], window: int, timeout_ns: int, clock: Clock) -> None:
        self.window = window
        self.timeout_ns = timeout_ns
        self._clock = clock
        self._published = 0
        self._stamps: list[int] = []  # of the newest blocks; the last one is number self._published
        self._readers: dict[str, _Reader] = {}
        self.peers: tuple[str, ...] = ()  # changed by `set_peers`
        self.set_peers(peers)

    @property
    def readers(self) -> tuple[str, ...]:
        """Names of the peers, and of everybody else who acknowledges."""
        return tuple(self._readers)

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest block that is out."""
        return self._stamps[-1] if self._stamps else None

    def set_peers(self, peers: Iterable[str]) -> None:
        """Change the peers; new ones owe nothing of what is already out."""
        before, self.peers = self.peers, tuple(peers)
        for name in set(self.peers).difference(before):
            reader = self._readers.setdefault(name, _Reader(self._published, self._clock()))
            reader.forgiven, reader.heard_ns, reader.waived = self._published, self._clock(), False
        for name in set(self._readers).difference(self.peers):
            if self._readers[name].acknowledged is None:
                del self._readers[name]

    def watch(self, name: str) -> None:
        """Take acknowledgements in this name, too, without waiting for any."""
        self._readers.setdefault(name, _Reader(0, self._clock()))

    def published(self, stamp_ns: int) -> None:
        """Note that the block with this stamp is out."""
        now = self._clock()
        for reader in self._readers.values():
            if self._owed(reader) == 0:
                reader.heard_ns = now  # owed nothing until now: its silence starts here
        self._published += 1
        self._stamps.append(stamp_ns)
        if len(self._stamps) >= 2 * KEPT:
            del self._stamps[:KEPT]

    def acknowledge(self, name: str, stamp_ns: int) -> bool:
        """Take an acknowledgement; False if it makes no sense (nobody we watch, later than any block)."""
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
        """Return how many blocks may be published now."""
        return self.window - self.outstanding()

    def outstanding(self) -> int:
        """Return how many blocks the slowest peer has not acknowledged."""
        return max((self._owed(self._readers[name]) for name in self.peers), default=0)

    def behind(self) -> dict[str, int]:
        """Return the blocks each reader has not acknowledged."""
        return {name: self._owed(reader) for name, reader in self._readers.items()}

    def heard(self) -> tuple[str, ...]:
        """Return the readers that have acknowledged."""
        return tuple(name for name, reader in self._readers.items() if reader.acknowledged is not None)

    def silent(self) -> tuple[str, ...]:
        """Return the peers that owe an acknowledgement and said nothing for the timeout."""
        limit = self._clock() - self.timeout_ns
        owing = (name for name in self.peers if self._owed(self._readers[name]) > 0)
        return tuple(name for name in owing if self._readers[name].heard_ns < limit)

    def forgive(self, names: Iterable[str]) -> None:
        """Count everything as acknowledged by some peers; they are waited for as before."""
        for name in names:
            self._readers[name].forgiven, self._readers[name].heard_ns = self._published, self._clock()

    def heard_ns(self, name: str) -> int:
        """Return when a reader said something new last, or had nothing to say [ns of the clock]."""
        return self._readers[name].heard_ns

    def waive(self) -> None:
        """Go on without the peers that are silent, until each of them acknowledges again.

        Where nobody else is followed, they are waited for after the next window: no rig runs away from all its peers.
        """
        silent = self.silent()
        for name in silent if set(silent) != set(self.peers) else ():
            self._readers[name].waived = True
        self.forgive(self.peers)

    def waived(self) -> tuple[str, ...]:
        """Return the peers that are not waited for."""
        return tuple(name for name in self.peers if self._readers[name].waived)

    def excuse(self) -> None:
        """Restart every peer's timeout: this process itself was away, so their silence means nothing."""
        for name in self.peers:
            self._readers[name].heard_ns = self._clock()

    def forget(self, name: str) -> None:
        """Drop what is known of a reader that has left; a peer still owes what it has not acknowledged."""
        reader = self._readers.pop(name)
        if name in self.peers:
            self._readers[name] = _Reader(self._published - self._owed(reader), reader.heard_ns, waived=reader.waived)

    def _owed(self, reader: _Reader) -> int:
        return 0 if reader.waived else self._published - max(reader.acknowledged or 0, reader.forgiven)


class Readers:
    """Looks for the subscriptions of a publisher in the graph; a reader is known by its node name.

    A block sent before a peer is connected would be lost to it. The graph knows a subscription before the publisher is
    matched with it; the publisher counts its matches, so all that can match must have (one that asks for other
    qualities of service cannot).
    """

    def __init__(self, node: Node, publisher: Any) -> None:
        self._node = node
        self._publisher = publisher
        self._missing: set[str] = set()
        self._expected_at = 0.0
        self._present: dict[str, set[bytes]] = {}  # subscriptions by name of their node
        self._came_ns: dict[str, int] = {}  # when the newest of these was seen first [ns of the monotonic clock]
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

    def came_ns(self, name: str) -> int:
        """Return when the newest subscription of a node was seen first [ns of the monotonic clock]; 0: never."""
        return self._came_ns.get(name, 0)

    def _due(self, period_s: float) -> bool:
        return time.monotonic() - self._looked_at >= period_s

    def _look(self) -> list[TopicEndpointInfo]:
        found: list[TopicEndpointInfo] = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
        self._looked_at, self._matched = time.monotonic(), self.subscribers
        before, self._present = self._present, {}
        for info in found:
            self._present.setdefault(info.node_name, set()).add(bytes(info.endpoint_gid))
        now_ns = time.monotonic_ns()
        anew = (name for name, ids in self._present.items() if not ids <= before.get(name, set()))
        self._came_ns |= dict.fromkeys(anew, now_ns)
        return found


class Acknowledgements:
    """Says on daq/ack up to which block a node has processed daq/scan.

    A block that comes alone is acknowledged at once. Of a burst the executor is asked to come back when it has handed
    over what is waiting, and one acknowledgement stands for all: a rig that runs ahead sends blocks in bursts, and each
    message costs its sender and its receiver more than the block it is about. Those of real time wait for a timer.

    Args:
        node: owner, which offers `daq/ack` while it is configured; its name is the peer's.
        may_send: called before each acknowledgement; keeps the promise it makes, or returns False if that cannot be.
        catch_up: called by the timer of real time: processes what has been put off until then.
    """

    def __init__(
        self,
        node: ManagedNode[Any],
        may_send: Callable[[], bool] = lambda: True,
        catch_up: Callable[[], None] = lambda: None,
    ) -> None:
        self.is_timed = False
        """Whether the newest block was one of real time, so that the timer acknowledges it."""
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
        """Note that the block with this stamp is processed."""
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
        """Say what has not been said: the node is being deactivated."""
        self.is_timed = self._has_timer = False
        if self._node.context.ok():
            self._send()

    def _on_timer(self) -> None:
        self._catch_up()
        self._send()

    def _send(self) -> None:
        waiting, self._waiting = self._waiting, 0  # what must not be acknowledged now never is by itself
        if waiting and self._may_send():
            self._sent_at = time.monotonic()
            self._node.send(topics.ACK, self._message.render(self._newest_ns))
