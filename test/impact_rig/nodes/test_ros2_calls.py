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
"""Part of `qualification/ros2_calls.py`: answers of nodes in this process to calls of the `ros2` command line."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig

from impact_rig.client import Client
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.plot_node import PlotDataNode
from qualification import ros2_calls
from qualification.ros2_calls import Calls

pytestmark = pytest.mark.ros


def test_every_topic_can_be_renamed() -> None:
    calls = Calls()
    ros2_calls.renamed(calls)
    assert calls.wrong == []
    assert calls.count > 20


def test_topics_services_parameters_and_states_answer_as_documented(client: Client, tmp_path: Path) -> None:
    host_rig(client)
    client.host(AnalysisNode)
    client.host(PlotDataNode)
    client.wait_active("rig", "analysis", "plot")
    calls = Calls()
    ros2_calls.topics(calls, client)
    ros2_calls.services(calls, client, ("rig", "analysis"))
    for node in ("rig", "analysis"):
        ros2_calls.lifecycle(calls, client, node)
        ros2_calls.parameters(calls, client, node, tmp_path)
    ros2_calls.operation(calls, client)
    assert calls.wrong == []
    assert calls.count > 50


def test_a_call_that_does_not_answer_as_documented_is_reported() -> None:
    said: list[str] = []
    calls = Calls(said.append)
    calls.hold("ros2 topic info /nowhere", as_documented=False, found="none")
    assert calls.wrong == said == ["WRONG ros2 topic info /nowhere: none"]
