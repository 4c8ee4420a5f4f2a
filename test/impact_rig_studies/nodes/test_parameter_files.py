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
"""`ros2 param dump`, `load` and `dump` again, by the code of rclpy that the command calls."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

import yaml
from kits.nodes import dotted
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import parameter_dict_from_yaml_file, parameter_value_to_python

from impact_rig.client import Client, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig_studies.stepped_sine_node import SteppedSineNode

pytestmark = pytest.mark.ros

ASLEEP: dict[str, Any] = {"autostart": False}
RIGS: dict[str, dict[str, Any]] = {
    "the paper's": {},
    "numbers that YAML takes for texts": {"contact__contact_time_s": 4e-5, "instruments__laser__noise_m_rms": 1e-10},
    "words that YAML takes for booleans": {"time__publish_clock": True, "instruments__adc__anti_alias": False},
    "limits that need an order": {
        "drive__frequency_hz": 450.0,
        "shaker__frequency_max_hz": 500.0,
        "shaker__frequency_min_hz": 300.0,
    },
    "faults and peers": {
        "time__peers": ["analysis", "recorder", "on"],
        "instruments__faults__planned": ["spike_train channel=laser start_s=0.5 value=1e-05 rate_hz=3", "lost_block"],
    },
    "a law of each kind": {"contact__law": "kelvin_voigt", "contact__release": "force", "contact__restitution": 1.0},
    "no sphere, prescribed": {"sphere__present": False, "drive__kind": "prescribed", "drive__amplitude": 1e-3},
    "other instruments": {"instruments__ideal": True, "instruments__adc__bits": 24, "daq__seed": 2**53},
    "lockstep": {"time__mode": "lockstep", "daq__rate_hz": 1000, "daq__block_scans": 10, "step__blocks": 7},
}
NODES: dict[str, tuple[type, list[dict[str, Any]]]] = {
    "rig": (RigNode, [dotted({"output__autostart": False, **values}) for values in RIGS.values()]),
    "analysis": (AnalysisNode, [ASLEEP, {**ASLEEP, "gap_m": 1e-5}]),
    "recorder": (RecorderNode, [ASLEEP, {**ASLEEP, "name": "2026", "directory": "7", "record": False}]),
    "stepped_sine": (SteppedSineNode, [ASLEEP, {**ASLEEP, "frequencies_hz": [7.0, 1e-5], "direction": "up_down"}]),
}

NUMBERS = itertools.count()


def host(client: Client, node: str, values: dict[str, Any]) -> ManagedNode[Any]:
    """Run a node under a unique name."""
    name = f"{node}{next(NUMBERS)}"
    hosted: ManagedNode[Any] = client.host(
        NODES[node][0], parameter_overrides=ros_parameters(values), cli_args=["--ros-args", "-r", f"__node:={name}"]
    )
    return hosted


def dump(client: Client, node: str, path: Path) -> dict[str, Any]:
    """Write parameters as `ros2 param dump` does (ros2param/verb/dump.py), and return the values."""
    names = client.call(ListParameters, f"{node}/list_parameters", ListParameters.Request()).result.names
    answer = client.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names))
    values = {
        name: list(value) if hasattr(value, "tolist") else value
        for name, value in zip(names, map(parameter_value_to_python, answer.values), strict=True)
    }
    tree: dict[str, Any] = {}
    for name, value in sorted(values.items()):
        *sections, key = name.split(".")
        place = tree
        for section in sections:
            place = place.setdefault(section, {})
        place[key] = value
    path.write_text(yaml.dump({f"/{node}": {"ros__parameters": tree}}, default_flow_style=False), encoding="utf-8")
    return values


def load(client: Client, node: str, path: Path) -> list[str]:
    """Set parameters as `ros2 param load` does, and return the refusals."""
    written = list(yaml.safe_load(path.read_text(encoding="utf-8")))  # Kilted wants the name of the node
    parameters = list(parameter_dict_from_yaml_file(str(path), target_nodes=written).values())
    request = SetParameters.Request(parameters=parameters)
    results = client.call(SetParameters, f"{node}/set_parameters", request).results
    assert len(results) == len(parameters)
    return [result.reason for result in results if not result.successful]


@pytest.fixture(scope="module")
def user() -> Iterator[Client]:
    with isolated_domain() as domain_id, Client(domain_id) as client:
        yield client


CASES = [(node, values) for node, (_, variants) in NODES.items() for values in variants]


@pytest.mark.parametrize(("node", "values"), CASES, ids=[f"{node}-{i}" for i, (node, _) in enumerate(CASES)])
def test_dumped_parameters_can_be_loaded_unchanged(
    user: Client, tmp_path: Path, node: str, values: dict[str, Any]
) -> None:
    """This also holds for another node that was started without them, except for what is fixed at the start."""
    first = host(user, node, values)
    before = dump(user, first.get_name(), tmp_path / "first.yaml")
    assert load(user, first.get_name(), tmp_path / "first.yaml") == []
    assert dump(user, first.get_name(), tmp_path / "again.yaml") == before
    assert (tmp_path / "again.yaml").read_bytes() == (tmp_path / "first.yaml").read_bytes()
    at_start = {name: value for name, value in values.items() if first.describe_parameter(name).read_only}
    other = host(user, node, at_start)
    assert load(user, other.get_name(), tmp_path / "first.yaml") == []
    assert dump(user, other.get_name(), tmp_path / "other.yaml") == before


def test_a_text_that_ros2_param_cannot_represent_is_not_changed(user: Client, tmp_path: Path) -> None:
    name = host(user, "recorder", {**ASLEEP, "directory": "off", "name": "0x10"}).get_name()
    before = dump(user, name, tmp_path / "recorder.yaml")
    assert load(user, name, tmp_path / "recorder.yaml") == []
    assert dump(user, name, tmp_path / "recorder.yaml") == before


def test_a_different_value_of_a_read_only_parameter_is_rejected(user: Client, tmp_path: Path) -> None:
    node = host(user, "rig", {"output.autostart": False})
    name = node.get_name()
    dump(user, name, tmp_path / "rig.yaml")
    text = (tmp_path / "rig.yaml").read_text(encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(text.replace("rate_hz: 10000\n", "rate_hz: 9999\n"), encoding="utf-8")
    refusals = load(user, name, tmp_path / "rig.yaml")
    assert refusals == ["daq.rate_hz is read-only: set it when the node starts (parameter file or -p)"]
    assert node.refusals.counts["parameter"] == 1
