# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The interlock as an operator meets it: an error until it is cleared, a journal that tells, a run that verifies."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig

from impact_rig.client import Client, ServiceFailedError
from impact_rig.client.client import ros_parameters
from impact_rig.errors import CommandError
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.recording import open_run
from impact_rig.runs.verification import verify

pytestmark = pytest.mark.ros


def told(client: Client, node: RigNode) -> dict[str, str]:
    """Return the figures of the rig as they are now."""
    client.diagnostics.clear()
    node.report_now()
    return client.wait_until(lambda: client.figures("rig"), "the figures")


def test_a_recorded_trip_latches_until_cleared_and_verifies_bit_for_bit(client: Client, tmp_path: Path) -> None:
    client.host(RecorderNode, parameter_overrides=ros_parameters({"directory": str(tmp_path), "name": "run"}))
    node = host_rig(client, time__peers=["recorder"], drive__frequency_hz=8.0)
    client.wait_active("rig", "recorder")
    client.wait_until(lambda: client.status("recorder").message == "recording", "the recorder")
    client.command(current_a=8.0)
    client.step(200)
    client.wait_until(lambda: "latched by over_travel" in client.status("rig").message, "the diagnostic")
    assert client.status("rig").level == b"\2"
    assert "limit 0.00635" in client.figures("rig")["latched"]
    with pytest.raises(ServiceFailedError, match="clear_trip"):
        client.trigger("rig/reset")
    with pytest.raises(CommandError, match="latched"):
        client.command(current_a=0.1)
    client.step(200)
    assert told(client, node)["latched"]
    client.trigger("rig/clear_trip")
    found = told(client, node)
    assert (found["latched"], float(found["current_a"])) == ("", 0.0)
    client.command(current_a=0.1)
    client.step(50)
    client.trigger("recorder/stop")
    with open_run(tmp_path / "run") as run:
        kinds = [bytes(row["kind"]).decode() for table in run.tables("rig/journal") for row in table.rows]
        assert kinds[-4:] == ["command", "trip", "clear_trip", "command"]
        verdict = verify(run)
    assert (verdict.identical, verdict.scans) == (True, 45_000), verdict
