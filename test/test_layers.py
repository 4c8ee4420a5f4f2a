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
"""Layers of the package: which parts may import which, and what an import costs."""

from __future__ import annotations

import argparse
import ast
import pkgutil
import re
import runpy
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

import impact_rig
import impact_rig_studies
from impact_rig.cli.main import command_line, commands
from impact_rig.cli.parsers import analyses
from impact_rig.kernels.build import NUMBA
from tools import release

ROOT = Path(__file__).parent.parent
WITH_ROS = {
    "impact_rig.nodes", "impact_rig_studies.ros_campaign", "impact_rig_studies.stepped_sine_node",
}  # fmt: skip
WITHOUT_ROS = sorted(
    module.name
    for package in (impact_rig, impact_rig_studies)
    for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}.")
    if module.name not in WITH_ROS and not module.name.endswith(".__main__")
)
NUMERICS = [
    name
    for name in WITHOUT_ROS
    if name.startswith("impact_rig.") and name.split(".")[1] in ("physics", "instruments", "analysis", "rig", "codec")
]


def test_import_contracts_hold():
    """The contracts are in pyproject.toml, one for each forbidden import."""
    pytest.importorskip("importlinter")
    result = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as main; main()", "--no-cache"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr


def _imported_by(modules: list[str]) -> set[str]:
    """Return the top-level modules that a fresh interpreter has loaded after importing `modules`."""
    code = f"import importlib, sys\nfor m in {modules!r}: importlib.import_module(m)\nprint(*sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return {name.split(".")[0] for name in result.stdout.split()}


def test_only_nodes_and_testing_need_ros():
    assert not _imported_by(WITHOUT_ROS) & {"rclpy", "launch", "launch_ros"}


def test_numerical_modules_load_no_plotting_and_no_table_library():
    """A node that publishes samples must not load matplotlib, nor fail if it is not installed."""
    assert not _imported_by([name for name in NUMERICS if name in WITHOUT_ROS]) & {"matplotlib", "rich"}


def test_recordings_are_read_without_a_compiler():
    """`impact-rig info` must not need half a second and 60 MB for Numba."""
    assert not _imported_by(["impact_rig.recording"]) & {"numba", "scipy", "matplotlib"}


def test_importing_the_package_itself_is_cheap():
    assert not _imported_by(["impact_rig"]) & {"rclpy", "numba", "numpy", "scipy", "matplotlib", "rich"}


def test_the_help_of_the_commands_imports_no_large_library():
    """Importing SciPy alone would take 1.1 s."""
    code = "from impact_rig.cli.main import command_line; import sys; command_line(); print(*sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = result.stdout.split()
    assert not {"numpy", "rich", "scipy", "matplotlib", "numba", "rclpy", "ssl", "mcap", "jinja2"}.intersection(loaded)
    assert len(loaded) < 300


def test_every_command_names_a_function():
    """A parser names the function of its command as text, which no type checker follows."""

    def functions(parser: argparse.ArgumentParser) -> Iterator[str]:
        below = [one for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
        if not below:
            yield parser.get_default("run").args[0]
        for one in below:
            for command in one.choices.values():
                yield from functions(command)

    named = [*functions(command_line()), *(one.run for one in analyses())]
    assert len(named) > len(commands())
    for name in named:
        assert callable(pkgutil.resolve_name(name)), name


def test_all_files_state_the_same_version():
    """setup.py and ROS read package.xml; package and citation state the same version, and the changelog contains it."""
    in_package_xml = ET.parse(ROOT / "package.xml").findtext("version")
    assert in_package_xml == impact_rig.__version__
    assert f"\nversion: {in_package_xml}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    headings = re.findall(r"^(.+)\n-+$", (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8"), re.MULTILINE)
    # as catkin_pkg reads them: the next release, or a version with its date
    assert headings[0] == "Forthcoming" or headings[0].startswith(f"{in_package_xml} (")
    assert all(re.fullmatch(r"Forthcoming|\d+\.\d+\.\d+ \(\d{4}-\d{2}-\d{2}\)", heading) for heading in headings)
    assert not headings[1:].count("Forthcoming")


KEYS = {"Jinja2": "python3-jinja2", "mcap": "mcap-ros2-support", "PyYAML": "python3-yaml"}
"""Keys of rosdistro that are not python3- and the name of the distribution."""
WITHOUT_KEY = {"uplot-python"}


@pytest.fixture
def given(monkeypatch):
    """The arguments of `setup`."""
    found = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("setuptools.setup", lambda **arguments: found.update(arguments))
    runpy.run_path("setup.py")
    return found


def test_the_page_of_the_installation_lists_every_extra(given):
    page = (ROOT / "docs" / "how-to" / "install.md").read_text(encoding="utf-8")
    table = page.partition("| extra | adds |\n|---|---|\n")[2].partition("\n\n")[0]
    assert sorted(re.findall(r"^\| `(\w+)` \| \S", table, re.MULTILINE)) == sorted(given["extras_require"])


def test_package_xml_names_every_dependency_that_has_a_key(given):
    """After `rosdep install`, the package must be able to import mcap, for example."""
    extras = [one for extra in ("jit", "lab", "completion") for one in given["extras_require"][extra]]
    needed = [*given["install_requires"], *extras]
    names = {re.match(r"[\w-]+", requirement)[0] for requirement in needed} - WITHOUT_KEY
    declared = {one.text for one in ET.parse(ROOT / "package.xml").iter("exec_depend")}
    assert {KEYS.get(name, f"python3-{name}") for name in names} <= declared
    assert given["url"] == ET.parse(ROOT / "package.xml").findtext("url")


def test_a_release_needs_a_maintainer_and_an_address(tmp_path):
    text = (ROOT / "package.xml").read_text(encoding="utf-8")
    package = tmp_path / "package.xml"
    package.write_text(text.replace("example.org", release.PLACEHOLDER), encoding="utf-8")
    assert release.placeholders(package) == ["maintainer", "url"]
    package.write_text(text.replace("example.org", "rig-lab.edu"), encoding="utf-8")
    assert release.placeholders(package) == []


def test_instructions_to_build_kernels_name_the_version_of_numba():
    """Kernels are built by one exact version of Numba: with another one, a workspace has no library of kernels."""
    for name in ("docs/tutorials/first_node.md", ".github/workflows/ci.yaml", "Dockerfile", "requirements/kernels.txt"):
        text = (ROOT / name).read_text(encoding="utf-8")
        versions = re.findall(r"numba==([\d.]+)", text)
        assert versions, name
        assert set(versions) == {NUMBA}, name
        assert not re.search(r"pip install .*\bnumba(?!==)", text), name


@pytest.mark.heavy
def test_each_class_has_a_unique_name():
    """If `Motion`, `State` or `Plan` named several classes, a reader could not tell which one a sentence means."""
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in ROOT.glob("impact_rig*/**/*.py"))
    names = Counter(node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef))
    assert len(names) > 200
    assert [name for name, count in names.items() if count > 1] == []
