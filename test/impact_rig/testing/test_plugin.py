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
"""Pytest plugin: it loads quickly, is registered where pytest searches, and does not disturb other suites."""

from __future__ import annotations

import importlib
import os
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from impact_rig.recording import open_run
from impact_rig.runs.verification import verify
from impact_rig.testing import LocalRig, plugin

ROOT = Path(__file__).parents[3]


def test_loading_the_plugin_loads_neither_ros_nor_compiled_code() -> None:
    """It is loaded in every pytest run of every environment that has this package."""
    code = "import impact_rig.testing.plugin, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert "impact_rig" in loaded
    assert loaded.isdisjoint({"rclpy", "numba", "numpy", "scipy", "matplotlib"})


def test_setup_py_registers_the_plugin_under_the_name_of_its_module(monkeypatch: pytest.MonkeyPatch) -> None:
    """With any other name, a pytest with `-p` for the module would load it twice and fail."""
    found: dict[str, Any] = {}
    monkeypatch.setattr("setuptools.setup", lambda **kwargs: found.update(kwargs))
    monkeypatch.chdir(ROOT)
    runpy.run_path(str(ROOT / "setup.py"))
    ((name, module),) = (line.split(" = ") for line in found["entry_points"]["pytest11"])
    assert name == module == importlib.import_module(module).__name__
    assert any(requirement.startswith("pytest") for requirement in found["extras_require"]["wheels"])


def test_all_public_names_of_the_package_can_be_imported() -> None:
    testing = importlib.import_module("impact_rig.testing")
    assert [name for name in testing.__all__ if getattr(testing, name).__name__ != name] == []
    with pytest.raises(AttributeError, match="no attribute 'Rug'"):
        _ = testing.Rug


def test_the_rigs_of_a_test_have_different_names(request: pytest.FixtureRequest) -> None:
    """Each rig has a folder; after one is closed, the next one must not get the name of one that still exists."""
    started = plugin._starting(request, lambda name: LocalRig(name=name))
    start = next(started)
    first, second = start(), start()
    first.close()
    assert (first.name, second.name, start().name, start().name) == ("rig", "rig2", "rig", "rig3")
    assert next(started, None) is None


SHARED = """
import numpy as np
import pytest
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

seen = []

class Raises(Node):
    def __init__(self):
        super().__init__("raises")
        self.create_subscription(PointCloud2, "daq/scan", self.on_scan, 10)

    def on_scan(self, message):
        raise RuntimeError("of a node")

@pytest.fixture
def rig(FIXTURE):
    rig = FIXTURE({"daq.rate_hz": 1000, "barriers.gap_m": 0.004}, scope="SCOPE", **OPTIONS)
    assert (rig.sample, rig.config.barriers.gap_m, rig.faults, rig.stopped) == (0, 0.004, [], "")
    rig.command(9.1, 0.5, at_sample=100)
    rig.step(20)
    seen.append((id(rig), rig.rows().tobytes(), len(rig.journal())))
    yield rig

@pytest.mark.parametrize("number", range(2))
def test_disturbs(rig, number):
    rig.configure({"barriers.gap_m": 0.006})
    rig.connect(lambda block: 1 / 0)
    assert number == 0

def test_ends_with_a_node(rig):
    if hasattr(rig, "host"):
        rig.host(Raises)
        rig.step()

def test_all_rigs_are_as_new(rig):
    assert len({rows for _, rows, _ in seen}) == 1
    assert len({entries for _, _, entries in seen}) == 1
    pytest.fail(f"different rigs: {len({number for number, _, _ in seen})}")
"""


KINDS: dict[str, tuple[str, dict[str, Any], str, int, int]] = {
    # fixture, its options, scope, number of different rigs, number of failed tests
    "hosted": ("ros_rig", {"hosted": True}, "module", 1, 3),
    "processes": ("ros_rig", {}, "session", 1, 3),
    "virtual": ("virtual_rig", {}, "module", 4, 2),  # a new one takes milliseconds
}


@pytest.fixture(scope="module")
def shared_rigs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run the tests of all `KINDS`, one file each, in one pytest, and return their folder with its JUnit file."""
    folder = tmp_path_factory.mktemp("shared")
    for kind, (fixture, options, scope, _, _) in KINDS.items():
        text = SHARED.replace("FIXTURE", fixture).replace("SCOPE", scope).replace("OPTIONS", repr(options))
        (folder / f"test_{kind}.py").write_text(text)
    words = [sys.executable, "-m", "pytest", "-q", "-p", "impact_rig.testing.plugin", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([*words, "--junitxml=found.xml"], cwd=folder, env=environment, check=False, capture_output=True)
    return folder


@pytest.mark.ros
@pytest.mark.pipeline
@pytest.mark.parametrize("kind", KINDS)
def test_a_rig_of_a_module_or_session_is_reset_for_each_test(shared_rigs: Path, kind: str) -> None:
    *_, different, failed = KINDS[kind]
    cases = [
        one for one in ET.parse(shared_rigs / "found.xml").iter("testcase") if one.get("classname") == f"test_{kind}"
    ]
    messages = [str(failure.get("message")) for one in cases for failure in (*one.iter("failure"), *one.iter("error"))]
    assert (len(cases), len(messages)) == (4, failed), messages
    assert any(f"different rigs: {different}\n" in f"{message}\n" for message in messages), messages
    runs = list((shared_rigs / "failed_runs").glob(f"test_{kind}.py_*"))
    for run in runs:
        with open_run(run / "rig") as left:
            assert str(verify(left)).startswith("identical"), run
    assert len(runs) == failed


@pytest.mark.ros
@pytest.mark.pipeline
def test_each_failure_names_a_complete_run_in_an_environment_like_that_of_a_container() -> None:
    """Eight of the fifty tests that `qualification/container_tests.py` runs, with all five that fail."""
    program = [sys.executable, str(ROOT / "qualification/container_tests.py"), "--tests", "8"]
    if os.getuid() == 0 and subprocess.run(["unshare", "--mount", "true"], check=False).returncode:
        pytest.skip("this machine allows no mounts of one's own")
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "8 tests, 5 failures, each with a complete run" in done.stdout


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


def test_the_junit_file_lists_the_requirements_of_every_test(tmp_path: Path) -> None:
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
