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
"""Rig in the test's process: inputs at exact samples, waits in rig time, comparison, and the saved run."""

from __future__ import annotations

import gc
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from impact_rig import topics
from impact_rig.analysis.sine import fit_sine
from impact_rig.blocks import Table
from impact_rig.errors import CommandError, ConfigError, RecordingError
from impact_rig.instruments.section import CHANNELS
from impact_rig.recording import open_run
from impact_rig.runs.verification import verify
from impact_rig.testing import Fault, Golden, LocalRig, NotReachedError, first_difference

LINEAR = {"sphere.present": False}
LASER = 1 << CHANNELS.index("laser")


def test_a_command_acts_at_the_requested_sample() -> None:
    rig = LocalRig(LINEAR)
    assert rig.command(frequency_hz=9.1, current_a=0.52, at_sample=3000) == 3000
    rig.run(0.2)
    current = rig.rows()["current"]
    assert np.abs(current[:3000]).max() < 0.02  # noise of the monitor
    assert np.abs(current[3000:]).max() > 0.1
    assert rig.rows("shaker/applied")["sample"].tolist() == [0, 3000]


@pytest.mark.heavy
def test_a_rejected_block_of_the_stream_is_not_recorded(tmp_path: Path) -> None:
    with LocalRig({**LINEAR, "drive.waveform": "stream"}, record=tmp_path / "run") as rig:
        rig.feed(0, np.full(3000, 0.1))
        for rejected in (np.full(10, np.nan), np.full(10, 1e9), np.zeros(10**6)):
            with pytest.raises(CommandError):
                rig.feed(3000, rejected)
        rig.run(seconds=0.25)
    with open_run(tmp_path / "run") as run:
        blocks = [run.table(one, topics.WAVEFORM) for one in run.messages(["/rig/shaker/waveform"])]
        assert verify(run).identical
    assert [block.rows["value"].tolist() for block in blocks] == [[0.1] * 3000]


@pytest.mark.parametrize("at_sample", [50, 3050])
def test_a_command_off_the_grid_of_instants_is_rejected(at_sample: int) -> None:
    with pytest.raises(CommandError, match=f"no command can act on sample {at_sample}: .* every 100 samples"):
        LocalRig(LINEAR).command(frequency_hz=9.1, at_sample=at_sample)


def test_a_command_in_the_past_is_rejected() -> None:
    rig = LocalRig(LINEAR)
    rig.run(1.0)
    with pytest.raises(ConfigError, match="cannot run to sample 100: rig is at sample 10000, already past it"):
        rig.command(current_a=0.1, at_sample=100)


def test_a_restarted_rig_begins_at_scan_0_and_at_rest() -> None:
    rig = LocalRig({**LINEAR, "drive.amplitude": 0.3}, analysis={"gap_m": None})
    rig.run(0.517)
    rig.command(current_a=0.5)
    rig.run(0.2)
    before = rig.rows()
    rig.reset()
    assert (rig.sample, rig.time_s) == (0, 0.0)
    assert rig.command(current_a=0.4) == 0
    rig.run(0.3)
    scan = rig.tables()[-1]
    assert rig.first_scan(scan) + len(scan.rows) == rig.sample == 3000
    again = rig.rows()[len(before) :]
    assert len(again) == 3000
    assert rig.lost_samples() == []
    assert np.abs(again["laser"][:10]).max() < 1e-4 < np.abs(again["laser"]).max()


def test_planned_and_injected_faults_begin_and_end_at_their_samples() -> None:
    """The numbers are odd on purpose: a fault need not begin with a block."""
    planned = Fault(kind="saturation", channel="laser", start_sample=4003, samples=17, value=1e-6)
    rig = LocalRig({**LINEAR, "drive.amplitude": 0.2}, [planned])
    rig.run(0.1)
    rig.inject(Fault(kind="dropout", channel="current", start_sample=6011, samples=5))
    rig.run(0.9)
    rows = rig.rows()
    assert np.flatnonzero(rows["status"] & LASER).tolist() == list(range(4003, 4020))
    faults = rig.rows("truth/faults")
    assert [(row["sample"], row["active"]) for row in faults] == [(4003, 1), (4020, 0), (6011, 1), (6016, 0)]
    with pytest.raises(CommandError):
        rig.inject(Fault(kind="dropout", channel="current", start_sample=6011))


def test_given_faults_are_added_to_those_of_the_configuration() -> None:
    config = {"instruments.faults.planned": ["dropout channel=base"]}
    rig = LocalRig(config, [Fault(kind="dropout", channel="laser")])
    assert [fault.channel for fault in rig.faults] == ["base", "laser"]


def test_the_pipeline_receives_each_block_before_the_next_and_can_send_commands() -> None:
    rig = LocalRig(LINEAR, [Fault(kind="lost_block", start_sample=2000, samples=150)])
    seen: list[int] = []

    def pipeline(block: Table) -> None:
        assert not block.rows.flags.writeable
        seen.append(block.stamp_ns)
        if len(seen) == 5:
            assert rig.command(current_a=0.1) == 500

    rig.connect(pipeline)
    rig.run(0.3)
    assert len(seen) == 28
    assert rig.lost_samples() == [(2000, 2200)], "whole blocks are lost"


def test_timeouts_count_rig_time_and_report_the_active_faults() -> None:
    rig = LocalRig({**LINEAR, "drive.amplitude": 0.52}, [Fault(kind="dropout", channel="laser", samples=500)])
    moved = rig.wait_until(lambda: np.abs(rig.rows()["laser"][500:]).max(initial=0) > 2e-3, "the structure to move")
    assert 0.05 < moved < 2.0
    with pytest.raises(
        NotReachedError, match=r"timeout after 0.3 s of rig time: waiting for the moon .*so far: dropout on laser"
    ):
        rig.wait_until(lambda: False, "the moon", limit_s=0.3)
    assert rig.time_s == pytest.approx(moved + 0.3)


def test_ideal_instruments_measure_the_closed_form() -> None:
    rig = LocalRig({**LINEAR, "drive.amplitude": 0.3, "drive.frequency_hz": 8.0, "instruments.ideal": True})
    rig.run(8.0)
    rows = rig.rows()[-50_000:]
    laser, base = (fit_sine(rows[name].copy(), rig.rate_hz, 8.0) for name in ("laser", "base"))
    expected = rig.expected_transmissibility(8.0)
    assert laser.amplitude / base.amplitude == pytest.approx(abs(expected), rel=2e-3)
    with pytest.raises(ConfigError, match="without the sphere"):
        LocalRig().expected_transmissibility(8.0)


@pytest.mark.ros
def test_the_recorded_run_is_verified_bit_for_bit(tmp_path: Path) -> None:
    rig = LocalRig({"barriers.gap_m": 0.002, "daq.seed": 7}, [Fault(kind="stuck", channel="base", start_sample=900)])
    rig.command(frequency_hz=9.1, current_a=0.52, at_sample=500)
    rig.run(0.5)
    rig.configure({"barriers.gap_m": 0.004})
    rig.run(0.5)
    rig.save(str(tmp_path / "run"))
    with open_run(tmp_path / "run") as run:
        assert str(verify(run)) == f"identical: {rig.sample} scans re-simulated bit for bit"
        assert run.provenance["seed"] == "7"
    with pytest.raises(RecordingError, match="is not overwritten"):
        rig.save(tmp_path / "run")


@pytest.mark.ros
def test_a_long_test_forgets_the_oldest_data(tmp_path: Path) -> None:
    rig = LocalRig(LINEAR, kept_bytes=50 * 100 * 41)
    rig.command(current_a=0.1)
    rig.run(1.0)
    assert 40 <= len(rig.tables()) <= 50
    assert rig.tables()[-1].stamp_ns == 990_000_000
    assert rig.lost_samples() == [], "forgotten is not lost"
    rig.save(tmp_path / "run")
    with open_run(tmp_path / "run") as run:
        assert str(verify(run)).startswith("identical")


def test_lost_scans_are_counted_when_the_tables_around_them_are_no_longer_kept() -> None:
    lost = [Fault(kind="lost_block", start_sample=start, samples=100) for start in (1000, 9000)]
    rig = LocalRig(LINEAR, lost, kept_bytes=50 * 100 * 41)
    rig.run(1.0)
    assert rig.lost_samples() == [(9000, 9100)]
    assert rig.lost_scans == 200
    rig.clear()
    assert rig.lost_samples() == []
    assert rig.lost_scans == 200
    rig.reset()
    assert rig.lost_scans == 0


@pytest.mark.heavy
@pytest.mark.parametrize("what", ["nothing", "commands", "changes", "faults"])
def test_the_memory_of_a_long_test_is_bounded(what: str) -> None:
    """Compare the memory after 200 and 400 blocks, with changes in every block."""
    rig = LocalRig({**LINEAR, "daq.rate_hz": 1000, "daq.block_scans": 10}, kept_bytes=80_000)

    def run(blocks: int) -> int:
        for number in range(blocks):
            if what == "commands":
                rig.command(9.0 + 0.01 * (number % 10), 0.1)
            elif what == "changes":
                rig.configure({"barriers.gap_m": 0.004 + 0.001 * (number % 2)})
            elif what == "faults":
                rig.inject(Fault(kind="saturation", channel="laser", start_sample=rig.frontier_sample, samples=5))
            rig.step()
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before, after = run(200), run(200)
    finally:
        tracemalloc.stop()
    assert before < 600_000
    assert after - before < 15_000
    assert len(rig.tables("daq/info")) >= 1
    assert len(rig.tables("shaker/applied")) >= 1


@pytest.mark.ros
def test_the_comparison_with_a_golden_run_names_the_first_difference(tmp_path: Path) -> None:
    def measure(**changes: object) -> LocalRig:
        rig = LocalRig({"drive.amplitude": 0.52, "barriers.gap_m": 0.002, **changes})
        rig.run(0.3)
        return rig

    with pytest.raises(AssertionError, match="run pytest once with --rig-update-golden"):
        Golden(tmp_path / "test_x", update=False).run(measure())
    Golden(tmp_path / "test_x", update=True).run(measure())
    golden = Golden(tmp_path / "test_x", update=False)
    golden.run(measure(), topics=("daq/scan", "truth/impacts"))
    other = measure(**{"daq.seed": 2})
    with pytest.raises(
        AssertionError, match=r"daq/scan differs .*: .* in row \d+, counted from 0, of the table at 0\.0\d+ s: .*golden"
    ):
        golden.run(other)
    noise = dict.fromkeys(CHANNELS, 1e3)
    golden.run(other, tolerances=noise)
    with pytest.raises(ConfigError, match=r"a compared table does not have: laserr; it has time, "):
        golden.run(other, tolerances={"laserr": 1.0})
    assert first_difference(other.tables()[:-1], other.tables(), {}) == "29 tables, golden 30"


def _full_disk(*_: object) -> None:
    raise RecordingError("no space left")


def test_a_golden_run_is_kept_if_the_new_one_cannot_be_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = LocalRig({"drive.amplitude": 0.52})
    rig.run(0.1)
    Golden(tmp_path / "test_x", update=True).run(rig)
    kept = {file.name: file.read_bytes() for file in (tmp_path / "test_x/run").iterdir()}
    monkeypatch.setattr(LocalRig, "_new_recording", _full_disk)
    with pytest.raises(RecordingError, match="no space left"):
        Golden(tmp_path / "test_x", update=True).run(rig)
    assert {file.name: file.read_bytes() for file in (tmp_path / "test_x/run").iterdir()} == kept


def test_the_comparison_with_golden_values_names_all_differences(tmp_path: Path) -> None:
    Golden(tmp_path, update=True).values({"dt": 76.3, "impacts": 2.0})
    golden = Golden(tmp_path, update=False)
    golden.values({"dt": 76.30001, "impacts": 2.0}, rel=1e-6)
    with pytest.raises(
        AssertionError, match=r"dt: 80.0, golden 76.3; impacts: missing, golden 2.0; more: 1.0, golden mi"
    ):
        golden.values({"dt": 80.0, "more": 1.0})


def test_a_report_describes_the_rig_and_its_events() -> None:
    rig = LocalRig({"barriers.gap_m": 0.003}, [Fault(kind="lost_block", start_sample=500, samples=100)], name="mine")
    rig.command(frequency_hz=8.5, current_a=0.1, at_sample=1000)
    report = rig.report()
    assert report.startswith("mine: 0.1 s of rig time, 1000 scans at 10000 Hz\n")
    for line in (
        "barriers.gap_m = 0.003",
        "fault: lost_block from sample 500 to sample 600",
        "scans 500 to 599 were not published",
        "drive from scan 1000 on: 8.5 Hz, 0.1 A peak",
    ):
        assert f"    {line}" in report.splitlines()


@pytest.mark.parametrize(
    ("parameters", "fault", "error", "words"),
    [
        ({"barriers.gap_mm": 2}, None, ConfigError, "unknown key 'barriers.gap_mm', did you mean 'barriers.gap_m'"),
        ({}, {"kind": "broken"}, CommandError, "fault kind must be one of"),
        ({}, {"kind": "dropout", "channel": "lazer"}, CommandError, "needs a channel, one of"),
        (
            {},
            {"kind": "dropout", "channel": "laser", "start_sample": -1},
            CommandError,
            "start_sample of the fault dropout must be finite and >= 0",
        ),
    ],
)
def test_invalid_parameters_and_faults_are_rejected(parameters, fault, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        LocalRig(parameters, [Fault(**fault)] if fault else [])
