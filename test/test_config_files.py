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
"""Every file in config/ loads, and states the unit and the origin of every value."""

from __future__ import annotations

import re

import pytest
import yaml

from impact_rig.config import Origin
from impact_rig.config.tree import flatten
from impact_rig.rig import config
from impact_rig.rig.config import RigConfig
from impact_rig.system.files import config_dir
from impact_rig_studies.campaign.plan import load_campaign

CAMPAIGNS = [config_dir() / "paper.yaml", *sorted(config_dir().glob("campaigns/*.yaml"))]
FILES = [path for path in sorted(config_dir().glob("*.yaml")) if path not in CAMPAIGNS]
FIELDS = {name: about for name, about, _ in config.fields()}
VALUE_LINE = re.compile(r"(?P<indent> *)(?P<key>\w+): (?P<value>\S.*?)  # (?P<unit>[^;]+); (?P<origin>\w+): \S")
SECTION_LINE = re.compile(r"(?P<indent> *)(?P<key>[\w/*]+):(?P<comment>  # .*)?$")


def value_lines(path):
    """Yield (dotted name, line, match) of every line that sets a value, from the text: YAML drops the comments."""
    above = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        found = SECTION_LINE.match(line) or VALUE_LINE.match(line)
        assert found, f"{path.name}: neither a section nor `name: value  # unit; origin: meaning`: {line!r}"
        depth = len(found["indent"]) // 2
        above = [*above[:depth], found["key"]]
        if found.re is VALUE_LINE:
            yield ".".join(above[2:]), line, found


def test_the_folder_contains_a_nominal_configuration():
    assert "nominal.yaml" in [path.name for path in FILES]


@pytest.mark.parametrize("path", CAMPAIGNS, ids=lambda path: path.name)
def test_every_campaign_file_loads(path):
    assert load_campaign(path).planned()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_file_loads_and_is_a_ros_parameter_file(path):
    assert isinstance(config.load_config(path), RigConfig)
    assert set(yaml.safe_load(path.read_text(encoding="utf-8"))["/**"]) == {"ros__parameters"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_value_of_a_file_has_unit_and_origin(path):
    lines = list(value_lines(path))
    for name, line, found in lines:
        assert found["unit"] == FIELDS[name].unit, line
        assert found["origin"] in {origin.value for origin in Origin}, line
    values = flatten(yaml.safe_load(path.read_text(encoding="utf-8"))["/**"]["ros__parameters"])
    assert [name for name, _, _ in lines] == list(values)


def test_the_nominal_file_is_the_complete_default_configuration():
    path = config_dir() / "nominal.yaml"
    assert config.load_config(path) == RigConfig()
    assert [name for name, _, _ in value_lines(path)] == list(FIELDS)


@pytest.mark.ros
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_ros_reads_the_same_values_with_the_same_types(path):
    """A float without a point, or an empty list, would have another type in ROS."""
    import rclpy
    from rclpy.node import Node

    context = rclpy.Context()
    rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context)
    try:
        node = Node("reader", context=context, automatically_declare_parameters_from_overrides=True)
        read = {name: node.get_parameter(name).value for name, _, _ in value_lines(path)}
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    expected = config.to_flat(config.load_config(path))
    for name, value in read.items():
        wanted = list(expected[name] or ("",)) if isinstance(expected[name], tuple) else expected[name]
        assert (value, type(value)) == (wanted, type(wanted)), name
