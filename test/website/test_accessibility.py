# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""axe finds no serious fault on pages of the website and of the lab, wide and light, narrow and dark.

The rules are those of axe-core as the package axe-core-python ships them; the pages are opened in a real Chromium.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("aiohttp", reason="the extra [lab] is not installed")
if importlib.util.find_spec("axe_core_python") is None:
    pytest.skip("axe is only on PyPI", allow_module_level=True)

from kits.browser import Browser, Page

from impact_rig.lab.playback import PlaybackSource
from impact_rig.lab.sample import make
from impact_rig.lab.server import Server
from tools.website.__main__ import served

AXE = Path(importlib.util.find_spec("axe_core_python").origin).with_name("axe.min.js").read_text(encoding="utf-8")
SERIOUS = ("serious", "critical")
WIDE, NARROW = 1280, 400


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    found = Browser()
    try:
        yield found
    finally:
        found.close()


def serious_faults(page: Page) -> list[str]:
    """Rule, element and what is wrong, of each fault that axe calls serious or critical."""
    page.call("Runtime.evaluate", expression=AXE)
    found = json.loads(
        page.js("axe.run(document, {resultTypes: ['violations']}).then(r => JSON.stringify(r.violations))")
    )
    return [
        f"{rule['id']}: {node['html'][:120]}: {node['failureSummary']}"
        for rule in found
        if rule["impact"] in SERIOUS
        for node in rule["nodes"]
    ]


@pytest.fixture(scope="module")
def address(site) -> Iterator[str]:
    """The website, served: browsers give files from the disk no search."""
    with served(site) as found:
        yield found


@pytest.mark.parametrize(("width", "scheme"), [(WIDE, "light"), (NARROW, "dark")])
@pytest.mark.parametrize("name", ["index", "rig", "first_node"])
def test_pages_of_the_website(address, browser, name, width, scheme):
    page = browser.page(width, 900, prefers_color_scheme=scheme)
    page.goto(f"{address}{name}.html")
    wanted = {"light": "default", "dark": "slate"}[scheme]
    page.wait(f"document.body.dataset.mdColorScheme === '{wanted}'", f"the {scheme} palette")
    assert serious_faults(page) == []
    assert page.js("document.documentElement.scrollWidth") <= width, "the page is wider than its window"
    assert [asked for asked in page.fetched if not asked.startswith((address, "data:", "blob:"))] == []
    assert page.errors == []
    page.close()


@pytest.fixture(scope="module")
def lab(tmp_path_factory) -> Iterator[str]:
    """The lab's page, playing back a run."""
    source = PlaybackSource([make(tmp_path_factory.mktemp("lab") / "sample")])
    with Server(source, port=0) as server, source:
        yield server.address


@pytest.mark.parametrize(("width", "scheme"), [(WIDE, "light"), (NARROW, "dark")])
def test_the_lab(lab, browser, width, scheme):
    page = browser.page(width, 900, prefers_color_scheme=scheme)
    page.goto(lab)
    page.wait("window.lab && lab.now.playback?.read === 1", "the run")
    assert serious_faults(page) == []
    page.close()


def test_axe_finds_what_is_there_to_be_found(browser, tmp_path):
    file = tmp_path / "bad.html"
    file.write_text("<html><body><img src='x.png'><p style='color:#ccc;background:#fff'>pale</p></body></html>")
    page = browser.page()
    page.goto(file.as_uri())
    found = "\n".join(serious_faults(page))
    assert "image-alt" in found
    assert "color-contrast" in found
    page.close()
