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
"""SROS2 policy of the rig, from the description of the graph (`impact_rig.graph`).

`config/sros2/policy.xml` is the policy for the default arguments of `rig.launch.py`. For another namespace or clock:

    python -m tools.sros2_policy --namespace /left/rig --clock clock > policy.xml

The rest of what SROS2 needs (keystore, certificates) is described in docs/explanation/security.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

from impact_rig import graph, topics
from impact_rig.nodes.messages import TOPICS

NAMESPACE = "/rig"
CLOCK = "clock"
"""Defaults of `rig.launch.py`."""
OPERATOR = "operator"
OPERATOR_TOPICS = (topics.FREQUENCY.name, topics.CURRENT.name, topics.NOTES.name, topics.ACK.name)
"""Topics that a user's own node may publish; it may read everything and call every service of the nodes."""
FILE = Path(__file__).parents[1] / "config" / "sros2" / "policy.xml"
Rights = dict[tuple[str, str], set[str]]
"""Full names by kind and expression, such as `("topics", "publish")`."""


def rights(namespace: str = NAMESPACE, clock: str = CLOCK) -> dict[str, Rights]:
    """Return the permissions of each node.

    Args:
        namespace: namespace of all nodes.
        clock: name that replaces `/clock`.
    """

    def full(names: Iterable[str], node: str = "") -> set[str]:
        remapped = dict([graph.clock_remapping(clock)])
        return {graph.resolve(remapped.get(name, name), namespace, node) for name in names}

    found: dict[str, Rights] = {
        node.name: {
            ("topics", "publish"): full((*node.published(TOPICS), *graph.ROS_TOPICS), node.name),
            ("topics", "subscribe"): full(node.subscribed(TOPICS), node.name),
            ("services", "reply"): full((*node.services(), *graph.ROS_SERVICES), node.name),
        }
        for node in graph.NODES
    }
    found[OPERATOR] = {
        ("topics", "publish"): full((*OPERATOR_TOPICS, "/parameter_events", "/rosout")),
        ("topics", "subscribe"): set().union(*(node["topics", "publish"] for node in found.values())),
        ("services", "request"): set().union(*(full(node.services(), node.name) for node in graph.NODES)),
    }
    return found


def policy(namespace: str = NAMESPACE, clock: str = CLOCK) -> str:
    """Return the text of the policy file."""
    root = ET.Element("policy", version="0.2.0")
    enclaves = ET.SubElement(root, "enclaves")
    namespace = graph.resolve(namespace)
    for node, opened in sorted(rights(namespace, clock).items()):
        enclave = ET.SubElement(enclaves, "enclave", path=graph.resolve(node, namespace))
        profile = ET.SubElement(ET.SubElement(enclave, "profiles"), "profile", ns=namespace, node=node)
        _add_groups(profile, opened)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _add_groups(profile: ET.Element, opened: Mapping[tuple[str, str], set[str]]) -> None:
    for (kind, expression), names in opened.items():
        group = ET.SubElement(profile, kind, {expression: "ALLOW"})
        for name in sorted(names):
            ET.SubElement(group, kind.removesuffix("s")).text = name


def main() -> None:
    """Print the policy for the namespace and clock on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--namespace", default=NAMESPACE, help="namespace of all nodes (default: %(default)s)")
    parser.add_argument("--clock", default=CLOCK, help="name that replaces /clock (default: %(default)s)")
    arguments = parser.parse_args()
    sys.stdout.write(policy(arguments.namespace, arguments.clock))


if __name__ == "__main__":
    main()
