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
"""Comparison of README and docs with the repository: `python -m tools.check_docs` lists every line that is wrong.

Every code block has an owner, determined by its page and the words after the fence:

- a test that runs it (`RUN_BY`);
- `test/test_docs.py`, which runs the Python and parses the YAML of all other pages;
- this script, for `sh`: it passes each command to the program's own parser, which must know it; `make journeys` runs
  the commands;
- none, with a reason after the language: `sh not run: needs an apt-installed Jazzy`.

Blocks of `text` are formulas, trees and output. Commands, paths and links in running text are checked, too.

Figures have an owner, too. A figure is a decimal fraction, or a number with a unit. A section of README or docs with a
figure in its text or tables begins with a comment that names the figures' owners, or its page does before its first
section:

    <!-- figures: make bench ONLY=analysis; test/impact_rig/analysis/test_x.py::test_y; config/nominal.yaml -->

The owners are commands that print a figure, tests that check it, or the file that defines it. They must exist. This
script does not compare the values; the reader can do so with the owner.
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import attrs
from markdown_it import MarkdownIt
from markdown_it.token import Token

sys.path.insert(0, str(Path(__file__).parents[1]))  # also for modules that the pages run, `python -m benchmarks`

from tools.doc_commands import PROGRAMS, command_faults, commands
from tools.doc_paths import ROOT, exists, is_dangling, is_path

RUN_BY = {
    ("docs/explanation/analysis.md", "python"): "test/impact_rig/analysis/test_guide.py",
    ("docs/how-to/drive.md", "python title"): "test/impact_rig/testing/test_examples.py",
    ("docs/how-to/extending.md", "python title"): "test/test_extending.py",
    ("docs/tutorials/first_node.md", "python title"): "test/impact_rig/testing/test_examples.py",
    ("docs/how-to/ros2_control.md", "xml"): "test/impact_rig/nodes/test_convert.py",
    ("docs/how-to/recording.md", "python"): "test/impact_rig/recording/test_guide.py",
    ("docs/how-to/recording.md", "python notebook"): "test/impact_rig/recording/test_guide.py",
    ("docs/how-to/recording.md", "python studies"): "test/impact_rig_studies/test_dynamics.py",
    ("docs/how-to/testing.md", "python title"): "test/impact_rig/testing/test_guide.py",
    ("docs/how-to/testing.md", "sh"): "test/impact_rig/testing/test_guide.py",
    ("docs/how-to/testing.md", "sh fails"): "test/impact_rig/testing/test_guide.py",
    ("docs/tutorials/first_pipeline_test.md", "python title"): "test/impact_rig/testing/test_guide.py",
    ("docs/tutorials/first_pipeline_test.md", "sh"): "test/impact_rig/testing/test_guide.py",
    ("docs/tutorials/first_pipeline_test.md", "sh fails"): "test/impact_rig/testing/test_guide.py",
    ("examples/README.md", "sh"): "test/impact_rig/testing/test_examples.py",
}
RUN_BY_TEST_DOCS = {"python", "python title", "yaml"}
NOT_RUN = "not run: "
_OWNERS = re.compile(r"<!-- figures: (.*?) -->", re.DOTALL)
_FIGURE = re.compile(
    r"\d+\.\d+|\d\s?(?:%|×|°|points?\b|[mµn]?s\b|min\b|[kMG]B\b|k?Hz\b|k?S/s|[mµ]?m\b|m/s|[mµ]?V\b|m?A\b|k?g\b|ppm\b)"
)


@attrs.frozen
class Block:
    """A code block: the words after its fence, split at the first blank, and its content."""

    page: str
    line: int
    language: str
    info: str
    content: str

    @property
    def kind(self) -> str:
        """Language and the first word after it, a title without its value."""
        return f"{self.language} {self.info.partition('=')[0]}".strip()

    def quotes(self, name: str) -> bool:
        """Return whether this block, without a language, is a part of a file."""
        text = (ROOT / name).read_text(encoding="utf-8")
        return not self.language and " ".join(self.content.split()) in " ".join(text.split())

    @property
    def owner(self) -> str | None:
        """The program that runs the block, or the reason why none does; None if that is unknown."""
        if self.info.startswith(NOT_RUN):
            return self.info if len(self.info) > len(NOT_RUN) else None
        if (self.page, self.kind) in RUN_BY:
            return RUN_BY[self.page, self.kind]
        if self.kind in RUN_BY_TEST_DOCS:
            return "test/test_docs.py"
        return "tools/check_docs.py" if self.kind in {"sh", "text"} else None


@attrs.frozen
class Section:
    """Text under one heading: its line, its first figure if there is one, and the owners of its figures."""

    line: int
    figure: str | None
    owners: tuple[str, ...]


@attrs.frozen
class Page:
    """Contents of a page: code blocks, code in running text, links, anchors of its headings, sections."""

    name: str
    blocks: tuple[Block, ...]
    words: tuple[tuple[int, str], ...]
    links: tuple[tuple[int, str], ...]
    anchors: frozenset[str]
    sections: tuple[Section, ...]

    @classmethod
    def parse(cls, name: str, text: str) -> Page:
        """Parse Markdown."""
        blocks, words, links, anchors, line, heading = [], [], [], set(), 0, False
        tokens = MarkdownIt("commonmark").enable("table").parse(text)
        for token in tokens:
            line = token.map[0] + 1 if token.map else line
            if token.type in {"fence", "code_block"}:
                language, _, info = token.info.partition(" ")
                blocks.append(Block(name, line, language, info, token.content))
            elif token.type == "inline":
                if heading:
                    anchors.add(re.sub(r"[^\w\- ]", "", token.content.lower()).replace(" ", "-"))
                for child in token.children or ():
                    if child.type == "code_inline":
                        words.append((line, child.content))
                    elif child.type in {"link_open", "image"}:
                        links.append((line, str(child.attrs.get("href") or child.attrs.get("src"))))
            heading = token.type == "heading_open"
        return cls(name, tuple(blocks), tuple(words), tuple(links), frozenset(anchors), tuple(_sections(tokens)))


def _sections(tokens: list[Token]) -> Iterator[Section]:
    """Yield the sections of a page; the first one includes the text before the second heading."""
    headings = [i for i, token in enumerate(tokens) if token.type == "heading_open"]
    for begin, end in itertools.pairwise([0, *headings[1:], len(tokens)]):
        own = tokens[begin:end]
        prose = [child.content for token in own for child in token.children or () if child.type == "text"]
        figure = next((found[0] for words in prose if (found := _FIGURE.search(words))), None)
        comments = "".join(token.content for token in own if token.type == "html_block")
        owners = [one.strip() for named in _OWNERS.findall(comments) for one in named.split(";")]
        yield Section((own[0].map or [0])[0] + 1 if own else 1, figure, tuple(owners))


@cache
def pages() -> dict[str, Page]:
    """Return every page by its name."""
    found = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md"), *ROOT.glob("test/**/*.md")]
    texts = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in sorted(found)}
    return {name: Page.parse(name, text) for name, text in texts.items()}


def faults(page: Page) -> Iterator[str]:
    """Yield the mistakes in a page."""
    for block in page.blocks:
        where = f"{page.name}:{block.line}"
        if block.quotes("LICENSE"):  # literally, including the fence
            continue
        if not block.language:
            yield f"{where}: a code block without a language"
        elif block.owner is None:
            yield f"{where}: no program runs this block of {block.kind!r}, and no reason is given"
        elif block.owner.startswith("test/") and not (ROOT / block.owner).exists():
            yield f"{where}: {block.owner}, which runs it, does not exist"
        if block.language == "sh":
            for command in commands(block.content):
                known = command[0] in PROGRAMS
                if not known and not block.info.startswith(NOT_RUN):
                    yield f"{where}: {command[0]} is not a program that can be checked"
                yield from (f"{where}: {fault}" for fault in command_faults(command, whole=True))
    if page.name == "README.md" or page.name.startswith("docs/"):
        yield from figure_faults(page)
    titles = {block.info.removeprefix("title="): block.line for block in page.blocks if block.info.startswith("title=")}
    for title, begin in titles.items():
        if not any(text == title and begin - 12 < line < begin for line, text in page.words):
            yield f"{page.name}:{begin}: the text before the block does not name its file {title}"
    for line, text in page.words:
        where = f"{page.name}:{line}"
        for command in commands(text) if text.split(" ")[0] in PROGRAMS or "=" in text.split(" ")[0] else ():
            yield from (f"{where}: {fault}" for fault in command_faults(command, whole=False))
        if is_path(text) and text not in titles and not exists(text):
            yield f"{where}: there is no {text}"
        if is_dangling(text) and not any(text.rpartition(".")[2] in block.content for block in page.blocks):
            yield f"{where}: the package has no {text}"
    for line, link in page.links:
        target, _, anchor = link.partition("#")
        if "://" in link or link.startswith("mailto:"):
            continue
        path = (ROOT / page.name).parent / target if target else ROOT / page.name
        if not path.exists():
            yield f"{page.name}:{line}: there is no {link}"
        elif anchor and anchor not in pages()[path.resolve().relative_to(ROOT).as_posix()].anchors:
            yield f"{page.name}:{line}: {target or page.name} has no heading #{anchor}"


# --- Figures ----------------------------------------------------------------------------------------------------------
def figure_faults(page: Page) -> Iterator[str]:
    """Yield the sections whose figures have no owner, and owners that do not exist."""
    for section in page.sections:
        where = f"{page.name}:{section.line}"
        if section.figure and not (section.owners or page.sections[0].owners):
            yield f"{where}: no command prints and no test checks figures such as {section.figure!r}"
        for owner in section.owners:
            path, _, test = owner.partition("::")
            if owner.split(" ")[0] in PROGRAMS:
                for words in commands(owner):
                    yield from (f"{where}: {fault}" for fault in command_faults(words, whole=True))
            elif not (ROOT / path).exists():
                yield f"{where}: {path}, the owner of figures, does not exist"
            elif test and f"def {test}(" not in (ROOT / path).read_text(encoding="utf-8"):
                yield f"{where}: {path} has no {test}"


def main() -> int:
    """Print every fault and return the exit code."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    found = [fault for page in pages().values() for fault in faults(page)]
    blocks = [block for page in pages().values() for block in page.blocks]
    sys.stdout.write("".join(f"{fault}\n" for fault in found))
    sys.stdout.write(f"{len(pages())} pages, {len(blocks)} code blocks, {len(found)} faults\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
