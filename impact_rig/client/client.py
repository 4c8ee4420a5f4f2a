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
"""A client of the rig's graph: waits on conditions, commands, steps, sets parameters and collects topics.

It spins in the caller's thread, only while it waits; no thread is started and nothing sleeps for a fixed time. Every
wait has a deadline and names what it waited for; with `processes` given, a node process that dies ends the wait at once
with its last words.
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
from impact_rig.client.processes import ParameterValue, Processes
from impact_rig.errors import CodecError, CommandError, ConfigError, GoneError, ImpactRigError
from impact_rig.nodes import messages
from impact_rig.nodes.managed import with_info
from impact_rig.nodes.messages import Template, by_name, header_stamp_ns
from impact_rig.nodes.process import make_executor, patient_threads
from impact_rig.rig.journal import JournalEntry
from impact_rig.simtime import NS_PER_S
from impact_rig.system.endings import unhurried
from impact_rig.topics import Topic


@attrs.frozen(eq=False)
class Received:
    """One message.

    Attributes:
        sequence: DDS publication sequence number: contiguous per publisher.
        received_system_ns: system clock at the callback [ns], comparable with stamps in realtime.
    """

    data: Any
    sequence: int
    received_system_ns: int
    table: Table | None = None


class Collector:
    """Keeps every message of one topic.

    A message that is no table of its topic is refused: counted, and not kept.
    """

    def __init__(self, topic: Topic, on_message: Callable[[Received], None] | None = None) -> None:
        self.topic = topic
        self.received: list[Received] = []
        self.refused = 0  # messages that were no tables of the topic
        self.last_refused = ""  # why the last of them was none
        self._on_message = [on_message] if on_message is not None else []

    def __len__(self) -> int:
        return len(self.received)

    def take(self, data: Any, info: dict[str, Any]) -> None:
        """Keep one message; the subscription's callback."""
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
        """Call this as well after each message that is kept from now on."""
        self._on_message.append(on_message)

    @property
    def messages(self) -> list[Any]:
        """The messages, or the CDR bytes of tables."""
        return [message.data for message in self.received]

    def tables(self, since: int = 0) -> list[Table]:
        """Return the decoded tables, without the first `since`."""
        return [message.table or codec.decode(message.data) for message in self.received[since:]]

    def last(self) -> Table | None:
        """Return the newest table, decoding nothing else; None if there is none."""
        found = self.tables(-1)
        return found[0] if found else None

    def entries(self, since: int = 0) -> list[JournalEntry]:
        """Return the entries of `rig/journal` that arrived, without the first `since` messages."""
        return [JournalEntry.from_line(message.data.data) for message in self.received[since:]]

    def rows(self) -> NDArray[np.void]:
        """Return the rows of all tables, one after the other; shape (n,)."""
        parts = [table.rows for table in self.tables()]
        assert parts or self.topic.columns is not None, f"{self.topic.name}: no tables have come, if it carries any"
        return np.concatenate(parts) if parts else np.empty(0, self.topic.columns)

    def lost(self) -> int:
        """Return how many messages are missing between the first and the last, by DDS sequence number."""
        numbers = [message.sequence for message in self.received]
        return int(numbers[-1] - numbers[0] + 1 - len(set(numbers))) if numbers else 0

    def clear(self) -> None:
        """Forget what arrived so far."""
        self.received.clear()


SPIN_S = 0.1
GONE_S = 2.0  # a rig that says nothing for so long is gone: it reports once a second, whatever it does
DIAGNOSTICS_PERIOD_S = 1.0
LOOK_S = 0.05  # what has arrived while nobody spun is handed over in this time
HISTORY_S = 1.0  # a client that has just found a rig is sent the rig's latched messages in this time


class WaitTimeoutError(ImpactRigError, TimeoutError):
    """Something awaited did not happen in time."""


Check = Callable[[], None]  # raises when there is nothing to wait for any more


def patiently() -> None:
    """Wait as long as there is time."""


class RigGoneError(GoneError):
    """The rig that something was given to is gone, by itself or for another one: it was not done, and will not be."""


class Activation:
    """Which rig a client speaks to: the activation it heard of last, and when.

    A command belongs to the rig it was given to. Whoever waits for one to be carried out asks `given` first: what that
    returns raises as soon as the rig is gone.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._instance = self._first = ""
        self._heard_at = self._changed_at = -math.inf
        self._previous = ""
        self._is_there = self._is_gone = False

    @property
    def is_overdue(self) -> bool:
        """Whether a rig that was heard has not been heard for a while."""
        return self._is_there and self._clock() - self._heard_at > DIAGNOSTICS_PERIOD_S

    @property
    def _is_changing(self) -> bool:
        """True while diagnostics of the previous rig may still arrive."""
        return self._clock() - self._changed_at <= LOOK_S

    def heard(self, instance: str) -> None:
        """Take the instance in a rig's diagnostics, as they are received.

        Diagnostics of the previous rig that follow `changed` immediately are outdated: they were under way.
        """
        self._identify()
        self._heard_at = self._clock()
        self._is_there, self._is_gone = True, False
        if instance != self._previous or not self._is_changing:
            self._instance = instance
            self._first = self._first or instance

    def changed(self) -> None:
        """Take the next rig that is heard for the one that is meant: the user has just seen that it is there."""
        self._previous, self._instance, self._changed_at = self._instance or self._previous, "", self._clock()
        self._first = ""
        self._is_there, self._is_gone = True, False

    def _identify(self) -> None:
        """Take the rig for the previous one if only that was heard after `changed`: it was the same one after all."""
        if not self._first and not self._is_changing and self._heard_at >= self._changed_at:
            self._instance = self._first = self._previous

    def given(self, what: str, silence_s: float = GONE_S) -> Check:
        """Return what raises once the rig that is there now is gone, or has been silent for so long [s]."""
        self._identify()
        instance, since = self._instance, self._clock()

        def check() -> None:
            nonlocal instance
            self._identify()
            instance = instance or self._first
            if instance != self._instance:
                raise RigGoneError(f"{what}: the rig it was given to is gone, and another one has begun")
            silent = self._is_there and self._clock() - max(self._heard_at, since) > silence_s
            self._is_gone |= silent
            if self._is_gone:
                raise RigGoneError(f"{what}: the rig it was given to is gone, nothing was heard of it for {GONE_S:g} s")

        return check


class Spinner:
    """Spins an executor and keeps the time."""

    def __init__(self, executor: Any) -> None:
        self._executor = executor
        self._working_s = 0.0

    def waited_s(self) -> float:
        """Return a time [s] that stands still while a hosted node is at work in a callback: compiling takes minutes."""
        return time.monotonic() - self._working_s

    def spin(self, longest_s: float = SPIN_S) -> None:
        """Let one callback run, or wait for it at most so long [s]."""
        began = time.monotonic()
        self._executor.spin_once(timeout_sec=longest_s)
        self._working_s += max(0.0, time.monotonic() - began - longest_s)


T = TypeVar("T")

DEFAULT_TIMEOUT_S = 10.0  # discovery takes 0.2 to 2 s; compiled code may load in the first seconds of a node
START_TIMEOUT_S = 240.0  # without the library of kernels a node's first start compiles the physics
LIFECYCLE = (ChangeState, GetState)  # services by which rigs are begun and ended; a transition may take minutes
RIG = "simulation"  # component in the diagnostics of a rig
AGAIN_S = 2.0  # when a question that may be asked twice is asked again


TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "cleanup": Transition.TRANSITION_CLEANUP,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "shutdown_unconfigured": Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
    "shutdown_inactive": Transition.TRANSITION_INACTIVE_SHUTDOWN,
    "shutdown_active": Transition.TRANSITION_ACTIVE_SHUTDOWN,
}
"""Transitions of a lifecycle node by name."""


class ServiceFailedError(ImpactRigError, RuntimeError):
    """A service answered that it could not do what was asked."""


class Client:
    """One ROS node that plays the user.

    Args:
        namespace: namespace of the rig's nodes; topics and node names below are relative to it.
        processes: watched during every wait.
        name: node name, and the name in its acknowledgements.
        commands: whether `command` will be called: all that the rig accepts is kept for it.
    """

    def __init__(
        self,
        domain_id: int,
        namespace: str = "",
        processes: Processes | None = None,
        name: str = "client",
        *,
        commands: bool = True,
    ) -> None:
        self._processes = processes
        self.name = name
        self.context = Context()
        self.context.init(args=[], domain_id=domain_id)
        self.executor = make_executor(self.context)
        with patient_threads():
            self.node = Node(
                name, namespace=namespace, context=self.context, use_global_arguments=False, enable_rosout=False
            )
        self.executor.add_node(self.node)
        self.diagnostics: dict[str, DiagnosticStatus] = {}
        """Latest status of each node, by name relative to the namespace; of others by their full name: `/there/rig`."""
        self._hosted: list[Any] = []
        self._spinner = Spinner(self.executor)
        self._rigs: dict[str, Activation] = {}
        self._publishers: dict[str, Any] = {}
        self._acknowledgements: dict[str, Template] = {}
        self._heard: set[Any] = set()
        self._knows_past = False  # whether all has come that had been applied before this client came
        self._clients: dict[tuple[str, Any], Any] = {}
        self.subscribe(topics.DIAGNOSTICS, self._on_diagnostics)
        self.applied = Collector(topics.APPLIED)
        """What the rig has accepted since this client is there: `shaker/applied`; nothing without `commands`."""
        if commands:
            self.subscribe(topics.APPLIED, self.applied.take, raw=True)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Destroy the node, the nodes it hosts and the context."""
        with unhurried():
            for node in self._hosted:  # those of this package end what they do, while the executor still runs
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
        """Spin until `condition()` is true, and return what it gave.

        Raises:
            WaitTimeoutError: it did not become true in time; names `what`.
            ProcessDiedError: a watched process ended.
        """
        deadline = self._spinner.waited_s() + timeout_s
        while not (found := condition()):
            if self._processes is not None:
                self._processes.check()
            check()
            if self._spinner.waited_s() > deadline:
                raise WaitTimeoutError(f"waited {timeout_s:g} s in vain for {what}{self._troubles()}")
            self._spinner.spin()
        return found

    def given(self, what: str, rig: str = "rig", *, may_be_silent: bool = False) -> Check:
        """Return what raises `RigGoneError` once the rig that is there now is gone, or another one is in its place.

        Args:
            what: is given to it, for the message.
            rig: its node name, relative to the namespace.
            may_be_silent: it may be at work for seconds without a word, as when a new law is compiled.
        """
        activation = self._rigs.setdefault(rig, Activation(self._spinner.waited_s))
        check = activation.given(what, math.inf) if may_be_silent else activation.given(what)
        if activation.is_overdue:  # nobody has spun: perhaps another rig has begun meanwhile
            deadline = time.monotonic() + LOOK_S
            while activation.is_overdue and time.monotonic() < deadline:
                self._spinner.spin(LOOK_S)
            check()
        return check

    def spin_pending(self) -> None:
        """Run the callbacks of everything that has arrived, without waiting for more."""
        last = self.executor.create_task(lambda: None)  # tasks and messages run in the order in which they arrived
        while not last.done():
            self._spinner.spin(0.0)

    def spin_for(self, duration_s: float) -> None:
        """Let things happen for a while of wall time: for benchmarks and demonstrations, not for tests."""
        deadline = time.monotonic() + duration_s
        while (left := deadline - time.monotonic()) > 0:
            if self._processes is not None:
                self._processes.check()
            self._spinner.spin(min(left, SPIN_S))

    def wait_active(self, *nodes: str, timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait until these nodes are in the lifecycle state `active`.

        Raises:
            WaitTimeoutError: one is not in time.
            ServiceFailedError: one says that it cannot be configured, and why.
        """
        for node in nodes:
            is_active = functools.partial(self._is_active, node, timeout_s)
            self.wait_until(is_active, f"{node} to be active", timeout_s)
            self._address(node)

    def _address(self, node: str) -> None:
        """Speak to whatever rig has this name now."""
        if node in self._rigs:
            received = self.executor.create_task(lambda: None)  # runs after everything that has been received by now
            self.wait_until(received.done, "the executor")
            self._rigs[node].changed()
            self._heard.clear()

    def host(self, make_node: Callable[..., Any], **kwargs: Any) -> Any:
        """Run a node in this process, in this client's executor, with this client's context and namespace.

        No thread: the node works while the client waits. A class that does not hand keyword arguments on to `Node` gets
        the context as the default one, and no namespace.
        """
        if any(one.kind is one.VAR_KEYWORD for one in inspect.signature(make_node).parameters.values()):
            namespace = self.node.get_namespace()
            kwargs |= {"context": self.context, "namespace": namespace, "use_global_arguments": False}
        with _as_default(self.context):
            node = make_node(**kwargs)
        self._hosted.append(node)
        self.executor.add_node(node)
        return node

    def acknowledge_callbacks(self, node: Any) -> int:
        """Acknowledge every block of daq/scan for a hosted node, once its callback has returned, or raised.

        The node need not know of daq/ack. Returns how many subscriptions to daq/scan it has.
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
        """Command frequency and current (peak) and wait for the rig's rows in shaker/applied; return the last one.

        Its `sample` is the first scan the commands act on.

        Raises:
            CommandError: the rig refused, in its words.
            WaitTimeoutError: it did neither in time.
            RigGoneError: the rig that was there is gone.
        """
        row: np.void | None = None
        for topic, column, value in (
            (topics.FREQUENCY, "frequency", frequency_hz),
            (topics.CURRENT, "current", current_a),
        ):
            if value is None:
                continue
            check = self.given(f"{column} = {value:g}")
            self._reach(self.publisher(topic), topic, timeout_s, "rig", check)
            self._hear_applied()
            before = len(self.applied)
            self.publish(topic, Float64(data=value), timeout_s, "rig", check)
            accepted = functools.partial(self._accepted, before, column, value, self.refusal(topic.name))
            what = f"{column} = {value:g} in {topics.APPLIED.name}"
            row = self.wait_until(accepted, what, timeout_s, check).rows[-1]
        assert row is not None, "command() needs a frequency or a current"
        return row

    def refusal(self, *reasons: str) -> Callable[[], str]:
        """Return what gives the rig's words as soon as it tells that it has refused something, "" till then.

        A rig tells in its diagnostics, within a second, and not to whom: what is refused to somebody else meanwhile
        counts, too.

        Args:
            reasons: what it counts refusals by: the name of a topic, or `inactive`.
        """

        def told() -> dict[str, tuple[str, str]] | None:
            figures = self.figures("rig")
            names = [f"refused.{reason}" for reason in reasons]
            return {name: (figures.get(name, ""), figures.get(f"last_{name}", "")) for name in names if figures} or None

        before = told()

        def words() -> str:
            nonlocal before
            now = told()
            before = before or now  # of a rig that was not heard before it may be old
            return next((now[name][1] for name in now if now[name] != before[name]), "") if now and before else ""

        return words

    def publish(
        self,
        topic: topics.Topic,
        message: Any,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        listener: str | None = None,
        check: Check = patiently,
    ) -> None:
        """Publish a message once somebody listens: everybody the graph knows, and the node `listener` among them."""
        publisher = self.publisher(topic)
        self._reach(publisher, topic, timeout_s, listener, check)
        publisher.publish(message)

    def note(self, text: str) -> None:
        """Publish an operator's remark; recorded with the run."""
        self.publish(topics.NOTES, String(data=text))

    def step(self, blocks: int | None = None, timeout_s: float = START_TIMEOUT_S) -> str:
        """Advance a rig in lockstep and return when the last block is out and acknowledged."""
        if blocks is not None:
            self.set_parameters("rig", {"step.blocks": blocks})
        return self.trigger("rig/step", timeout_s)

    def pause(self, paused: bool = True) -> None:
        """Pause the rig, or let it go on."""
        response = self.call(SetBool, "rig/pause", SetBool.Request(data=paused))
        if not response.success:
            raise ServiceFailedError(f"rig/pause: {response.message}")

    def trigger(self, name: str, timeout_s: float = DEFAULT_TIMEOUT_S, *, may_be_silent: bool = False) -> str:
        """Call a Trigger service, e.g. `rig/reset`, `recorder/start`; return its message. See `call`.

        Raises:
            ServiceFailedError: it answered `success = False`.
        """
        response = self.call(Trigger, name, Trigger.Request(), timeout_s, may_be_silent=may_be_silent)
        if not response.success:
            raise ServiceFailedError(f"{name}: {response.message}")
        return str(response.message)

    def call(
        self,
        service_type: Any,
        name: str,
        request: Any,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        again_s: float = math.inf,
        *,
        may_be_silent: bool = False,
    ) -> Any:
        """Call any service and return its response.

        Args:
            service_type: class of the service.
            name: service name.
            request: the request.
            timeout_s: how long to wait for the service, and then for its answer.
            again_s: ask again after this long, where it does no harm: on a busy machine DDS loses the answer to a
                client that the server has not discovered within 100 ms.
            may_be_silent: a rig that says nothing for a while is not taken to be gone.

        Raises:
            WaitTimeoutError: there is no such service, or no answer, in time.
            RigGoneError: the service is one of a rig, and that is gone.
        """
        node = name.rpartition("/")[0]
        check = patiently
        if node in self._rigs and service_type not in LIFECYCLE:
            may_be_silent |= service_type is SetParametersAtomically  # which may compile a law
            check = self.given(name, node, may_be_silent=may_be_silent)
        client = self.prepare(service_type, name)
        self.wait_until(client.service_is_ready, f"service {name}", timeout_s, check)
        left = timeout_s
        while True:
            future = client.call_async(request)
            try:
                self.wait_until(future.done, f"an answer of {name}", min(again_s, left), check)
            except WaitTimeoutError:
                client.remove_pending_request(future)
                left -= again_s
                if left <= 0.0:
                    raise
            else:
                return future.result()

    def prepare(self, service_type: Any, name: str) -> Any:
        """Return the client of a service, made if there is none: one made early has been discovered when it is used."""
        client = self._clients.get((name, service_type))
        if client is None:
            client = self._clients[name, service_type] = self.node.create_client(service_type, name)
        return client

    # Parameters and lifecycle

    def set_parameters(self, node: str, values: Mapping[str, ParameterValue]) -> None:
        """Set parameters, all or none.

        Raises:
            ConfigError: the node refused; its reason.
        """
        request = SetParametersAtomically.Request(
            parameters=[parameter.to_parameter_msg() for parameter in ros_parameters(values)]
        )
        name = f"{node}/set_parameters_atomically"
        result = self.call(SetParametersAtomically, name, request, again_s=AGAIN_S).result
        if not result.successful:
            raise ConfigError(result.reason)

    def get_parameters(self, node: str, names: Sequence[str]) -> dict[str, Any]:
        """Return parameter values by name."""
        request = GetParameters.Request(names=list(names))
        response = self.call(GetParameters, f"{node}/get_parameters", request, again_s=AGAIN_S)
        return {name: parameter_value_to_python(value) for name, value in zip(names, response.values, strict=True)}

    def state(self, node: str, timeout_s: float = DEFAULT_TIMEOUT_S) -> str:
        """Return the label of a node's lifecycle state."""
        response = self.call(GetState, f"{node}/get_state", GetState.Request(), timeout_s, AGAIN_S)
        return str(response.current_state.label)

    def change_state(self, node: str, transition: str, timeout_s: float = START_TIMEOUT_S) -> bool:
        """Request a lifecycle transition (`configure`, `activate`, `deactivate`, `cleanup`); return its success."""
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[transition]))
        changed = bool(self.call(ChangeState, f"{node}/change_state", request, timeout_s).success)
        self._address(node)
        return changed

    def status(self, node: str) -> DiagnosticStatus:
        """Return a node's latest diagnostics; an empty status before the first was heard."""
        return self.diagnostics.get(node, DiagnosticStatus(name=node))

    def figures(self, node: str) -> dict[str, str]:
        """Return the figures of a node's latest diagnostics."""
        return {value.key: value.value for value in self.status(node).values}

    # Topics

    def collect(self, name: str, acknowledge: bool = False, timeout_s: float = DEFAULT_TIMEOUT_S) -> Collector:
        """Subscribe to a topic of the table and keep everything that arrives; returns once a publisher is matched.

        Args:
            name: topic name as in the table, e.g. `daq/scan`.
            acknowledge: answer every message with daq/ack, as a peer named like this client must.
            timeout_s: how long to wait for a publisher.
        """
        topic = by_name(name)
        collector = Collector(topic, self._acknowledge if acknowledge else None)
        subscription = self.subscribe(topic, collector.take, raw=topic.columns is not None)
        self.wait_until(subscription.get_publisher_count, f"a publisher of {name}", timeout_s)
        return collector

    def listen(
        self, name: str, on_message: Callable[[Received], None] | None = None, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> Collector:
        """Subscribe to any topic, e.g. an output of the pipeline under test, and keep everything that arrives.

        Type and reliability are those of its publisher, which must be there; tables come as with `collect`.
        """
        full_name = self.node.resolve_topic_name(name)
        topic, profile = self.wait_until(lambda: published(self.node, name), f"a publisher of {full_name}", timeout_s)
        collector = Collector(topic, on_message)
        is_table = topic.type_name == topics.SCAN.type_name
        subscription = self.subscribe(topic, collector.take, is_table, profile)
        self.wait_until(subscription.get_publisher_count, f"a publisher of {full_name} to match", timeout_s)
        return collector

    def acknowledge_for(self, peer: str, stamp_ns: int) -> None:
        """Tell the rig that a peer, which does not do so itself, has processed everything up to a block."""
        if peer not in self._acknowledgements:
            self._acknowledgements[peer] = Template(Header(frame_id=peer))
        self.publisher(topics.ACK).publish(self._acknowledgements[peer].render(stamp_ns))

    def publisher(self, topic: topics.Topic) -> Any:
        """Return the publisher of a topic, made if there is none."""
        if topic.name not in self._publishers:
            kind, profile = messages.class_of(topic), messages.profile(topic.qos)
            self._publishers[topic.name] = self.node.create_publisher(kind, topic.name, profile)
        return self._publishers[topic.name]

    def subscribe(
        self, topic: topics.Topic, callback: Callable[..., None], raw: bool = False, profile: QoSProfile | None = None
    ) -> Any:
        """Subscribe to a row of the topics table; the callback gets message, or CDR bytes if `raw`, and info."""
        kind, profile = messages.class_of(topic), profile or messages.profile(topic.qos)
        return self.node.create_subscription(kind, topic.name, with_info(callback), profile, raw=raw)

    def _reach(self, publisher: Any, topic: topics.Topic, timeout_s: float, listener: str | None, check: Check) -> None:
        """Wait once until somebody listens; see `publish`."""
        if publisher not in self._heard:
            heard = functools.partial(is_heard, self.node, publisher, listener)
            self.wait_until(heard, f"{listener or 'somebody'} to subscribe {topic.name}", timeout_s, check)
            self._heard.add(publisher)

    def _hear_applied(self) -> None:
        """Hear first what was applied before this client came: it would be taken for the answer to a command.

        A rig that has not begun has applied nothing.
        """
        deadline = time.monotonic() + HISTORY_S
        while not self._knows_past and time.monotonic() < deadline:
            came_ns = [message.received_system_ns for message in self.applied.received[:1]]
            self._knows_past = bool(came_ns) and time.time_ns() - came_ns[0] > LOOK_S * NS_PER_S  # all came with it
            if not self._knows_past:
                self.spin_for(LOOK_S)
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
            self.diagnostics[name] = status
            if component.strip() == RIG:
                instance = next((value.value for value in status.values if value.key == "instance"), "")
                activation = self._rigs.setdefault(name, Activation(self._spinner.waited_s))
                activation.heard(instance)

    def _troubles(self) -> str:
        """Return what nodes that are not well say: most waits in vain have their reason there."""
        bad = [f"{name}: {status.message}" for name, status in self.diagnostics.items() if status.level != b"\0"]
        return f" ({'; '.join(bad)})" if bad else ""


def ros_parameters(values: Mapping[str, ParameterValue]) -> list[Parameter]:
    """Return parameters by name and value; rclpy knows no sequences but lists, tuples and arrays.

    No lines are one empty line, as the nodes have it: of which type an empty list is, ROS 2 cannot tell.
    """
    return [
        Parameter(
            name, value=value if isinstance(value, str) or not isinstance(value, Sequence) else list(value) or [""]
        )
        for name, value in values.items()
    ]


def subscribers(node: Node, topic: str) -> set[str]:
    """Return the names of the nodes that subscribe a topic."""
    full_name = node.resolve_topic_name(topic)
    return {info.node_name for info in node.get_subscriptions_info_by_topic(full_name)}


def is_heard(node: Node, publisher: Any, listener: str | None) -> bool:
    """Return whether a node's publisher has reached all that the graph knows, the node `listener` among them."""
    found = node.get_subscriptions_info_by_topic(publisher.topic_name)
    there = listener is None or listener in {info.node_name for info in found}
    return there and publisher.get_subscription_count() >= max(len(found), 1)


def published(node: Node, topic: str) -> tuple[topics.Topic, QoSProfile] | None:
    """Return a topic's row, as the table of topics has them, and the profile that its first publisher satisfies.

    None: nobody publishes it.
    """
    found = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    if not found:
        return None
    publisher = found[0]
    profile = messages.profile(topics.Qos.DATA)
    profile.reliability = publisher.qos_profile.reliability
    return topics.Topic(topic, publisher.topic_type, topics.Qos.DATA, publisher.node_name, "", ()), profile


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
def _as_default(context: Context) -> Iterator[None]:
    """Make a context the default one, which is what a node gets that is not given any."""
    utilities: Any = rclpy.utilities
    before, utilities.g_default_context = utilities.g_default_context, context
    try:
        yield
    finally:
        utilities.g_default_context = before
