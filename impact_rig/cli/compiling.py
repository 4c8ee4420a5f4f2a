# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a command says while compiled code is made, once on a machine: a bar, or a plain line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn

from impact_rig.analysis import warm_up as analysis
from impact_rig.cli.terminal import Console, Words
from impact_rig.rig import warm_up as rig
from impact_rig.system.compile_ahead import Task, compile_ahead

ANALYSIS = (analysis.TASK,)
ALL = (*rig.TASKS, *ANALYSIS)
PLAIN_S = 3.0


def ready(tasks: Sequence[Task] = ALL) -> list[Task]:
    """Return once the tasks are compiled; standard error says how far that is. Returns those that could not be."""
    with _Teller() as teller:
        return compile_ahead(tasks, teller.tell)


class _Teller:
    def __init__(self) -> None:
        self._progress: Progress | None = None
        self._said, self._last = 0.0, -1

    def __enter__(self) -> _Teller:
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def tell(self, done: int, count: int) -> None:
        if not sys.stderr.isatty():
            if time.monotonic() - self._said > PLAIN_S or (done == count and done != self._last):
                self._said, self._last = time.monotonic(), done
                print(f"compiling, once on this machine: {done} of {count} functions", file=sys.stderr, flush=True)  # noqa: T201
            return
        if self._progress is None:
            columns = (
                Words("compiling, once on this machine"),
                BarColumn(24),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
            )
            self._progress = Progress(*columns, console=Console(stderr=True))
            self._progress.start()
            self._progress.add_task("", total=count)
        self._progress.update(self._progress.task_ids[0], completed=done, total=count)
