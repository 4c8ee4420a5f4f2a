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
"""A rig starts when it is alone on its topics and, in realtime, when its peers are connected, or a limit is over."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from rclpy.node import Node

from impact_rig import topics
from impact_rig.client import Client, Collector, ServiceFailedError, WaitTimeoutError
from impact_rig.client.client import ros_parameters
from impact_rig.nodes import messages
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.nodes.session import NamespaceLock
from impact_rig.recording import open_run
from impact_rig.runs import info, recorded_journal

pytestmark = pytest.mark.ros
LEVELS = {"ok": b"\0", "warn": b"\1", "error": b"\2"}


def test_a_realtime_recording_begins_with_scan_0(client: Client, tmp_path) -> None:
    """The rig waits for recorder and analysis, which are its peers, however late they start."""
    host_rig(client, "realtime", time__peers=["analysis", "recorder"], time__start_wait_s=3600.0)
    client.wait_active("rig")
    client.wait_until(lambda: "waiting for peer analysis, recorder" in client.status("rig").message, "the diagnostic")
    assert client.status("rig").level == LEVELS["warn"]
    with pytest.raises(ServiceFailedError, match="the rig has not started: waiting for peer"):
        client.trigger("rig/reset")
    client.host(RecorderNode, parameter_overrides=ros_parameters({"directory": str(tmp_path), "name": "run"}))
    client.wait_until(
        lambda: "waiting for peer analysis to subscribe, at most" in client.status("rig").message, "the recorder"
    )
    client.host(AnalysisNode)
    client.wait_active("analysis")
    scans = client.collect("daq/scan")
    client.wait_until(lambda: len(scans) > 20, "blocks")
    client.trigger("recorder/stop")
    with open_run(tmp_path / "run") as run:
        (calibration,) = run.tables("daq/info")
        first = next(run.tables("daq/scan"))
        journal = next(recorded_journal.of_run(run))
    assert calibration.rows["since_start"][0] == 0.0
    assert first.stamp_ns == calibration.stamp_ns == journal.stamp_ns
    assert info(tmp_path / "run").intact
    assert int(client.figures("analysis")["unconfigured_scans"]) == 0


def test_a_rig_in_real_time_continues_without_a_peer_that_does_not_appear(client: Client) -> None:
    host_rig(client, "realtime", time__peers=["absent"], time__start_wait_s=0.3)
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    client.wait_until(lambda: len(scans) > 5, "blocks all the same")
    client.wait_until(lambda: "running without peer absent" in client.status("rig").message, "the diagnostic")
    assert client.status("rig").level == LEVELS["warn"]


def other(client: Client, topic: topics.Topic) -> Node:
    """Return a node that publishes one of the rig's topics."""
    node = client.host(Node, node_name="intruder")
    node.create_publisher(messages.class_of(topic), topic.name, messages.profile(topic.qos))
    return node


@pytest.mark.parametrize("topic", [topics.SCAN, topics.CLOCK], ids=lambda topic: topic.name)
def test_a_rig_with_a_rival_publisher_names_it_and_continues(client: Client, topic: topics.Topic) -> None:
    host_rig(client, time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.step(3)
    other(client, topic)
    expected = f"/intruder publishes {topic.name} as well as this rig"
    client.wait_until(lambda: expected in client.status("rig").message, "the diagnostic")
    assert client.status("rig").level == LEVELS["error"]
    assert client.figures("rig")["other_publishers"] == expected
    client.step(3)
    assert len(scans) == 6


def starts(journal: Collector) -> int:
    """Return the number of starts in a journal."""
    return [entry.kind.value for entry in journal.entries()].count("start")


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_a_second_rig_waits_until_the_first_has_ended(client: Client, mode: str) -> None:
    """Two rigs with one name in one namespace would be merged into one recording."""
    first = host_rig(client, "realtime")
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    journal = client.collect("rig/journal")
    client.wait_until(lambda: len(scans) > 3, "blocks of the first")
    client.wait_until(lambda: starts(journal) == 1, "its start, which late subscribers receive again")
    second: RigNode = client.host(
        RigNode, parameter_overrides=ros_parameters({"time.mode": mode, "daq.seed": 2, "output.autostart": False})
    )
    second.trigger_configure()
    second.trigger_activate()
    # the graph names it, a lock is quicker
    held_back = "waiting until the other rig has ended: another /rig publishes daq/scan"
    client.wait_until(lambda: held_back in second.health()[1], "the second to hold back")
    assert second.health()[0] == 2
    assert starts(journal) == 1, "not a word of the second in the journal"
    client.wait_until(lambda: "another /rig publishes daq/scan" in first.health()[1], "the first to say so")
    first.trigger_deactivate()
    first.trigger_cleanup()
    client.wait_until(lambda: starts(journal) == 2, "the second to begin")


def test_a_rig_waits_for_a_local_rig_that_is_not_discovered_yet(client: Client) -> None:
    place = NamespaceLock(client.node)
    assert place.take()
    node = host_rig(client)
    client.wait_until(lambda: "another rig of this machine" in client.status("rig").message, "the diagnostic")
    assert client.status("rig").level == LEVELS["error"]
    assert "has ended: another rig of this machine is in the namespace /" in node._session.why_not()
    place.leave()
    assert node._session.why_not() == "the rig is about to start: try again"
    client.wait_until(lambda: client.status("rig").message == "running in time mode lockstep", "the rig to begin")
    assert not place.take()


def test_a_rig_in_real_time_ignores_other_publishers_of_the_clock(client: Client) -> None:
    host_rig(client, "realtime")
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    client.wait_until(lambda: len(scans) > 3, "blocks")
    assert client.node.count_publishers("/clock") == 0


def test_a_clock_can_belong_to_a_namespace(client: Client) -> None:
    """The launch file starts two rigs this way, next to each other and not in real time."""
    remapped = ["--ros-args", "-r", "/clock:=clock"]
    for name in ("one", "two"):
        client.host(
            lambda name=name, **kwargs: RigNode(**{**kwargs, "namespace": f"/{name}", "cli_args": remapped}),
            parameter_overrides=ros_parameters({"time.mode": "lockstep"}),
        )
    client.wait_until(lambda: client.status("one/rig").message == "running in time mode lockstep", "the first")
    client.wait_until(lambda: client.status("two/rig").message == "running in time mode lockstep", "the second")
    client.trigger("one/rig/step")
    client.trigger("two/rig/step")
    clocks = [client.node.count_publishers(name) for name in ("/clock", "/one/clock", "/two/clock")]
    assert clocks == [0, 1, 1]
    with pytest.raises(WaitTimeoutError):
        client.wait_until(lambda: client.status("one/rig").level != LEVELS["ok"], "a quarrel", 1.5)
