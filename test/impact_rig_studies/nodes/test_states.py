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
"""Every word of the table of states, reported by a real node in that state at once, with reason and time."""

from __future__ import annotations

import errno
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import TICK, host_rig
from rclpy.node import Node

from impact_rig import codec, states, topics
from impact_rig.client import Client
from impact_rig.client.client import ros_parameters
from impact_rig.errors import RecordingError
from impact_rig.nodes import messages
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.plot_node import PlotDataNode
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.recording import RunWriter
from impact_rig_studies.stepped_sine_node import SteppedSineNode

pytestmark = pytest.mark.ros
NODES: dict[str, type[ManagedNode[Any]]] = {
    "rig": RigNode, "analysis": AnalysisNode, "recorder": RecorderNode, "plot": PlotDataNode,
    "stepped_sine": SteppedSineNode,
}  # fmt: skip


def wait_for(client: Client, node: str, word: str, reason: str = "") -> dict[str, str]:
    """Wait until a node reports a word, with a reason that contains these words; return its figures."""

    def said() -> dict[str, str] | None:
        figures = client.figures(node)
        return figures if figures.get("state") == word and reason in figures["reason"] else None

    found = client.wait_until(said, f"{node} to be {word} ({reason})", 20.0)
    assert re.fullmatch("[0-9a-f]{16}", found["instance"])
    assert re.fullmatch(r"\d*", found["since_ns"])
    return found


def test_a_rig_reports_its_state(client: Client) -> None:
    """Each change is reported in the next message, not in one of the regular reports."""
    host_rig(client, "free_running", time__peers=["client"], output__autostart=False)
    inactive = wait_for(client, "rig", "inactive", "unconfigured")
    assert inactive["since_ns"] == ""
    client.change_state("rig", "configure")
    client.change_state("rig", "activate")
    found = wait_for(client, "rig", "no_peer", "client")
    assert found["instance"] != inactive["instance"]
    client.collect("daq/scan", acknowledge=True)
    wait_for(client, "rig", "at_rest")
    row = client.command(current_a=0.05)
    driving = wait_for(client, "rig", "driving")
    assert int(driving["since_ns"]) >= int(row["sample"]) * 100_000
    client.pause()
    wait_for(client, "rig", "paused", "~/pause")
    client.pause(False)
    client.trigger("rig/stop")
    wait_for(client, "rig", "tripped", "emergency stop")
    client.trigger("rig/clear_trip")
    assert wait_for(client, "rig", "at_rest")["instance"] == found["instance"]
    client.trigger("rig/pluck")
    wait_for(client, "rig", "plucked")
    client.change_state("rig", "deactivate")
    wait_for(client, "rig", "inactive", "inactive")
    client.change_state("rig", "activate")
    assert wait_for(client, "rig", "at_rest")["instance"] != found["instance"]


def test_the_reason_of_a_trip_names_the_interlock(client: Client) -> None:
    host_rig(client, time__peers=["client"], shaker__travel_limit_m=1e-6, drive__amplitude=0.5, step__blocks=50)
    client.wait_active("rig")
    client.collect("daq/scan", acknowledge=True)
    client.step()
    wait_for(client, "rig", "tripped", "travel")


def test_a_rig_in_lockstep_is_paused_between_steps(client: Client) -> None:
    host_rig(client, time__peers=["client"], drive__amplitude=0.1)
    client.wait_active("rig")
    client.collect("daq/scan", acknowledge=True)
    assert wait_for(client, "rig", "paused", "no step")["since_ns"] == "0"
    client.step(3)
    client.wait_until(lambda: client.trigger("rig/step") and client.figures("rig")["state"] == "driving", "the drive")
    assert wait_for(client, "rig", "paused", "no step")


def test_a_silent_peer_is_named(client: Client) -> None:
    host_rig(client, "free_running", time__peers=["client"], time__peer_timeout_s=0.3)
    client.wait_active("rig")
    client.collect("daq/scan")  # and never acknowledges
    wait_for(client, "rig", "silent_peer", "client")


def test_two_rigs_in_one_namespace_both_report_a_rival(client: Client) -> None:
    """The first rig continues, and the other one waits; neither is shown as a rig at rest."""
    first = host_rig(client, "realtime")
    client.wait_active("rig")
    wait_for(client, "rig", "at_rest")
    second: RigNode = client.host(
        RigNode, parameter_overrides=ros_parameters({"time.mode": "realtime", "output.autostart": False})
    )
    second.trigger_configure()
    second.trigger_activate()
    for node in (first, second):
        client.wait_until(lambda node=node: node.present().word == states.RigWord.RIVAL, "both to say so")
    said: set[str] = set()

    def both_report_a_rival() -> bool:
        figures = client.figures("rig")
        if figures["state"] == "rival":
            said.add(figures["instance"])
        return len(said) == 2

    client.wait_until(both_report_a_rival, "both to publish it")


def host_analysis(client: Client) -> AnalysisNode:
    node: AnalysisNode = client.host(AnalysisNode)
    return node


def test_an_analysis_reports_whether_it_can_measure(client: Client) -> None:
    host_analysis(client)
    wait_for(client, "analysis", "no_scans", "no scans received yet")
    host_rig(client, time__peers=["analysis"], step__blocks=100)
    client.wait_active("rig", "analysis")
    client.step()
    wait_for(client, "analysis", "at_rest")
    rows = client.collect("transmissibility/table")
    for _ in range(6):
        client.step()
    client.wait_until(lambda: len(rows) and rows.rows()["status"][0] == b"silence", "a row of a rig at rest")
    client.spin_for(1.5)
    assert wait_for(client, "analysis", "at_rest")["reason"] == "", "where nothing is to be measured, nothing fails"
    assert (client.status("analysis").level, client.status("analysis").message) == (b"\0", "at rest")
    client.command(current_a=0.52)
    client.step()
    client.step()
    since = int(wait_for(client, "analysis", "settling")["since_ns"])
    assert since == 700 * TICK
    for _ in range(12):
        client.step()
    wait_for(client, "analysis", "measuring")
    wait_for(client, "analysis", "no_scans", "no scans received for 2 s")
    client.change_state("analysis", "deactivate")
    wait_for(client, "analysis", "inactive", "inactive")


def test_lost_blocks_and_an_unmeasurable_signal_are_states_of_the_analysis(client: Client) -> None:
    """The base sensor is stuck: scans arrive, but DT cannot be measured."""
    faults = ["lost_block start_s=2 duration_s=0.01", "dropout channel=base start_s=3"]
    host_analysis(client)
    host_rig(
        client, time__peers=["analysis"], drive__amplitude=0.52, sphere__present=False, step__blocks=100,
        instruments__faults__planned=faults,
    )  # fmt: skip
    client.wait_active("rig", "analysis")
    seen: set[str] = set()

    def stepped(word: str) -> bool:
        client.step()
        seen.add(client.figures("analysis")["state"])
        return client.figures("analysis")["state"] == word

    client.wait_until(lambda: stepped("lost_scans"), "lost scans")
    wait_for(client, "analysis", "lost_scans")
    client.wait_until(lambda: stepped("unable"), "a measurement that cannot be", 60.0)
    assert wait_for(client, "analysis", "unable")["reason"]


def host_recorder(client: Client, directory: Path, **values: object) -> RecorderNode:
    node: RecorderNode = client.host(
        RecorderNode, parameter_overrides=ros_parameters({"directory": str(directory), "name": "run", **values})
    )
    return node


def test_a_recorder_reports_whether_it_records(client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    host_recorder(client, tmp_path)
    wait_for(client, "recorder", "waiting", "configuration")
    host_rig(client, time__peers=["recorder"])
    client.wait_active("rig", "recorder")
    wait_for(client, "recorder", "recording")
    client.step(3)
    client.trigger("recorder/stop")
    wait_for(client, "recorder", "idle")
    client.set_parameters("recorder", {"name": "another"})
    client.trigger("recorder/start")
    wait_for(client, "recorder", "recording")

    def full(*_: Any) -> None:
        raise RecordingError(f"no space left ({errno.ENOSPC})")

    monkeypatch.setattr(RunWriter, "flush_due", full)
    wait_for(client, "recorder", "failed", "no space left")
    client.change_state("recorder", "deactivate")
    wait_for(client, "recorder", "inactive", "inactive")


def intruder(client: Client, topic: topics.Topic) -> Callable[[Any], None]:
    """Return a publisher of another node on one of the rig's topics, once it is discovered."""
    node = client.host(Node, node_name="intruder")
    publisher = node.create_publisher(messages.class_of(topic), topic.name, messages.profile(topic.qos))
    client.wait_until(publisher.get_subscription_count, "a listener")
    return publisher.publish


def foreign_journal() -> bytes:
    return codec.encode_text("{}")


def test_a_recorder_reports_lost_messages_and_foreign_publishers(client: Client, tmp_path: Path) -> None:
    """Each of the two makes the run impossible to verify."""
    recorder = host_recorder(client, tmp_path)
    host_rig(client, time__peers=["recorder"])
    client.wait_active("rig", "recorder")
    client.step(3)
    wait_for(client, "recorder", "recording")
    recorder._account.take("/daq/scan", 1000)
    wait_for(client, "recorder", "losing", "on daq/scan")
    intruder(client, topics.JOURNAL)(foreign_journal())
    found = wait_for(client, "recorder", "rival", "/intruder and /rig publish rig/journal")
    assert found["other_publishers"] == found["reason"]
    status = client.status("recorder")
    assert status.level == b"\2"  # two publishers alone are a warning, lost messages are an error
    assert all(words in status.message for words in ("cannot be verified", "messages were lost"))


def test_a_stepped_sine_node_reports_the_state_of_its_sweep(client: Client) -> None:
    client.host(
        SteppedSineNode, parameter_overrides=ros_parameters({"frequencies_hz": [30.0], "begin": True, "current_a": 1.0})
    )
    wait_for(client, "stepped_sine", "waiting", "no rig subscribes to shaker/frequency and shaker/current")
    host_analysis(client)
    host_rig(client, "realtime", time__factor=4.0, sphere__present=False)
    client.wait_active("rig", "analysis", "stepped_sine")
    wait_for(client, "stepped_sine", "running")
    wait_for(client, "stepped_sine", "done")
    client.trigger("stepped_sine/start")
    wait_for(client, "stepped_sine", "running")
    client.trigger("stepped_sine/stop")
    wait_for(client, "stepped_sine", "aborted", "stopped by the operator")
    client.change_state("stepped_sine", "deactivate")
    wait_for(client, "stepped_sine", "inactive")


def test_every_node_has_documented_states() -> None:
    assert {name: kind.STATES for name, kind in NODES.items()} == states.BY_NODE
    for words in states.BY_NODE.values():
        assert all(word.doc for word in words)
