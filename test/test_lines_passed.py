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
"""The lines that `make test` counts are those that a process has passed, however it ends."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from pathlib import Path

import pytest
from coverage import CoverageData
from kits.measured import FOLDER

from impact_rig import simtime

ROOT = Path(__file__).parents[1]
SOURCE, FIRST = inspect.getsourcelines(simtime.stamp_ns)
DEFINED, PASSED = FIRST, FIRST + len(SOURCE) - 1


PROGRAM = "import os; from impact_rig import simtime; "
TESTED = "import os, sys, pytest; sys.exit(pytest.main(['-c', os.devnull, '-p', 'no:cacheprovider', sys.argv[1]]))"
"""Program that runs pytest, which imports all of an installed checkout to rewrite a plugin's assertions."""


@pytest.mark.parametrize(
    ("program", "noted"),
    [
        (PROGRAM, {DEFINED}),
        (f"{PROGRAM} simtime.stamp_ns(1, 2)", {DEFINED, PASSED}),
        (f"{PROGRAM} simtime.stamp_ns(1, 2); os.chdir('/'); os._exit(0)", {DEFINED, PASSED}),
        (f"{PROGRAM} os.fork() and os._exit(os.wait()[1]); simtime.stamp_ns(1, 2)", {DEFINED, PASSED}),
        (TESTED, {DEFINED, PASSED}),
    ],
    ids=["not called", "called", "ended at once", "a forked child", "pytest, which imports plugins by itself"],
)
def test_exactly_the_lines_that_a_process_executed_are_counted(program: str, noted: set[int], tmp_path: Path) -> None:
    environment = {**os.environ, "IMPACT_RIG_LINES": str(tmp_path / "data"), "PYTHONPATH": FOLDER}
    test = tmp_path / "test_it.py"
    test.write_text("def test_it():\n    from impact_rig import simtime\n    simtime.stamp_ns(1, 2)\n")
    command = [sys.executable, "-c", program, str(test)]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    found = CoverageData(basename=str(tmp_path / "whole"))
    for path in tmp_path.glob("data.*"):
        part = CoverageData(basename=str(path))
        part.read()
        found.update(part)
    lines = set(found.lines(inspect.getfile(simtime)) or ())
    assert lines & {DEFINED, PASSED} == noted
    assert set(found.lines(str(Path(simtime.__file__).with_name("blocks.py"))) or ()) == set(), "it was not imported"
