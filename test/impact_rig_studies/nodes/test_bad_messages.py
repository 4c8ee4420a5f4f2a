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
"""A bad message affects only itself: every subscription of every node and of the client accepts any bytes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.lib import recfunctions

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2, PointField

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.client import Client, Collector, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.instruments.section import SCAN
from impact_rig.nodes import messages
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.messages import TOPICS
from impact_rig.nodes.plot_node import PlotDataNode
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig_studies.stepped_sine_node import SteppedSineNode

pytestmark = pytest.mark.ros
TABLES = {topic.name: topic for topic in TOPICS if topic.columns is not None}
NUMBERS = (math.nan, math.inf, -math.inf, 1e308, -1.0, 2.0**60, 0.5)


def good(topic: topics.Topic, rows: int = 2) -> Table:
    table = Table(10**9, np.zeros(rows, SCAN if topic is topics.SCAN else topic.columns))
    for column in topic.fields:
        if column.least > 0.0:
            table.rows[column.name] = column.least
    return table


def malformed(topic: topics.Topic) -> Iterator[bytes]:
    """Yield messages on a table topic that are not tables of that topic."""
    table = good(topic)
    names = [column.name for column in topic.fields]
    for name in names:
        if topic.fields[names.index(name)].default is None and len(names) > 1:
            yield codec.encode(Table(0, recfunctions.drop_fields(table.rows, name)))
        other = [(one, "i1" if table.rows.dtype[one].kind == "S" else "S32") if one == name else
                 (one, table.rows.dtype[one]) for one in table.rows.dtype.names]  # fmt: skip
        yield codec.encode(Table(0, np.zeros(2, other)))
    encoded = codec.encode(table)
    yield b""
    yield b"\x00\x01\x00\x00"
    yield encoded[: len(encoded) // 2]
    yield encoded + bytes(64)
    yield b"\x00\x00" + encoded[2:]
    yield bytes(serialize_message(PointCloud2(height=480, width=640, point_step=16, row_step=640 * 16)))
    yield bytes(serialize_message(PointCloud2(height=1, width=2**32 - 1, point_step=2**32 - 1, row_step=2**32 - 1)))
    fields = [PointField(name="time", offset=2**31, datatype=8, count=2**32 - 1)]
    yield bytes(serialize_message(PointCloud2(height=1, width=1, fields=fields)))


def hostile(topic: topics.Topic) -> Iterator[bytes]:
    """Yield tables with the right columns and with numbers, texts and stamps that no rig sends."""
    for column in topic.fields:
        for value in {"S": (b"\xff\xfe", b"nobody"), "f": NUMBERS}.get(np.dtype(column.kind).kind, (0, 1, 127)):
            table = good(topic)
            table.rows[column.name] = value
            yield codec.encode(table)
    for stamp in (-(2**31) * 10**9, (2**31 - 1) * 10**9, 0):
        yield codec.encode(Table(stamp, good(topic).rows))
    yield codec.encode(good(topic, 0))
    yield codec.encode(Table(0, np.full(3, 255, "u1").view([("a", "u1")])))


OTHERS: dict[str, list[Any]] = {
    "std_msgs/msg/Float64": [{"data": value} for value in NUMBERS],
    "std_msgs/msg/String": [{"data": text} for text in ("", "gap_m=nan at 1", "{", "\n" * 99, "x: &a [*a]", "é" * 99)],
    "diagnostic_msgs/msg/DiagnosticArray": [{}],
}


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Client, dict[str, ManagedNode[Any]]]]:
    directory = str(tmp_path_factory.mktemp("runs"))
    with isolated_domain() as domain_id, Client(domain_id) as client:
        nodes: dict[str, ManagedNode[Any]] = {
            "rig": host_rig(client),
            "analysis": client.host(AnalysisNode),
            "recorder": client.host(RecorderNode, parameter_overrides=ros_parameters({"directory": directory})),
            "plot": client.host(PlotDataNode),
            "stepped_sine": client.host(SteppedSineNode, parameter_overrides=ros_parameters({"hold": "phase"})),
        }
        client.wait_active(*nodes)
        client.wait_until(lambda: client.figures("recorder").get("state") == "recording", "the recorder")
        yield client, nodes


@pytest.mark.parametrize("name", ["rig", "analysis", "recorder", "plot", "stepped_sine"])
def test_every_subscription_of_a_node_survives_any_message(
    graph: tuple[Client, dict[str, ManagedNode[Any]]], name: str
) -> None:
    """Messages that are not tables of their topic are rejected and counted under it; none raises an exception."""
    node = graph[1][name]
    info = {"source_timestamp": 1, "received_timestamp": 1, "publication_sequence_number": 0}
    tried = 0
    for subscription in list(node.subscriptions):
        said = (info,) if subscription._callback_type is Subscription.CallbackType.WithMessageInfo else ()
        topic = TABLES.get(subscription.topic_name.lstrip("/"))
        if topic is not None:
            before, bad = node.refusals.counts[topic.name], list(malformed(topic))
            for data in bad:
                subscription.callback(data, *said)
            assert node.refusals.counts[topic.name] - before == len(bad), topic.name
            assert node.refusals.last[topic.name]
            for data in hostile(topic):
                subscription.callback(data, *said)
            tried += 1
        elif subscription.raw:
            for data in (b"", b"\x00\x01\x00\x00", bytes(100), b"\xff" * 40):
                subscription.callback(data, *said)
        else:
            kind = next(t for t in TOPICS if t.name.lstrip("/") == subscription.topic_name.lstrip("/"))
            for fields in OTHERS[kind.type_name]:
                subscription.callback(messages.class_of(kind)(**fields), *said)
    assert tried or name == "rig"
    assert node.refusals.counts["exception"] == 0, node.refusals.last["exception"]
    assert node.active


def test_nodes_continue_after_invalid_messages(graph: tuple[Client, dict[str, ManagedNode[Any]]]) -> None:
    client, nodes = graph
    node = client.host(Node, node_name="intruder")
    publishers = {topic.name: node.create_publisher(PointCloud2, topic.name, messages.profile(topic.qos))
                  for topic in TABLES.values()}  # fmt: skip
    client.wait_until(lambda: publishers["daq/scan"].get_subscription_count() >= 3, "the subscriptions")
    for topic in TABLES.values():
        publishers[topic.name].publish(next(malformed(topic)))
    client.spin_for(0.2)
    scans = client.collect("daq/scan")
    client.step(3)
    client.wait_until(lambda: len(scans) == 3, "blocks")
    assert all(one.active and not one.refusals.counts["exception"] for one in nodes.values())
    found = client.wait_until(
        lambda: (f := client.figures("recorder")).get("state") in ("losing", "rival") and f, "the recorder's word"
    )
    assert int(found["refused.shaker/applied"]) > 0
    assert client.status("recorder").level == b"\1"


@pytest.mark.parametrize("topic", TABLES.values(), ids=lambda topic: topic.name)
def test_a_collector_keeps_valid_tables_of_its_topic_and_counts_the_others(topic: topics.Topic) -> None:
    collector = Collector(topic)
    bad = list(malformed(topic))
    for data in bad:
        collector.take(data, {"publication_sequence_number": 1})
    assert (len(collector), collector.refused) == (0, len(bad))
    assert collector.last_refused
    for data in hostile(topic):
        collector.take(data, {"publication_sequence_number": 1})
    collector.take(codec.encode(good(topic)), {"publication_sequence_number": 1})
    assert collector.last() is not None
    assert collector.tables()[-1].rows.tobytes() == good(topic).rows.tobytes()
