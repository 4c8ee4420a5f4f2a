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
"""Worked examples in `examples/`, run as a reader runs them: a separate pytest with the plugin loaded."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.pipeline, pytest.mark.timeout(300)]

ROOT = Path(__file__).parents[3]
EXAMPLES = ROOT / "examples"


def test_every_example_passes(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pytest", "-p", "impact_rig.testing.plugin", "-p", "no:cacheprovider", "-q"]
    done = subprocess.run(
        [*command, "-c", os.devnull, f"--rootdir={EXAMPLES}", f"--rig-runs={tmp_path}", str(EXAMPLES)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    written = sum(len(re.findall(r"^def test_", path.read_text(), re.MULTILINE)) for path in EXAMPLES.glob("test_*.py"))
    assert done.returncode == 0, done.stdout
    assert f"{written} passed" in done.stdout
    assert not list(tmp_path.iterdir()), "only failures leave runs"


def test_pytest_collects_the_examples_in_a_checkout() -> None:
    """Run `pytest examples` with the configuration of this repository, and nothing of it on the path."""
    command = [sys.executable, "-P", "-m", "pytest", "-p", "impact_rig.testing.plugin", "-p", "no:cacheprovider"]
    command += ["-q", "--collect-only", "examples"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "tests collected" in done.stdout


@pytest.mark.parametrize(
    ("page", "name"), [("tutorials/first_node", "first_node.py"), ("how-to/drive", "velocity_feedback.py")]
)
def test_the_nodes_of_the_pages_are_the_tested_ones(page: str, name: str) -> None:
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    (block,) = re.findall(rf"^```python title=examples/{name}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    notice, file = re.split("^(?!#)", (EXAMPLES / name).read_text(encoding="utf-8"), maxsplit=1, flags=re.M)
    assert "Copyright" in notice
    assert block == file


def test_example_pipelines_do_not_import_this_package() -> None:
    """Pipelines under test know topics and messages, not this package; only the analysis of a file may import it."""
    for path in EXAMPLES.glob("*.py"):
        ours = re.findall(r"^[ ]*(?:from|import) impact_rig\S*", path.read_text(), re.MULTILINE)
        if not path.name.startswith("test_") and path.name != "launched_rig.py":  # a test for an installed ROS
            assert ours == (["from impact_rig.recording"] if path.name == "analyse_run.py" else []), path.name


def test_all_files_of_the_examples_are_installed() -> None:
    listed = re.search(r"^EXAMPLES = \[(.*?)^\]", (ROOT / "setup.py").read_text(), re.MULTILINE | re.DOTALL)
    assert listed is not None
    files = [path for suffix in ("py", "md", "json") for path in EXAMPLES.rglob(f"*.{suffix}")]
    folders = {path.parent.relative_to(ROOT).as_posix() for path in files}
    assert set(re.findall(r'"(.*?)"', listed[1])) == folders
