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
"""A report of hostile names runs nothing, fetches nothing, and writes nothing outside its directory."""

from __future__ import annotations

import base64
import csv
import hashlib
import re
from html.parser import HTMLParser

import pytest
from kits.hostile_names import HOSTILE_NAMES, hostile_campaign

from impact_rig.cli import main
from impact_rig.drawing import Drawn, new_axes, style
from impact_rig.names import file_name
from impact_rig_studies.report import page
from qualification.check_report import VIEWS, shown

pytestmark = pytest.mark.heavy

POLICY = re.compile(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)">')


class Elements(HTMLParser):
    """Parser that collects the elements of a page and the names of their attributes."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes = set(), set()
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attributes}


def assert_harmless(text):
    """Assert that a page has no element or attribute that runs or fetches, and a policy that would forbid both."""
    found = Elements(text)
    assert not found.tags & {"script", "img", "iframe", "object", "embed", "form", "base"}
    assert not [name for name in found.attributes if name.startswith("on") or name == "style"]
    (policy,) = POLICY.findall(text)
    (sheet,) = re.findall(r"<style>(.*?)</style>", text, flags=re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(sheet.encode()).digest()).decode()
    assert policy.replace("&#39;", "'") == (
        f"default-src 'none'; style-src 'sha256-{digest}'; img-src data:; base-uri 'none'; form-action 'none'"
    )


def tree(folder):
    """Return every path below a folder, except those in its `campaign`."""
    return {path for path in folder.rglob("*") if "campaign" not in path.relative_to(folder).parts}


FEW = (
    *HOSTILE_NAMES[:4], r"\g<1>", "$x^$", "=HYPERLINK(1)", "-2+3", "x/../../../escaped", "..", "a\nb",
    "\x1b]0;title\x07\x1b[31m", "url(#a)",
)  # fmt: skip
"""One name for each way in which a text could act; each study has a drawing, which takes most of the time."""


@pytest.fixture(scope="module", params=[FEW, pytest.param(HOSTILE_NAMES, marks=pytest.mark.slow)], ids=["few", "all"])
def studies(request):
    return request.param


@pytest.fixture(scope="module")
def reported(studies, tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile") / "a" / "b" / "c" / "d"
    folder.mkdir(parents=True)
    directory = hostile_campaign(folder / "campaign", studies=studies)
    before = tree(folder.parents[3])
    (directory / "figures").mkdir()
    (directory / "figures" / "study_x").mkdir()
    (directory / "figures" / "study_").symlink_to(folder)
    # svg: it is drawn for the page anyway; `test_names` draws all names in all formats
    assert main(["report", str(directory), "--format", "svg"]) == 0
    assert tree(folder.parents[3]) == before
    return directory


def test_the_page_contains_every_name_as_text_and_no_active_content(reported):
    text = (reported / "report.html").read_text()
    assert_harmless(text)
    assert "&lt;img src=x onerror=alert(1)&gt;" in text
    assert "{{ 7*7 }}" in text


def test_every_file_is_in_the_directory_and_has_a_plain_name(reported, studies):
    figures = reported / "figures"
    assert list((figures / "study_x").iterdir()) == []
    made = [path.name for path in figures.iterdir() if path.is_file()]
    assert len(made) > len(studies)
    assert [name for name in made if not re.fullmatch(r"\w[\w.+=,-]*\.(png|svg|pdf|csv)", name, re.ASCII)] == []


def test_no_cell_of_a_csv_table_is_a_formula(reported, tmp_path):
    assert main(["export", str(reported), "points", str(tmp_path / "points.csv")]) == 0
    for file in [*reported.rglob("*.csv"), tmp_path / "points.csv"]:
        for row in csv.reader(file.read_text().splitlines()):
            for cell in row:
                assert not cell.strip().startswith(("=", "@")), file
                assert not re.match(r"\s*[+-](?![\d.]+(e[+-]\d+)?$)", cell), file


def test_a_link_in_place_of_the_figures_is_not_followed(reported, tmp_path, capsys):
    directory = hostile_campaign(tmp_path / "campaign", studies=HOSTILE_NAMES[:1])
    (tmp_path / "elsewhere").mkdir()
    (directory / "figures").symlink_to(tmp_path / "elsewhere")
    assert main(["report", str(directory)]) == 1
    assert "links are not followed for writing" in capsys.readouterr().err
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_browser_runs_and_fetches_nothing_and_applies_the_style(reported, browser):
    with shown(browser, reported / "report.html", *VIEWS[0]) as seen:
        assert seen.errors == []
        assert [one for one in seen.fetched if not one.startswith(("file:", "data:"))] == []
        assert seen.js("document.styleSheets.length") == 1
        assert seen.js("getComputedStyle(document.querySelector('figure svg path')).strokeLinejoin") == "round"
        assert seen.js("document.querySelectorAll('img, script').length") == 0


def drawn(name):
    with style():
        figure, (axis,) = new_axes()
        axis.plot([0.0, 1.0], [0.0, 1.0])
        axis.set_axis_off()  # numbers take most of the time
        axis.set_title(name)
        return Drawn(f"d_{name}", figure, name)


@pytest.mark.parametrize("name", HOSTILE_NAMES, ids=file_name)
def test_every_part_of_a_page_accepts_any_name(name):
    sections = [page.section(name, page.paragraph(name), page.figures([drawn(name)]))]
    parts = [
        page.title(name), page.cover([(name, name)]), page.contents(sections), *sections, page.heading(name),
        page.table([name, "n"], [[name, "pass"]], [1]), page.tiles([(name, name)]),
        page.folded(name, page.paragraph(name)), page.links([(name, name)]),
    ]  # fmt: skip
    text = page.page(name, parts)
    assert_harmless(text)
    assert name != "{{ 7*7 }}" or text.count(name) > 8
