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
"""Nodes in this process, run by the executor of a client that acts as the user: no threads, and no sleeping."""

from __future__ import annotations

from typing import Any

from impact_rig.client import Client, Collector
from impact_rig.client.client import ros_parameters
from impact_rig.nodes.rig_node import RigNode
from impact_rig.rig import resimulate
from impact_rig.simtime import COMMAND_GRID_NS

TICK = COMMAND_GRID_NS
DRIVEN = {"drive__amplitude": 0.52, "barriers__gap_m": 0.002}
"""A rig that hits its walls soon, as `host_rig` takes it."""


def dotted(values: dict[str, Any]) -> dict[str, Any]:
    """Return the keys with a point for each `__`, as configuration names."""
    return {name.replace("__", "."): value for name, value in values.items()}


def host_rig(client: Client, mode: str = "lockstep", **values: Any) -> RigNode:
    """Run a rig node in this process; keys with `__` for the point."""
    return client.host(RigNode, parameter_overrides=ros_parameters({"time.mode": mode, **dotted(values)}))


def same_as_resimulated(scans: Collector, journal: Collector) -> int:
    """Compare every published block with a re-simulation of the journal; return how many were compared."""
    tables = scans.tables()
    pure = {}
    for block in resimulate(journal.entries()):
        pure[block.scan.stamp_ns] = block.scan.rows.tobytes()
        if block.scan.stamp_ns >= tables[-1].stamp_ns:
            break
    for table in tables:
        assert table.rows.tobytes() == pure[table.stamp_ns], f"block at {table.stamp_ns}"
    return len(tables)
