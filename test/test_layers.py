# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The layers of the package hold: who may import whom, and what importing costs."""

from __future__ import annotations

import ast
import pkgutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

import impact_rig

ROOT = Path(__file__).parent.parent
WITHOUT_ROS = sorted(
    module.name
    for module in pkgutil.iter_modules(impact_rig.__path__, "impact_rig.")
    if module.name not in ("impact_rig.nodes", "impact_rig.testing")
)
NUMERICS = [
    name for name in WITHOUT_ROS if name.split(".")[1] in ("physics", "instruments", "analysis", "rig", "codec")
]


def test_import_contracts_hold():
    """The contracts are in pyproject.toml, one for each arrow that must not exist."""
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
    """Return the top-level modules that a fresh interpreter holds after importing `modules`."""
    code = f"import importlib, sys\nfor m in {modules!r}: importlib.import_module(m)\nprint(*sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return {name.split(".")[0] for name in result.stdout.split()}


def test_nothing_but_nodes_and_testing_needs_ros():
    assert _imported_by(WITHOUT_ROS).isdisjoint({"rclpy", "launch", "launch_ros"})


def test_numerics_load_no_figures_and_no_tables():
    """A node that publishes samples must not pay for matplotlib, nor fail where it is not installed."""
    assert _imported_by([name for name in NUMERICS if name in WITHOUT_ROS]).isdisjoint({"matplotlib", "rich"})


def test_recordings_are_read_without_a_compiler():
    """`impact-rig info` must not take half a second and 60 MB for Numba."""
    assert _imported_by(["impact_rig.recording"]).isdisjoint({"numba", "scipy", "matplotlib"})


def test_importing_the_package_itself_is_cheap():
    assert _imported_by(["impact_rig"]).isdisjoint({"rclpy", "numba", "numpy", "scipy", "matplotlib", "rich"})


def test_there_is_one_version():
    """package.xml is what setup.py and ROS read; package and citation say the same, and the changelog knows it."""
    in_package_xml = ET.parse(ROOT / "package.xml").findtext("version")
    assert in_package_xml == impact_rig.__version__
    assert f"\nversion: {in_package_xml}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n{in_package_xml} (" in (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8")


def test_one_word_names_one_class():
    """`Motion`, `State` or `Plan` once named four classes each: a reader could not tell which one a sentence meant."""
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "impact_rig").rglob("*.py"))
    names = Counter(node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef))
    assert len(names) > 200
    assert [name for name, count in names.items() if count > 1] == []
