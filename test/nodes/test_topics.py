# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The table of topics is what is on the graph."""

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


def test_nodes_publish_the_table_and_nothing_else(client: Client) -> None:
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


def test_a_blocks_message_fits_the_shared_memory_segment(client: Client) -> None:
    node = host_rig(client, daq__block_scans=10_000, output__truth_scan=True)
    client.wait_until(lambda: "daq.block_scans must be <= 46" in client.status("rig").message, "the reason")
    assert client.state("rig") == "unconfigured"
    assert node.active is False
    assert MAX_MESSAGE_BYTES == 480_000
