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
"""Topics and services that every node opens, as known to the graph."""

from __future__ import annotations

from typing import Any

from impact_rig.client import Client, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig_studies.stepped_sine_node import SteppedSineNode

Opened = dict[tuple[str, str], set[str]]
"""Full names of topics and services, by kind and expression of an SROS2 policy."""


def opened_by(namespace: str, clock: str, directory: str) -> dict[str, Opened]:
    """Run every node in a namespace with its own clock, and return what each of them opens."""
    arguments = ["--ros-args", "-r", f"/clock:={clock}"]
    makers: dict[str, tuple[Any, dict[str, Any]]] = {
        "rig": (RigNode, {"time.mode": "lockstep"}),
        "analysis": (AnalysisNode, {"use_sim_time": True}),
        "recorder": (RecorderNode, {"use_sim_time": True, "directory": directory}),
        "stepped_sine": (SteppedSineNode, {"use_sim_time": True, "hold": "phase"}),
    }
    with isolated_domain() as domain_id, Client(domain_id, namespace=namespace, name="operator") as client:
        for make_node, values in makers.values():
            client.host(make_node, parameter_overrides=ros_parameters(values), cli_args=arguments)
        client.wait_active(*makers)
        client.wait_until(lambda: client.status("recorder").message.startswith("recording"), "the recorder")
        return {name: _opened(client.node, name, namespace) for name in makers}


def _opened(node: Any, name: str, namespace: str) -> Opened:
    queries = {
        ("topics", "publish"): node.get_publisher_names_and_types_by_node,
        ("topics", "subscribe"): node.get_subscriber_names_and_types_by_node,
        ("services", "reply"): node.get_service_names_and_types_by_node,
        ("services", "request"): node.get_client_names_and_types_by_node,
    }
    return {kind: {found for found, _types in query(name, namespace)} for kind, query in queries.items()}
