# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Compiling ahead: it makes everything, once, says how far it is, and leaves no process behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from impact_rig.analysis import warm_up as analysis
from impact_rig.rig import warm_up as rig
from impact_rig.system import compiled
from impact_rig.system.compile_ahead import Task, compile_ahead, functions, kept

ALL = (*rig.TASKS, analysis.TASK)


def test_the_tasks_compile_every_function() -> None:
    compile_ahead(ALL, lambda _done, _count: None)
    directory = compiled.Cache(compiled.ROOT).directory
    assert directory is not None
    packages = ("arithmetic", "physics", "instruments", "rig", "analysis")
    assert len(functions(packages)) > 100
    assert functions(packages) - kept(directory) == set()


def test_what_is_done_is_not_begun_again() -> None:
    compile_ahead(ALL, lambda _done, _count: None)
    assert compile_ahead(ALL, lambda _done, _count: pytest.fail("something was compiled")) == []


PROGRAM = """
from impact_rig.system.compile_ahead import Task, compile_ahead
import os
from pathlib import Path
def children():
    return Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
class Enough(Exception): pass
def tell(done, count):
    assert len(children()) == 1, "it is compiled in a process of its own"
    raise Enough
try:
    compile_ahead([Task("impact_rig.rig.warm_up:mechanics", ("physics",))], tell)
except Enough:
    print(len(children()))
"""


def test_who_is_told_may_end_it_and_no_process_is_left(tmp_path: Path) -> None:
    found = subprocess.run(
        [sys.executable, "-c", PROGRAM], env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert found.stdout.strip() == "0", found.stderr


def test_a_task_that_fails_leaves_the_error_to_whoever_needs_the_code() -> None:
    task = Task("impact_rig.rig.warm_up:not_there", ("analysis",))
    told = []
    assert compile_ahead([task], lambda done, count: told.append((done, count))) == [task]
    directory = compiled.Cache(compiled.ROOT).directory
    assert directory is not None
    wanted = functions(["analysis"])
    assert told[-1] == (len(wanted & kept(directory)), len(wanted)), "what is compiled is counted"
