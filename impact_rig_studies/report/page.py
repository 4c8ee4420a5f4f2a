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
"""Construction of the HTML pages of reports by a template engine that escapes texts.

A page loads and executes nothing. Its security policy allows only one style sheet, identified by its digest, and
embedded images. Styles of drawings are therefore converted to classes of the style sheet.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from urllib.parse import quote

import attrs
import jinja2
from markupsafe import Markup, escape

from impact_rig import names
from impact_rig.drawing import TAG, Drawn, variables

_SYMBOL, _LOWERED = re.compile(r"\b([A-Za-z])_(\w)\b"), r"\1<sub>\2</sub>"
_POLICY = "default-src 'none'; style-src '{digest}'; img-src data:; base-uri 'none'; form-action 'none'"


@attrs.frozen
class Section:
    """Part of a page with a heading that the table of contents links to."""

    title: str
    html: Markup

    @property
    def anchor(self) -> str:
        """Identifier of the section on its page, to which links point."""
        return f"s-{names.identifier(self.title.lower())}"

    def __html__(self) -> Markup:
        """Return the HTML of the section; `Markup` calls this to insert it without escaping."""
        return self.html


@functools.cache
def _parts() -> jinja2.Template:
    """Return the template file whose macros make the parts of a page."""
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
    )
    environment.filters["lowered"] = _lowered
    return environment.get_template("parts.html")


def _render(part: str, *values: object) -> Markup:
    made: Markup = getattr(_parts().module, part)(*values)
    return made


def _lowered(text: str) -> Markup:
    """Return a text as HTML, in which symbols such as m_1 have a subscript.

    Such a symbol is one letter with an index of one character.
    """
    return Markup(_SYMBOL.sub(_LOWERED, str(escape(text))))  # noqa: S704  # escaped, and what it gains is ours


def page(title: str, parts: Iterable[Section | Markup]) -> str:
    """Return the complete HTML document of a page with this title, from its parts in order."""
    body, classes = _classed(Markup("\n").join(parts))
    style = f"{STYLE}{classes}"
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    policy = _POLICY.format(digest=f"sha256-{digest}")
    return str(_render("page", title, policy, Markup(style), body))  # noqa: S704  # ours


def _classed(body: Markup) -> tuple[Markup, str]:
    """Replace the inline styles in the drawings of a page by classes; return the HTML and the CSS rules of the classes.

    The security policy of the page allows no inline styles.
    """
    rules: dict[str, str] = {}

    def name(found: re.Match[str]) -> str:
        return f' class="{rules.setdefault(found[1], f"k{len(rules)}")}"'

    def drawing(found: re.Match[str]) -> str:
        plain = re.sub(r"<style[^>]*>.*?</style>", "", found[0], flags=re.DOTALL)
        return TAG.sub(lambda tag: re.sub(r' style="([^"]*)"', name, tag[0]), plain)

    html = re.sub(r"<svg\b.*?</svg>", drawing, body, flags=re.DOTALL)
    return Markup(html), "\n".join(f".{one} {{ {rule} }}" for rule, one in rules.items())  # noqa: S704  # as it was


def title(text: str) -> Markup:
    """Return the main heading of a page as HTML."""
    return _render("title", text)


def section(title: str, *parts: Markup) -> Section | None:
    """Return a section of a page with a title and its parts, or None if all parts are empty."""
    body = Markup("\n").join(one for one in parts if one)
    if not body:
        return None
    made = Section(title, Markup())
    return attrs.evolve(made, html=_render("section", title, made.anchor, body))


def contents(sections: Iterable[Section]) -> Markup:
    """Return a table of contents with links to sections, as HTML."""
    return _render("contents", list(sections))


def heading(title: str) -> Markup:
    """Return a heading within a section, as HTML."""
    return _render("heading", title)


def paragraph(text: str, kind: str = "") -> Markup:
    """Return a paragraph of plain text as HTML; `kind` is its class in the style sheet, such as `muted`."""
    return _render("paragraph", text, kind)


def cover(entries: Iterable[tuple[str, str]]) -> Markup:
    """Return the block below a page's title as HTML: pairs of label and value, without those with an empty value."""
    return _render("cover", [entry for entry in entries if entry[1]])


@attrs.frozen
class _Figure:
    """Figure of a page as its template needs it: texts, drawing as inline SVG, and link to the CSV."""

    identifier: str
    name: str
    caption: str
    drawing: Markup
    csv: str  # address with the numbers; empty if there are none


def figures(drawn: Sequence[Drawn], *, large: bool = False) -> Markup:
    """Return figures as HTML, side by side as the page width allows; `large` makes them larger.

    The reader can enlarge each figure. A figure with lines has a link to its numbers as CSV.
    """
    shown = [
        _Figure(
            one.identifier,
            one.name,
            one.caption,
            Markup(one.inline()),  # noqa: S704  # matplotlib escapes its texts
            f"data:text/csv;charset=utf-8,{quote(one.csv())}" if one.lines else "",
        )
        for one in drawn
    ]
    return _render("figures", shown, "figures large" if large else "figures") if shown else Markup()


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], numeric: Iterable[int] = ()) -> Markup:
    """Return a table of plain text as HTML; on a phone every row becomes a list of its cells with their headings.

    Args:
        headings: headings of the columns.
        rows: cells of each row; a cell that is a verdict (`pass`, `FAIL`) is coloured.
        numeric: indices of right-aligned columns.
    """
    return _render("table", list(headings), [list(row) for row in rows], set(numeric))


def tiles(items: Iterable[tuple[str, str]]) -> Markup:
    """Return key figures, shown large, as HTML from pairs of a number and its description."""
    return _render("tiles", list(items))


def folded(summary: str, body: Markup) -> Markup:
    """Return HTML that is collapsed below the line `summary` until the reader opens it; it is expanded in print."""
    return _render("folded", summary, body)


def links(items: Iterable[tuple[str, str]]) -> Markup:
    """Return a list of links as HTML from pairs of an address and a text; without pairs, a list without entries."""
    return _render("links", list(items))


# --- Its look

_LIGHT = "--page: #ffffff; --good: #17692f; --bad: #b30f1b; --soft: #f3f5f8; --quietly: #59636e; "
_DARK = "--page: #14181d; --good: #4ac26b; --bad: #ff6b6b; --soft: #1d232a; --quietly: #a9b3be; "

_CSS = (Path(__file__).parent / "style.css").read_text(encoding="utf-8")
STYLE = (
    _CSS.partition("*/")[2]
    .replace("LIGHT", _LIGHT + variables(dark=False))
    .replace("DARK", _DARK + variables(dark=True))
)
