"""The page: parts of HTML, a style that follows the theme and prints, and nothing that is fetched."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

from impact_rig.drawing.palette import variables
from impact_rig.drawing.style import Drawn

escape = html.escape

_STYLE = """
:root { color-scheme: light dark; --page: #ffffff; --good: #1a7f37; --bad: #c1121f; --soft: #f3f5f8; LIGHT }
@media (prefers-color-scheme: dark) { :root {
  --page: #14181d; --good: #4ac26b; --bad: #ff6b6b; --soft: #1d232a; DARK } }
@media print { :root {
  color-scheme: light; --page: #ffffff; --good: #1a7f37; --bad: #c1121f; --soft: #f3f5f8; LIGHT } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem; max-width: 90rem; background: var(--page); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: .5rem 0; } h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; }
p { max-width: 48rem; } a { color: var(--s0); } .muted { color: var(--muted); }
.figures { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 24rem), 1fr)); gap: 1rem 1.5rem; }
figure { margin: 0; min-width: 0; max-width: 34rem; } figure svg { display: block; width: 100%; height: auto; }
figure svg text { font-family: "DejaVu Sans", Verdana, Geneva, sans-serif !important; }
figcaption { font-size: .85rem; color: var(--muted); }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem; text-align: left; vertical-align: top; border-bottom: 1px solid var(--grid); }
th { font-size: .85rem; color: var(--muted); font-weight: 600; }
td.n, th.n { text-align: right; } td.n { white-space: nowrap; }
.pass { color: var(--good); font-weight: 600; } .FAIL { color: var(--bad); font-weight: 600; }
.tiles { display: grid; grid-template-columns: repeat(auto-fill, minmax(10rem, 1fr)); gap: .7rem; margin: 1rem 0; }
.tile { background: var(--soft); border-radius: .5rem; padding: .6rem .8rem; }
.tile b { display: block; font-size: 1.3rem; }
details summary { cursor: pointer; }
@media (max-width: 40rem) { th, td { padding: .2rem .25rem; } table, th { font-size: .8rem; } }
@media print { figure, tr { break-inside: avoid; } h2 { break-after: avoid; } body { font-size: 11px; }
  .figures { grid-template-columns: 1fr 1fr; } .scroll { overflow: visible; } }
""".replace("LIGHT", variables(dark=False)).replace("DARK", variables(dark=True))


def page(title: str, parts: Iterable[str]) -> str:
    """Return the whole document."""
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<link rel="icon" href="data:,">\n<style>{_STYLE}</style>\n</head>\n<body>\n'  # else browsers ask for an icon
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def section(title: str, *parts: str) -> str:
    """Return a section; nothing if it has no content."""
    body = "\n".join(part for part in parts if part)
    return f"<section>\n<h2>{escape(title)}</h2>\n{body}\n</section>" if body else ""


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph of plain text."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def figures(drawn: Sequence[Drawn]) -> str:
    """Return figures side by side as far as the page is wide."""
    if not drawn:
        return ""
    items = (
        f'<figure role="group" aria-label="{escape(one.caption)}">{one.inline()}'
        f"<figcaption>{escape(one.caption)}</figcaption></figure>"
        for one in drawn
    )
    return f'<div class="figures">{"".join(items)}</div>'


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], numeric: Iterable[int] = ()) -> str:
    """Return a table of plain text.

    Args:
        headings: of the columns.
        rows: cells; one that begins with a verdict's word is coloured by it.
        numeric: columns that are set flush right.
    """
    right = set(numeric)

    def cell(tag: str, column: int, text: str) -> str:
        word = text if text in ("pass", "FAIL") else ""
        kind = " ".join(filter(None, ("n" if column in right else "", word)))
        return f'<{tag} class="{kind}">{escape(text)}</{tag}>' if kind else f"<{tag}>{escape(text)}</{tag}>"

    head = "".join(cell("th", i, text) for i, text in enumerate(headings))
    body = "\n".join(f"<tr>{''.join(cell('td', i, text) for i, text in enumerate(row))}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'


def tiles(items: Iterable[tuple[str, str]]) -> str:
    """Return key figures: (number, what it is)."""
    each = (f'<div class="tile"><b>{escape(number)}</b>{escape(what)}</div>' for number, what in items)
    return f'<div class="tiles">{"".join(each)}</div>'


def folded(summary: str, body: str) -> str:
    """Return a part that is closed at first."""
    return f"<details><summary>{escape(summary)}</summary>\n{body}\n</details>"


def link(address: str, text: str) -> str:
    """Return a link."""
    return f'<a href="{escape(address)}">{escape(text)}</a>'
