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
"""axe finds no serious fault on pages of the website and of the lab, wide and light, narrow and dark.

The rules are those of axe-core as the package axe-core-python ships them; the pages are opened in a real Chromium.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("aiohttp", reason="the extra [lab] is not installed")

from kits.browser import serious_faults

from impact_rig.driver.sample_run import make_sample
from impact_rig_lab.playback import PlaybackSource
from impact_rig_lab.server import Server

WIDE, NARROW = 1280, 400
OF_EACH_KIND = 2
FEW = f"""(() => {{ const seen = {{}}; for (const one of document.querySelectorAll(".doc-object")) {{
  const kind = `${{one.parentElement?.className}}/${{one.className}}`;
  if ((seen[kind] = (seen[kind] ?? 0) + one.isConnected) > {OF_EACH_KIND}) one.remove(); }}
  return seen; }})()"""
"""JavaScript that leaves the page of the API two entries of each kind: axe takes most of its time for the others."""


@pytest.mark.parametrize(
    ("name", "width", "scheme", "whole"),
    [
        ("index", WIDE, "light", True),
        ("index", NARROW, "dark", True),
        ("explanation/rig", NARROW, "light", True),
        ("tutorials/first_node", WIDE, "dark", True),
        ("reference/api", NARROW, "light", False),
        pytest.param("reference/api", NARROW, "light", True, marks=pytest.mark.slow),
    ],
)
def test_pages_of_the_website_have_no_serious_faults(site, browser, name, width, scheme, whole):
    page = browser.page(width, 900, prefers_color_scheme=scheme)
    page.goto((site / f"{name}.html").as_uri())
    wanted = {"light": "default", "dark": "slate"}[scheme]
    page.wait(f"document.body.dataset.mdColorScheme === '{wanted}'", f"the {scheme} palette")
    assert page.js("document.documentElement.scrollWidth") <= width, "the page is wider than its window"
    if not whole:
        left = page.js(FEW)
        assert len(left) >= 4, "classes, functions, methods and attributes"
        assert all(left.values())
    assert serious_faults(page) == []
    assert [asked for asked in page.fetched if not asked.startswith((site.as_uri(), "data:", "blob:"))] == []
    assert page.faults() == []


def test_the_search_works_on_a_website_opened_from_disk(site, browser):
    page = browser.page()
    page.goto((site / "index.html").as_uri())
    page.click(".md-search__input")
    page.call("Input.insertText", text="slow manifol")
    page.key("d")  # the search reads its field when a key is released
    page.wait("document.querySelectorAll('.md-search-result__item').length > 0", "results")
    links = page.js("[...document.querySelectorAll('.md-search-result__link')].map(link => link.href).join(' ')")
    assert "prediction.html" in links
    assert page.faults() == []


@pytest.fixture(scope="module")
def lab(tmp_path_factory) -> Iterator[str]:
    """The lab's page, playing back a run."""
    source = PlaybackSource([make_sample(tmp_path_factory.mktemp("lab") / "sample")])
    with Server(source, port=0) as server, source:
        yield server.address


@pytest.mark.parametrize(("width", "scheme"), [(WIDE, "light"), (NARROW, "dark")])
def test_the_page_of_the_lab_has_no_serious_faults(lab, browser, width, scheme):
    page = browser.page(width, 900, prefers_color_scheme=scheme)
    page.goto(lab)
    page.wait("window.lab && lab.now.playback?.read === 1", "the run")
    assert serious_faults(page) == []


def test_axe_finds_planted_faults(browser, tmp_path):
    file = tmp_path / "bad.html"
    file.write_text("<html><body><img src='x.png'><p style='color:#ccc;background:#fff'>pale</p></body></html>")
    page = browser.page()
    page.goto(file.as_uri())
    found = "\n".join(serious_faults(page))
    assert "image-alt" in found
    assert "color-contrast" in found
