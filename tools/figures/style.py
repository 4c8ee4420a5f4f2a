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
"""Common style of the docs' figures: size, type, colours by meaning, light and dark in one file.

The colours are those of the report (`impact_rig.drawing`). Each body has one colour everywhere: the inferior base is
blue, the superior base green, the sphere orange. Red is for the paper's data.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import re
from collections.abc import Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING

from impact_rig.drawing import DARK, GRID, INK, MUTED, PAPER_RED, SERIES, STYLE, themed, variables

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BASE, STRUCTURE, SPHERE, PAPER = SERIES[0], SERIES[1], SERIES[2], PAPER_RED
WIDTH = 640
"""Width of every figure [px]: half a wide page, and legible on a phone."""
FONT = "system-ui, 'DejaVu Sans', sans-serif"
TEXT_PX = 13
"""Width of lines in drawings and plots."""
MARGIN = 10.0
"""Margin about plots [px]."""
DECIMALS = 2
"""Digits of coordinates: a hundredth of a pixel."""

_SHEETS = {False: "--sheet: #ffffff; --card: #f4f6f8;", True: "--sheet: #151a20; --card: #1f262e;"}
_NUMBER = re.compile(r"-?\d+\.\d{3,}")
__all__ = ["BASE", "DARK", "GRID", "INK", "MUTED", "PAPER", "SERIES", "SPHERE", "STRUCTURE", "WIDTH"]


def sheet(height: float, title: str, body: str, css: str = "") -> str:
    """Return a complete SVG file.

    Args:
        height: height of the canvas [px], which is `WIDTH` wide.
        title: description of the figure for readers who cannot see it.
        body: elements, in the light colours of the palette.
        css: additional rules.
    """
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="{WIDTH}"'
        f' height="{height:g}" viewBox="0 0 {WIDTH} {height:g}" font-family="{FONT}" font-size="{TEXT_PX}"'
        ' role="img">\n'
        f"<title>{escape(title)}</title>\n<style>\n"
        f":root {{ {variables(dark=False)} {_SHEETS[False]} }}\n"
        f"@media (prefers-color-scheme: dark) {{ :root {{ {variables(dark=True)} {_SHEETS[True]} }} }}\n"
        f'{themed(css)}</style>\n<rect width="{WIDTH}" height="{height:g}" rx="8" fill="var(--sheet)"/>\n'
        f"{themed(body)}\n</svg>\n"
    )


# --- Plots ------------------------------------------------------------------------------------------------------------
@contextlib.contextmanager
def style() -> Iterator[None]:
    """Apply the style to everything that matplotlib draws within."""
    from matplotlib import rc_context  # noqa: PLC0415  # a second of import: only when something is drawn

    own: dict[str, object] = {
        "font.size": TEXT_PX, "axes.titlesize": TEXT_PX, "legend.fontsize": TEXT_PX - 1, "axes.titleweight": "bold",
        "axes.titlelocation": "left", "lines.linewidth": 2.0, "lines.markersize": 6.0, "figure.dpi": 72,
        "path.simplify": False,  # which points would be left out depends on last digits
        "svg.hashsalt": "impact_rig",
    }  # fmt: skip
    with rc_context(STYLE | own):  # type: ignore[arg-type]  # its key type is a literal of all settings
        yield


def new_figure(height: float) -> Figure:
    """Return a figure of the common width, free of pyplot's global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  # as above
    from matplotlib.figure import Figure as MatplotlibFigure  # noqa: PLC0415  # as above

    figure = MatplotlibFigure(figsize=(WIDTH / 72.0, height / 72.0), layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(w_pad=MARGIN / 72.0, h_pad=MARGIN / 72.0)
    return figure


def direct_label(axis: Axes, x: float, y: float, text: str, colour: str, **more: object) -> None:
    """Write a label next to the thing that it names, in the same colour."""
    axis.annotate(text, (x, y), (4, 0), textcoords="offset points", color=colour, va="center", **more)  # type: ignore[arg-type]


def finished(figure: Figure, title: str) -> str:
    """Return a figure as a file: text as text, coordinates rounded, identifiers numbered in order of appearance."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    body = text[text.index("<defs>") : text.rindex("</svg>")]
    body = re.sub(r"<!--.*?-->\n?", "", body, flags=re.DOTALL)
    body = re.sub(r"<style.*?</style>|<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = body.replace("'DejaVu Sans', 'Bitstream Vera Sans'", "system-ui, 'DejaVu Sans'")
    used = list(dict.fromkeys(re.findall(r"(?:url\(#|href=\"#)([\w-]+)", body)))
    names = dict(zip(used, (f"n{number}" for number in itertools.count()), strict=False))
    body = re.sub(r' id="([\w-]+)"', lambda found: f' id="{names[found[1]]}"' if found[1] in names else "", body)
    body = re.sub(r"(url\(#|href=\"#)([\w-]+)", lambda found: f"{found[1]}{names[found[2]]}", body)
    body = re.sub(
        r"<[^>]*>", lambda found: _NUMBER.sub(_rounded, found[0]), body
    )  # the numbers that readers see stay unchanged
    return sheet(round(figure.get_figheight() * 72.0, 3), title, body)


def _rounded(found: re.Match[str]) -> str:
    return f"{float(found[0]):.{DECIMALS}f}".rstrip("0").rstrip(".")


# --- Drawings ---------------------------------------------------------------------------------------------------------
def text(
    x: float,
    y: float,
    words: str,
    *,
    anchor: str = "start",
    colour: str = INK,
    bold: bool = False,
    px: float = TEXT_PX,
    symbols: bool = True,
) -> str:
    """Return a text at a position; with `symbols`, a character after `_` is a subscript: `x_1`."""
    weight = ' font-weight="600"' if bold else ""
    parts, low = escape(words), f'<tspan dy="{0.25 * px:g}" font-size="75%">'
    if symbols:  # not all browsers support `baseline-shift`
        parts = re.sub(r"_(\w)", rf'{low}\1</tspan><tspan dy="{-0.25 * px:g}">&#8203;</tspan>', parts)
    size = f' font-size="{px:g}"' if px != TEXT_PX else ""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" fill="{colour}"{weight}{size}>{parts}</text>'


def box(
    x: float, y: float, width: float, height: float, *, fill: str = "none", stroke: str = "none", rx: float = 0.0
) -> str:
    """Return a rectangle."""
    edge = f' stroke="{stroke}" stroke-width="1.5"' if stroke != "none" else ""
    return f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="{rx:g}" fill="{fill}"{edge}/>'


def line(points: Sequence[tuple[float, float]], *, colour: str = INK, width: float = 1.5, more: str = "") -> str:
    """Return a line through points."""
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    return f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}" {more}/>'


def arrow(x0: float, y0: float, x1: float, y1: float, *, colour: str = INK) -> str:
    """Return an arrow."""
    length = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    foot_x, foot_y = x1 - 8.0 * ux, y1 - 8.0 * uy
    head = ((x1, y1), (foot_x - 4.0 * uy, foot_y + 4.0 * ux), (foot_x + 4.0 * uy, foot_y - 4.0 * ux))
    tip = " ".join(f"{x:.1f},{y:.1f}" for x, y in head)
    return line(((x0, y0), (foot_x, foot_y)), colour=colour) + f'<polygon points="{tip}" fill="{colour}"/>'
