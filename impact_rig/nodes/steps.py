# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Steps: blocks that ~/step has asked for, answered when the last of them is out and acknowledged."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any  # settings of any node

from std_srvs.srv import Trigger

from impact_rig.nodes.deferred import Answer, DeferredService, Done
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.pacing import AckWindow
from impact_rig.nodes.readers import Readers

IDLE_S = 1.0
"""Who steps in turns asks more often than this: a rig between two steps of a series is not paused."""


class StepRequests:
    """The service ~/step and the blocks it still owes.

    Args:
        node: owner.
        refusal: returns why no step can be taken now, or nothing.
        blocks: returns how many blocks a step has.
        work: called once a step is asked for.
    """

    def __init__(
        self, node: ManagedNode[Any], refusal: Callable[[], str], blocks: Callable[[], int], work: Callable[[], None]
    ) -> None:
        self._refusal = refusal
        self._blocks = blocks
        self._service = DeferredService(node, Trigger, "~/step", self._on_step, work)
        self._asked_at = -IDLE_S
        self.left = 0
        """Blocks not published yet."""

    @property
    def waiting(self) -> bool:
        """Whether somebody waits for an answer."""
        return bool(self._service.waiting)

    @property
    def is_idle(self) -> bool:
        """Whether nothing is owed, and for a while nobody has asked for a step."""
        return self.left <= 0 and time.monotonic() - self._asked_at > IDLE_S

    def take(self, steps: int, done: Done) -> None:
        """Take so many steps, as a request does that is not refused; `done` is called when that one is answered."""
        self._owe(steps)
        self._service.wait(done)

    def refuse(self, message: str) -> None:
        """Answer what waits with a refusal; what is left is dropped."""
        self.left = 0
        self._service.reply(False, message)

    def refuse_without(self, readers: Readers, patience_s: float) -> None:
        """Refuse when a peer has not been there for so long."""
        if self._service.waiting and readers.overdue(patience_s) and time.monotonic() - self._asked_at > patience_s:
            self.refuse(f"peer {', '.join(readers.missing())} is not there")

    def answer(self, window: AckWindow, now_s: float) -> None:
        """Answer when all is out and acknowledged, at this rig time, or when a peer has fallen silent."""
        if not self._service.waiting:
            return
        silent = window.silent()
        if silent:
            self.refuse(f"peer {', '.join(silent)} does not acknowledge")
        elif self.left <= 0 and window.outstanding() == 0:
            self._service.reply(True, f"at {now_s:.9f} s")

    def _on_step(self, _request: Trigger.Request) -> Answer | None:
        refusal = self._refusal()
        if refusal:
            return False, refusal
        self._owe(1)
        return None

    def _owe(self, steps: int) -> None:
        self.left += steps * self._blocks()
        self._asked_at = time.monotonic()
