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
"""Interlock for an operator: an error until it is cleared, an entry in the journal, a run that can be verified."""

from __future__ import annotations

import math
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig

from impact_rig.client import Client, ServiceFailedError
from impact_rig.client.client import ros_parameters
from impact_rig.errors import CommandError
from impact_rig.nodes import session
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.recording import open_run
from impact_rig.runs import recorded_journal
from impact_rig.runs.verification import verify

pytestmark = pytest.mark.ros


def present_figures(client: Client, node: RigNode) -> dict[str, str]:
    """Return the present figures of the rig."""
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
    assert "limit 6.35 mm" in client.figures("rig")["latched"]
    with pytest.raises(ServiceFailedError, match="clear_trip"):
        client.trigger("rig/reset")
    with pytest.raises(CommandError, match="latched"):
        client.command(current_a=0.1)
    client.step(200)
    assert present_figures(client, node)["latched"]
    client.trigger("rig/clear_trip")
    found = present_figures(client, node)
    assert (found["latched"], float(found["current_a"])) == ("", 0.0)
    client.command(current_a=0.1)
    client.step(50)
    client.trigger("recorder/stop")
    with open_run(tmp_path / "run") as run:
        kinds = [entry.kind.value for entry in recorded_journal.of_run(run)]
        assert kinds[-4:] == ["command", "trip", "clear_trip", "command"]
        verdict = verify(run)
    assert (verdict.identical, verdict.scans) == (True, 45_000), verdict


@pytest.mark.parametrize("by", ["stop", "over_travel"])
@pytest.mark.parametrize("through", ["inactive", "unconfigured"])
def test_a_latch_survives_leaving_the_active_state(client: Client, by: str, through: str) -> None:
    """The next rig starts latched and at rest, although its configuration drives it from the start."""
    node = host_rig(client, drive__frequency_hz=8.0, drive__amplitude=8.0, shaker__ramp_s=0.0)
    client.wait_active("rig")
    if by == "stop":
        client.trigger("rig/stop")
    else:
        client.step(300)
    assert present_figures(client, node)["latched"].startswith("emergency" if by == "stop" else by)
    steps = ["deactivate", "cleanup", "configure", "activate"]
    for transition in steps if through == "unconfigured" else (steps[0], steps[-1]):
        assert client.change_state("rig", transition)
    journal = client.collect("rig/journal")
    applied = client.collect("shaker/applied")
    client.step(100)
    assert present_figures(client, node)["latched"].startswith("emergency" if by == "stop" else by)
    client.wait_until(lambda: "stop" in [entry.kind.value for entry in journal.entries()], "the stop in the journal")
    client.wait_until(lambda: len(applied.rows()) and applied.rows()["current"][-1] == 0.0, "the amplitude zero")
    assert abs(float(node._session.rig.simulation.stored_energy())) < 1e-12
    with pytest.raises(CommandError, match="clear_trip"):
        client.command(current_a=0.1)
    client.trigger("rig/clear_trip")
    client.command(current_a=0.1)


@pytest.mark.parametrize("step_s", [3_600, -3_600])
def test_a_step_of_the_system_clock_does_not_affect_commands_after_a_suspension(
    client: Client, monkeypatch: pytest.MonkeyPatch, step_s: int
) -> None:
    """The clock is set during the suspension, and set back afterwards: commands received after that are accepted."""
    node = host_rig(client, "realtime")
    client.wait_active("rig")
    client.command(current_a=0.1)
    client.trigger("rig/stop")
    system_ns = time.time_ns
    monkeypatch.setattr(session, "REPEATED_S", 1.5)
    with monkeypatch.context() as patch:
        patch.setattr(session, "AWAY_S", -1.0)
        patch.setattr(session, "EXPIRES_S", -1.0)
        patch.setattr(session, "BUSY_SHARE", math.inf)
        patch.setattr(session.time, "time_ns", lambda: system_ns() + step_s * 10**9)
        client.wait_until(lambda: node._session._resumed_ns, "a call of the timer")
    for name in ("clear_trip", "pluck", "reset"):
        with pytest.raises(
            ServiceFailedError,
            match="the command may have been sent before the process of this rig, which had",
        ):
            client.trigger(f"rig/{name}")
    client.trigger("rig/stop")
    resumed = node._session._resumed_at
    client.wait_until(lambda: time.monotonic() - resumed > session.REPEATED_S, "the end of what may have been queued")
    for name in ("clear_trip", "reset"):
        client.trigger(f"rig/{name}")
    assert client.command(current_a=0.2)["current"] == 0.2


def test_a_command_sent_after_a_suspension_is_accepted_at_once(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    node = host_rig(client, "realtime")
    client.wait_active("rig")
    with monkeypatch.context() as patch:
        patch.setattr(session, "AWAY_S", -1.0)
        patch.setattr(session, "EXPIRES_S", -1.0)
        patch.setattr(session, "BUSY_SHARE", math.inf)
        client.wait_until(lambda: node._session._resumed_ns, "a call of the timer")
    assert client.command(current_a=0.2)["current"] == 0.2
