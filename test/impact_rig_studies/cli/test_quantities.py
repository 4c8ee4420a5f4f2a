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
"""Quantities on the command line: units, ranges and words of every option that takes one."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import attrs
import pytest

from impact_rig.cli import main
from impact_rig.cli.main import command_line
from impact_rig.cli.quantities import GAP, Quantity, positive
from impact_rig.config import FieldInfo
from impact_rig.config.sections import Drive
from impact_rig.errors import ConfigError
from impact_rig_studies.cli.parsers import GAP_LABEL
from impact_rig_studies.operate.plans import HoldPlan

LENGTH_OPTIONS = {"--gap", "--drop", "--abort"}


def options(parser: argparse.ArgumentParser, name: str = "") -> Iterator[tuple[str, argparse.Action]]:
    """Yield every option and argument of a parser and of its subcommands, with the words that lead to it."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, one in action.choices.items():
                yield from options(one, f"{name} {word}".strip())
        else:
            yield name, action


OPTIONS = list(options(command_line()))
LENGTHS = [
    (name, action) for name, action in OPTIONS if isinstance(action.type, Quantity) and action.type.about.unit == "m"
]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("6mm", 0.006), ("0.006m", 0.006), ("6 mm", 0.006), ("0.6cm", 0.006), ("6000um", 0.006), ("6000 µm", 0.006),
        ("6000μm", 0.006), ("6e-3m", 0.006), (".3mm", 0.0003), ("none", 0.0),
    ],
)  # fmt: skip
def test_a_length_is_the_same_number_in_every_unit(text: str, value: float) -> None:
    assert GAP.parse(text) == value


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.6", "a length needs a unit after the number, e.g. 6mm or 0.006m, or the word none, got '0.6'"),
        ("6", "a length needs a unit after the number"),
        ("0", "a length needs a unit after the number"),
        ("6kg", "the unit must be one of m, cm, mm, um"),
        ("6MM", "the unit must be one of"),
        ("wide", "must be a number with its unit, e.g. 6mm, or the word none, got 'wide'"),
        ("nanmm", "must be a number"),
        ("inf", "must be a number"),
        ("6,5mm", "must be a number"),
        ("", "must be a number"),
        ("0mm", "must be >= 1e-06 and <= 1 m, got '0mm'"),
        ("2m", "must be >= 1e-06 and <= 1 m"),
        ("1e999m", "must be >= 1e-06"),
    ],
)
def test_an_invalid_length_is_rejected_with_a_hint(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        GAP.parse(text)
    assert message in str(error.value)


def test_other_quantities_may_omit_the_unit() -> None:
    frequency = Quantity.of(attrs.fields(Drive).frequency_hz)
    assert frequency.parse("9.1") == frequency.parse("9.1Hz") == frequency.parse("9100 mHz") == 9.1
    assert positive("A").parse("520mA") == 0.52
    assert positive("m/s²").parse("3m/s²") == positive("m/s²").parse("3 m/s2") == 3.0
    with pytest.raises(ConfigError, match="one of Hz, mHz, kHz"):
        frequency.parse("9.1 rpm")
    with pytest.raises(ConfigError, match="must be a number in Hz"):
        frequency.parse("fast")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2", "must be > 0 and <= 0.5, got '2'"),
        ("x", "must be a number without a unit, got 'x'"),
        ("0.1-", "must be a number without a unit, got '0.1-'"),
    ],
)
def test_a_message_about_a_quantity_without_a_unit_names_none(text: str, message: str) -> None:
    tolerance = Quantity.of(attrs.fields(HoldPlan).tolerance)
    assert tolerance.parse("0.1") == 0.1
    with pytest.raises(ConfigError) as error:
        tolerance.parse(text)
    assert str(error.value) == message


def test_an_option_accepts_a_length_or_the_name_of_a_signal() -> None:
    assert GAP_LABEL.parse("6mm") == 0.006
    assert GAP_LABEL.parse("gap column") == "gap column"
    assert GAP_LABEL.parse("2nd") == "2nd"
    with pytest.raises(ConfigError, match="needs a unit"):
        GAP_LABEL.parse("6")


def test_an_option_has_one_meaning_in_every_command() -> None:
    """The placeholder of its value shows it: the same everywhere, unless a signal of a file may be named instead."""
    values: dict[str, set[str]] = {}
    for name, action in OPTIONS:
        assert action.help, f"{name} {action.option_strings or action.dest} has no help"
        for option in action.option_strings:
            values.setdefault(option, set()).add(str(action.metavar or action.choices or action.nargs))
    several = {option: found for option, found in values.items() if len(found) > 1}
    assert set(several) == {"--frequency", "--gap", "--reference", "--through"}, several
    assert several["--frequency"] == {"HZ", "HZ|SIGNAL"}
    assert several["--gap"] == {"LENGTH", "LENGTH|SIGNAL"}
    assert values["--output"] == values["--figures"] == {"DIR"}
    assert values["--scan-rate"] == {"HZ"}


def test_every_length_of_every_command_needs_a_unit() -> None:
    """Options with a length have the one type for lengths, and no other option accepts a length."""
    assert {option for _, action in LENGTHS for option in action.option_strings} == LENGTH_OPTIONS - {"--abort"}
    commands = {name for name, action in OPTIONS if "--gap" in action.option_strings}
    assert commands == {name for name, action in LENGTHS if "--gap" in action.option_strings}
    assert {
        "drive play",
        "drive frf",
        "import",
        "drive hold",
        "drive lock",
        "drive backbone",
        "drive random",
    } <= commands
    for _, action in OPTIONS:
        assert action.metavar not in ("M", "MM", "U_M"), action.option_strings


@pytest.mark.parametrize(("name", "action"), LENGTHS, ids=[f"{n} {a.option_strings}" for n, a in LENGTHS])
def test_a_length_without_a_unit_is_rejected_in_every_command(
    name: str, action: argparse.Action, capsys: pytest.CaptureFixture[str]
) -> None:
    needed = [
        "x.csv" if other.type is not None else str(next(iter(other.choices)) if other.choices else "60um")
        for command, other in OPTIONS
        if command == name and not other.option_strings and other.nargs in (None, "+")
    ]
    required = [
        word
        for command, other in OPTIONS
        if command == name and other.required and other.option_strings
        for word in (other.option_strings[-1], "1")
    ]
    with pytest.raises(SystemExit) as ended:
        main([*name.split(), *needed, *required, action.option_strings[0], "0.6"])
    assert ended.value.code == 2
    assert (
        f"argument {action.option_strings[0]}: a length needs a unit after the number, e.g. 6mm"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["base"], "base: must be a number with its unit, e.g. 6mm"),
        (["mass=1"], "the channel must be one of accelerometer, laser, base, current"),
        (["laser=0.005"], "laser: a length needs a unit after the number"),
        (["current=2A", "base=-1mm"], "base: must be > 0 m"),
        (["current=2mm"], "current: the unit must be one of A, mA"),
    ],
)
def test_invalid_limits_are_rejected(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["drive", "shock", "--abort", *words])
    assert message in capsys.readouterr().err


def test_the_parser_has_the_unit_and_range_of_its_field() -> None:
    assert GAP.about.unit == "m"
    assert (GAP.about.low, GAP.about.high) == (1e-6, 1)
    assert Quantity(FieldInfo("", "Pa", low=0.0)).parse("3Pa") == 3.0
