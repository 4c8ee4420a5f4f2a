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
"""Test rig that hosts ROS nodes in this process and runs their callbacks in a reproducible order.

`LocalRigWithNodes.host` creates a node with real subscriptions, timers, parameters and clock. The rig runs the
callbacks one by one in rig time. A model of the transport replaces the middleware, with queues, qualities of service
and latched messages. The order of callbacks therefore depends only on the scenario. The actions of a scenario are in
`impact_rig.testing.strategies`.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any  # nodes and messages have no common base

import attrs
import rclpy.clock
import rclpy.publisher
from rclpy.clock import ClockType
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.client.client import Collector, as_default
from impact_rig.client.processes import isolated_domain
from impact_rig.driver.driver import STEP_TIMEOUT_S
from impact_rig.driver.local_rig import LocalRig
from impact_rig.errors import CommandError, ConfigError
from impact_rig.nodes import messages
from impact_rig.nodes.publishers import Monitors, noise_of
from impact_rig.nodes.rclpy_internals import call_subscription, call_timer
from impact_rig.rig import Block, journal
from impact_rig.rig.config import RigConfig
from impact_rig.rig.journal import JournalEntry
from impact_rig.simtime import NS_PER_S, first_scan_at, stamp_ns

TIMERS, MESSAGES = "timers", "messages"
"""Sources that are not topics: all timers of the nodes, and for `hold` only, the messages of all topics."""
KEPT_CALLBACKS = 20_000
MOST_CALLBACKS = 10_000  # limit at one instant of rig time: nodes that exceed it answer each other without end
TICK_S, IDLE_S, BUSY_S = 0.2, 1.0, 20.0
"""A callback is blocked if it uses no processor time for `IDLE_S`, or does not return within `BUSY_S` of wall time.

This is checked every `TICK_S`.
"""
IDLE_CPU_S = 0.002  # processor time per tick of a thread that waits
INTERNAL = ("/parameter_events", "/rosout")


class BlockedError(AssertionError):
    """Error raised if code of a hosted node does not return.

    The code waits although no other callback can run, or it runs for longer than `BUSY_S` seconds of wall time.
    """


@attrs.define(eq=False)
class _Inbox:
    """Queue of the messages of one subscription, oldest first: number of the publication, and CDR bytes."""

    subscription: Any
    topic: str
    queue: deque[tuple[int, bytes]] = attrs.field(factory=deque)

    @property
    def is_lossy(self) -> bool:
        """Return whether the subscription is best effort, so that the transport may drop messages."""
        return bool(self.subscription.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT)

    def put(self, number: int, data: bytes) -> bool:
        """Append the message with this number; return whether the queue was full, so that the oldest one is lost."""
        qos = self.subscription.qos_profile
        is_full = qos.history != HistoryPolicy.KEEP_ALL and len(self.queue) >= max(1, qos.depth)
        if is_full:
            self.queue.popleft()
        self.queue.append((number, data))
        return is_full


@attrs.define(eq=False)
class _Hosted:
    node: Any
    busy_ns: int  # until then, its executor runs nothing
    inboxes: dict[Any, _Inbox] = attrs.field(factory=dict)

    @property
    def name(self) -> str:
        """Name of the node; `a new node` while it is being created and has no name yet."""
        return "a new node" if self.node is None else str(self.node.get_name())


@attrs.frozen(order=True)
class _Ready:
    """Callback that can run now.

    The order of these objects is the order of execution. Preferred callbacks come first, then messages in the order of
    their publication, then timers.
    """

    is_not_first: bool
    is_timer: bool
    number: int
    host: int
    source: str = attrs.field(order=False)
    entity: Any = attrs.field(order=False)


@attrs.define
class _Latched:
    """Last messages of a latched topic, kept for subscriptions that are created later.

    Only reliable, latched subscriptions receive them.
    """

    qos: QoSProfile
    type: Any
    kept: deque[tuple[int, bytes]]


class LocalRigWithNodes(LocalRig):
    """Rig in this process that can host ROS nodes.

    It is a `LocalRig` with further methods such as `host` and `listen`. The constructor takes the same arguments. Its
    topics are in the root namespace: scans are on `/daq/scan`.

    Attributes:
        callbacks: log of the hosted nodes, oldest line first. It has callbacks that have run, messages that the nodes
            published or lost, changes of parameters and calls of services. The last `KEPT_CALLBACKS` lines are kept.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._stack = contextlib.ExitStack()
        self._context: Context | None = None
        self._hosted: list[_Hosted] = []
        self._latched: dict[str, _Latched] = {}
        self._collectors: dict[str, Collector] = {}
        self._published: list[tuple[topics.Topic, bytes]] = []  # by the rig since the last delivery
        self._outbox: deque[tuple[int, str, Any, QoSProfile, bytes]] = deque()  # of callbacks that sleep
        self._numbers = 0
        self._monitors: Monitors | None = None
        self._held: dict[str, int] = {}
        self._first: dict[str, int] = {}
        self._duplicates: Counter[str] = Counter()
        self._drops: Counter[str] = Counter()
        self._planned: list[list[Any]] = []  # callbacks left, and what happens then
        self.callbacks: deque[str] = deque(maxlen=KEPT_CALLBACKS)
        super().__init__(*args, **kwargs)

    # The nodes under test

    def host(self, make_node: Callable[..., Any], **kwargs: Any) -> Any:
        """Create a ROS node in this process, and return it.

        The callbacks and the clock of the node follow rig time. In a callback, `time.sleep` returns at once, but later
        messages of the callback are delivered only when this much rig time has passed. Until then the node runs no
        further callback.

        Args:
            make_node: class of the node, or a function that creates it.
            kwargs: arguments of `make_node`.

        Raises:
            ConfigError: a timer of the node does not follow its clock.
            BlockedError: the creation of the node waits or does not return.
        """
        if self._context is None:
            domain_id = self._stack.enter_context(isolated_domain())
            self._context = Context()
            self._context.init(args=["--ros-args", "-p", "use_sim_time:=true"], domain_id=domain_id)
            self._stack.callback(self._context.try_shutdown)
        self._flush()
        hosted = _Hosted(None, self._time_ns)
        self._hosted.append(hosted)
        try:
            with as_default(self._context), self._running(hosted, f"{make_node.__name__}()"):
                hosted.node = make_node(**kwargs)
            if not hosted.node.get_parameter("use_sim_time").value:
                hosted.node.set_parameters([Parameter("use_sim_time", value=True)])
            self._find_entities()
        except BaseException:
            self._hosted.remove(hosted)
            if hosted.node is not None:
                hosted.node.destroy_node()
            raise
        self._stack.callback(hosted.node.destroy_node)
        return hosted.node

    def listen(self, topic: str) -> Collector:
        """Return the collector of the messages that hosted nodes publish on a topic.

        Messages are collected from the first call for the topic on.
        """
        topic = topic.removeprefix("/")
        if topic not in self._collectors:
            self._collectors[topic] = Collector(topics.Topic(topic, "", topics.Qos.DATA, "", "", ()))
        return self._collectors[topic]

    def send(self, topic: str, message: Any, qos: QoSProfile | None = None) -> None:
        """Publish a message to the hosted nodes, not to the rig.

        Without `qos`, the message has the quality of service of commands. The nodes' callbacks for it run in the next
        `step`, or later in the present step if a callback calls `send`.
        """
        self._route(topic, type(message), qos or messages.profile(topics.Qos.EVENT), bytes(serialize_message(message)))

    def send_data(self, topic: str, data: object) -> None:
        """Publish a message with the value `data` in its field `data` to the hosted nodes.

        If `data` is None, the message has its default values. If no hosted node subscribes to the topic, nothing
        happens.
        """
        name = topic.removeprefix("/")
        inboxes = (inbox for hosted in self._hosted for inbox in hosted.inboxes.values() if inbox.topic == name)
        inbox = next(inboxes, None)
        if inbox is not None:
            kind = inbox.subscription.msg_type
            self.send(topic, kind() if data is None else kind(data=data))

    # RigDriver

    def step(self, blocks: int = 1, timeout_s: float = STEP_TIMEOUT_S) -> None:
        """Advance rig time by a number of blocks, and run the callbacks of hosted nodes that are due.

        Callbacks run before and after each block. An exception of a callback ends the call, but blocks that are already
        simulated remain. A callback that does not return raises `BlockedError`. `timeout_s` is ignored.
        """
        if not self._hosted:
            super().step(blocks, timeout_s)
            self._flush()
            return
        for _ in range(blocks):
            self._deliver_messages()  # what was sent since the last block
            super().step(1, timeout_s)
            self._deliver_messages()

    def configure(self, changes: Mapping[str, Any]) -> RigConfig:
        """Change configuration values of the rig by full name, and return the new configuration.

        The values apply from the same scan as in `LocalRig.configure`. Hosted nodes receive the monitor topics
        according to the new configuration.

        Raises:
            ConfigError: a key is unknown, or a value is invalid or fixed at the start; nothing is changed.
        """
        config = super().configure(changes)
        if self._monitors is not None:
            self._monitors = Monitors(config, noise_of(self.core.info()), self._monitors)
        return config

    def save(self, directory: str | Path) -> Path:
        """Write all kept messages of the rig as an MCAP run into a new directory, and return the directory.

        If the rig hosts nodes, the log `callbacks` is written to `callbacks.txt` in this directory.
        """
        directory = super().save(directory)
        if self._hosted:
            (directory / "callbacks.txt").write_text("".join(f"{line}\n" for line in self.callbacks), encoding="utf-8")
        return directory

    def close(self) -> None:
        """Destroy the hosted nodes and end the recording."""
        if not self.closed:
            super().close()
            self._stack.close()

    # Disturbances; the actions of `strategies` call these

    def hold(self, source: str, blocks: int) -> None:
        """Hold back callbacks of hosted nodes for the next `blocks` blocks.

        `source` is a topic without leading slash, `TIMERS` for all timers, or `MESSAGES` for the messages of all
        topics. The messages wait in their queues, and a full queue loses its oldest message. A timer that is due
        meanwhile runs once afterwards.
        """
        self._held[source] = max(self._held.get(source, 0), self._after(blocks))

    def prefer(self, source: str, blocks: int) -> None:
        """Run the callbacks of one source before all others for the next `blocks` blocks.

        `source` is a topic without leading slash, or `TIMERS` for all timers.
        """
        self._first[source] = self._after(blocks)

    def duplicate(self, topic: str, count: int = 1) -> None:
        """Deliver the next `count` messages of a topic twice."""
        self._duplicates[topic] += count

    def drop(self, topic: str, count: int = 1) -> None:
        """Drop the next `count` messages of a topic at best-effort subscriptions.

        Reliable subscriptions still receive these messages.
        """
        self._drops[topic] += count

    def calm(self) -> None:
        """End all disturbances of callbacks and messages.

        The rig advances until no source is held back or preferred. Further duplicates and drops are cancelled. Pending
        actions of `after` run at the end of the call.
        """
        while any(until > self._time_ns for until in (*self._held.values(), *self._first.values())):
            self.step()
        for some in (self._held, self._first, self._duplicates, self._drops):
            some.clear()
        planned, self._planned = self._planned, []
        for _, action in planned:
            action()

    def after(self, callbacks: int, action: Callable[[], object]) -> None:
        """Call `action` after this many further callbacks, counted over all hosted nodes; 0 means now."""
        if callbacks == 0:
            action()
        else:
            self._planned.append([callbacks, action])

    def set_parameter(self, name: str, value: object) -> None:
        """Change a parameter of every hosted node that has it.

        A node that rejects the value keeps its present value. The log `callbacks` has a line for each change, which
        says whether the node rejected it. If no node has the parameter, nothing happens.
        """
        for hosted in self._hosted:
            if hosted.node.has_parameter(name):
                with self._running(hosted, f"the change of {name}"):
                    (result,) = hosted.node.set_parameters([Parameter(name, value=value)])
                self._note(hosted, f"parameter {name} = {value!r}{'' if result.successful else ': rejected'}")

    def call(self, service: str) -> list[Any]:
        """Call a service of the hosted nodes with an empty request; return one response per node that offers it."""
        found = []
        for hosted in self._hosted:
            for one in list(hosted.node.services):
                if hosted.node.resolve_service_name(one.srv_name) == hosted.node.resolve_service_name(service):
                    self._note(hosted, f"service {service}")
                    with self._running(hosted, f"the service {service}"):
                        found.append(one.callback(one.srv_type.Request(), one.srv_type.Response()))
        return found

    # Transport

    @property
    def _time_ns(self) -> int:
        """Time of the hosted nodes' clock [ns]: the end of the rig's newest block."""
        return self._start_ns + self.now_ns

    def _after(self, blocks: int) -> int:
        return self._time_ns + stamp_ns(blocks * self.block_scans, self.rate_hz)

    def _publish(self, topic: str, one: Table | JournalEntry) -> None:
        super()._publish(topic, one)
        described = messages.by_name(topic)
        if self._hosted or described.qos.transient_local:
            data = journal.encode(one) if isinstance(one, JournalEntry) else codec.encode(one)
            self._published.append((described, data))

    def _deliver(self, block: Block) -> None:
        if self._hosted:
            if self._monitors is None:
                self._monitors = Monitors(self.config, noise_of(self.core.info()))
            self._published += self._monitors.messages(block, lambda _: True)
            tables = ((topic, table) for topic, table in block.tables() if topic.name not in self._kept)
            self._published += ((topic, codec.encode(table)) for topic, table in tables)
        super()._deliver(block)

    def _flush(self) -> None:
        """Put new messages into the queues of the subscriptions.

        The messages of the rig come first, and among them the scans last. Then follow messages that a callback
        published after a `time.sleep`, if the rig time of the sleep has passed.
        """
        published, self._published = self._published, []
        for topic, data in sorted(published, key=lambda one: one[0] is topics.SCAN):
            self._route(topic.name, messages.class_of(topic), messages.profile(topic.qos), data)
        while self._outbox and self._outbox[0][0] <= self._time_ns:
            self._publish_output(*self._outbox.popleft()[1:])

    def _route(self, topic: str, kind: Any, qos: QoSProfile, data: bytes) -> None:
        """Put a message into the queues of the hosted nodes' subscriptions to its topic.

        The disturbances of `duplicate` and `drop` are applied here. A message on a latched topic is kept for later
        subscribers.
        """
        topic = topic.removeprefix("/")
        self._numbers += 1
        if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            if topic not in self._latched:
                self._latched[topic] = _Latched(qos, kind, deque(maxlen=max(1, qos.depth)))
            self._latched[topic].kept.append((self._numbers, data))
        if not self._hosted:
            return
        is_doubled, is_dropped = self._duplicates[topic] > 0, self._drops[topic] > 0
        self._duplicates[topic] -= is_doubled
        self._drops[topic] -= is_dropped
        for hosted in self._hosted:
            for inbox in hosted.inboxes.values():
                if inbox.topic != topic or not _match(inbox.subscription, kind, qos):
                    continue
                if is_dropped and inbox.is_lossy:
                    self._note(hosted, f"{topic}: dropped")
                    continue
                for _ in range(1 + is_doubled):
                    if inbox.put(self._numbers, data):
                        self._note(hosted, f"{topic}: lost, the queue is full")

    def _find_entities(self) -> None:
        """Update the known subscriptions of hosted nodes, and reject timers that do not run by rig time.

        A new subscription that is reliable and latched receives the latched messages of its topic.
        """
        for hosted in self._hosted:
            for timer in hosted.node.timers:
                if timer.clock.clock_type != ClockType.ROS_TIME:
                    raise ConfigError(
                        f"the node {hosted.name} has a timer by {timer.clock.clock_type.name}, not by rig time; "
                        "create it with the default clock of create_timer"
                    )
            present = list(hosted.node.subscriptions)
            for gone in set(hosted.inboxes).difference(present):
                del hosted.inboxes[gone]
            for subscription in present:
                if subscription in hosted.inboxes:
                    continue
                inbox = hosted.inboxes[subscription] = _Inbox(subscription, subscription.topic_name.removeprefix("/"))
                latched = self._latched.get(inbox.topic)
                wants = subscription.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL and not inbox.is_lossy
                if latched is not None and wants and _match(subscription, latched.type, latched.qos):
                    for number, data in latched.kept:
                        inbox.put(number, data)

    # Callbacks

    def _deliver_messages(self) -> None:
        """Run every callback of hosted nodes, for messages and timers, that is due at this instant of rig time."""
        now = Clock(clock=messages.time_message(self._time_ns))
        for hosted in self._hosted:
            for inbox in hosted.inboxes.values():
                if inbox.topic == topics.CLOCK.name.removeprefix("/"):
                    inbox.subscription.callback(now)
        for _ in range(MOST_CALLBACKS):
            self._flush()
            self._find_entities()
            ready = min(self._ready(), default=None)
            if ready is None:
                return
            self._run(ready)
        raise AssertionError(
            f"more than {MOST_CALLBACKS} callbacks ran at one instant of rig time: hosted nodes answer each other "
            f"without end, at last {self.callbacks[-1]!r}; end this exchange of messages"
        )

    def _ready(self) -> Iterator[_Ready]:
        now = self._time_ns
        held = {source for source, until in self._held.items() if until > now}
        first = {source for source, until in self._first.items() if until > now}
        for number, hosted in enumerate(self._hosted):
            if hosted.busy_ns > now:
                continue
            for inbox in hosted.inboxes.values():
                if inbox.queue and not held & {inbox.topic, MESSAGES}:
                    yield _Ready(inbox.topic not in first, False, inbox.queue[0][0], number, inbox.topic, inbox)
            if TIMERS in held:
                continue
            for index, timer in enumerate(hosted.node.timers):
                if timer.is_ready():
                    yield _Ready(TIMERS not in first, True, index, number, TIMERS, timer)

    def _run(self, ready: _Ready) -> None:
        hosted = self._hosted[ready.host]
        for planned in self._planned:
            planned[0] -= 1
        if ready.is_timer:
            self._note(hosted, f"timer of {ready.entity.timer_period_ns / NS_PER_S:g} s")
            self._call(hosted, "its timer", call_timer, ready.entity)
        else:
            number, data = ready.entity.queue.popleft()
            subscription = ready.entity.subscription
            message = data if subscription.raw else deserialize_message(data, subscription.msg_type)
            stamp = messages.header_stamp_ns(message) if hasattr(message, "header") else None
            self._note(hosted, f"{ready.source} {number if stamp is None else f'{stamp / NS_PER_S:.9f}'}")
            info = {
                "source_timestamp": self._time_ns,
                "received_timestamp": self._time_ns,
                "publication_sequence_number": number,
                "reception_sequence_number": number,
            }
            self._call(hosted, f"its callback for {ready.source}", call_subscription, subscription, (message, info))
        due = [action for left, action in self._planned if left <= 0]
        self._planned = [planned for planned in self._planned if planned[0] > 0]
        for action in due:
            action()

    def _call(self, hosted: _Hosted, what: str, callback: Callable[..., Any], *args: Any) -> None:
        """Run a callback of a hosted node, with the name `what` in error messages.

        If the callback waits or does not return, `BlockedError` is raised. A coroutine must reach its end without
        waiting.
        """
        with self._running(hosted, what):
            result = callback(*args)
            if not inspect.iscoroutine(result):
                return
            with contextlib.closing(result), contextlib.suppress(StopIteration):
                result.send(None)
                raise BlockedError(
                    f"{hosted.name} blocks: {what} waits at an `await` for a result that only another callback can "
                    "give, and this schedule, unlike rclpy, does not resume it; process the result in that callback"
                )

    @contextlib.contextmanager
    def _running(self, hosted: _Hosted, what: str) -> Iterator[None]:
        """Provide the context in which code of a hosted node runs.

        In it, `time.sleep` returns at once, and delays later messages of the code by the requested rig time. If the
        code waits for anything else, or does not return, `BlockedError` is raised. `what` is the name of the code in
        the error message.
        """

        def publish(publisher: Any, message: Any) -> None:
            topic = publisher.topic_name
            if topic not in INTERNAL:
                data = message if isinstance(message, bytes) else bytes(serialize_message(message))
                self._note(hosted, f"publishes {topic.removeprefix('/')} {_digest(message)}")
                sent = topic, publisher.msg_type, publisher.qos_profile, data
                if hosted.busy_ns > self._time_ns:
                    self._outbox.append((hosted.busy_ns, *sent))
                else:
                    self._publish_output(*sent)

        def sleep(seconds: float) -> None:
            hosted.busy_ns = max(hosted.busy_ns, self._time_ns) + round(seconds * NS_PER_S)

        def sleep_until(clock: Any, until: Any, context: Any = None) -> bool:  # noqa: ARG001  # as in rclpy
            sleep(max(0, until.nanoseconds - clock.now().nanoseconds) / NS_PER_S)
            return True

        with contextlib.ExitStack() as stack:
            for place, name, value in (
                (rclpy.publisher.Publisher, "publish", publish),
                (time, "sleep", sleep),
                (rclpy.clock.Clock, "sleep_until", sleep_until),
            ):
                stack.callback(setattr, place, name, getattr(place, name))
                setattr(place, name, value)
            stack.enter_context(_returning(f"{hosted.name} blocks: {what}"))
            yield

    def _publish_output(self, topic: str, kind: Any, qos: QoSProfile, data: bytes) -> None:
        """Deliver a message of a hosted node to collectors, to the rig and to the nodes' queues.

        The rig gets only commands and drive samples. A message that the rig rejects has no effect on it.
        """
        relative = topic.removeprefix("/")
        message = deserialize_message(data, kind)
        if relative in self._collectors:
            self._collectors[relative].take(message, {"publication_sequence_number": self._numbers})
        with contextlib.suppress(CommandError):
            if relative == topics.FREQUENCY.name:
                self.command(frequency_hz=message.data)
            elif relative == topics.CURRENT.name:
                self.command(current_a=message.data)
            elif relative == topics.WAVEFORM.name and self.core.takes_samples:
                table = codec.decode(data, topics.WAVEFORM)
                self.feed(first_scan_at(table.stamp_ns, self.stream_rate_hz, self._start_ns), table.rows["value"])
        self._route(relative, kind, qos, data)

    def _note(self, hosted: _Hosted, text: str) -> None:
        self.callbacks.append(f"{self._time_ns / NS_PER_S:.9f} {hosted.name}: {text}")


def _match(subscription: Any, kind: Any, qos: QoSProfile) -> bool:
    """Return whether a publisher of this type and quality of service reaches a subscription."""
    compatible, _ = qos_check_compatible(qos, subscription.qos_profile)
    return subscription.msg_type is kind and compatible != QoSCompatibility.ERROR


def _digest(message: Any) -> str:
    """Return a message as a short text for `callbacks`, which differs for different messages."""
    text = repr(message)
    return text if len(text) <= 120 else f"{text[:60]}... sha256 {hashlib.sha256(text.encode()).hexdigest()[:16]}"


@contextlib.contextmanager
def _returning(message: str) -> Iterator[None]:
    """Raise `BlockedError` in the `with` block if its code waits or runs for too long.

    The error text begins with `message`. The check works in the main thread only.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    begin, used, idle = time.monotonic(), time.thread_time(), 0

    def watch(*_: object) -> None:
        nonlocal used, idle
        before, used = used, time.thread_time()
        idle = idle + 1 if used - before < IDLE_CPU_S else 0
        if idle * TICK_S >= IDLE_S:
            raise BlockedError(
                f"{message} waits: {IDLE_S:g} s without computing, while no other callback can run in this test; do "
                "not wait in a callback, process the result in the callback that receives it"
            )
        if time.monotonic() - begin > BUSY_S:
            raise BlockedError(f"{message} has not returned within {BUSY_S:g} s of wall time; let it compute less")

    handler = signal.signal(signal.SIGALRM, watch)
    left_s, period_s = signal.setitimer(signal.ITIMER_REAL, TICK_S, TICK_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, handler)
        if left_s:
            signal.setitimer(signal.ITIMER_REAL, max(left_s - (time.monotonic() - begin), 1e-3), period_s)
