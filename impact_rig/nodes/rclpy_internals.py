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
"""Access to private parts of rclpy, all in this module, and an events executor built from them.

rclpy has no public access to the start-up overrides of parameters, the state machine of a lifecycle node, the messages
in a subscription, or the base class of the events executor. The functions here support rclpy of Jazzy (7) and Kilted
(9). With any other version, nodes use rclpy's public executor (see `events_executor`).

The events executor of rclpy never polls. It may miss a message that arrives while it starts to listen to a
subscription, and reports that message only with the next one (since https://github.com/ros2/rmw_fastrtps/pull/657). A
message that is sent once, such as the calibration, would stay unreported. The executor here therefore polls each new
entity once.
"""

from __future__ import annotations

import contextlib
import faulthandler
import importlib.metadata
import inspect
import traceback
import weakref
from collections.abc import Callable, Iterator
from typing import Any  # rclpy is untyped

from rclpy.client import Client
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.qos import HistoryPolicy
from rclpy.subscription import Subscription

KNOWN = ("7.", "9.")
"""Beginnings of the rclpy versions whose private parts are as this module expects: Jazzy and Kilted."""
EventsExecutor: Any = getattr(rclpy_implementation, "EventsExecutor", object)  # absent before rclpy 7.1.2
InvalidHandle: Any = rclpy_implementation.InvalidHandle
WITH_INFO = Subscription.CallbackType.WithMessageInfo
MOST = 1000  # maximum number of items processed in one poll, for a queue without a limit


def parameter_overrides(node: Any) -> dict[str, Any]:
    """Return the parameter values given to a node at start (by file, command line or argument), by parameter name.

    rclpy would validate one value at a time. With all values together, values that depend on each other can be
    validated as one combination.
    """
    return {name: parameter.value for name, parameter in node._parameter_overrides.items()}


def lifecycle_state(node: Any) -> str:
    """Return the label of a node's lifecycle state."""
    return str(node._state_machine.current_state[1])


def is_possible(node: Any, transition: Any) -> bool:
    """Return whether a node's present state allows a requested lifecycle transition, given by label or by number."""
    available = [(number, label) for number, label, *_states in node._state_machine.available_transitions]
    wanted = transition.label or transition.id
    return any(wanted in one for one in available)


def change_state_service(node: Any) -> Any:
    """Return the service object of a lifecycle node that receives the requests for transitions."""
    return node._service_change_state


def destroy_state_machine(node: Any) -> None:
    """Destroy the lifecycle state machine of a node that has been destroyed.

    Without this call, the node would stay in the ROS graph.
    """
    node._state_machine.destroy_when_not_in_use()


def take_messages(subscription: Any, raw: bool = False) -> Iterator[Any]:
    """Take the messages that wait in a subscription, and yield them; its callback is not called.

    With `raw`, the messages are CDR bytes.
    """
    with contextlib.suppress(InvalidHandle), subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, raw)) is not None:
            yield taken[0]


def events_executor(context: Any) -> Any:
    """Return a new events executor for a ROS context; None if this version of rclpy has none or is not supported."""
    version = importlib.metadata.version("rclpy")
    if EventsExecutor is object or not version.startswith(KNOWN):
        return None
    return PollingEventsExecutor(context)


class PollingEventsExecutor(EventsExecutor):
    """Events executor that misses nothing while it starts to listen to a new subscription, service or client."""

    def __init__(self, context: Any) -> None:
        super().__init__(context)
        faulthandler.enable()  # this line and the next as in `rclpy.experimental.EventsExecutor`
        context.on_shutdown(self._wake)
        self._known: weakref.WeakSet[Any] = weakref.WeakSet()

    def add_node(self, node: Any) -> bool:
        """Run the callbacks of a node from now on; return False if it was added before."""
        added = bool(super().add_node(node))
        self._watch_soon()
        return added

    def remove_node(self, node: Any) -> None:
        """Stop running a node's callbacks."""
        super().remove_node(node)
        self._watch_soon()

    def wake(self) -> None:
        """Start listening to newly created subscriptions, services and clients; rclpy calls this method."""
        super().wake()
        self._watch_soon()

    def _wake(self) -> None:
        super().wake()

    def _watch_soon(self) -> None:
        """Schedule one poll of each new subscription, service and client.

        The poll runs after the executor has started to listen, because the executor processes requests in order.
        """
        nodes = self.get_nodes()
        found = {one for node in nodes for one in (*node.subscriptions, *node.services, *node.clients)}
        for entity in found.difference(self._known):
            self.create_task(_watch, weakref.ref(entity))
        self._known = weakref.WeakSet(found)


async def _watch(reference: weakref.ref[Any]) -> None:
    """Process the items that a subscription, service or client holds now, because the executor may not report them.

    An item that the executor reports as well is processed only once.
    """
    entity = reference()
    if entity is None:
        return
    qos = entity.qos_profile
    endless = qos.history == HistoryPolicy.KEEP_ALL
    for _ in range(MOST if endless else qos.depth or MOST):  # more items arrive and are reported meanwhile
        try:
            hand_over = _taken(entity)
            if hand_over is None:
                return
            result = hand_over()
            if inspect.isawaitable(result):
                await result
        except Exception:  # an exception that leaves a task of this executor ends the process in the middleware
            get_logger("executor").error(traceback.format_exc())


def _taken(entity: Any) -> Callable[[], Any] | None:
    """Take the next item that a subscription, service or client holds; return a function that processes it.

    The function calls the callback or, for a client, sets the result of the request's future. If it returns an
    awaitable, the caller must await it. The result is None if there is no item, or if the entity is already destroyed.
    """
    handle = entity.handle
    try:
        with handle:
            if isinstance(entity, Subscription):
                message = handle.take_message(entity.msg_type, entity.raw)
                return message and (lambda: call_subscription(entity, message))
            if isinstance(entity, Client):
                header, response = handle.take_response(entity.srv_type.Response)
                return header and (lambda: _answer(entity, header, response))
            request, header = handle.service_take_request(entity.srv_type.Request)
            return header and (lambda: _serve(entity, request, header))
    except InvalidHandle:  # already destroyed
        return None


def call_subscription(subscription: Any, message: tuple[Any, Any]) -> Any:
    """Call a subscription's callback with (message, info), or only with the message if the callback takes one argument.

    Returns:
        What the callback returns: a coroutine if the callback is a coroutine function.
    """
    return subscription.callback(*(message if subscription._callback_type is WITH_INFO else message[:1]))


def call_timer(timer: Any) -> Any:
    """Mark a timer as called, and call its callback.

    The timer is next due a whole number of periods after the time at which it was due, at the first such time after
    now.

    Returns:
        What the callback returns: a coroutine if the callback is a coroutine function.
    """
    timer.handle.call_timer()
    return timer.callback()


def _answer(client: Any, header: Any, response: Any) -> None:
    try:
        future = client.get_pending_request(header.request_id.sequence_number)
    except KeyError:  # its client has given up
        return
    future.set_result(response)


async def _serve(service: Any, request: Any, header: Any) -> None:
    response = service.callback(request, service.srv_type.Response())
    service.send_response(await response if inspect.isawaitable(response) else response, header)
