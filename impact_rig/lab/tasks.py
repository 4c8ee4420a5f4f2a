# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a page asked for, done step by step without waiting: generators that say what they wait for.

    def deed() -> Steps:
        answer = yield Waiting(check, "an answer of rig/reset", 10.0)
        return "what to tell the page"

A deed raises `Refused` to tell the page why not.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Any  # what is waited for

import attrs

from impact_rig.errors import ImpactRigError
from impact_rig.lab.source import Answer


class Refused(ImpactRigError):  # noqa: N818  # a fact about a request, not a mistake of ours
    """What was asked is not done; the message is for the page."""


@attrs.frozen(eq=False)
class Waiting:
    """What a deed waits for.

    Attributes:
        check: returns what was waited for, or None; may raise `Refused`.
        what: said when it does not come.
        timeout_s: how long it may take [s].
        instead: called when it does not come.
    """

    check: Callable[[], Any]
    what: str
    timeout_s: float
    instead: Callable[[], None] = lambda: None


Steps = Generator[Waiting, Any, str]


@attrs.define(eq=False)
class _Task:
    steps: Steps
    answer: Answer
    waiting: Waiting | None = None
    deadline: float = 0.0


class Tasks:
    """The deeds under way.

    Args:
        clock: seconds, monotonic.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._tasks: list[_Task] = []

    def __len__(self) -> int:
        return len(self._tasks)

    def begin(self, steps: Steps, answer: Answer) -> None:
        """Begin a deed."""
        task = _Task(steps, answer)
        if not self._advance(task, None):
            self._tasks.append(task)

    def work(self) -> None:
        """Look at everything that is waited for, once."""
        self._tasks = [task for task in self._tasks if not self._look(task)]

    def end(self, reason: str) -> None:
        """Refuse everything that is under way."""
        for task in self._tasks:
            task.steps.close()
            task.answer(False, reason)
        self._tasks.clear()

    def _look(self, task: _Task) -> bool:
        """Go on with a task if it can, and return whether it is done."""
        waiting = task.waiting
        assert waiting is not None
        try:
            found = waiting.check()
        except ImpactRigError as error:
            return self._advance(task, None, error)
        if found is not None:
            return self._advance(task, found)
        if self._clock() > task.deadline:
            waiting.instead()
            return self._advance(task, None, Refused(f"waited {waiting.timeout_s:g} s in vain for {waiting.what}"))
        return False

    def _advance(self, task: _Task, found: Any, error: ImpactRigError | None = None) -> bool:
        try:
            task.waiting = task.steps.throw(error) if error is not None else task.steps.send(found)
        except StopIteration as end:
            task.answer(True, str(end.value or ""))
            return True
        except ImpactRigError as refusal:
            task.answer(False, str(refusal))
            return True
        task.deadline = self._clock() + task.waiting.timeout_s
        return False
