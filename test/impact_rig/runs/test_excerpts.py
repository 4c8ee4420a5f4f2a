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
"""`impact-rig analyze RUN --frf` and `--sine`: measurements of a recorded run as one record."""

from __future__ import annotations

import json
import re
from pathlib import Path

import attrs
import numpy as np
import pytest
from kits.recorded_rig import SLOW_RIG, record, scanned

from impact_rig.blocks import Table
from impact_rig.cli import main
from impact_rig.errors import RecordingError
from impact_rig.physics.linear_response import transmissibility
from impact_rig.recording import open_run
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.runs import excerpts, reanalysis
from impact_rig.runs.excerpts import last_excerpt
from impact_rig.testing import LocalRig

pytestmark = pytest.mark.ros  # runs carry the schemas of the messages


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Noise from 6 to 12 Hz for 100 s, without the sphere."""
    noise = {
        "drive.waveform": "random",
        "drive.amplitude": 0.3,
        "drive.random_low_hz": 6.0,
        "drive.random_high_hz": 12.0,
    }
    rig = LocalRig({**SLOW_RIG, **noise})
    rig.run(seconds=100.0)
    return record(tmp_path_factory.mktemp("swept") / "swept", scanned(rig))


@pytest.fixture(scope="module")
def steady(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Settled measurement at 9.3 Hz."""
    rig = LocalRig(SLOW_RIG)
    rig.command(frequency_hz=9.3, current_a=0.3)
    rig.run(seconds=13.0)
    return record(tmp_path_factory.mktemp("steady") / "steady", scanned(rig))


def test_a_frequency_response_is_the_closed_form_within_its_uncertainty(swept: Path) -> None:
    with open_run(swept) as run:
        found = excerpts.response_of(run, 20.0)
    frequency = found.frequency_hz[found.excited]
    far = (frequency > 6.5) & (frequency < 11.5)
    assert np.count_nonzero(far) > 90
    truth = np.array([abs(transmissibility(from_flat(RigConfig(), SLOW_RIG), f)) for f in frequency[far]])
    off = np.abs(found.h1[found.excited][far]) / truth - 1.0
    assert np.mean(np.abs(off) < 2.0 * found.u_relative[found.excited][far] + 0.01) > 0.9


def test_the_command_prints_and_draws_a_frequency_response(
    swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn = ["--figures", str(tmp_path / "new"), "--format", "png"]
    assert main(["analyze", str(swept), "--frf", "--segment", "20", *drawn]) == 0
    printed = capsys.readouterr().out
    assert "coherence" in printed
    peak = float(re.search(r"largest at ([0-9.]+) Hz", printed)[1])  # type: ignore[index]  # it is there
    assert peak == pytest.approx(9.1, abs=0.06)
    assert f"wrote {tmp_path}/new/frf.png\n" in printed
    assert (tmp_path / "new" / "frf.png").read_bytes().startswith(b"\x89PNG")
    assert "the true peak may be" in printed.replace("\n", " "), "20 s cannot resolve a width of 0.08 Hz"
    assert main(["analyze", str(swept), "--frf", *drawn]) == 1
    assert "frf.png exists already and is not overwritten" in capsys.readouterr().err


def test_the_window_of_a_frequency_response_can_be_chosen(swept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A window with wide lines resolves less, and the result states this."""
    bias = []
    for window in ("hann", "flattop"):
        assert main(["analyze", str(swept), "--frf", "--segment", "40", "--window", window, "--json"]) == 0
        printed = json.loads(capsys.readouterr().out)
        assert (printed["window"], printed["segment_s"]) == (window, pytest.approx(40.0))
        bias.append(printed["peak_bias"])
    assert bias[1] is None or bias[1] > 2.0 * bias[0]


def test_a_sine_yields_one_line_and_is_reported_as_a_sine(steady: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", str(steady), "--frf", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["sine"]
    (line,) = printed["lines"]
    assert line["frequency_hz"] == pytest.approx(9.3, abs=0.1)
    assert main(["analyze", str(steady), "--frf"]) == 0
    assert "the drive is a sine of about 9.2" in capsys.readouterr().out.replace("\n", " ")


@pytest.mark.parametrize(
    ("segment", "words"),
    [
        ("nan", "--segment must be a finite number of seconds > 0, got nan"),
        ("-1", "--segment must be a finite number of seconds > 0, got -1"),
        ("200", "segment must be 8 to 100000 samples (0.008 to 100 s), got 200000 (200 s)"),
        ("1e-3", "segment must be 8 to 100000 samples (0.008 to 100 s), got 1 (0.001 s)"),
    ],
)
def test_an_impossible_segment_length_is_rejected(
    swept: Path, segment: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["analyze", str(swept), "--frf", "--segment", segment]) == 1
    assert words in capsys.readouterr().err.replace("\n", " ")


@pytest.mark.parametrize("option", [["--segment", "20"], ["--window", "hann"], ["--damping", "0.01"]])
def test_an_option_of_the_frequency_response_is_rejected_without_it(
    swept: Path, option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["analyze", str(swept), *option]) == 1
    assert f"{option[0]} has an effect only with --frf" in capsys.readouterr().err.replace("\n", " ")


def test_a_rig_at_rest_has_no_frequency_response(tmp_path: Path) -> None:
    rig = LocalRig({**SLOW_RIG, "daq.block_scans": 1000})
    rig.run(seconds=40.0)
    with (
        open_run(record(tmp_path / "rest", scanned(rig))) as run,
        pytest.raises(RecordingError, match="the coherence of base and laser is below"),
    ):
        excerpts.response_of(run, 1.0)


def test_sines_agree_with_the_measurement_of_the_same_scans(steady: Path) -> None:
    with open_run(steady) as run:
        findings = list(reanalysis.analyze(run))
        found = excerpts.sines_of(run, last_excerpt(run, findings))
        rows = reanalysis.rows(reanalysis.measurements(iter(findings)))
    row = rows[rows["settled"] == 1.0][-1]
    assert found.reference.frequency_hz == pytest.approx(9.3, abs=4 * found.reference.u_frequency_hz)
    assert found.measured.transmissibility == pytest.approx(row["transmissibility"], rel=1e-4), "other cycles"
    assert found.fits["base"].amplitude == pytest.approx(row["base_amplitude"], rel=1e-4)
    assert found.fits["current"].amplitude == pytest.approx(row["current_amplitude"], rel=1e-4)
    truth = abs(transmissibility(from_flat(RigConfig(), SLOW_RIG), 9.3))
    ratio = found.fits["laser"].amplitude / found.fits["base"].amplitude
    assert ratio == pytest.approx(truth, rel=0.01), "lag and skew are not corrected: 0.1 % at 9.3 Hz"


def test_the_command_prints_and_draws_sines(
    steady: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    assert main(["analyze", str(steady), "--sine", "--figures", str(tmp_path), "--format", "svg"]) == 0
    printed = capsys.readouterr().out
    assert "of the last settled measurement" in printed
    for channel in ("accelerometer", "laser", "base", "current"):
        assert channel in printed
    assert "<svg" in (tmp_path / "sine.svg").read_text(encoding="utf-8")


@pytest.mark.parametrize(("channels", "missing"), [(["current", "base"], "laser"), (["current"], "laser and base")])
def test_a_run_without_laser_and_base_has_no_dt(
    steady: Path, channels: list[str], missing: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def with_only(table: Table) -> Table:
        rows = np.zeros(len(table.rows), [("time", "f8"), ("status", "u1"), *((name, "f8") for name in channels)])
        for name in set(rows.dtype.names or ()) & set(table.rows.dtype.names or ()):
            rows[name] = table.rows[name]
        return attrs.evolve(table, rows=rows)

    with open_run(steady) as run:
        scans, drive = run.tables("daq/scan"), run.tables("shaker/applied")
        info = next(run.tables("daq/info"))
        rows = info.rows[: len(channels)].copy()
        rows["name"] = [name.encode() for name in channels]
        messages = [
            ("daq/info", attrs.evolve(info, rows=rows)),
            *(("shaker/applied", table) for table in drive),
            *(("daq/scan", with_only(table)) for table in scans),
        ]
    directory = record(tmp_path / "run", messages)
    assert main(["analyze", str(directory), "--sine"]) == 0
    assert f"but the run has no {missing}; record" in " ".join(capsys.readouterr().out.split())


def test_a_run_without_a_drive_has_no_sines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = LocalRig(SLOW_RIG)
    rig.run(seconds=2.0)
    messages = [one for one in scanned(rig) if one[0] != "shaker/applied"]
    assert main(["analyze", str(record(tmp_path / "still", messages)), "--sine"]) == 1
    assert "shaker/applied" in capsys.readouterr().err
