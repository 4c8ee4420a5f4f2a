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
"""Text from outside appears on the terminal as plain text, never as markup, colour or a control command."""

from __future__ import annotations

import ast
import io
from pathlib import Path

import pytest
from rich.progress import Progress
from rich.table import Table

from impact_rig.cli import main
from impact_rig.cli.terminal import Console, TextTable, Words, figure
from impact_rig.names import visible

CLI = Path(__file__).parents[3] / "impact_rig" / "cli"
TRICKS = "run [gap=2mm] x [/red] :smile: \x1b[31m\x1b]0;title\x07 \u202e \r\n\ud800"
SHOWN = "run [gap=2mm] x [/red] :smile: \\x1b[31m\\x1b]0;title\\x07 \\u202e \\r\\n\\ud800"


def test_invisible_characters_are_shown_as_escapes() -> None:
    assert visible(TRICKS) == SHOWN
    assert visible("gap 6 mm, ±2u, χ², 测") == "gap 6 mm, ±2u, χ², 测"
    assert visible("a\nb\x1b", lines=True) == "a\nb\\x1b"


def test_a_missing_value_is_not_shown_as_a_number() -> None:
    assert figure(1.234, ".2f") == "1.23"
    assert {figure(value, "+.3g") for value in (float("nan"), float("inf"), -float("inf"))} == {"-"}
    assert figure(float("nan"), "g", "unknown") == "unknown"


def test_a_value_that_rounds_to_zero_has_no_sign() -> None:
    shown = [figure(-0.004, ".2f"), figure(-0.004, "+.2f"), figure(-0.0, "g"), figure(-0.006, ".2f")]
    assert shown == ["0.00", "0.00", "0", "-0.01"]


def drawn(what: object) -> str:
    console = Console()
    console.file = io.StringIO()
    console.width = 200
    console.print(what)
    return console.file.getvalue()


def test_text_with_markup_is_printed_unchanged() -> None:
    assert drawn(TRICKS) == f"{SHOWN}\n"


def test_text_in_tables_and_headings_is_printed_unchanged() -> None:
    table = Table(TRICKS, title=TRICKS, caption=TRICKS)
    table.add_row(TRICKS)
    assert drawn(table).count(SHOWN) == 4


@pytest.mark.parametrize("width", [80, 38, 12])
def test_numbers_in_a_table_keep_all_their_digits(width: int) -> None:
    """If 9.105 Hz were cut to 9.10, it would be another frequency."""
    console = Console()
    console.file, console.width = io.StringIO(), width
    table = TextTable(left=("what",), right=("f [Hz]", "DT", "u(DT)", "phase [deg]", "gap [mm]"))
    table.add_row("a long name", "9.105", "63.567", "0.160", "-119.73", "6.25")
    console.print(table)
    shown = console.file.getvalue()
    assert all(number in shown for number in ("9.105", "63.567", "0.160", "-119.73", "6.25")), shown


@pytest.mark.parametrize("width", [80, 38, 12])
def test_a_column_without_a_heading_keeps_its_text_in_one_piece(width: int) -> None:
    """A column without a heading must not be so narrow that its text is split into letters, or missing."""
    console = Console()
    console.file, console.width = io.StringIO(), width
    table = TextTable(right=("frequency [Hz]", "DT measured", "± 2u", "DT model", "off [u]"), last=("",))
    table.add_row("9.105", "63.567", "0.160", "61.012", "+254214.2", "differs")
    console.print(table)
    assert all(word in console.file.getvalue() for word in ("differs", "+254214.2"))


@pytest.mark.parametrize("width", [80, 38])
def test_a_right_aligned_text_keeps_all_its_words(width: int) -> None:
    console = Console()
    console.file, console.width = io.StringIO(), width
    table = TextTable(right=("f [Hz]", "DT", "± 2u", "superior [mm]", "phase [°]", ""))
    table.add_row("9.10521", "105.76", "0.95", "10.562", "-89.91", "not locked, JUMP")
    console.print(table)
    assert "not locked, JUMP" in console.file.getvalue()


def test_text_in_a_progress_display_is_printed_unchanged() -> None:
    console = Console()
    console.file = io.StringIO()
    console.width = 200
    with Progress(Words("{task.description}"), Words("{task.fields[state]}"), console=console) as progress:
        progress.add_task(TRICKS, state=TRICKS)
    assert console.file.getvalue().count(SHOWN) == 2


@pytest.mark.parametrize("name", ["run [gap=2mm] x", "[/red]", "\x1b[31m"])
@pytest.mark.parametrize("command", ["info", "check", "replay", "verify"])
def test_file_names_are_printed_unchanged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, name: str
) -> None:
    assert main([command, str(tmp_path / name)]) == 1
    shown = capsys.readouterr().err
    assert visible(name) in shown
    assert "\x1b" not in shown


def test_all_modules_print_through_the_console_of_the_package() -> None:
    """A module that imports rich's own console, or its columns that parse markup, would bypass ours."""
    for path in CLI.glob("*.py"):
        if path.name == "terminal.py":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                assert node.module != "rich.console", path
                assert "TextColumn" not in {alias.name for alias in node.names}, path
