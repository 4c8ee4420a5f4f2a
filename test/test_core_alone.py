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
"""The rig alone, without `impact_rig_studies` and `impact_rig_lab`: it imports, has commands, and passes its tests."""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

pytestmark = pytest.mark.heavy

ROOT = Path(__file__).parents[1]
REMOVED = ("impact_rig_studies", "impact_rig_lab")
TESTS = ("cli", "rig/test_commands.py", "runs/test_exports.py", "driver/test_local_rig.py")
"""Tests of the rig that run in some seconds without another process."""
ALONE = f"""\
import sys

class Removed:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {REMOVED!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Removed())
"""
EVERY_MODULE = """\
import alone, importlib, importlib.util, pathlib, pkgutil
import impact_rig
assert pathlib.Path(impact_rig.__file__).parent.parent == pathlib.Path.cwd()
with_ros = importlib.util.find_spec("rclpy") is not None
for module in pkgutil.walk_packages(impact_rig.__path__, "impact_rig."):
    needs_ros = module.name.startswith((
        "impact_rig.nodes", "impact_rig.client.client", "impact_rig.client.service_call", "impact_rig.driver.ros_rig",
    ))
    if not module.name.endswith((".__main__", "._library")) and (with_ros or not needs_ros):
        importlib.import_module(module.name)
        print(module.name)
"""


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the rig, its tests and its entry points, without the other packages."""
    folder = tmp_path_factory.mktemp("core")
    ignored = shutil.ignore_patterns("__pycache__")
    for name in ("impact_rig", "config", "launch", "urdf", "test/impact_rig", "test/kits", "test/data/third_version"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for name in ("pyproject.toml", "package.xml"):
        shutil.copy(ROOT / name, folder / name)
    for path in (ROOT / "test").glob("*.py"):
        if not path.name.startswith("test_"):  # what every test gets
            shutil.copy(path, folder / "test")
    groups: dict[str, list[str]] = {}
    for one in metadata.distribution("impact_rig").entry_points:
        if one.module.partition(".")[0] not in REMOVED:
            groups.setdefault(one.group, []).append(f"{one.name} = {one.value}")
    info = folder / "impact_rig-0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: impact_rig\nVersion: 0\n")
    (info / "entry_points.txt").write_text(
        "\n".join("\n".join([f"[{group}]", *rows]) for group, rows in groups.items()) + "\n"
    )
    (folder / "alone.py").write_text(ALONE)
    return folder


def python(core: Path, code: str) -> str:
    """Run a program in the folder and return what it printed."""
    done = subprocess.run([sys.executable, "-c", code], cwd=core, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def test_every_module_of_the_core_can_be_imported(core: Path) -> None:
    modules = python(core, EVERY_MODULE).split()
    assert len(modules) > 100
    assert "impact_rig.runs.verification" in modules


def test_the_command_line_of_the_core_has_the_commands_of_the_rig(core: Path) -> None:
    page = python(
        core, "import alone; from impact_rig.cli.main import command_line; print(command_line().format_help())"
    )
    found = {line.split()[0] for line in page.splitlines() if line.startswith("  ") and line[2] != " "}
    assert {"info", "analyze", "verify", "replay", "recover", "export", "check"} <= found
    assert found.isdisjoint({"lab", "campaign", "map", "import", "report"})


def test_the_tests_of_the_core_pass(core: Path) -> None:
    tests = [f"test/impact_rig/{name}" for name in TESTS]
    words = [*tests, "-q", "--check", "-p", "no:cacheprovider", "-p", "no:xdist"]
    python(core, f"import sys, alone, pytest; sys.exit(pytest.main({words!r}))")
