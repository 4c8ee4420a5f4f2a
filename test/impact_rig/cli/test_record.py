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
"""`impact-rig record`: one run that can be verified, with its DT and budget, however the command ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from kits.browser import PATIENCE_S

from impact_rig.analysis.uncertainty_budget import plus_minus
from impact_rig.cli.main import main
from impact_rig.driver import LocalRig
from impact_rig.errors import SimulationError
from impact_rig.recording import open_run
from impact_rig.runs import info, reanalysis
from impact_rig.runs.verification import verify

pytestmark = pytest.mark.heavy

PROGRAM = [sys.executable, "-c", "from impact_rig.cli import main; raise SystemExit(main())"]
RATE = ("--scan-rate", "2000")


def check(directory: Path) -> None:
    """Re-simulate a run and analyse it again: both agree with the recording."""
    with open_run(directory) as run:
        assert verify(run).identical
        found = reanalysis.measurements(reanalysis.analyze(run))
        assert reanalysis.compare(run, found).same is not False


def test_a_recorded_run_reports_its_dt_and_its_budget(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--frequency", "9.1Hz", "--current", "520mA", "--gap", "6mm", "--seconds", "25", "--seed", "3", *RATE]
    assert main(["record", *words, "--output", str(tmp_path / "run")]) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines()[-1] == str(tmp_path / "run")
    assert "(2u) at 9.1 Hz, gap 6 mm, periodic" in printed.out
    assert "combined" in printed.out
    assert "seconds 25 of 25: gap 6 mm, DT 6" in printed.err
    check(tmp_path / "run")
    assert main(["record", *words, "--output", str(tmp_path / "again"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["directory"] == str(tmp_path / "again")
    assert found["transmissibility"] == pytest.approx(63.6, rel=0.02)
    assert 0.0 < found["u_transmissibility"] < 0.02 * found["transmissibility"]
    squares = sum(part["u_relative"] ** 2 for part in found["budget"])
    assert squares == pytest.approx((found["u_transmissibility"] / found["transmissibility"]) ** 2, rel=1e-6)
    assert f"DT {plus_minus(found['transmissibility'], found['u_transmissibility'])} (2u)" in printed.out, (
        "the same seed gives the same run"
    )


def test_a_run_that_is_too_short_for_a_measurement_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["record", "--seconds", "2", *RATE, "--gap", "none", "--output", str(tmp_path / "run"), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["transmissibility"] is None
    assert "2 s are too short for one measurement" in found["missing"]
    check(tmp_path / "run")


def test_a_rig_at_rest_has_no_dt_however_long_it_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--current", "0", "--seconds", "10", *RATE, "--output", str(tmp_path / "run")]
    assert main(["record", *words]) == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "silence; silence: Neither base nor structure moves measurably." in printed
    assert "longer" not in printed


def test_a_trip_ends_the_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["record", "--current", "12", *RATE, "--output", str(tmp_path / "run")]) == 1
    assert "ended early: the rig tripped: over_travel" in " ".join(capsys.readouterr().out.split())
    check(tmp_path / "run")


def test_a_run_whose_rig_cannot_continue_is_named_with_the_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail_after_a_second(rig: LocalRig, *_: object, **__: object) -> None:
        if rig.time_s > 1.0:
            raise SimulationError("no progress in a drive segment")
        step(rig)

    step = LocalRig.step
    monkeypatch.setattr(LocalRig, "step", fail_after_a_second)
    assert main(["record", *RATE, "--output", str(tmp_path / "run")]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    *_, where, why = printed.err.splitlines()
    assert where == f"incomplete recording: {tmp_path / 'run'}"
    assert why == "impact-rig record: no progress in a drive segment"
    check(tmp_path / "run")


def test_a_file_is_no_directory_for_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run").write_text("mine")
    assert main(["record", "--seconds", "1", "--output", str(tmp_path / "run")]) == 1
    assert "run is a file, not a directory: choose another --output" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "run").read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--current", "30"), "current must be >= 0 and <= 21.21 A peak"),
        (("--config", "stream.yaml"), "drive.waveform must be sine"),
        (("--namespace", "/rig"), "--namespace selects a running rig"),
        (("--through", "running", "--gap", "6mm"), "--gap applies only to a rig"),
        (("--through", "running", "--seed", "2"), "--seed applies only to a rig"),
    ],
)
def test_an_impossible_recording_is_rejected_before_any_file_is_created(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], says: str
) -> None:
    (tmp_path / "stream.yaml").write_text("{drive: {waveform: stream}}")
    words = tuple(str(tmp_path / word) if word.endswith(".yaml") else word for word in words)
    assert main(["record", *words, "--output", str(tmp_path / "run")]) == 1
    assert says in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_an_existing_run_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "own.txt").write_text("mine")
    assert main(["record", "--seconds", "1", "--output", str(tmp_path / "run")]) == 1
    assert "nothing is overwritten" in capsys.readouterr().err


def test_ctrl_c_leaves_a_readable_run(tmp_path: Path) -> None:
    words = ["record", "--seconds", "100000", "--output", str(tmp_path / "run")]
    with subprocess.Popen([*PROGRAM, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert "seconds 0 of" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        printed, _ = process.communicate(timeout=120)
    assert process.returncode == 128 + signal.SIGINT
    assert printed.splitlines()[-1] == str(tmp_path / "run")
    assert "ended early: interrupted" in printed
    assert info(tmp_path / "run").intact
    check(tmp_path / "run")


@pytest.mark.ros
def test_a_run_over_topics_has_the_same_measurement(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    words = ["record", "--gap", "none", "--seconds", "25", *RATE, "--json"]
    found = []
    for way in ("process", "ros"):
        assert main([*words, "--through", way, "--output", str(tmp_path / way)]) == 0
        found.append(json.loads(capsys.readouterr().out))
        check(tmp_path / way)
    process, ros = found
    assert ros["transmissibility"] == pytest.approx(process["transmissibility"], abs=2 * process["u_transmissibility"])
    assert [part["what"] for part in ros["budget"]] == [part["what"] for part in process["budget"]]


@pytest.mark.ros
@pytest.mark.parametrize("seconds", ["2", "100000"], ids=["complete", "interrupted"])
def test_the_current_of_a_running_rig_is_0_again_however_its_recording_ends(tmp_path: Path, seconds: str) -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client import Client, Processes, isolated_domain  # needs ROS 2

    words = ["record", "--through", "running", "--namespace", "/", "--current", "0.3", "--seconds", seconds]
    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs") as processes:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain_id)}
        processes.start("rig")
        with Client(domain_id) as client:
            client.wait_active("rig")
            applied = client.collect("shaker/applied")

            def currents() -> list[float]:
                return [float(row["current"]) for table in applied.tables() for row in table.rows]

            with subprocess.Popen(
                [*PROGRAM, *words, "--output", str(tmp_path / "run")], env=environment, stderr=subprocess.PIPE
            ) as recording:
                client.wait_until(lambda: 0.3 in currents(), "the current", PATIENCE_S)
                if seconds != "2":
                    recording.send_signal(signal.SIGINT)
                _, errors = recording.communicate(timeout=PATIENCE_S)
            client.wait_until(lambda: currents()[-1] == 0.0, f"current 0 after {errors!r}", PATIENCE_S)
