"""The launch file fits the package: its programs, parameters and arguments exist and are described.

`launch` comes with an apt-installed ROS only; elsewhere the file is read as a syntax tree.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from impact_rig.rig import config
from impact_rig.system.resources import share_dir

FILE = share_dir() / "launch" / "rig.launch.py"
TREE = ast.parse(FILE.read_text(encoding="utf-8"), FILE.name)


def calls(name: str) -> Iterator[ast.Call]:
    for node in ast.walk(TREE):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name:
            yield node


def keyword(call: ast.Call, name: str) -> ast.expr:
    return next(word.value for word in call.keywords if word.arg == name)


def text(node: ast.expr) -> str:
    assert isinstance(node, ast.Constant)
    return str(node.value)


def declared() -> dict[str, ast.Call]:
    return {text(call.args[0]): call for call in calls("DeclareLaunchArgument")}


def test_every_argument_is_described_and_has_a_default():
    for call in declared().values():
        assert text(keyword(call, "description")).endswith(".")
        assert keyword(call, "default_value")


def test_every_argument_is_used_and_every_used_one_declared():
    assert {text(call.args[0]) for call in calls("LaunchConfiguration")} == set(declared())


def test_the_programs_are_those_that_are_installed():
    setup = (share_dir() / "setup.py").read_text(encoding="utf-8")
    for call in calls("Node"):
        assert f'"{text(keyword(call, "executable"))} = impact_rig.' in setup


def test_the_modes_are_those_of_the_configuration():
    modes = next(about.choices for name, about, _ in config.fields() if name == "time.mode")
    assert tuple(ast.literal_eval(keyword(declared()["mode"], "choices"))) == ("", *modes)


def parameters(node: ast.Call) -> set[str]:
    """Return the keys of the dictionaries given to a node, by their text."""
    dictionaries = [item for item in ast.walk(keyword(node, "parameters")) if isinstance(item, ast.Dict)]
    return {text(key) for dictionary in dictionaries for key in dictionary.keys if key is not None}


def given() -> set[str]:
    """Return the rig's parameters that arguments put on top of the file."""
    targets = (target for node in ast.walk(TREE) if isinstance(node, ast.Assign) for target in node.targets)
    return {text(target.slice) for target in targets if isinstance(target, ast.Subscript)}


@pytest.mark.ros
def test_the_parameters_are_those_of_the_nodes():
    from impact_rig.nodes.parameters import CONFIG_FILE, RigSchema, SectionSchema
    from impact_rig.nodes.settings import AnalysisSettings, RecorderSettings

    schemas = {"rig": RigSchema(), "analysis": SectionSchema(AnalysisSettings)}
    schemas["recorder"] = SectionSchema(RecorderSettings)
    nodes = {text(keyword(call, "name")): call for call in calls("Node")}
    assert set(nodes) == {*schemas, "lab"}  # the lab's own are in impact_rig/lab/node.py
    for name, schema in schemas.items():
        known = {field for field, _, _ in schema.fields()} | {CONFIG_FILE}
        assert parameters(nodes[name]) <= known, name
    rig = {field for field, _, _ in schemas["rig"].fields()}
    assert {"time.mode", "time.factor", "time.peers", "time.start_wait_s"} == given() <= rig


def test_every_namespace_has_its_own_clock():
    """All nodes are started with `common`: those that follow rig time, and the one that makes it."""
    assert all(any(word.arg is None for word in call.keywords) for call in calls("Node")), "**common"
    pairs = [ast.unparse(node) for node in ast.walk(TREE) if isinstance(node, ast.Tuple)]
    assert "('/clock', LaunchConfiguration('clock'))" in pairs
    assert not text(keyword(declared()["clock"], "default_value")).startswith("/")


def test_launch_itself_reads_it():
    pytest.importorskip("launch_ros", reason="launch comes with an apt-installed ROS 2 only")
    from launch.launch_description_sources import get_launch_description_from_python_launch_file

    description = get_launch_description_from_python_launch_file(str(FILE))
    assert {argument.name for argument in description.get_launch_arguments()} == set(declared())
