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
"""`impact-rig analyze RUN --figures DIR`: the figures of a run, and their labels."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import attrs
import numpy as np
import pytest
from kits.recorded_rig import Messages, record

from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.cli import main
from impact_rig.errors import RecordingError
from impact_rig.instruments.section import SCAN
from impact_rig.recording import open_run
from impact_rig.runs import drawings, reanalysis
from impact_rig.runs.excerpts import Excerpt, last_excerpt
from impact_rig.testing import LocalRig

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.ros  # runs carry the schemas of the messages

POINT_S = 13.0
"""Rig time at each point of the sweep: enough for a settled measurement and not for two."""
TOPICS = ("daq/info", "shaker/applied", "daq/scan")
CLI = [sys.executable, "-c", "import sys; from impact_rig.cli import main; sys.exit(main())"]


@pytest.fixture(scope="module")
def measured() -> Messages:
    """Two points of a sweep with the sphere, with a settled measurement each."""
    rig = LocalRig({"barriers.gap_m": 0.006, "daq.rate_hz": 5000, "daq.block_scans": 50})
    for frequency_hz in (9.0, 9.1):
        rig.command(frequency_hz=frequency_hz, current_a=0.52)
        rig.run(seconds=POINT_S)
    found = [(topic, table) for topic in TOPICS for table in rig.tables(topic)]
    return sorted(found, key=lambda one: one[1].stamp_ns)


@pytest.fixture(scope="module")
def run(measured: Messages, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("figures") / "swept", measured)


def excerpt_of(path: Path) -> Excerpt:
    with open_run(path) as opened:
        return last_excerpt(opened, list(reanalysis.analyze(opened)))


Drawn = tuple[Path, subprocess.CompletedProcess[str]]
"""Folder of the figures, and the ended process that drew them."""


@pytest.fixture(scope="module")
def drawn(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    where = tmp_path_factory.mktemp("drawn") / "new" / "figures"
    command = [*CLI, "analyze", str(run), "--figures", str(where)]
    return where, subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_command_line_draws_and_names_what_it_wrote(drawn: Drawn) -> None:
    where, done = drawn
    assert done.returncode == 0, done.stderr
    assert "of the last settled measurement" in done.stdout
    assert "nothing to compare with" in done.stdout
    wanted = [where / f"{name}.{kind}" for name in drawings.NAMES for kind in ("png", "svg", "pdf")]
    assert sorted(where.iterdir()) == sorted(wanted)
    assert all(f"wrote {file}\n" in done.stdout for file in wanted)
    for file in where.glob("*.png"):
        header = file.read_bytes()[:24]
        assert header.startswith(b"\x89PNG")
        assert int.from_bytes(header[16:20]) > 1000, "pixels wide"


def test_the_curve_of_a_run_is_printable_and_reproducible(run: Path, drawn: Drawn, tmp_path: Path) -> None:
    """Axes have quantities and units, the legend has gap, current and ± 2u, and no file has a date."""
    first, _ = drawn
    assert main(["analyze", str(run), "--figures", str(tmp_path / "again")]) == 0
    for again in (tmp_path / "again").iterdir():
        assert again.read_bytes() == (first / again.name).read_bytes(), again.name
    texts = " ".join(ET.fromstring((first / "curves.svg").read_bytes()).itertext())
    assert "frequency (Hz)" in texts
    assert re.search(r"gap unknown, 0\.\d+ (to 0\.\d+ )?A, ± 2u", texts)


def test_figures_have_the_requested_format_and_overwrite_no_file(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["analyze", str(run), "--figures", str(tmp_path), "--format", "svg"]
    assert main(command) == 0
    assert "<svg" in (tmp_path / "spectrum.svg").read_text(encoding="utf-8")
    assert main(command) == 1
    assert f"{tmp_path}/time_traces.svg exists already and is not overwritten" in capsys.readouterr().err


@pytest.mark.parametrize("where", ["/proc/figures", "/proc"], ids=["not made", "not written to"])
def test_an_unwritable_directory_is_an_error(where: str, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", str(run), "--figures", where]) == 1
    assert f"impact-rig analyze: cannot write figures to {where}: " in capsys.readouterr().err


def test_the_drawn_excerpt_is_that_of_the_last_settled_measurement(run: Path) -> None:
    with open_run(run) as opened:
        rows = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(opened)))
    last = rows[rows["settled"] == 1.0][-1]
    excerpt = excerpt_of(run)
    assert excerpt.settled
    assert excerpt.drive_hz == pytest.approx(9.1, abs=1e-3)
    assert len(excerpt.rows) == pytest.approx(last["cycles"] / excerpt.drive_hz * excerpt.rate_hz, abs=2)
    assert np.allclose(np.diff(excerpt.rows["time"]), 1.0 / excerpt.rate_hz)
    assert excerpt.rows["time"][0] > POINT_S, "after the second command"
    # an impact at either end may be counted with the cycle before or after
    assert len(excerpt.impact_times) == pytest.approx(last["impacts_per_cycle"] * last["cycles"], abs=2)
    tail = excerpt.newest(4)
    assert len(tail.rows) == round(4 / excerpt.drive_hz * excerpt.rate_hz)
    assert np.all(tail.impact_times >= tail.rows["time"][0])


def test_the_drawn_excerpt_is_the_end_of_the_run_if_no_measurement_settled(measured: Messages, tmp_path: Path) -> None:
    scans = [one for one in measured if one[0] == "daq/scan"][:400]
    kept = [one for one in measured if one[0] != "daq/scan"] + scans[:100] + scans[150:]
    excerpt = excerpt_of(record(tmp_path / "gap", kept))
    assert not excerpt.settled
    assert excerpt.rows["time"][[0, -1]] == pytest.approx([1.5, 4.0], abs=1e-3)
    short = record(tmp_path / "short", kept[:-300])
    assert main(["analyze", str(short), "--figures", str(tmp_path), "--format", "png"]) == 0
    few = record(tmp_path / "few", [one for one in kept if one[0] != "daq/scan"] + scans[:10] + scans[20:21])
    assert len(excerpt_of(few).rows) == 50
    none = record(tmp_path / "none", [(name, attrs.evolve(table, rows=np.empty(0, SCAN))) for name, table in scans[:1]])
    assert main(["analyze", str(none), "--figures", str(tmp_path)]) == 1


def test_data_before_a_reset_are_not_mixed_with_later_data(measured: Messages, tmp_path: Path) -> None:
    """The same four seconds twice: rig time goes back, and the data before the reset are not mixed in."""
    four = [one for one in measured if one[1].stamp_ns < 4_000_000_000]
    excerpt = excerpt_of(record(tmp_path / "reset", [*four, *four[:200]]))
    assert excerpt.rows["time"][0] == 0.0
    assert len(excerpt.rows) == len(np.unique(excerpt.rows["time"])) < 200 * 50


def test_each_gap_and_direction_with_two_frequencies_has_a_curve() -> None:
    rows = np.zeros(9, TRANSMISSIBILITY)
    rows["settled"] = 1.0
    rows["frequency"] = (8.0, 9.0, 9.0, 10.0, 9.0, 8.0, 9.1, 7.0, 8.0)
    rows["gap"] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.002, np.nan, np.nan)
    curves = drawings.measured_curves(rows)
    assert {label: found["frequency"].tolist() for label, found in curves.items()} == {
        "no sphere, up": [8.0, 9.0, 9.0, 10.0],
        "no sphere, down": [9.0, 8.0],
        "gap unknown": [7.0, 8.0],
    }
    repeated = rows[:3].copy()
    repeated["frequency"], repeated["frequency_deviation"] = 9.1, (2e-6, -1e-6, 3e-6)
    assert drawings.measured_curves(repeated) == {}, "what is measured again at one frequency is no sweep"
    rows["settled"] = 0.0
    assert drawings.measured_curves(rows) == {}


def test_figures_are_not_written_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "figures").symlink_to("elsewhere")
    with pytest.raises(RecordingError, match="it is a link; links are not followed for writing"):
        drawings.prepare(tmp_path / "figures", ["png"])
    assert not list((tmp_path / "elsewhere").iterdir())
