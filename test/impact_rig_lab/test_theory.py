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
"""Theory on the page: computed in the background for the active knobs, and drawn solid, dashed, or not at all."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kits.browser import PATIENCE_S, Page
from kits.lab import FakeSource

from impact_rig.cli.main import main
from impact_rig.errors import ConfigError
from impact_rig.rig.config import RigConfig, from_flat, to_flat
from impact_rig_lab import theory
from impact_rig_lab.server import Server
from impact_rig_lab.theory import DECIDING, Theory, closed_form, continued, contradiction, predicted
from impact_rig_studies import prediction
from impact_rig_studies.maps.measure import MapRig, Settings

DEFAULT = to_flat(RigConfig())
CURRENT_A = 0.52


def of(gap_mm: float, amplitude: float = CURRENT_A, **changed: object) -> dict[str, Any]:
    names = {name.replace("__", "."): value for name, value in changed.items()}
    return predicted({**DEFAULT, "barriers.gap_m": gap_mm * 1e-3, **names}, amplitude)


@pytest.mark.heavy
def test_the_line_is_the_prediction_for_the_present_settings() -> None:
    found = of(20.0)
    assert [lasts for lasts, _ in found["lines"]] == [True]
    f, dt = np.array(found["lines"][0][1]).T
    wanted = prediction.at(RigConfig(), 9.1, 0.020, current_a=CURRENT_A)
    assert np.interp(9.1, f, dt) == pytest.approx(wanted.dt[0], abs=1e-4)
    assert found["words"] == "Predicted for 20 mm, 0.52 A, two impacts per cycle."
    assert of(12.0, 6e-5, drive__kind="prescribed")["words"].startswith("Predicted for 12 mm, 60 µm")
    other = of(20.0, contact__law="hu_guo")["lines"]
    assert other != found["lines"]


def test_a_measured_motion_other_than_the_predicted_one_is_reported() -> None:
    """At 6 mm, the rig has four impacts per cycle; the prediction is for two."""
    found = of(6.0)
    assert contradiction(found, 4.0).startswith("Measured: 4.00 impacts per cycle.")
    for same in (contradiction(found, 2.01), contradiction(found, np.nan), contradiction(of(32.0), 4.0)):
        assert same == ""


def test_unstable_motions_are_a_separate_line_that_joins_its_neighbours() -> None:
    lines = of(12.0)["lines"]
    assert [lasts for lasts, _ in lines] == [True, False, True]
    assert lines[0][1][-1] == lines[1][1][0]
    assert lines[1][1][-1] == lines[2][1][0]
    assert ", nowhere stable" not in of(12.0)["words"]


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (lambda: of(32.0), "no motion with two impacts per cycle at 32 mm, 0.52 A"),
        (lambda: of(6.0, 0.0), "No prediction at rest"),
        (lambda: of(6.0, sphere__present=False), "Without a sphere"),
        (lambda: of(6.0, sphere__guide_friction=0.1), "not include friction of the guide"),
        (lambda: of(6.0, drive__kind="voltage"), "a drive of constant voltage"),
        (lambda: of(6.0, drive__waveform="chirp"), "a drive that is chirp"),
    ],
)
def test_the_reason_is_shown_where_the_prediction_does_not_apply(
    found: Callable[[], dict[str, Any]], words: str
) -> None:
    said = found()
    assert said["lines"] == []
    assert words in said["words"]


def test_only_the_newest_request_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []
    reported: list[dict[str, Any]] = []
    started, go_on, done = threading.Event(), threading.Event(), threading.Event()

    def slow(_values: object, amplitude: float) -> dict[str, Any]:
        asked.append(amplitude)
        started.set()
        assert go_on.wait(PATIENCE_S)
        return {"lines": [], "words": f"{amplitude:g}"}

    def receive(found: dict[str, Any]) -> None:
        reported.append(found)
        done.set()

    monkeypatch.setattr(theory, "predicted", slow)
    one = Theory(receive)
    try:
        one.want(DEFAULT, 1.0)
        assert started.wait(PATIENCE_S)
        for amplitude in (2.0, 3.0, 3.0):
            one.want(DEFAULT, amplitude)
        one.want({**DEFAULT, "daq.rate_hz": 1}, 3.0)  # nothing a prediction depends on
        go_on.set()
        assert done.wait(PATIENCE_S)
    finally:
        one.close()
    assert asked == [1.0, 3.0]
    assert [found["words"] for found in reported] == ["3"]
    one.want(DEFAULT, 4.0)  # ended: nothing happens
    assert asked == [1.0, 3.0]


def test_the_prediction_depends_only_on_mechanics_and_drive() -> None:
    assert {"barriers.gap_m", "sphere.present", "contact.law", "drive.kind"} <= set(DECIDING)
    assert not any(name.startswith(("daq.", "instruments.", "time.")) for name in DECIDING)


COLOURED = """(want => {
  const plot = lab.curve.plot, copy = document.createElement('canvas'), from = plot.ctx.canvas;
  [copy.width, copy.height] = [from.width, from.height];
  const drawn = copy.getContext('2d', { willReadFrequently: true });
  drawn.drawImage(from, 0, 0);
  const style = getComputedStyle(document.documentElement);
  const ink = style.getPropertyValue('--drive').trim().match(/\\w\\w/g).map(part => parseInt(part, 16));
  return lab.curve.predicted.filter(([lasts]) => lasts === want).map(([, points]) => {
    let hit = 0, all = 0;
    for (let i = 1; i < points.length; i++) for (let s = 0; s < 8; s++) {
      const at = key => points[i - 1][key] + (points[i][key] - points[i - 1][key]) * s / 8;
      const x = plot.valToPos(at(0), 'x', true), y = plot.valToPos(at(1), 'y', true);
      const pixels = drawn.getImageData(Math.round(x) - 1, Math.round(y) - 1, 3, 3).data;
      all++;
      for (let p = 0; p < 36; p += 4) {
        if (pixels[p + 3] > 100 && ink.every((part, k) => Math.abs(part - pixels[p + k]) < 40)) { hit++; break; }
      }
    }
    return hit / all;
  });
})"""
"""The share of each predicted line that is drawn in its colour."""


@pytest.mark.heavy
def test_continued_motions_are_drawn_where_they_exist(tmp_path: Path) -> None:
    """Four impacts per cycle at 6 mm exist on an island between two folds, one of which is passed here."""
    study, out = tmp_path / "study.yaml", tmp_path / "out"
    study.write_text(
        "title: island\nset: {barriers.gap_m: 0.006}\n"
        "continue: {over: frequency_hz, from: 8.5, to: 9.7, at: 9.1, points: 30}\n"
    )
    words = ["dynamics", "continue", str(study), "--workers", "1", "--no-figures", "--output", str(out)]
    assert main(words) == 0
    island = continued(out)
    for gap_m, amplitude, here in ((0.006, CURRENT_A, True), (0.007, CURRENT_A, False), (0.006, 0.5, False)):
        reported: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        one = Theory(reported.put)
        one.branches = [island]
        one.want({**DEFAULT, "barriers.gap_m": gap_m, "sphere.start": "right"}, amplitude)
        found = reported.get(timeout=PATIENCE_S)
        one.close()
        plain = of(gap_m * 1e3, amplitude)["lines"]
        assert found["lines"] == [*plain, *(island.lines if here else [])]
        assert found["words"].endswith("Also drawn: motions of the model (island).") == here
    assert [lasts for lasts, _ in island.lines] == [True, False]
    rig = MapRig(from_flat(RigConfig(), {"barriers.gap_m": 0.006}), Settings())
    rig.reset()
    assert np.interp(9.1, *np.array(island.lines[0][1]).T) == pytest.approx(rig.measure(9.1, CURRENT_A).dt, rel=1e-4)
    over = "over: frequency_hz, from: 8.5, to: 9.7, at: 9.1, points: 30"
    study.write_text(study.read_text().replace(over, "from: 0.005, to: 0.007, at: 0.006, points: 2"))
    assert main(words) == 0
    with pytest.raises(ConfigError, match="over gap_m, but the page can draw only those over frequency_hz"):
        continued(out)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_draws_unstable_predictions_dashed(open_page: Callable[..., Page], scheme: str) -> None:
    source = FakeSource()
    source.snapshot.put(knobs={**DEFAULT, "barriers.gap_m": 0.012})
    source.snapshot.put(closed_form=closed_form(dict(DEFAULT)))
    source.snapshot.put(prediction=of(12.0))
    with Server(source, port=0) as server:
        page = open_page(server.address, prefers_color_scheme=scheme)
        page.wait("window.lab && lab.curve.predicted.length === 3", "the lines")
        page.wait(f"{COLOURED}(true).every(share => share > 0.97)", "whole lines")
        (dashed,) = page.js(f"{COLOURED}(false)")
        assert 0.3 < dashed < 0.95
        assert page.text("#prediction-note").startswith("Predicted for 12 mm, 0.52 A")
        assert page.js("document.getElementById('curve').getAttribute('aria-label')").startswith("DT over frequency")
        source.snapshot.put(prediction=of(32.0))
        page.wait("lab.curve.predicted.length === 0", "no line")
        assert page.text("#prediction-note") == "Theory finds no motion with two impacts per cycle at 32 mm, 0.52 A."
        page.js("lab.link.socket.onclose = null")  # no wish to connect again
