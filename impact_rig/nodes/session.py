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
"""ROS session of one rig: start-up checks, command input, time stepping, publishing and flow control.

The session asks `Rig` for the blocks that are due, and publishes them. A block is a short piece of the rig's output, 10
ms by default. In the time mode `realtime`, the clock decides which blocks are due. In other modes, the acknowledgements
of the slowest peer decide. In lockstep or while paused, only requested steps are due.

A namespace of a ROS domain belongs to one rig at a time. The ROS graph may show another rig only after seconds. A lock
file shows a rig of the same user and machine at once. If discovery is limited to this machine, the lock suffices.
"""

from __future__ import annotations

import functools
import math
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any  # values of parameters

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from impact_rig import codec, states, topics
from impact_rig.blocks import Table, joined
from impact_rig.errors import CodecError, CommandError, describe
from impact_rig.instruments.section import channels_of
from impact_rig.names import one_line
from impact_rig.nodes.acknowledgements import REPEATED_S, AckWindow, Readers
from impact_rig.nodes.managed import Done, ManagedNode, NodeState
from impact_rig.nodes.pacing import Pacer, WorkTimer
from impact_rig.nodes.publishers import Publishers
from impact_rig.nodes.rclpy_internals import take_messages
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S
from impact_rig.system import files

OBEDIENT = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp")
"""Names of the ROS middleware that obeys the environment variable `ROS_AUTOMATIC_DISCOVERY_RANGE`."""
GRAPH_POLL_S = 0.5  # minimum interval between two checks for other publishers of a rig's topics


def ends_here(environment: Mapping[str, str], middleware: str) -> bool:
    """Return whether ROS discovery is certainly limited to this machine.

    Rigs on other machines then cannot interfere.

    Args:
        environment: environment variables. `ROS_AUTOMATIC_DISCOVERY_RANGE` must be `LOCALHOST` or `OFF` (case is
            ignored); `ROS_STATIC_PEERS` and `ROS_DISCOVERY_SERVER` must be empty or not set.
        middleware: name of the ROS middleware, which must be in `OBEDIENT`.
    """
    near = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() in ("LOCALHOST", "OFF")
    far = environment.get("ROS_STATIC_PEERS") or environment.get("ROS_DISCOVERY_SERVER")
    return near and not far and middleware in OBEDIENT


class NamespaceLock:
    """Lock file of a rig for its ROS domain and namespace, to detect a second rig of the same user and machine.

    If the lock decides (`decides`), `take` returns False in the second rig. The second rig then waits until the first
    rig has ended.
    """

    def __init__(self, node: Node) -> None:
        self._name = files.place(node.context.get_domain_id(), node.get_namespace())
        self._held: int | None = None
        here = ends_here(os.environ, get_rmw_implementation_identifier())
        self.decides = here and files.can_hold(files.PLACES, self._name)
        """True if the lock shows any other rig of this user in the namespace; False if only the ROS graph can show it.

        It is False if rigs of other machines are possible, or no lock file can be used.
        """

    def take(self) -> bool:
        """Try to acquire the lock; return False if another rig holds it.

        Returns:
            True if this rig holds the lock, and also if `decides` is False: then only the ROS graph can show other
            rigs.
        """
        if self._held is None and self.decides:
            self._held = files.hold(files.PLACES, self._name)
            if self._held is None and files.is_held_by_others(files.PLACES, self._name):
                self.decides = False
        return self._held is not None or not self.decides

    def leave(self) -> None:
        """Release the lock, if it is held, so that another rig can start in this namespace."""
        if self._held is not None:
            os.close(self._held)
            self._held = None


class DuplicatePublishers:
    """Detector of other nodes that publish topics which only this rig may publish, as shown by the ROS graph.

    Args:
        node: node of this rig.
        names: function that returns the names of these topics, such as `Publishers.names`.
    """

    def __init__(self, node: Node, names: Callable[[], Iterable[str]]) -> None:
        self._node = node
        self._names = names
        self._polled_at = -GRAPH_POLL_S
        self._sentence = ""

    def sentence(self) -> str:
        """Return a sentence that names other nodes which publish this rig's topics; empty if there are none.

        The graph is queried at most twice a second; a change is logged.
        """
        now = time.monotonic()
        if now - self._polled_at >= GRAPH_POLL_S:
            self._polled_at = now
            before, self._sentence = self._sentence, self._poll()
            if self._sentence != before:
                logger = self._node.get_logger()
                logger.error(f"{self._sentence}; end one of them") if self._sentence else logger.info(
                    "no node other than this rig publishes its topics now"
                )
        return self._sentence

    def _poll(self) -> str:
        found: dict[str, list[str]] = {}
        for name in self._names():
            if self._node.count_publishers(name) > 1:
                for other in self._others(name):
                    found.setdefault(other, []).append(name)
        return "; ".join(f"{other} publishes {', '.join(names)} as well as this rig" for other, names in found.items())

    def _others(self, name: str) -> set[str]:
        own = self._node.get_fully_qualified_name()
        publishers = [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(name))
        ]
        others = {publisher for publisher in publishers if publisher != own}
        return others | {f"another {own}"} if publishers.count(own) > 1 else others


WORK_S = 0.02  # wall time for which one call of the work timer may run before commands and services are processed
LARGEST_BATCH_S = 0.2  # rig time simulated at once, which delays commands and services as well
CATCH_UP_NS = 50_000_000
"""Largest rig time [ns] that a rig in real time simulates at once while it is behind; then it reads the clock again."""
SHORTEST_PERIOD_S, LONGEST_PERIOD_S = 0.001, 0.05
AHEAD_PERIOD_S = 0.005  # period of the work timer if acknowledgements drive the work
SLICE_S = 0.02
"""Time [s] after each call of the work timer during which an acknowledgement may start further work.

An executor that delivers all messages of one subscription first would otherwise never reach services and timers.
"""
AWAY_S = 1.0  # a gap this long between two calls of the work timer means that this process was suspended, not the peers
EXPIRES_S = 2.0
"""Duration [s] of a suspension of this process above which commands that were sent during it are rejected.

Their senders have already received an error.
"""
# share of a processor: a process that used more between two calls of the work timer was not suspended
BUSY_SHARE = 0.25
CHECKED_S = 10.0
"""Time [s] after a suspension during which the rig rejects commands that were sent before it resumed.

If clocks have been set, or differ, the times of sending prove nothing: then every command received within `REPEATED_S`
after the suspension is rejected.
"""
STEP_NS = 100_000_000  # difference between two clocks above which they disagree, or one of them was set
IDLE_S = 1.0  # a client that steps repeatedly does so more often than this: between two such steps a rig is not paused
RATE_WINDOW_S = 2.0
COUNTED_TOGETHER = 32  # number of blocks whose scans are checked together


class Counts:
    """Counters of a rig since its activation (blocks, impacts, scans over range), and its active faults."""

    def __init__(self) -> None:
        self.blocks = 0
        self.lost_blocks = 0
        self.impacts = 0
        self.other_acks = 0
        self._over_range: Counter[str] = Counter()
        self._uncounted: list[NDArray[np.void]] = []  # scans not yet checked for channels over range
        self.faults: dict[int, str] = {}  # active instrument faults
        self._rates: deque[tuple[float, int]] = deque([(time.monotonic(), 0)])

    def take(self, block: Block) -> None:
        """Count one block of the rig, its impacts and its scans over range, and update the active faults.

        A block whose scans are withheld by an instrument fault counts, too.
        """
        self.blocks += 1
        self.lost_blocks += block.lost
        if block.impacts is not None:
            self.impacts += len(block.impacts.rows)
        self._uncounted.append(block.scan.rows)
        if len(self._uncounted) >= COUNTED_TOGETHER:
            self.over_range()
        if block.faults is not None:
            for row in block.faults.rows:
                number = int(row["id"])
                if row["active"]:
                    self.faults[number] = f"{row['kind'].decode()}/{row['channel'].decode()}".rstrip("/")
                else:
                    self.faults.pop(number, None)

    def over_range(self) -> Counter[str]:
        """Return, by channel, the number of scans since the activation in which the channel was over range."""
        if self._uncounted:
            rows, self._uncounted = joined(self._uncounted), []
            status = rows["status"]
            if status.any():
                for bit, name in enumerate(channels_of(rows)):
                    self._over_range[name] += int(((status >> bit) & 1).sum())
        return self._over_range

    def block_rate_hz(self) -> float:
        """Return the number of blocks per second of wall time, averaged over at least the last two seconds.

        The average begins at a former call, so it covers more time if this method is called less often. In the first
        two seconds it begins at the activation.
        """
        now = time.monotonic()
        self._rates.append((now, self.blocks))
        while len(self._rates) > 2 and now - self._rates[1][0] > RATE_WINDOW_S:
            self._rates.popleft()
        then, before = self._rates[0]
        return (self.blocks - before) / (now - then) if now > then else 0.0


class Session:
    """Operation of the rigs of a node, one after another: commands, services, publishing and pace.

    The session exists as long as the node. Each activation of the node starts a new rig, as soon as no other rig is in
    its namespace; the rig ends when the node is deactivated.
    """

    publishers: Publishers  # exists from when the node is configured
    readers: Readers  # readers of the scans and, below, other publishers; exist from when the node is active
    duplicates: DuplicatePublishers

    def __init__(self, node: ManagedNode[RigConfig]) -> None:
        self.node = node
        self.lock = NamespaceLock(node)
        self.rig: Rig | None = None  # the simulated rig; None before it has started
        self._latched: str | None = None  # reason of a latch that the next rig inherits from the previous one
        self.pacer = Pacer(time.monotonic_ns)
        self.window = AckWindow((), 1, NS_PER_S, time.monotonic_ns)
        self.counts = Counts()
        self.absent = ""  # peers not discovered in time, separated by commas
        self._contact: object = None  # settings of the contact law for which the next value was computed
        # restitution coefficient that the contact law realises: with the paper's law 0.309 for a nominal 0.35
        self.realised_restitution = math.nan
        self.paused = False  # whether rig time stands still except for requested steps
        self.clock_offset_ns = 0
        self._is_still = False  # no step has been requested since the pause
        # monotonic time [s] since which a rig outside of real time has waited for samples of its drive
        self._starved_at: float | None = None
        self._steps_left, self._stepped_at = 0, -IDLE_S  # blocks owed, and time of the last step request
        self._stepping: list[Done] = []
        self._pausing: list[Done] = []
        self._history_settled = self._active = False
        self._timer = WorkTimer(node, self._on_timer)
        self._worked_at = self._used_s = self._slice_began = 0.0
        # time at which this process last resumed from a suspension: monotonic [s], system time [ns]
        self._resumed_at, self._resumed_ns = -math.inf, 0
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._clock_is_set = False  # whether the system clock was set during that suspension or soon after it
        self._commands = [
            node.subscribe(topic, functools.partial(self._on_command, topic.name, key))
            for topic, key in ((topics.FREQUENCY, "frequency_hz"), (topics.CURRENT, "amplitude"))
        ]
        self._commands.append(node.subscribe_table(topics.WAVEFORM, self._on_waveform))
        node.subscribe(topics.ACK, self._on_ack, raw=True)
        node.service(Trigger, "~/step", self._on_step)
        node.service(SetBool, "~/pause", lambda request, done: self.pause(done) if request.data else self.resume(done))
        for name, act, said in (
            ("reset", self.reset, "reset: the rig starts again at scan 0"),
            ("stop", Rig.stop, "shaker ramps to zero and stays latched until ~/clear_trip"),
            ("clear_trip", Rig.clear_trip, "latch released; the amplitude stays zero until the next command"),
            ("pluck", self._pluck, "base locked, structure displaced and released; ~/reset unlocks the base"),
        ):
            in_time = None if name == "stop" else self.refuse_backlog
            node.service(Trigger, f"~/{name}", functools.partial(self._act, act, said), in_time)

    @property
    def is_realtime(self) -> bool:
        """Return whether the time mode is `realtime`, in which wall time decides when blocks are due."""
        return self.node.settings.time.mode == "realtime"

    @property
    def is_lockstep(self) -> bool:
        """Return whether the time mode is `lockstep`, in which rig time advances by requested steps only."""
        return self.node.settings.time.mode == "lockstep"

    @property
    def is_idle(self) -> bool:
        """Return whether all requested steps are published, and no step was requested for 1 s of wall time."""
        return self._steps_left <= 0 and time.monotonic() - self._stepped_at > IDLE_S

    @property
    def is_starving(self) -> bool:
        """Return whether the rig has waited for samples of its drive longer than `time.peer_timeout_s` of wall time.

        In real time, a rig waits for samples only during the steps of a pause.
        """
        patience_s = self.node.settings.time.peer_timeout_s
        return self._starved_at is not None and time.monotonic() - self._starved_at > patience_s

    def controllers(self) -> list[str]:
        """Return the names, without namespace, of the nodes that have a publisher on `shaker/waveform`, sorted.

        These nodes can send samples of the drive.
        """
        found = self.node.get_publishers_info_by_topic(self.node.resolve_topic_name(topics.WAVEFORM.name))
        return sorted({info.node_name for info in found})

    def lack_of_samples(self) -> str:
        """Return why the rig lacks samples of its drive, as text for messages; call it only while the rig lacks them.

        The text names the nodes that could send samples, or says that no node publishes samples.
        """
        names, topic = self.controllers(), topics.WAVEFORM.name
        source = f"no samples arrive from {' and '.join(names)}" if names else "no node publishes samples"
        return f"{source} on {topic}"

    # Start and end

    def configure(self) -> None:
        """Create the publishers of the rig's topics, with the present settings."""
        self.publishers = Publishers(self.node, self.node.settings)

    def activate(self) -> None:
        """Start the rig as soon as no other rig publishes its topics or holds its namespace.

        In real time, the rig also waits for its peers to subscribe to the scans, at most for `time.start_wait_s`. It
        then starts without the missing peers. This method returns at once: if the rig cannot start now, a timer starts
        it later.
        """
        self.publishers.forget()
        self.duplicates = DuplicatePublishers(self.node, self.publishers.names)
        self.readers = Readers(self.node, self.node.outputs[topics.SCAN.name])
        self.readers.expect(self.node.settings.time.peers)
        self._history_settled, self._active = False, True
        self._steps_left, self.counts, self._starved_at = 0, Counts(), None
        self._timer.start(AHEAD_PERIOD_S, 0.0)
        reason = self.reason_not_ready()
        if reason is None:
            self._begin()
        else:
            self.node.get_logger().info(one_line(reason.reason))
            self.publishers.announce(self.node.settings)

    def reason_not_ready(self) -> NodeState | None:
        """Return the state that keeps the rig of an active node from starting, with its reason.

        The result is None if nothing prevents the start, if the rig has started, or if the node is not active. A rig
        waits while another rig publishes the same topics or holds the lock of the namespace. In real time, it waits for
        its peers to subscribe, too, at most `time.start_wait_s`. If no other rig publishes, this method also tries to
        take the lock.
        """
        if not self._active or self.rig is not None:
            return None
        others = self.duplicates.sentence()
        if not others and not self.lock.take():
            others = f"another rig of this machine is in the namespace {self.node.get_namespace()}"
        if others:
            return NodeState(states.RigWord.RIVAL, f"waiting until the other rig has ended: {others}")
        patience_s = self.node.settings.time.start_wait_s
        if not self.is_realtime or self.readers.all_matched() or self.readers.overdue(patience_s):
            return None  # the other modes wait block by block
        names = ", ".join(self.readers.missing())
        return NodeState(states.RigWord.NO_PEER, f"waiting for peer {names} to subscribe, at most {patience_s:g} s")

    def _begin(self) -> None:
        """Create and start a new rig: its scan 0 is at the present time in real time, and at time 0 otherwise.

        Commands that were sent before are rejected.
        """
        config = self.node.settings
        timing = config.time
        self.absent = ", ".join(self.readers.missing()) if self.is_realtime else ""
        for subscription in self._commands:  # sent to no rig, or to the previous one
            for _message in take_messages(subscription):
                self.node.refuse(
                    "inactive",
                    f"{subscription.topic_name}: the command was sent before this rig started: send it again",
                )
        self.clock_offset_ns = time.time_ns() - time.monotonic_ns()
        start_ns = time.time_ns() if self.is_realtime else 0
        self.pacer = Pacer(time.monotonic_ns, timing.factor)
        self.pacer.rebase(start_ns)  # together with the stamp: both mean the same instant
        self.rig = Rig(config, start_ns)
        if self._latched is not None:
            self.rig.stop(self._latched)
            self._latched = None
        timeout_ns = round(timing.peer_timeout_s * NS_PER_S)
        self.window = AckWindow(timing.peers, timing.ack_window, timeout_ns, time.monotonic_ns)
        self.publishers.changes(self.rig)
        self._publish_configuration(self.rig)
        if timing.peers and self.is_realtime:
            self.publishers.settle_history()
        self._worked_at = time.monotonic()
        self._start_timer(config)

    def deactivate(self) -> None:
        """End the rig, drop unpublished data, and answer waiting requests with an error.

        If the shaker is latched, the shaker of the next rig is latched from its start.
        """
        self._timer.stop()
        if self.rig is not None:
            self._latched = self.rig.latched
        self.rig, self._active = None, False
        self.lock.leave()
        self.paused = self._is_still = False
        self._worked_at, self._resumed_at = 0.0, -math.inf
        self._end_steps("the rig was deactivated")
        _answer(self._pausing, False, "the rig was deactivated")

    def running(self) -> Rig:
        """Return the rig that has started, also if it is paused.

        Raises:
            CommandError: no rig has started; the message says why.
        """
        if self.rig is None:
            raise CommandError(self.why_not())
        return self.rig

    def why_not(self) -> str:
        """Return why no rig has started and, if possible, what to do, as text for an error message."""
        reason_not_ready = self.reason_not_ready()
        if reason_not_ready is not None:
            return f"the rig has not started: {reason_not_ready.reason}"
        if self._active:
            return "the rig is about to start: try again"
        return f"the rig is {self.node.why_not_active()}"

    # Work

    def _start_timer(self, config: RigConfig) -> None:
        """Start the timer that calls `work`: in real time in phase with the blocks, otherwise every 5 ms."""
        period_s = AHEAD_PERIOD_S
        if self.is_realtime:
            block_s = config.daq.block_scans / config.daq.rate_hz / config.time.factor
            calls = math.ceil(block_s / LONGEST_PERIOD_S)  # calls per block; one of them at its end
            period_s = max(block_s / calls, SHORTEST_PERIOD_S)
        self._timer.start(period_s, self._wait_s() if self.is_realtime else 0.0)

    def _wait_s(self) -> float:
        """Return the wall time until the next block is due in real time [s]; negative if it is overdue."""
        return self.pacer.wait_ns(self.running().block_end_ns(1)) / NS_PER_S

    def _on_timer(self) -> None:
        self.work()
        self._slice_began = time.monotonic()
        if self.rig is not None and self.is_realtime and not self.paused:
            self._timer.keep_in_step(self._wait_s())

    def work(self) -> None:
        """Publish the blocks that are due, or start the rig if it has not started and nothing prevents the start.

        A call ends after about 20 ms even if more blocks are due; the next call continues. If the simulation fails, the
        node is deactivated.
        """
        now = self._notice_absence()
        try:
            if self.rig is None:
                if self._active and self.reason_not_ready() is None:
                    self._begin()
            elif self.is_realtime and not self.paused:
                self._catch_up(self.rig, now + WORK_S)
            elif not self._is_still and (self._stepping or not self.paused):
                self._run_ahead(self.rig, now + WORK_S)
        except Exception as error:
            self.node.report_failure("simulation", describe(error))
            self.node.trigger_deactivate()
        if self._pausing and (self.window.outstanding() == 0 or self.window.silent()):
            _answer(self._pausing, True, "paused")

    def _notice_absence(self) -> float:
        """Detect whether this process was suspended since the last call; return the present monotonic time [s].

        A process counts as suspended if more than `AWAY_S` passed between two calls. The timeouts of the peers then
        start again. After more than `EXPIRES_S` with little use of the processor, `refuse_backlog` also rejects
        commands that were sent before the process resumed.
        """
        now, used_s = time.monotonic(), time.process_time()
        before_ns, self._epoch_ns = self._epoch_ns, time.time_ns() - time.monotonic_ns()
        self._clock_is_set |= abs(self._epoch_ns - before_ns) > STEP_NS
        if self._worked_at and now - self._worked_at > AWAY_S:
            self.window.excuse()
            if self._starved_at is not None:
                self._starved_at = now
            # for example, while a new law is compiled
            is_busy = used_s - self._used_s > BUSY_SHARE * (now - self._worked_at)
            if now - self._worked_at > EXPIRES_S and not is_busy:
                self._resumed_at, self._resumed_ns = now, time.time_ns()
        elif now - self._resumed_at > CHECKED_S:
            self._clock_is_set = False
        self._worked_at, self._used_s = now, used_s
        return now

    def refuse_backlog(self, sent_ns: int) -> None:
        """Raise an error if a command was sent before this process resumed from a suspension: its sender has given up.

        Only a suspension that was longer than `EXPIRES_S` and ended less than `CHECKED_S` ago matters.

        Args:
            sent_ns: time at which the command was sent, by the system clock of its sender [ns].

        Raises:
            CommandError: the command was, or may have been, sent before this process resumed.
        """
        since_s = self._notice_absence() - self._resumed_at
        if since_s > CHECKED_S:
            return
        late_s = (self._resumed_ns - sent_ns) / NS_PER_S
        if self._clock_is_set or sent_ns > time.time_ns() + STEP_NS:
            if since_s < REPEATED_S:
                raise CommandError(
                    "the command may have been sent before the process of this rig, which had been stopped, ran again: "
                    "send it again in a few seconds"
                )
        elif late_s > 0.0:
            raise CommandError(
                f"the command was sent {late_s:.1f} s before the process of this rig, which had been stopped, ran "
                "again: send it again"
            )

    def _catch_up(self, rig: Rig, deadline: float) -> None:
        """Simulate and publish the blocks that are due in real time, until `deadline` [s of the monotonic clock].

        The deadline is checked after every 50 ms of rig time (`CATCH_UP_NS`). The next call publishes the blocks that
        remain.
        """
        due_ns = self.pacer.due_ns(self._simulated_ns(rig))
        while True:
            until_ns = min(due_ns, rig.frontier_ns + CATCH_UP_NS)
            self._advance(rig, until_ns)
            if until_ns == due_ns or time.monotonic() > deadline:
                return

    def _simulated_ns(self, rig: Rig) -> int:
        """Return the rig time up to which the rig is simulated [ns], for the pacer.

        The simulated part of an unfinished block counts, except its last 10 ms (`COMMAND_GRID_NS`). That last part may
        be simulated ahead of time.
        """
        return max(rig.next_block_ns, rig.frontier_ns - COMMAND_GRID_NS)

    def _run_ahead(self, rig: Rig, deadline: float) -> None:
        """Publish as many blocks as peers, steps and samples allow, until `deadline` [s of the monotonic clock].

        The method is for rigs outside of real time, and for the steps of a paused rig. Step requests are answered with
        success once the peers have acknowledged all blocks of the steps. They are answered with an error if a peer is
        silent, or if samples of the drive are missing for too long.
        """
        daq, window = self.node.settings.daq, self.window
        by_steps = self.paused or self.is_lockstep
        limit = self._steps_left if by_steps else window.window
        if not self.readers.all_matched():
            self._refuse_without_peers()
            return
        if not self._history_settled:
            self.publishers.settle_history()
            self._history_settled = True
        batch = max(1, round(LARGEST_BATCH_S * daq.rate_hz / daq.block_scans))
        while limit > 0 and not window.silent():
            room = min(window.room(), limit, batch)
            if room < min(limit, batch, (window.window + 1) // 2):
                break  # waiting for half a window makes batches efficient
            room = rig.blocks_with_samples(room)
            if room == 0:
                self._starved_at = self._starved_at or time.monotonic()
                break
            published = self._advance(rig, rig.block_end_ns(room))
            if by_steps:
                self._steps_left -= published
                limit = self._steps_left
            if time.monotonic() > deadline:
                break
        silent = window.silent() if self._stepping else ()
        if self._stepping and self.is_starving:
            self._end_steps(
                f"{self.lack_of_samples()}: send samples, or call ~/pause with false to continue without them"
            )
        elif silent:
            self._end_steps(
                f"peer {', '.join(silent)} does not acknowledge {topics.SCAN.name}: restart it, or call ~/pause with "
                "false to continue without it"
            )
        elif self._steps_left <= 0 and self._stepping and window.outstanding() == 0:
            _answer(self._stepping, True, f"rig time {rig.next_block_ns / NS_PER_S:.9f} s")

    def _advance(self, rig: Rig, until_ns: int) -> int:
        """Simulate up to the rig time `until_ns` [ns]; publish changes of the rig, and then the completed blocks.

        Returns:
            Number of completed blocks.
        """
        blocks = rig.advance(until_ns)
        if self.publishers.changes(rig):
            self.node.report_change()  # for example, after a trip
        if blocks:
            self.publishers.poll(often=self.paused or not self.is_realtime)
        for block in blocks:
            self.publishers.block(block)
            if not block.lost:
                self.window.published(block.scan.stamp_ns)
            if not self.paused:
                self.pacer.published(block.end_ns)
            self.counts.take(block)
        if blocks:
            self._starved_at = None
            self.publishers.stream(rig)
        if blocks and self.node.settings.time.publishes_clock:
            self.publishers.clock(blocks[-1].end_ns)
        return len(blocks)

    # Steps and pauses

    def step(self, steps: int, done: Done) -> None:
        """Request `steps` steps of `step.blocks` blocks each, and advance the rig as far as possible now.

        `done` is called with success when every peer has acknowledged all blocks of all requested steps. It is called
        with an error if a peer does not subscribe or acknowledge, or samples of the drive are missing, for longer than
        `time.peer_timeout_s`. Reset and deactivation also give an error, and so does resuming the rig, except in
        lockstep.
        """
        self._steps_left += steps * self.node.settings.step.blocks
        self._stepped_at = time.monotonic()
        self._stepping.append(done)
        self._is_still = False  # a step of a paused rig includes the rest of earlier steps
        self.work()

    def pause(self, done: Done) -> None:
        """Stop rig time at once; call `done` with success when the peers have acknowledged all published blocks.

        `done` is also called with success if a peer is silent. Unfinished steps wait for the next `step`, or in
        lockstep for `resume`.

        Raises:
            CommandError: no rig has started.
        """
        self.running()
        self.paused = self._is_still = True
        self._pausing.append(done)
        self.work()
        self.node.report_change()

    def resume(self, done: Done) -> None:
        """Let rig time continue if the rig is paused, or waits for a silent peer or for samples; then call `done`.

        The rig continues without the silent peers until they acknowledge again. If no other peer is left, it continues
        only for one more window of blocks. If samples of the drive are missing, the stream ends after the samples that
        have arrived. Waiting requests to pause are answered with an error. Waiting step requests are answered with an
        error, too, except in lockstep.

        Raises:
            CommandError: no rig has started.
        """
        rig = self.running()
        starving = self.is_starving
        if self.paused or self.window.silent() or starving:  # a running rig gives nothing up
            was_paused, self.paused, self._is_still = self.paused, False, False
            _answer(self._pausing, False, "the rig was resumed by another request")
            if not self.is_lockstep:
                self._end_steps("the rig was resumed by another request")
            self.window.waive()
            if starving:
                rig.feed(rig.stream.played + rig.stream.buffered(), ())
            if was_paused:  # otherwise, real time went on, and blocks that are due keep their time
                self.pacer.rebase(self._simulated_ns(rig))
                self._start_timer(self.node.settings)
            self.node.report_change()
        done(True, "running")

    def _end_steps(self, message: str) -> None:
        """Answer the waiting step requests with an error, and cancel their remaining blocks."""
        self._steps_left = 0
        _answer(self._stepping, False, message)

    def _refuse_without_peers(self) -> None:
        """Answer waiting step requests with an error if a peer has not subscribed within `time.peer_timeout_s`.

        This time counts from the last step request, or from the time at which the peers were set if that is later.
        """
        patience_s = self.node.settings.time.peer_timeout_s
        waited = time.monotonic() - self._stepped_at > patience_s
        if self._stepping and waited and self.readers.overdue(patience_s):
            missing = ", ".join(self.readers.missing())
            self._end_steps(
                f"peer {missing} does not subscribe to {topics.SCAN.name}: start it, or remove it from time.peers"
            )

    def _on_step(self, _request: Trigger.Request, done: Done) -> None:
        self.running()
        if not self.is_lockstep and not self.paused:
            mode = self.node.settings.time.mode
            raise CommandError(
                f"no steps while the rig runs in {mode}: pause it first (~/pause), or start it with time.mode lockstep"
            )
        self.step(1, done)

    # Other inputs

    def reset(self, rig: Rig) -> None:
        """Start the rig again at scan 0, with stamps that continue; waiting step requests are answered with an error.

        Raises:
            CommandError: the shaker is latched; nothing is changed.
            ConfigError: the limits of the shaker are below `drive.amplitude`, after a change; nothing is changed.
        """
        rig.reset()
        self._end_steps("the rig was reset")
        self._starved_at = None  # samples are needed from the start again
        self.publishers.changes(rig)
        self.counts.faults.clear()  # planned faults start again and are reported again
        self._publish_configuration(rig)
        self.node.get_logger().info("reset: the rig starts again at scan 0")

    def _pluck(self, rig: Rig) -> None:
        rig.pluck(self.node.settings.pluck.displacement_m)

    def _act(self, act: Callable[[Rig], None], said: str, _request: Trigger.Request, done: Done) -> None:
        """Apply the action `act` of a service to the rig, and answer the request with the text `said`."""
        rig = self.running()
        act(rig)
        self._note_samples(rig)
        self.publishers.changes(rig)
        done(True, said)

    def _on_command(self, name: str, key: str, message: Float64, info: Mapping[str, Any]) -> None:
        if self.rig is None:
            self.node.refuse("inactive", f"{name}: {self.why_not()}")
            return
        was_driven = self.rig.target_amplitude != 0.0
        try:
            self.refuse_backlog(int(info["source_timestamp"]))
            self.rig.accept(**{key: message.data})
        except CommandError as error:
            self.node.refuse(name, str(error))
            return
        self.node.get_logger().debug(f"accepted: {key} = {message.data:g}")
        self.publishers.changes(self.rig)
        if was_driven != (self.rig.target_amplitude != 0.0):
            self.node.report_change()

    def _on_waveform(self, table: Table) -> None:
        rig = self.rig
        if rig is None:
            self.node.refuse("inactive", f"{topics.WAVEFORM.name}: {self.why_not()}")
            return
        try:
            rig.feed(rig.sample_at(table.stamp_ns), table.rows["value"])
        finally:
            if not self.is_realtime:  # in real time the next block reports it
                self.publishers.stream(rig)
        if self._starved_at is not None:
            self._note_samples(rig)
            self.work()

    def _note_samples(self, rig: Rig) -> None:
        """End the wait for samples of the drive (`is_starving`) if the rig has all samples for its next block."""
        if self._starved_at is not None and rig.blocks_with_samples(1):
            self._starved_at = None

    def _on_ack(self, data: bytes) -> None:
        """Process an acknowledgement (`daq/ack`) of any reader.

        After the acknowledgement of a peer, further blocks may be published at once.
        """
        if not self._active:
            return
        try:
            stamp, name = codec.header(data)
        except CodecError as error:
            self.node.refuse(topics.ACK.name, str(error))
            return
        window = self.window
        if window.newest_ns is None or stamp > window.newest_ns:
            self.node.refuse(
                topics.ACK.name,
                f"{name!r} acknowledged a block with stamp {stamp} ns, but no block so late was published: send the "
                "stamp of a block that was received",
            )
            return
        if name not in window.readers:
            if not self.readers.knows(name):
                self.counts.other_acks += 1
                return
            window.watch(name)
        window.acknowledge(name, stamp)
        is_awaited = name in window.peers and (self._pausing or not self.is_realtime)
        if is_awaited and time.monotonic() - self._slice_began < SLICE_S:
            self.work()

    def change(self, settings: RigConfig, changes: dict[str, Any]) -> None:
        """Apply new, validated settings to the rig, the flow control and the pace, and publish the settings.

        If no rig has started, the settings are not published. The next rig starts with them.

        Raises:
            ImpactRigError: the rig rejects the settings; nothing is changed.
        """
        rig = self.rig
        if rig is not None:
            rig.adopt(settings, changes)  # first, because it may raise
        if self._active and "time.peers" in changes:
            self.readers.expect(settings.time.peers)
            self._history_settled = False
        if rig is None:
            return
        self.publishers.changes(rig)
        if any(name.startswith(("time.peers", "time.ack_window", "time.peer_timeout")) for name in changes):
            self.window.set_peers(settings.time.peers)
            self.window.window = settings.time.ack_window
            self.window.timeout_ns = round(settings.time.peer_timeout_s * NS_PER_S)
        if "time.factor" in changes:
            self.pacer.rebase(self._simulated_ns(rig), settings.time.factor)
            self._start_timer(settings)
        self._publish_configuration(rig)

    def _publish_configuration(self, rig: Rig) -> None:
        """Publish the active configuration, the calibration if it has changed, and the state of the sample stream."""
        self.publishers.configuration(rig)
        self.publishers.stream(rig)
        if rig.config.contact != self._contact:
            self._contact, self.realised_restitution = rig.config.contact, rig.simulation.realised_restitution


def _answer(waiting: list[Done], success: bool, message: str) -> None:
    """Answer all waiting requests with the same result, and empty the list.

    The list is emptied before the first answer, because an answer may trigger new requests.
    """
    answered, waiting[:] = list(waiting), []
    for done in answered:
        done(success, message)
