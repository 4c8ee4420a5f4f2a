# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Services that answer later, whatever executor runs them.

rclpy wants a response from the callback, and its executors differ: the events executor takes no coroutines, the others
resume them only when something else wakes them. All of them hand the returned response to `Service.send_response`
together with the request's header. So the callback returns a marker, and the wrapped `send_response` keeps the header
until there is an answer.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any  # rclpy handles, requests

from impact_rig.nodes.guard import describe
from impact_rig.nodes.managed import ManagedNode

Answer = tuple[bool, str]
"""`success` and `message` of `std_srvs/Trigger` and `std_srvs/SetBool`."""
Done = Callable[[bool, str], None]
"""Takes `success` and `message`, once."""


class LateService:
    """A service of any type whose requests are answered by a call, at once or later.

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
