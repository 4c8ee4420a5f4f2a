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
"""A recorder that is killed, suspended or too slow at 50 kS/s: all that it has acknowledged is on disk."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from impact_rig.client import Client, Collector, Processes, isolated_domain
from impact_rig.nodes.messages import header_stamp_ns, nanoseconds
from impact_rig.recording import open_run
from impact_rig.runs import recover

pytestmark = [pytest.mark.ros, pytest.mark.pipeline, pytest.mark.timeout(300)]
RATE_HZ = 50_000
BLOCK_NS = 10_000_000
OTHERS = ("truth/scan", "truth/joint_states", "truth/impacts")  # published with a block, ahead of its scans
Live = tuple[Client, Processes, dict[str, Collector]]


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    """Rig in real time, and everything that it publishes with its blocks."""
    directory = tmp_path_factory.mktemp("killed")
    overrides = {
        "daq.rate_hz": RATE_HZ, "daq.block_scans": RATE_HZ * BLOCK_NS // 10**9, "drive.amplitude": 0.52,
        "barriers.gap_m": 0.002, "output.truth_scan": True, "output.monitor_rate_hz": 100.0,
    }  # fmt: skip
    with isolated_domain() as domain_id, Processes(domain_id, directory / "logs") as processes:
        processes.start("rig", overrides)
        with Client(domain_id, processes=processes) as client:
            client.wait_active("rig")
            yield client, processes, {name: client.collect(name) for name in ("daq/scan", *OTHERS)}


def kill_and_recover(live: Live, directory: Path, after_s: float, stopped_s: float = 0.0) -> None:
    """Kill a recorder some time after its start or after a suspension; check everything that it has acknowledged."""
    client, processes, published = live
    for collector in published.values():
        collector.clear()
    recorder = processes.start("recorder", {"directory": str(directory), "name": "run"})
    client.wait_until((directory / "run" / "run.mcap").exists, "the recorder", 60.0)
    acks = client.listen("daq/ack")
    client.wait_until(lambda: len(acks) > 50, "acknowledgements")
    if stopped_s:
        recorder.signal(signal.SIGSTOP)
        client.spin_for(stopped_s)
        recorder.signal(signal.SIGCONT)
    client.spin_for(after_s)
    recorder.signal(signal.SIGKILL)
    processes.stop("recorder")
    client.spin_for(0.1)

    recover(directory / "run", directory / "out")
    acknowledged = max(nanoseconds(header.stamp) for header in acks.messages)
    with open_run(directory / "out") as run:
        kept = {name: list(run.messages([name])) for name in published}
    first_ns = min(header_stamp_ns(bytes(message.data)) for message in kept["daq/scan"])
    for name, collector in published.items():
        since_ns = first_ns + (0 if name == "daq/scan" else BLOCK_NS)  # it may have joined within a block
        stamps = [header_stamp_ns(message) for message in collector.messages]
        due = [stamp for stamp in stamps if since_ns <= stamp <= acknowledged]
        assert len(due) > 10, name
        assert not set(due).difference(header_stamp_ns(bytes(message.data)) for message in kept[name]), name
    scans = {bytes(message.data) for message in kept["daq/scan"]}
    assert {raw for raw in published["daq/scan"].messages if first_ns <= header_stamp_ns(raw) <= acknowledged} <= scans


@pytest.mark.parametrize("after_s", [1.17])
def test_a_killed_recorder_loses_no_acknowledged_block(live: Live, tmp_path: Path, after_s: float) -> None:
    kill_and_recover(live, tmp_path, after_s)


@pytest.mark.parametrize("after_s", [0.2])
def test_a_recorder_killed_after_a_suspension_loses_no_acknowledged_block(
    live: Live, tmp_path: Path, after_s: float
) -> None:
    """The middleware has dropped messages meanwhile, and repeats those of one topic before those of another."""
    kill_and_recover(live, tmp_path, after_s, stopped_s=3.0)


@pytest.mark.slow
@pytest.mark.parametrize("after_s", np.random.default_rng(12).uniform(0.0, 6.0, 20).round(3).tolist())
def test_a_recorder_killed_at_any_instant_after_a_suspension_loses_no_block(
    live: Live, tmp_path: Path, after_s: float
) -> None:
    kill_and_recover(live, tmp_path, after_s, stopped_s=3.0)


@pytest.mark.slow
@pytest.mark.parametrize("after_s", np.random.default_rng(11).uniform(1.0, 4.0, 20).round(3).tolist())
def test_a_recorder_killed_at_any_instant_loses_no_acknowledged_block(
    live: Live, tmp_path: Path, after_s: float
) -> None:
    kill_and_recover(live, tmp_path, after_s)
