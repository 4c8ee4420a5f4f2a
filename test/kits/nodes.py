# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes in this process, in the executor of a client that plays the user: no threads, nothing sleeps."""

from __future__ import annotations

from typing import Any

from impact_rig.client import Client, Collector, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.nodes.stepped_sine_node import SteppedSineNode
from impact_rig.rig import resimulate
from impact_rig.simtime import COMMAND_GRID_NS

TICK = COMMAND_GRID_NS
DRIVEN = {"drive__amplitude": 0.52, "barriers__gap_m": 0.002}
"""A rig that hits its walls soon, as `host_rig` takes it."""


def dotted(values: dict[str, Any]) -> dict[str, Any]:
    """Keys with `__` for the point, as configuration names."""
    return {name.replace("__", "."): value for name, value in values.items()}


def host_rig(client: Client, mode: str = "stepped", **values: Any) -> RigNode:
    """Run a rig node in this process; keys with `__` for the point."""
    return client.host(RigNode, parameter_overrides=ros_parameters({"time.mode": mode, **dotted(values)}))


def same_as_resimulated(scans: Collector, journal: Collector) -> int:
    """Compare every published block with a re-simulation of the journal; return how many were compared."""
    tables = scans.tables()
    pure = {}
    for block in resimulate(journal.tables()):
        pure[block.scan.stamp_ns] = block.scan.rows.tobytes()
        if block.scan.stamp_ns >= tables[-1].stamp_ns:
            break
    for table in tables:
        assert table.rows.tobytes() == pure[table.stamp_ns], f"block at {table.stamp_ns}"
    return len(tables)


Opened = dict[tuple[str, str], set[str]]
"""Full names of topics and services, by kind and expression of an SROS2 policy."""


def opened_by(namespace: str, clock: str, directory: str) -> dict[str, Opened]:
    """Run every node in a namespace with a clock of its own, and return what each of them opens."""
    arguments = ["--ros-args", "-r", f"/clock:={clock}"]
    makers: dict[str, tuple[Any, dict[str, Any]]] = {
        "rig": (RigNode, {"time.mode": "stepped"}),
        "analysis": (AnalysisNode, {"use_sim_time": True}),
        "recorder": (RecorderNode, {"use_sim_time": True, "directory": directory}),
        "stepped_sine": (SteppedSineNode, {"use_sim_time": True, "hold": "phase"}),
    }
    with isolated_domain() as domain_id, Client(domain_id, namespace=namespace, name="operator") as client:
        for make_node, values in makers.values():
            client.host(make_node, parameter_overrides=ros_parameters(values), cli_args=arguments)
        client.wait_active(*makers)
        client.wait_until(lambda: client.status("recorder").message.startswith("recording"), "the recorder")
        return {name: _opened(client.node, name, namespace) for name in makers}


def _opened(node: Any, name: str, namespace: str) -> Opened:
    queries = {
        ("topics", "publish"): node.get_publisher_names_and_types_by_node,
        ("topics", "subscribe"): node.get_subscriber_names_and_types_by_node,
        ("services", "reply"): node.get_service_names_and_types_by_node,
        ("services", "request"): node.get_client_names_and_types_by_node,
    }
    return {kind: {found for found, _types in query(name, namespace)} for kind, query in queries.items()}
