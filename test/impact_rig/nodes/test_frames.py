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
"""Two rigs in one graph: the frames, clocks and topics of each belong to its namespace."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig

from impact_rig import codec
from impact_rig.client import Client, Collector, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.messages import TOPICS
from impact_rig.nodes.plot_node import PlotDataNode
from impact_rig.nodes.rig_node import RigNode

pytestmark = pytest.mark.ros
FRAMED = [topic.name for topic in TOPICS if topic.frame_id and topic.publisher in ("rig", "analysis", "plot")]
OWN_CLOCK = ["--ros-args", "-r", "/clock:=clock"]


def frames(collectors: list[Collector]) -> dict[str, set[str]]:
    """Return the frames in the received messages, by topic."""

    def frame(data: Any) -> str:
        return codec.header(data)[1] if isinstance(data, bytes) else data.header.frame_id

    return {one.topic.name: {frame(data) for data in one.messages} for one in collectors if len(one)}


def frames_of_a_rig(client: Client, prefix: str = "") -> dict[str, set[str]]:
    """Run a rig with its analysis in the namespace of the client, and return the frames that they publish."""
    settings = {"time.mode": "lockstep", "drive.amplitude": 0.52, "barriers.gap_m": 0.002, "time.peers": ["analysis"]}
    rig = client.host(
        RigNode,
        parameter_overrides=ros_parameters(settings | {"output.frame_prefix": prefix, "output.truth_scan": True}),
        cli_args=OWN_CLOCK,
    )
    client.host(AnalysisNode, parameter_overrides=ros_parameters({"use_sim_time": True}), cli_args=OWN_CLOCK)
    plot = client.host(PlotDataNode, parameter_overrides=ros_parameters({"use_sim_time": True}), cli_args=OWN_CLOCK)
    collectors = [client.collect(name) for name in FRAMED]
    client.wait_active("rig", "analysis", "plot")
    client.wait_until(lambda: plot.doing().word == "plotting", "the scans")
    client.step(60)
    wanted = {"daq/scan", "laser", "truth/impacts", "impacts", "analysis/settings", "plot/envelope/laser", "plot/drive"}
    client.wait_until(lambda: wanted <= frames(collectors).keys(), "their messages")
    assert client.get_parameters("rig", ["output.frame_prefix"])["output.frame_prefix"] == rig.frame_prefix
    return frames(collectors)


def test_two_rigs_share_neither_frames_nor_clocks() -> None:
    with (
        isolated_domain() as domain_id,
        Client(domain_id, namespace="/left/rig", name="left") as left,
        Client(domain_id, namespace="/right/rig", name="right") as right,
    ):
        found = {client.node.get_namespace(): frames_of_a_rig(client) for client in (left, right)}
        for client in (left, right):
            namespace = client.node.get_namespace()
            publishers = client.node.get_publishers_info_by_topic(f"{namespace}/clock")
            followers = client.node.get_subscriptions_info_by_topic(f"{namespace}/clock")
            assert [info.node_namespace for info in publishers] == [namespace]
            assert {(info.node_namespace, info.node_name) for info in followers} == {
                (namespace, "analysis"),
                (namespace, "plot"),
            }
        assert left.node.count_publishers("/clock") == 0
    for namespace, by_topic in found.items():
        expected = {topic.name: {namespace[1:] + "/" + topic.frame_id} for topic in TOPICS}
        for topic, names in by_topic.items():
            assert names == expected[topic], topic


@pytest.mark.parametrize(("prefix", "expected"), [("my/", "my/"), ("/", "")])
def test_a_prefix_in_the_settings_replaces_the_namespace(prefix: str, expected: str) -> None:
    """The analysis takes the prefix from the scans that it receives."""
    with isolated_domain() as domain_id, Client(domain_id, namespace="/rig") as client:
        found = frames_of_a_rig(client, prefix)
    own = {topic.name: topic.frame_id for topic in TOPICS}
    early = ("analysis/settings", "plot/drive")  # may be published before the calibration arrives
    settled = {topic: names for topic, names in found.items() if topic not in early}
    assert all(names == {expected + own[topic]} for topic, names in settled.items()), settled


def test_frames_have_no_prefix_without_a_namespace(client: Client) -> None:
    assert host_rig(client).frame_prefix == ""
