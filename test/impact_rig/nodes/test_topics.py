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
"""The topics on the graph are those of the table of topics."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from impact_rig.client import Client
from impact_rig.codec import MAX_MESSAGE_BYTES
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.messages import TOPICS

pytestmark = pytest.mark.ros


def test_nodes_publish_exactly_the_topics_of_the_table(client: Client) -> None:
    host_rig(client)
    client.host(AnalysisNode)
    client.wait_active("rig", "analysis")
    node = client.node
    for topic in TOPICS:
        publishers = node.get_publishers_info_by_topic(topic.name)
        names = {publisher.node_name for publisher in publishers}
        if topic.publisher in ("rig", "analysis"):
            assert names == {topic.publisher}, topic.name
        for publisher in publishers:
            assert publisher.topic_type == topic.type_name
            assert publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE
            latched = publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            assert latched == topic.qos.transient_local, topic.name
    for name in ("rig", "analysis"):
        published = {topic for topic, _ in node.get_publisher_names_and_types_by_node(name, "/")}
        own = {node.resolve_topic_name(topic.name) for topic in TOPICS}
        of_ros = {"/parameter_events", "/rosout", f"/{name}/transition_event"}
        assert published <= own | of_ros


@pytest.mark.parametrize(
    ("rate_hz", "block_scans", "blocks"),
    [(10_000, 100, 2_500), (50_000, 500, 780), (10_000, 5_000, 100)],
    ids=["25 s", "16 MB of scans of 41 bytes", "at least 100"],
)
def test_the_queue_of_scans_bridges_25_seconds_or_16_megabytes(
    client: Client, rate_hz: int, block_scans: int, blocks: int
) -> None:
    node = host_rig(client, daq__rate_hz=rate_hz, daq__block_scans=block_scans)
    client.wait_active("rig")
    assert node.outputs["daq/scan"].qos_profile.depth == blocks


def test_a_blocks_message_fits_the_shared_memory_segment(client: Client) -> None:
    node = host_rig(client, daq__block_scans=10_000, output__truth_scan=True)
    client.wait_until(lambda: "daq.block_scans must be <= 46" in client.status("rig").message, "the reason")
    assert client.state("rig") == "unconfigured"
    assert node.active is False
    assert MAX_MESSAGE_BYTES == 480_000
