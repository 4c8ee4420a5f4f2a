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
"""A study is drawn over its longest axis, with one line per other value, at the measured heights."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rig.drawing import style
from impact_rig_studies.campaign import run
from impact_rig_studies.campaign.job import execute
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.report import dt, studies

pytestmark = pytest.mark.heavy

RESTITUTIONS = (0.3, 0.5, 0.7)
STUDIES = f"""\
analysis: {{settle_tolerance: 0.01}}
studies:
  reference: {{frequencies_hz: 9.1, gaps_m: none}}
  restitution: {{frequencies_hz: 9.1, gaps_m: [0.004, 0.008], restitutions: {list(RESTITUTIONS)}}}
  sweep: {{frequencies_hz: [8.9, 9.0, 9.1], gaps_m: [none, 0.006]}}
  quiet: {{frequencies_hz: 9.1, gaps_m: [0.002, 0.012, 0.014], starts: [centre]}}
  pair: {{frequencies_hz: [9.0, 9.1], gaps_m: none}}
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("studies")
    (folder / "studies.yaml").write_text(STUDIES)
    campaign = load_campaign(folder / "studies.yaml")
    store = run.prepare(campaign, folder / "out", "process")
    for job in run.unique_jobs(campaign.planned()):
        store.put(job, execute(job))
    return run.finished(campaign, folder / "out")


@pytest.fixture
def drawn(done, monkeypatch):
    """Return a study's points, its axes before they become a file, and its caption."""

    def draw(study):
        monkeypatch.setattr(studies, "Drawn", lambda _name, figure, caption, _lines: (figure, caption))
        points = [point for point in done.points if point.study == study]
        ((figure, caption),) = studies.study_figures(study, points, done.curves, done.calibration)
        (axis,) = figure.axes
        return points, axis, caption

    return draw


def test_reductions_are_drawn_over_the_restitution(done, drawn):
    points, axis, caption = drawn("restitution")
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("nominal restitution", "reduction of DT (%)")
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["gap 4 mm", "gap 8 mm"]
    without = done.curves.at(0.0, 9.1).dt
    for gap, (line, *_) in zip((0.004, 0.008), axis.containers, strict=True):
        own = {point.axes["contact.restitution"]: point.dt for point in points if point.gap_m == gap}
        np.testing.assert_allclose(line.get_xdata(orig=False), RESTITUTIONS)
        np.testing.assert_allclose(line.get_ydata(orig=False), [100 * (1 - own[e] / without) for e in RESTITUTIONS])
    assert caption == "Study “restitution”: 6 settled points, ± 2u."


def test_the_legend_lists_each_case_once_and_labels_are_within_the_figure(done, monkeypatch):
    """A legend that lists each gap twice would push a label over the edge of the figure."""
    figures = []
    monkeypatch.setattr(dt, "Drawn", lambda _name, figure, _caption, _lines: figures.append(figure))
    with style():
        for draw in (dt.draw_damper(done.curves, done.calibration), dt.draw_amplitudes(done.curves)):
            list(draw)
        for figure, cases in zip(figures, (["6 mm"], ["no sphere", "6 mm"]), strict=True):
            figure.canvas.draw()
            assert [text.get_text() for text in figure.axes[-1].get_legend().get_texts()] == cases
            for axis in figure.axes:
                box = axis.yaxis.label.get_window_extent()
                assert 0.0 <= box.x0 < box.x1 <= figure.bbox.width, axis.get_ylabel()


def test_transmissibility_is_drawn_over_the_frequency(drawn):
    points, axis, _ = drawn("sweep")
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("frequency (Hz)", "transmissibility")
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["no sphere", "gap 6 mm"]
    for gap, (line, *_) in zip((0.0, 0.006), axis.containers, strict=True):
        np.testing.assert_allclose(line.get_ydata(orig=False), [point.dt for point in points if point.gap_m == gap])


def test_points_without_impacts_are_drawn_open_and_named(drawn):
    points, axis, caption = drawn("quiet")
    assert [point.status for point in points] == ["ok", "no_impacts", "no_impacts"]
    (marked,) = [line for line in axis.lines if line.get_markerfacecolor() == "white"]
    np.testing.assert_allclose(marked.get_xdata(orig=False), [12.0, 14.0])
    assert "Open circles: the sphere did not strike (no impacts for 6" in caption
    assert caption.endswith("s; a sphere slower than 0.2 mm/s could still strike).")


def test_two_points_are_too_few_for_a_figure(done):
    pair = [point for point in done.points if point.study == "pair"]
    assert not list(studies.study_figures("pair", pair, done.curves, done.calibration))
    assert not list(studies.study_figures("pair", [], done.curves, done.calibration))
