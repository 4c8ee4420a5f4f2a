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
"""Commands and parameters over topics and services: applied in order and journaled, or rejected and counted."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig, same_as_resimulated
from rclpy.duration import Duration
from std_msgs.msg import Float64

from impact_rig import topics
from impact_rig.client import Client, ServiceFailedError
from impact_rig.errors import CommandError, ConfigError
from impact_rig.rig.description import robot_description

pytestmark = pytest.mark.ros


def test_invalid_commands_are_rejected_and_counted_and_change_nothing(client: Client) -> None:
    node = host_rig(client)
    client.wait_active("rig")
    client.command(frequency_hz=9.1, current_a=0.3)
    applied = client.collect("shaker/applied")
    client.wait_until(lambda: len(applied) >= 3, "the rows so far")
    bad = [math.nan, math.inf, -math.inf, 1e308, -1.0, 1e-300, 4.9, 200.1]
    for value in bad:
        client.publish(topics.FREQUENCY, Float64(data=value))
    for value in (math.nan, -0.001, 30.0):
        client.publish(topics.CURRENT, Float64(data=value))
    client.wait_until(lambda: node.refusals.counts.total() == len(bad) + 3, "all refusals")
    assert node.refusals.counts == {"shaker/frequency": len(bad), "shaker/current": 3}
    assert "200.1" in node.refusals.last["shaker/frequency"]
    refused = ("refused.shaker/frequency", str(len(bad)))
    client.wait_until(lambda: refused in client.figures("rig").items(), "the rejection in the diagnostics")
    row = client.command(frequency_hz=9.2)
    assert (row["frequency"], row["current"]) == (9.2, 0.3)
    client.wait_until(lambda: len(applied) >= 4, "the row")
    assert len(applied) == 4


def test_a_rejected_command_returns_the_reason_at_once(client: Client) -> None:
    """A rejected command must return the reason at once, not after ten seconds, although the rig has no problem."""
    host_rig(client)
    client.wait_active("rig")
    with pytest.raises(CommandError, match=r"frequency must be >= 5 .*, got 250"):
        client.command(frequency_hz=250.0, current_a=0.2)
    with pytest.raises(CommandError, match=r"current must be .*got 40"):
        client.command(frequency_hz=8.0, current_a=40.0)
    assert client.command(current_a=0.2)["frequency"] == 8.0


def test_a_command_to_an_inactive_rig_returns_the_reason_at_once(client: Client) -> None:
    host_rig(client, output__autostart=False)
    client.wait_until(lambda: client.state("rig") == "unconfigured", "the node")
    with pytest.raises(CommandError, match="the rig is unconfigured: configure and activate it first"):
        client.command(current_a=0.2)


def test_commands_are_rejected_and_parameters_accepted_before_activation(client: Client) -> None:
    node = host_rig(client, output__autostart=False)
    client.wait_until(lambda: client.state("rig") == "unconfigured", "the node")
    client.publish(topics.CURRENT, Float64(data=0.1))
    client.wait_until(lambda: node.refusals.counts["inactive"] == 1, "the refusal")
    client.set_parameters("rig", {"barriers.gap_m": 0.008})
    for service in ("reset", "stop", "clear_trip", "pluck", "step"):
        with pytest.raises(ServiceFailedError, match="unconfigured"):
            client.trigger(f"rig/{service}")
    assert client.change_state("rig", "configure")
    assert client.change_state("rig", "activate")
    configuration = client.collect("rig/configuration")
    client.wait_until(lambda: configuration.messages, "rig/configuration")
    assert "gap_m: 0.008" in configuration.messages[0].data


def test_a_command_sent_before_the_rig_starts_is_dropped(client: Client) -> None:
    """A command that waited in the node's queue during its start was meant for another rig, or for none."""
    node = host_rig(client, output__autostart=False)
    publisher = client.publisher(topics.CURRENT)
    client.wait_until(publisher.get_subscription_count, "the subscription")
    client.spin_for(0.1)
    for _ in range(3):
        publisher.publish(Float64(data=0.3))
    publisher.wait_for_all_acked(Duration(seconds=5.0))
    node.trigger_configure()
    node.trigger_activate()
    client.wait_active("rig")
    client.spin_for(0.2)
    assert node.refusals.counts == {"inactive": 3}
    assert "before this rig started" in node.refusals.last["inactive"]
    client.step()
    assert len(client.applied) == 1
    assert client.applied.last().rows["current"][0] == 0.0
    assert client.command(current_a=0.2)["current"] == 0.2


def test_the_robot_description_is_latched_and_changes_only_with_visible_parameters(client: Client) -> None:
    node = host_rig(client)
    client.wait_active("rig")
    descriptions = client.collect("robot_description")
    client.wait_until(lambda: descriptions.messages, "the description")
    client.set_parameters("rig", {"time.ack_window": 5})
    client.set_parameters("rig", {"barriers.gap_m": 0.01})
    client.wait_until(lambda: len(descriptions) >= 2, "another description")
    assert [message.data for message in descriptions.messages][-1] == robot_description(node.settings)
    assert len(descriptions) == 2


def test_a_flood_of_commands_keeps_the_order_and_a_complete_journal(client: Client) -> None:
    """A client publishes as fast as it can: the queue keeps the newest commands; every accepted one is journaled."""
    host_rig(client, "realtime")
    client.wait_active("rig")
    journal, scans = client.collect("rig/journal"), client.collect("daq/scan")
    client.command(frequency_hz=10.0)
    publisher = client.publisher(topics.FREQUENCY)
    for k in range(3000):
        publisher.publish(Float64(data=10.0 + k / 1000))
        if k % 20 == 0:
            client.executor.spin_once(timeout_sec=0.0)
    client.wait_until(lambda: any(entry.value == 12.999 for entry in journal.entries(-1)), "the last command")
    client.pause()
    values = [entry.value for entry in journal.entries(1)]
    assert np.all(np.diff(values) >= 0)
    assert same_as_resimulated(scans, journal) > 0


def test_a_parameter_changes_at_a_command_instant_and_is_journaled(client: Client) -> None:
    host_rig(client)
    client.wait_active("rig")
    journal = client.collect("rig/journal")
    client.step(7)
    client.set_parameters("rig", {"barriers.gap_m": 0.004, "output.monitor_rate_hz": 20.0})
    client.wait_until(lambda: len(journal) == 2, "the journal")
    (entry,) = journal.entries(1)
    assert (entry.kind.value, dict(entry.values), entry.sample) == ("parameter", {"barriers.gap_m": 0.004}, 700)
    with pytest.raises(ConfigError, match=r"barriers.gap_m must be >= 1e-06 and <= 1, got 6"):
        client.set_parameters("rig", {"barriers.gap_m": 6, "contact.law": "hertz"})
    assert client.get_parameters("rig", ["barriers.gap_m", "contact.law"]) == {
        "barriers.gap_m": 0.004,
        "contact.law": "flores",
    }


def test_over_travel_latches_with_an_error_until_cleared(client: Client) -> None:
    host_rig(client, shaker__travel_limit_m=0.001)
    client.wait_active("rig")
    client.command(frequency_hz=8.0, current_a=5.0)
    client.step(100)
    client.wait_until(lambda: "latched by over_travel" in client.status("rig").message, "the diagnostic")
    assert client.status("rig").level == b"\2"
    client.trigger("rig/clear_trip")
    row = client.command(current_a=0.1)
    assert row["current"] == 0.1


def test_the_pluck_service_uses_the_parameter_of_the_deflection(client: Client) -> None:
    host_rig(client, pluck__displacement_m=0.003, output__truth_scan=True, sphere__present=False)
    client.wait_active("rig")
    truth = client.collect("truth/scan")
    client.trigger("rig/pluck")
    client.step(2)
    client.wait_until(lambda: len(truth) == 2, "the truth")
    assert truth.rows()["x_1"][0] == pytest.approx(0.003)
    assert np.all(truth.rows()["x_b"] == 0)


def test_a_new_client_ignores_old_rows_while_it_waits_for_an_answer(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new client receives old rows, which must not end its first `command` with a scan of the past."""
    host_rig(client)
    client.wait_active("rig")
    client.command(current_a=0.5)
    client.step(10)
    client.command(current_a=0.3)
    client.step(10)
    with Client(client.context.get_domain_id(), name="newcomer") as newcomer:
        spin = newcomer._spinner.spin

        def spin_both(longest_s: float = 0.1) -> None:
            client.executor.spin_once(timeout_sec=min(longest_s, 0.005))
            spin(min(longest_s, 0.005))

        monkeypatch.setattr(newcomer._spinner, "spin", spin_both)
        assert newcomer.command(current_a=0.5)["sample"] == 2000
