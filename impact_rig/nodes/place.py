# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A rig's place: its domain and namespace, which one rig of a machine may have at a time.

The graph knows of another rig only after seconds where an announcement was missed; a lock tells at once, but only on
this machine. Where discovery ends at this machine, nobody has to wait for the graph.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier

from impact_rig.system import locks
from impact_rig.system.locks import PLACES as FOLDER
from impact_rig.system.locks import place as lock_name

OBEDIENT = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp")
"""Middleware that keeps to `ROS_AUTOMATIC_DISCOVERY_RANGE`."""


def ends_here(environment: Mapping[str, str], middleware: str) -> bool:
    """Return whether discovery surely ends at this machine."""
    near = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() in ("LOCALHOST", "OFF")
    far = environment.get("ROS_STATIC_PEERS") or environment.get("ROS_DISCOVERY_SERVER")
    return near and not far and middleware in OBEDIENT


class Place:
    """Takes a rig's place and leaves it.

    Args:
        node: the rig's.
    """

    def __init__(self, node: Node) -> None:
        self._name = lock_name(node.context.get_domain_id(), node.get_namespace())
        self._held: int | None = None
        here = ends_here(os.environ, get_rmw_implementation_identifier())
        self.decides = here and locks.can_hold(FOLDER, self._name)
        """Whether no rig can be in this place unseen; False: only the graph tells."""

    def take(self) -> bool:
        """Return whether the place is ours now; true as well where only the graph tells."""
        if self._held is None and self.decides:
            self._held = locks.hold(FOLDER, self._name)
        return self._held is not None or not self.decides

    def leave(self) -> None:
        """Leave the place to others."""
        if self._held is not None:
            os.close(self._held)
            self._held = None
