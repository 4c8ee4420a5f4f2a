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
"""ROS client of a rig and its nodes: it waits for conditions, sends commands, sets parameters and collects topics.

The client runs its callbacks (spins) in the caller's thread, and only while it waits. It starts no thread and never
sleeps for a fixed time. Every wait has a deadline and an error message that names what was awaited. If node processes
are given (`processes`), a wait also ends when one of them ends; the error then quotes the last lines of its log.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar  # rclpy handles; message classes have no common base

import attrs
import numpy as np
import rclpy.utilities
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64, Header, String
from std_srvs.srv import SetBool, Trigger

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.client.processes import ParameterValue, Processes, domain_of_environment
from impact_rig.client.service_call import ServiceCall
from impact_rig.errors import CodecError, CommandError, ConfigError, GoneError, ImpactRigError
from impact_rig.nodes import messages
from impact_rig.nodes.managed import DIAGNOSTICS_PERIOD_S, with_info
from impact_rig.nodes.messages import Template, by_name, header_stamp_ns
from impact_rig.nodes.process import make_executor, patient_threads
from impact_rig.rig.journal import JournalEntry
from impact_rig.simtime import NS_PER_S
from impact_rig.system.endings import defer_signals
from impact_rig.topics import Topic


@attrs.frozen(eq=False)
class Received:
    """Message that a `Collector` has received and kept.

    Attributes:
        data: the message, or its CDR bytes on a topic with tables.
        sequence: DDS publication sequence number; each publisher numbers its messages without gaps.
        received_system_ns: system time at which the callback ran [ns since 1970]; comparable with stamps of a rig in
            real time.
        table: decoded table; None on a topic without tables, and for a message of `Client.listen`.
    """

    data: Any
    sequence: int
    received_system_ns: int
    table: Table | None = None


class Collector:
    """Store of the messages received on one topic, without limit, until `clear`.

    A message that is not a valid table of the topic is dropped and counted in `refused`. A collector of `Client.listen`
    keeps such messages.

    Args:
        topic: the topic.
        on_message: called with each message that is kept, as `Received`.
    """

    def __init__(self, topic: Topic, on_message: Callable[[Received], None] | None = None) -> None:
        self.topic = topic
        self.received: list[Received] = []
        self.refused = 0  # number of invalid messages
        self.last_refused = ""  # reason why the last of them is invalid
        self._on_message = [on_message] if on_message is not None else []

    def __len__(self) -> int:
        return len(self.received)

    def take(self, data: Any, info: dict[str, Any]) -> None:
        """Keep one received message with its decoded table; drop an invalid table and count it in `refused`."""
        table = None
        if self.topic.columns is not None:
            try:
                table = codec.decode(data, self.topic)
            except CodecError as error:
                self.refused, self.last_refused = self.refused + 1, str(error)
                return
        message = Received(data, int(info["publication_sequence_number"]), time.time_ns(), table)
        self.received.append(message)
        for on_message in self._on_message:
            on_message(message)

    def then(self, on_message: Callable[[Received], None]) -> None:
        """Register a further function that is called with each message kept from now on, as `Received`."""
        self._on_message.append(on_message)

    @property
    def messages(self) -> list[Any]:
        """Messages kept since the start or `clear`, oldest first; on a topic with tables, as CDR (serialised) bytes."""
        return [message.data for message in self.received]

    def tables(self, since: int = 0) -> list[Table]:
        """Return the tables kept since the start or `clear`, oldest first, without the first `since` of them.

        The topic must carry tables.
        """
        return [message.table or codec.decode(message.data) for message in self.received[since:]]

    def last(self) -> Table | None:
        """Return the newest table received since the start or `clear`, or None if there is none."""
        found = self.tables(-1)
        return found[0] if found else None

    def entries(self, since: int = 0) -> list[JournalEntry]:
        """Return the journal entries kept from `rig/journal`, oldest first, without the first `since` of them."""
        return [JournalEntry.from_line(message.data.data) for message in self.received[since:]]

    def rows(self) -> NDArray[np.void]:
        """Return the rows of all kept tables, joined to one array of shape (n,).

        If no table is kept, the array is empty. A collector of `Client.listen` then raises an AssertionError instead,
        because it does not know the columns.
        """
        parts = [table.rows for table in self.tables()]
        assert parts or self.topic.columns is not None, (
            f"{self.topic.name}: no table received: check that this topic carries tables, and wait for one"
        )
        return np.concatenate(parts) if parts else np.empty(0, self.topic.columns)

    def lost(self) -> int:
        """Return the number of messages missing between the first and the last one kept, by DDS sequence number.

        It is meaningful for a topic with one publisher. Invalid messages, which are dropped, count as missing.
        """
        numbers = [message.sequence for message in self.received]
        return int(numbers[-1] - numbers[0] + 1 - len(set(numbers))) if numbers else 0

    def clear(self) -> None:
        """Drop the messages kept in this collector; `refused` stays unchanged."""
        self.received.clear()


SPIN_S = 0.1
GONE_S = 2 * DIAGNOSTICS_PERIOD_S  # every rig reports in any state, so one that is silent for longer is gone
DELIVERY_S = 0.05  # messages that arrived while the executor was not spinning are delivered within this time
HISTORY_S = 1.0  # a client that has just discovered a rig receives its latched messages within this time


class WaitTimeoutError(ImpactRigError, TimeoutError):
    """Timeout of a wait: the condition did not become true in time; also a `TimeoutError`.

    The message names what was awaited.
    """


Check = Callable[[], None]  # raises an error if the wait has become pointless


def patiently() -> None:
    """Do nothing. This is the default `Check` of a wait, which never ends the wait early."""


class RigGoneError(GoneError):
    """Loss of the rig that a client waits for: the rig ended, was replaced, or no longer reports its state."""


class AddressedActivation:
    """Record of which activation of a rig a client addresses.

    Each activation of a rig reports its own identifier (`instance`) in diagnostics. Call `given` before you wait for
    the effect of a command. The returned check raises a `RigGoneError` if another activation has replaced the one that
    received the command. It also raises if the rig, after its first report, is silent for two seconds.

    Args:
        clock: monotonic clock [s].
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._instance = self._first = ""
        self._reported_at = self._changed_at = -math.inf
        self._previous = ""
        self._is_there = self._is_gone = False

    @property
    def is_overdue(self) -> bool:
        """Return whether no report has arrived for over a second; False before any report or call of `changed`."""
        return self._is_there and self._clock() - self._reported_at > DIAGNOSTICS_PERIOD_S

    @property
    def _is_changing(self) -> bool:
        """Return whether `changed` was called so recently that diagnostics of the previous rig may still arrive."""
        return self._clock() - self._changed_at <= DELIVERY_S

    def heard(self, instance: str) -> None:
        """Register that a rig has just reported its state, with the identifier of its activation.

        A late report of the previous activation, up to 50 ms after `changed`, does not count as a new activation.
        """
        self._identify()
        self._reported_at = self._clock()
        self._is_there, self._is_gone = True, False
        if instance != self._previous or not self._is_changing:
            self._instance = instance
            self._first = self._first or instance

    def changed(self) -> None:
        """Register that a new activation may have started, as after a transition.

        Later waits concern the activation that reports next.
        """
        self._previous, self._instance, self._changed_at = self._instance or self._previous, "", self._clock()
        self._first = ""
        self._is_there, self._is_gone = True, False

    def _identify(self) -> None:
        """Address the previous activation again if only that activation has reported since `changed`."""
        if not self._first and not self._is_changing and self._reported_at >= self._changed_at:
            self._instance = self._first = self._previous

    def given(self, what: str, silence_s: float = GONE_S) -> Check:
        """Return a check that raises `RigGoneError` once the activation that is addressed now is over.

        The activation is over if another activation has reported, or if no report arrives for `silence_s` seconds.
        Before any report, the check addresses the first activation that reports, and silence counts only after a call
        of `changed`.

        Args:
            what: what the rig was asked to do, for the message.
            silence_s: time without a report after which the rig counts as gone [s].
        """
        self._identify()
        instance, since = self._instance, self._clock()

        def check() -> None:
            nonlocal instance
            self._identify()
            instance = instance or self._first
            if instance != self._instance:
                raise RigGoneError(
                    f"{what}: the rig has ended or was activated again: repeat the call to address the present one"
                )
            now = self._clock()
            self._is_gone |= self._is_there and now - max(self._reported_at, since) > silence_s
            if self._is_gone:
                quiet_s = now - (self._reported_at if math.isfinite(self._reported_at) else since)
                raise RigGoneError(
                    f"{what}: the rig is gone: no report from it for {quiet_s:.1f} s; start a rig and repeat the call"
                )

        return check


class Spinner:
    """Runner of an executor's callbacks in the caller's thread, with a clock for the time limits of waits."""

    def __init__(self, executor: Any) -> None:
        self._executor = executor
        self._working_s = 0.0

    def waited_s(self) -> float:
        """Return the time [s] of a monotonic clock that stops during long callbacks.

        In each call of `spin`, the clock advances by at most `longest_s` seconds.
        """
        return time.monotonic() - self._working_s

    def spin(self, longest_s: float = SPIN_S) -> None:
        """Run the next callback of the executor; if none is due, wait for one for at most `longest_s` seconds."""
        began = time.monotonic()
        self._executor.spin_once(timeout_sec=longest_s)
        self._working_s += max(0.0, time.monotonic() - began - longest_s)


T = TypeVar("T")

DEFAULT_TIMEOUT_S = 10.0  # discovery takes 0.2 to 2 s; a node may load compiled code in its first seconds
START_TIMEOUT_S = 240.0  # without the library of kernels, the first start of a node compiles the physics
LIFECYCLE = (ChangeState, GetState)  # services that start and stop rigs; the answer may take minutes
RIG = "simulation"  # component in the diagnostics of a rig


TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "cleanup": Transition.TRANSITION_CLEANUP,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "shutdown_unconfigured": Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
    "shutdown_inactive": Transition.TRANSITION_INACTIVE_SHUTDOWN,
    "shutdown_active": Transition.TRANSITION_ACTIVE_SHUTDOWN,
}
"""Numbers of the lifecycle transitions in `lifecycle_msgs`, by the name that `Client.change_state` accepts."""


class ServiceFailedError(ImpactRigError, RuntimeError):
    """Negative answer of a service; the message has the name of the service or node, and its reason."""


class Client:
    """ROS node that acts as the user of a rig: it commands, calls services, sets parameters and receives topics.

    It receives messages only while it waits. Every wait has a time limit. A wait also ends with a `GoneError` if a
    watched node process ends. `Client(namespace="/rig")` connects to a rig that runs elsewhere in this ROS domain. Used
    as a context manager, it calls `close` at the end. It needs ROS 2.

    Args:
        domain_id: ROS domain of the rig; None means the value of `ROS_DOMAIN_ID`.
        namespace: namespace of the rig's nodes; topics and node names below are relative to it.
        processes: node processes to watch during every wait.
        name: name of this node, also in the acknowledgements that it sends.
        commands: whether `command` will be called; the client then keeps all changes of the drive that the rig applies.

    Attributes:
        node: the `rclpy` node.
        applied: changes of the drive that the rig has applied, if `commands` is true.
        diagnostics: latest diagnostics of each node, by name.
        reported_ns: stamp of the latest diagnostics of each node, by name [ns]; for a rig, the stamp of its next block.

    Examples:
        >>> import impact_rig
        >>> with impact_rig.RosRig(hosted=True) as rig:
        ...     client = rig.client
        ...     print(client.state("rig"), client.get_parameters("rig", ["barriers.gap_m"]))
        ...     print(client.command(frequency_hz=9.1, current_a=0.52)["frequency"])
        active {'barriers.gap_m': 0.006}
        9.1

    See Also:
        - `RosRig`: starts a rig, and drives it with the calls of `LocalRig`.
        - docs/reference/interface.md: topics, services and parameters of the nodes.
    """

    def __init__(
        self,
        domain_id: int | None = None,
        namespace: str = "",
        processes: Processes | None = None,
        name: str = "client",
        *,
        commands: bool = True,
    ) -> None:
        self._processes = processes
        self.name = name
        self.context = Context()
        self.domain_id = domain_of_environment() if domain_id is None else domain_id
        self.context.init(args=[], domain_id=self.domain_id)
        self.executor = make_executor(self.context)
        with patient_threads():
            self.node: Node = Node(
                name, namespace=namespace, context=self.context, use_global_arguments=False, enable_rosout=False
            )
        self.executor.add_node(self.node)
        self.diagnostics: dict[str, DiagnosticStatus] = {}
        """Latest diagnostics of each node, by name relative to the client's namespace, or by full name outside it."""
        self.reported_ns: dict[str, int] = {}
        self._hosted: list[Any] = []
        self._spinner = Spinner(self.executor)
        self._rigs: dict[str, AddressedActivation] = {}
        self._publishers: dict[str, Any] = {}
        self._acknowledgements: dict[str, Template] = {}
        self._matched: set[Any] = set()
        self._knows_past = False  # whether all commands applied before this client started have arrived
        self._clients: dict[tuple[str, Any], Any] = {}
        self.subscribe(topics.DIAGNOSTICS, self._on_diagnostics)
        self.applied: Collector = Collector(topics.APPLIED)
        """Changes of the drive that the rig has applied (`shaker/applied`); it stays empty without `commands`."""
        self._has_commands = commands
        if commands:
            self.subscribe(topics.APPLIED, self.applied.take, raw=True)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the nodes that this client hosts, and destroy its own node, executor and ROS context.

        The watched node processes continue.
        """
        with defer_signals():
            for node in self._hosted:  # nodes of this package finish their work while the executor still runs
                if hasattr(node, "close"):
                    node.close()
            self.executor.shutdown()
            for node in (*self._hosted, self.node):
                node.destroy_node()
            self.context.try_shutdown()

    # Waiting

    def wait_until(
        self,
        condition: Callable[[], T | None],
        what: str,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        check: Check = patiently,
    ) -> T:
        """Run callbacks until a condition is true.

        Args:
            condition: function without arguments, called before each callback.
            what: what is awaited, for the error message.
            timeout_s: longest wait [s]; the time of a callback beyond 0.1 s does not count.
            check: called before each callback; raises an error if the wait has become pointless, see `given`.

        Returns:
            The first value of the condition that counts as true.

        Raises:
            TimeoutError: the condition did not become true in time.
            GoneError: a watched process ended, or `check` raised it.
        """
        deadline = self._spinner.waited_s() + timeout_s
        while not (found := condition()):
            if self._processes is not None:
                self._processes.check()
            check()
            if self._spinner.waited_s() > deadline:
                raise WaitTimeoutError(f"timeout after {timeout_s:g} s: waiting for {what}{self._troubles()}")
            self._spinner.spin()
        return found

    def given(self, what: str, rig: str = "rig", *, may_be_silent: bool = False) -> Check:
        """Return a check for `wait_until` that raises a `GoneError` once the rig that runs now is gone or replaced.

        Args:
            what: what the rig was asked to do, for the message.
            rig: node name of the rig, relative to the namespace.
            may_be_silent: whether the rig may send no report during the wait, for example while it compiles a contact
                law. The check then raises only if another rig has reported.

        Raises:
            GoneError: the rig was silent for over a second before this call, and is gone or has been replaced.
        """
        activation = self._rigs.setdefault(rig, AddressedActivation(self._spinner.waited_s))
        check = activation.given(what, math.inf) if may_be_silent else activation.given(what)
        if activation.is_overdue:  # no callback has run for a while: another rig may have started meanwhile
            deadline = time.monotonic() + DELIVERY_S
            while activation.is_overdue and time.monotonic() < deadline:
                self._spinner.spin(DELIVERY_S)
            check()
        return check

    def spin_pending(self) -> None:
        """Run the callbacks of all messages and answers that have arrived, without waiting for more."""
        last = self.executor.create_task(lambda: None)  # tasks and messages run in the order in which they arrived
        while not last.done():
            self._spinner.spin(0.0)

    def spin_for(self, duration_s: float) -> None:
        """Run callbacks for a duration of wall time.

        Meant for benchmarks and demonstrations; tests wait for a condition.

        Args:
            duration_s: duration [s].
        """
        deadline = time.monotonic() + duration_s
        while (left := deadline - time.monotonic()) > 0:
            if self._processes is not None:
                self._processes.check()
            self._spinner.spin(min(left, SPIN_S))

    def wait_active(self, *nodes: str, timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait until nodes are in the lifecycle state `active`.

        Args:
            nodes: node names, relative to the namespace.
            timeout_s: time limit for each node [s], by default 240: a rig may have to compile its physics.

        Raises:
            TimeoutError: a node was not active in time.
            ImpactRigError: a node reports that it cannot be configured; the message says why.
        """
        for node in nodes:
            is_active = functools.partial(self._is_active, node, timeout_s)
            self.wait_until(is_active, f"{node} to be active", timeout_s)
            self._address(node)

    def _address(self, node: str) -> None:
        """Register that a lifecycle transition of a rig has ended, so that the next activation is addressed.

        The call ignores a node that is not known as a rig.
        """
        if node in self._rigs:
            received = self.executor.create_task(lambda: None)  # runs after everything received so far
            self.wait_until(received.done, "the executor")
            self._rigs[node].changed()
            self._matched.clear()

    def host(self, make_node: Callable[..., Any], **kwargs: Any) -> Any:
        """Create a node in this process, and run it in this client's executor.

        The node works only while the client waits. If `make_node` accepts `**kwargs`, it gets this client's ROS context
        and namespace as arguments. Otherwise, the client makes its context rclpy's default context during the call, and
        the node has no namespace.

        Args:
            make_node: class or function that creates the node.
            kwargs: arguments of `make_node`.

        Returns:
            The node.
        """
        if any(one.kind is one.VAR_KEYWORD for one in inspect.signature(make_node).parameters.values()):
            namespace = self.node.get_namespace()
            kwargs |= {"context": self.context, "namespace": namespace, "use_global_arguments": False}
        with as_default(self.context):
            node = make_node(**kwargs)
        self._hosted.append(node)
        self.executor.add_node(node)
        return node

    def evict(self, node: Any) -> None:
        """Remove a node that this client hosts from the client's executor, and destroy it.

        Args:
            node: a node from `host`.
        """
        self._hosted.remove(node)
        self.executor.remove_node(node)
        node.destroy_node()

    def acknowledge_callbacks(self, node: Any) -> int:
        """Make the client acknowledge each block of daq/scan for a hosted node, after the node's callback.

        The node itself needs no knowledge of daq/ack. If the node has several subscriptions to daq/scan, the first
        callback already acknowledges the block.

        Args:
            node: a node from `host`.

        Returns:
            Number of the node's present subscriptions to daq/scan; later subscriptions are not acknowledged.
        """
        name = self.node.resolve_topic_name(topics.SCAN.name)
        found = [subscription for subscription in node.subscriptions if subscription.topic_name == name]
        acknowledge = functools.partial(self.acknowledge_for, node.get_name())
        for subscription in found:
            subscription.callback = _then(subscription.callback, acknowledge)
        return len(found)

    # Commands

    def command(
        self, frequency_hz: float | None = None, current_a: float | None = None, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> np.void:
        """Command the drive, and wait until the rig has applied the command.

        Args:
            frequency_hz: new frequency [Hz]; None leaves it unchanged, but then `current_a` must be given.
            current_a: new amplitude, peak, or rms for a random drive; in A, m or V by `drive.kind`. None leaves it
                unchanged.
            timeout_s: time limit for each step of the exchange with the rig [s].

        Returns:
            Row of shaker/applied for the command; if both values are given, the row for the current. Its `sample` is
            the number of the first scan that the command acts on.

        Raises:
            CommandError: both values are None, or the rig rejected the command, for example because it is not active;
                then the message is that of the rig. If it rejected only the current, the new frequency stays applied.
            TimeoutError: the rig neither applied nor rejected it in time.
            GoneError: the rig that received it is gone.
            ValueError: the client was made with `commands=False`.
        """
        if not self._has_commands:
            raise ValueError("a client made with commands=False cannot command the drive: omit commands=False")
        row: np.void | None = None
        for topic, column, value in (
            (topics.FREQUENCY, "frequency", frequency_hz),
            (topics.CURRENT, "current", current_a),
        ):
            if value is None:
                continue
            check = self.given(f"command {topic.name} = {value:g}")
            self._reach(self.publisher(topic), topic, timeout_s, "rig", check)
            self.wait_until(lambda: self.figures("rig"), "the rig's diagnostics", timeout_s, check)  # count rejections
            self._receive_applied()
            before = len(self.applied)
            self.publish(topic, Float64(data=value), timeout_s, "rig", check)
            accepted = functools.partial(self._accepted, before, column, value, self.refusal(topic.name, "inactive"))
            what = f"the rig to apply the command {topic.name} = {value:g}"
            row = self.wait_until(accepted, what, timeout_s, check).rows[-1]
        if row is None:
            raise CommandError("a command needs a frequency, a current, or both")
        return row

    def refusal(self, *reasons: str) -> Callable[[], str]:
        """Return a function that returns the rig's message once the rig has rejected an input, and "" before.

        Only rejections after this call count. The rig reports them in its diagnostics without naming the sender, so
        rejected inputs of other senders count, too.

        Args:
            reasons: keys under which the rig counts the rejections of interest: the name of a topic, or `inactive`.
        """

        def rejections() -> dict[str, tuple[str, str]] | None:
            figures = self.figures("rig")
            names = [f"refused.{reason}" for reason in reasons]
            return {name: (figures.get(name, ""), figures.get(f"last_{name}", "")) for name in names if figures} or None

        before = rejections()

        def message() -> str:
            nonlocal before
            now = rejections()
            before = before or now  # a rig without an earlier report may have rejected something before
            return next((now[name][1] for name in now if now[name] != before[name]), "") if now and before else ""

        return message

    def publish(
        self,
        topic: topics.Topic,
        message: Any,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        listener: str | None = None,
        check: Check = patiently,
    ) -> None:
        """Publish a message as soon as the publisher is connected with all subscribers that the ROS graph lists.

        There must be at least one subscriber. Later calls for the same topic publish at once, until this client has
        changed the state of the rig.

        Args:
            topic: entry of `impact_rig.topics`.
            message: the message, or its CDR bytes.
            timeout_s: longest wait for the subscribers [s].
            listener: name of a node that must be among the subscribers; None for any.
            check: raises an error if the wait has become pointless, see `given`.

        Raises:
            TimeoutError: no such subscriber was connected in time; nothing is published.
        """
        publisher = self.publisher(topic)
        self._reach(publisher, topic, timeout_s, listener, check)
        publisher.publish(message)

    def note(self, text: str) -> None:
        """Publish an operator's remark on `notes`, which is recorded with the run.

        Args:
            text: the remark.

        Raises:
            TimeoutError: no node, such as a recorder, subscribed to `notes` within 10 s.
        """
        self.publish(topics.NOTES, String(data=text))

    def step(self, blocks: int | None = None, timeout_s: float = START_TIMEOUT_S) -> str:
        """Advance a rig by one step; the rig must be in lockstep or paused.

        The call returns when the blocks of the step are published and every peer has acknowledged them.

        Args:
            blocks: number of blocks of a step: the rig's parameter `step.blocks` is set to it, for later steps, too.
                None leaves the parameter unchanged.
            timeout_s: time limit for the service to appear, and again for its answer [s], by default 240: the first
                step may have to compile the physics.

        Returns:
            The message in the rig's answer.

        Raises:
            ImpactRigError: the rig is neither in lockstep nor paused, or `blocks` is out of range. The step may also
                end with an error after some of its blocks: a peer does not acknowledge, samples of the drive are
                missing, or the rig was reset, deactivated or resumed. The message says which.
            TimeoutError: the rig did not answer in time.
            GoneError: the rig is gone.
        """
        if blocks is not None:
            self.set_parameters("rig", {"step.blocks": blocks})
        return self.trigger("rig/step", timeout_s)

    def pause(self, paused: bool = True) -> None:
        """Pause the rig, or resume it.

        A pause returns when every peer has acknowledged all published blocks. It does not wait for a silent peer, which
        has acknowledged nothing for `time.peer_timeout_s`.

        Args:
            paused: whether to pause; False resumes.

        Raises:
            ImpactRigError: the rig did not pause or resume; the message says why.
            TimeoutError: the rig did not answer within 10 s.
            GoneError: the rig is gone.
        """
        _succeeded("rig/pause", self.call(SetBool, "rig/pause", SetBool.Request(data=paused), repeatable=True))

    def trigger(self, name: str, timeout_s: float = DEFAULT_TIMEOUT_S, *, may_be_silent: bool = False) -> str:
        """Call a service of type Trigger, such as `rig/reset` or `recorder/start`; see `call`.

        Args:
            name: service name, relative to the namespace.
            timeout_s: time limit for the service to appear, and again for its answer [s].
            may_be_silent: whether to continue to wait even if the rig does not report its state for seconds.

        Returns:
            The message of the service.

        Raises:
            ImpactRigError: the service answered `success = False`; the message has its name and its reason.
            TimeoutError: the service did not appear or did not answer in time.
            GoneError: the rig that offers the service is gone.
        """
        return _succeeded(name, self.call(Trigger, name, Trigger.Request(), timeout_s, may_be_silent=may_be_silent))

    def call(
        self,
        service_type: Any,
        name: str,
        request: Any,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        repeatable: bool = False,
        may_be_silent: bool = False,
    ) -> Any:
        """Call a service of any type.

        Args:
            service_type: class of the service.
            name: service name, relative to the namespace.
            request: the request.
            timeout_s: time limit for the service to appear, and again for its answer [s].
            repeatable: whether to send the request again every 2 s until the answer arrives; always so for services
                that get or set parameters, or get a lifecycle state.
            may_be_silent: whether to continue to wait even if the rig does not report its state for seconds.

        Returns:
            The response of the service.

        Raises:
            TimeoutError: the service did not appear or did not answer in time.
            GoneError: the rig that offers the service is gone.
        """
        node = name.rpartition("/")[0]
        check = patiently
        if node in self._rigs and service_type not in LIFECYCLE:
            may_be_silent |= service_type is SetParametersAtomically  # may compile a law
            check = self.given(name, node, may_be_silent=may_be_silent)
        client = self.prepare(service_type, name)
        self.wait_until(client.service_is_ready, f"service {name}", timeout_s, check)
        with ServiceCall(client, request, repeatable=repeatable) as call:
            return self.wait_until(call.response, f"an answer of {name}", timeout_s, check)

    def prepare(self, service_type: Any, name: str) -> Any:
        """Return the rclpy client of a service, created at the first call.

        If you call it early, ROS discovers the service before the first request.

        Args:
            service_type: class of the service.
            name: service name, relative to the namespace.
        """
        client = self._clients.get((name, service_type))
        if client is None:
            client = self._clients[name, service_type] = self.node.create_client(service_type, name)
        return client

    # Parameters and lifecycle

    def set_parameters(self, node: str, values: Mapping[str, ParameterValue]) -> None:
        """Set parameters of a node: all of them, or none if one is rejected.

        Args:
            node: node name.
            values: new values by name.

        Raises:
            ConfigError: the node rejected the parameters; the message is its reason.
            TimeoutError: the node did not answer in time.
        """
        request = SetParametersAtomically.Request(
            parameters=[parameter.to_parameter_msg() for parameter in ros_parameters(values)]
        )
        name = f"{node}/set_parameters_atomically"
        result = self.call(SetParametersAtomically, name, request).result
        if not result.successful:
            raise ConfigError(result.reason)

    def get_parameters(self, node: str, names: Sequence[str]) -> dict[str, Any]:
        """Return the present values of a node's parameters.

        Args:
            node: node name.
            names: names of the parameters.

        Returns:
            Values by name.

        Raises:
            ConfigError: the node lacks at least one of these parameters; ROS 2 does not report which.
            TimeoutError: the node did not answer in time.
        """
        request = GetParameters.Request(names=list(names))
        response = self.call(GetParameters, f"{node}/get_parameters", request)
        if len(response.values) != len(names):  # ROS then answers without any value
            raise ConfigError(
                f"node {node} lacks at least one of the parameters {', '.join(names)}, ROS 2 does not report which: "
                "correct the names, or start the node from the version of this program"
            )
        return {name: parameter_value_to_python(value) for name, value in zip(names, response.values, strict=True)}

    def state(self, node: str, timeout_s: float = DEFAULT_TIMEOUT_S) -> str:
        """Return the label of a node's lifecycle state, such as `active`.

        Args:
            node: node name.
            timeout_s: time limit for the service to appear, and again for its answer [s].

        Raises:
            TimeoutError: the node did not answer in time.
        """
        response = self.call(GetState, f"{node}/get_state", GetState.Request(), timeout_s)
        return str(response.current_state.label)

    def change_state(self, node: str, transition: str, timeout_s: float = START_TIMEOUT_S) -> bool:
        """Request a lifecycle transition of a node.

        Args:
            node: node name.
            transition: `configure`, `activate`, `deactivate`, `cleanup`, or a `shutdown_...` of `TRANSITIONS`.
            timeout_s: time limit for the service to appear, and again for its answer [s], by default 240: a rig may
                have to compile its physics.

        Returns:
            Whether the transition succeeded.

        Raises:
            KeyError: `transition` is unknown.
            TimeoutError: the node did not answer in time.
        """
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[transition]))
        changed = bool(self.call(ChangeState, f"{node}/change_state", request, timeout_s).success)
        self._address(node)
        return changed

    def status(self, node: str) -> DiagnosticStatus:
        """Return a node's latest diagnostics, a `diagnostic_msgs/DiagnosticStatus`; an empty one if none has arrived.

        Args:
            node: node name.
        """
        return self.diagnostics.get(node, DiagnosticStatus(name=node))

    def figures(self, node: str) -> dict[str, str]:
        """Return the key-value pairs of a node's latest diagnostics; empty if none has arrived.

        Args:
            node: node name.
        """
        return {value.key: value.value for value in self.status(node).values}

    # Topics

    def collect(self, name: str, acknowledge: bool = False, timeout_s: float = DEFAULT_TIMEOUT_S) -> Collector:
        """Subscribe to a topic of this package and keep all messages; return once a publisher is connected.

        Args:
            name: topic name as in docs/reference/interface.md, such as `daq/scan`.
            acknowledge: whether to acknowledge every valid message on daq/ack; necessary for daq/scan if this client is
                a peer of the rig, listed in its parameter `time.peers`.
            timeout_s: time limit for the publisher to appear [s].

        Returns:
            The messages as they arrive: `messages`, `tables()` and `last()`.

        Raises:
            KeyError: there is no such topic in docs/reference/interface.md; use `listen` for other topics.
            TimeoutError: no publisher appeared in time.
        """
        topic = by_name(name)
        collector = Collector(topic, self._acknowledge if acknowledge else None)
        subscription = self.subscribe(topic, collector.take, raw=topic.columns is not None)
        self.wait_until(subscription.get_publisher_count, f"a publisher of {name}", timeout_s)
        return collector

    def listen(
        self, name: str, on_message: Callable[[Received], None] | None = None, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> Collector:
        """Subscribe to any topic, such as an output of the pipeline under test, and keep all its messages.

        Message type and reliability are those of the topic's first publisher. Messages published before the call are
        not received. Unlike in `collect`, invalid tables are kept: `tables()` raises a CodecError for them.

        Args:
            name: topic name, relative to the namespace or absolute.
            on_message: called with each message, as `Received`.
            timeout_s: time limit for the publisher to appear, and again for the connection to it [s].

        Returns:
            The messages as they arrive: `messages`, `tables()` and `last()`.

        Raises:
            TimeoutError: no publisher appeared in time.
        """
        full_name = self.node.resolve_topic_name(name)
        topic, profile = self.wait_until(lambda: published(self.node, name), f"a publisher of {full_name}", timeout_s)
        collector = Collector(topic, on_message)
        is_table = topic.type_name == topics.SCAN.type_name
        subscription = self.subscribe(topic, collector.take, is_table, profile)
        self.wait_until(subscription.get_publisher_count, f"the connection to a publisher of {full_name}", timeout_s)
        return collector

    def acknowledge_for(self, peer: str, stamp_ns: int) -> None:
        """Acknowledge blocks of daq/scan on behalf of another node, up to the block with a given stamp.

        Args:
            peer: name of the node, as in the rig's parameter `time.peers`.
            stamp_ns: stamp of the last block to acknowledge [ns].
        """
        if peer not in self._acknowledgements:
            self._acknowledgements[peer] = Template(Header(frame_id=peer))
        self.publisher(topics.ACK).publish(self._acknowledgements[peer].render(stamp_ns))

    def publisher(self, topic: topics.Topic) -> Any:
        """Return this client's publisher of a topic, created at the first call.

        Args:
            topic: entry of `impact_rig.topics`.
        """
        if topic.name not in self._publishers:
            kind, profile = messages.class_of(topic), messages.profile(topic.qos)
            self._publishers[topic.name] = self.node.create_publisher(kind, topic.name, profile)
        return self._publishers[topic.name]

    def subscribe(
        self, topic: topics.Topic, callback: Callable[..., None], raw: bool = False, profile: QoSProfile | None = None
    ) -> Any:
        """Subscribe to a topic of `impact_rig.topics`, without waiting for a publisher.

        Args:
            topic: entry of `impact_rig.topics`.
            callback: function that gets each message and its info.
            raw: whether it gets the CDR bytes instead of the message.
            profile: quality of service; None means that of the topic.

        Returns:
            The rclpy subscription.
        """
        kind, profile = messages.class_of(topic), profile or messages.profile(topic.qos)
        return self.node.create_subscription(kind, topic.name, with_info(callback), profile, raw=raw)

    def _reach(self, publisher: Any, topic: topics.Topic, timeout_s: float, listener: str | None, check: Check) -> None:
        """Wait until a publisher is connected with all subscribers of its topic, at least one.

        The node `listener`, if given, must be among them. A publisher that was connected once is not checked again,
        until this client changes the state of the rig.
        """
        if publisher not in self._matched:
            matched = functools.partial(has_subscribers, self.node, publisher, listener)
            self.wait_until(matched, f"{listener or 'a node'} to subscribe to {topic.name}", timeout_s, check)
            self._matched.add(publisher)

    def _receive_applied(self) -> None:
        """Wait at most 1 s for the changes of the drive that were applied before this client started.

        Otherwise, an old change could be mistaken for the effect of a new command.
        """
        deadline = time.monotonic() + HISTORY_S
        while not self._knows_past and time.monotonic() < deadline:
            received_ns = [message.received_system_ns for message in self.applied.received[:1]]
            # the rig sent its history with the first message
            self._knows_past = bool(received_ns) and time.time_ns() - received_ns[0] > DELIVERY_S * NS_PER_S
            if not self._knows_past:
                self.spin_for(DELIVERY_S)
        self._knows_past = True

    def _acknowledge(self, message: Received) -> None:
        self.acknowledge_for(self.name, codec.header_stamp_ns(message.data))

    def _is_active(self, node: str, timeout_s: float) -> bool:
        present, message = self.state(node, timeout_s), self.status(node).message
        if present == "unconfigured" and message.startswith("cannot configure"):
            raise ServiceFailedError(f"{node}: {message}")
        return present == "active"

    def _accepted(self, before: int, column: str, value: float, refusal: Callable[[], str]) -> Table | None:
        for table in reversed(self.applied.tables(before)):
            if table.rows[column][-1] == value:
                return table
        if words := refusal():
            raise CommandError(words)
        return None

    def _on_diagnostics(self, message: Any, _info: dict[str, Any]) -> None:
        namespace = self.node.get_namespace().rstrip("/")
        for status in message.status:
            name, _, component = status.name.partition(":")
            name = f"/{name}".removeprefix(f"{namespace}/")
            self.diagnostics[name], self.reported_ns[name] = status, messages.nanoseconds(message.header.stamp)
            values = {value.key: value.value for value in status.values}
            if component.strip() == RIG and values.get("lifecycle") == "active":  # its next activation is another rig
                self._rigs.setdefault(name, AddressedActivation(self._spinner.waited_s)).heard(
                    values.get("instance", "")
                )

    def _troubles(self) -> str:
        """Return possible causes of a timeout in parentheses, for the end of an error message.

        The text lists the messages of unhealthy nodes, or says that no node has reported; otherwise it is empty.
        """
        if not self.diagnostics:
            return f" (no node has reported in ROS domain {self.domain_id}: check that the rig runs in this domain)"
        bad = [f"{name}: {status.message}" for name, status in self.diagnostics.items() if status.level != b"\0"]
        return f" ({'; '.join(bad)})" if bad else ""


def ros_parameters(values: Mapping[str, ParameterValue]) -> list[Parameter]:
    """Return values by parameter name as a list of rclpy parameters.

    An empty list becomes `[""]`, as in the nodes of this package: ROS 2 cannot tell the type of an empty list.
    """
    return [
        Parameter(
            name, value=value if isinstance(value, str) or not isinstance(value, Sequence) else list(value) or [""]
        )
        for name, value in values.items()
    ]


def subscribers(node: Node, topic: str) -> set[str]:
    """Return the names, without namespace, of the nodes that subscribe to a topic, as known to `node`."""
    full_name = node.resolve_topic_name(topic)
    return {info.node_name for info in node.get_subscriptions_info_by_topic(full_name)}


def has_subscribers(node: Node, publisher: Any, listener: str | None) -> bool:
    """Return whether a publisher is connected with all subscribers that the ROS graph lists; False without subscribers.

    Args:
        node: node of the publisher.
        publisher: the publisher.
        listener: name of a node that must be among the subscribers; None for any.
    """
    found = node.get_subscriptions_info_by_topic(publisher.topic_name)
    there = listener is None or listener in {info.node_name for info in found}
    return there and publisher.get_subscription_count() >= max(len(found), 1)


def published(node: Node, topic: str) -> tuple[topics.Topic, QoSProfile] | None:
    """Return the description of a topic of any node, and a quality-of-service profile that suits its first publisher.

    Returns None if `node` has not discovered a publisher of the topic.
    """
    found = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    if not found:
        return None
    publisher = found[0]
    profile = messages.profile(topics.Qos.DATA)
    profile.reliability = publisher.qos_profile.reliability
    return topics.Topic(topic, publisher.topic_type, topics.Qos.DATA, publisher.node_name, "", ()), profile


def _succeeded(name: str, response: Any) -> str:
    """Return the message of a service's response; raise a `ServiceFailedError` with it if `success` is false."""
    if not response.success:
        raise ServiceFailedError(f"{name} failed: {response.message}")
    return str(response.message)


def _then(callback: Callable[..., Any], acknowledge: Callable[[int], None]) -> Callable[..., Any]:
    @functools.wraps(callback)
    def call(*args: Any) -> Any:
        message = args[0][0] if type(args[0]) is tuple else args[0]
        try:
            return callback(*args)
        finally:
            stamp_ns = header_stamp_ns(message)
            assert stamp_ns is not None, "a message without a header cannot be acknowledged"
            acknowledge(stamp_ns)

    return call


@contextlib.contextmanager
def as_default(context: Context) -> Iterator[None]:
    """Make this context rclpy's default one within the `with` statement, for nodes created without a context."""
    utilities: Any = rclpy.utilities
    before, utilities.g_default_context = utilities.g_default_context, context
    try:
        yield
    finally:
        utilities.g_default_context = before
