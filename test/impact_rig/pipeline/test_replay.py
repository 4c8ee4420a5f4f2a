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
"""A replayed run is equal to the run itself for every subscriber."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from rclpy.parameter import Parameter
from std_srvs.srv import SetBool

from impact_rig.blocks import Table
from impact_rig.client import Client, isolated_domain
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.messages import nanoseconds
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.recording import open_run
from impact_rig.runs import reanalysis

pytestmark = [pytest.mark.ros, pytest.mark.pipeline, pytest.mark.usefixtures("measured_programs")]
BLOCKS = 1600
TICK_NS = 10_000_000


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixteen seconds of the rig without its sphere, analysed live, the recorder started after a reset."""
    directory = tmp_path_factory.mktemp("replay")
    with isolated_domain() as domain_id, Client(domain_id) as client:
        for node, values in (
            (AnalysisNode, {"gap_m": 0.0}),
            (RecorderNode, {"directory": str(directory), "name": "run", "record": False}),
            (RigNode, {"time.mode": "lockstep", "time.peers": ["analysis", "recorder"], "sphere.present": False}),
        ):
            client.host(node, parameter_overrides=[Parameter(name, value=value) for name, value in values.items()])
        client.wait_active("rig", "analysis", "recorder")
        client.step(20)
        client.trigger("rig/reset")
        client.trigger("recorder/start")
        client.command(frequency_hz=9.1, current_a=0.52)
        client.step(BLOCKS)
        client.trigger("recorder/stop")
    return directory / "run"


@pytest.fixture
def client() -> Iterator[Client]:
    with isolated_domain() as domain_id, Client(domain_id) as user:
        yield user


@contextlib.contextmanager
def replay(client: Client, run: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    script = "import sys; from impact_rig.cli import main; sys.exit(main())"
    with subprocess.Popen(
        [sys.executable, "-c", script, "replay", str(run), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "ROS_DOMAIN_ID": str(client.node.context.get_domain_id()), "COLUMNS": "80"},
    ) as player:
        try:
            yield player
        finally:
            player.kill()


def finish(client: Client, player: subprocess.Popen[str], code: int = 0) -> str:
    client.wait_until(lambda: player.poll() is not None, "the end of the replay", 60.0)
    output, _ = player.communicate()
    assert player.returncode == code, output
    return output


def content(tables: list[Table]) -> list[tuple[int, bytes]]:
    return [(table.stamp_ns, table.rows.tobytes()) for table in tables]


def test_a_live_analysis_of_a_replay_reproduces_its_results(client: Client, run: Path) -> None:
    """The replay is as fast as the analysis follows, far faster than real time, and loses no block."""
    client.host(AnalysisNode)
    client.wait_active("analysis")
    topics = ("daq/scan", "daq/info", "shaker/applied")
    with replay(client, run, "--rate", "max", "--peers", "analysis", "--paused", "--topics", *topics) as player:
        scans = client.collect("daq/scan", timeout_s=30.0)
        found = client.collect("transmissibility/table")
        clock = client.collect("/clock")
        client.set_parameters("analysis", {"gap_m": 0.0})
        client.call(SetBool, "player/pause", SetBool.Request(data=False))
        finish(client, player)
    with open_run(run) as opened:
        recorded = list(opened.tables("daq/scan", recorded_order=True))
        again = reanalysis.measurements(reanalysis.analyze(opened))
        assert reanalysis.compare(opened, again).identical
    client.wait_until(lambda: len(scans) == len(recorded) == BLOCKS, "every block")
    assert content(scans.tables()) == content(recorded)
    settled = [table for table in again if table.rows["settled"][0] == 1]
    client.wait_until(lambda: found.rows()["settled"].sum() >= len(settled) > 0, "settled measurements")
    assert content([table for table in found.tables() if table.rows["settled"][0] == 1]) == content(settled)
    times = [nanoseconds(message.clock) for message in clock.messages]  # a clock is sampled, not queued
    assert times == sorted(times)
    assert scans.tables()[0].stamp_ns < times[-1] <= scans.tables()[-1].stamp_ns + TICK_NS


def test_a_replay_in_real_time_is_paced_and_ctrl_c_ends_a_loop(client: Client, run: Path) -> None:
    with replay(client, run, "--rate", "30", "--loop", "--delay", "0") as player:
        scans = client.collect("daq/scan", timeout_s=30.0)
        monitors = client.collect("laser", timeout_s=30.0)  # a round takes half a second: it may be the second by now
        scans.clear()
        monitors.clear()
        client.wait_until(lambda: len(scans) > 1.5 * BLOCKS, "the next round", 60.0)
        player.send_signal(signal.SIGINT)
        assert "interrupted" in finish(client, player, 130)
    stamps = np.array([table.stamp_ns for table in scans.tables()])
    assert (np.diff(stamps) < 0).sum() >= 1, "stamps go back where the run begins again"
    assert len(monitors) > BLOCKS / 2, "50 Hz: one for every other block"


def test_a_single_topic_can_be_replayed(client: Client, run: Path) -> None:
    with replay(client, run, "--rate", "30", "--topics", "laser", "--paused") as player:
        heard = client.collect("laser", timeout_s=30.0)
        client.call(SetBool, "player/pause", SetBool.Request(data=False))
        finish(client, player)
    assert len(heard) > BLOCKS / 4


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--rate", "max"), "would lose messages"),
        (("--rate", "max", "--peers", "analysis", "--topics", "laser"), "include it in the chosen topics"),
        (("--topics", "nothing/here"), "no topic 'nothing/here'"),
        (("--rate", "-1"), "must be max or a number"),
        (("--delay", "-1"), "must be a number of seconds from 0 to 3600"),
        (("--delay", "nan"), "must be a number of seconds from 0 to 3600"),
    ],
)
def test_an_impossible_replay_is_rejected(client: Client, run: Path, options: tuple[str, ...], words: str) -> None:
    with replay(client, run, *options) as player:
        output = finish(client, player, 2 if options[-1] in ("-1", "nan") else 1)
    assert words in " ".join(output.split())
