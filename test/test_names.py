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
"""Names from outside are treated as data wherever they are written."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kits.hostile_names import HOSTILE_NAMES

from impact_rig import names
from impact_rig.drawing import Drawn, Line, new_axes, style
from impact_rig.names import FIGURE_FORMATS

ANY = st.one_of(st.text(), st.sampled_from(HOSTILE_NAMES))


@given(ANY)
def test_a_file_name_stays_in_its_directory(text):
    found = names.file_name(text)
    assert re.fullmatch(r"[\w+=,][\w.+=,-]*", found, re.ASCII)
    assert len(found) <= 120
    assert names.file_name(found) == found


@given(ANY, ANY)
def test_different_names_give_different_files_and_identifiers(one, other):
    assert (names.file_name(one) == names.file_name(other)) == (one == other)
    assert (names.identifier(one) == names.identifier(other)) == (one == other)


def test_studies_whose_names_differ_in_one_sign_have_their_own_figures():
    assert len({names.identifier(name) for name in ("study_a_b", "study_a-b", "study_a b", "study_a__b")}) == 4


@pytest.mark.parametrize("name", ["gap_6mm", "fig8a_gap_2.5mm", "run_20260101_120000", "a=1,b=2"])
def test_an_ordinary_name_is_its_own_file_name(name):
    assert names.file_name(name) == name


@given(ANY)
def test_an_identifier_is_valid_in_every_format(text):
    assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", names.identifier(text))


@given(ANY)
def test_a_log_line_is_one_line_of_visible_characters(text):
    line = names.one_line(text)
    assert line.isprintable()
    assert len(line) <= 10 * names.LONGEST_LINE + 60  # an invisible character becomes up to ten visible ones


def test_a_long_text_keeps_its_ends():
    assert names.one_line("a" * 3_000_000 + "end") == "a" * 1000 + " … (3000003 characters) … " + "a" * 997 + "end"


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        ("=HYPERLINK(1)", "'=HYPERLINK(1)"), ("+1+1", "'+1+1"), ("-2+3", "'-2+3"), ("@SUM(A1)", "'@SUM(A1)"),
        ("\t=1", "'\t'=1"), (" =1+1", "' =1+1"), ("a;=1+1", "a;'=1+1"), ("a\n=1", "a\n'=1"),
        ("\uff1d1+1", "'\uff1d1+1"), ("\ufeff=1+1", "'\ufeff=1+1"), ("\u200b@SUM(A1)", "'\u200b@SUM(A1)"),
        ("\x00=1+1", "'\x00=1+1"), ("\xa0+1+1", "'\xa0+1+1"),
        ("-2.5", "-2.5"), ("+1e-3", "+1e-3"), ("-", "-"), ("gap 6 mm, up", "gap 6 mm, up"), (-2.5, -2.5), ("", ""),
    ],
)  # fmt: skip
def test_a_cell_never_becomes_a_formula(text, cell):
    assert names.csv_cell(text) == cell


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (np.float64(0.5), "0.5"), ((np.float64(1.5), np.int32(2)), "(1.5, 2)"), ("a" * 300, f"'{'a' * 199}..."),
        (10**31, "a number too large to represent"), ([16**5000], "a number too large to represent"),
        (np.float64("nan"), "nan"), (b"x", "b'x'"),
    ],
)  # fmt: skip
def test_a_quoted_value_is_short_and_reads_as_python_writes_it(value, shown):
    assert names.quoted(value) == shown


def test_only_symbols_of_the_package_are_typeset():
    for own in ("$x_1$ (mm)", "transmissibility $|X_1|/|X_b|$", r"$K_f,\ k_f,\ c_f$", "$m_a + m_b$"):
        assert names.plot_text(own) == own
    assert names.plot_text("$x^$") == r"\$x^\$"
    assert names.plot_text("$x_1_2$") == r"\$x_1_2\$"
    assert names.plot_text("a $ sign") == r"a \$ sign"


@style()
def drawing_of(name, labels, height_inch=3.0):
    """Return a drawing with a name in all places for texts, and for each label a line and a text."""
    figure, (axis,) = new_axes(height_inch)
    for i, label in enumerate(labels):
        axis.plot([0.0, 1.0], [0.0, 1.0], label=f"case {label}")
        axis.text(0.0, i / len(labels), label)
    axis.legend()
    axis.set(xlabel=name, ylabel="$x_1$ (mm)", xticks=[], yticks=[])  # numbers take most of the time
    axis.set_title(name, loc="left")
    return Drawn(f"study_{name}", figure, name, [Line(name, {name: [1.0]})])


@pytest.mark.heavy
def test_all_names_are_drawn_in_all_formats(tmp_path):
    """One drawing has all names, because each PDF takes half a second for its fonts."""
    drawn = drawing_of(HOSTILE_NAMES[0], HOSTILE_NAMES, 16.0)
    drawn.save(tmp_path, FIGURE_FORMATS)
    for kind, first in (("svg", b"<?xml"), ("png", b"\x89PNG"), ("pdf", b"%PDF")):
        assert (tmp_path / f"{drawn.name}.{kind}").read_bytes().startswith(first)
    shown = [words.get_text() for words in drawn._figure.axes[0].get_legend().get_texts()]
    assert len(shown) == len(HOSTILE_NAMES)


@pytest.mark.heavy
@pytest.mark.parametrize("name", HOSTILE_NAMES, ids=names.file_name)
def test_a_drawing_shows_any_name_unchanged(name, tmp_path):
    drawn = drawing_of(name, [name])
    folder = tmp_path / "figures"
    folder.mkdir()
    drawn.save(folder, ("svg",))
    made = {path.name for path in tmp_path.rglob("*")}
    assert made == {"figures", *(f"{drawn.name}.{suffix}" for suffix in ("svg", "csv"))}
    assert drawn.name == names.file_name(f"study_{name}")
    assert "<script" not in drawn.svg + drawn.inline()
    assert "<img" not in drawn.svg + drawn.inline()
    if name in ("$x^$", r"a\q", "$x_1_2$", "url(#a)", 'id="f"'):
        assert f">{name}</text>" in drawn.inline()
