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
"""`ManagedNode`: base class of all lifecycle nodes of the rig.

It configures and activates itself (`autostart`), validates all parameters in one place, and reports at 1 Hz and on
change. It survives invalid transition requests and exceptions in callbacks, both of which end a plain Jazzy Python
node. A subclass implements configure, activate, deactivate and clean up. Services may answer later.

Every callback is guarded: an exception is logged and reported in diagnostics, and the node continues.
"""

from __future__ import annotations

import contextlib
import enum
import functools
import secrets
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Generic, TypeVar  # rclpy is untyped

import attrs
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos_overriding_options import QoSOverridingOptions

from impact_rig import codec, graph, states, topics
from impact_rig.blocks import FRAME_DAQ, Table
from impact_rig.config.tree import Tree
from impact_rig.errors import CodecError, ImpactRigError, describe, reason_of
from impact_rig.names import one_line
from impact_rig.nodes import messages, rclpy_internals
from impact_rig.nodes.parameters import FOREIGN, Parameters, Proposal, set_one_by_one

Report = Callable[[str, str], None]  # reports a failure by the name of the callback, and a message


@attrs.define
class Refusals:
    """Count of rejected inputs by reason, with the last message of each reason."""

    counts: Counter[str] = attrs.field(factory=Counter)
    last: dict[str, str] = attrs.field(factory=dict)

    def add(self, reason: str, message: str) -> None:
        """Count one rejection."""
        self.counts[reason] += 1
        self.last[reason] = one_line(message)


def guarded(callback: Callable[..., Any], report: Report) -> Callable[..., Any]:
    """Return `callback` with its exceptions reported instead of raised, and its arguments unified by `with_info`."""

    @functools.wraps(callback)
    def safe(*args: Any) -> Any:
        try:
            return callback(*_each(args))
        except Exception as error:  # no exception in a callback may end the process
            report(_name(callback), describe(error))
            return None

    return safe


def with_info(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Return a subscription callback that gets (message, info) from every executor.

    Jazzy's events executor passes both as one tuple, the others as two arguments. rclpy decides by the signature
    whether the callback wants the info, and `wraps` keeps the signature.
    """

    @functools.wraps(callback)
    def call(*args: Any) -> Any:
        return callback(*_each(args))

    return call


def _each(args: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the arguments one by one, even if an executor passed them as one tuple."""
    return args[0] if len(args) == 1 and type(args[0]) is tuple else args


def guarded_answer(callback: Callable[[Any, Any], Any], refuse: Callable[[str], None]) -> Callable[[Any, Any], Any]:
    """Return a service callback that answers an invalid request with an error, also for rclpy's own services.

    For example, an unknown parameter type raises in rclpy's parameter services.
    """

    @functools.wraps(callback)
    def safe(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:  # see `guarded`
            message = one_line(describe(error))
            refuse(message)
            no = SetParametersResult(successful=False, reason=message)
            if hasattr(response, "results"):
                response.results += [no] * (len(request.parameters) - len(response.results))
            elif hasattr(response, "result") and isinstance(response.result, SetParametersResult):
                response.result = no
            return response

    return safe


def _name(callback: Callable[..., Any]) -> str:
    while isinstance(callback, functools.partial):
        callback = callback.func
    return getattr(callback, "__name__", type(callback).__name__).lstrip("_")


S = TypeVar("S", bound=attrs.AttrsInstance)

Done = Callable[[bool, str], None]
"""Answer to a request of `std_srvs/Trigger` or `std_srvs/SetBool`: called once with `success` and `message`."""

DIAGNOSTICS_PERIOD_S = 1.0
CHANGE_PERIOD_S = 0.1
"""Delay until a change of level or message is reported, and until an unrequested change of state is reported.

The first is also the minimum interval between two such reports.
"""
INSTANCE_BYTES = 8
ERROR_MEMORY_S = 5.0  # duration for which diagnostics show an exception of a callback
WARN_PERIOD_S = 1.0  # minimum interval between two warnings with the same reason


class Level(enum.IntEnum):
    """Levels of `diagnostic_msgs/DiagnosticStatus`, in order of severity."""

    OK = 0
    WARN = 1
    ERROR = 2


@attrs.frozen
class NodeState:
    """State of a node, as one word of `impact_rig.states`."""

    word: enum.StrEnum  # the most severe word that applies
    reason: str = ""  # readable reason; empty if the word says enough
    since_ns: int | None = None  # rig time at which it began; None: when the node reported it first


@attrs.define
class CpuMeter:
    """Meter of the share of one core that this process has used since the last call [%]."""

    clock: Callable[[], float] = time.monotonic
    used: Callable[[], float] = time.process_time
    _last: tuple[float, float] | None = None

    def percent(self) -> float:
        """Return the share since the last call [%]; 0 at the first call."""
        now = (self.clock(), self.used())
        before, self._last = self._last, now
        if before is None or now[0] <= before[0]:
            return 0.0
        return 100.0 * (now[1] - before[1]) / (now[0] - before[0])


def worst(*statuses: tuple[Level, str]) -> tuple[Level, str]:
    """Return the most severe of several (level, message); messages of equal level are joined, ("OK", "") gives OK."""
    level = max((found for found, _ in statuses), default=Level.OK)
    return level, "; ".join(message for found, message in statuses if found == level and message)


class ManagedNode(LifecycleNode, Generic[S]):
    """Lifecycle node with guarded callbacks, validated parameters and diagnostics.

    Args:
        kwargs: passed to rclpy's Node (context, namespace, parameter_overrides, ...).
    """

    COMPONENT: ClassVar[str] = "state"  # component that the diagnostics of the node describe
    STATES: ClassVar[type[states.NodeWord]]
    """Words for the states of the node."""
    MAKES_TIME: ClassVar[bool] = False  # whether the node publishes the clock, so it cannot follow another one

    def __init__(self, name: str, tree: Tree[S], **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.is_ending: Callable[[], bool] = lambda: False
        """Query whether the process is about to end; the end of other nodes is then expected."""
        self.quitting = False  # whether a client has requested the end of the process
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.refusals = Refusals()
        self.frame_prefix = graph.frame_prefix(self.get_namespace())
        """Prefix of the frames that the node publishes: rigs in different namespaces have different frames."""
        arguments = kwargs.get("cli_args") or sys.argv
        self.parameters = Parameters(self, tree, arguments, self.MAKES_TIME, self.complete)
        self.outputs: dict[str, Publisher] = {}  # publishers by topic, created by `offer`; destroyed at clean-up
        self.activation = contextlib.ExitStack()
        """Resources that are destroyed after `deactivate`: see `every` and `until_deactivated`."""
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._proposed: Proposal[S] | None = None
        self._guard_transitions()
        self._cpu = CpuMeter()
        self._last_error: tuple[float, str] = (-ERROR_MEMORY_S, "")
        self._warned: dict[str, float] = {}
        self._instance = secrets.token_hex(INSTANCE_BYTES)
        self._word: enum.StrEnum | None = None
        self._since_ns: int | None = None
        self._reported: tuple[Level, str] = (Level.OK, "")
        self._reported_at = -DIAGNOSTICS_PERIOD_S
        self._diagnostics = self.create_publisher(
            messages.class_of(topics.DIAGNOSTICS), topics.DIAGNOSTICS.name, messages.profile(topics.DIAGNOSTICS.qos)
        )
        self._reporter = self.steady_timer(CHANGE_PERIOD_S, self._report_when_due)
        self._starter = self.steady_timer(0.001, self._autostart) if self.autostarts() else None

    # Methods of a subclass

    def configure(self) -> None:
        """Build the parts of the node and create its publishers.

        An ImpactRigError fails the transition with its message.
        """

    def activate(self) -> None:
        """Start working."""

    def deactivate(self) -> None:
        """Stop working, if active; the publishers of `offer` stay."""

    def cleanup(self) -> None:
        """Free everything else that `configure` created; must succeed even if `configure` failed half-way."""

    def settings_changed(self, settings: S, changes: dict[str, Any]) -> None:
        """Apply new, validated settings; an exception rejects them."""

    def doing(self) -> NodeState:
        """Return the state of the node, computed from data only; often called, but only while the node is active."""
        raise NotImplementedError

    def health(self) -> tuple[Level, str]:
        """Return level and message of diagnostics in any lifecycle state; it is called ten times a second."""
        return Level.OK, self.state

    def figures(self) -> Mapping[str, object]:
        """Return the key-value pairs of diagnostics in any lifecycle state; it is called for each message."""
        return {}

    def complete(self, settings: S) -> S:
        """Return the start-up settings completed by properties of the node, such as its namespace."""
        return settings

    def autostarts(self) -> bool:
        """Return whether the node configures and activates itself."""
        return bool(getattr(self.settings, "autostart", True))

    def rig_time_ns(self) -> int | None:
        """Return the stamp of diagnostics: rig time in a node that follows it, here the node's clock.

        None if there is no rig time yet.
        """
        return int(self.get_clock().now().nanoseconds)

    # Helpers for subclasses

    @property
    def settings(self) -> S:
        """Parameters as one frozen value."""
        return self.parameters.settings

    @property
    def state(self) -> str:
        """Label of the lifecycle state."""
        return rclpy_internals.lifecycle_state(self)

    @property
    def active(self) -> bool:
        """Return whether the node is in the lifecycle state `active`."""
        return self.state == "active"

    def create_service(self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **options: Any) -> Any:
        """Create a guarded service. rclpy calls this for its own services (parameters), too."""
        reason = "parameter" if "parameter" in srv_name else srv_name.removeprefix("~/")
        if srv_type is SetParameters:
            callback = self._on_set_request
        safe = guarded_answer(callback, lambda message: self.refuse(reason, message))
        return super().create_service(srv_type, srv_name, safe, **options)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., None], *args: Any, **options: Any
    ) -> Any:
        """Create a guarded subscription. rclpy calls this for its own subscriptions (/clock), too."""
        return super().create_subscription(msg_type, topic, guarded(callback, self.report_failure), *args, **options)

    def steady_timer(self, period_s: float, callback: Callable[[], None]) -> Any:
        """Create a guarded timer on the monotonic clock, which neither sim time nor a clock step affects."""
        return self.create_timer(period_s, guarded(callback, self.report_failure), clock=self.steady)

    def every(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call a function periodically until the node is deactivated."""
        self.activation.callback(self.destroy_timer, self.steady_timer(period_s, callback))

    def offer(self, *chosen: topics.Topic) -> None:
        """Create the publishers of some topics; they exist while the node is configured."""
        self.outputs |= {topic.name: self.publisher(topic) for topic in chosen}

    def send(self, topic: topics.Topic, message: Any) -> None:
        """Publish a message, or its CDR bytes, on an offered topic."""
        self.outputs[topic.name].publish(message)

    def send_table(self, topic: topics.Topic, table: Table) -> None:
        """Publish a table on an offered topic, in a frame of this rig."""
        self.send(topic, codec.encode(table, self.frame_prefix))

    def adopt_frame(self, info: Table) -> None:
        """Adopt the frame prefix of `daq/info`: results are in the frame of the scans they were computed from."""
        if info.frame_id.endswith(FRAME_DAQ):
            self.frame_prefix = info.frame_id.removesuffix(FRAME_DAQ)

    def until_deactivated(self, *subscriptions: Any) -> None:
        """Keep subscriptions until the node is deactivated."""
        for subscription in subscriptions:
            self.activation.callback(self.destroy_subscription, subscription)

    def publisher(self, topic: topics.Topic, depth: int | None = None) -> Publisher:
        """Create the publisher of a topic of the topics table, optionally with another depth; `qos_overrides` apply."""
        return self.create_publisher(
            messages.class_of(topic),
            topic.name,
            messages.profile(topic.qos, depth),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def subscribe(
        self, topic: topics.Topic, callback: Callable[..., None], raw: bool = False, depth: int | None = None
    ) -> Any:
        """Create a guarded subscription to a topic of the topics table, optionally deeper; `raw` gives CDR bytes."""
        return self.create_subscription(
            messages.class_of(topic),
            topic.name,
            callback,
            messages.profile(topic.qos, depth),
            raw=raw,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def subscribe_table(self, topic: topics.Topic, callback: Callable[[Table], None]) -> Any:
        """Create a guarded subscription to a table.

        Invalid messages and those that `callback` rejects are logged and counted.
        """

        def take(data: bytes) -> None:
            table = self.table(topic, data)
            if table is None:
                return
            try:
                callback(table)
            except ImpactRigError as error:
                self.refuse(topic.name, str(error))

        return self.subscribe(topic, take, raw=True)

    def table(self, topic: topics.Topic, data: bytes) -> Table | None:
        """Decode a received table. Returns None (logged and counted) if it does not match the topic."""
        try:
            return codec.decode(data, topic)
        except CodecError as error:
            self.refuse(topic.name, str(error))
            return None

    def service(
        self,
        service_type: Any,
        name: str,
        on_request: Callable[[Any, Done], None],
        check_sent: Callable[[int], None] | None = None,
    ) -> None:
        """Create a service of `std_srvs`; use private names (`~/name`).

        Args:
            service_type: `Trigger` or `SetBool`.
            name: service name.
            on_request: called with each request and a function that answers it, now or later. An error of this package
                rejects the request, any other error is a failure; both are answered. Changes are reported at once.
            check_sent: called first, with the system time at which the request was sent [ns]; may reject it likewise.
        """
        reason = name.removeprefix("~/")

        def answer(request: Any, sent_ns: int, send: Callable[[Any], None]) -> None:
            def done(success: bool, message: str) -> None:
                message = one_line(message)
                if not success:
                    self.refuse(reason, message)
                send(service_type.Response(success=success, message=message))

            try:
                if check_sent is not None:
                    check_sent(sent_ns)
                on_request(request, done)
            except ImpactRigError as error:
                done(False, str(error))
            except Exception as error:  # no exception caused by a request may end the process
                message = one_line(describe(error))
                self.report_failure(reason, message)
                send(service_type.Response(success=False, message=message))
            self.report_change()

        LateService(self, service_type, name, answer)

    def report_failure(self, where: str, message: str) -> None:
        """Log an exception caught by a guard, and show it in diagnostics."""
        self._last_error = (time.monotonic(), f"{where}: {message}")
        self.refusals.add("exception", message)
        self.warn_throttled(f"exception in {where}", f"exception in {where}: {message}", error=True)

    def refuse(self, reason: str, message: str) -> None:
        """Count a rejected input and warn, at most once per second and reason."""
        self.refusals.add(reason, message)
        self.warn_throttled(reason, f"refused ({reason}): {message}")

    def warn_throttled(self, key: str, message: str, error: bool = False) -> None:
        """Log, at most once per second and key."""
        now = time.monotonic()
        if now - self._warned.get(key, -WARN_PERIOD_S) >= WARN_PERIOD_S:
            self._warned[key] = now
            logger, text = self.get_logger(), one_line(message)
            logger.error(text) if error else logger.warning(text)

    # Lifecycle: every transition is guarded and logs the reason of a failure

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Build the node's parts; return FAILURE and log the reason if the parameters are invalid."""
        if self.parameters.refused is not None:
            return self._failed("configure", self.parameters.refused)
        self._last_error = (-ERROR_MEMORY_S, "")
        done = self._transition("configure", self.configure, undo=self._free)
        if done == TransitionCallbackReturn.SUCCESS:
            self.get_logger().info("configured")
        return done

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start working."""
        self._instance = secrets.token_hex(INSTANCE_BYTES)
        done = self._transition("activate", self.activate, undo=self._stop)
        if done != TransitionCallbackReturn.SUCCESS:
            return done
        self.get_logger().info("active")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working."""
        self._transition("deactivate", self._stop)
        self.get_logger().info("deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working and free everything, from any state. The node can be configured again unless it is finalized."""
        return self._transition("clean up", self._free)

    on_shutdown = on_cleanup
    on_error = on_cleanup

    def close(self) -> None:
        """Stop working before the process ends; works even if ROS is already shut down."""
        self._transition("clean up", self._free)
        self.get_logger().info("ended")

    def destroy_node(self) -> None:
        """Destroy the node with its state machine."""
        super().destroy_node()
        rclpy_internals.destroy_state_machine(self)

    def _stop(self) -> None:
        try:
            self.deactivate()
        finally:
            self.activation.close()

    def _free(self) -> None:
        try:
            self._stop()
        finally:
            self.cleanup()
            while self.outputs:
                self.destroy_publisher(self.outputs.popitem()[1])

    def _transition(
        self, what: str, action: Callable[[], None], undo: Callable[[], None] | None = None
    ) -> TransitionCallbackReturn:
        try:
            action()
        except Exception as error:  # a transition must end in a lifecycle state
            if undo is not None:
                self._transition(f"undo {what}", undo)
            return self._failed(what, error)
        return TransitionCallbackReturn.SUCCESS

    def _failed(self, what: str, error: Exception) -> TransitionCallbackReturn:
        message = reason_of(error)
        self._last_error = (float("inf") if what == "configure" else time.monotonic(), f"cannot {what}: {message}")
        self.get_logger().error(one_line(f"cannot {what}: {message}"))
        return TransitionCallbackReturn.FAILURE

    def _guard_transitions(self) -> None:
        """Answer an invalid transition request with `success = False`, and count it.

        rclpy of Jazzy would raise and end the process; rclpy of Kilted answers likewise.
        """
        service = rclpy_internals.change_state_service(self)
        original = service.callback

        def on_change_state(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            wanted = request.transition.label or str(request.transition.id)
            try:
                if rclpy_internals.is_possible(self, request.transition):
                    return original(request, response)
                self.refuse("transition", f"{wanted!r} is not possible in state {self.state!r}")
            except Exception as error:  # rclpy raises RCLError, which is not exported
                self.refuse("transition", f"{wanted!r} failed in state {self.state!r} ({error})")
            finally:
                self.report_change()
            response.success = False
            return response

        service.callback = on_change_state

    def _autostart(self) -> None:
        assert self._starter is not None
        self._starter.cancel()
        if self.state != "unconfigured":
            return
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()
        self.report_change()

    # Parameters

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all parameters or none, through the validator; the services and in-process calls both use this."""
        result = self._attempt(parameter_list)
        if not result.successful:
            self.refuse("parameter", result.reason)
        return result

    def _attempt(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all parameters or none."""
        try:
            self._proposed = proposed = self.parameters.check(parameter_list)
            result = super().set_parameters_atomically(proposed.stored)
            if result.successful:
                self.parameters.settings = proposed.settings
                self.report_change()
        except Exception as error:  # an exception rejects the values with its reason and is never fatal
            result = SetParametersResult(successful=False, reason=one_line(reason_of(error)))
        finally:
            self._proposed = None
        return result

    def _on_set_request(
        self, request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        response.results = set_one_by_one(list(request.parameters), self._attempt)
        for result in response.results:
            if not result.successful:
                self.refuse("parameter", result.reason)
        return response

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """Set the parameters one after the other, each through the validator."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def _on_set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        # rclpy declares parameters of its own (qos_overrides), also for a subscription created while a value is set
        if self._proposed is None or all(parameter.name.startswith(FOREIGN) for parameter in parameters):
            return SetParametersResult(successful=True)
        try:
            if self._proposed.changes:
                self.settings_changed(self._proposed.settings, self._proposed.changes)
        except Exception as error:  # an exception rejects the values with its reason and is never fatal
            return SetParametersResult(successful=False, reason=reason_of(error))
        return SetParametersResult(successful=True)

    # Diagnostics

    def _report_when_due(self) -> None:
        if self.is_ending():
            return
        if time.monotonic() - self._reported_at >= DIAGNOSTICS_PERIOD_S or self._judged() != self._reported:
            self.report_now()
        else:
            self.report_change()

    def report_change(self) -> None:
        """Publish the present status if the state differs from the last published one."""
        if self.present().word != self._word and not self.is_ending():
            self.report_now()

    def present(self) -> NodeState:
        """Return the present state in any lifecycle state."""
        if self.active:
            return self.doing()
        at, message = self._last_error
        fresh = time.monotonic() - at < ERROR_MEMORY_S
        return NodeState(self.STATES("inactive"), f"{self.state}: {message}" if fresh else self.state)

    def report_now(self) -> None:
        """Publish the present status."""
        level, message = self._judged()
        state, now_ns = self.present(), self.rig_time_ns()
        self._reported, self._reported_at = (level, message), time.monotonic()
        if state.word != self._word:
            self._word, self._since_ns = state.word, now_ns
        since_ns = self._since_ns if state.since_ns is None else state.since_ns
        values = {
            "state": state.word,
            "reason": state.reason,
            "since_ns": "" if since_ns is None else since_ns,
            "instance": self._instance,
            "lifecycle": self.state,
            "cpu_percent": self._cpu.percent(),
            **self.figures(),
            **{f"refused.{reason}": count for reason, count in sorted(self.refusals.counts.items())},
            **{f"last_refused.{reason}": text for reason, text in sorted(self.refusals.last.items())},
        }
        one = DiagnosticStatus(
            level=bytes([level]), name=f"{self.get_fully_qualified_name().lstrip('/')}: {self.COMPONENT}",
            message=one_line(message), hardware_id=f"impact_rig{self.get_namespace()}".rstrip("/"),
            values=[
                KeyValue(
                    key=one_line(key), value=f"{value:.6g}" if isinstance(value, float) else one_line(str(value))
                )
                for key, value in values.items()
            ],
        )  # fmt: skip
        array = DiagnosticArray(status=[one])
        array.header.stamp = messages.time_message(now_ns or 0)
        self._diagnostics.publish(array)

    def _judged(self) -> tuple[Level, str]:
        """Return the level and message of `health`, together with the last error while it is recent."""
        at, message = self._last_error
        if time.monotonic() - at < ERROR_MEMORY_S:
            return worst(self.health(), (Level.ERROR, message))
        return self.health()


class LateService:
    """Service of any type whose requests may be answered later, under any executor.

    rclpy expects the callback to return a response. Its executors differ: the events executor accepts no coroutines,
    and the others resume them only when something else wakes them. All of them pass the returned response to
    `Service.send_response` together with the request's header. Therefore the callback returns a marker, and the wrapped
    `send_response` keeps the header until there is an answer.

    Args:
        on_request: called with each request, the system time at which it was sent [ns], and a function that sends its
            response. It must not raise.
    """

    def __init__(
        self,
        node: ManagedNode[Any],
        service_type: Any,
        name: str,
        on_request: Callable[[Any, int, Callable[[Any], None]], None],
    ) -> None:
        self._on_request = on_request
        self._request: Any = None
        self._service = node.create_service(service_type, name, self._keep)
        self._send = self._service.send_response
        self._service.send_response = self._begin
        self._marker = service_type.Response()

    def _keep(self, request: Any, _response: Any) -> Any:
        self._request = request
        return self._marker

    def _begin(self, _marker: Any, header: Any) -> None:
        sent_ns = getattr(header, "source_timestamp", 0) or time.time_ns()  # some middleware does not provide it
        self._on_request(self._request, sent_ns, lambda response: self._send(response, header))
