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
"""The recorder writes every message it receives, reports losses, and acknowledges nothing that it cannot write."""

from __future__ import annotations

import errno
import functools
import os
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Float64, String

from impact_rig import codec, topics
from impact_rig.blocks import TRANSMISSIBILITY, Table
from impact_rig.client import Client, ServiceFailedError
from impact_rig.client.client import ros_parameters
from impact_rig.errors import RecordingError
from impact_rig.nodes import messages
from impact_rig.nodes.managed import Level
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.recording import open_run
from impact_rig.recording.losses import RECORD_NAME, read_record
from impact_rig.runs import info, recorded_journal

pytestmark = pytest.mark.ros


def host_recorder(client: Client, directory: Path, **values: object) -> RecorderNode:
    return client.host(
        RecorderNode, parameter_overrides=ros_parameters({"directory": str(directory), "name": "run", **values})
    )


def recording(client: Client) -> bool:
    return client.status("recorder").message == "recording"


def host_both(client: Client, directory: Path, **values: object) -> tuple[RecorderNode, RigNode]:
    """Host a recorder and a rig that waits for it, until it records."""
    recorder, rig = host_recorder(client, directory), host_rig(client, time__peers=["recorder"], **values)
    client.wait_active("rig", "recorder")
    client.wait_until(lambda: recording(client), "the recorder")
    return recorder, rig


def test_a_run_contains_every_message_and_the_configuration(client: Client, tmp_path: Path) -> None:
    host_both(client, tmp_path, daq__seed=77, barriers__gap_m=0.002)
    client.command(frequency_hz=9.1, current_a=0.52)
    client.note("first light")
    client.step(50)
    client.trigger("recorder/stop")
    assert info(tmp_path / "run").lost == {}
    with open_run(tmp_path / "run") as run:
        assert run.topics[run.resolve("daq/scan")].count == 50
        assert run.provenance["seed"] == "77"
        assert run.provenance["mode"] == "lockstep"
        assert b"gap_m: 0.002" in run.attachments()["config.yaml"]
        stamps = [table.stamp_ns for table in run.tables("daq/scan")]
        assert stamps == [k * 10_000_000 for k in range(50)]
        names = {name.lstrip("/") for name in run.topics}
        assert names >= {"daq/info", "rig/journal", "rig/configuration", "shaker/applied", "accelerometer", "notes"}
        entries = list(recorded_journal.of_run(run))
        assert [entry.kind.value for entry in entries] == ["start", "command", "command"]
        assert entries[0].values["barriers.gap_m"] == 0.002
        times = [message.log_time for message in run.messages()]
        assert max(times) < 10**9, "rig time, not the system's"


@pytest.mark.parametrize("seed", ["abc", ".inf", "null", "[1]"])
def test_an_invalid_seed_does_not_prevent_recording(client: Client, tmp_path: Path, seed: str) -> None:
    """Any node may send a seed. An invalid one must not leave the recorder idle without a reason."""
    host_recorder(client, tmp_path)
    client.wait_active("recorder")
    client.publish(topics.CONFIGURATION, String(data=f"daq: {{seed: {seed}}}"), listener="recorder")
    client.wait_until(lambda: client.status("recorder").message.startswith("recording"), "the recorder")
    client.trigger("recorder/stop")
    with open_run(tmp_path / "run") as run:
        assert run.provenance["seed"] == "-1"
        assert run.attachments()["config.yaml"].decode() == f"daq: {{seed: {seed}}}"


@pytest.mark.parametrize("end", ["stop", "deactivate", "failed", "broken"])
def test_messages_of_several_blocks_are_written_together_and_all_before_the_end(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str
) -> None:
    """An error in the queued messages, such as a full disk, must close the run, and ~/stop must report it."""
    monkeypatch.setattr("impact_rig.nodes.acknowledgements.REALTIME_S", 60.0)  # no timer processes the queue before
    came: list[str] = []
    kept: list[int] = []

    class Counting(RecorderNode):
        def _on_message(self, topic: topics.Topic, data: bytes, info: dict[str, Any]) -> None:
            came.append(topic.name)
            super()._on_message(topic, data, info)
            kept.append(len(self._inbox))

        def _take(self, topic: topics.Topic, data: bytes, info: dict[str, Any]) -> None:
            if ended and end == "failed":
                self._fail(RecordingError("no room"))
            if ended and end == "broken" and ended.pop():
                raise RuntimeError("of one message")
            super()._take(topic, data, info)

        def _on_timer(self) -> None:
            if not ended:  # otherwise the timer may be faster than the request
                super()._on_timer()

        def _finish(self) -> None:
            due.append(len(came))
            super()._finish()

    ended: list[bool] = []
    due: list[int] = []
    node = client.host(Counting, parameter_overrides=ros_parameters({"directory": str(tmp_path), "name": "run"}))
    host_rig(client, "realtime", time__peers=["recorder"])
    client.wait_active("rig", "recorder")
    client.wait_until(lambda: max(kept, default=0) >= 10, "a full inbox")
    client.wait_until(lambda: node._inbox, "something in it")
    ended.append(True)
    if end in ("deactivate", "broken"):
        assert client.change_state("recorder", "deactivate")
    elif end == "stop":
        client.trigger("recorder/stop")
    else:
        with pytest.raises(ServiceFailedError, match="no room"):
            client.trigger("recorder/stop")
        return
    with open_run(tmp_path / "run") as run:
        counts = {name.lstrip("/"): topic.count for name, topic in run.topics.items()}
    assert counts["daq/scan"] > 0
    assert sum(counts.values()) == due[0] - (end == "broken"), (
        "and not what was still delivered to a node that had ended"
    )


def test_a_recorder_that_cannot_write_holds_the_rig_until_an_operator_acts(client: Client, tmp_path: Path) -> None:
    """Nothing is overwritten; a rig that waits for the recorder names it as the reason."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "metadata.yaml").write_text("precious")
    host_recorder(client, tmp_path)
    host_rig(client, time__peers=["recorder"], time__peer_timeout_s=0.3)
    client.wait_until(lambda: client.status("recorder").message.startswith("recording stopped"), "the reason")
    assert client.status("recorder").level == b"\2"
    client.wait_active("rig", "recorder")
    with pytest.raises(ServiceFailedError, match="peer recorder"):
        client.step(30)
    with pytest.raises(ServiceFailedError, match="run"):
        client.trigger("recorder/start")
    assert (tmp_path / "run" / "metadata.yaml").read_text() == "precious"
    client.trigger("recorder/stop")
    client.step(30)
    client.set_parameters("recorder", {"name": "other"})
    client.trigger("recorder/start")
    client.step(3)
    client.trigger("recorder/stop")
    with open_run(tmp_path / "other") as run:
        assert run.topics[run.resolve("daq/scan")].count == 3
        assert run.topics[run.resolve("rig/journal")].count == 1, (
            "messages from before the start that belong to the run"
        )


def test_start_and_stop_answer_in_every_state(client: Client, tmp_path: Path) -> None:
    host_recorder(client, tmp_path, record=False, configuration_wait_s=0.0)
    client.wait_active("recorder")
    assert "nothing" in client.trigger("recorder/stop")
    client.trigger("recorder/start")
    with pytest.raises(ServiceFailedError, match="already recording"):
        client.trigger("recorder/start")
    assert client.change_state("recorder", "deactivate")
    with pytest.raises(ServiceFailedError, match="the recorder is inactive: activate it first"):
        client.trigger("recorder/start")
    assert client.change_state("recorder", "cleanup")
    with pytest.raises(ServiceFailedError, match="the recorder is unconfigured: configure and activate it first"):
        client.trigger("recorder/start")
    with open_run(tmp_path / "run") as run:
        assert run.attachments()["environment.json"]


def test_a_start_before_the_configuration_has_arrived_is_not_requested_again(client: Client, tmp_path: Path) -> None:
    host_recorder(client, tmp_path)
    client.wait_active("recorder")
    with pytest.raises(ServiceFailedError, match="already requested, and waits for the rig's configuration"):
        client.trigger("recorder/start")


def test_recordings_within_one_second_are_numbered(client: Client, tmp_path: Path) -> None:
    """Stopping and starting again within one second must work, although the name of the run is taken."""
    host_recorder(client, tmp_path, record=False, name="", configuration_wait_s=0.0)
    client.wait_active("recorder")
    started = []
    for _ in range(20):
        started.append(client.trigger("recorder/start"))
        client.trigger("recorder/stop")
    assert len({*started}) == 20
    assert any(name.endswith("_2") for name in started), "as twenty take less than twenty seconds"


def test_a_recorder_whose_disk_fails_stops_acknowledging(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig in lockstep must not count a block as recorded that the recorder could not write."""
    really = os.write

    def full(descriptor: int, data: bytes) -> int:
        if Path(f"/proc/self/fd/{descriptor}").readlink().is_relative_to(tmp_path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return really(descriptor, data)

    host_both(client, tmp_path, time__peer_timeout_s=0.3)
    client.step(5)
    monkeypatch.setattr(os, "write", full)  # from now on no file of the recording takes a byte
    client.wait_until(lambda: client.status("recorder").message.startswith("recording stopped"), "the reason")
    with pytest.raises(ServiceFailedError, match="peer recorder does not acknowledge"):
        client.step(5)
    client.wait_until(lambda: "peer recorder silent" in client.status("rig").message, "the rig to name it")


def test_all_rapid_changes_of_calibration_and_configuration_are_recorded(client: Client, tmp_path: Path) -> None:
    """The recorder is busy with other work while all the changes are made."""
    recorder, rig = host_both(client, tmp_path)
    client.step(1)
    changes = 300
    for number in range(changes):  # nothing is spun meanwhile
        (result,) = rig.set_parameters(ros_parameters({"instruments.laser.lag_s": 1e-3 + 1e-6 * number}))
        assert result.successful
    assert recorder.active
    client.wait_until(lambda: int(client.figures("recorder")["messages"]) > 2 * changes, "the recorder", 120.0)
    client.step(1)
    client.trigger("recorder/stop")
    found = info(tmp_path / "run")
    assert (found.lost, found.intact) == ({}, True)
    with open_run(tmp_path / "run") as run:
        lags = [table.rows["lag"][1] for table in run.tables("daq/info")]
        assert run.topics[run.resolve("rig/configuration")].count == changes + 1
    assert lags[1:] == [pytest.approx(1e-3 + 1e-6 * number) for number in range(changes)]


def test_several_publishers_of_a_topic_are_not_taken_for_a_loss(client: Client, tmp_path: Path) -> None:
    """Two operators send commands and remarks: each has its own sequence numbers."""
    host_both(client, tmp_path)
    others = [client.host(Node, node_name=f"operator_{number}") for number in range(2)]
    outlets = [
        (node.create_publisher(Float64, topics.FREQUENCY.name, messages.profile(topics.FREQUENCY.qos)),
         node.create_publisher(String, topics.NOTES.name, messages.profile(topics.NOTES.qos)))
        for node in others
    ]  # fmt: skip
    client.wait_until(
        lambda: all(one.get_subscription_count() > 0 for pair in outlets for one in pair), "the listeners"
    )
    for number in range(30):
        frequency, remark = outlets[number % 3 // 2]  # the one speaks twice as often as the other
        frequency.publish(Float64(data=9.0 + 0.01 * number))
        remark.publish(String(data=f"remark {number}"))
        client.step(1)
    client.trigger("recorder/stop")
    found = info(tmp_path / "run")
    assert found.verdict.startswith("whole: ")
    assert client.status("recorder").level == b"\0"


def test_lost_messages_are_reported_by_topic_and_noted_in_the_file(client: Client, tmp_path: Path) -> None:
    recorder, _ = host_both(client, tmp_path)
    client.step(1)
    (inlet,) = [one for one in recorder.subscriptions if one.topic_name == "/shaker/applied"]
    really, arrived = inlet.callback, []

    def deaf(*arguments: object) -> object:
        arrived.append(arguments)
        return None if len(arrived) % 3 == 2 else really(*arguments)

    inlet.callback = functools.wraps(really)(deaf)
    for number in range(9):
        client.command(frequency_hz=9.0 + 0.01 * number)
    client.wait_until(lambda: len(arrived) == 9, "the commands")
    client.wait_until(lambda: client.figures("recorder").get("lost.shaker/applied") == "3", "the losses to be counted")
    assert client.status("recorder").level == b"\2"
    client.trigger("recorder/stop")
    found = info(tmp_path / "run")
    assert (found.lost, found.intact) == ({"/shaker/applied": 3}, False)
    with open_run(tmp_path / "run") as run:
        (stream,) = read_record(run.record(RECORD_NAME))["/shaker/applied"]
    assert stream.publisher == "/rig"


def test_a_message_replaced_by_a_newer_one_does_not_count_as_lost(client: Client, tmp_path: Path) -> None:
    """The rig keeps only its newest robot description, so a busy recorder receives a part of them."""
    recorder, _ = host_both(client, tmp_path)
    (inlet,) = [one for one in recorder.subscriptions if one.topic_name == f"/{topics.ROBOT_DESCRIPTION.name}"]
    really, arrived = inlet.callback, []

    def every_third(*arguments: object) -> object:
        arrived.append(arguments)
        return really(*arguments) if len(arrived) % 3 == 0 else None

    inlet.callback = functools.wraps(really)(every_third)
    for number in range(7):
        client.set_parameters("rig", {"barriers.gap_m": 0.002 + 0.001 * number})
        client.wait_until(lambda count=number: len(arrived) > count, "the description")
    client.step(2)
    assert recorder.health() == (Level.OK, "recording")
    assert not [key for key in recorder.figures() if key.startswith("lost.")]
    client.trigger("recorder/stop")
    assert client.status("recorder").level == b"\0"
    with open_run(tmp_path / "run") as run:
        (stream,) = read_record(run.record(RECORD_NAME))[f"/{topics.ROBOT_DESCRIPTION.name}"]
    assert stream.lost > 1
    found = info(tmp_path / "run")
    assert found.intact, found.verdict


def test_acknowledged_blocks_are_complete_on_every_topic(client: Client, tmp_path: Path) -> None:
    taken: Counter[str] = Counter()
    acknowledged: list[Counter[str]] = []

    class Counting(RecorderNode):
        def _take(self, topic: topics.Topic, data: bytes, info: dict[str, Any]) -> None:
            taken[topic.name] += 1
            super()._take(topic, data, info)

        def send(self, topic: topics.Topic, message: Any) -> None:
            if topic is topics.ACK:
                acknowledged.append(Counter(taken))
            super().send(topic, message)

    client.host(Counting, parameter_overrides=ros_parameters({"directory": str(tmp_path), "name": "run"}))
    host_rig(client, time__peers=["recorder"], output__monitor_rate_hz=100.0, output__truth_scan=True)
    client.wait_active("rig", "recorder")
    client.wait_until(lambda: recording(client), "the recorder")
    client.step(20)
    client.trigger("recorder/stop")
    assert acknowledged
    for counts in acknowledged:
        assert counts[topics.SCAN.name] <= min(counts[topics.TRUTH_SCAN.name], counts[topics.JOINT_STATES.name]), counts


@pytest.mark.parametrize("topic", [topics.SCAN, topics.JOINT_STATES])
def test_after_a_loss_nothing_is_acknowledged_until_the_recording_is_stopped(
    client: Client, tmp_path: Path, topic: topics.Topic
) -> None:
    recorder, _ = host_both(client, tmp_path, time__peer_timeout_s=0.3, output__monitor_rate_hz=100.0)
    client.step(2)
    (inlet,) = [one for one in recorder.subscriptions if one.topic_name == f"/{topic.name}"]
    really, arrived = inlet.callback, []

    def lose_the_first(*arguments: object) -> object:
        arrived.append(arguments)
        return None if len(arrived) == 1 else really(*arguments)

    inlet.callback = functools.wraps(really)(lose_the_first)
    with pytest.raises(ServiceFailedError, match="peer recorder does not acknowledge"):
        client.step(6)
    client.wait_until(lambda: "no block is acknowledged" in client.status("recorder").message, "the reason")
    client.trigger("recorder/stop")
    client.pause(False)
    client.step(3)


def test_after_a_stall_nothing_is_acknowledged_while_messages_may_still_be_repeated(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rig stalls as well, gives up its lag and sends blocks at once: none of them is late by its own time."""
    monkeypatch.setattr("impact_rig.nodes.recorder_node.REPEATED_S", 1.5)
    host_recorder(client, tmp_path)
    host_rig(client, "realtime", time__peers=["recorder"])
    client.wait_active("rig", "recorder")
    heard = client.listen(topics.ACK.name)
    for _ in range(2):  # after the first stall, stamps are behind the system time
        before = len(heard)
        client.wait_until(lambda n=before: len(heard) > n + 5, "acknowledgements")  # type: ignore[misc]
        begin = time.monotonic()
        time.sleep(1.2)  # nothing here runs
        heard.clear()
        client.wait_until(lambda: len(heard) > 0, "acknowledgements again")
        assert time.monotonic() - begin > 2.5


def test_long_blocks_ahead_of_time_lose_no_monitor_message(client: Client, tmp_path: Path) -> None:
    """The rig sends 16 blocks of half a second ahead: more messages than the middleware holds."""
    host_recorder(client, tmp_path)
    host_rig(client, "free_running", time__peers=["recorder"], daq__block_scans=5000, output__monitor_rate_hz=200.0)
    client.wait_active("rig", "recorder")
    scans = client.listen("daq/scan")
    client.wait_until(lambda: len(scans) > 40, "blocks", 60.0)
    client.trigger("recorder/stop")
    assert info(tmp_path / "run").lost == {}


def test_latched_results_of_earlier_cases_are_not_part_of_a_run(client: Client, tmp_path: Path) -> None:
    """A recorder that starts receives latched results of earlier cases, which are not part of its run."""
    node = client.host(Node, node_name="analysis")
    profile = messages.profile(topics.TRANSMISSIBILITY_TABLE.qos)
    table = node.create_publisher(messages.class_of(topics.SCAN), topics.TRANSMISSIBILITY_TABLE.name, profile)
    rows = np.zeros(1, TRANSMISSIBILITY)
    for stamp in (1, 2, 3):
        table.publish(codec.encode(Table(stamp, rows)))
    host_recorder(client, tmp_path, configuration_wait_s=0.0)
    host_rig(client, time__peers=["recorder"])
    client.wait_active("recorder")
    client.wait_until(lambda: recording(client) and table.get_subscription_count(), "the recorder")
    table.publish(codec.encode(Table(4, rows)))
    assert table.wait_for_all_acked(Duration(seconds=30.0)), "topics overtake each other, and services topics"
    client.step(1)
    client.trigger("recorder/stop")
    with open_run(tmp_path / "run") as run:
        assert [found.stamp_ns for found in run.tables("transmissibility/table")] == [4]


def test_the_calibration_is_attached_as_readable_text(client: Client, tmp_path: Path) -> None:
    host_both(client, tmp_path)
    client.step(5)
    client.set_parameters("rig", {"instruments.laser.lag_s": 0.001})
    client.step(5)
    client.trigger("recorder/stop")
    with open_run(tmp_path / "run") as run:
        found = run.attachments()
        certificates = [table.rows for table in run.tables("daq/info")]
    first, second = (yaml.safe_load(found[name]) for name in ("calibration.yaml", "calibration_2.yaml"))
    assert list(first["channels"]) == ["accelerometer", "laser", "base", "current"]
    assert first["channels"]["laser"]["lag"] == certificates[0]["lag"][1]
    assert second["channels"]["laser"]["lag"] == certificates[1]["lag"][1] == 0.001


def test_an_impossible_directory_is_rejected_and_the_node_continues(client: Client, tmp_path: Path) -> None:
    host_recorder(client, tmp_path, record=False)
    host_rig(client, time__peers=["recorder"])
    client.wait_active("rig", "recorder")
    client.step(1)
    client.set_parameters("recorder", {"directory": "~nobody_of_that_name/runs"})
    with pytest.raises(ServiceFailedError, match="nobody_of_that_name/runs' cannot be used"):
        client.trigger("recorder/start")
    client.set_parameters("recorder", {"directory": str(tmp_path)})
    assert client.trigger("recorder/start") == str(tmp_path / "run")
