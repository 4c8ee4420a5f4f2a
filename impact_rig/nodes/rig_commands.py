# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The topics that command a rig: `shaker/frequency` and `shaker/current`."""

from __future__ import annotations

from collections.abc import Callable

from std_msgs.msg import Float64

from impact_rig import topics
from impact_rig.errors import CommandError
from impact_rig.nodes.managed import ManagedNode
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig


class RigCommands:
    """Subscribes to the commands and gives them to the rig; what it refuses is told and counted.

    Args:
        node: owner.
        running: returns the rig; CommandError says why there is none.
        done: called after a command, to publish what it has changed.
    """

    def __init__(self, node: ManagedNode[RigConfig], running: Callable[[], Rig], done: Callable[[Rig], None]) -> None:
        self._node = node
        self._running = running
        self._done = done
        self._subscriptions = [
            node.subscribe(topics.FREQUENCY, self._on_frequency),
            node.subscribe(topics.CURRENT, self._on_current),
        ]

    def drop(self) -> None:
        """Refuse what came and was not looked at yet: it was given to no rig, or to the one before."""
        for subscription in self._subscriptions:
            with subscription.handle:
                while subscription.handle.take_message(subscription.msg_type, False) is not None:
                    name = subscription.topic_name
                    self._node.refuse("inactive", f"{name}: it came before this rig began")

    def _on_frequency(self, message: Float64) -> None:
        self._accept(topics.FREQUENCY.name, frequency_hz=message.data)

    def _on_current(self, message: Float64) -> None:
        self._accept(topics.CURRENT.name, current_a=message.data)

    def _accept(self, name: str, **values: float) -> None:
        try:
            rig = self._running()
        except CommandError as error:
            self._node.refuse("inactive", f"{name}: {error}")
            return
        try:
            rig.accept(**values)
        except CommandError as error:
            self._node.refuse(name, str(error))
            return
        told = ", ".join(f"{key} = {value:g}" for key, value in values.items())
        self._node.get_logger().debug(f"accepted: {told}")
        self._done(rig)
