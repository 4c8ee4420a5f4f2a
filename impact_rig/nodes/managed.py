# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`ManagedNode`: the lifecycle node all nodes of the rig are made of.

It configures and activates itself (`autostart`), survives invalid transition requests and callback exceptions (both end
a plain Jazzy Python node), takes parameters through one validator, and reports at 1 Hz and on change. A subclass fills
in what happens on configure, activate, deactivate and clean up. Its services may answer later (`DeferredService`).
"""

from __future__ import annotations

import enum
import functools
import secrets
import sys
import time
from collections.abc import Callable
from typing import Any, ClassVar, Generic, TypeVar  # rclpy is untyped

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos_overriding_options import QoSOverridingOptions

from impact_rig import codec, states, topics
from impact_rig.blocks import Table
from impact_rig.errors import CodecError, ImpactRigError, visible
from impact_rig.nodes import diagnostics, messages
from impact_rig.nodes.diagnostics import CpuMeter, Health, Level, State
from impact_rig.nodes.guard import Refusals, describe, guarded, guarded_answer, guarded_service, in_words
from impact_rig.nodes.parameters import Parameters, Schema, set_one_by_one

S = TypeVar("S")

Answer = tuple[bool, str]
"""`success` and `message` of `std_srvs/Trigger` and `std_srvs/SetBool`."""
Done = Callable[[bool, str], None]
"""Takes `success` and `message`, once."""

DIAGNOSTICS_PERIOD_S = 1.0
CHANGE_PERIOD_S = 0.1
"""How soon a change of level or message is reported, and one of state that nobody asked for; also how often the first
may be."""
INSTANCE_BYTES = 8
ERROR_MEMORY_S = 5.0
"""An exception of a callback is shown in diagnostics this long."""
WARN_PERIOD_S = 1.0
"""Least time between two warnings of one reason."""


class ManagedNode(LifecycleNode, Generic[S]):
    """A lifecycle node with guards, validated parameters and diagnostics.

    Args:
        name: node name.
        schema: the node's parameters.
        kwargs: passed to rclpy's Node (context, namespace, parameter_overrides, ...).
    """

    COMPONENT: ClassVar[str] = "state"
    """What of the node its diagnostics are about."""
    STATES: ClassVar[type[states.Rig | states.Analysis | states.Recorder | states.SteppedSine]]
    """The words for what the node does."""
    MAKES_TIME: ClassVar[bool] = False
    """Whether its clock is what others follow, so that it can follow nobody's."""

    def __init__(self, name: str, schema: Schema[S], **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.is_told_to_end: Callable[[], bool] = lambda: False
        """Whether the process is about to end: that others end as well is no news then."""
        self.quitting = False
        """Whether a client asked for the end of the process."""
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.refusals = Refusals()
        self.parameters = Parameters(self, schema, kwargs.get("cli_args") or sys.argv, self.MAKES_TIME)
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._proposed: S | None = None
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

    # What a subclass fills in

    def configure(self) -> None:
        """Build what the node needs and create its publishers; ImpactRigError refuses with its message."""

    def activate(self) -> None:
        """Begin to work."""

    def deactivate(self) -> None:
        """Stop working; configuration stays."""

    def cleanup(self) -> None:
        """Free what `configure` made; must not fail when that failed half-way."""

    def settings_changed(self, settings: S, changes: dict[str, Any]) -> None:
        """Take validated new settings; an exception refuses the set."""

    def settings_in_force(self) -> None:
        """Follow up once the new settings are in `self.settings`."""

    def doing(self) -> State:
        """Return what the node does, from data alone; asked only while it is active, and often."""
        raise NotImplementedError

    def status(self) -> Health:
        """Return level, sentence and figures for diagnostics, whatever lifecycle state it is in."""
        return Health(Level.OK, self.state, {})

    def autostarts(self) -> bool:
        """Say whether the node configures and activates itself."""
        return True

    def rig_time_ns(self) -> int | None:
        """Return the time that stamps diagnostics: rig time in a node that follows it, here the node's clock.

        None: there is no rig time yet.
        """
        return int(self.get_clock().now().nanoseconds)

    # Helpers for subclasses

    @property
    def settings(self) -> S:
        """The parameters as one frozen value."""
        return self.parameters.settings

    @property
    def state(self) -> str:
        """Label of the lifecycle state."""
        return str(self._state_machine.current_state[1])

    @property
    def active(self) -> bool:
        """Whether the node is in the lifecycle state `active`."""
        return self.state == "active"

    def create_service(self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **options: Any) -> Any:
        """Create a service, guarded: also those that rclpy makes for itself (parameters)."""
        reason = "parameter" if "parameter" in srv_name else srv_name.removeprefix("~/")
        if srv_type is SetParameters:
            callback = self._on_set_request
        safe = guarded_answer(callback, lambda message: self.refuse(reason, message))
        return super().create_service(srv_type, srv_name, safe, **options)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., None], *args: Any, **options: Any
    ) -> Any:
        """Create a subscription, guarded: also those that rclpy makes for itself (/clock)."""
        return super().create_subscription(msg_type, topic, guarded(callback, self.report_failure), *args, **options)

    def steady_timer(self, period_s: float, callback: Callable[[], None]) -> Any:
        """Create a guarded timer on the monotonic clock: neither sim time nor a clock step moves it."""
        return self.create_timer(period_s, guarded(callback, self.report_failure), clock=self.steady)

    def publisher(self, topic: topics.Topic, depth: int | None = None) -> Publisher:
        """Create the publisher of a row of the topics table, perhaps less deep; `qos_overrides` parameters apply."""
        profile = messages.profile(topic.qos)
        if depth is not None:
            profile.depth = min(depth, profile.depth)
        return self.create_publisher(
            messages.class_of(topic),
            topic.name,
            profile,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def subscribe(
        self, topic: topics.Topic, callback: Callable[..., None], raw: bool = False, depth: int | None = None
    ) -> Any:
        """Create a guarded subscription to a row of the topics table, perhaps deeper; `raw` gives CDR bytes."""
        profile = messages.profile(topic.qos)
        profile.depth = depth or profile.depth
        return self.create_subscription(messages.class_of(topic), topic.name, callback, profile, raw=raw)

    def subscribe_table(self, topic: topics.Topic, callback: Callable[[Table], None]) -> Any:
        """Create a guarded subscription to a table; what is none, or what `callback` refuses, is told and counted."""

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
        """Return the table in a message of anybody's; None if it is none of this topic, which is told and counted."""
        try:
            return codec.decode(data, topic)
        except CodecError as error:
            self.refuse(topic.name, str(error))
            return None

    def service(self, service_type: Any, name: str, callback: Callable[[Any, Any], Any]) -> Any:
        """Create a guarded service; private names (`~/name`) are the convention.

        What a call changes is reported at once.
        """
        safe = guarded_service(callback, self.report_failure, self.refuse)

        @functools.wraps(callback)
        def serve(request: Any, response: Any) -> Any:
            try:
                return safe(request, response)
            finally:
                self.report_change()

        return self.create_service(service_type, name, serve)

    def report_failure(self, where: str, message: str) -> None:
        """Log an exception that a guard caught, and show it in diagnostics."""
        self._last_error = (time.monotonic(), f"{where}: {message}")
        self.refusals.add("exception", message)
        self.warn_throttled(f"exception in {where}", f"exception in {where}: {message}", error=True)

    def refuse(self, reason: str, message: str) -> None:
        """Count a refused input and warn, at most once per second and reason."""
        self.refusals.add(reason, message)
        self.warn_throttled(reason, f"refused ({reason}): {message}")

    def warn_throttled(self, key: str, message: str, error: bool = False) -> None:
        """Log, at most once per second and key."""
        now = time.monotonic()
        if now - self._warned.get(key, -WARN_PERIOD_S) >= WARN_PERIOD_S:
            self._warned[key] = now
            logger, text = self.get_logger(), visible(message)
            logger.error(text) if error else logger.warning(text)

    # Lifecycle: every transition is guarded and says why it failed

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Build the node's parts; FAILURE with the reason in the log if the parameters do not allow it."""
        if self.parameters.refused is not None:
            return self._failed("configure", self.parameters.refused)
        self._last_error = (-ERROR_MEMORY_S, "")
        done = self._transition("configure", self.configure, undo=self.cleanup)
        if done == TransitionCallbackReturn.SUCCESS:
            self.get_logger().info("configured")
        return done

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to work."""
        self._instance = secrets.token_hex(INSTANCE_BYTES)
        done = self._transition("activate", self.activate, undo=self.deactivate)
        if done != TransitionCallbackReturn.SUCCESS:
            return done
        self.get_logger().info("active")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working."""
        self._transition("deactivate", self.deactivate)
        self.get_logger().info("deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Free everything."""
        return self._transition("clean up", self.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and free everything, from any state."""
        if state.label == "active":
            self._transition("deactivate", self.deactivate)
        return self._transition("clean up", self.cleanup)

    def on_error(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Free everything; the node is unconfigured and can be configured again."""
        return self._transition("clean up", self.cleanup)

    def close(self) -> None:
        """Stop working before the process ends, without ROS if it is already down."""
        if self.active:
            self._transition("deactivate", self.deactivate)
        self._transition("clean up", self.cleanup)
        self.get_logger().info("ended")

    def destroy_node(self) -> None:
        """Destroy the node with its state machine, which rclpy forgets: that would keep the node in the graph."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    def _transition(
        self, what: str, action: Callable[[], None], undo: Callable[[], None] | None = None
    ) -> TransitionCallbackReturn:
        try:
            action()
        except Exception as error:  # a transition must end in a lifecycle state, whatever happened
            if undo is not None:
                self._transition(f"undo {what}", undo)
            return self._failed(what, error)
        return TransitionCallbackReturn.SUCCESS

    def _failed(self, what: str, error: Exception) -> TransitionCallbackReturn:
        message = in_words(error)
        self._last_error = (float("inf") if what == "configure" else time.monotonic(), f"cannot {what}: {message}")
        self.get_logger().error(f"cannot {what}: {message}")
        return TransitionCallbackReturn.FAILURE

    def _guard_transitions(self) -> None:
        """Answer an invalid transition request with `success = False`; rclpy would raise and end the process."""
        service = self._service_change_state
        original = service.callback

        def on_change_state(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            try:
                return original(request, response)
            except Exception as error:  # rclpy raises RCLError, which is not exported
                wanted = request.transition.label or str(request.transition.id)
                self.refuse("transition", f"{wanted!r} is not possible in state {self.state!r} ({error})")
                response.success = False
                return response
            finally:
                self.report_change()

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
        """Set all or none, through the validator; the services and the in-process calls both come here."""
        result = self._attempt(parameter_list)
        if not result.successful:
            self.refuse("parameter", result.reason)
        return result

    def _attempt(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all or none."""
        try:
            stored, self._proposed = self.parameters.check(parameter_list)
            result = super().set_parameters_atomically(stored)
            if result.successful:
                self.parameters.settings = self._proposed
                self.settings_in_force()
                self.report_change()
        except Exception as error:  # a set is refused with its reason, never fatal
            result = SetParametersResult(successful=False, reason=in_words(error))
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
        """Set one after the other, each through the validator."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def _on_set_parameters(self, _parameters: list[Parameter]) -> SetParametersResult:
        if self._proposed is None:  # rclpy declares a parameter of its own (qos_overrides)
            return SetParametersResult(successful=True)
        try:
            changes = self.parameters.changes(self._proposed)
            if changes:
                self.settings_changed(self._proposed, changes)
        except Exception as error:  # a set is refused with its reason, never fatal
            return SetParametersResult(successful=False, reason=in_words(error))
        return SetParametersResult(successful=True)

    # Diagnostics

    def _report_when_due(self) -> None:
        if self.is_told_to_end():
            return
        level, message = self._judged(self.status())
        now = time.monotonic()
        if now - self._reported_at >= DIAGNOSTICS_PERIOD_S or (level, message) != self._reported:
            self.report_now()
        else:
            self.report_change()

    def report_change(self) -> None:
        """Publish the present status if the state is another one than was published last."""
        if self.present().word != self._word and not self.is_told_to_end():
            self.report_now()

    def present(self) -> State:
        """Return what the node does, whatever lifecycle state it is in."""
        if self.active:
            return self.doing()
        at, message = self._last_error
        fresh = time.monotonic() - at < ERROR_MEMORY_S
        return State(self.STATES("inactive"), f"{self.state}: {message}" if fresh else self.state)

    def report_now(self) -> None:
        """Publish the present status."""
        status, state, now_ns = self.status(), self.present(), self.rig_time_ns()
        level, message = self._judged(status)
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
            **status.values,
            **{f"refused.{reason}": count for reason, count in sorted(self.refusals.counts.items())},
            **{f"last_refused.{reason}": text for reason, text in sorted(self.refusals.last.items())},
        }
        full = Health(level, message, values)
        name = f"{self.get_fully_qualified_name().lstrip('/')}: {self.COMPONENT}"
        hardware = f"impact_rig{self.get_namespace()}".rstrip("/")
        self._diagnostics.publish(diagnostics.to_message(name, hardware, full, now_ns or 0))

    def _judged(self, status: Health) -> tuple[Level, str]:
        """Return the node's own status, or the last error while it is fresh."""
        at, message = self._last_error
        if time.monotonic() - at < ERROR_MEMORY_S:
            return diagnostics.worst((status.level, status.message), (Level.ERROR, message))
        return status.level, status.message


class LateService:
    """A service of any type whose requests are answered by a call, at once or later, whatever executor runs it.

    rclpy wants a response from the callback, and its executors differ: the events executor takes no coroutines, the
    others resume them only when something else wakes them. All of them hand the returned response to
    `Service.send_response` together with the request's header. So the callback returns a marker, and the wrapped
    `send_response` keeps the header until there is an answer.

    Args:
        node: owner.
        service_type: of the service.
        name: service name.
        on_request: called with each request and with what sends its response. It must not raise.
    """

    def __init__(
        self,
        node: ManagedNode[Any],
        service_type: Any,
        name: str,
        on_request: Callable[[Any, Callable[[Any], None]], None],
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
        self._on_request(self._request, lambda response: self._send(response, header))


class DeferredService:
    """A service of `std_srvs` whose requests may be answered by `reply`.

    Args:
        node: owner; counts refusals.
        service_type: `Trigger` or `SetBool`.
        name: service name.
        accept: called with each request; returns None to defer the answer, or the answer to give at once.
        registered: called once a deferred request is known, so that it may be answered; work begins here. It must not
            raise.
    """

    def __init__(
        self,
        node: ManagedNode[Any],
        service_type: Any,
        name: str,
        accept: Callable[[Any], Answer | None],
        registered: Callable[[], None],
    ) -> None:
        self._type = service_type
        self._refuse = functools.partial(node.refuse, name.removeprefix("~/"))
        self._accept = accept
        self._registered = registered
        self._waiting: list[Done] = []
        self._service = LateService(node, service_type, name, self._on_request)

    @property
    def waiting(self) -> int:
        """Requests not answered yet."""
        return len(self._waiting)

    def wait(self, done: Done) -> None:
        """Let somebody of this process wait as a client does whose request was deferred."""
        self._waiting.append(done)
        self._registered()

    def reply(self, success: bool, message: str) -> None:
        """Answer every waiting request."""
        waiting, self._waiting = self._waiting, []
        for done in waiting:
            done(success, message)

    def _on_request(self, request: Any, send: Callable[[Any], None]) -> None:
        def done(success: bool, message: str) -> None:
            if not success:
                self._refuse(message)
            send(self._type.Response(success=success, message=message))

        try:
            answer = self._accept(request)
        except Exception as error:  # as `guarded_service`: nothing a request causes may end the process
            answer = False, describe(error)
        if answer is None:
            self.wait(done)
        else:
            done(*answer)
