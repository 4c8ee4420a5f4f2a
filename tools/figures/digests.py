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
"""Digests of the pictures that take a browser or minutes of measurement to make.

`make figures` writes them, and `test/test_figures.py` computes them again in seconds: a picture whose digest has
changed must be made again. The digest of a drawn picture is that of a miniature, the same command with a few points:
its numbers to six digits and the texts of its drawing, together with the file of the full command. If there is no
miniature, the digest is that of the drawing function's syntax tree and of a few of its numbers. The digest of a
screenshot is that of the page's elements, styles and texts.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import inspect
import io
import json
import re
import tempfile
import textwrap
from collections.abc import Callable, Iterator, Mapping
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree as ET

import attrs
import numpy as np
import yaml

import impact_rig
from impact_rig.cli.main import main
from impact_rig.drawing import Drawn
from impact_rig.rig.config import RigConfig
from impact_rig_studies import comparison, prediction
from impact_rig_studies.excitation.files import load
from impact_rig_studies.excitation.random import RandomPlan, control
from impact_rig_studies.excitation.response import measure
from impact_rig_studies.excitation.shock import Pulse, shock
from impact_rig_studies.excitation.signals import Excitation
from impact_rig_studies.report.excitation import tell
from qualification import closed_loop, foreign_rig
from qualification import prediction as prediction_test
from tools import gallery_pictures, map_picture, urdf_picture
from tools.drive_pictures import PLANS, hardware
from tools.figures import BY_TOOLS, IMAGES, ROOT

FILE = Path(__file__).with_name("digests.json")
STATIC = ROOT / "impact_rig_lab" / "static"
STUDIES = """
title: miniature
set: {barriers.gap_m: 0.020}
section: {cycles: 10}
bifurcation: {over: gap_m, values: [0.019, 0.021], direction: both, cycles: 8}
basin: {sphere_position_m: [-0.009, 0.0], sphere_speed_m_s: [0.0, 0.4]}
orbit: {starts: [left]}
continue: {over: gap_m, from: 0.018, to: 0.022, at: 0.020, points: 3}
exponent: {over: gap_m, values: [0.020], cycles: 10, windows: 4}
"""
MAP = "axes: {frequency_hz: [9.0, 9.1], gap_m: [0.006, 0.010]}"
CAMPAIGN = """
title: miniature
set: {daq.rate_hz: 2000}
analysis: {settle_tolerance: 0.05}
studies:
  reference: {frequencies_hz: 9.1, gaps_m: none}
  curves: {frequencies_hz: 9.1, gaps_m: [none, 0.010], currents_a: 0.520, traces: true}
  gap: {frequencies_hz: 9.1, gaps_m: [0.008, 0.009, 0.010]}
  laws: {frequencies_hz: 9.1, gaps_m: [0.008, 0.009, 0.010], laws: [flores, exact]}
  restitution: {frequencies_hz: 9.1, gaps_m: 0.010, laws: exact, restitutions: [0.5, 0.6, 0.7]}
  mass: {frequencies_hz: 9.1, gaps_m: 0.010, vary: {sphere.density_kg_m3: [6500, 7850, 8960]}}
  amplitude: {frequencies_hz: 9.1, gaps_m: 0.010, currents_a: [0.48, 0.5, 0.52]}
  hysteresis: {frequencies_hz: [9.0, 9.05, 9.1], gaps_m: 0.010, direction: up_down}
"""
NUMBER = re.compile(r"-?\d+\.\d+(?:e[+-]?\d+)?")
LITERAL = re.compile(r'"((?:[^"\\\n]|\\.)*)"|`((?:[^`\\]|\\.)*)`')
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


def written() -> dict[str, dict[str, str]]:
    """Return the digests of the last `make figures`: by picture, of its contents and of its file."""
    found: dict[str, dict[str, str]] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def write(names: tuple[str, ...]) -> None:
    """Write the digests of new pictures."""
    found = written() if FILE.exists() else {}
    found |= {name: {"shows": shown(name), "file": of_file(IMAGES / name)} for name in names}
    FILE.write_text(json.dumps(dict(sorted(found.items())), indent=1) + "\n", encoding="utf-8")


def of_file(path: Path) -> str:
    """Return the digest of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def shown(name: str) -> str:
    """Return the digest of a picture's contents.

    Raises:
        KeyError: there is no function for its contents.
    """
    return hashlib.sha256(json.dumps(_subjects()[name]()).encode()).hexdigest()[:16]


@functools.cache
def _subjects() -> dict[str, Callable[[], object]]:
    """Return by picture the function that computes its contents."""
    found: dict[str, Callable[[], object]] = {}
    for words, (figure, name) in map_picture.PICTURES.items():
        found[f"{name}.png"] = functools.partial(_study, words[:-1], ROOT / "config" / f"{words[-1]}.yaml", figure)
    for file, names in gallery_pictures.SHOWN.items():
        for one in names:
            found[f"gallery_{one}.png"] = functools.partial(_gallery, ROOT / file, one)
    for one in ("random", "shock", "frf"):
        found[f"drive_{one}.png"] = functools.partial(_excitation, one)
    found |= dict.fromkeys(BY_TOOLS["tools/lab_pictures.py"], page)
    return found | {
        "backbone.png": lambda: [_tree(closed_loop._draw), _numbers(*attrs.astuple(_backbone())[:3])],
        "comparison.png": lambda: [_tree(comparison.drawn), _tree(foreign_rig.draw), _scans()],
        "prediction.png": lambda: [_tree(prediction_test.draw), _tree(prediction_test.continued), _branches()],
        "urdf.png": lambda: [
            urdf_picture.URDF.read_text(encoding="utf-8"), _tree(urdf_picture.draw), _tree(urdf_picture.main),
            urdf_picture.SHOWN_M, urdf_picture.FRAMES,
        ],
    }  # fmt: skip


def _backbone() -> prediction.Branch:
    return prediction.backbone(RigConfig(), closed_loop.SWEEP_GAP_M)


def _branches() -> list[object]:
    branches = [
        prediction.branch(RigConfig(), one, current_a=prediction_test.CURRENT_A)
        for one in prediction_test.FREQUENCIES_HZ
    ]
    return [_numbers(one.gap_m, one.dt, one.phase_rad) for one in branches]


def _scans() -> list[object]:
    record = impact_rig.simulate(seconds=1.0)
    return [_numbers(record.scans["base"], record.scans["laser"])]


def _numbers(*columns: np.ndarray) -> list[list[str]]:
    """Return some values of each column."""
    return [[f"{one:.6g}" for one in column[:: max(1, len(column) // 8)]] for column in map(np.asarray, columns)]


def _tree(function: Callable[..., object]) -> str:
    """Return the syntax tree of a function; docstrings, comments and layout do not count."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and ast.get_docstring(node) is not None:
            del node.body[0]
    return ast.dump(tree)


def _run(*words: str) -> None:
    """Run a command silently.

    Raises:
        RuntimeError: the command failed.
    """
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        if main(list(words)):
            raise RuntimeError(said.getvalue())


def _rounded(text: str) -> str:
    return NUMBER.sub(lambda number: f"{float(number[0]):.6g}", text)


def _texts(svg: str) -> list[str]:
    texts = ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")  # noqa: S314  # our own drawing
    return [text for one in texts if (text := "".join(one.itertext()))]


def _study(command: tuple[str, ...], file: Path, figure: str) -> list[object]:
    """Compute the contents of a miniature of a map or of a study, with the file of the full command."""
    return [_plan(file), *_miniature(command, figure)]


def _plan(file: Path) -> object:
    """Return the content of a plan file, without its comments."""
    return yaml.safe_load(file.read_text(encoding="utf-8"))


@functools.cache
def _miniature(command: tuple[str, ...], figure: str) -> list[object]:
    with tempfile.TemporaryDirectory() as folder:
        plan, out = Path(folder, "miniature.yaml"), Path(folder, "out")
        plan.write_text(MAP if command == ("map",) else STUDIES, encoding="utf-8")
        _run(*command, str(plan), "--output", str(out), "--workers", "1", "--format", "svg")
        table = (out / f"{command[-1]}.csv").read_text(encoding="utf-8")
        drawing = (out / "figures" / f"{figure}.svg").read_text(encoding="utf-8")
    return [_rounded(table), _texts(drawing)]


@functools.cache
def _report() -> Mapping[str, list[object]]:
    """Return by figure the contents of a miniature campaign's report."""
    with tempfile.TemporaryDirectory() as folder:
        plan, out = Path(folder, "miniature.yaml"), Path(folder, "out")
        plan.write_text(CAMPAIGN, encoding="utf-8")
        _run("campaign", str(plan), "--output", str(out), "--workers", "1")
        _run("report", str(out), "--format", "svg")
        return {
            one.stem: [_rounded(one.with_suffix(".csv").read_text(encoding="utf-8")), _texts(one.read_text("utf-8"))]
            for one in (out / "figures").glob("*.svg") if one.with_suffix(".csv").exists()
        }  # fmt: skip


def _gallery(file: Path, figure: str) -> list[object]:
    return [_plan(file), *_report()[figure]]


def _excitation(name: str) -> list[object]:
    """Compute the contents of a short test through the stream, with the plan of the full test."""
    linear = {"sphere.present": False}
    plan: object = ""
    if name == "random":
        path = PLANS / "random_superior.yaml"
        plan, whole = _plan(path), load(path, RandomPlan)
        short = attrs.evolve(whole, loops=1, frames=2, averages=2)
        *_, found = control(hardware(1_000, **{"barriers.gap_m": 0.006}), short)
        drawn = _first(found, whole.response.unit)
    elif name == "shock":
        path = PLANS / "shock.yaml"
        plan = _plan(path)
        *_, followed = shock(hardware(1_000, **linear), load(path, Pulse))
        drawn = _first(followed, "m")
    else:
        *_, response = measure(hardware(500, **linear), Excitation(frames=3), "base")
        drawn = _first(response, "m/A")
    return [plan, _rounded(drawn.csv()), _texts(drawn.svg)]


def _first(found: object, unit: str) -> Drawn:
    return tell(found, unit).draw()[0]


@functools.cache
def page() -> list[object]:
    """Return the elements of the page with their attributes and texts, its styles, and the texts in its scripts."""
    elements = _Elements()
    elements.feed((STATIC / "index.html").read_text(encoding="utf-8"))
    styles = " ".join(COMMENT.sub("", (STATIC / "style.css").read_text(encoding="utf-8")).split())
    texts = sorted({text for path in STATIC.glob("*.js") for text in _said(path.read_text(encoding="utf-8"))})
    words = json.loads((STATIC.parent / "words.json").read_text(encoding="utf-8"))
    return [elements.found, styles, texts, words]


def _said(script: str) -> Iterator[str]:
    """Yield the texts in a script: literals of several words."""
    for one in LITERAL.finditer(re.sub(r"^\s*(//|\*|/\*).*$", "", script, flags=re.MULTILINE)):
        text = one[1] or one[2] or ""
        if re.search(r"\w \w", text):
            yield text


class _Elements(HTMLParser):
    """Reader of a page's elements and texts."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[object] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Store an element."""
        self.found.append([tag, *map(list, attributes)])

    def handle_data(self, data: str) -> None:
        """Store a text."""
        if data.strip():
            self.found.append(" ".join(data.split()))
