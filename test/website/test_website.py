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
"""The built website: strict, with every link, block and picture present, and nothing fetched from elsewhere."""

from __future__ import annotations

import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
pytestmark = pytest.mark.heavy  # it builds the site
PAGES = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))


class Found(HTMLParser):
    """Parser of a page: its links, its anchors and its blocks of code."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.blocks = 0
        self.unnamed: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attributes}
        self.anchors |= {given["id"]} if "id" in given else set()
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag in {"img", "script", "link", "source"}:
            self.loaded += [
                given[name] for name in ("src", "href") if name in given and given.get("rel") != "canonical"
            ]
        if tag == "img" and not given.get("alt"):
            self.unnamed.append(given["src"])
        self.blocks += tag == "pre"


def pages(site: Path) -> dict[Path, Found]:
    return {
        path: Found(path.read_text(encoding="utf-8"))
        for path in sorted(site.rglob("*.html"))
        if path.name not in {"404.html", "impact_rig.html"}  # the latter is the rig itself, if `make site` has built it
    }


@pytest.fixture(scope="module")
def found(site):
    return pages(site)


def test_every_page_exists_and_is_in_the_navigation(site, found):
    assert {path.relative_to(site).with_suffix(".md").as_posix() for path in found} == set(PAGES)
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    listed = set(re.findall(r"[\w/.-]+\.md", navigation))
    assert set(PAGES) == listed


def test_every_link_has_an_existing_target(found):
    for path, page in found.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            assert target.exists(), f"{path.name}: {link}"
            if parts.fragment and target.suffix == ".html":
                assert unquote(parts.fragment) in found[target].anchors, f"{path.name}: {link}"


def test_every_loaded_file_is_part_of_the_site(found):
    for path, page in found.items():
        for address in page.loaded:
            parts = urlsplit(address)
            assert not parts.scheme, f"{path.name} asks for {address}"
            assert not parts.netloc, f"{path.name} asks for {address}"
            assert (path.parent / unquote(parts.path)).exists(), f"{path.name}: {address}"


def test_every_picture_has_a_text_alternative(found):
    assert [(path.name, page.unnamed) for path, page in found.items() if page.unnamed] == []


@pytest.mark.parametrize("name", PAGES)
def test_every_block_of_code_is_rendered_as_a_block(site, found, name):
    text = (DOCS / name).read_text(encoding="utf-8")
    path = site / Path(name).with_suffix(".html")
    blocks = len(re.findall(r"^```+\w+", text, re.MULTILINE))
    generated = ":::" in text  # signatures and examples of docstrings are blocks, too
    assert found[path].blocks > blocks if generated else found[path].blocks == blocks
    assert "```" not in path.read_text(encoding="utf-8")


def test_the_page_of_the_api_has_inherited_methods_default_values_and_links(site):
    text = (site / "reference" / "api.html").read_text(encoding="utf-8")
    assert 'id="impact_rig.LocalRig.command"' in text
    assert ">256000000<" in text
    assert "KEPT_BYTES" not in text
    assert '<a href="configuration.html">docs/reference/configuration.md</a>' in text
    assert '<a href="#impact_rig.RosRig"><code>RosRig</code></a>' in text


@pytest.mark.heavy
def test_a_broken_link_fails_the_build(mkdocs, tmp_path):
    """The configuration is the real one, with one page that has one bad link."""
    from mkdocs.commands.build import build as build_site
    from mkdocs.config import load_config
    from mkdocs.exceptions import Abort

    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text("# A page\n\n[nowhere](none.md)\n", encoding="utf-8")
    for name in ("site.css", "site.js"):
        shutil.copy(DOCS / name, docs)
    config = load_config(
        str(ROOT / "mkdocs.yml"), docs_dir=str(docs), site_dir=str(tmp_path / "site"), nav=[{"Page": "index.md"}]
    )
    with pytest.raises(Abort, match="1 warning"):
        build_site(config)
