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
"""Faulty controllers as processes next to a rig in real time: each ends as docs/how-to/drive.md says, and is recorded.

They drive one rig, one after the other; at its end, the recording contains everything and can be verified.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from subprocess import PIPE

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from impact_rig.client import Client, Processes, isolated_domain
from impact_rig.recording import open_run
from impact_rig.rig.journal import InputKind
from impact_rig.runs import info
from impact_rig.runs.verification import verify

pytestmark = [pytest.mark.ros, pytest.mark.pipeline]

IN_ORDER = True
EXAMPLES = Path(__file__).parents[3] / "examples"
STOPPED_S = 3.0
CONTROLLER = """
import sys

import numpy as np
import rclpy
from pointcloud import stamp_ns
from velocity_feedback import VelocityFeedback


class Paced(VelocityFeedback):
    heard = next_ns = 0

    def on_scan(self, message):
        if self.output.get_subscription_count() < 2:  # rig and recorder
            return
        self.heard += 1
        if self.heard < 50:  # both need a moment to find us, too, and what they miss is not sent again
            return
        if sys.argv[1] == "feedback":
            return super().on_scan(message)
        self.next_ns = self.next_ns or stamp_ns(message) + 40_000_000
        if sys.argv[1] == "slow":
            if self.heard % 10 == 1:
                self.play(stamp_ns(message) + 40_000_000, np.full(100, 0.1))
            return
        for _ in range(10):
            self.play(self.next_ns, np.full(100, 0.1))
            self.next_ns += 10_000_000


rclpy.init()
rclpy.spin(Paced())
"""


class Bench:
    """Rig driven by its stream, and a recorder, as processes, with everything that the rig has reported so far."""

    def __init__(self, client: Client, processes: Processes, directory: Path, domain_id: int) -> None:
        self.client, self.processes, self.directory, self.domain_id = client, processes, directory, domain_id
        self._streams = client.collect("shaker/stream")
        self._journal = client.collect("rig/journal")

    def state(self, name: str) -> float:
        """Newest value of a column of shaker/stream."""
        tables = self._streams.tables()[-1:]
        return float(tables[0].rows[name][0]) if tables else 0.0

    def count_entries(self, key: str) -> int:
        """Return how often the journal contains the stream's `begin` or `end`."""
        return sum(entry.kind is InputKind.STREAM and entry.name == key for entry in self._journal.entries())

    def wait(self, condition, what: str) -> None:
        self.client.wait_until(condition, what, 60.0)

    @contextlib.contextmanager
    def controller(self, name: str) -> Iterator[None]:
        """Start a controller, wait until its samples take effect, and finally kill it and wait until they end."""
        begins, ended = self.count_entries("begin"), self.count_entries("end")
        environment = {"PYTHONPATH": str(EXAMPLES)}
        self.processes.start(name, command=[sys.executable, "-c", CONTROLLER, name], environment=environment)
        self.wait(lambda: self.count_entries("begin") > begins, f"samples of {name}")
        yield
        self.processes.running[name].signal(signal.SIGKILL)
        self.processes.stop(name)
        self.wait(lambda: self.count_entries("end") > ended and self.state("buffered") == 0, f"the end of {name}")
        self.wait(lambda: "did not arrive in time" in self.client.status("rig").message, "the warning")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    directory = tmp_path_factory.mktemp("controllers")
    with isolated_domain() as domain_id, Processes(domain_id, directory / "logs") as processes:
        processes.start("rig", {"drive.waveform": "stream"})
        processes.start("recorder", {"directory": str(directory), "name": "run"})
        with Client(domain_id) as client:  # without knowledge of the processes: controllers are killed
            client.wait_active("rig", "recorder")
            client.wait_until(lambda: client.status("recorder").message == "recording", "the recorder")
            yield Bench(client, processes, directory, domain_id)


def test_a_controller_plays_a_file_to_a_running_rig(bench: Bench, tmp_path: Path) -> None:
    np.savez(tmp_path / "wave.npz", drive=0.3 * np.sin(2.0 * np.pi * 9.1 * np.arange(5_000) / 10_000), fs=10_000.0)
    program = [sys.executable, "-c", "from impact_rig.cli import main; raise SystemExit(main())", "drive", "play"]
    words = [
        "--json",
        str(tmp_path / "wave.npz"),
        "--through",
        "running",
        "--namespace",
        "/",
        "--output",
        str(tmp_path / "run"),
    ]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(bench.domain_id)}
    recorder = bench.processes.running["recorder"]
    bench.wait(lambda: "behind.recorder" in bench.client.figures("rig"), "the rig to know its reader")
    recorder.signal(signal.SIGSTOP)  # it cannot be found meanwhile, and must not miss the first samples
    with subprocess.Popen([*program, *words], env=environment, stdout=PIPE, stderr=PIPE, text=True) as playing:
        try:
            node = bench.client.node
            bench.wait(lambda: node.count_publishers("shaker/waveform") or playing.poll() is not None, "the player")
            assert playing.poll() is None, playing.communicate()
            bench.client.spin_for(1.0)
            recorder.signal(signal.SIGCONT)
            output, errors = playing.communicate(timeout=250)
        finally:
            recorder.signal(signal.SIGCONT)
            playing.kill()
    assert playing.returncode == 0, errors
    found = json.loads(output)
    assert found["peak_asked"] == pytest.approx(0.3)
    assert found["current_error"] < 0.05
    with open_run(tmp_path / "run") as run:
        assert run.holds("shaker/waveform")
    bench.wait(lambda: bench.count_entries("end") == bench.count_entries("begin") == 1, "the end of the stream")


def test_a_controller_that_is_suspended_and_resumes_is_late_and_then_followed_again(bench: Bench) -> None:
    """The recorder is stopped together with the controller; at the end of this file, it must have every block."""
    with bench.controller("feedback"):
        late, begins, process = bench.state("late"), bench.count_entries("begin"), bench.processes.running["feedback"]
        recorder = bench.processes.running["recorder"]
        for one in (process, recorder):
            one.signal(signal.SIGSTOP)
        bench.wait(lambda: "did not arrive in time" in bench.client.status("rig").message, "the warning")
        missing = bench.state("missing")
        bench.wait(lambda: bench.state("missing") > missing + STOPPED_S * 10_000, "three seconds of silence")
        for one in (recorder, process):
            one.signal(signal.SIGCONT)
        bench.wait(lambda: bench.state("late") > late, "answers to what it missed, which is past")
        bench.wait(lambda: bench.count_entries("begin") > begins, "samples again")


def test_samples_beyond_the_buffer_are_rejected_from_a_controller_ten_times_too_fast(bench: Bench) -> None:
    refused = bench.state("refused")
    with bench.controller("fast"):
        bench.wait(lambda: bench.state("refused") > refused + 10, "refusals")
        assert bench.state("buffered") <= 2.0 * 10_000


def test_a_controller_ten_times_too_slow_is_followed_only_at_times(bench: Bench) -> None:
    begins, ended = bench.count_entries("begin"), bench.count_entries("end")
    with bench.controller("slow"):
        bench.wait(lambda: bench.count_entries("begin") >= begins + 5, "five blocks")
        assert bench.count_entries("end") >= ended + 4


def test_the_recording_of_all_controllers_is_complete_and_verified(bench: Bench) -> None:
    assert bench.client.state("rig") == "active"
    bench.client.trigger("recorder/stop")
    path = bench.directory / "run"
    assert info(path).scans.lost_blocks == 0
    with open_run(path) as run:
        assert str(verify(run)).startswith("identical")
