# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The service ~/pause: rig time stands still, or goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any  # settings of any node

from std_srvs.srv import SetBool

from impact_rig.nodes.deferred import Answer, DeferredService, Done
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.pacing import AckWindow


class Pause:
    """Whether a rig is paused; a pause is answered when the peers have processed all that was out.

    Args:
        node: owner.
        refusal: returns why there is nothing to pause, or nothing.
        window: returns how far the peers are.
        go_on: called when the rig is told to go on, without what a silent peer has missed.
    """

    def __init__(
        self,
        node: ManagedNode[Any],
        refusal: Callable[[], str],
        window: Callable[[], AckWindow],
        go_on: Callable[[], None],
    ) -> None:
        self._refusal = refusal
        self._window = window
        self._go_on = go_on
        self._service = DeferredService(node, SetBool, "~/pause", self._on_request, self.answer)
        self.on = False
        """Whether rig time stands still, but for steps that are asked for meanwhile."""
        self.held = False
        """Whether it stands still altogether: since the pause no step has been asked for."""

    def end(self, message: str) -> None:
        """Be paused no more, because there is no rig any more; whoever waits is told why."""
        self.on = self.held = False
        self._service.reply(False, message)

    def answer(self) -> None:
        """Answer when all that is out has been processed, or will not be."""
        if self._service.waiting and (self._window().outstanding() == 0 or self._window().silent()):
            self._service.reply(True, "paused")

    def hold(self, done: Done) -> None:
        """Pause the rig there is; `done` is called when the peers have processed all that was out."""
        self.on = self.held = True
        self._service.wait(done)

    def resume(self) -> str:
        """Go on; returns the answer."""
        if self.on or self._window().silent():  # else it was running: nothing is given up
            self.on = self.held = False
            self._service.reply(False, "told to go on")
            self._go_on()
        return "running"

    def _on_request(self, request: SetBool.Request) -> Answer | None:
        refusal = self._refusal()
        if refusal:
            return False, refusal
        if request.data:
            self.on = self.held = True
            return None
        return True, self.resume()
