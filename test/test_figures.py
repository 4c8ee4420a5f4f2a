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
"""Every figure of README and docs is as the code draws it and is used, and all of them together are small."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from PIL import Image

pytest.importorskip("rclpy", reason="pictures of the nodes are made from the nodes")

from tools.figures import COMMAND, DRAWN, IMAGES, digests, there
from tools.figures.same import difference
from tools.figures.style import DARK
from tools.generate import generated

ROOT = Path(__file__).parents[1]
MOST_BYTES = 3_000_000
GENERATED = [path.name for path in generated() if path.parent == IMAGES]  # compared in test_generated.py
TAKEN = [picture for pictures in there().values() for picture in pictures]
ALL = (*DRAWN, *GENERATED, *TAKEN)
SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize("name", DRAWN)
def test_each_drawing_equals_the_output_of_the_code(name):
    assert difference((IMAGES / name).read_text(encoding="utf-8"), DRAWN[name]()) is None, f"run `{COMMAND}`"


def test_every_picture_is_made_by_the_command():
    assert {path.name for path in IMAGES.iterdir()} == set(ALL)


def test_every_picture_is_used_on_a_page():
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md")]
    texts = "".join(path.read_text(encoding="utf-8") for path in pages)
    assert [name for name in ALL if f"images/{name}" not in texts] == []


def test_the_total_size_of_the_pictures_is_bounded():
    assert sum(path.stat().st_size for path in IMAGES.iterdir()) <= MOST_BYTES


@pytest.mark.parametrize("name", [*DRAWN, *GENERATED])
def test_each_drawing_has_a_text_alternative_and_colours_for_dark_mode(name):
    text = (IMAGES / name).read_text(encoding="utf-8")
    root = ET.fromstring(text)
    assert root.get("aria-label") or root.findtext(f"{SVG}title")
    assert "prefers-color-scheme: dark" in text
    assert not re.search(r"(?:href|src)=\"(?!#)", text), "it asks for something else"


@pytest.mark.parametrize("name", DRAWN)
def test_each_drawing_uses_only_colours_of_the_palette(name):
    """Okabe and Ito's palette suits any colour vision; each colour is a variable with values for light and for dark."""
    drawn = (IMAGES / name).read_text(encoding="utf-8").partition("</style>")[2]
    assert set(re.findall(r"(?<!&)#[0-9a-f]{3,8}\b", drawn)) == set()
    assert set(re.findall(r"var\(--([\w-]+)\)", drawn)) <= {*DARK, "sheet", "card"}


@pytest.mark.heavy
@pytest.mark.parametrize("name", TAKEN)
def test_each_picture_shows_the_present_page(name):
    """A picture of an old page must make the test fail."""
    known = digests.written()
    assert name in known, f"run `{COMMAND}`"
    assert digests.of_file(IMAGES / name) == known[name]["file"], f"not made by `{COMMAND}`"
    assert digests.shown(name, known[name].get("at", {})) == known[name]["shows"], (
        f"what it shows has changed: run `{COMMAND}`, and look at it"
    )


@pytest.mark.heavy
@pytest.mark.parametrize("name", digests.STUDIES)
def test_the_reduced_plan_of_a_picture_contains_all_its_regimes(name):
    """A plan with only regular motions would not show a change of the chaotic and rare motions of a picture."""
    known = digests.written()[name]
    at = known.get("at", {})
    whole, few = digests.plan_of(digests.STUDIES[name][1]), digests.thinned(name, at)
    assert differences(whole, few) <= {*at, "values", "optimum", "cycles", "points"}
    if at:
        table, _ = digests.miniature(name, at)
        marched = {"intermittent"} if "bifurcation" in name else set()  # rare, and it depends on the values before
        assert {*digests.regimes(table)} | marched == {*known["regimes"]} | marched


def differences(one: dict, other: dict) -> set[str]:
    """Return the keys, at any depth, whose values differ."""
    keys = {key for key in {*one, *other} if one.get(key) != other.get(key)}
    nested = {key for key in keys if isinstance(one.get(key), dict) and isinstance(other.get(key), dict)}
    return (keys - nested).union(*(differences(one[key], other[key]) for key in nested))


def test_the_digest_of_the_page_follows_its_elements_texts_and_styles(tmp_path, monkeypatch):
    for file in digests.STATIC.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path.parent / "words.json").write_bytes((digests.STATIC.parent / "words.json").read_bytes())
    monkeypatch.setattr(digests, "STATIC", tmp_path)
    before = digests.page.__wrapped__()
    for name, old, new in (
        ("index.html", "<h2", "<!-- a remark --><h2"), ("style.css", "{", "{ /* a remark */"),
        ("main.js", "export", "// a remark of some words\nexport"),
    ):  # fmt: skip
        path = tmp_path / name
        path.write_text(path.read_text().replace(old, new, 1))
    assert digests.page.__wrapped__() == before
    for name, old, new in (("index.html", "<h2", "<h3"), ("style.css", "color", "colour")):
        path = tmp_path / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))
        assert digests.page.__wrapped__() != before
        path.write_text(text)


@pytest.mark.parametrize("name", TAKEN)
def test_each_picture_is_a_valid_file(name):
    with Image.open(IMAGES / name) as picture:
        picture.verify()


ONE = '<svg viewBox="0 0 500 300"><title>t</title><path d="M 1.0 2.0" stroke="#123456"/><text x="3">9.1 Hz</text></svg>'


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (("2.0", "2.4"), None),  # less than 1e-3 of 500
        (("2.0", "2.6"), "a coordinate differs by 0.6 of 500"),
        (('x="3"', 'x="2.9"'), None),
        (("9.1 Hz", "9.2 Hz"), "the texts differ"),
        (("#123456", "#123457"), "the colours differ"),
        (("M 1.0 2.0", "M 1.0 2.0 L 1.0 2.0"), "the elements differ"),
        (("viewBox", "box"), "the elements differ"),
    ],
)
def test_only_differences_that_a_cpu_may_cause_are_ignored(change, found):
    assert difference(ONE, ONE.replace(*change)) == found
