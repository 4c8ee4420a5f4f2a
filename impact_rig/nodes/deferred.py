"""A service that answers later, whatever executor runs it.

rclpy wants a response from the callback, and its executors differ: the events executor takes no coroutines, the others
resume them only when something else wakes them. All of them hand the returned response to `Service.send_response`
together with the request's header. So the callback returns a marker, and the wrapped `send_response` keeps the header
until `reply`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any  # rclpy handles, requests

from impact_rig.nodes.guard import describe
from impact_rig.nodes.managed import ManagedNode

Answer = tuple[bool, str]
"""`success` and `message` of `std_srvs/Trigger` and `std_srvs/SetBool`."""


class DeferredService:
    """A service of `std_srvs` whose requests may be answered by `reply`.

    Args:
        node: owner; counts refusals.
        service_type: `Trigger` or `SetBool`.
        name: service name.
        accept: called with each request; returns None to defer the answer, or the answer to give at once. It must not
            raise.
        registered: called once a deferred request is known, so that it may be answered; work begins here.
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
        self._waiting: list[Any] = []
        self._service = node.create_service(service_type, name, self._on_request)
        self._send = self._service.send_response
        self._service.send_response = self._send_or_keep
        self._marker = service_type.Response()

    @property
    def waiting(self) -> int:
        """Requests not answered yet."""
        return len(self._waiting)

    def reply(self, success: bool, message: str) -> None:
        """Answer every waiting request."""
        waiting, self._waiting = self._waiting, []
        for header in waiting:
            if not success:
                self._refuse(message)
            self._send(self._type.Response(success=success, message=message), header)

    def _on_request(self, request: Any, _response: Any) -> Any:
        try:
            answer = self._accept(request)
        except Exception as error:  # as `guarded_service`: nothing a request causes may end the process
            answer = False, describe(error)
        if answer is None:
            return self._marker
        success, message = answer
        if not success:
            self._refuse(message)
        return self._type.Response(success=success, message=message)

    def _send_or_keep(self, response: Any, header: Any) -> None:
        if response is self._marker:
            self._waiting.append(header)
            self._registered()
        else:
            self._send(response, header)
