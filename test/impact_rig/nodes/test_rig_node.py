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
"""Life of the rig node: start, reset, latched messages for late subscribers, and a simulation that cannot continue."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import DRIVEN, TICK, host_rig
from rclpy.qos import ReliabilityPolicy

from impact_rig import codec
from impact_rig.client import Client
from impact_rig.client.client import ros_parameters
from impact_rig.errors import SimulationError
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.managed import ManagedNode
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig, from_flat, load_config
from impact_rig.rig.journal import InputKind
from impact_rig.topics import Topic

pytestmark = pytest.mark.ros


def test_a_rig_with_an_invalid_value_is_not_configured_and_reports_the_reason(client: Client) -> None:
    node = host_rig(client, barriers__gap_m=6)
    client.wait_until(lambda: client.status("rig").level == b"\2", "the diagnostic")
    assert "barriers.gap_m must be >= 1e-06 and <= 1, got 6" in client.status("rig").message
    assert client.state("rig") == "unconfigured"
    assert not client.change_state("rig", "configure")
    assert node.refusals.counts.total() == 0


def test_a_reset_begins_a_new_journal_and_stamps_continue(client: Client) -> None:
    host_rig(client, **DRIVEN)
    client.wait_active("rig")
    journal, scans = client.collect("rig/journal"), client.collect("daq/scan")
    client.step(5)
    client.trigger("rig/reset")
    client.step(5)
    client.wait_until(lambda: len(scans) == 10, "all blocks")
    assert [table.stamp_ns for table in scans.tables()] == [k * TICK for k in range(10)]
    first, second = ([t.rows.tobytes() for t in scans.tables()[k : k + 5]] for k in (0, 5))
    assert first == second, "as new"
    start, reset = journal.entries()
    assert (start.kind, reset.kind) == (InputKind.START, InputKind.RESET)
    assert (start.sequence, reset.sequence) == (0, 0)
    assert start.values == reset.values


def test_a_late_subscriber_receives_the_present_state_and_the_journal(client: Client) -> None:
    host_rig(client)
    client.wait_active("rig")
    client.command(frequency_hz=8.0, current_a=0.2)
    client.step(3)
    late = {name: client.collect(name) for name in ("daq/info", "rig/configuration", "rig/journal", "shaker/applied")}
    # step() changes a parameter: the configuration before it arrives as well, and then the active one
    expected = {"daq/info": 1, "rig/configuration": 2, "rig/journal": 3, "shaker/applied": 3}
    client.wait_until(lambda: {n: len(c) for n, c in late.items()} == expected, "what was published before")
    assert late["daq/info"].rows()["name"].tolist() == [b"accelerometer", b"laser", b"base", b"current"]
    assert late["shaker/applied"].rows()[["frequency", "current"]].tolist() == [(9.1, 0.0), (8.0, 0.0), (8.0, 0.2)]
    assert [entry.name for entry in late["rig/journal"].entries()] == ["", "frequency", "current"]


def test_the_scans_of_a_block_are_published_last(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scans are acknowledged for the complete block: its true values, and readings that are filtered 80 ms later."""
    sent: list[tuple[str, int]] = []
    delays = {"truth/joint_states": 0, "laser": 8 * TICK}
    send = ManagedNode.send

    def noted(node: ManagedNode, topic: Topic, message: object) -> None:
        if isinstance(message, bytes) and topic.name in ("daq/scan", *delays):
            sent.append((topic.name, codec.header_stamp_ns(message)))
        send(node, topic, message)

    monkeypatch.setattr(ManagedNode, "send", noted)
    host_rig(client, **DRIVEN)
    client.wait_active("rig")
    for name in delays:
        client.collect(name)
    client.step(20)
    begin, seen = 0, set()  # of the block whose scans come next
    for name, stamp in sent:
        if name == "daq/scan":
            begin = stamp + TICK
        elif name in delays:
            assert begin <= stamp + delays[name] < begin + TICK, name
            seen.add(name)
    assert seen == set(delays)


def test_the_published_configuration_is_a_file_that_loads_again(client: Client, tmp_path) -> None:
    host_rig(client, barriers__gap_m=0.004)
    client.wait_active("rig")
    configuration = client.collect("rig/configuration")
    client.wait_until(lambda: configuration.messages, "rig/configuration")
    path = tmp_path / "rig.yaml"
    path.write_text(configuration.messages[0].data)
    expected = from_flat(RigConfig(), {"barriers.gap_m": 0.004, "time.mode": "lockstep"})
    assert load_config(path) == expected


def test_qos_of_publishers_and_subscriptions_can_be_overridden(client: Client) -> None:
    depth, reliability = (
        "qos_overrides./daq/scan.publisher.depth",
        "qos_overrides./shaker/current.subscription.reliability",
    )
    host_rig(client, **{depth: 7, reliability: "best_effort"})
    client.host(AnalysisNode, parameter_overrides=ros_parameters({"qos_overrides./daq/scan.subscription.depth": 5}))
    client.wait_active("rig", "analysis")
    assert client.get_parameters("rig", [depth, reliability]) == {depth: 7, reliability: "best_effort"}
    (command,) = [
        info for info in client.node.get_subscriptions_info_by_topic("/shaker/current") if info.node_name == "rig"
    ]
    assert command.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    scans = "qos_overrides./daq/scan.subscription.depth"
    assert client.get_parameters("analysis", [scans]) == {scans: 5}


@pytest.mark.parametrize("mode", ["realtime", "free_running"])
def test_a_failed_simulation_deactivates_the_rig_which_can_be_restarted(
    client: Client, mode: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = host_rig(client, mode, time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.wait_until(lambda: len(scans) > 0, "the first block")

    def stuck(_rig: Rig, _until_ns: int) -> list[Block]:
        raise SimulationError("no progress in drive segment 7")

    with monkeypatch.context() as broken:  # by hand: no legal configuration is known that does this
        broken.setattr(Rig, "advance", stuck)
        client.wait_until(lambda: "no progress in drive segment 7" in client.status("rig").message, "the reason")
        assert client.status("rig").level == b"\2"
        assert client.state("rig") == "inactive"
    assert client.change_state("rig", "activate")
    scans.clear()
    client.wait_until(lambda: len(scans) > 5, "blocks of the next rig")
    assert node.refusals.counts == {"exception": 1}
