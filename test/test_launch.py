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
"""The launch files fit the package: programs, parameters and arguments exist, and they start what is requested.

`launch` comes with an apt-installed ROS only; elsewhere stand-ins are used, which keep their arguments.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml
from kits.launched import (
    Context,
    GroupAction,
    IncludeLaunchDescription,
    SetEnvironmentVariable,
    Shutdown,
    context_of,
    declared,
    description,
    nodes,
    perform,
    used,
)

from impact_rig.errors import ConfigError
from impact_rig.rig import config
from impact_rig.system.endings import PARENT_VARIABLE
from impact_rig.system.files import share_dir

LAUNCH = share_dir() / "launch"
RIG, TWO = LAUNCH / "rig.launch.py", LAUNCH / "two_rigs.launch.py"
FILES = sorted(LAUNCH.glob("*.launch.py"))


def parameters(node: dict[str, Any]) -> dict[str, Any]:
    """Return a node's parameters; later ones win, as in launch."""
    merged: dict[str, Any] = {}
    for part in node["parameters"]:
        merged |= part
    return merged


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_argument_is_described_has_a_default_and_is_used(path: Path) -> None:
    known = declared(description(path))
    for argument in known.values():
        assert argument.words["description"].endswith(".")
        assert isinstance(argument.words["default_value"], str) or hasattr(argument.words["default_value"], "perform")
    assert used(path) == set(known)


def test_the_launched_programs_are_installed() -> None:
    setup = (Path(__file__).parents[1] / "setup.py").read_text(encoding="utf-8")
    for node in nodes(RIG, lab="true").values():
        assert f'"{node["executable"]} = impact_rig' in setup


def test_the_choices_of_the_mode_are_those_of_the_configuration() -> None:
    modes = next(about.choices for name, about, _ in config.fields() if name == "time.mode")
    assert tuple(declared(description(RIG))["mode"].words["choices"]) == ("", *modes)


def test_four_nodes_start_by_default_and_scan_0_waits_for_two_of_them() -> None:
    started = nodes(RIG)
    assert list(started) == ["rig", "analysis", "recorder", "plot"]
    assert list(nodes(RIG, plot="false")) == ["rig", "analysis", "recorder"]
    assert {node["namespace"] for node in started.values()} == {"rig"}
    rig = parameters(started["rig"])
    assert rig.pop("config_file").endswith("config/nominal.yaml")
    assert rig == {"time.peers": ["analysis", "recorder"]}
    assert parameters(started["recorder"]) == {
        "use_sim_time": False, "autostart": True, "directory": "runs", "record": True,
    }  # fmt: skip


def test_common_settings_are_launch_arguments() -> None:
    started = nodes(
        RIG,
        mode="realtime",
        factor="0.5",
        overrides="{barriers: {gap_m: 0.004}, daq.seed: 7}",
        autostart="false",
        namespace="cell/two",
        record="false",
        record_directory="/data",
        peers="analysis,mine",
        start_wait="3",
    )
    rig = parameters(started["rig"])
    del rig["config_file"]
    assert rig == {
        "barriers.gap_m": 0.004, "daq.seed": 7, "time.mode": "realtime", "time.factor": 0.5, "time.start_wait_s": 3.0,
        "output.autostart": False, "time.peers": ["analysis", "mine"],
    }  # fmt: skip
    assert parameters(started["recorder"]) == {
        "use_sim_time": True, "autostart": False, "directory": "/data", "record": False,
    }  # fmt: skip
    assert parameters(started["analysis"]) == {"use_sim_time": True, "autostart": False}


def test_blanks_between_the_names_of_peers_are_allowed() -> None:
    """Scan 0 must not wait for a peer called ` recorder`, whose end nothing would notice."""
    started = nodes(RIG, peers="analysis, recorder", required="rig, recorder")
    assert parameters(started["rig"])["time.peers"] == ["analysis", "recorder"]
    assert [name for name, node in started.items() if "on_exit" in node] == ["rig", "recorder"]


def test_all_nodes_wait_for_lifecycle_services_if_the_rig_does() -> None:
    """Analysis and recorder must not start by themselves if the configuration says that the rig does not."""
    started = nodes(RIG, overrides="{output.autostart: false}")
    assert [parameters(started[name])["autostart"] for name in ("analysis", "recorder")] == [False, False]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("overrides", "{gap_m: 1}"),
        ("overrides", "{barriers.gap_m: -1}"),
        ("overrides", "{barriers.gap_m: "),
        ("overrides", "0.004"),
        ("config", "/nowhere/rig.yaml"),
        ("factor", "abc"),
        ("factor", "-1"),
        ("start_wait", "soon"),
        ("start_wait", "nan"),
        ("frame_prefix", "left-right"),
        ("required", "rig,player"),
    ],
)
def test_an_invalid_argument_is_rejected_by_name_before_any_node_starts(name: str, value: str) -> None:
    with pytest.raises(ConfigError, match=f"^launch argument {name}\\b") as refused:
        nodes(RIG, **{name: value})
    assert "\n" not in str(refused.value)


@pytest.mark.ros
def test_the_launched_parameters_exist_on_the_nodes() -> None:
    from impact_rig.config.tree import Tree
    from impact_rig.nodes.analysis_node import AnalysisSettings
    from impact_rig.nodes.parameters import CONFIG_FILE
    from impact_rig.nodes.recorder_node import RecorderSettings
    from impact_rig.rig.config import TREE

    schemas = {"rig": TREE, "analysis": Tree(AnalysisSettings)}
    schemas["recorder"] = Tree(RecorderSettings)
    started = nodes(RIG, mode="free_running", factor="1", start_wait="1", autostart="true")
    for name, schema in schemas.items():
        known = {field for field, _, _ in schema.fields()} | {CONFIG_FILE, "use_sim_time"}
        assert set(parameters(started[name])) <= known, name
    assert "use_sim_time" not in parameters(started["rig"]), "it makes the time"


def test_every_namespace_has_a_separate_clock() -> None:
    for node in nodes(RIG, rviz="true", lab="true").values():
        assert ("/clock", "clock") in node["remappings"]


def test_the_end_of_a_required_node_or_of_the_launcher_ends_all_nodes() -> None:
    """After Ctrl-C, or after another required node, a node that ends does not report that it was required."""
    running, ending = Context({}), Context({})
    ending.is_shutdown = True
    for name, node in nodes(RIG, plot="false").items():
        (shutdown,) = (node["on_exit"](None, context) for context in (running,))
        assert isinstance(shutdown, Shutdown)
        assert name in shutdown.words["reason"]
        assert node["on_exit"](None, ending) is None
    some = nodes(RIG, required="rig", rviz="true")
    assert [name for name, node in some.items() if "on_exit" in node] == ["rig"]
    variables = [entity.args[0] for entity in description(RIG) if isinstance(entity, SetEnvironmentVariable)]
    assert PARENT_VARIABLE in variables


@pytest.mark.parametrize(
    ("pushed", "namespace", "given", "prefix"),
    [
        ("/left", "rig", "auto", "left/rig/"),
        ("/left", "/rig", "auto", "rig/"),
        ("", "", "auto", ""),
        ("/left", "", "auto", "left/"),
        ("/left", "rig", "my/", "my/"),
        ("/left", "rig", "", ""),
    ],
)
def test_frames_follow_the_effective_namespace(pushed: str, namespace: str, given: str, prefix: str) -> None:
    started = nodes(RIG, pushed_namespace=pushed, namespace=namespace, frame_prefix=given, state_publisher="true")
    assert parameters(started["robot_state_publisher"])["frame_prefix"] == prefix
    prefix = parameters(started["rig"]).get("output.frame_prefix")
    assert prefix == {"auto": None, "": "/"}.get(given, given), "by itself the node follows its namespace"


def test_rviz_and_tf_start_on_request_and_agree_on_frames() -> None:
    """robot_state_publisher follows the truth, and leaves the description's topic to the rig."""
    started = nodes(RIG, rviz="true", pushed_namespace="/cell", namespace="two", overrides="{barriers.gap_m: 0.01}")
    state = started["robot_state_publisher"]
    assert ("joint_states", "truth/joint_states") in state["remappings"]
    assert ("robot_description", "robot_state_publisher/robot_description") in state["remappings"]
    assert parameters(state)["frame_prefix"] == "cell/two/"
    links = {link.get("name") for link in ET.fromstring(parameters(state)["robot_description"]).iter("link")}
    _, file = started["rviz"]["arguments"]
    shown = yaml.safe_load(Path(file).read_text(encoding="utf-8"))["Visualization Manager"]
    fixed = shown["Global Options"]["Fixed Frame"]
    assert fixed.removeprefix("cell/two/") in links
    (robot,) = [display for display in shown["Displays"] if display["Name"] == "Rig"]
    assert robot["TF Prefix"] == "cell/two"
    assert robot["Description Topic"]["Value"] == "robot_description"
    assert "rviz" not in nodes(RIG, state_publisher="true")


def test_two_rigs_have_separate_namespaces_clocks_and_folders() -> None:
    entities = description(TWO)
    context = context_of(entities, {"mode": "free_running"})
    groups = [entity for entity in entities if isinstance(entity, GroupAction)]
    assert all(group.words == {"scoped": True} for group in groups)
    given = []
    for group in groups:
        (include,) = group.args[0]
        assert isinstance(include, IncludeLaunchDescription)
        assert perform(include.args[0].args[0], context) == str(RIG)
        given.append(perform(dict(include.words["launch_arguments"]), context))
    assert [one["namespace"] for one in given] == ["rig1", "rig2"]
    assert [one["record_directory"] for one in given] == ["runs/rig1", "runs/rig2"]
    started = [nodes(RIG, **one) for one in given]
    for rigs in zip(*(one.values() for one in started), strict=True):
        assert len({node["namespace"] for node in rigs}) == 2
        assert all(("/clock", "clock") in node["remappings"] for node in rigs), "relative: one per namespace"
    assert parameters(started[1]["rig"])["daq.seed"] == 2
    assert {one["mode"] for one in given} == {"free_running"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_the_launch_system_reads_each_file(path: Path) -> None:
    pytest.importorskip("launch_ros", reason="launch comes with an apt-installed ROS 2 only")
    from launch.launch_description_sources import get_launch_description_from_python_launch_file

    read = get_launch_description_from_python_launch_file(str(path))
    assert {argument.name for argument in read.get_launch_arguments()} >= set(declared(description(path)))
