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
"""Lost answers: a service whose first callback never ends gives the client nothing, as DDS does on a busy machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from impact_rig.client import isolated_domain
from impact_rig.client.client import Client, WaitTimeoutError
from impact_rig.client.service_call import AGAIN_S


class Unresponsive:
    """Callback of a service that never answers the first request."""

    def __init__(self) -> None:
        self.requests = 0

    async def answer(self, _request: Any, response: Any) -> Any:
        self.requests += 1
        if self.requests == 1:
            await Future()
        return response


@pytest.fixture
def client() -> Iterator[Client]:
    with isolated_domain() as domain_id, Client(domain_id) as client:
        yield client


@pytest.fixture
def serve(client: Client) -> Iterator[Callable[[Any, str], Unresponsive]]:
    """Function that creates an unresponsive service on a node that another thread spins."""
    node = Node("server", context=client.context, use_global_arguments=False)
    executor = SingleThreadedExecutor(context=client.context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()

    def create(service_type: Any, name: str) -> Unresponsive:
        service = Unresponsive()
        node.create_service(service_type, name, service.answer, callback_group=ReentrantCallbackGroup())
        executor.wake()
        return service

    yield create
    executor.shutdown()
    thread.join()
    node.destroy_node()


def test_a_repeatable_request_is_sent_again_if_its_answer_is_lost(
    client: Client, serve: Callable[..., Unresponsive]
) -> None:
    name = "node/set_parameters_atomically"
    service = serve(SetParametersAtomically, name)
    began = time.monotonic()
    client.call(SetParametersAtomically, name, SetParametersAtomically.Request())
    assert service.requests == 2
    assert time.monotonic() >= began + AGAIN_S


def test_a_request_that_must_not_be_repeated_is_sent_once(client: Client, serve: Callable[..., Unresponsive]) -> None:
    service = serve(Trigger, "rig/pluck")
    with pytest.raises(WaitTimeoutError, match="an answer of rig/pluck"):
        client.call(Trigger, "rig/pluck", Trigger.Request(), timeout_s=2 * AGAIN_S)
    assert service.requests == 1
    client.call(Trigger, "rig/pluck", Trigger.Request(), repeatable=True)
    assert service.requests == 2


def test_a_client_without_commands_rejects_them() -> None:
    with (
        isolated_domain() as domain_id,
        Client(domain_id, commands=False) as client,
        pytest.raises(ValueError, match="commands=False"),
    ):
        client.command(current_a=0.1)
