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
"""Ends of processes: stopped and restarted, nothing is left, files are readable, and the next start is not hindered."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from impact_rig.client import Client, Processes, isolated_domain
from impact_rig.recording import open_run
from impact_rig.runs import check_contiguity, recover

OWN = os.sched_getscheduler(0)  # the policy of the tests
pytestmark = [pytest.mark.ros, pytest.mark.pipeline]
ALL = ("rig", "analysis", "recorder")
BLOCK_NS = 10_000_000


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs") as started:
        yield started


def start_all(processes: Processes, run: Path, mode: str, **rig: object) -> None:
    processes.start("rig", {"time.mode": mode, **{name.replace("__", "."): value for name, value in rig.items()}})
    processes.start("analysis")
    processes.start("recorder", {"directory": str(run.parent), "name": run.name})


def blocks(run: Path) -> list[tuple[int, int]]:
    with open_run(run) as opened:
        return [(table.stamp_ns, len(table.rows)) for table in opened.tables("daq/scan", recorded_order=True)]


def shared_memory(processes: Processes) -> set[Path]:
    """Return the shared-memory segments of DDS that the processes have open; all processes share the ports."""
    maps = [Path(f"/proc/{process.pid}/maps").read_text() for process in processes.running.values()]
    return {Path(name) for name in re.findall(r"/dev/shm/fast(?:rtps|dds)_[0-9a-f]{16}\b", "\n".join(maps))}


def patient() -> int:
    """Return the scheduling policy of DDS threads here, which the parent process or a container may set."""
    if OWN != os.SCHED_OTHER:
        return OWN
    try:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        os.sched_setscheduler(0, OWN, os.sched_param(0))
    except OSError:
        return OWN
    return os.SCHED_BATCH


def threads_of_dds(process: int) -> list[Path]:
    threads = Path(f"/proc/{process}/task").iterdir()
    return [thread for thread in threads if (thread / "comm").read_text().startswith("dds.")]


def test_killed_processes_leave_a_readable_file_and_do_not_block_the_next_start(
    processes: Processes, tmp_path: Path
) -> None:
    """SIGKILL ends all, the reader first; then the same again on the same domain, with each available signal."""
    start_all(processes, tmp_path / "killed", "realtime")
    with Client(processes.domain_id) as client:
        client.wait_active(*ALL)
        client.wait_until(lambda: client.status("recorder").message == "recording", "the recorder")
        client.wait_until(lambda: "behind.analysis" in client.figures("rig"), "the analysis to be known")
        for process in processes.running.values():
            policies = {int(t.name): os.sched_getscheduler(int(t.name)) for t in threads_of_dds(process.pid)}
            assert set(policies.values()) == {patient()}, "they wait their turn"
            assert os.sched_getscheduler(process.pid) == OWN, "callbacks do not wait"
        processes.running["analysis"].signal(signal.SIGKILL)
        client.wait_until(
            lambda: re.search(r"analysis is \d+ s behind", client.status("rig").message), "the dead reader's name"
        )
        litter = shared_memory(processes)
        for name in ALL:
            processes.running[name].signal(signal.SIGKILL)
        assert processes.stop() == dict.fromkeys(ALL, -signal.SIGKILL)
    assert recover(tmp_path / "killed", tmp_path / "recovered") is not None
    assert check_contiguity(blocks(tmp_path / "recovered"), 10_000).whole

    assert any(path.exists() for path in litter), "SIGKILL leaves no litter any more: this test has lost its point"
    begin = time.monotonic()
    start_all(processes, tmp_path / "next", "realtime")
    with Client(processes.domain_id, processes=processes) as client:
        client.wait_active(*ALL)
        client.wait_until(lambda: client.status("recorder").message == "recording", "the recorder")
        scans = client.collect("daq/scan")
        client.wait_until(lambda: len(scans) > 30, "blocks")
        assert scans.lost() == 0
        assert time.monotonic() - begin < 60.0, "the litter of the killed ones holds up the next start"
        used = shared_memory(processes)
        assert used
        processes.running["rig"].signal(signal.SIGINT)
        processes.running["analysis"].signal(signal.SIGTERM)
        for _ in range(2):  # Ctrl-C reaches a group directly, and again through its parent
            processes.running["recorder"].signal(signal.SIGINT)
        codes = {name: processes.running[name].wait(10.0) for name in ALL}
    assert codes == dict.fromkeys(ALL, 0)
    for name in ALL:
        assert "Traceback" not in processes.running[name].log.read_text()
    assert check_contiguity(blocks(tmp_path / "next"), 10_000).whole
    left = [path for path in used - litter if path.exists()]
    assert not left, "who ends in order leaves nothing in shared memory"


def test_a_suspended_rig_or_peer_resumes_without_a_lost_block(processes: Processes, tmp_path: Path) -> None:
    """In free-running mode the rig waits for a stopped peer and names it; its own stop does not count."""
    start_all(
        processes, tmp_path / "run", "free_running",
        time__peers=("analysis", "recorder"), time__peer_timeout_s=0.5, time__ack_window=8,
    )  # fmt: skip
    with Client(processes.domain_id, processes=processes) as client:
        client.wait_active(*ALL)
        rig, analysis = processes.running["rig"], processes.running["analysis"]
        progress = lambda: float(client.figures("rig").get("rig_time_s", "0"))  # noqa: E731  # asked again and again
        client.wait_until(lambda: progress() > 1.0, "rig time")
        analysis.signal(signal.SIGSTOP)
        client.wait_until(lambda: "peer analysis silent" in client.status("rig").message, "the stopped peer's name")
        assert client.status("rig").level == b"\2"
        held = progress()
        analysis.signal(signal.SIGCONT)
        client.wait_until(lambda: progress() > held + 1.0, "rig time to go on by itself")
        rig.signal(signal.SIGSTOP)
        client.spin_for(1.2)  # longer than the peers' timeout and than AWAY_S: what is tested is the time itself
        rig.signal(signal.SIGCONT)
        held = progress()
        client.wait_until(lambda: progress() > held + 1.0, "rig time to go on")
        client.wait_until(lambda: client.status("rig").level == b"\0", "the rig to report no silent peer")
        assert client.figures("analysis")["lost_scans"] == "0"
        assert processes.stop() == dict.fromkeys(ALL, 0)
    stamps = [stamp for stamp, _ in blocks(tmp_path / "run")]
    assert stamps[0] == 0
    assert set(np.diff(stamps)) == {BLOCK_NS}


BAD_STARTS = {
    "a parameter without a value": (["-p", "gap"], None, "cannot start the node: .*-p gap"),
    "no such file": (["--params-file", "/nowhere.yaml"], None, "cannot start the node: .*/nowhere.yaml"),
    "not YAML": ([], "a: [\n", "cannot start the node: .*FILE"),
    "an unknown argument": (["--nonsense"], None, "cannot start the node: .*--nonsense"),
}


@pytest.mark.parametrize("what", BAD_STARTS)
def test_an_invalid_start_ends_with_one_clear_line(what: str, tmp_path: Path) -> None:
    arguments, content, reason = BAD_STARTS[what]
    path = tmp_path / "mine.yaml"
    if content is not None:
        path.write_text(content)
        arguments = ["--params-file", str(path)]
    with isolated_domain() as domain_id:
        ended = subprocess.run(
            [sys.executable, "-m", "impact_rig.nodes", "recorder", "--ros-args", *arguments],
            env={**os.environ, "ROS_DOMAIN_ID": str(domain_id)},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert ended.returncode == 2
    line = ended.stderr.strip().splitlines()[-1]
    assert re.search(reason.replace("FILE", str(path)), line), ended.stderr
    assert "Traceback" not in ended.stderr
