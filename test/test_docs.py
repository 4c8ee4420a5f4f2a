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
"""README and docs: every code block is run or states why not; every command, path and link in them exists."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import pkgutil
import re
import runpy
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("markdown_it", reason="comes with rich, except with Ubuntu's")

import impact_rig
from impact_rig import kernels
from impact_rig.analysis.tracker import Tracker
from impact_rig.kernels.build import PARTS
from impact_rig.physics.linear_response import transmissibility
from impact_rig.rig.config import RigConfig, dump, load_config
from impact_rig.simtime import NS_PER_S
from impact_rig.testing import LocalRig
from impact_rig_studies.campaign.paper import CURRENT_A, FREQUENCY_HZ, REDUCTION_PERCENT
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.dynamics.plan import KINDS
from impact_rig_studies.dynamics.plan import load as load_dynamics
from impact_rig_studies.importing.mapping import Mapping, refined
from impact_rig_studies.maps.plan import load_map

ROOT = Path(__file__).parents[1]
TOOL = runpy.run_path(str(ROOT / "tools" / "check_docs.py"))
DEMO_ROW = re.compile(r"^ +(\d+) +([\d.]+) +([\d.]+) +([\d.]+) +([\d.]+) +([-+]?[\d.]+)$", re.MULTILINE)
"""Row of the table of `make demo`: gap, DT, reduction, its 2u, that of the paper, and the difference."""
BLOCKS = [block for page in TOOL["pages"]().values() for block in page.blocks]
OURS = [block for block in BLOCKS if block.owner == "test/test_docs.py"]


WITHOUT_EXAMPLE = {"GoneError", "SimulationError", "TrackerSettings"}
"""Public names without an example: errors that no short program raises, and settings that `Tracker` receives."""
NO_SYMBOLS = {"d", "Σ", "a", "π"}
"""The differential, the sum, the article, and the number."""
INDEXED = r"._([\dikjnq]|first|last)"
SOURCES_LETTERS = {
    "impact_rig.arithmetic.elementary",
    "impact_rig.arithmetic.random",
    "impact_rig.analysis.calibration",
}
"""Modules whose letters are those of their sources, as the page of symbols says."""


def by_place(block):
    return f"{block.page}:{block.line}"


def test_every_page_is_free_of_faults():
    found = [fault for page in TOOL["pages"]().values() for fault in TOOL["faults"](page)]
    assert found == []
    assert len(BLOCKS) > 40
    assert {"README.md", "CONTRIBUTING.md", "docs/reference/interface.md", "examples/README.md"} <= TOOL[
        "pages"
    ]().keys()


def symbol_rows(page: str) -> list[list[str]]:
    """Return the rows (symbols, unit, meaning) of a page's table of symbols."""
    text = (
        (ROOT / "docs" / page).read_text(encoding="utf-8").partition("| symbol | unit | meaning |\n|---|---|---|\n")[2]
    )
    return [line.strip("| ").split(" | ") for line in text.partition("\n\n")[0].splitlines()]


def symbols_in(text: str) -> set[str]:
    """Return the letters of equations, each with its subscript; one below Σ, or a number, is an index."""
    found = re.findall(r"(?<![\w∂])[A-Za-zα-ωΑ-Ω](?:_\w+)?(?![\w-])", re.sub(r"`[^`]*`|'s ", " ", text))
    return {re.sub(r"²|³", "", symbol) for symbol in found if symbol[0] not in NO_SYMBOLS}


def known_symbols() -> list[str]:
    """Return every symbol of both tables, as often as it occurs."""
    rows = symbol_rows("reference/symbols.md") + symbol_rows("explanation/physics.md")
    assert all(len(row) == 3 and all(row) for row in rows)
    return [symbol for row in rows for symbol in row[0].split(", ")]


def kernels_that_read_aloud() -> list[Callable[..., Any]]:
    """Return all compiled functions, except those that keep the letters of their sources."""
    for part in PARTS.values():
        for module in part:
            importlib.import_module(f"impact_rig.{module}")
    own = [one for one in kernels.kernels if one.__module__ not in SOURCES_LETTERS]
    assert len(own) > 90, "the kernels were not found"
    return own


def test_each_symbol_of_the_kernels_has_one_meaning():
    assert [symbol for symbol, count in Counter(known_symbols()).items() if count > 1] == []


def test_every_symbol_of_the_kernels_is_listed():
    """Each letter in equations of docs/explanation/kernels.md and the modules has a unit or a dash, and a meaning."""
    page = (
        (ROOT / "docs" / "explanation" / "kernels.md").read_text(encoding="utf-8").partition("| kernel | equation |")[2]
    )
    equations = [page.partition("\n\n")[0]]
    for module in {one.__module__ for one in kernels_that_read_aloud()}:
        head = sys.modules[module].__doc__ or ""
        equations.append("\n".join(line for line in head.splitlines() if line.startswith("    ")))
    used = set().union(*map(symbols_in, equations))
    assert len(used) > 50, "there are no equations"
    known = set(known_symbols()) | {symbol.strip("`") for symbol in known_symbols()}
    counted = {symbol[:2] for symbol in known if re.fullmatch(r"._[\dkn]", symbol)} | {"φ_"}  # C_n includes C_1
    assert {one for one in used - known if not (one[:2] in counted and re.fullmatch(INDEXED, one))} == set()


def test_every_letter_in_the_code_of_kernels_is_listed():
    known = {re.sub(r"`|'", "", symbol) for symbol in known_symbols()}
    letters = {
        (one.__module__, one.__name__, name)
        for one in kernels_that_read_aloud()
        for name in one.__code__.co_varnames
        if re.fullmatch(r"[A-Za-z](_[a-z0-9]{1,2})?", name)
    }
    assert len(letters) > 200
    assert {one for one in letters if one[2] not in known and not re.fullmatch(r"o_\d", one[2])} == set()


def test_the_table_lists_every_symbol_of_the_equations_of_motion():
    """All but the three states and what the equations themselves define, such as m_a, c_f and K_f."""
    text = (
        (ROOT / "docs" / "explanation" / "physics.md")
        .read_text(encoding="utf-8")
        .partition("```text\n")[2]
        .partition("```")[0]
    )
    equations = re.sub(r"[a-z]{2,}|`[^`]*`|'s |'", " ", text.replace("F_right", "F_r").replace("F_left", "F_l"))
    found = {*re.findall(r"(?<![\w.])[A-Za-zμδ](?:_\w|0)?(?!\w)", equations)}
    assert {"m_a", "c_f", "K_f", "F_μ", "L", "δ", "v0", "F_r"} <= found
    known = {one.removesuffix("(e)") for row in symbol_rows("explanation/physics.md") for one in row[0].split(", ")}
    assert found - {one[:3] for one in known} == {"x_b", "x_1", "x_2", "t", "F", "F_μ"}


def test_every_test_that_runs_a_page_names_it():
    for (page, _), owner in TOOL["RUN_BY"].items():
        named = Path(page).stem if page.startswith("docs/") else Path(page).parent.name
        assert re.search(rf"\b{named}\b", (ROOT / owner).read_text(encoding="utf-8")), owner


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("    make test\n", "1: a code block without a language"),
        ("\n```ruby\nputs 1\n```\n", "2: no program runs this block of 'ruby'"),
        ("```python not run: \nx\n```\n", "no program runs this block"),
        ("```sh\nimpact-rig analyse RUN\n```\n", "impact-rig analyse RUN: no such subcommand"),
        ("```sh\nmake lint && impact-rig info\n```\n", "impact-rig info: the following arguments are required: RUN"),
        ("```sh\ncurl x\n```\n", "curl is not a program that can be checked"),
        ("```sh not run: so\nFOO=1 make tset  # x\n```\n", "make tset: the Makefile has no target tset"),
        ("`impact-rig info RUN --fig x`", "unrecognized arguments: --fig x"),
        ("`impact-rig replay --rate fast`", "argument --rate"),
        ("| a |\n|---|\n| `make test ARGSS=-k` |\n", "the Makefile has no variable ARGSS"),
        ("`make bench ONLY=codec`", "benchmarks/ has no part codec"),
        ("`make test ROS=humble`", "requirements/ has no ROS humble"),
        ("`make test ARGS=test/test_nothing.py`", "there is no test/test_nothing.py"),
        ("`make test ARGS='-k nothing_of_this'`", "no test has nothing_of_this in its name"),
        ("`make check ARGS=--changes`", "the plugin has no --changes"),
        ("`make lab ARGS='--rates 9'`", "unrecognized arguments: --rates"),
        ("`make campaign ARGS='--alone curves'`", "unrecognized arguments: --alone curves"),
        ("`make figures ARGS=paper.png`", "figures has no paper.png"),
        ("`make fuzz ARGS='--inputs 9 words'`", "fuzz has no words"),
        ("`make soak ARGS='--part dead'`", "soak has no dead"),
        ("`make lock ARGS=--checks`", "lock has no --checks"),
        ("`python -m impact_rig.nodes.interfaces`", "there is no module impact_rig.nodes.interfaces"),
        ("`python tools/sock.py`", "there is no tools/sock.py"),
        ("`pytest --rig-golden`", "the plugin has no --rig-golden"),
        ("`ros2 run impact_rig rig`", "setup.py has no program rig"),
        ("`ros2 run impact_rig impact-rig inform x`", "no such subcommand"),
        ("`ros2 launch impact_rig rig.launch.py modus:=x`", "rig.launch.py has no argument modus"),
        ("`ros2 topic echo /rig/transmissibilities`", "docs/reference/interface.md has no topic transmissibilities"),
        ("`ros2 param set /rig/rig barriers.gap 1`", "docs/reference/configuration.md has no parameter barriers.gap"),
        ("```sh not run: so\nros2 run impact_rig\n```\n", "ros2 run impact_rig: words are missing"),
        ("in `test/test_nothing.py`", "there is no test/test_nothing.py"),
        ("```python title=new.py\n1\n```\n", "the text before the block does not name its file new.py"),
        ("in `config/none/`", "there is no config/none/"),
        ("It takes 3.5 s.\n", "no command prints and no test checks figures such as '3.5'"),
        ("# A\n## B\n<!-- figures: make test -->\n9 %\n\n## C\n| a |\n|---|\n| 7 % |\n", "docs/page.md:6: no command"),
        ("<!-- figures: make tset -->\n", "make tset: the Makefile has no target tset"),
        ("<!-- figures: test/test_nothing.py -->\n", "test/test_nothing.py, the owner of figures, does not exist"),
        ("<!-- figures: make test; test/test_docs.py::test_none -->\n", "test/test_docs.py has no test_none"),
        ("`analysis.tracker.Trackers`", "the package has no analysis.tracker.Trackers"),
        ("`codec.decode_all()`", "the package has no codec.decode_all()"),
        ("`daq.rate`", "the package has no daq.rate"),
        ("[x](none.md)", "there is no none.md"),
        ("[x](explanation/physics.md#nothing)", "explanation/physics.md has no heading #nothing"),
    ],
)  # fmt: skip
def test_each_planted_fault_is_named(text, fault):
    (found,) = TOOL["faults"](TOOL["Page"].parse("docs/page.md", text))
    assert found.startswith("docs/page.md:")
    assert fault in found


def test_the_menu_of_make_lists_the_existing_targets():
    menu = re.findall(r"^(\w+):.*##.*?(ARGS=(?:'[^']*'|\S+))", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert len(menu) > 8
    text = "\n".join(f"make {target} {arguments}" for target, arguments in menu)
    page = TOOL["Page"].parse("Makefile", f"```sh\n{text}\n```\n")
    assert list(TOOL["faults"](page)) == []


def test_valid_text_has_no_faults():
    text = (
        "```sh\nmake bench ONLY=physics; make  # all\nmake figures ARGS='paper.svg lab_pictures'\n```\n\n"
        "`build/bench.json`, `test_codec.py`, "
        "`impact-rig recover`, `rig/start`, `analysis/settings`, `impact-rig campaign FILE`, "
        "`~/stop`, `daq.rate_hz`, `analysis.tracker.Tracker`, `e.g.`, [x](explanation/physics.md#equations)\n"
    )
    assert list(TOOL["faults"](TOOL["Page"].parse("docs/page.md", text))) == []


@pytest.mark.parametrize("page", [name for name in TOOL["pages"]() if re.match(r"docs/(?!decisions)", name)])
def test_each_page_begins_with_one_sentence_about_its_purpose(page):
    text = re.sub(r"<!--.*?-->\s*|`[^`]*`", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL)
    title, first = [part.strip() for part in text.split("\n\n") if part.strip()][:2]
    assert title.startswith("# ")
    assert re.findall(r"[.!?](?=\s|$)", first) == ["."]
    assert len(first.split()) <= 32


@pytest.mark.parametrize("block", [block for block in BLOCKS if block.language == "sh"], ids=by_place)
def test_shell_blocks_have_valid_syntax(block):
    done = subprocess.run(["bash", "-n"], input=block.content, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.heavy
@pytest.mark.parametrize("block", [block for block in OURS if block.language == "python"], ids=by_place)
def test_python_blocks_run(block, monkeypatch, tmp_path):
    """A session (`>>>`) prints what the page shows; other code runs to its end."""
    if ">>>" in block.content:
        monkeypatch.chdir(tmp_path)  # it may write
        session = doctest.DocTestParser().get_doctest(block.content, {}, by_place(block), block.page, block.line)
        assert doctest.DocTestRunner().run(session).failed == 0
        return
    monkeypatch.chdir(ROOT)
    exec(compile(block.content, by_place(block), "exec"), {})


@pytest.mark.heavy
@pytest.mark.parametrize("name", impact_rig.__all__)
def test_examples_in_docstrings_of_public_names_run(name, monkeypatch, tmp_path):
    """They print what they show, and every name has one except a few."""
    if name in {"Client", "RosRig"}:
        pytest.importorskip("rclpy")
    for library in {"Run": ["xarray"], "open_run": ["pandas"], "Record": ["matplotlib"]}.get(name, []):
        pytest.importorskip(library)
    text = inspect.getdoc(getattr(impact_rig, name)) or ""
    assert ">>> " in text or name in WITHOUT_EXAMPLE
    assert re.search(rf"\b{name}\b", impact_rig.__doc__ or ""), "help(impact_rig) does not list it"
    monkeypatch.chdir(tmp_path)
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert doctest.DocTestRunner().run(example).failed == 0


@pytest.mark.heavy
def test_the_example_of_the_package_runs():
    assert doctest.testmod(impact_rig).attempted >= 5
    assert doctest.testmod(impact_rig).failed == 0


@pytest.mark.parametrize("block", [block for block in OURS if block.language == "yaml"], ids=by_place)
def test_yaml_blocks_are_accepted(block, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(block.content, encoding="utf-8")
    if block.page == "docs/how-to/campaign.md":
        (tmp_path / "rig.yaml").write_text(dump(RigConfig()), encoding="utf-8")
        assert load_campaign(file).base.daq.rate_hz == 20_000
    elif block.page == "docs/how-to/maps.md":
        assert load_map(file).direction == "both"
    elif block.page == "docs/how-to/import.md":
        assert sorted(refined(Mapping(channels={}), block.content).channels) == ["accelerometer", "base", "laser"]
    elif block.page == "docs/how-to/dynamics.md":
        assert [bool(load_dynamics(file, kind).tasks) for kind in KINDS] == [True] * len(KINDS)
    elif block.page == "docs/how-to/fmu.md":
        assert load_config(file).drive.waveform == "stream"
    else:
        assert len(load_config(file).instruments.faults.planned) == 2


def imported_names() -> set[str]:
    """Return the dotted names of this repository that Python on the pages imports."""
    found = set()
    for block in BLOCKS:
        if block.language == "python":
            code = "\n".join(re.findall(r"^(?:>>>|\.\.\.) (.*)$", block.content, re.MULTILINE)) or block.content
            for node in ast.walk(ast.parse(code)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("impact_rig"):
                    found |= {f"{node.module}.{one.name}" for one in node.names if one.name != "*"}
    return found


def is_in_python(name: str) -> bool:
    """Return whether a dotted name is a module, or an attribute of one that can be reached from it."""
    try:
        pkgutil.resolve_name(name)
    except AttributeError:
        return False
    return True


DOTTED = re.compile(r"`(impact_rig(?:_studies|_lab)?(?:\.\w+)+)(?:\(\))?`((?:(?:,| and|, and| or) `\w+`)*)")


def test_every_dotted_name_on_a_page_can_be_imported():
    """A word that continues a list has the same parent, such as `plan` after `impact_rig_studies.dynamics.orbits`."""
    pytest.importorskip("rclpy")
    found = []
    for page in TOOL["pages"]():
        for name, more in DOTTED.findall((ROOT / page).read_text(encoding="utf-8")):
            parent = name.rpartition(".")[0]
            found += [(page, one) for one in (name, *(f"{parent}.{word}" for word in re.findall(r"`(\w+)`", more)))]
    found = [(page, name) for page, name in found if not name.endswith((".h", ".o"))]  # files of the kernels
    assert len(found) > 10
    assert [(page, name) for page, name in found if not is_in_python(name)] == []


@pytest.mark.heavy
def test_functions_that_accept_a_path_accept_a_string_too():
    """It holds for all public names, and for those that the Python of the pages imports, with their methods."""
    pytest.importorskip("rclpy")
    wrong, seen = [], set()
    for name in {*imported_names(), *(f"impact_rig.{name}" for name in impact_rig.__all__)}:
        if not is_in_python(name):
            continue  # a module that the reader writes
        value = pkgutil.resolve_name(name)
        members = inspect.getmembers(value, inspect.isroutine) if inspect.isclass(value) else []
        for called in [value, *(member for key, member in members if not key.startswith("_"))]:
            try:
                parameters = inspect.signature(called).parameters.values() if callable(called) else ()
            except ValueError:  # of a builtin
                continue
            for one in parameters:
                words = set(re.findall(r"\w+", str(one.annotation)))
                if "Path" in words:
                    seen.add((name.rpartition(".")[2], one.name))
                    wrong += [] if "str" in words else [(name, str(one))]
    assert {("open_study", "directory"), ("open_map", "directory"), ("open_run", "path"), ("export", "target")} <= seen
    assert wrong == []


def test_the_table_of_the_first_measurement_is_consistent():
    """It has the paper's numbers, the closed form, and the reductions that follow from the shown transmissibilities."""
    (block,) = (
        block
        for block in BLOCKS
        if block.page == "docs/tutorials/first_measurement.md" and "no sphere" in block.content
    )
    without = re.search(r"none +([\d.]+) +closed form ([\d.]+)", block.content)
    assert without is not None
    measured, closed_form = map(float, without.groups())
    assert closed_form == round(abs(transmissibility(RigConfig(), FREQUENCY_HZ)), 2)
    rows = [[float(word) for word in row] for row in DEMO_ROW.findall(block.content)]
    assert {row[0] / 1e3: row[4] for row in rows} == REDUCTION_PERCENT
    for _, dt, ours, expanded, paper, difference in rows:
        assert ours == pytest.approx(100.0 * (1.0 - dt / measured), abs=0.01)
        assert 0.0 < expanded < 0.1
        assert difference == pytest.approx(ours - paper, abs=0.06)


def test_the_reductions_on_the_page_of_the_paper_agree_with_their_sources():
    text = (ROOT / "docs" / "explanation" / "paper.md").read_text(encoding="utf-8")
    paper, rig = (
        [float(one) for one in re.findall(r"([\d.]+) %", re.search(rf"^\| {row} \|.*$", text, re.MULTILINE)[0])]
        for row in ("paper", "rig")
    )
    assert paper == list(REDUCTION_PERCENT.values())
    table = (ROOT / "docs" / "tutorials" / "first_measurement.md").read_text(encoding="utf-8")
    assert rig == [round(float(row[2]), 1) for row in DEMO_ROW.findall(table)]


@pytest.mark.heavy
def test_removing_the_sphere_takes_as_long_as_the_first_measurement_states():
    """It is about ten seconds of rig time."""
    text = (ROOT / "docs" / "tutorials" / "first_measurement.md").read_text(encoding="utf-8")
    assert "Click *none* to remove the sphere. After about ten seconds DT is near 110.7." in text
    rig = LocalRig()
    rig.command(frequency_hz=FREQUENCY_HZ, current_a=CURRENT_A)
    rig.run(seconds=12.0)
    rig.core.configure({"sphere.present": False})
    rig.run(seconds=14.0)
    tracker = Tracker()
    tracker.label(0.006, 0)
    tracker.label(0.0, 12 * NS_PER_S)
    tracker.configure(rig.tables("daq/info")[0])
    for table in rig.tables("shaker/applied"):
        tracker.on_applied(table)
    rows = [one.rows[0] for table in rig.tables("daq/scan") for one in tracker.feed(table).measurements]
    without = next(row for row in rows if row["settled"] == 1 and row["gap"] == 0.0)
    assert without["transmissibility"] == pytest.approx(110.4, abs=1.0)
    assert 8.0 < without["waited"] < 12.0


@pytest.mark.parametrize("text", ["`python`", "`ros2`", "`ros2 run impact_rig`", "`make`", "`ros2 param set X`"])
def test_the_bare_name_of_a_program_is_not_checked_as_a_command(text):
    assert list(TOOL["faults"](TOOL["Page"].parse("page.md", text))) == []
