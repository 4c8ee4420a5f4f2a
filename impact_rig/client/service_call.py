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
"""Service call that repeats a harmless request every 2 s until its response arrives.

On a busy machine, DDS loses the answer to a client that the server has not discovered within 100 ms.
"""

from __future__ import annotations

import time
from typing import Any  # requests and responses

from lifecycle_msgs.srv import GetAvailableStates, GetAvailableTransitions, GetState
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.client import Client as ServiceClient

AGAIN_S = 2.0  # interval after which a repeatable request is sent again
REPEATABLE = (
    DescribeParameters, GetParameters, GetParameterTypes, ListParameters, SetParameters, SetParametersAtomically,
    GetAvailableStates, GetAvailableTransitions, GetState,
)  # fmt: skip
"""Types of the services that may receive a request twice, because the second one changes nothing."""


class ServiceCall:
    """Service call in progress: a request that has been sent, and its response.

    Creating the object sends the request. Then spin the node of `client`, and call `response` until it returns the
    response. Leaving the context manager ends the call. A response that arrives later is ignored.

    Args:
        client: client of the service, which must be ready.
        request: the request.
        repeatable: whether to send the request again every 2 s (`AGAIN_S`) until a response arrives. Requests of the
            types in `REPEATABLE` are always sent again.
    """

    def __init__(self, client: ServiceClient, request: Any, *, repeatable: bool = False) -> None:
        self._client, self._request = client, request
        self._repeatable = repeatable or client.srv_type in REPEATABLE
        self._sent = [client.call_async(request)]
        self._sent_at = time.monotonic()

    def __enter__(self) -> ServiceCall:
        return self

    def __exit__(self, *_: object) -> None:
        for future in self._sent:
            self._client.remove_pending_request(future)

    def response(self) -> Any:
        """Return the response, or None before it arrives; a repeatable request is sent again after 2 s."""
        for future in self._sent:
            if future.done():
                return future.result()
        if self._repeatable and time.monotonic() > self._sent_at + AGAIN_S:
            self._sent.append(self._client.call_async(self._request))
            self._sent_at = time.monotonic()
        return None
