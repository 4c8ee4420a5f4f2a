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
"""`kill -9` of the recorder while it records 50 kS/s: all it has acknowledged is given back, bit for bit."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from impact_rig.client import Client, Collector, Processes, isolated_domain
from impact_rig.nodes.messages import nanoseconds
from impact_rig.recording import open_run
from impact_rig.runs import recover

pytestmark = [pytest.mark.ros, pytest.mark.pipeline, pytest.mark.timeout(300)]
RATE_HZ = 50_000
Live = tuple[Client, Processes, Collector]


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    """A rig in real time, and everything it publishes on daq/scan."""
    directory = tmp_path_factory.mktemp("killed")
    with isolated_domain() as domain_id, Processes(domain_id, directory / "logs") as processes:
        processes.start("rig", {"daq.rate_hz": RATE_HZ, "daq.block_scans": RATE_HZ // 100, "drive.amplitude": 0.52})
        with Client(domain_id, processes=processes) as client:
            client.wait_active("rig")
            yield client, processes, client.collect("daq/scan")


def kill_and_recover(live: Live, directory: Path, after_s: float) -> None:
    client, processes, scans = live
    scans.clear()
    recorder = processes.start("recorder", {"directory": str(directory), "name": "run"})
    client.wait_until((directory / "run" / "run.mcap").exists, "the recorder", 60.0)
    acks = client.listen("daq/ack")
    client.spin_for(after_s)
    client.wait_until(lambda: len(acks) > 50, "acknowledgements")
    recorder.signal(signal.SIGKILL)
    processes.stop("recorder")
    client.spin_for(0.1)
    published = {table.stamp_ns: table.rows.tobytes() for table in scans.tables()}

    recover(directory / "run", directory / "out")
    with open_run(directory / "out") as run:
        kept = [(table.stamp_ns, table.rows.tobytes()) for table in run.tables("daq/scan")]
    stamps = [stamp for stamp, _ in kept]
    assert set(np.diff(stamps)) <= {10_000_000}
    assert [published[stamp] for stamp in stamps] == [rows for _, rows in kept]
    acknowledged = {nanoseconds(header.stamp) for header in acks.messages}
    assert acknowledged <= set(stamps)


@pytest.mark.parametrize("after_s", [1.17])
def test_a_killed_recorder_loses_nothing_it_has_acknowledged(live: Live, tmp_path: Path, after_s: float) -> None:
    kill_and_recover(live, tmp_path, after_s)


@pytest.mark.slow
@pytest.mark.parametrize("after_s", np.random.default_rng(11).uniform(1.0, 4.0, 20).round(3).tolist())
def test_a_killed_recorder_loses_nothing_it_has_acknowledged_at_any_instant(
    live: Live, tmp_path: Path, after_s: float
) -> None:
    kill_and_recover(live, tmp_path, after_s)
