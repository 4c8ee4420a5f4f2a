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
"""Rig on its own ROS domain, in lockstep with nodes under test: hosted, answering, or acknowledging by themselves."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import attrs
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64, Header

from impact_rig.client import Client, ServiceFailedError, isolated_domain
from impact_rig.client.processes import Processes
from impact_rig.errors import CommandError, ConfigError, RecordingError
from impact_rig.nodes.rig_node import RigNode
from impact_rig.recording import open_run
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.runs.verification import verify
from impact_rig.testing import Fault, LocalRig, RosRig

pytestmark = pytest.mark.ros
PLUGIN = "impact_rig.testing.plugin"
LINEAR = {"sphere.present": False}
LOST = Fault(kind="lost_block", start_sample=1500, samples=250)


class Counter(Node):
    """Node as a user writes it: no keyword arguments, a queue of ten, no acknowledgement."""

    def __init__(self, topic: str = "daq/scan") -> None:
        super().__init__("counter")
        self.blocks: list[PointCloud2] = []
        self.create_subscription(PointCloud2, topic, self.blocks.append, 10)


class Answerer(Node):
    """Node that answers every block without naming it, and can be silenced."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("answerer", **kwargs)
        self.silent = False
        self.publisher = self.create_publisher(Float64, "answers", 10)
        self.create_subscription(PointCloud2, "daq/scan", self.on_scan, 10)

    def on_scan(self, message: PointCloud2) -> None:
        if not self.silent:
            self.publisher.publish(Float64(data=float(message.width)))


class Acknowledger(Node):
    """Node that sends `daq/ack` itself."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("acknowledger", **kwargs)
        self.publisher = self.create_publisher(Header, "daq/ack", 10)
        self.create_subscription(PointCloud2, "daq/scan", self.on_scan, 10)

    def on_scan(self, message: PointCloud2) -> None:
        self.publisher.publish(Header(stamp=message.header.stamp, frame_id="acknowledger"))


@pytest.fixture
def rig() -> Iterator[RosRig]:
    with RosRig(LINEAR, [LOST], hosted=True, record=True) as started:
        yield started


def test_samples_for_a_rig_that_is_not_driven_by_a_stream_are_rejected(rig: RosRig) -> None:
    for drive in (rig, LocalRig(LINEAR)):
        with pytest.raises(CommandError, match="the drive is sine, not a stream: "):
            drive.stream_level()
        with pytest.raises(CommandError, match="the drive is sine, not a stream: "):
            drive.feed(0, np.zeros(10))


def test_a_restarted_rig_begins_with_an_empty_stream_and_keeps_what_cannot_be_changed() -> None:
    stream = {**LINEAR, "drive.waveform": "stream"}
    with RosRig(stream, hosted=True) as rig:
        rig.feed(0, np.full(5000, 0.1))
        rig.run(0.2)
        assert rig.stream_level().buffered > 0
        rig.restart(from_flat(RigConfig(), {**stream, "daq.rate_hz": 5000, "barriers.gap_m": 0.002}), {})
        assert rig.stream_level()[:2] == (0, 0)
        assert (rig.config.daq.rate_hz, rig.rate_hz, rig.config.barriers.gap_m) == (10_000, 10_000, 0.002)


def test_a_rig_can_be_renewed_with_a_stream_as_its_drive(rig: RosRig) -> None:
    rig.configure({"drive.waveform": "stream"})
    with pytest.raises(CommandError, match="the drive is not yet a stream: "):
        rig.stream_level()
    for _ in range(2):
        rig.renew(from_flat(RigConfig(), {**LINEAR, "drive.waveform": "stream"}))
        rig.feed(0, np.full(5000, 0.1))
        rig.run(0.2)
        assert rig.stream_level().buffered > 0


def test_a_recording_whose_copy_failed_can_be_saved_to_another_directory(rig: RosRig, tmp_path: Path) -> None:
    rig.run(0.1)
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="save it to another directory, or copy it from"):
        rig.save(tmp_path / "file" / "run")
    with open_run(rig.save(tmp_path / "run")) as run:
        assert verify(run).identical


@pytest.mark.parametrize("hosted", [True, False])
def test_the_answers_of_a_hosted_node_have_arrived_when_a_step_returns(hosted: bool) -> None:
    with RosRig(LINEAR, hosted=hosted) as rig:
        rig.host(Answerer)
        answers = rig.listen("answers")
        for steps in range(1, 51):
            rig.step()
            assert len(answers) == steps


@pytest.mark.parametrize(("refused", "given"), [("faults", {"faults": [LOST]}), ("hosted", {"hosted": True})])
def test_what_only_a_new_rig_can_have_is_refused_for_a_running_one(refused: str, given: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=f"^{refused} is only for a new rig, but namespace='/rig' names a"):
        RosRig(namespace="/rig", **given)


def test_a_rig_over_topics_yields_the_samples_of_a_rig_without_ros(rig: RosRig) -> None:
    """Both drivers of one rig give equal samples, so a test may change from one to the other."""
    node = rig.host(Counter)
    virtual = LocalRig(LINEAR, [LOST])
    for each in (rig, virtual):
        assert each.command(frequency_hz=8.0, current_a=0.3, at_sample=1000) == 1000
        each.run_to_sample(5000)
    ours, theirs = rig.tables(), virtual.tables()
    assert [table.stamp_ns for table in ours] == [table.stamp_ns for table in theirs]
    assert all(one.rows.tobytes() == other.rows.tobytes() for one, other in zip(ours, theirs, strict=True))
    assert rig.lost_samples() == virtual.lost_samples() == [(1500, 1800)]
    assert len(node.blocks) == len(ours) == 47, "the node under test has had every published block, none twice"
    with pytest.raises(CommandError, match="no command can act on sample 5050"):
        rig.command(current_a=0.1, at_sample=5050)


def test_a_node_can_answer_or_acknowledge_and_is_named_when_it_is_silent(rig: RosRig) -> None:
    answerer = rig.client.host(Answerer)
    rig.client.host(Acknowledger)
    answers = rig.follow("answerer", output="answers")
    assert rig.follow("acknowledger") is None
    rig.step(25)
    assert answers is not None
    assert len(answers) == len(rig.tables()) == 22, "three of them are lost on the board"
    assert {message.data for message in answers.messages} == {100.0}
    answerer.silent = True
    rig.client.set_parameters("rig", {"time.peer_timeout_s": 0.2})

    def silent_peers() -> list[str]:
        with pytest.raises(ServiceFailedError, match="does not acknowledge") as failure:
            rig.step(20)
        found = re.search(r"peer (.+) does not acknowledge", str(failure.value))
        assert found
        return found[1].split(", ")

    assert "answerer" in silent_peers()
    for _ in range(50):  # on a busy machine, the others may answer late as well
        if (named := silent_peers()) == ["answerer"]:
            break
    assert named == ["answerer"]


def test_a_step_takes_the_requested_number_of_blocks_even_if_zero_or_set_otherwise(rig: RosRig) -> None:
    """A time of zero is valid; with `step.blocks` set, a step still takes the number of blocks that it is asked for."""
    rig.run(0.0)
    rig.configure({"step.blocks": 3})
    rig.step(1)
    assert (rig.sample, len(rig.tables())) == (100, 1)
    rig.step(3)
    assert (rig.sample, len(rig.tables())) == (400, 4)


def test_an_injected_fault_is_reported_at_the_scan_at_which_it_acts(rig: RosRig) -> None:
    """The time of an injected fault in reports counts from scan 0, not from the injection."""
    rig.step(10)
    fault = Fault(kind="offset_step", channel="laser", start_sample=1200, value=1e-3)
    rig.inject(fault)
    assert rig.faults == [LOST, fault]
    assert str(fault) in rig.report()


def test_a_running_rig_accepts_changes_and_faults_and_has_an_analysis(rig: RosRig) -> None:
    """Over topics, it is done as docs/how-to/testing.md says; without ROS, by `configure` and `inject`."""
    rig.processes.start("analysis")
    assert rig.follow("analysis") is None, "it acknowledges by itself"
    acknowledged = rig.listen("daq/ack")
    rig.step(10)
    rig.client.set_parameters(
        "rig", {"barriers.gap_m": 0.004, "instruments.faults.planned": ["stuck channel=laser start_s=0"]}
    )
    rig.step(20)
    assert rig.time_s == pytest.approx(0.3)
    laser = rig.rows()["laser"]
    assert len(set(laser[:1000])) > 5
    assert len(set(laser[-1000:])) == 1
    assert "analysis" in {message.frame_id for message in acknowledged.messages}
    (started,) = (row for row in rig.rows("truth/faults") if row["active"] and row["kind"] == b"stuck")
    assert started["channel"] == b"laser"
    assert {"barriers.gap_m": 0.004} in [dict(entry.values) for entry in rig.journal()]


def test_a_rig_in_lockstep_is_joined_at_its_present_scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs", "/rig") as processes:
        processes.start("rig", {**LINEAR, "time.mode": "lockstep"})
        with Client(domain_id, "/rig", processes, "operator") as operator:
            operator.wait_active("rig")
            for _ in range(7):
                operator.trigger("rig/step")
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        with RosRig(namespace="/rig") as rig:
            assert (rig.sample, rig.lost_scans) == (700, 0)
            rig.inject(Fault(kind="offset_step", channel="laser", start_sample=1000, value=1e-3))
            rig.run_to_sample(1100)
            assert (rig.sample, rig.lost_scans, rig.first_scan(rig.tables()[0])) == (1100, 0, 700)
            assert list(rig.newest("truth/faults", 1)["sample"]) == [1000]
            node = rig.host(Counter, topic="/rig/daq/scan")
            rig.step(2)
            assert len(node.blocks) == 2, "the rig waits for this node, and for no name that does not exist"
        with Client(domain_id, "/rig", processes, "operator") as operator:
            operator.wait_active("rig")
            operator.trigger("rig/step")  # the node that has ended is no peer


def test_a_step_of_a_joined_rig_in_real_time_waits_for_blocks_that_are_not_there_yet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs", "/rig") as processes:
        processes.start("rig", {**LINEAR, "time.mode": "realtime"})
        with Client(domain_id, "/rig", processes, "operator") as operator:
            operator.wait_active("rig")
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        with RosRig(namespace="/rig") as rig:
            newest = rig.tables()[-1]
            assert rig.sample >= rig.first_scan(newest) + len(newest.rows)
            before = rig.sample
            rig.step(1)
            assert rig.first_scan(rig.tables()[-1]) >= before


def test_empty_lines_of_planned_faults_are_no_faults() -> None:
    with RosRig({**LINEAR, "instruments.faults.planned": [" ", LOST.line(10_000)]}, hosted=True) as rig:
        assert rig.inject(fault := Fault(kind="offset_step", channel="laser", start_sample=1200, value=1e-3)) == 2
        assert rig.faults == [LOST, fault]
        assert rig.inject(LOST) == 3
        assert rig.faults == [LOST, fault, LOST], "the same fault, planned and injected"
        rig.step(1)
        with pytest.raises(CommandError, match="must be >= 100, the first scan not yet measured, got 50"):
            rig.inject(attrs.evolve(LOST, start_sample=50))
        rig.restart(RigConfig(), {})
        assert rig.faults == []


def test_a_new_rate_of_a_stream_counts_from_the_next_reset() -> None:
    with RosRig({**LINEAR, "drive.waveform": "stream"}, hosted=True) as rig:
        rig.configure({"drive.stream_rate_hz": 5000})
        assert rig.stream_rate_hz == 10_000
        rig.client.trigger("rig/reset")
        rig.client.wait_until(lambda: rig.stream_rate_hz == 5000, "the new rate")
        rig.configure({"drive.waveform": "sine", "drive.stream_rate_hz": 4000})
        rig.client.trigger("rig/reset")
        assert rig.stream_rate_hz == 4000


def test_a_node_without_a_subscription_cannot_be_in_lockstep(rig: RosRig) -> None:
    with pytest.raises(ConfigError, match="'deaf' does not subscribe to daq/scan"):
        rig.host(lambda **kwargs: Node("deaf", **kwargs))


@pytest.mark.pipeline
def test_the_last_output_of_dead_processes_is_reported_and_their_run_is_complete(tmp_path: Path) -> None:
    """The run saved from real processes after the rig was killed is still verified bit for bit."""
    rig = RosRig({"barriers.gap_m": 0.002}, record=True)
    try:
        rig.command(frequency_hz=9.1, current_a=0.52, at_sample=500)
        rig.run(0.5)
        rig.processes.running["rig"].process.kill()
        with pytest.raises(RuntimeError, match="the rig process was ended by SIGKILL"):
            rig.run(0.5)
        rig.save(str(tmp_path / "saved"))
    finally:
        rig.close()
    assert {path.name for path in (tmp_path / "saved" / "logs").glob("*.log")} >= {"rig.log", "recorder.log"}
    with open_run(tmp_path / "saved") as run:
        assert str(verify(run)).startswith("identical")
        rows = np.concatenate([table.rows for table in run.tables("daq/scan")])
    assert len(rows) == rig.sample == 5500
    assert not rig.directory.exists()


def test_a_rig_that_cannot_be_built_fails_at_once_with_the_reason(tmp_path: Path) -> None:
    """Its configuration is valid, but a file is missing: only the node can find this out."""
    with isolated_domain() as domain_id, Client(domain_id) as client:
        client.host(RigNode, parameter_overrides=[Parameter("config_file", value=str(tmp_path / "none.yaml"))])
        with pytest.raises(ServiceFailedError, match=r"rig: cannot configure: cannot read configuration: .*none\.yaml"):
            client.wait_active("rig")


FAILING = """
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

class Fragile(Node):
    def __init__(self, raises=True, **kwargs):
        super().__init__("fragile", **kwargs)
        self.blocks, self.raises = 0, raises
        self.create_subscription(PointCloud2, "daq/scan", self.on_scan, 10)

    def on_scan(self, message):
        self.blocks += 1
        if self.blocks == 6 and self.raises:
            raise ValueError("of the node under test")

def test_a_node_that_raises(ros_rig):
    rig = ros_rig({"daq.seed": 8}, hosted=True)
    rig.host(Fragile)
    rig.run(seconds=0.2)

def test_a_peer_that_hangs(ros_rig):
    rig = ros_rig({"daq.seed": 9, "time.peer_timeout_s": 0.3}, hosted=True)
    rig.client.host(Fragile, raises=False)  # which acknowledges nothing
    rig.client.set_parameters("rig", {"time.peers": ["client", "recorder", "fragile"]})
    rig.run(seconds=0.2)
"""


def test_every_failure_leaves_a_recording_and_its_properties(tmp_path: Path) -> None:
    """This also holds if a hosted node raises, or a peer hangs: then the run contains what had arrived."""
    (tmp_path / "test_failing.py").write_text(FAILING, encoding="utf-8")
    runs, junit = tmp_path / "runs", tmp_path / "junit.xml"
    command = [sys.executable, "-m", "pytest", "-q", "-p", PLUGIN, "-p", "no:cacheprovider", "-n", "0"]
    command += ["--rig-runs", str(runs), f"--junitxml={junit}", str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=250)
    assert "2 failed" in done.stdout, done.stdout + done.stderr
    for case, seed in zip(ET.parse(junit).iter("testcase"), ("8", "9"), strict=True):
        found = {one.get("name"): one.get("value") or "" for one in case.iter("property")}
        assert found["rig.seed"] == seed
        assert " 0 s of rig time" not in found["rig.report"]
        with open_run(Path(found["rig.run"])) as run:
            assert run.topics[run.resolve("daq/scan")].count >= 5


WITH_CAPSYS = """
import sys

def test_what_is_printed(ros_rig, capsys):
    rig = ros_rig({"sphere.present": False}, hosted=True)
    rig.run(seconds=0.1)
    print("spoken", file=sys.stderr)
    assert len(rig.rows()) == 1000
    assert "spoken" in capsys.readouterr().err
"""


@pytest.mark.parametrize(
    "option", ["-s", *(pytest.param(o, marks=pytest.mark.slow) for o in ("--capture=sys", "--capture=fd"))]
)
def test_a_test_can_use_capsys_with_any_capture_mode_of_pytest(tmp_path: Path, option: str) -> None:
    """With `-s`, sys.stderr has no file, so the events executor would raise `UnsupportedOperation: fileno`."""
    (tmp_path / "test_capsys.py").write_text(WITH_CAPSYS, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", PLUGIN, "-p", "no:cacheprovider", option, str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=250)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout
