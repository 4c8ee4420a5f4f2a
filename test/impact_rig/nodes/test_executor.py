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
"""Delivery of messages that arrived before an executor listened and were never announced to it.

The middleware has a gap of a microsecond, see `impact_rig.nodes.rclpy_internals`. Here the gap is made wide: everything
is announced to one executor, which never runs again, and another executor takes the node over.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

import impact_rig
from impact_rig.client import Client, isolated_domain
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.process import make_executor

pytestmark = pytest.mark.ros

KEPT = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SOON = Duration(seconds=10)


@pytest.fixture
def context() -> Iterator[Context]:
    with isolated_domain() as domain_id:
        found = Context()
        found.init(args=[], domain_id=domain_id)
        yield found
        found.try_shutdown()


@pytest.fixture
def make_node(context: Context) -> Iterator[Callable[[str], Node]]:
    made = []

    def make(name: str) -> Node:
        made.append(Node(name, context=context, use_global_arguments=False, enable_rosout=False))
        return made[-1]

    yield make
    for node in made:
        node.destroy_node()


@pytest.fixture
def executors(context: Context) -> Iterator[Any]:
    made = [make_executor(context), make_executor(context)]
    yield made
    for executor in made:
        executor.shutdown()


def run(executor: Any, calls: int = 50) -> None:
    for _ in range(calls):
        executor.spin_once(timeout_sec=0.002)


@pytest.mark.parametrize("with_info", [False, True])
def test_messages_without_a_notification_are_delivered_in_order(
    executors: list[Any], make_node: Callable[[str], Node], with_info: bool
) -> None:
    first, second = executors
    got: list[str] = []

    def take(message: String) -> None:
        got.append(message.data)

    def take_with_info(message: String, info: dict[str, Any]) -> None:
        got.append(message.data if info["publication_sequence_number"] else "")

    node, other = make_node("one"), make_node("other")
    node.create_subscription(String, "words", take_with_info if with_info else take, KEPT)
    first.add_node(node)
    run(first)
    publisher = other.create_publisher(String, "words", KEPT)
    for word in ("a", "b"):
        publisher.publish(String(data=word))
    assert publisher.get_subscription_count() == 1
    assert publisher.wait_for_all_acked(SOON)
    second.add_node(node)
    run(second)
    assert got == ["a", "b"]
    publisher.publish(String(data="c"))
    assert publisher.wait_for_all_acked(SOON)
    if not with_info:  # Jazzy's own way to hand over both is another
        run(second)
        assert got == ["a", "b", "c"]


@pytest.mark.parametrize("qos", [KEPT, QoSProfile(depth=2, history=HistoryPolicy.KEEP_ALL)], ids=["last", "all"])
def test_an_exception_in_a_callback_does_not_prevent_later_deliveries(
    executors: list[Any], make_node: Callable[[str], Node], qos: QoSProfile
) -> None:
    """An exception that leaves a task of rclpy's events executor ends the process with a segmentation fault."""
    first, second = executors
    node, other = make_node("one"), make_node("other")
    got: list[str] = []

    def take(message: String) -> None:
        got.append(message.data)
        if message.data == "a":
            raise ValueError("no")

    node.create_subscription(String, "words", take, qos)
    first.add_node(node)
    run(first)
    publisher = other.create_publisher(String, "words", KEPT)
    for word in "abc":
        publisher.publish(String(data=word))
    assert publisher.wait_for_all_acked(SOON)
    second.add_node(node)
    run(second)
    assert got == ["a", "b", "c"]


def test_a_poll_ends_although_messages_keep_arriving(executors: list[Any], make_node: Callable[[str], Node]) -> None:
    first, second = executors
    node = make_node("one")
    publisher = node.create_publisher(String, "words", KEPT)
    got: list[str] = []

    def answer_oneself(message: String) -> None:
        got.append(message.data)
        if len(got) < 100 * KEPT.depth:
            publisher.publish(message)

    node.create_subscription(String, "words", answer_oneself, KEPT)
    first.add_node(node)
    run(first)
    publisher.publish(String(data="a"))
    assert publisher.wait_for_all_acked(SOON)
    second.add_node(node)
    while not got:
        run(second, 1)
    assert len(got) == KEPT.depth


@pytest.mark.parametrize("is_coroutine", [False, True])
def test_requests_and_answers_without_a_notification_are_delivered(
    executors: list[Any], make_node: Callable[[str], Node], is_coroutine: bool
) -> None:
    first, second = executors
    server, asking = make_node("server"), make_node("asking")

    def answer(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = "here"
        return response

    async def answer_later(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return answer(request, response)

    server.create_service(Trigger, "ask", answer_later if is_coroutine else answer)
    client = asking.create_client(Trigger, "ask")
    for node in (server, asking):
        first.add_node(node)
    run(first)
    assert client.wait_for_service(10.0)
    future = client.call_async(Trigger.Request())
    second.add_node(server)
    run(second)
    assert not future.done()
    second.add_node(asking)
    run(second)
    assert future.result().message == "here"


PRIVATE = re.compile(
    r"rclpy\.impl|rclpy\.experimental|_rclpy|\._parameter_overrides|\._state_machine|\._service_change_state"
    r"|\._callback_type|\.handle\b|take_message\("
)


def test_only_one_module_uses_private_parts_of_rclpy() -> None:
    package = Path(impact_rig.__file__).parent
    texts = {path.relative_to(package): path.read_text(encoding="utf-8") for path in package.rglob("*.py")}
    assert [str(path) for path, text in texts.items() if PRIVATE.search(text)] == ["nodes/rclpy_internals.py"]


def test_nodes_use_the_public_executor_with_other_versions_of_rclpy(client: Client, monkeypatch) -> None:
    monkeypatch.setattr("importlib.metadata.version", lambda _name: "10.0.0")
    executor = make_executor(client.context)
    assert type(executor) is SingleThreadedExecutor
    executor.shutdown()
    with Client(client.context.get_domain_id(), namespace="/other") as other:
        assert type(other.executor) is SingleThreadedExecutor
        host_rig(other)
        other.host(AnalysisNode)
        scans = other.collect("daq/scan")
        other.wait_active("rig", "analysis")
        other.step(3)
        other.wait_until(lambda: len(scans) == 3, "the blocks")
