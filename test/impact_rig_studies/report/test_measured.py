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
"""The report of an imported measurement, or of a run, contains the measured results and nothing else."""

from __future__ import annotations

import json
import re

import pytest
from kits.hostile_names import hostile_campaign

from impact_rig.analysis.uncertainty_budget import COVERAGE, plus_minus
from impact_rig.cli import main
from impact_rig_studies.campaign import paper, run
from impact_rig_studies.measured import _plain

pytestmark = pytest.mark.heavy


def text_of(page):
    text = re.sub(r"<(svg|style)\b.*?</\1>", "", page.read_text(), flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", " ", text).split())


def test_the_report_of_an_imported_campaign_omits_paper_and_nominal_rig(tmp_path):
    directory = hostile_campaign(tmp_path / "campaign", "My rig, May 2026", ["one"])
    info = run.open_finished(directory).info.copy()
    info["rate"] = 2048.0
    info["bandwidth"][info["name"] == b"base"] = 0.0  # of daq/info: not known
    (directory / run.CALIBRATION_FILE).write_text(json.dumps([_plain(row) for row in info]))
    assert main(["report", str(directory), "--format", "svg"]) == 0
    text = text_of(directory / "report.html")
    assert text.startswith("My rig, May 2026")
    for words in ("2048 scans/s", "Amplitude of the base 200 µm", "Amplitude of the structure 1 mm", "k = 2"):
        assert words in text
    assert "unknown" in text, "the bandwidth of a channel that states none"
    assert " 0 Hz" not in text
    for foreign in (
        paper.TITLE,
        "DOI",
        "Seed",
        "virtual",
        "simulated",
        "Fig.",
        "10000 scans",
        "520 mA",
        "statement",
        "fit",
    ):
        assert foreign not in text, foreign
    figures = {path.stem for path in (directory / "figures").glob("*.svg")}
    assert figures == {"transmissibility"}
    assert main(["report", str(directory), "--margins", str(directory)]) == 1


@pytest.fixture(scope="module")
def one_run(tmp_path_factory):
    directory = tmp_path_factory.mktemp("one") / "run"
    options = ["--gap", "6mm", "--seconds", "30", "--scan-rate", "2000", "--output", str(directory)]
    assert main(["record", *options]) == 0
    return directory


def test_a_run_is_reported_with_result_uncertainty_and_conditions(one_run):
    assert main(["report", str(one_run)]) == 0
    text = text_of(one_run / "report.html")
    facts = json.loads((one_run / "report.json").read_text())["facts"]
    assert f"DT = {plus_minus(facts['budget_dt'], facts['budget_expanded_uncertainty'] / COVERAGE)}" in text
    for words in ("coverage factor k = 2", "Effective degrees of freedom", "2000 scans/s", "gap 6 mm", "Conditions:"):
        assert words in text
    assert paper.TITLE not in text
    figures = {path.stem for path in (one_run / "figures").glob("*.svg")}
    assert figures == {"time_traces", "spectrum"}  # a single frequency is in the table: it is no curve


def test_a_report_removes_the_figures_of_the_report_that_it_replaces_and_no_others(one_run, tmp_path):
    (tmp_path / "figures").mkdir()
    (tmp_path / "report.json").write_text(json.dumps({"figures": {"curves": {}, "../own": {}, "spectrum": {}}}))
    for name in ("own.png", "figures/own.png", "figures/curves.png", "figures/curves.csv", "figures/spectrum.pdf"):
        (tmp_path / name).write_text("earlier")
    assert main(["report", str(one_run), "--output", str(tmp_path), "--format", "svg"]) == 0
    there = {path.name for path in (tmp_path / "figures").iterdir() if path.suffix != ".csv"}
    assert there == {"own.png", "time_traces.svg", "spectrum.svg"}
    assert not (tmp_path / "figures" / "curves.csv").exists()
    assert (tmp_path / "own.png").exists()
    (tmp_path / "report.json").write_text("[")
    assert main(["report", str(one_run), "--output", str(tmp_path), "--format", "png"]) == 0
