# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Compile ahead, in processes of their own, and say how far it is.

A program names the tasks it needs before anybody waits for it: functions that run a part of the compiled code once, on
nothing. Each runs in a process of its own, side by side with the others; the code lands in the directory of
`system.compiled`, from where every process loads it. A second program that needs the same waits for the first instead
of compiling it again. Once a task is done the directory says so, and asking again costs a look at a file.

As a program (`python -m impact_rig.system.compile_ahead MODULE:FUNCTION`) this is one of those processes.
"""

from __future__ import annotations

import contextlib
import fcntl
import importlib
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import attrs
from numba.core import config

from impact_rig.system import compiled
from impact_rig.system.endings import PARENT_VARIABLE, end_with, held, unhurried
from impact_rig.system.lean_numba import go_without_blas

LOOK_S = 0.1
TELL_S = 1.0
"""How often it is told how far the compiler is."""
_FUNCTION = re.compile(r"^@njit.*\n(?:@.*\n)*def (\w+)", re.MULTILINE)


@attrs.frozen
class Task:
    """A part of the compiled code.

    Attributes:
        run: `package.module:function` that runs it once.
        packages: whose functions it compiles, relative to the package of all.
    """

    run: str
    packages: tuple[str, ...]

    def stamp(self, directory: Path) -> Path:
        """Return the file that is there once the task is done."""
        return directory / f"{self.run.replace(':', '.')}.ready"


def compile_ahead(tasks: Sequence[Task], tell: Callable[[int, int], None]) -> list[Task]:
    """Return once these tasks are done; returns those that are not.

    Where nothing can be kept or compiled, or a task fails, nothing is raised: whoever needs the code compiles it, and
    meets the error.

    Args:
        tasks: what is needed, the longest first.
        tell: called about once a second with (functions compiled, of how many); what it raises ends the compiling.
    """
    directory = compiled.Cache(compiled.ROOT).directory
    if directory is None or config.DISABLE_JIT:
        return list(tasks)
    left = _missing(tasks, directory)
    if not left:
        return []
    wanted, told = functions({package for task in tasks for package in task.packages}), 0.0
    running: list[subprocess.Popen[bytes]] = []
    with _ended(running):
        while left or running:
            running[:] = [process for process in running if process.poll() is None]
            while left and len(running) < (os.cpu_count() or 1):
                running.append(_start(left.pop(0)))
            if time.monotonic() - told > TELL_S:
                tell(len(wanted & kept(directory)), len(wanted))
                told = time.monotonic()
            time.sleep(LOOK_S)
    tell(len(wanted & kept(directory)), len(wanted))
    return _missing(tasks, directory)


def functions(packages: Iterable[str], root: Path = compiled.ROOT) -> set[str]:
    """Return the functions that these packages have compiled, `directory/module.function`."""
    return {
        f"{path.relative_to(root).parent}/{path.stem}.{name}"
        for package in packages
        for path in (root / package).rglob("*.py")
        for name in _FUNCTION.findall(path.read_text(encoding="utf-8"))
    }


def kept(directory: Path) -> set[str]:
    """Return those that are compiled and kept in `directory`, and whatever else is."""
    indices = (path.relative_to(directory) for path in directory.rglob("*.nbi"))
    return {f"{index.parent}/{index.name.partition('-')[0]}" for index in indices}


def _missing(tasks: Sequence[Task], directory: Path) -> list[Task]:
    return [task for task in tasks if not task.stamp(directory).exists()]


def _start(task: Task) -> subprocess.Popen[bytes]:
    with held():
        return subprocess.Popen(  # noqa: S603  # ourselves
            [sys.executable, "-m", __name__, task.run],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, PARENT_VARIABLE: str(os.getpid())},
            start_new_session=True,  # Ctrl-C reaches us alone
        )


@contextlib.contextmanager
def _ended(processes: list[subprocess.Popen[bytes]]) -> Iterator[None]:
    """Let no process be left."""
    try:
        yield
    finally:
        with unhurried():
            for process in processes:
                process.kill()  # what it was compiling is not kept, what it has compiled is
                process.wait()


def _main(run: str) -> None:
    end_with(int(os.environ[PARENT_VARIABLE]), lambda: os._exit(1))
    go_without_blas()
    directory = compiled.Cache(compiled.ROOT).directory
    assert directory is not None
    stamp = Task(run, ()).stamp(directory)
    with stamp.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not stamp.exists():
            module, function = run.split(":")
            getattr(importlib.import_module(module), function)()
            stamp.touch()


if __name__ == "__main__":
    _main(sys.argv[1])
