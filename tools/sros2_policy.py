# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Write `config/sros2/policy.xml` from what the nodes really open: `python tools/sros2_policy.py`.

Each node is run in this process until it is active, and the graph is asked for its topics and services. What SROS2
needs besides (keystore, certificates) is in docs/security.md.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from rclpy.parameter import Parameter

from impact_rig.client import Client, isolated_domain
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.nodes.stepped_sine_node import SteppedSineNode

NAMESPACE = "/rig"
NODES = {"rig": RigNode, "analysis": AnalysisNode, "recorder": RecorderNode, "stepped_sine": SteppedSineNode}
OPERATOR = {
    "publish": {"/rig/shaker/frequency", "/rig/shaker/current", "/rig/notes", "/rig/daq/ack"},
    "request": {"pause", "step", "reset", "stop", "clear_trip", "pluck", "start"},
}
"""What a person's own node may do; it may read everything."""
FILE = Path(__file__).parents[1] / "config" / "sros2" / "policy.xml"
Rights = dict[tuple[str, str], set[str]]


def rights() -> dict[str, Rights]:
    """Return what each node opens: (kind, expression) -> full names."""
    with (
        tempfile.TemporaryDirectory() as folder,
        isolated_domain() as domain_id,
        Client(domain_id, namespace=NAMESPACE, name="operator") as client,
    ):
        own = {"rig": ("time.mode", "stepped"), "recorder": ("directory", folder), "stepped_sine": ("hold", "phase")}
        for node, make_node in NODES.items():
            overrides = [Parameter(own[node][0], value=own[node][1])] if node in own else []
            client.host(make_node, parameter_overrides=overrides)
        client.wait_active(*NODES)
        client.wait_until(lambda: client.status("recorder").message.startswith("recording"), "the recorder")
        found = {node: _opened(client, node) for node in NODES}
    everything = {name for node in found.values() for name in node["topics", "publish"]}
    replies = {name for node in found.values() for name in node["services", "reply"]}
    found["operator"] = {
        ("topics", "publish"): {*OPERATOR["publish"], "/rosout", "/parameter_events"},
        ("topics", "subscribe"): everything,
        ("services", "request"): {name for name in replies if name.rsplit("/", 1)[1] in OPERATOR["request"]},
    }
    return found


def _opened(client: Client, name: str) -> Rights:
    node: Any = client.node

    def names(query: Any) -> set[str]:
        return {topic for topic, _types in query(name, NAMESPACE)}

    return {
        ("topics", "publish"): names(node.get_publisher_names_and_types_by_node),
        ("topics", "subscribe"): names(node.get_subscriber_names_and_types_by_node),
        ("services", "reply"): names(node.get_service_names_and_types_by_node),
        ("services", "request"): names(node.get_client_names_and_types_by_node),
    }


def policy() -> str:
    """Return the policy file."""
    root = ET.Element("policy", version="0.2.0")
    enclaves = ET.SubElement(root, "enclaves")
    for node, opened in sorted(rights().items()):
        enclave = ET.SubElement(enclaves, "enclave", path=f"{NAMESPACE}/{node}")
        profile = ET.SubElement(ET.SubElement(enclave, "profiles"), "profile", ns=NAMESPACE, node=node)
        for (kind, expression), names in opened.items():
            if names:
                group = ET.SubElement(profile, kind, {expression: "ALLOW"})
                for name in sorted(names):
                    ET.SubElement(group, kind.removesuffix("s")).text = name
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


if __name__ == "__main__":
    FILE.parent.mkdir(exist_ok=True)
    sys.exit(0 if FILE.write_text(policy(), encoding="utf-8") else 1)
