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
"""Playback of a recorded run onto the ROS graph, at a multiple of real time or as fast as named peers acknowledge.

The recorded bytes are published unchanged, so an analysis of the playback finds the original results. Messages that
were recorded before the first scan (calibration, journal, settings) are sent at once, even if the player is paused.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any  # rclpy publishers and messages

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from impact_rig import codec, topics
from impact_rig.errors import ImpactRigError, RecordingError
from impact_rig.nodes import messages
from impact_rig.nodes.acknowledgements import AckWindow, Readers
from impact_rig.nodes.messages import TOPICS
from impact_rig.nodes.pacing import Pacer
from impact_rig.nodes.process import make_executor, patient_threads
from impact_rig.recording import RecordedTopic, Run
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S
from impact_rig.system.endings import defer_signals

MADE_HERE = (topics.CLOCK.name, topics.CLOCK.name.lstrip("/"), topics.ACK.name)
"""Topics that are never replayed: the player makes its own clock, and acknowledgements come from the present peers."""
SPIN_S = 0.05
LAST_NS = (2**31 - 1) * NS_PER_S  # builtin_interfaces/Time counts seconds in 32 bits
LONGEST_PAUSE_NS = 3600 * NS_PER_S
"""Longest pause [ns] between two recorded messages that is replayed; a run with a longer one is rejected.

Otherwise the player would stall, or fill the pause with messages on /clock.
"""
WINDOW = 16  # number of blocks published ahead of the slowest peer
PEER_TIMEOUT_S = 10.0
AWAY_S = 1.0  # a gap this long between two waits means that this process, and not the peers, was suspended or busy
DELIVERY = Duration(seconds=1.0)
LAST_WORDS_S = 0.3


Spin = Callable[[float], None]  # runs callbacks for at most this long [s]


@contextlib.contextmanager
def on_graph(name: str) -> Iterator[tuple[Node, Spin]]:
    """Create a node on the ROS domain of the environment; yield the node and a function that runs its callbacks.

    The function waits until a callback can run, at most for the given time [s]. The node is destroyed at the end of the
    `with` statement.
    """
    context = Context()
    context.init(args=[])
    executor = make_executor(context)
    with patient_threads():
        node = Node(name, context=context, use_global_arguments=False)
    executor.add_node(node)
    try:
        yield node, lambda longest_s: executor.spin_once(timeout_sec=longest_s)
    finally:
        with defer_signals():
            executor.shutdown()
            node.destroy_node()
            context.try_shutdown()


class Player:
    """Publisher of a recorded run, which other nodes receive like a live rig.

    Args:
        run: opened run; it must contain daq/scan.
        node: node that publishes.
        spin: function that runs the callbacks of the node for at most the given time [s].
        factor: seconds of rig time per second of wall time; None means as fast as the peers acknowledge.
        peers: names that nodes use in daq/ack; the player waits for these nodes, so that they lose no block.
        chosen: topics to replay, with or without namespace; empty means all but those of other rigs in the run.
            `daq/ack` and the recorded `/clock` are never replayed; the player publishes a `/clock` of its own.
        paused: whether playback starts paused, until the service `~/pause` is called with `false`.

    Raises:
        RecordingError: a chosen topic is not in the run, the run has no daq/scan, none of its several rigs was chosen,
            or it contains a topic name or time that ROS does not allow.
        ImpactRigError: `factor` is None without a peer, `chosen` lacks the daq/scan that peers acknowledge, or a
            message type is not installed.
    """

    def __init__(
        self,
        run: Run,
        node: Node,
        spin: Spin,
        *,
        factor: float | None = 1.0,
        peers: Collection[str] = (),
        chosen: Sequence[str] = (),
        paused: bool = False,
    ) -> None:
        if peers and chosen and run.name(topics.SCAN) not in map(run.name, chosen):
            raise ImpactRigError(
                f"peers acknowledge {topics.SCAN.name}: include it in the chosen topics (--topics), or name no peers "
                "(--peers)"
            )
        if factor is None and not peers:
            raise ImpactRigError(
                "playback at the highest rate would lose messages: name peers that acknowledge "
                f"{topics.SCAN.name} (--peers), or a rate (--rate)"
            )
        if run.end_ns > LAST_NS:
            raise RecordingError(
                f"{run.path}: a message has the log time {run.end_ns} ns, which cannot be replayed: the largest ROS "
                f"time is {LAST_NS} ns (19 January 2038); correct the clock and record the run again"
            )
        self._run, self._node, self._spin = run, node, spin
        self._factor = factor
        self._scan = run.resolve(topics.SCAN.name)
        others = tuple(prefix for prefix in run.prefixes if prefix != run.prefix)  # of the other rigs in the recording
        everything = [one for one in sorted(run.topics) if run.relative(one) is not None or not one.startswith(others)]
        wanted = [run.resolve(name) for name in chosen] if chosen else everything
        self._names = [name for name in wanted if name not in MADE_HERE and run.relative(name) not in MADE_HERE]
        self._publishers = {name: self._publisher(run.topics[name]) for name in self._names}
        self._clock = node.create_publisher(Clock, topics.CLOCK.name, messages.profile(topics.CLOCK.qos))
        self._readers = Readers(node, self._publishers[self._scan]) if peers else None
        if self._readers is not None:
            self._readers.expect(peers)
        self._peers = tuple(peers)
        self._window = self._new_window()
        self._rested_at = 0.0
        self._pacer = Pacer(time.monotonic_ns, factor or 1.0)
        ack = run.name(topics.ACK)
        node.create_subscription(Header, ack, self._on_ack, messages.profile(topics.ACK.qos))
        node.create_service(SetBool, "~/pause", self._on_pause)
        self.paused = paused
        self.now_ns = self.start_ns = next((one.log_time for one in run.messages([self._scan])), run.start_ns)
        self.end_ns = run.end_ns

    def play(self) -> Iterator[int]:
        """Publish the run once, from its start; yield its rig time [ns] often, so that the caller can stop.

        At the start, the player waits until all peers subscribe to the scans, without a time limit. At the end, it
        waits until the peers have acknowledged all blocks.

        Raises:
            RecordingError: a chunk of the run is damaged, or a message is more than an hour of rig time later than the
                message before it; earlier messages have been published.
            CodecError: a message on daq/scan has no valid header.
            ImpactRigError: a peer acknowledged nothing for 10 s of wall time although blocks were outstanding.
        """
        self.now_ns = self.start_ns
        self._window = self._new_window()  # stamps begin again
        self._rested_at = time.monotonic()
        while self._readers is not None and not self._readers.all_matched():
            yield from self._wait(SPIN_S)
        self._pacer.rebase(self.start_ns)
        clock_ns, shift_ns = self.start_ns, 0  # /clock follows the stamps: log times may belong to another clock
        for message in self._run.messages(self._names):
            if message.log_time > self.now_ns + LONGEST_PAUSE_NS:
                pause_h = (message.log_time - self.now_ns) / NS_PER_S / 3600
                raise RecordingError(
                    f"{self._run.path}: a message on {message.topic} is {pause_h:.4g} h later than the one replayed "
                    f"before it; a pause of more than {LONGEST_PAUSE_NS // (3600 * NS_PER_S)} h cannot be replayed: "
                    "choose topics without such a pause"
                )
            waits = message.log_time > self.start_ns or message.topic == self._scan
            while waits and self._must_wait(message.log_time):
                yield from self._wait(self._time_left_s(message.log_time))
            self.now_ns = max(self.now_ns, message.log_time)
            if message.topic == self._scan:
                shift_ns = codec.header_stamp_ns(message.data) - message.log_time
            rig_ns = min(max(message.log_time + shift_ns, 0), LAST_NS)
            if not clock_ns - NS_PER_S <= rig_ns <= clock_ns + LONGEST_PAUSE_NS:
                clock_ns = rig_ns
            while clock_ns <= rig_ns:
                self._clock.publish(messages.CLOCK.render(clock_ns))
                clock_ns += COMMAND_GRID_NS
            self._publishers[message.topic].publish(bytes(message.data))
            if message.topic == self._scan:
                self._window.published(codec.header_stamp_ns(message.data))
        while self._window.outstanding():
            yield from self._wait(SPIN_S)

    def finish(self) -> None:
        """Wait until the last messages and answers of services are delivered, so that the node can be destroyed.

        The wait lasts at most 1 s per topic, and 0.3 s for the answers. Messages that are not delivered by then cause
        no error.
        """
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(DELIVERY)
        self.spin_for(LAST_WORDS_S)

    def spin_for(self, seconds: float) -> None:
        """Run the callbacks of the node for a duration of wall time [s], however many there are."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._spin(left)

    def _must_wait(self, due_ns: int) -> bool:
        blocked = self._window.room() <= 0
        return self.paused or blocked or (self._factor is not None and self._pacer.wait_ns(due_ns) > 0)

    def _time_left_s(self, due_ns: int) -> float:
        if self.paused or self._factor is None:
            return SPIN_S
        return min(max(self._pacer.wait_ns(due_ns) / NS_PER_S, 0.0), SPIN_S)

    def _wait(self, longest_s: float) -> Iterator[int]:
        """Run callbacks for at most `longest_s` seconds of wall time, and then yield the present rig time [ns] once.

        Raises:
            ImpactRigError: a peer has acknowledged nothing for 10 s of wall time although blocks were outstanding.
        """
        now = time.monotonic()
        if now - self._rested_at > AWAY_S:
            self._window.excuse()
        self._rested_at = now
        silent = self._window.silent()
        if silent:
            raise ImpactRigError(
                f"playback stopped: peer {', '.join(silent)} acknowledged no block for {PEER_TIMEOUT_S:g} s; start "
                "that node and play the run again, or name only peers that are running"
            )
        self._spin(longest_s)
        yield self.now_ns

    def _new_window(self) -> AckWindow:
        return AckWindow(self._peers, WINDOW, round(PEER_TIMEOUT_S * NS_PER_S), time.monotonic_ns)

    def _publisher(self, recorded: RecordedTopic) -> Any:
        topic = recorded.topic
        offered = [qos for qos in topic.offered_qos_yaml() if isinstance(qos, dict)]
        relative = self._run.relative(topic.name)
        known = next((row for row in TOPICS if row.name in (topic.name, relative)), None)
        profile = messages.profile(known.qos if known else topics.Qos.DATA)
        if offered:  # a rig without ROS records no quality of service
            latched = any(qos.get("durability") == "transient_local" for qos in offered)
            profile.durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        try:
            return self._node.create_publisher(messages.message_class(topic.type_name), topic.name, profile)
        except NameValidationException as error:
            raise RecordingError(
                f"{self._run.path}: {topic.name!r} is not a valid ROS topic name; choose the topics to replay without "
                "this one"
            ) from error
        except (ImportError, AttributeError, ValueError) as error:
            raise ImpactRigError(
                f"{topic.name}: the message type {topic.type_name!r} is not installed: install the ROS package that "
                "defines it, or choose the topics to replay without this one"
            ) from error

    def _on_ack(self, message: Header) -> None:
        self._window.acknowledge(message.frame_id, messages.nanoseconds(message.stamp))

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.paused = request.data
        self._pacer.rebase(self.now_ns)
        response.success, response.message = True, "paused" if request.data else "playing"
        return response
