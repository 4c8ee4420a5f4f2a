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
"""The complete graph as users run it: rig, analysis and recorder as processes, a client, an MCAP file at the end."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.tracker import Tracker
from impact_rig.client import Client, ProcessDiedError, Processes, isolated_domain
from impact_rig.codec import header_stamp_ns
from impact_rig.recording import open_run
from impact_rig.rig import resimulate
from impact_rig.runs import info, reanalysis, recorded_journal, recover
from impact_rig.runs.reanalysis import compare
from impact_rig.runs.verification import verify
from impact_rig.simtime import NS_PER_S
from impact_rig.states import Status

pytestmark = [pytest.mark.ros, pytest.mark.pipeline]
TICK = 10_000_000
RIG = {"barriers.gap_m": 0.002, "time.peers": ("analysis", "recorder")}


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs", namespace="/lab") as started:
        yield started


@pytest.fixture
def client(processes: Processes) -> Iterator[Client]:
    with Client(processes.domain_id, namespace="/lab", processes=processes) as user:
        yield user


def start_all(processes: Processes, client: Client, tmp_path: Path, **rig: object) -> None:
    processes.start("rig", {**RIG, **{name.replace("__", "."): value for name, value in rig.items()}})
    processes.start("analysis", {"gap_m": 0.002})
    processes.start("recorder", {"directory": str(tmp_path), "name": "run"})
    client.wait_active("rig", "analysis", "recorder")
    client.wait_until(lambda: client.status("recorder").message == "recording", "the recorder")


@pytest.mark.usefixtures("measured_programs")  # of one start, clock and end
def test_a_run_in_lockstep_is_complete_and_agrees_with_its_journal(
    processes: Processes, client: Client, tmp_path: Path
) -> None:
    """Published, recorded and re-simulated data are equal, and the recorded analysis is that of an offline tracker."""
    start_all(processes, client, tmp_path, time__mode="lockstep")
    scans = client.collect("daq/scan")
    client.step(20)
    client.command(frequency_hz=9.1, current_a=0.52)
    client.step(1500)
    client.set_parameters("rig", {"barriers.gap_m": 0.004})
    client.step(100)
    client.wait_until(lambda: len(scans) == 1620, "all blocks")
    assert client.figures("rig")["lost_blocks"] == "0"
    assert processes.stop() == {"rig": 0, "analysis": 0, "recorder": 0}

    with open_run(tmp_path / "run") as run:
        recorded = list(run.tables("daq/scan"))
        assert [table.stamp_ns for table in recorded] == [k * TICK for k in range(1620)]
        assert [t.rows.tobytes() for t in recorded] == [t.rows.tobytes() for t in scans.tables()]
        journal = list(recorded_journal.of_run(run))
        for table, block in zip(recorded, resimulate(journal), strict=False):
            assert table.rows.tobytes() == block.scan.rows.tobytes(), f"block {block.number}"
        measured = np.concatenate([table.rows for table in run.tables("transmissibility/table")])
        tracker = Tracker()
        (info,) = run.tables("daq/info")
        tracker.configure(info)
        tracker.label(0.002, info.stamp_ns)
        for table in run.tables("shaker/applied"):
            tracker.on_applied(table)
        again = [row for table in recorded for found in tracker.feed(table).measurements for row in found.rows]
    assert measured.tobytes() == np.array(again, measured.dtype).tobytes()
    assert (measured["settled"] == 1).any()


def test_a_killed_process_is_named_with_its_last_output_and_its_file_is_recovered(
    processes: Processes, client: Client, tmp_path: Path
) -> None:
    start_all(processes, client, tmp_path, time__mode="free_running")
    acknowledged = client.listen("daq/ack")
    client.wait_until(lambda: float(client.figures("recorder").get("messages", 0)) > 3000, "a recording")
    client.wait_until(lambda: any(ack.frame_id == "recorder" for ack in acknowledged.messages), "its acknowledgement")
    processes.running["recorder"].signal(signal.SIGKILL)
    with pytest.raises(
        ProcessDiedError, match=r"the recorder process was ended by SIGKILL; its last lines:\n(.*\n)*.*recording"
    ):
        client.wait_until(lambda: False, "the end of the recorder")
    processes.stop("recorder")
    client.wait_until(lambda: "peer recorder silent" in client.status("rig").message, "the rig to name the dead peer")
    assert processes.stop() == {"rig": 0, "analysis": 0}
    last_ns = max(
        ack.stamp.sec * NS_PER_S + ack.stamp.nanosec for ack in acknowledged.messages if ack.frame_id == "recorder"
    )
    recover(tmp_path / "run", tmp_path / "recovered")
    with open_run(tmp_path / "recovered") as run:
        stamps = [table.stamp_ns for table in run.tables("daq/scan")]
    assert stamps == list(range(0, len(stamps) * TICK, TICK))
    assert stamps[-1] >= last_ns > 0, "what the recorder has acknowledged is on disk"


def test_real_time_survives_a_suspension_and_a_second_rig_in_the_same_namespace(
    processes: Processes, client: Client, tmp_path: Path
) -> None:
    """SIGSTOP lasts longer than the pacer can catch up: time is given up and reported; stamps stay contiguous."""
    processes.start("rig", {"time.peers": [""]})
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    processes.start("rig", {"daq.seed": 2}, name="other_rig")
    client.wait_active("other_rig")
    # a lock says so at once, the graph names the other
    held_back = "waiting until the other rig has ended: /lab/rig publishes daq/scan"
    client.wait_until(lambda: held_back in client.status("other_rig").message, "the second to hold back")
    client.wait_until(lambda: "/lab/other_rig publishes" in client.status("rig").message, "the first to say so")
    client.wait_until(lambda: len(scans) > 50, "blocks of the first alone")
    assert set(np.diff([table.stamp_ns for table in scans.tables()])) == {TICK}
    processes.stop("other_rig")
    processes.running["rig"].signal(signal.SIGSTOP)
    client.spin_for(1.5)
    processes.running["rig"].signal(signal.SIGCONT)
    client.wait_until(lambda: "could not keep real time" in client.status("rig").message, "the diagnostic")
    assert int(client.figures("rig")["slips"]) >= 1  # a busy machine adds some
    assert float(client.figures("rig")["slipped_s"]) > 1.0
    scans.clear()
    client.wait_until(lambda: len(scans) > 20, "more blocks")
    stamps = [table.stamp_ns for table in scans.tables()]
    assert set(np.diff(stamps)) == {TICK}
    assert processes.stop() == {"rig": 0}


def test_a_run_in_real_time_is_complete_from_scan_0_and_is_reproduced(
    processes: Processes, client: Client, tmp_path: Path
) -> None:
    """Started like by the launch file: recorder and analysis start after the rig, which waits for them."""
    processes.start("rig", {**RIG, "time.start_wait_s": 3600.0, "sphere.present": False, "time.factor": 4.0})
    client.wait_active("rig")
    client.wait_until(lambda: "waiting for peer analysis, recorder" in client.status("rig").message, "the rig to wait")
    processes.start("recorder", {"directory": str(tmp_path), "name": "run"})
    processes.start("analysis", {"gap_m": 0.0, "hold_s": 4.0 * TrackerSettings().hold_s})  # as long on the clock
    client.wait_active("analysis", "recorder")
    client.wait_until(lambda: float(client.figures("rig").get("rig_time_s", 0)) > 0, "scan 0")
    assert client.figures("rig")["mode"] == "realtime"
    assert "peer" not in client.status("rig").message, "it began because both were there, not because it was tired"
    client.command(frequency_hz=9.1, current_a=0.52)
    table = client.collect("transmissibility/table")
    client.wait_until(lambda: (table.rows()["settled"] == 1).any() if len(table) else False, "a measurement", 300.0)
    for process in processes.running.values():
        assert "scipy/linalg" not in Path(f"/proc/{process.pid}/maps").read_text(), "0.4 s and 15 MB for nothing"
    assert processes.stop("recorder", "analysis", "rig") == {"recorder": 0, "analysis": 0, "rig": 0}
    found = info(tmp_path / "run")
    assert found.verdict.startswith("whole: "), found.verdict
    with open_run(tmp_path / "run") as run:
        (calibration,) = run.tables("daq/info")
        assert next(run.tables("daq/scan")).stamp_ns == calibration.stamp_ns
        assert calibration.rows["since_start"][0] == 0.0
        comparison = compare(run, reanalysis.measurements(reanalysis.analyze(run)))
        assert comparison.identical, comparison
        rows = np.concatenate([table.rows for table in run.tables("transmissibility/table")])
        lost = rows["status"] == Status.LOST_BLOCKS.value.encode()
        assert comparison.left_out[0] == 0 or lost.any(), comparison  # what a busy machine loses is not compared
        verified = verify(run)
        assert verified.identical, verified.reason
        counts = {one.topic: one.count for one in verified.topics}
        assert min(counts[name] for name in ("daq/info", "shaker/applied", "truth/joint_states", "rig/journal")) > 0
        *_, last = run.tables("daq/scan")
        end_ns = last.stamp_ns + round(len(last.rows) * NS_PER_S / 10_000)  # the recorder ends before the rig does
        stamps = [header_stamp_ns(one.data) for one in run.messages(["truth/joint_states"])]
        assert counts["truth/joint_states"] == sum(stamp < end_ns for stamp in stamps)


def test_a_recording_that_starts_during_a_run_is_valid(processes: Processes, client: Client, tmp_path: Path) -> None:
    """Scans reach the recorder some blocks before the calibration and the drive, which are latched."""
    processes.start("rig", {**RIG, "time.peers": ("analysis",), "sphere.present": False, "time.factor": 4.0})
    processes.start("analysis", {"gap_m": 0.0, "hold_s": 4.0 * TrackerSettings().hold_s})  # as long on the clock
    processes.start("recorder", {"directory": str(tmp_path), "name": "run", "record": False})
    client.wait_active("rig", "analysis", "recorder")
    client.command(frequency_hz=9.1, current_a=0.52)
    table = client.collect("transmissibility/table")
    client.wait_until(lambda: len(table) > 0, "a row", 60.0)
    client.trigger("recorder/start")
    table.clear()
    client.wait_until(lambda: len(table) > 0, "a row", 60.0)
    client.command(frequency_hz=9.3)
    table.clear()
    client.wait_until(lambda: (table.rows()["settled"] == 1).any() if len(table) else False, "a measurement", 300.0)
    assert processes.stop("recorder", "analysis", "rig") == {"recorder": 0, "analysis": 0, "rig": 0}
    assert info(tmp_path / "run").verdict.startswith("whole: ")
    with open_run(tmp_path / "run") as run:
        findings = list(reanalysis.analyze(run))
        impacts = [one for found in findings for one in found.impacts]
        comparison = compare(run, reanalysis.measurements(iter(findings)), impacts)
        assert comparison.same, comparison
        assert comparison.compared > 0
        verified = verify(run)
        assert verified.identical, verified.reason
