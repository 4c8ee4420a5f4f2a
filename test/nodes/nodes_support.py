"""Nodes in this process, in the executor of a client that plays the user: no threads, nothing sleeps."""

from __future__ import annotations

from typing import Any

from rclpy.parameter import Parameter

from impact_rig.nodes.rig_node import RigNode
from impact_rig.testing import Client


def overrides(values: dict[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in values.items()]


def host_rig(client: Client, mode: str = "stepped", **values: Any) -> RigNode:
    """Run a rig node in this process; keys with `__` for the point."""
    chosen = {"time.mode": mode, **{name.replace("__", "."): value for name, value in values.items()}}
    return client.host(RigNode, parameter_overrides=overrides(chosen))
