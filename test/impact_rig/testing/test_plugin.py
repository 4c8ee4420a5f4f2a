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
"""The pytest plugin: cheap to load, registered where pytest looks, out of the way of other suites."""

from __future__ import annotations

import importlib
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from impact_rig.testing import LocalRig, plugin

ROOT = Path(__file__).parents[3]


def test_loading_it_loads_neither_ros_nor_compiled_code() -> None:
    """It is loaded in every pytest run of every environment that has this package."""
    code = "import impact_rig.testing.plugin, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert "impact_rig" in loaded
    assert loaded.isdisjoint({"rclpy", "numba", "numpy", "scipy", "matplotlib"})


def test_setup_py_registers_it_under_its_own_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """With any other name, a pytest with `-p` for the module would load it twice and fail."""
    found: dict[str, Any] = {}
    monkeypatch.setattr("setuptools.setup", lambda **kwargs: found.update(kwargs))
    monkeypatch.chdir(ROOT)
    runpy.run_path(str(ROOT / "setup.py"))
    ((name, module),) = (line.split(" = ") for line in found["entry_points"]["pytest11"])
    assert name == module == importlib.import_module(module).__name__
    assert any(requirement.startswith("pytest") for requirement in found["extras_require"]["wheels"])


def test_everything_the_package_offers_can_be_had() -> None:
    testing = importlib.import_module("impact_rig.testing")
    assert [name for name in testing.__all__ if getattr(testing, name).__name__ != name] == []
    with pytest.raises(AttributeError, match="no attribute 'Rug'"):
        _ = testing.Rug


def test_no_two_rigs_of_a_test_have_one_name(request: pytest.FixtureRequest) -> None:
    """They have a folder each; after one was closed, the next was once called as one that was still there."""
    started = plugin._starting(request, lambda name: LocalRig(name=name))
    start = next(started)
    first, second = start(), start()
    first.close()
    assert (first.name, second.name, start().name, start().name) == ("rig", "rig2", "rig", "rig3")
    assert next(started, None) is None


MARKED = """
import pytest
pytestmark = pytest.mark.requirement("R1")

@pytest.mark.requirement("R2", "R3")
@pytest.mark.requirement("R1")
def test_passes(): pass

@pytest.mark.requirement("R4")
def test_fails(): assert False

@pytest.mark.requirement("R5")
@pytest.mark.skip
def test_skipped(): pass
"""


def test_requirements_are_in_the_junit_file_of_every_test(tmp_path: Path) -> None:
    (tmp_path / "test_marked.py").write_text(MARKED)
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "--strict-markers",
        "-p",
        "impact_rig.testing.plugin",
        "--junitxml=found.xml",
    ]
    subprocess.run([*words, "test_marked.py"], cwd=tmp_path, check=False, capture_output=True)
    cases = ET.parse(tmp_path / "found.xml").iter("testcase")
    found = {
        case.get("name"): [one.get("value") for one in case.iter("property") if one.get("name") == "requirement"]
        for case in cases
    }
    assert found["test_passes"] == ["R1", "R2", "R3"]
    assert found["test_fails"] == ["R4", "R1"]
