# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""rclpy's events executor, which looks once for itself at whatever is new to it.

It runs callbacks when the middleware tells it that something has come, and never looks by itself. rmw_fastrtps counts
what a new reader holds, and from then on tells of every message; but what comes between the two is told with the next
one only (since https://github.com/ros2/rmw_fastrtps/pull/657). Mostly that takes less than a microsecond, and
milliseconds where the thread has to wait for a core. Of what comes once, such as the calibration, there is no next.
"""

from __future__ import annotations

import faulthandler
import traceback
import weakref
from collections.abc import Callable
from typing import Any  # rclpy is untyped

import rclpy.experimental.events_executor  # noqa: F401  # absent before rclpy 7.1.2
from rclpy.client import Client
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.qos import HistoryPolicy
from rclpy.subscription import Subscription

EventsExecutor: Any = rclpy_implementation.EventsExecutor
InvalidHandle: Any = rclpy_implementation.InvalidHandle
WITH_INFO = Subscription.CallbackType.WithMessageInfo
MOST = 1000  # things handed over at once by a look, where a queue has no end


class LookingExecutor(EventsExecutor):
    """An events executor that misses nothing of what comes while it begins to listen."""

    def __init__(self, context: Any) -> None:
        super().__init__(context)
        faulthandler.enable()  # this and the next as `rclpy.experimental.EventsExecutor` does
        context.on_shutdown(self._wake)
        self._known: weakref.WeakSet[Any] = weakref.WeakSet()

    def add_node(self, node: Any) -> bool:
        """Run a node's callbacks from now on."""
        added = bool(super().add_node(node))
        self._look_soon()
        return added

    def remove_node(self, node: Any) -> None:
        """Run a node's callbacks no longer."""
        super().remove_node(node)
        self._look_soon()

    def wake(self) -> None:
        """Begin to listen to what nodes have that is new."""
        super().wake()
        self._look_soon()

    def _wake(self) -> None:
        super().wake()

    def _look_soon(self) -> None:
        """Look at what is new once it is listened to: that is asked for by now, and done in the order of asking."""
        nodes = self.get_nodes()
        found = {one for node in nodes for one in (*node.subscriptions, *node.services, *node.clients)}
        for entity in found.difference(self._known):
            self.create_task(_look, weakref.ref(entity))
        self._known = weakref.WeakSet(found)


def _look(reference: weakref.ref[Any]) -> None:
    """Hand over what an entity holds; what was told as well is no longer there when its turn comes."""
    entity = reference()
    if entity is None:
        return
    qos = entity.qos_profile
    endless = qos.history == HistoryPolicy.KEEP_ALL
    for _ in range(MOST if endless else qos.depth or MOST):  # more come, and are told, meanwhile
        try:
            hand_over = _taken(entity)
            if hand_over is None:
                return
            hand_over()
        except Exception:  # one that leaves a task of this executor ends the process in the middleware
            get_logger("executor").error(traceback.format_exc())


def _taken(entity: Any) -> Callable[[], None] | None:
    """Take the next thing that an entity holds, and return what does with it what any executor does."""
    handle = entity.handle
    try:
        with handle:
            if isinstance(entity, Subscription):
                message = handle.take_message(entity.msg_type, entity.raw)
                return message and (lambda: _call(entity, message))
            if isinstance(entity, Client):
                header, response = handle.take_response(entity.srv_type.Response)
                return header and (lambda: _answer(entity, header, response))
            request, header = handle.service_take_request(entity.srv_type.Request)
            return header and (lambda: _serve(entity, request, header))
    except InvalidHandle:  # it is gone already
        return None


def _call(subscription: Any, message: tuple[Any, Any]) -> None:
    subscription.callback(*(message if subscription._callback_type is WITH_INFO else message[:1]))


def _answer(client: Any, header: Any, response: Any) -> None:
    try:
        future = client.get_pending_request(header.request_id.sequence_number)
    except KeyError:  # nobody waits for it any more
        return
    future.set_result(response)


def _serve(service: Any, request: Any, header: Any) -> None:
    service.send_response(service.callback(request, service.srv_type.Response()), header)
