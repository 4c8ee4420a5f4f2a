# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The rig's services that act at once: reset, stop, clear_trip, pluck."""

from __future__ import annotations

from collections.abc import Callable

from std_srvs.srv import Trigger

from impact_rig.nodes.managed import ManagedNode
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig


class RigServices:
    """Makes the services and keeps them.

    Args:
        node: owner.
        running: returns the rig; CommandError says why there is none.
        done: called after each, to publish what it has changed.
        was_reset: called after a reset, too.
    """

    def __init__(
        self,
        node: ManagedNode[RigConfig],
        running: Callable[[], Rig],
        done: Callable[[Rig], None],
        was_reset: Callable[[Rig], None],
    ) -> None:
        self._node = node
        self._running = running
        self._done = done
        self._was_reset = was_reset
        node.service(Trigger, "~/reset", self._on_reset)
        node.service(Trigger, "~/stop", self._on_stop)
        node.service(Trigger, "~/clear_trip", self._on_clear_trip)
        node.service(Trigger, "~/pluck", self._on_pluck)

    def reset(self) -> str:
        """Begin again from scan 0; returns the answer. CommandError: it cannot be now."""
        rig = self._running()
        rig.reset()
        self._done(rig)
        self._was_reset(rig)
        self._node.get_logger().info("reset: scan 0")
        return "reset: scan 0"

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, self.reset()
        return response

    def _on_stop(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._act(response, Rig.stop, "shaker ramps to zero and stays latched until ~/clear_trip")

    def _on_clear_trip(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._act(response, Rig.clear_trip, "latch released; current stays zero until the next command")

    def _on_pluck(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        displacement_m = self._node.settings.pluck.displacement_m
        return self._act(
            response, lambda rig: rig.pluck(displacement_m), "base locked, structure released; ~/reset unlocks"
        )

    def _act(self, response: Trigger.Response, action: Callable[[Rig], None], done: str) -> Trigger.Response:
        rig = self._running()
        action(rig)
        self._done(rig)
        response.success, response.message = True, done
        return response
