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
"""The command line explains itself: examples, suggestions for wrong words, JSON, 80 columns, plain progress."""

from __future__ import annotations

import argparse
import io
import json
import math
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from kits.recorded_rig import messages, record

from impact_rig.analysis.uncertainty_budget import plus_minus
from impact_rig.cli import main, terminal
from impact_rig.cli.main import HEADINGS, HIDDEN, command_line, commands
from impact_rig.cli.terminal import Console, Steps, TextTable, tell_json
from impact_rig.system.extras import load_ros
from impact_rig.system.files import config_dir

PROGRAM = [sys.executable, "-c", "from impact_rig.cli import main; raise SystemExit(main())"]
NOMINAL = str(config_dir() / "nominal.yaml")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run of twelve seconds without a sphere, with the findings of its live analysis."""
    pytest.importorskip("rclpy")  # runs carry the schemas of the messages
    return record(tmp_path_factory.mktemp("runs") / "no_sphere", messages())


@pytest.fixture(autouse=True)
def terminal_of_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


def pages(
    parser: argparse.ArgumentParser, words: tuple[str, ...] = ()
) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield every command and test with its parser."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, one in action.choices.items():
                yield " ".join((*words, name)), one
                yield from pages(one, (*words, name))


PAGES = dict(pages(command_line()))


def test_a_closed_pipe_ends_the_program_quietly() -> None:
    """The reader ends early in `impact-rig interface --json | head`."""
    with subprocess.Popen([*PROGRAM, "interface", "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert (process.stderr.read(), process.wait()) == (b"", 128 + signal.SIGPIPE)


def test_the_help_lists_the_commands_under_headings() -> None:
    page = command_line().format_help()
    found: dict[str, list[str]] = {}
    for line in page.splitlines():
        if re.fullmatch(r"[A-Z].*:", line):
            found[line[:-1]] = []
        elif word := re.match(r"  (\w+) ", line):
            found[list(found)[-1]].append(word[1])
    found.pop("options", None)
    expected = {name: [one for one in named if one in commands()] for name, named in HEADINGS.items()}
    assert found == {name: named for name, named in expected.items() if named}
    assert {name for named in found.values() for name in named} == {*commands()} - {*HIDDEN}


@pytest.mark.parametrize("name", PAGES)
def test_every_help_page_has_examples_that_parse(name: str) -> None:
    page = PAGES[name].format_help()
    examples = re.findall(r"^  impact-rig (.*)$", page, flags=re.MULTILINE)
    assert examples
    for example in examples:
        words = shlex.split(example.split(">")[0])
        found = command_line(words[0]).parse_args(words)
        assert name in (found.command, f"{found.command} {getattr(found, 'test', '')}")
    assert max(map(len, page.splitlines())) <= 80


WRONG = [
    *((words, f"{words[0]!r} is now `impact-rig drive") for words in (["loop", "hold"], ["play", "x"], ["frf"])),
    (["analyse", "x"], "did you mean `impact-rig analyze`?"),
    (["nothing"], f"the commands are {next(iter(commands()))}"),
]


@pytest.mark.parametrize(("words", "answer"), WRONG)
def test_an_unknown_command_is_answered_with_help(
    words: list[str], answer: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert answer in capsys.readouterr().err


@pytest.mark.heavy
def test_tables_of_measurements_fit_80_columns_without_cuts_or_nan(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["analyze", str(run)]) == 0
    said = capsys.readouterr().out
    assert re.match(r"DT \d+\.\d+ ± \d\.\d+ \(2u\), phase -\d+\.\d+°, at 9.1 Hz", said), "the result comes first"
    assert "nan" not in said
    assert "…" not in said
    for unit in ("[Hz]", "[deg]", "[mm]"):
        assert said.count(unit) == 1
    assert re.search(r"rows left out because they have no value of DT: 1 command_changed \(", said)
    assert max(map(len, said.splitlines())) <= 80
    assert main(["analyze", str(run), "--all"]) == 0
    assert re.search(r"^ +9\.100 .*command_changed", capsys.readouterr().out, flags=re.MULTILINE)


@pytest.mark.heavy
def test_json_contains_the_numbers_of_the_table(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", str(run)]) == 0
    shown = capsys.readouterr().out
    assert main(["analyze", str(run), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    last = [one for one in found["measurements"] if one["settled"]][-1]
    assert f"DT {plus_minus(last['transmissibility'], last['transmissibility_uncertainty'])} (2u)" in shown
    (unmeasured,) = (one for one in found["measurements"] if one["status"] == "command_changed")
    assert unmeasured["transmissibility"] is None
    assert found["live"]["same"] is True
    assert main(["info", str(run), "--json"]) == 0
    about = json.loads(capsys.readouterr().out)
    assert (about["intact"], about["lost_blocks"], about["lost_messages"]) == (True, 0, {})
    assert {one["name"].removeprefix("/rig/"): one["messages"] for one in about["topics"]}["daq/scan"] > 100
    assert main(["analyze", str(run), "--sine", "--json"]) == 0
    sine = json.loads(capsys.readouterr().out)
    assert sine["transmissibility"] == pytest.approx(last["transmissibility"], rel=1e-3)
    assert [one["channel"] for one in sine["channels"]] == ["accelerometer", "laser", "base", "current"]


def test_json_of_a_configuration_names_the_law_and_the_channels(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", NOMINAL, "--instruments", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["contact_law"] == "flores"
    assert found["restitution_realised"] == pytest.approx(0.309, abs=1e-3)
    assert [one["ok"] for one in found["instruments"]] == [True] * 4


def test_units_and_numbers_of_a_table_are_never_cut() -> None:
    table = TextTable()
    for heading in ("frequency [Hz]", "displacement transmissibility", "phase [deg]"):
        table.add_column(heading, justify="right")
    table.add_column("status")
    table.add_row("9.100000", "110.713000", "-119.7400", "word " * 30)
    console = Console()
    console.file, console.width = io.StringIO(), 50
    console.print(table)
    said = console.file.getvalue()
    for whole in ("[Hz]", "[deg]", "9.100000", "110.713000", "-119.7400", "transmissibility"):
        assert whole in said
    assert "…" not in said
    assert max(map(len, said.splitlines())) <= 50


def test_output_has_no_colour_where_colour_is_disabled(monkeypatch: pytest.MonkeyPatch) -> None:
    def styled_text() -> str:
        console = Console()
        console.file = io.StringIO()
        console.print("whole", style="green")
        return console.file.getvalue()

    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert "\x1b[" in styled_text()
    monkeypatch.setenv("NO_COLOR", "1")
    assert styled_text() == "whole\n"


def test_progress_without_a_terminal_is_printed_as_plain_lines(capsys: pytest.CaptureFixture[str]) -> None:
    lines = Steps("runs", 200)
    for done in range(201):
        lines.show(done, "gap 2 mm")
    said = capsys.readouterr()
    assert said.out == "", "results go there"
    printed = said.err.splitlines()
    assert printed[0] == "runs 0 of 200: gap 2 mm"
    assert printed[-1] == "runs 200 of 200: gap 2 mm"
    assert len(printed) <= terminal.LINES + 1


def test_json_output_contains_no_nan_or_infinity(capsys: pytest.CaptureFixture[str]) -> None:
    tell_json({"a": math.nan, "b": (1.5, math.inf), "c": Path("x"), 4: b"word"})
    assert json.loads(capsys.readouterr().out) == {"a": None, "b": [1.5, None], "c": "x", "4": "word"}


@pytest.mark.parametrize("words", [("check", "{}", "--json"), ("campaign", "{}", "--output", "{}_run")])
def test_a_file_name_that_is_not_utf_8_is_printed_unchanged(words: tuple[str, ...], tmp_path: Path) -> None:
    """Results appear on the terminal even if the locale is strict about UTF-8."""
    file = tmp_path / os.fsdecode(b"m\xff 1.yaml")
    study = "studies: {one: {frequencies_hz: 9.1, gaps_m: 0.01}}\nset: {daq.rate_hz: 1000}\n"
    file.write_text("daq: {rate_hz: 1000}\n" if words[0] == "check" else study)
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}
    asked = [word.format(file) for word in words]
    done = subprocess.run([*PROGRAM, *asked], env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    if "--json" in words:
        assert json.loads(done.stdout)["path"] == str(file)
    else:
        assert os.fsdecode(done.stdout.splitlines()[-1]) == f"{file}_run"


@pytest.mark.parametrize(
    ("line", "expected"),
    [("impact-rig an", {"analyze"}), ("impact-rig analyze --fi", {"--figures"}), ("impact-rig check --js", {"--json"})],
)
def test_tab_completes_commands_and_options(line: str, expected: set[str], tmp_path: Path) -> None:
    pytest.importorskip("argcomplete")
    answer = tmp_path / "answer"
    environment = {
        "_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)),
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer), "_ARGCOMPLETE_IFS": "\n", "PATH": "/usr/bin:/bin",
    }  # fmt: skip
    subprocess.run(PROGRAM, env=environment, check=True, capture_output=True)
    assert {word.strip() for word in answer.read_text().split("\n")} == expected


ROS = "rclpy|rosidl_runtime_py|.*_(msgs|srvs)"
WITHOUT = """\
import re, sys

missing = sys.argv.pop(1)

class Removed:
    def find_spec(self, name, path=None, target=None):
        if re.fullmatch(missing, name.partition(".")[0]):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Removed())
"""
PROGRAM_OF_NAME = """\
import importlib.metadata
[entry] = importlib.metadata.entry_points(group="console_scripts", name=sys.argv[1])
del sys.argv[0]
raise SystemExit(entry.load()())
"""


def without(missing: str, folder: Path, source: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a Python program where some libraries are not installed."""
    command = [sys.executable, "-c", WITHOUT + source, missing, *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


def reported_without(missing: str, line: str, folder: Path) -> str:
    """Run a command or an installed program where some libraries are not; return what it reports to need."""
    program, *words = line.split()
    if program not in (*commands(), *(one.name for one in entry_points(group="console_scripts"))):
        pytest.skip("the package of this program is not installed")
    begin = ("impact-rig", program) if program in commands() else (program,)
    done = without(missing, folder, PROGRAM_OF_NAME, *begin, *words)
    assert (done.returncode, done.stdout, [*folder.iterdir()]) == (1, "", []), done.stderr
    head, _, needs = done.stderr.partition(f"{program} needs ")
    assert "\n" not in head
    return needs


@pytest.mark.parametrize(
    "line",
    [
        "demo", "record --through ros", "record --through running", "drive sweep --through ros",
        "drive backbone --currents 0.1 0.2 --through ros", "drive random plan.yaml --through running",
        "drive shock --through ros", "campaign file.yaml --through ros", "daqmx --namespace /rig", "replay run",
        "lab --no-browser --port 0", "lab --attach", "rig_node", "analysis_node", "recorder_node", "plot_node",
        "lab_node", "stepped_sine_node",
    ],
)  # fmt: skip
def test_one_line_names_the_remedy_if_ros_is_missing_and_no_file_is_created(line: str, tmp_path: Path) -> None:
    needs = reported_without(ROS, line, tmp_path)
    assert re.fullmatch(r"ROS 2 Jazzy \(No module [^\n]*\[wheels\][^\n]*\n", needs)


@pytest.mark.parametrize("line", ["lab --sample", "lab_node"])
def test_one_line_names_the_remedy_if_the_library_of_the_page_is_missing(line: str, tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="lab_node needs ROS 2 first")
    needs = reported_without("aiohttp", line, tmp_path)
    assert needs == "aiohttp, which is not installed: pip install 'impact_rig[lab]'\n"


@pytest.mark.parametrize("name", ["RosRig", "Client", "driver.RosRig", "client.Collector", "testing.LocalRigWithNodes"])
def test_a_class_that_needs_ros_names_the_remedy_if_it_is_missing(name: str, tmp_path: Path) -> None:
    package, _, one = f"impact_rig.{name}".rpartition(".")
    done = without(ROS, tmp_path, f"from {package} import {one}")
    last = done.stderr.splitlines()[-1]
    assert re.fullmatch(rf"\S+ImpactRigError: \S+\.{one} needs ROS 2 Jazzy \(No module .*\[wheels\].*", last), last


def test_a_missing_module_of_this_project_is_not_reported_as_a_missing_library() -> None:
    with pytest.raises(ModuleNotFoundError):
        load_ros("impact_rig.absent", "a test")


def test_every_command_that_can_run_through_ros_declares_it() -> None:
    declared = []
    for words, parser in pages(command_line()):
        (way,) = [one for one in parser._actions if "--through" in one.option_strings] or [None]
        if way is not None and "ros" in (way.choices or (way.help or "").replace("(", " ").split()):
            assert parser.get_default("needs_ros") is not None, words
            declared.append(words)
    assert declared


def test_characters_that_the_output_cannot_encode_are_escaped_as_in_json(run: Path, tmp_path: Path) -> None:
    """A traceback would have the exit code of `different`."""
    file = tmp_path / "gäp ± 😀"
    file.symlink_to(run)
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    printed = []
    for words in (["analyze", str(file)], ["info", str(file)], ["analyze", "--help"]):
        done = subprocess.run([*PROGRAM, *words], env=environment, capture_output=True, check=False)
        assert (done.returncode, done.stderr) == (0, b"")
        assert done.stdout.isascii()
        printed.append(done.stdout)
    done = subprocess.run([*PROGRAM, "info", str(file), "--json"], env=environment, capture_output=True, check=False)
    assert Path(json.loads(done.stdout)["path"]).name == file.name
    assert rb"DT 110" in printed[0]
    assert rb" \u00b1 " in printed[0]
