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
"""Namespace lock of a rig: whether the rig must wait for the graph, and who holds the namespace."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from rclpy.node import Node

from impact_rig.client import Client
from impact_rig.nodes.session import NamespaceLock, ends_here
from impact_rig.system import files

pytestmark = pytest.mark.ros
FAST = "rmw_fastrtps_cpp"
NEAR = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


@pytest.mark.parametrize(
    ("environment", "middleware", "expected"),
    [
        (NEAR, FAST, True),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "off"}, "rmw_cyclonedds_cpp", True),
        ({}, FAST, False),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, FAST, False),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}, FAST, False),
        (NEAR | {"ROS_STATIC_PEERS": "192.168.0.7"}, FAST, False),
        (NEAR | {"ROS_DISCOVERY_SERVER": "192.168.0.7:11811"}, FAST, False),
        (NEAR, "rmw_zenoh_cpp", False),
    ],
)
def test_discovery_counts_as_local_only_where_the_settings_guarantee_it(environment, middleware, expected) -> None:
    assert ends_here(environment, middleware) is expected


def test_a_lock_covers_one_namespace_of_one_domain(client: Client) -> None:
    place, same, other = (
        NamespaceLock(client.host(Node, node_name=name, namespace=where))
        for name, where in (("a", "/cell/one"), ("b", "/cell/one"), ("c", "/cell/two"))
    )
    assert place.decides
    assert place.take()
    assert place.take(), "a repeated request succeeds as well"
    assert not same.take()
    assert other.take()
    place.leave()
    assert same.take()
    for one in (same, other):
        one.leave()


def test_the_graph_decides_where_no_lock_is_possible(client: Client, monkeypatch) -> None:
    monkeypatch.setattr(files, "LOCK_PARENTS", (Path("/nowhere"),))
    place = NamespaceLock(client.node)
    assert not place.decides
    assert place.take()
