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
"""Common parts of the commands `campaign`, `map` and `dynamics`: their arguments, running of tasks, progress."""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import TypeVar

from impact_rig.cli.terminal import Console, Counted
from impact_rig.errors import ConfigError
from impact_rig.system import files
from impact_rig_studies.campaign.pool import in_parallel, on_cluster
from impact_rig_studies.campaign.tasks import Runner, Task, TaskStore, WorkItem
from impact_rig_studies.campaign.tasks import measure as measure_tasks

WAYS = ("process", "dask")
P = TypeVar("P", bound=WorkItem)
R = TypeVar("R")
T = TypeVar("T", bound=Task)


def words(
    arguments: argparse.Namespace, what: str, example: str, ways: Sequence[str] = WAYS
) -> tuple[Path, Path, str, str]:
    """Return the arguments of a command: file, directory of the results, way of measuring, address of a Dask cluster.

    The way of measuring is the first word after `--through`. The file may be an argument of its own, or the last word
    after `--through`. The directory is absolute. The address is empty unless the way is `dask`.

    Args:
        arguments: parsed arguments of the command.
        what: name of the command, for messages and the default directory.
        example: command without the program's name, for messages.
        ways: allowed ways of measuring.

    Raises:
        ConfigError: the file or the address is missing, the way is unknown, there are further words, or the number of
            workers is below 1.
    """
    way, *rest = arguments.through
    if way not in ways:
        raise ConfigError(f"the way of measuring, --through, must be one of {', '.join(ways)}, got {way!r}")
    address = ""
    if way == "dask":
        if not rest:
            raise ConfigError("--through dask needs the address of a scheduler: --through dask tcp://127.0.0.1:8786")
        address = rest.pop(0)
    file = arguments.file or (Path(rest.pop(0)) if rest else None)
    if file is None:
        raise ConfigError(f"a {what} file is needed, e.g. impact-rig {example}")
    if rest:
        raise ConfigError(
            f"unexpected {' '.join(rest)!r} after --through {way}, where only the address for dask and one file may "
            f"stand; use the form impact-rig {example}"
        )
    if arguments.workers is not None and arguments.workers < 1:
        raise ConfigError(f"--workers must be >= 1, got {arguments.workers}")
    return file, (arguments.output or Path("runs") / f"{what}_{file.stem}").resolve(), way, address


def runner(
    work: Callable[[P], R], address: str, workers: int | None
) -> Callable[[Sequence[P]], Generator[tuple[P, R], None, None]]:
    """Return a function that applies `work` to tasks and yields each with its result.

    Results are yielded in the order of completion. The function uses the Dask cluster at `address`. If the address is
    empty, it uses `workers` processes on this machine, or one per usable core if `workers` is None.
    """
    return on_cluster(work, address) if address else lambda tasks: in_parallel(work, tasks, workers)


def measure(
    tasks: Sequence[T], store: TaskStore[T], runner: Runner[T], console: Console, places: Callable[[T], int]
) -> tuple[int, float]:
    """Measure the tasks without a stored result, store the results, and show the progress.

    `places` is a function that returns the number of points of a task.

    Returns:
        (number of points measured now, duration [s]).
    """
    began = time.monotonic()
    new = sum(places(task) for task in tasks if store.get(task) is None)
    count = 0
    with (
        Counted(console, "points", sum(map(places, tasks))) as shown,
        contextlib.closing(measure_tasks(tasks, store.get, store.put, runner)) as done,
    ):
        for task, _ in done:
            count += places(task)
            shown.show(count, task.describe())
    for what in store.damaged:
        console.print(f"{what}; it was measured again", style="yellow")
    return new, time.monotonic() - began


def figures_folder(arguments: argparse.Namespace, directory: Path) -> Path:
    """Create and return the folder of a study's figures: that of the option `--figures`, else `figures` in `directory`.

    Raises:
        RecordingError: the folder cannot be created.
    """
    folder: Path = arguments.figures or directory / "figures"
    with files.translate_errors(f"cannot write {folder}"):
        files.make_folder(folder)
    return folder
