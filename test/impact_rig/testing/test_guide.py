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
"""Pages on testing, followed to the letter in an empty folder: every block prints what its page shows."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from impact_rig.recording import open_run
from impact_rig.runs.verification import verify

pytestmark = [pytest.mark.ros, pytest.mark.pipeline, pytest.mark.timeout(300)]

ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "docs" / name for name in ("tutorials/first_pipeline_test.md", "how-to/testing.md")]
_BLOCK = re.compile(r"^```(\w+)(?: ([^\n]*))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks() -> Iterator[tuple[str, str, str]]:
    """Return language, following text and content of each block, in order."""
    for page in PAGES:
        yield from (match.groups(default="") for match in _BLOCK.finditer(page.read_text(encoding="utf-8")))


def run(commands: str, folder: Path, project: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run shell lines like a user who has installed the plugin; in a checkout, the plugin must be named."""
    pytest_here = f"{sys.executable} -m pytest -p impact_rig.testing.plugin -p no:cacheprovider"
    line = " && ".join(re.sub(r"^pytest", pytest_here, command) for command in commands.splitlines())
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTEST_", "COV_"))}
    path = os.pathsep.join(filter(None, [str(project), os.environ.get("PYTHONPATH", "")]))
    return subprocess.run(
        line,
        shell=True,
        cwd=folder,
        env={**environment, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )


def output_contains(output: str, line: str) -> bool:
    """Return whether a line of the page is in the output: rules may be longer, numbers are cut, paths are absolute."""
    core = line.strip(" -")
    before, colon, path = core.partition("run: ")
    return (f"{before}{colon}" in output and path in output) if colon else core in output


def test_every_block_of_the_guide_works_as_written(tmp_path: Path) -> None:
    output, output_of_schedules, commands = "", "", 0
    for language, info, content in blocks():
        if language == "python" and info.startswith("title="):
            (tmp_path / info.removeprefix("title=")).write_text(content)
        elif language == "sh" and not info.startswith("not run"):
            commands += 1
            done = run(content, tmp_path)
            output = done.stdout + done.stderr
            output_of_schedules = output if "schedules" in content else output_of_schedules
            assert (done.returncode != 0) == (info == "fails"), output
        elif language == "text":
            missing = [line for line in content.splitlines() if not output_contains(output, line)]
            assert missing == [], output
    assert commands == 6
    failed = sorted((tmp_path / "failed_runs").iterdir())
    assert len(failed) == 3
    for directory in failed:
        with open_run(directory / "rig") as left:
            assert str(verify(left)).startswith("identical")
    (scheduled,) = (tmp_path / "failed_runs").glob("*schedules*/rig")
    assert (scheduled / "scenario.py").read_text().splitlines()[-1] in output_of_schedules
    assert "measured: daq/scan 0.000000000" in (scheduled / "callbacks.txt").read_text()


def test_the_installation_commands_name_existing_extras() -> None:
    (install,) = (content for language, _, content in blocks() if language == "sh" and "pip install" in content)
    (extras,) = re.findall(r"impact_rig\[(.+?)\]", install)
    assert extras == "wheels,strategies"
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    assert all(f'"{extra}": [' in setup for extra in extras.split(","))
