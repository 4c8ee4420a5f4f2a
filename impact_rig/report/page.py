# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The page: parts of HTML, each plain text or made of such parts, and nothing that is fetched."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from urllib.parse import quote

from impact_rig.drawing import Drawn, variables

escape = html.escape
_SYMBOL, _LOWERED = re.compile(r"\b([A-Za-z])_(\w)\b"), r"\1<sub>\2</sub>"


def page(title: str, parts: Iterable[str]) -> str:
    """Return the whole document."""
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<link rel="icon" href="data:,">\n'  # else browsers ask for one
        f"<style>{STYLE}</style>\n</head>\n<body>\n<main>\n" + "\n".join(parts) + "\n</main>\n</body>\n</html>\n"
    )


def anchor(title: str) -> str:
    """Return the identifier of a section."""
    return "s-" + re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def section(title: str, *parts: str, part: bool = False) -> str:
    """Return a section; nothing if it has no content."""
    body = "\n".join(one for one in parts if one)
    if not body:
        return ""
    kind = ' class="part"' if part else ""
    return f'<section{kind} id="{anchor(title)}">\n<h2>{escape(title)}</h2>\n{body}\n</section>'


def contents(sections: Iterable[str]) -> str:
    """Return the table of contents of sections."""
    titles = [found[1] for one in sections if (found := re.search(r"<section.*>\n<h2>(.*)</h2>", one))]
    items = "".join(f'<li><a href="#{anchor(html.unescape(title))}">{title}</a></li>' for title in titles)
    return f'<nav aria-label="Contents">\n<h2>Contents</h2>\n<ol>{items}</ol>\n</nav>'


def heading(title: str) -> str:
    """Return a heading within a section."""
    return f"<h3>{escape(title)}</h3>"


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph of plain text."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def cover(entries: Iterable[tuple[str, str]]) -> str:
    """Return the cover block: (what, its value), both plain text."""
    items = "".join(f"<dt>{escape(what)}</dt><dd>{escape(value)}</dd>" for what, value in entries if value)
    return f'<dl class="cover">{items}</dl>'


def figures(drawn: Sequence[Drawn], *, large: bool = False) -> str:
    """Return figures side by side as far as the page is wide; each can be enlarged, and gives its numbers as CSV."""
    kind = "figures large" if large else "figures"
    return f'<div class="{kind}">{"".join(map(_figure, drawn))}</div>' if drawn else ""


def _figure(one: Drawn) -> str:
    name, caption = escape(one.name), escape(one.caption)
    place = f"f-{one.name.replace('_', '-')}"
    tools = (
        f'<a class="enlarge" href="#{place}" aria-label="Enlarge {name}">enlarge</a>'
        f' <a class="back" href="#{place}-here" aria-label="Close {name}">close</a>'
    )
    if one.lines:
        address = f"data:text/csv;charset=utf-8,{quote(one.csv())}"
        tools += f' <a download="{name}.csv" href="{address}" aria-label="CSV of {name}">CSV</a>'
    return (
        f'<figure id="{place}" role="group" aria-label="{caption}"><span id="{place}-here"></span>{one.inline()}'
        f"<figcaption>{caption} {tools}</figcaption></figure>"
    )


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], numeric: Iterable[int] = ()) -> str:
    """Return a table of plain text; on a phone every row becomes a list of its cells with their headings.

    Args:
        headings: of the columns.
        rows: cells; one that is a verdict's word is coloured by it.
        numeric: columns that are set flush right.
    """
    right = set(numeric)

    def cell(tag: str, column: int, text: str) -> str:
        word = text if text in ("pass", "FAIL") else ""
        kind = " ".join(filter(None, ("n" if column in right else "", word)))
        marks = f' class="{kind}"' if kind else ""
        if tag == "td":
            marks += f' role="cell" data-label="{escape(headings[column])}"'
        else:
            marks += ' role="columnheader"'
        return f"<{tag}{marks}>{_SYMBOL.sub(_LOWERED, escape(text))}</{tag}>"

    head = "".join(cell("th", i, text) for i, text in enumerate(headings))
    body = "\n".join(f'<tr role="row">{"".join(cell("td", i, t) for i, t in enumerate(row))}</tr>' for row in rows)
    return (
        f'<div class="scroll"><table role="table"><thead role="rowgroup"><tr role="row">{head}</tr></thead>\n'
        f'<tbody role="rowgroup">{body}</tbody></table></div>'
    )


def tiles(items: Iterable[tuple[str, str]]) -> str:
    """Return key figures: (number, what it is)."""
    each = (f'<div class="tile"><b>{escape(number)}</b>{escape(what)}</div>' for number, what in items)
    return f'<div class="tiles">{"".join(each)}</div>'


def folded(summary: str, body: str) -> str:
    """Return a part that is closed at first, and open in print."""
    return f"<details><summary>{escape(summary)}</summary>\n{body}\n</details>"


def link(address: str, text: str) -> str:
    """Return a link."""
    return f'<a href="{escape(address)}">{escape(text)}</a>'


# --- Its look

_LIGHT = "--page: #ffffff; --good: #17692f; --bad: #b30f1b; --soft: #f3f5f8; --quietly: #59636e; "
_DARK = "--page: #14181d; --good: #4ac26b; --bad: #ff6b6b; --soft: #1d232a; --quietly: #a9b3be; "

_CSS = (Path(__file__).parent / "style.css").read_text(encoding="utf-8")
STYLE = (
    _CSS.partition("*/")[2]
    .replace("LIGHT", _LIGHT + variables(dark=False))
    .replace("DARK", _DARK + variables(dark=True))
)
