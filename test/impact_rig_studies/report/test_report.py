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
"""The report is one self-contained page, and shows the measured results."""

from __future__ import annotations

import csv
import json
import re
from html.parser import HTMLParser
from types import SimpleNamespace
from urllib.parse import unquote

import attrs
import numpy as np
import pytest
from matplotlib.colors import to_hex

from impact_rig.analysis.uncertainty_budget import plus_minus
from impact_rig.arithmetic import ARITHMETIC
from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.cli import main
from impact_rig.drawing import DARK, NAMES, PERIODIC, QUIET
from impact_rig.errors import RecordingError
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.system.files import config_dir
from impact_rig_studies import prediction
from impact_rig_studies.campaign import paper, run
from impact_rig_studies.campaign.job import execute
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.campaign.results import Curves, Point
from impact_rig_studies.campaign.statements import variations
from impact_rig_studies.report import cover, dt
from impact_rig_studies.report.studies import predicted, reduction_over_gap
from qualification.check_report import VIEWS, shown, troubles

pytestmark = pytest.mark.heavy

VOID = {"meta", "link", "br", "use"}


class Page(HTMLParser):
    """Parser that collects identifiers, addresses, text and unbalanced elements."""

    def __init__(self, text):
        super().__init__()
        self.identifiers, self.addresses, self.open, self.words, self.said = [], [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        if "id" in values:
            self.identifiers.append(values["id"])
        self.addresses += [values[name] for name in ("src", "href", "xlink:href") if name in values]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data):
        self.words.append(data)
        if not {"svg", "style"} & set(self.open):
            self.said.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Campaign with the paper's curves at three frequencies and a point that fails, with the outcomes of its jobs."""
    folder = tmp_path_factory.mktemp("report")
    file = folder / "short.yaml"
    campaign = load_campaign(config_dir() / "paper.yaml").only(("curves",))
    text = campaign.text.replace("[7.5, 8.0, 8.5, 8.9, 9.0, 9.1, 9.2, 9.5, 10.0, 10.5]", "[9.0, 9.1, 9.2]")
    text = text[: text.index("  peak:")] + "  <trip>: { frequencies_hz: 9.1, gaps_m: none, currents_a: 18 }\n"
    file.write_text(f"analysis: {{ settle_tolerance: 0.01 }}\n{text}")
    campaign = load_campaign(file)
    jobs = run.unique_jobs(campaign.planned())
    fewer = [job if job.frequencies_hz == (9.1,) else attrs.evolve(job, traces=False) for job in jobs]
    return campaign, [(job, execute(one)) for job, one in zip(jobs, fewer, strict=True)]


def stored(folder, campaign, found):
    """Return the directory of a campaign whose jobs had these outcomes."""
    store = run.prepare(campaign, folder, "process")
    for job, outcome in found:
        store.put(job, outcome)
    run.write_results(run.finished(campaign, folder), 1.0)
    return folder


@pytest.fixture(scope="module")
def margins(tmp_path_factory):
    """Campaign on the rig itself and one with another mass."""
    folder = tmp_path_factory.mktemp("margins")
    (folder / "margins.yaml").write_text(MARGINS)
    varied = load_campaign(folder / "margins.yaml")
    return stored(folder / "out", varied, [(job, execute(job)) for job in run.unique_jobs(varied.planned())])


@pytest.fixture(scope="module")
def reported(short, margins, tmp_path_factory):
    """The campaign, and its page with margins and continued motions."""
    folder = tmp_path_factory.mktemp("reported")
    (folder / "branches.yaml").write_text(BRANCHES)
    continued = ["dynamics", "continue", str(folder / "branches.yaml"), "--workers", "1"]
    assert main([*continued, "--output", str(folder / "branches")]) == 0
    out = stored(folder / "out", *short)
    extras = ["--margins", str(margins), "--branches", str(folder / "branches")]
    assert main(["report", str(out), "--format", "svg", "png", *extras]) == 0
    return out


@pytest.fixture(scope="module")
def page(reported):
    return Page((reported / "report.html").read_text())


def test_the_page_is_complete_and_fetches_nothing(page, reported):
    assert page.open == []
    assert len(page.identifiers) == len(set(page.identifiers))
    for address in page.addresses:
        local = address.startswith(("#", "data:")) or (reported / address).is_file()
        assert local, f"{address} is somewhere else"
    text = (reported / "report.html").read_text()
    assert "<script" not in text
    assert "@import" not in text
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", text))


def test_every_colour_follows_the_theme(reported):
    text = (reported / "report.html").read_text()
    drawings = re.findall(r"<svg.*?</svg>", text, flags=re.DOTALL)
    assert drawings
    for drawing in drawings:
        assert not [light for light in NAMES if light in drawing]
        assert "#000000" not in drawing, "drawn in the default black, unseen in the dark"
    assert set(DARK) == set(NAMES.values())


def test_the_page_states_the_results_of_the_campaign(page, reported):
    done = run.open_finished(reported)
    reductions = done.reductions()
    for gap, value in reductions.percent().items():
        assert plus_minus(value, reductions.percent_uncertainty[gap]) in page.text, gap
    for verdict in done.verdicts():
        assert verdict.text in page.text
        assert f"{verdict.word} {verdict.kind.value} {verdict.detail}" in page.text
    assert "a fit, not a validation" in page.text
    assert "returns 0.309 in this simulation" in page.text
    assert "<trip> no sphere 9.1 reset the rig tripped: over_travel" in page.text
    assert "structure.damping_ratio" in page.text


MARGINS = """\
set: { instruments.ideal: true }
analysis: { settle_tolerance: 0.01 }
studies:
  m_b:
    frequencies_hz: [7.5, 8.0, 8.5, 8.9, 9.0, 9.1, 9.2, 9.5, 10.0, 10.5]
    gaps_m: none
    vary: { shaker.base_mass_kg: [1.84, 0.84] }
"""


BRANCHES = """
title: Over the gap
continue: {over: gap_m, from: 0.002, to: 0.036, at: [0.010], points: 8}
"""


def test_the_page_states_the_evidence_for_each_verdict_and_its_chosen_constants(page, reported, margins, capsys):
    text = page.text
    for verdict in run.open_finished(reported).verdicts():
        assert f"{verdict.word} {verdict.kind.value} {verdict.detail}" in text
    (itself, changed) = variations(run.open_finished(margins).points)
    for one, name in ((itself, "the rig itself"), (changed, "shaker.base_mass_kg = 0.84")):
        peak, amplitudes = (f"{v.result.value:.4g} {v.word}" for v in one.verdicts[:2])
        assert f"{name} {peak} {amplitudes}" in text
    assert changed.verdicts[1].word == "FAIL"
    assert main(["report", str(reported), "--margins", str(reported)]) == 1
    assert "do not suffice to judge the paper's statements on two rigs or more" in capsys.readouterr().err


def test_continued_motions_are_drawn_with_the_measurements(reported, tmp_path, capsys):
    kept = json.loads((reported / "report.json").read_text())["figures"]["continued_0"]
    stable, unstable, measured = kept["cases"]
    assert max(unstable["gap_m"]) < 9.7e-3  # the flip at 9.69 mm
    assert max(stable["gap_m"]) > 10.3e-3
    assert sorted(measured["gap_m"]) == [0.002, 0.004, 0.006, 0.008, 0.010]
    ours = stable["transmissibility"][stable["gap_m"].index(0.010)]
    at = measured["gap_m"].index(0.010)
    assert ours == pytest.approx(measured["transmissibility"][at], abs=2.0 * measured["expanded_uncertainty"][at])
    assert "Stable and unstable motions of the model" in Page((reported / "report.html").read_text()).text
    (tmp_path / "branches.yaml").write_text(f"set: {{sphere.diameter_m: 0.006}}\n{BRANCHES.replace('8}', '2}')}")
    out, page = str(tmp_path / "out"), str(tmp_path / "report.html")
    assert main(["dynamics", "continue", str(tmp_path / "branches.yaml"), "--workers", "1", "--output", out]) == 0
    assert main(["report", str(reported), "--output", page, "--branches", out]) == 1
    assert (
        f"{out}: the branches belong to another rig: its sphere.diameter_m is 0.006, but 0.00635 in the campaign"
        in capsys.readouterr().err
    )
    assert main(["report", str(reported), "--output", page, "--rig", "/a"]) == 1
    assert "--rig applies only to a run" in capsys.readouterr().err


NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*[A-Za-z_])")


def leaves(value):
    """Yield every number and every text in the content of a JSON file."""
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from leaves(item)
    if isinstance(value, (int, float, str)):
        yield value


def kept(folder):
    """Return the numbers that a program can read, and those in texts."""
    numbers, written = set(), set()
    report, summary = (json.loads((folder / name).read_text()) for name in ("report.json", "summary.json"))
    del report["figures"]  # thousands of numbers, that no text shows
    found = [*leaves([report, summary])]
    for row in csv.reader((folder / "points.csv").read_text().splitlines()):
        found += row
    for one in found:
        if isinstance(one, str):
            written |= {text.replace("−", "-").lstrip("+") for text in NUMBER.findall(one)}
        else:
            numbers.add(float(one))
    return numbers | {float(text) for text in written}, written


def stands_for(shown, number):
    """Return whether the shown text is this number, rounded to the shown digits."""
    _, _, decimals = shown.partition("e")[0].partition(".")
    digits = len(re.sub(r"e.*|\D", "", shown).lstrip("0").rstrip("0" if not decimals else "")) or 1
    return float(shown) in (round(number, len(decimals)), float(f"{number:.{digits}g}"))


def test_every_number_of_the_page_is_in_a_machine_readable_file(page, reported):
    numbers, written = kept(reported)
    shown = {text.replace("−", "-").lstrip("+") for data in page.said for text in NUMBER.findall(data)}
    assert len(shown) > 150
    strange = [one for one in shown if one not in written and not any(stands_for(one, each) for each in numbers)]
    assert strange == []


def test_the_check_finds_a_number_that_is_in_no_file(reported):
    numbers, written = kept(reported)
    for invented in ("31.4159", "-0.271828", "65537"):
        assert invented not in written
        assert not any(stands_for(invented, each) for each in numbers)
    assert stands_for("30.87", 30.8709)
    assert stands_for("10000", 9999.7)
    assert not stands_for("30.88", 30.8709)


def test_the_cover_names_paper_configuration_and_versions(page, reported):
    for words in (paper.TITLE, paper.AUTHORS, "none found", "contact law flores, 10000 scans/s", "Seed 1"):
        assert words in page.text
    summary = json.loads((reported / "summary.json").read_text())
    assert f"Measured {summary['written']}" in page.text
    assert f"Arithmetic version {ARITHMETIC}" in page.text


def test_the_contents_link_to_every_section(reported):
    text = (reported / "report.html").read_text()
    contents = re.search(r"<nav.*?</nav>", text, flags=re.DOTALL)[0]
    sections = re.findall(r'<section[^>]* id="([^"]+)"', text)
    assert re.findall(r'href="#([^"]+)"', contents) == sections
    assert len(sections) >= 10


def test_the_instruments_are_those_of_the_certificate(page):
    for row in Rig(RigConfig()).info().rows:
        shown = f"{100.0 * row['sensitivity_uncertainty']:.2g}"
        assert re.search(rf"{row['name'].decode()} -?[\d.]+ to [\d.]+ \S+ \S+ \S+ {re.escape(shown)} ", page.text)


def test_every_figure_can_be_enlarged_and_links_to_its_numbers(reported):
    text = (reported / "report.html").read_text()
    figures = re.findall(r'<figure id="([^"]+)".*?</figure>', text, flags=re.DOTALL)
    assert figures
    for place in figures:
        assert f'href="#{place}"' in text
        assert f'href="#{place}-here"' in text
    for name, address in re.findall(r'<a download="([^"]+)" href="data:text/csv;charset=utf-8,([^"]*)"', text):
        table = list(csv.reader(unquote(address).splitlines()))
        assert table == list(csv.reader((reported / "figures" / name).read_text().splitlines()))
        assert table[0][0] == "case"
        assert len(table) > 1
    rows = csv.DictReader((reported / "figures" / "fig8c_gap_6mm.csv").read_text().splitlines())
    points = run.open_finished(reported).curves.by_gap[6e-3]
    found = {float(row["frequency_hz"]): float(row["transmissibility"]) for row in rows if row["case"] == "6 mm"}
    assert found == pytest.approx({frequency: point.dt for frequency, point in points.items()}, rel=1e-8)


def test_a_prediction_is_drawn_where_it_exists_and_is_stable():
    frequencies, current_a, gap_m = np.linspace(8.9, 9.3, 9), 0.52, 0.02
    lasting = [b.take(b.stable) for b in prediction.curves(RigConfig(), frequencies, gap_m, current_a=current_a)]
    found = predicted(RigConfig(), gap_m, frequencies, current_a)
    assert sum(len(one.dt) for one in found) == sum(len(one) for one in lasting) > 1
    assert {*np.concatenate([one.dt for one in found])} == {*np.concatenate([one.dt for one in lasting])}
    assert predicted(from_flat(RigConfig(), {"sphere.guide_friction": 0.1}), gap_m, frequencies, current_a) == []
    line = reduction_over_gap(RigConfig(), 9.1, current_a)
    motions = prediction.branch(RigConfig(), 9.1, current_a=current_a)
    assert line.columns["gap_m"] == sorted(motions.gap_m[motions.stable])


def test_figures_are_stored_next_to_the_page(reported):
    names = {path.stem for path in (reported / "figures").glob("*.svg")}
    assert names == {path.stem for path in (reported / "figures").glob("*.png")}
    assert {"fig6_without_sphere", "fig7_all_gaps", "fig8a_gap_2mm", "fig8e_gap_10mm", "regimes", "reductions"} <= names
    assert len((reported / "points.csv").read_text().splitlines()) == 1 + 6 * 3 + 1
    assert {"trace_gap_2mm", "phase_gap_10mm", "amplitudes"} <= names


def test_a_directory_without_a_campaign_is_rejected(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 1
    printed = capsys.readouterr().err
    assert "is not a campaign's directory" in printed
    assert "--output NEW`" in printed, "into the directory of something else no campaign goes"


SHOWN = (VIEWS[0], VIEWS[3], *(pytest.param(*view, marks=pytest.mark.slow) for view in VIEWS[1:3]))


@pytest.mark.parametrize(("width", "scheme"), SHOWN)
def test_a_browser_finds_no_fault_in_the_page(reported, browser, width, scheme):
    with shown(browser, reported / "report.html", width, scheme) as page:
        assert troubles(page) == []


BAD = """\
<div class="scroll" style="width: 100px; overflow: auto"><table><tr><td style="min-width: 900px">far</table></div>
<figure aria-label="a drawing"><svg viewBox="0 0 100 100" width="100" style="font-size: 12px">
<text x="0" y="50">over</text><text x="2" y="50">each other</text></svg></figure><img src="https://127.0.0.1:9/x.png">
"""


def test_a_browser_finds_planted_faults(browser, tmp_path):
    (tmp_path / "bad.html").write_text(BAD)
    with shown(browser, tmp_path / "bad.html", *VIEWS[0]) as page:
        found = "\n".join(troubles(page))
    for trouble in ("a table is cut off", "overlap", "asks for https", "console: ", "image-alt"):
        assert trouble in found


def drawable(**changes):
    """Points with and without the sphere at two frequencies."""
    row = np.zeros(1, TRANSMISSIBILITY)
    row["transmissibility"], row["transmissibility_uncertainty"], row["phase"], row["settled"] = 5.0, 0.01, -1.5, 1.0
    row["regime"], row["impacts_per_cycle"] = b"periodic", 2.0
    for name, value in changes.items():
        row[name] = value
    return Curves.of([
        Point(
            study="s", axes={}, reference=True, gap_m=gap, current_a=paper.CURRENT_A, frequency_hz=frequency,
            direction="reset", rows=row, failure="", key="",
        )
        for gap in (0.0, 0.006) for frequency in (9.1, 10.5)
    ])  # fmt: skip


@pytest.mark.parametrize(
    ("impacts", "shade", "text"), [(2.0, PERIODIC, "2.0"), (0.0, QUIET, "0.0"), (np.nan, PERIODIC, "")]
)
def test_points_without_counted_impacts_are_not_drawn_as_free_of_impacts(monkeypatch, impacts, shade, text):
    """A measurement without an accelerometer must not be drawn as one without impacts, with nan of them."""
    monkeypatch.setattr(dt, "Drawn", lambda _, figure, *__: figure)
    (figure,) = dt.draw_regimes(drawable(impacts_per_cycle=impacts))
    (axis,) = figure.axes
    colours = {to_hex(one.get_facecolor()[0]) for one in axis.collections[: len(paper.FREQUENCIES_HZ)]}
    assert to_hex(shade) in colours
    assert (to_hex(QUIET) in colours) == (impacts == 0.0)
    assert {one.get_text() for one in axis.texts} == ({text} if text else set())


def test_phases_on_both_sides_of_half_a_turn_are_visible_in_the_figure(monkeypatch):
    """A point that noise has turned into a lead of 179° must not be invisible above the axis."""
    monkeypatch.setattr(dt, "Drawn", lambda _, figure, *__: figure)
    for figure in dt.draw_all_gaps(drawable(phase=np.pi - 0.01), RigConfig()):
        axis = figure.axes[2]
        low, high = axis.get_ylim()
        drawn = np.concatenate([np.asarray(line.get_ydata(), float) for line in axis.lines])
        assert len(drawn)
        assert np.all((drawn > low) & (drawn < high))


@pytest.mark.parametrize("content", ["[1]", "3", "null", "{", "[" * 100_000])
def test_a_damaged_description_of_a_campaign_is_reported_in_one_line(tmp_path, content):
    done = SimpleNamespace(directory=tmp_path)
    for name in ("provenance.json", "summary.json"):
        (tmp_path / name).write_text(content)
    with pytest.raises(RecordingError, match=r"provenance\.json cannot be read: "):
        cover.versions(done)
    assert cover.written(done) == ""
