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

Such a node configures and activates itself (`autostart`), validates its parameters, and publishes diagnostics at 1 Hz
and on change. Its services may answer requests later. Invalid transition requests and exceptions in callbacks do not
end the node, unlike a plain Python node of ROS 2 Jazzy. An exception is logged and reported in diagnostics. A subclass
implements `configure`, `activate`, `deactivate` and `cleanup`.
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
    """Number of rejected inputs (messages, requests, parameters) by reason, with the last message of each reason."""

    counts: Counter[str] = attrs.field(factory=Counter)
    last: dict[str, str] = attrs.field(factory=dict)

    def add(self, reason: str, message: str) -> None:
        """Count one rejected input under `reason`, and keep its message as the last one of this reason."""
        self.counts[reason] += 1
        self.last[reason] = one_line(message)


def guarded(callback: Callable[..., Any], report: Report) -> Callable[..., Any]:
    """Return a wrapper of `callback` that passes any exception to `report` instead of raising it.

    `report` gets the name of the callback and a description of the exception. The wrapper then returns None. If an
    executor passes the arguments as a single tuple, the wrapper passes them to `callback` one by one.
    """

    @functools.wraps(callback)
    def safe(*args: Any) -> Any:
        try:
            return callback(*_each(args))
        except Exception as error:  # no exception in a callback may end the process
            report(_name(callback), describe(error))
            return None

    return safe


def with_info(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Return a wrapper of a subscription callback that passes message and info as two arguments under every executor.

    The info is rclpy's dictionary with the times of sending and receipt. The wrapper keeps the signature of the
    callback, by which rclpy decides whether to pass the info.
    """

    @functools.wraps(callback)
    def call(*args: Any) -> Any:
        return callback(*_each(args))

    return call


def _each(args: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return callback arguments one by one, even if an executor passed them as a single tuple."""
    return args[0] if len(args) == 1 and type(args[0]) is tuple else args


def guarded_answer(callback: Callable[[Any, Any], Any], refuse: Callable[[str], None]) -> Callable[[Any, Any], Any]:
    """Return a wrapper of a service callback that answers the request even if the callback raises an exception.

    The wrapper then passes a description of the exception to `refuse`, and returns the given response object. If the
    request was to set parameters, each parameter without a result is rejected.
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
"""Function that answers a request of `std_srvs/Trigger` or `std_srvs/SetBool` by success and message; call it once."""

DIAGNOSTICS_PERIOD_S = 1.0  # longest time between two reports of a node on `diagnostics`
CHANGE_PERIOD_S = 0.1
"""Interval [s] at which a node checks whether level, message or state of its diagnostics have changed.

A change is published at the next check, unless a service or a transition has published it already.
"""
INSTANCE_BYTES = 8
ERROR_MEMORY_S = 5.0  # duration for which diagnostics show an exception of a callback
WARN_PERIOD_S = 1.0  # minimum interval between two warnings with the same reason


class Level(enum.IntEnum):
    """Levels OK, WARN and ERROR of `diagnostic_msgs/DiagnosticStatus`, in ascending order of severity."""

    OK = 0
    WARN = 1
    ERROR = 2


@attrs.frozen
class NodeState:
    """State of a node for its diagnostics: a word of `impact_rig.states`, with reason and time of its beginning.

    Attributes:
        word: the most severe word that applies.
        reason: readable reason; empty if the word says enough.
        since_ns: rig time at which the state began [ns]. If it is None, the diagnostics show the rig time of the first
            report with this word.
    """

    word: enum.StrEnum
    reason: str = ""
    since_ns: int | None = None


@attrs.define
class CpuMeter:
    """Meter of how much of one processor core this process uses."""

    clock: Callable[[], float] = time.monotonic
    used: Callable[[], float] = time.process_time
    _last: tuple[float, float] | None = None

    def percent(self) -> float:
        """Return this process's processor time since the last call, in % of the elapsed time; 0 at the first call.

        It exceeds 100 if several threads keep more than one core busy.
        """
        now = (self.clock(), self.used())
        before, self._last = self._last, now
        if before is None or now[0] <= before[0]:
            return 0.0
        return 100.0 * (now[1] - before[1]) / (now[0] - before[0])


def worst(*statuses: tuple[Level, str]) -> tuple[Level, str]:
    """Return the most severe level of (level, message) pairs, and all messages of that level, joined by "; ".

    Without a pair, the level is OK and the message is empty.
    """
    level = max((found for found, _ in statuses), default=Level.OK)
    return level, "; ".join(message for found, message in statuses if found == level and message)


class ManagedNode(LifecycleNode, Generic[S]):
    """Lifecycle node with validated parameters and diagnostics, which continues after an exception in a callback.

    The exception is logged and shown in diagnostics. A lifecycle transition that raises one fails, except
    deactivation, which succeeds nevertheless.

    Args:
        name: node name.
        tree: parameters of the node, with their validation.
        kwargs: passed to rclpy's Node (context, namespace, parameter_overrides, ...).
    """

    COMPONENT: ClassVar[str] = "state"  # component that the diagnostics of the node describe
    STATES: ClassVar[type[states.NodeWord]]
    """Enumeration of `impact_rig.states` whose words are the states of this node in diagnostics."""
    MAKES_TIME: ClassVar[bool] = False  # whether the node publishes the clock, so it cannot follow another one

    def __init__(self, name: str, tree: Tree[S], **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.is_ending: Callable[[], bool] = lambda: False
        """Function that returns whether this process is about to end; the node then publishes no more diagnostics.

        Other nodes often end at the same time, and a report that they are missing would mislead.
        """
        self.quitting = False  # whether a client has requested the end of the process
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.refusals = Refusals()
        self.frame_prefix = graph.frame_prefix(self.get_namespace())
        """Prefix of the frame names in published messages, made from the namespace: the frames of two rigs differ."""
        arguments = kwargs.get("cli_args") or sys.argv
        self.parameters = Parameters(self, tree, arguments, self.MAKES_TIME, self.complete)
        self.outputs: dict[str, Publisher] = {}  # publishers by topic, created by `offer`; destroyed at clean-up
        self.activation = contextlib.ExitStack()
        """Timers and subscriptions that exist while the node is active: they are destroyed after `deactivate`."""
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._proposed: Proposal[S] | None = None
        self._guard_transitions()
        self._cpu = CpuMeter()
        self._last_error: tuple[float, str] = (-ERROR_MEMORY_S, "")
        self._configure_error = ""  # why the node is not configured; empty without an error
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
        """Build the parts of the node and create its publishers, at the lifecycle transition `configure`.

        After an exception, the transition fails, and `deactivate` and `cleanup` are called. The exception is logged.
        """

    def activate(self) -> None:
        """Start the node's work, at the lifecycle transition `activate`; after an exception, `deactivate` is called."""

    def deactivate(self) -> None:
        """Stop the node's work; the publishers created by `offer` stay.

        This method may also be called while the node is not active. An exception is logged, and the node is deactivated
        nevertheless.
        """

    def cleanup(self) -> None:
        """Free what `configure` created.

        This method must also work if `configure` failed midway. The base class then destroys the publishers created by
        `offer`.
        """

    def settings_changed(self, settings: S, changes: dict[str, Any]) -> None:
        """Apply new, validated settings to the node.

        An exception rejects the settings: all parameters keep their values. Before the method raises an exception, it
        must undo what it has applied.

        Args:
            settings: all parameters with their new values.
            changes: the values that differ from the present ones, by parameter name.
        """

    def doing(self) -> NodeState:
        """Return the state of the active node for diagnostics: a word of `STATES`, with its reason.

        The method must be fast, because it is called about ten times a second. It is called only while the node is
        active.
        """
        raise NotImplementedError

    def health(self) -> tuple[Level, str]:
        """Return level and message of the node's diagnostics; called about ten times a second in any state."""
        return Level.OK, self.state

    def figures(self) -> Mapping[str, object]:
        """Return the values that the node adds to its diagnostics, by key; called for each report in any state."""
        return {}

    def complete(self, settings: S) -> S:
        """Return the start-up settings with values filled in that only the node knows, such as its namespace.

        This base class returns the settings unchanged.
        """
        return settings

    def autostarts(self) -> bool:
        """Return whether the node configures and activates itself at start: parameter `autostart`, True without it."""
        return bool(getattr(self.settings, "autostart", True))

    def rig_time_ns(self) -> int | None:
        """Return the stamp of the node's diagnostics [ns], or None if there is no rig time yet.

        A stamp of None is published as 0. This base class returns the time of the node's clock. A subclass that reads a
        rig returns the rig's time.
        """
        return int(self.get_clock().now().nanoseconds)

    # Helpers for subclasses

    @property
    def settings(self) -> S:
        """Present values of all parameters, as one immutable object."""
        return self.parameters.settings

    @property
    def state(self) -> str:
        """Label of the node's lifecycle state, such as `inactive` or `active`."""
        return rclpy_internals.lifecycle_state(self)

    @property
    def active(self) -> bool:
        """Return whether the node is in the lifecycle state `active`."""
        return self.state == "active"

    def why_not_active(self) -> str:
        """Return the lifecycle state of an inactive node and how to activate it, for error messages."""
        remedies = {"unconfigured": "configure and activate it first", "finalized": "start its program again"}
        return f"{self.state}: {remedies.get(self.state, 'activate it first')}"

    def create_service(self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **options: Any) -> Any:
        """Create a service that answers a request even if its callback raises; the exception is logged and counted.

        `guarded_answer` describes the answer. rclpy's own services (parameters) are created by this method, too.
        """
        reason = "parameter" if "parameter" in srv_name else srv_name.removeprefix("~/")
        if srv_type is SetParameters:
            callback = self._on_set_request
        safe = guarded_answer(callback, lambda message: self.refuse(reason, message))
        return super().create_service(srv_type, srv_name, safe, **options)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., None], *args: Any, **options: Any
    ) -> Any:
        """Create a subscription whose callback cannot end the node: an exception is logged and shown in diagnostics.

        rclpy's own subscriptions (/clock) are created by this method, too.
        """
        return super().create_subscription(msg_type, topic, guarded(callback, self.report_failure), *args, **options)

    def steady_timer(self, period_s: float, callback: Callable[[], None]) -> Any:
        """Create a timer that calls `callback` every `period_s` seconds of the monotonic clock.

        Simulated time and changes of the system clock do not affect the timer. An exception in `callback` is logged and
        shown in diagnostics.
        """
        return self.create_timer(period_s, guarded(callback, self.report_failure), clock=self.steady)

    def every(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call `callback` every `period_s` seconds, by a `steady_timer`, until the node is deactivated."""
        self.activation.callback(self.destroy_timer, self.steady_timer(period_s, callback))

    def offer(self, *chosen: topics.Topic) -> None:
        """Create the publishers of these topics, for `send`; they exist until the node is cleaned up."""
        self.outputs |= {topic.name: self.publisher(topic) for topic in chosen}

    def send(self, topic: topics.Topic, message: Any) -> None:
        """Publish a message, or its CDR (serialised) bytes, on a topic whose publisher `offer` has created.

        An inactive node publishes the message, too.
        """
        self.outputs[topic.name].publish(message)

    def send_table(self, topic: topics.Topic, table: Table) -> None:
        """Publish a table on a topic whose publisher `offer` has created, with this rig's prefix of the frame name."""
        self.send(topic, codec.encode(table, self.frame_prefix))

    def adopt_frame(self, info: Table) -> None:
        """Adopt the frame prefix of a `daq/info` table, so that results name the same frame as their scans.

        A table whose frame name does not end with `daq` has no effect.
        """
        if info.frame_id.endswith(FRAME_DAQ):
            self.frame_prefix = info.frame_id.removesuffix(FRAME_DAQ)

    def until_deactivated(self, *subscriptions: Any) -> None:
        """Destroy these subscriptions when the node is deactivated."""
        for subscription in subscriptions:
            self.activation.callback(self.destroy_subscription, subscription)

    def publisher(self, topic: topics.Topic, depth: int | None = None) -> Publisher:
        """Create the publisher of a topic; ROS parameters (`qos_overrides`) can change its quality of service.

        Args:
            topic: entry of `impact_rig.topics`.
            depth: number of messages kept for a slow subscriber (default: that of the topic).
        """
        return self.create_publisher(
            messages.class_of(topic),
            topic.name,
            messages.profile(topic.qos, depth),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def subscribe(
        self, topic: topics.Topic, callback: Callable[..., None], raw: bool = False, depth: int | None = None
    ) -> Any:
        """Create a subscription to a topic; an exception in `callback` is logged and shown in diagnostics.

        The subscription outlives deactivation and clean-up, unless you pass it to `until_deactivated`.

        Args:
            topic: entry of `impact_rig.topics`.
            callback: called with each message. If it takes two arguments, it also gets the info of the message.
            raw: whether `callback` gets the message as CDR (serialised) bytes.
            depth: length of the queue (default: that of the topic).
        """
        return self.create_subscription(
            messages.class_of(topic),
            topic.name,
            callback,
            messages.profile(topic.qos, depth),
            raw=raw,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def subscribe_table(self, topic: topics.Topic, callback: Callable[[Table], None]) -> Any:
        """Create a subscription to a topic that carries tables; `callback` gets each decoded table.

        Invalid messages are logged and counted as rejected. So are tables for which `callback` raises an
        ImpactRigError. The subscription outlives deactivation and clean-up, unless you pass it to `until_deactivated`.
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
        """Decode the CDR bytes of a received table; return None (logged and counted) if they are invalid."""
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
        """Create a service of `std_srvs` that may answer a request later; use private names (`~/name`).

        Diagnostics are published at once if a request changes the node's state.

        Args:
            service_type: `Trigger` or `SetBool`.
            name: service name.
            on_request: called with each request and a function that answers it, now or later. Only the first answer is
                sent. An exception answers the request without success and with the message of the exception. Exceptions
                other than ImpactRigError are also reported by `report_failure`. Answers without success are logged and
                counted.
            check_sent: called before `on_request` with the system time at which the request was sent [ns]; raises an
                ImpactRigError to reject the request.
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
        """Log an exception of the callback `where` as an error, and show it in diagnostics for 5 s (wall time).

        Every exception is counted, but at most one per second and callback is logged.
        """
        self._last_error = (time.monotonic(), f"{where}: {message}")
        self.refusals.add("exception", message)
        self.warn_throttled(f"exception in {where}", f"exception in {where}: {message}", error=True)

    def refuse(self, reason: str, message: str) -> None:
        """Count a rejected input under `reason`, for diagnostics; log a warning at most once per second and reason."""
        self.refusals.add(reason, message)
        self.warn_throttled(reason, f"refused ({reason}): {message}")

    def warn_throttled(self, key: str, message: str, error: bool = False) -> None:
        """Log a warning (or an error, if `error`), unless one with the same `key` was logged within the last second."""
        now = time.monotonic()
        if now - self._warned.get(key, -WARN_PERIOD_S) >= WARN_PERIOD_S:
            self._warned[key] = now
            logger, text = self.get_logger(), one_line(message)
            logger.error(text) if error else logger.warning(text)

    # Lifecycle: every transition is guarded and logs the reason of a failure

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Run `configure` at a lifecycle transition; return FAILURE and log why if it fails.

        It also fails if the start-up parameters are invalid.
        """
        self._last_error, self._configure_error = (-ERROR_MEMORY_S, ""), ""
        if self.parameters.refused is not None:
            return self._failed("configure", self.parameters.refused)
        done = self._transition("configure", self.configure, undo=self._free)
        if done == TransitionCallbackReturn.SUCCESS:
            self.get_logger().info("node configured")
        return done

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `activate` at a lifecycle transition; if it fails, deactivate the node, log why and return FAILURE."""
        self._instance = secrets.token_hex(INSTANCE_BYTES)
        done = self._transition("activate", self.activate, undo=self._stop)
        if done != TransitionCallbackReturn.SUCCESS:
            return done
        self.get_logger().info("node active")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `deactivate` at a lifecycle transition, and destroy the timers and subscriptions of the activation.

        The transition succeeds even if `deactivate` raises an exception, which is logged.
        """
        self._transition("deactivate", self._stop)
        self.get_logger().info("node deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the node's work and free what `configure` created, in any state.

        Shutdown and error transitions use this method, too. An exception is logged, and the result is then FAILURE.
        """
        return self._transition("clean up", self._free)

    on_shutdown = on_cleanup
    on_error = on_cleanup

    def close(self) -> None:
        """Stop the node's work and free what `configure` created, before the process ends.

        It works even if ROS is already shut down.
        """
        self._transition("clean up", self._free)
        self.get_logger().info("node ended")

    def destroy_node(self) -> None:
        """Destroy the node and its lifecycle state machine, so that the node disappears from the ROS graph."""
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
        message = f"cannot {what}: {reason_of(error)}"
        if what == "configure":
            self._configure_error = message
        else:
            self._last_error = (time.monotonic(), message)
        self.get_logger().error(one_line(message))
        return TransitionCallbackReturn.FAILURE

    def _guard_transitions(self) -> None:
        """Make the node answer an invalid transition request with `success = False`, and count it as rejected.

        Without this, rclpy of Jazzy would raise an exception that ends the process; rclpy of Kilted answers likewise.
        """
        service = rclpy_internals.change_state_service(self)
        original = service.callback

        def on_change_state(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            wanted = request.transition.label or str(request.transition.id)
            try:
                if rclpy_internals.is_possible(self, request.transition):
                    return original(request, response)
                self.refuse(
                    "transition",
                    f"transition {wanted!r} is not possible in lifecycle state {self.state!r}: `ros2 lifecycle list "
                    f"{self.get_fully_qualified_name()}` shows those that are",
                )
            except Exception as error:  # rclpy raises RCLError, which is not exported
                self.refuse("transition", f"transition {wanted!r} failed in lifecycle state {self.state!r}: {error}")
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
        """Validate and set all of these parameters, or none; a rejection is logged and counted.

        rclpy's service `set_parameters_atomically` uses this method.
        """
        result = self._attempt(parameter_list)
        if not result.successful:
            self.refuse("parameter", result.reason)
        return result

    def _attempt(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Validate and set all of these parameters, or none; a rejection is returned but not logged or counted."""
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
        """Validate and set the parameters one after the other; a rejected parameter does not affect the others.

        This method is for calls within this process. The service `set_parameters` uses `set_one_by_one` instead, which
        tries rejected parameters again.
        """
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
        """Publish diagnostics now if the word of the node's state differs from the last published one.

        Nothing is published while the process ends.
        """
        if self.present().word != self._word and not self.is_ending():
            self.report_now()

    def present(self) -> NodeState:
        """Return the node's present state for diagnostics, in any lifecycle state.

        An active node returns the result of `doing`. Otherwise, the word is `inactive`, and the reason is the lifecycle
        state. A recent error, or an error that prevented `configure`, is appended to the reason.
        """
        if self.active:
            return self.doing()
        errors = "; ".join(self._errors())
        return NodeState(self.STATES("inactive"), f"{self.state}: {errors}" if errors else self.state)

    def report_now(self) -> None:
        """Publish the node's diagnostics now: level, message, state and figures."""
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
            level=bytes([level]),
            name=f"{self.get_fully_qualified_name().lstrip('/')}: {self.COMPONENT}",
            message=one_line(message),
            hardware_id=f"impact_rig{self.get_namespace()}".rstrip("/"),
            values=[
                KeyValue(key=one_line(key), value=f"{value:.6g}" if isinstance(value, float) else one_line(str(value)))
                for key, value in values.items()
            ],
        )
        array = DiagnosticArray(status=[one])
        array.header.stamp = messages.time_message(now_ns or 0)
        self._diagnostics.publish(array)

    def _judged(self) -> tuple[Level, str]:
        """Return level and message for diagnostics: those of `health`, or the level ERROR with a current error.

        If `health` has the level ERROR, too, all messages are returned.
        """
        return worst(self.health(), *((Level.ERROR, message) for message in self._errors()))

    def _errors(self) -> list[str]:
        """Return the error that prevented `configure` and one of the last five seconds, if there are any."""
        at, message = self._last_error
        recent = message if time.monotonic() - at < ERROR_MEMORY_S else ""
        return [error for error in (self._configure_error, recent) if error]


class LateService:
    """Service of any type that may answer a request after its callback has returned, under any executor.

    rclpy sends the response that a callback returns. Here the callback returns a placeholder, and the request's header
    is kept until the answer is known and sent.

    Args:
        on_request: called with each request, the system time at which it was sent [ns], and a function that sends its
            response. Only the first response is sent. `on_request` must not raise. If the middleware does not provide
            the time of sending, the time of receipt is passed.
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
        is_answered = False

        def send(response: Any) -> None:
            nonlocal is_answered
            if not is_answered:  # a handler may raise, which is answered, too, after it has answered or promised to
                self._send(response, header)  # of an error, the answer may still be sent
                is_answered = True

        self._on_request(self._request, sent_ns, send)
