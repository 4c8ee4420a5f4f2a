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
"""`impact-rig loop` from the command line: what it prints, writes and returns."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from impact_rig.cli.main import main
from impact_rig_studies.cli import loop

RATE = "daq: {rate_hz: 2000}\n"
NO_NUMBER = re.compile(r"\b(nan|inf)\b", re.IGNORECASE)


@pytest.fixture
def rig(tmp_path: Path) -> list[str]:
    (tmp_path / "rig.yaml").write_text(RATE)
    return ["--config", str(tmp_path / "rig.yaml")]


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_hold(rig, tmp_path, capsys):
    out = tmp_path / "held.csv"
    words = ["base", "60um", "--frequencies", "9.2", "--gap", "none", "--output", str(out)]
    assert main(["loop", "hold", *words, *rig]) == 0
    (row,) = rows_of(out)
    assert abs(float(row["error"])) <= 2e-3
    assert float(row["base_amplitude"]) == pytest.approx(60e-6, rel=2e-3)
    assert "base held at 6e-05" in capsys.readouterr().out
    assert main(["loop", "hold", *words, *rig]) == 1
    assert "not overwritten" in capsys.readouterr().err


def test_where_it_shall_be_written_is_looked_at_first(rig, tmp_path, monkeypatch, capsys):
    """In a folder that was not there the rows were lost after the measurement; a file that came meanwhile was lost."""
    words = ["loop", "hold", "base", "60um", "--frequencies", "9.2", "--gap", "none", *rig, "--output"]
    out = tmp_path / "new" / "folder" / "held.csv"
    assert main([*words, str(out)]) == 0
    assert len(rows_of(out)) == 1
    (tmp_path / "file").write_text("")
    with monkeypatch.context() as patched:
        patched.setattr("impact_rig_studies.cli.loop.hold", lambda *_: pytest.fail("it was measured"))
        assert main([*words, str(tmp_path / "file" / "held.csv")]) == 1
    assert "cannot write" in capsys.readouterr().err

    found, late = loop.hold, tmp_path / "late.csv"
    monkeypatch.setattr("impact_rig_studies.cli.loop.hold", lambda *held: late.write_text("mine") and found(*held))
    assert main([*words, str(late)]) == 1
    assert late.read_text() == "mine"


def test_an_amplitude_that_was_not_reached_is_said_and_is_no_success(rig, tmp_path, capsys):
    assert main(["loop", "hold", "base", "1m", "--frequencies", "9", *rig]) == 1
    assert "9 Hz" in capsys.readouterr().out.splitlines()[-1]


@pytest.mark.ros
@pytest.mark.pipeline
def test_hold_over_topics_has_the_same_bits(rig, tmp_path):
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    words = ["base", "60um", "--frequencies", "9.2", "--gap", "none", *rig]
    for way in ("process", "ros"):
        assert main(["loop", "hold", *words, "--through", way, "--output", str(tmp_path / f"{way}.csv")]) == 0
    assert (tmp_path / "ros.csv").read_bytes() == (tmp_path / "process.csv").read_bytes()


def test_lock(rig, tmp_path, capsys):
    out = tmp_path / "lock.csv"
    assert main(["loop", "lock", "--gap", "6mm", "--dwell", "3", "--output", str(out), *rig]) == 0
    assert float(rows_of(out)[-1]["frequency"]) == pytest.approx(9.065, abs=0.01)
    assert "drift" in capsys.readouterr().out


def test_a_dwell_too_short_for_an_uncertainty_has_no_result(rig, capsys):
    assert main(["loop", "lock", "--gap", "none", "--dwell", "0.3", *rig]) == 1
    told = capsys.readouterr().out
    assert "too few for a mean with its uncertainty" in " ".join(told.split())
    assert "--dwell 3 or more" in " ".join(told.split())
    assert not NO_NUMBER.search(told)


def test_backbone(rig, tmp_path, capsys):
    out = tmp_path / "backbone.csv"
    words = ["--gap", "10mm", "--currents", "0.3", "0.4", "--output", str(out)]
    assert main(["loop", "backbone", *words, *rig]) == 0
    found = rows_of(out)
    assert [row["direction"] for row in found] == ["up", "up", "down"]
    assert all(row["locked"] == "True" for row in found)
    assert "Backbone" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["backbone", "--currents", "0.4", "0.3"], "ascending"),
        (["lock", "--start", "90"], "start_hz must be within"),
        (["hold", "base", "60e-6"], "target of base: a length needs its unit"),
        (["hold", "superior", "0mm"], "target of superior: must be > 0 m"),
        (["hold", "current", "60um"], "target of current: its unit must be one of A, mA"),
    ],
)
def test_nonsense_is_one_line(words, message, capsys):
    assert main(["loop", *words]) == 1
    assert message in capsys.readouterr().err
