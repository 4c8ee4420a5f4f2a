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
its numbers to six digits and the texts of its drawing, together with the file of the full command. The miniature of a
map or a study is its own plan with a few values of each axis, at which all regimes of the picture occur. If there is no
miniature, the digest is that of the drawing function's syntax tree and of a few of its numbers. The digest of a
screenshot is that of the page's elements, styles and texts.
"""

from __future__ import annotations

import ast
import contextlib
import csv
import functools
import hashlib
import inspect
import io
import json
import re
import tempfile
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import attrs
import numpy as np
import yaml

import impact_rig
from impact_rig.cli.main import main
from impact_rig.drawing import Drawn
from impact_rig.rig.config import RigConfig
from impact_rig_studies import comparison, prediction
from impact_rig_studies.campaign.job import execute
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
STUDIES = {
    f"{name}.png": (words[:-1], ROOT / "config" / f"{words[-1]}.yaml", figure)
    for words, (figure, name) in map_picture.PICTURES.items()
}
"""Picture of a map or of a study -> command, file of the plan, and figure."""
MOST_VALUES = {"bifurcation": 20}  # largest number of values of an axis in a miniature; 6 for other kinds
MOST = {"section": ("cycles", 200), "continue": ("points", 6)}  # largest value of a key of such a section
SHARES = (0.35, 0.0, 0.8, 0.2, 0.65, 0.5, 0.95)  # places of each regime in a miniature, as fractions of all its places
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


def written() -> dict[str, dict[str, Any]]:
    """Return the digests of the last `make figures`: by picture, of its contents and of its file.

    Those of a map or study also contain the values of the axes of its miniature, and the regimes of the picture.
    """
    found: dict[str, dict[str, Any]] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def write(names: tuple[str, ...]) -> None:
    """Write the digests of new pictures."""
    found = written() if FILE.exists() else {}
    for name in names:
        at, regimes = chosen(name) if name in STUDIES else ({}, [])
        own = {"at": at, "regimes": regimes} if at else {}
        found[name] = {"shows": shown(name, at), "file": of_file(IMAGES / name), **own}
    FILE.write_text(json.dumps(dict(sorted(found.items())), indent=1) + "\n", encoding="utf-8")


def of_file(path: Path) -> str:
    """Return the digest of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def shown(name: str, at: Mapping[str, Sequence[float]]) -> str:
    """Return the digest of a picture's contents.

    Args:
        name: file name of the picture.
        at: values of the axes of its miniature, if it is that of a map or study with axes.

    Raises:
        KeyError: there is no function for its contents.
    """
    contents = [plan_of(STUDIES[name][1]), *miniature(name, at)] if name in STUDIES else _subjects()[name]()
    return hashlib.sha256(json.dumps(contents).encode()).hexdigest()[:16]


@functools.cache
def _subjects() -> dict[str, Callable[[], object]]:
    """Return by picture the function that computes its contents."""
    found: dict[str, Callable[[], object]] = {}
    for file, names in gallery_pictures.SHOWN.items():
        for one in names:
            found[f"gallery_{one}.png"] = functools.partial(_gallery, ROOT / file, one)
    for one in ("random", "shock", "frf"):
        found[f"drive_{one}.png"] = functools.partial(_excitation, one)
    found |= dict.fromkeys(BY_TOOLS["tools/lab_pictures.py"], page)
    return found | {
        "backbone.png": lambda: [_tree(closed_loop._draw), _numbers(*attrs.astuple(_backbone())[:3])],
        "comparison.png": lambda: [_tree(comparison.drawn), _tree(foreign_rig.draw), _scans()],
        "prediction.png": lambda: [_tree(prediction_test.draw), _tree(prediction_test.continued), *_branches(),
            *(_numbers(*one) for one in prediction_test.continued(2, 1)),
        ],
        "urdf.png": lambda: [
            urdf_picture.URDF.read_text(encoding="utf-8"), _tree(urdf_picture.draw), _tree(urdf_picture.main),
            urdf_picture.SHOWN_M, urdf_picture.FRAMES,
        ],
    }  # fmt: skip


def _backbone() -> prediction.Branch:
    return prediction.backbone(RigConfig(), closed_loop.SWEEP_GAP_M)


def _branches() -> list[object]:
    """Return the predicted motions of the picture, and its measurements next to the limits of stability."""
    found: list[object] = []
    for frequency in prediction_test.FREQUENCIES_HZ:
        one = prediction.branch(RigConfig(), frequency, current_a=prediction_test.CURRENT_A)
        found.append(_numbers(one.gap_m, one.dt, one.phase_rad))
        stable, gaps = one.gap_m[one.stable], 1e-3 * np.sort(prediction_test.GAPS_MM)
        near = {i for end in (stable.min(), stable.max()) for i in np.argsort(np.abs(gaps - end))[:2].tolist()}
        for job in (prediction_test.job(frequency, float(gaps[i])) for i in sorted(near)):
            mark = prediction_test.compared(job, execute(job))
            symmetric = bool(mark.two_per_cycle and mark.predicted)
            found.append([_numbers([mark.gap_m], [mark.dt], [mark.phase_rad]), symmetric])
    return found


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


def plan_of(file: Path) -> object:
    """Return the content of a plan file, without its comments."""
    return yaml.safe_load(file.read_text(encoding="utf-8"))


def _axes(plan: Any, kind: str) -> dict[str, list[Any]]:
    """Return the lists of values in the plan of a map or study by column of its results.

    Each is the mapping that contains it and its key there.
    """
    if kind == "map":
        return {name: [plan["axes"], name] for name in plan["axes"]}
    if kind == "basin":
        return {name: [plan[kind], name] for name in plan[kind]}
    return {plan[kind]["over"]: [plan[kind], "values"]} if "values" in plan[kind] else {}


def regimes(table: str) -> dict[str, list[dict[str, str]]]:
    """Return the rows of a table of results by regime.

    Periodic motions without impacts, with two per cycle, and with other numbers are different regimes.
    """
    found: dict[str, list[dict[str, str]]] = {}
    for row in csv.DictReader(io.StringIO(table)):
        regime = row["regime"]
        if regime == "periodic" and "impacts_per_cycle" in row:
            regime += {0.0: ", no impacts", 2.0: ", two impacts"}.get(float(row["impacts_per_cycle"]), "")
        found.setdefault(regime, []).append(row)
    return found


def chosen(name: str) -> tuple[dict[str, list[float]], list[str]]:
    """Return the values of the axes of a picture's miniature, and all regimes that occur in the picture.

    The values are those of some places of each regime in the results of the picture, the rarest regime first.
    """
    command, file, _ = STUDIES[name]
    columns = list(_axes(plan_of(file), command[-1]))
    if not columns:
        return {}, []
    results = map_picture.RESULTS / Path(name).stem / f"{command[-1]}.csv"
    by_regime = regimes(results.read_text(encoding="utf-8"))
    at: dict[str, set[float]] = {column: set() for column in columns}
    for share in SHARES:
        for rows in sorted(by_regime.values(), key=len):
            row = rows[int(share * len(rows))]
            grown = {column: at[column] | {float(row[column])} for column in columns}
            if max(map(len, grown.values())) <= MOST_VALUES.get(command[-1], 6):
                at = grown
    return {column: sorted(values) for column, values in at.items()}, sorted(by_regime)


def thinned(name: str, at: Mapping[str, Sequence[float]]) -> Any:
    """Return the plan of a picture with the few values of `at` on its axes."""
    command, file, _ = STUDIES[name]
    kind, plan = command[-1], plan_of(file)
    for column, (section, key) in _axes(plan, kind).items():
        section[key] = list(at[column])
    plan.pop("optimum", None)  # not drawn
    if kind in MOST:
        key, most = MOST[kind]
        plan[kind][key] = min(plan[kind].get(key, most), most)
    return plan


def miniature(name: str, at: Mapping[str, Sequence[float]]) -> tuple[str, list[str]]:
    """Compute the table of results and the texts of the drawing of a picture's thinned plan."""
    return _studied(name, yaml.safe_dump(thinned(name, at), sort_keys=False))


@functools.cache
def _studied(name: str, text: str) -> tuple[str, list[str]]:
    """Return table and texts of the study of a picture, with the plan in `text`."""
    command, _, figure = STUDIES[name]
    with tempfile.TemporaryDirectory() as folder:
        plan, out = Path(folder, "miniature.yaml"), Path(folder, "out")
        plan.write_text(text, encoding="utf-8")
        _run(*command, str(plan), "--output", str(out), "--workers", "1", "--format", "svg")
        table = (out / f"{command[-1]}.csv").read_text(encoding="utf-8")
        drawing = (out / "figures" / f"{figure}.svg").read_text(encoding="utf-8")
    return _rounded(table), _texts(drawing)


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
    return [plan_of(file), *_report()[figure]]


def _excitation(name: str) -> list[object]:
    """Compute the contents of a short test through the stream, with the plan of the full test."""
    linear = {"sphere.present": False}
    plan: object = ""
    if name == "random":
        path = PLANS / "random_superior.yaml"
        plan, whole = plan_of(path), load(path, RandomPlan)
        short = attrs.evolve(whole, loops=1, frames=2, averages=2)
        *_, found = control(hardware(1_000, **{"barriers.gap_m": 0.006}), short)
        drawn = _first(found, whole.response.unit)
    elif name == "shock":
        path = PLANS / "shock.yaml"
        plan = plan_of(path)
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
