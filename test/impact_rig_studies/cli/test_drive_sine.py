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
"""The sine tests of `impact-rig drive`: what they print, write and return."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from impact_rig.cli.main import main
from impact_rig_studies.cli import drive_sine

RATE = "daq: {rate_hz: 2000}\n"
NO_NUMBER = re.compile(r"\b(nan|inf)\b", re.IGNORECASE)


@pytest.fixture
def rig(tmp_path: Path) -> list[str]:
    (tmp_path / "rig.yaml").write_text(RATE)
    return ["--config", str(tmp_path / "rig.yaml")]


def rows_of(directory: Path, test: str) -> list[dict[str, str]]:
    with (directory / f"{test}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.heavy
def test_the_hold_command_keeps_the_base_amplitude(rig, tmp_path, capsys):
    out = tmp_path / "new" / "held"
    words = ["base", "60um", "--frequencies", "9.2", "--gap", "none", "--output", str(out)]
    assert main(["drive", "hold", *words, *rig]) == 0
    (row,) = rows_of(out, "hold")
    assert abs(float(row["error"])) <= 2e-3
    assert float(row["base_amplitude"]) == pytest.approx(60e-6, rel=2e-3)
    printed = capsys.readouterr().out
    assert "base held at 6e-05" in printed
    assert printed.splitlines()[-1] == str(out)
    assert main(["drive", "hold", *words, *rig]) == 1
    assert "nothing is overwritten" in capsys.readouterr().err


@pytest.mark.heavy
def test_the_sweep_command_measures_the_frequencies_in_the_given_direction(rig, tmp_path, capsys):
    out = tmp_path / "sweep"
    words = ["--frequencies", "9.2", "9", "--gap", "none", "--current", "100mA", "--direction", "down", "--json"]
    assert main(["drive", "sweep", *words, "--output", str(out), *rig]) == 0
    rows = rows_of(out, "sweep")
    assert [float(row["frequency"]) for row in rows] == [9.2, 9.0]
    assert all(float(row["current_amplitude"]) == pytest.approx(0.1, rel=0.01) for row in rows)
    printed = json.loads(capsys.readouterr().out)
    assert printed["directory"] == str(out)
    assert {"directory": str(out), **json.loads((out / "sweep.json").read_text())} == printed


def test_an_unwritable_output_is_rejected_before_any_measurement(rig, tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(drive_sine, "operate", lambda *_: pytest.fail("it was measured"))
    words = ["drive", "hold", "base", "60um", "--frequencies", "9.2", "--gap", "none", *rig, "--output"]
    assert main([*words, str(tmp_path / "file" / "held")]) == 1
    assert "cannot write" in capsys.readouterr().err


@pytest.mark.heavy
def test_an_amplitude_that_was_not_reached_is_reported_and_fails_the_command(rig, tmp_path, capsys):
    assert main(["drive", "hold", "base", "1m", "--frequencies", "9", *rig, "--output", str(tmp_path / "run")]) == 1
    assert "9 Hz" in " ".join(capsys.readouterr().out.splitlines()[-3:])


@pytest.mark.ros
@pytest.mark.pipeline
def test_the_hold_command_over_topics_yields_the_same_bits(rig, tmp_path):
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    words = ["base", "60um", "--frequencies", "9.2", "--gap", "none", *rig]
    for way in ("process", "ros"):
        assert main(["drive", "hold", *words, "--through", way, "--output", str(tmp_path / way)]) == 0
    assert (tmp_path / "ros/hold.csv").read_bytes() == (tmp_path / "process/hold.csv").read_bytes()


@pytest.mark.heavy
def test_the_lock_command_finds_the_resonance(rig, tmp_path, capsys):
    out = tmp_path / "lock"
    assert main(["drive", "lock", "--gap", "6mm", "--dwell", "3", "--output", str(out), *rig]) == 0
    assert float(rows_of(out, "lock")[-1]["frequency"]) == pytest.approx(9.065, abs=0.01)
    assert "drift" in capsys.readouterr().out


def test_a_dwell_too_short_for_an_uncertainty_yields_no_result(rig, tmp_path, capsys):
    assert main(["drive", "lock", "--gap", "none", "--dwell", "0.3", *rig, "--output", str(tmp_path / "lock")]) == 1
    printed = capsys.readouterr().out
    assert "too few for a mean with its uncertainty" in " ".join(printed.split())
    assert "--dwell 3 or more" in " ".join(printed.split())
    assert not NO_NUMBER.search(printed.replace(str(tmp_path), ""))


@pytest.mark.heavy
def test_the_backbone_command_locks_at_every_current_up_and_down(rig, tmp_path, capsys):
    out = tmp_path / "backbone"
    words = ["--gap", "10mm", "--currents", "0.3", "0.4", "--output", str(out)]
    assert main(["drive", "backbone", *words, *rig]) == 0
    found = rows_of(out, "backbone")
    assert [row["direction"] for row in found] == ["up", "up", "down"]
    assert all(row["locked"] == "True" for row in found)
    assert "Backbone" in capsys.readouterr().out


@pytest.mark.heavy
def test_commands_of_a_prescribed_base_are_shown_in_metres(tmp_path, capsys):
    (tmp_path / "rig.yaml").write_text(RATE + "drive: {kind: prescribed}\n")
    rig = ["--config", str(tmp_path / "rig.yaml"), "--gap", "none", "--output"]
    assert main(["drive", "sweep", "--frequencies", "9", "--current", "1e-4", *rig, str(tmp_path / "sweep")]) == 0
    assert "Sweep at 0.0001 m" in capsys.readouterr().out
    assert main(["drive", "backbone", "--currents", "5e-5", "1e-4", *rig, str(tmp_path / "backbone")]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"^ +\[m\] +\[Hz\]", shown, re.MULTILINE)
    assert all(re.search(rf"^ *up +{peak} ", shown, re.MULTILINE) for peak in ("5e-05", "0.0001"))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["backbone", "--currents", "0.4", "0.3"], "ascending"),
        (["lock", "--start", "90"], "start_hz (--start) must be > 5"),
        (["hold", "base", "60e-6"], "PEAK, amplitude at which base is held: a length needs a unit"),
        (["hold", "superior", "0mm"], "PEAK, amplitude at which superior is held: must be > 0 m"),
        (["hold", "current", "60um"], "PEAK, amplitude at which current is held: the unit must be one of A, mA"),
    ],
)
def test_invalid_arguments_are_reported_in_one_line(words, message, tmp_path, capsys):
    assert main(["drive", *words, "--output", str(tmp_path / "run")]) == 1
    assert not (tmp_path / "run").exists()
    assert message in capsys.readouterr().err
