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
"""A rig driver does the same in this process and over topics: the same calls give the same samples."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from impact_rig.driver import Hardware, LocalRig, RigDriver
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.recording import open_run
from impact_rig.runs.verification import verify

LINEAR = {"sphere.present": False, "daq.rate_hz": 2000, "daq.block_scans": 100}
STREAM = {**LINEAR, "drive.waveform": "stream", "drive.stream_rate_hz": 2000}
LOST = Fault(kind="lost_block", start_sample=500, samples=50)
Start = Callable[..., RigDriver]


@pytest.fixture(params=["local", pytest.param("ros", marks=pytest.mark.ros)])
def start(request: pytest.FixtureRequest) -> Iterator[Start]:
    """Return a function that starts a rig, in this process or over topics."""
    started: list[RigDriver] = []

    def begin(*args: Any, **kwargs: Any) -> RigDriver:
        if request.param == "ros":
            pytest.importorskip("rclpy", reason="no ROS 2 here")
            from impact_rig.driver import RosRig

            started.append(RosRig(*args, hosted=True, **kwargs))
        else:
            started.append(LocalRig(*args, **kwargs))
        return started[-1]

    yield begin
    for rig in started:
        rig.close()


def test_commands_changes_and_faults_act_at_the_same_samples_with_every_driver(start: Start) -> None:
    rig, twin = start(LINEAR, [LOST]), LocalRig(LINEAR, [LOST])
    for one in (rig, twin):
        assert one.command(frequency_hz=9.1, current_a=0.4, at_sample=200) == 200
        one.run(seconds=0.3)
        assert one.configure({"instruments.laser.noise_m_rms": 2e-6}).instruments.laser.noise_m_rms == 2e-6
        one.inject(Fault(kind="dropout", channel="current", start_sample=1003, samples=7))
        one.run_to_sample(1400)
    assert (rig.sample, rig.now_ns, rig.time_s) == (1400, 700_000_000, 0.7)
    assert rig.rows().tobytes() == twin.rows().tobytes()
    assert set(rig.rows("shaker/applied")["sample"]) == {0, 200}
    assert rig.lost_samples() == [(500, 600)]
    assert rig.lost_scans == 100
    assert rig.faults == twin.faults
    assert rig.report() == twin.report()


def test_scans_that_were_read_can_be_discarded(start: Start) -> None:
    rig = start(LINEAR, [LOST])
    for _ in range(7):
        rig.step()
        assert len(rig.rows()) in (0, 100)
        rig.clear()
    assert rig.tables() == []
    assert rig.lost_scans == 100, "forgotten is not lost, and lost is not forgotten"
    assert len(rig.rows("daq/info")) == 4


def test_a_rejected_request_changes_nothing(start: Start) -> None:
    rig = start(LINEAR)
    with pytest.raises(CommandError, match="current must be >= 0"):
        rig.command(current_a=99.0)
    for at_sample in (None, 200):
        with pytest.raises(CommandError, match="a command needs a frequency, a current, or both"):
            rig.command(at_sample=at_sample)
    with pytest.raises(ConfigError, match=r"barriers\.gap_m"):
        rig.configure({"barriers.gap_m": -1.0})
    rig.step(2)
    assert rig.rows("shaker/applied")["current"].tolist() == [0.0]


def test_a_trip_is_reported_with_its_figures(start: Start) -> None:
    rig = start({**LINEAR, "shaker.travel_limit_m": 1e-5})
    assert rig.stopped == ""
    rig.command(frequency_hz=9.1, current_a=0.5)
    rig.run(seconds=0.2)
    assert rig.stopped.startswith("the rig tripped: over_travel: ")
    assert rig.stopped.endswith("limit 0.01 mm")


def test_a_stream_is_played_and_recorded_and_ends_with_its_samples(start: Start) -> None:
    wave = 0.3 * np.sin(2.0 * np.pi * 9.0 * np.arange(1500) / 2000)
    found = Hardware(start({**STREAM, "time.mode": "free_running", "time.peers": ["client"]})).respond(wave)
    twin = Hardware(LocalRig(STREAM)).respond(wave)
    assert found["current"].tobytes() == twin["current"].tobytes()
    assert np.abs(found["current"][:1500]).max() > 0.25


@pytest.mark.heavy
def test_every_driver_provides_analysis_and_recording(start: Start, tmp_path: Path) -> None:
    rig = start({**LINEAR, "drive.amplitude": 0.4}, analysis={"gap_m": 0.0}, record=tmp_path / "run")
    rig.run(seconds=12.0)
    rows = rig.rows("transmissibility/table")
    rig.close()
    assert rows["gap"].tolist() == [0.0] * len(rows)
    assert rows["settled"][-1] == 1.0
    with LocalRig({**LINEAR, "drive.amplitude": 0.4}, analysis={"gap_m": 0.0}) as twin:
        twin.run(seconds=12.0)
    assert rows.tobytes() == twin.rows("transmissibility/table")[: len(rows)].tobytes()
    with open_run(tmp_path / "run") as run:
        assert verify(run).identical


def test_the_truth_of_every_scan_is_available_on_request(start: Start) -> None:
    rig = start(LINEAR, also=["truth/scan"])
    rig.configure({"output.truth_scan": True})
    rig.step()
    rig.clear()
    rig.step(3)
    assert len(rig.newest("truth/scan", 300)) == 300
    assert len(rig.newest("truth/scan", 0)) == 0


def test_a_topic_that_is_not_kept_is_rejected_with_a_list_of_those_that_are(start: Start) -> None:
    rig = start(LINEAR)
    for read in (rig.tables, rig.rows):
        with pytest.raises(ConfigError, match=r"'daq/scans' is not kept, .* no topic of a rig, did you mean 'daq/s"):
            rig.tables("daq/scans")
        with pytest.raises(ConfigError, match=r"'truth/scan' is not kept, only daq/info, daq/scan, .*`also`"):
            read("truth/scan")


@pytest.mark.parametrize("topic", ["rig/journal", "rig/configuration"])
def test_a_topic_without_tables_is_rejected(start: Start, topic: str) -> None:
    rig = start(LINEAR, also=["rig/configuration"])
    for read in (rig.tables, rig.rows):
        with pytest.raises(ConfigError, match=rf"^topic '{topic}' carries no tables: `journal` returns the journal"):
            read(topic)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"analysis": {"window": 8}}, "unknown setting 'window' of the analysis, did you mean 'windows'?"),
        ({"analysis": {"xyz": 8}}, "unknown setting 'xyz' of the analysis: the settings are"),
    ],
)
def test_an_unknown_setting_is_rejected(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}"):
        LocalRig(**given)


def test_an_unknown_topic_is_rejected(start: Start) -> None:
    words = r"^unknown topic 'truth/scans' in the argument `also`, did you mean 'truth/scan'\?$"
    with pytest.raises(ConfigError, match=words):
        start(also=["truth/scans"])
