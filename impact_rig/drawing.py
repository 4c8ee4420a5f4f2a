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
"""Common style of all drawings: colours by meaning, fonts and lines, legends, light and dark themes.

A figure is drawn once, in the light colours, and exported to files and as SVG within an HTML page. On the page, each
colour is a CSS variable that follows the theme. matplotlib is imported when the first figure is drawn. The series
colours are those of Okabe & Ito, which people with any colour vision can distinguish, darkened for a white background.
"""

from __future__ import annotations

import contextlib
import csv
import io
import re
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
from numpy.typing import NDArray

from impact_rig import names
from impact_rig.system import files

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, GRID, PAPER_RED = "#1b1f24", "#66707c", "#d5dae1", "#c1121f"
SERIES = ("#0072b2", "#00845f", "#c75000", "#b0558f", "#8a6a00", "#3b8fc2", "#5b4fa2", "#7a7a2a")
PERIODIC, MODULATED, CHAOTIC, QUIET = "#cfe6f5", "#f6e3b4", "#f3c6bd", "#eceff2"

MEASURED, PREDICTED, TRUTH = SERIES[0], SERIES[4], SERIES[2]
"""Colours by meaning, for drawings of a single case: instrument readings, theory, and truth."""

NAMES: Mapping[str, str] = {
    INK: "ink", MUTED: "muted", GRID: "grid", PAPER_RED: "paper",
    **{colour: f"s{number}" for number, colour in enumerate(SERIES)}, PERIODIC: "periodic", MODULATED: "modulated",
    CHAOTIC: "chaotic", QUIET: "quiet",
}  # fmt: skip
"""Name of the CSS variable for each colour of the light theme."""

DARK: Mapping[str, str] = {
    "ink": "#e6e9ed",
    "muted": "#9aa4b0",
    "grid": "#39414b",
    "paper": "#ff6b6b",
    "s0": "#56b4e9",
    "s1": "#35c99a",
    "s2": "#ff9347",
    "s3": "#e59bc8",
    "s4": "#e0c04a",
    "s5": "#8fd0f5",
    "s6": "#b0a5f0",
    "s7": "#c9c96a",
    "periodic": "#1f4560",
    "modulated": "#5c4a14",
    "chaotic": "#63302a",
    "quiet": "#2a3038",
}

TAG = re.compile("<[^>]*>")
"""Pattern of a tag in an SVG by matplotlib, which escapes the angle brackets of texts."""
WIDTH_INCH = 4.4  # usual width of a drawing, about that of a phone, on which its text of 9 pt is then legible
WIDE_INCH = 7.2  # width of a drawing with a page, or a file, of its own
PIXELS_PER_INCH = 160
DIGITS = 9  # digits of numbers in the CSV of a drawing: more than any screen shows
POINTS_PER_INCH, CHARACTER = 72.0, 0.55  # width of a character in type sizes, approximate
LABELS_INCH = 0.48  # height of the numbers and the name below an axis
STYLE: dict[str, object] = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "legend.fontsize": 8.0,
    "svg.fonttype": "none",  # text stays text: it is searchable and sharp
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "lines.markersize": 4.0,
}


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Apply the common style of drawings to matplotlib within a `with` block or, as a decorator, within a function."""
    from cycler import cycler  # noqa: PLC0415  # a second of import: only for drawing
    from matplotlib import rc_context  # noqa: PLC0415  # as above

    lines = cycler(linestyle=["-", "--"]) * cycler(color=SERIES)  # the second half is dashed
    settings: dict[Any, Any] = {**STYLE, "axes.prop_cycle": lines}  # its key type is a literal of all settings
    with rc_context(settings):
        yield


def new_axes(
    height_inch: float = 3.0, ratios: Sequence[float] = (1.0,), width_inch: float = WIDTH_INCH, *, share: bool = True
) -> tuple[Figure, list[Axes]]:
    """Return a new figure and its axes, from top to bottom; call this within `style`.

    The figure is not registered in pyplot, so it needs no closing.

    Args:
        height_inch: height of the figure [inch].
        ratios: ratios of the heights of the axes.
        width_inch: width of the figure [inch].
        share: whether the axes share one horizontal scale.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  # as above
    from matplotlib.figure import Figure as MatplotlibFigure  # noqa: PLC0415  # as above

    figure = MatplotlibFigure(figsize=(width_inch, height_inch), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(ratios), 1, sharex=share, squeeze=False, height_ratios=ratios)[:, 0]
    return figure, list(axes)


def legend_below(axis: Axes, columns: int, *others: Axes) -> None:
    """Place one legend for several axes of a figure below the lowest axes.

    Args:
        axis: lowest axes of the figure.
        columns: number of columns of the legend.
        others: further axes, whose entries are listed before those of `axis`; equal labels are listed once.
    """
    from matplotlib.transforms import ScaledTranslation  # noqa: PLC0415  # as above

    entries: dict[str, Any] = {}  # a case that several axes show is one entry
    for one in (*others, axis):
        for handle, label in zip(*one.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    # of the axes, not of the figure: only this reserves room for it in matplotlib 3.6, which Ubuntu 24.04 has
    figure = axis.get_figure()
    assert figure is not None
    below = axis.transAxes + ScaledTranslation(0.0, -LABELS_INCH, figure.dpi_scale_trans)
    axis.legend(
        list(entries.values()), list(entries), loc="upper center", bbox_to_anchor=(0.5, 0.0), bbox_transform=below,
        ncols=columns, borderaxespad=0.0, columnspacing=1.2, handlelength=1.6,
    )  # fmt: skip


def legend_outside(figure: Figure, axis: Axes, columns: int, **more: Any) -> None:
    """Place the legend of one axes below all axes of a figure, in as many columns as fit into the figure's width.

    Args:
        figure: figure with constrained layout.
        axis: axes whose entries are listed; if it has none, there is no legend.
        columns: largest number of columns.
        more: further arguments of `Figure.legend`.
    """
    handles, labels = axis.get_legend_handles_labels()
    for ncols in range(columns if handles else 0, 0, -1):
        legend = figure.legend(handles, labels, loc="outside lower center", ncols=ncols, **more)
        if ncols == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


@attrs.frozen(eq=False)
class Line:
    """Numbers of one curve or point set of a drawing, for the CSV file next to the figure.

    Attributes:
        label: label of the curve in the legend.
        columns: name with unit -> values, one per point; all columns have the same length.
    """

    label: str
    columns: Mapping[str, Sequence[float] | NDArray[Any]]


class Drawn:
    """Drawing with its caption and numbers, ready for an HTML page and for files.

    Args:
        name: name of the drawing, any text; `names.file_name` makes its file names from it.
        figure: finished matplotlib figure. The constructor changes its texts by `plain_texts`, and renders it as SVG.
        caption: sentence(s) below the drawing, which also serve as alternative text.
        lines: numbers that the drawing shows, for its CSV file.
    """

    def __init__(self, name: str, figure: Figure, caption: str, lines: Sequence[Line] = ()) -> None:
        self.name, self.caption, self.lines = names.file_name(name), names.visible(caption), tuple(lines)
        self._figure = figure
        plain_texts(figure)
        self.svg = rendered(figure, "svg", self.name).decode()
        figure.set_layout_engine("none")  # its layout is done, which is half the work

    def content(self, kind: str) -> bytes:
        """Return the content of a file with the figure, in one of `names.FIGURE_FORMATS`."""
        return self.svg.encode() if kind == "svg" else rendered(self._figure, kind, self.name)

    @property
    def identifier(self) -> str:
        """HTML identifier of the drawing, which also begins all identifiers within its SVG on a page."""
        return f"f-{names.identifier(self.name)}"

    def inline(self) -> str:
        """Return the drawing as an `svg` element for an HTML page.

        The theme's colours are CSS variables, and all identifiers begin with `identifier`. The page sets the size: the
        element has no height, and its width, such as `316.8pt`, is in the attribute `data-width`.
        """
        body = re.sub(r"<metadata>.*?</metadata>", "", self.svg[self.svg.index("<svg") :], flags=re.DOTALL)
        body = TAG.sub(self._of_page, body)
        return re.sub(r'<svg height="[^"]*"', "<svg", body, count=1).replace(' width="', ' data-width="', 1)

    def _of_page(self, tag: re.Match[str]) -> str:
        """Return an SVG tag for use in an HTML page.

        The theme's colours become CSS variables. Identifiers, and references to them, get the prefix `identifier`,
        which avoids conflicts between drawings on one page.
        """
        return re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{self.identifier}-", themed(tag[0]))

    def csv(self) -> str:
        """Return the numbers of all `lines` as CSV text; without lines, the text is empty.

        The first row has the names of the columns. Each further row is one point: the label of its line (column
        `case`), then its values. Columns that the line does not have are empty.
        """
        columns = list(dict.fromkeys(name for line in self.lines for name in line.columns))
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        if self.lines:
            writer.writerow(["case", *map(names.csv_cell, columns)])
        for line in self.lines:
            for i in range(len(next(iter(line.columns.values())))):
                cells = [
                    f"{float(line.columns[name][i]):.{DIGITS}g}" if name in line.columns else "" for name in columns
                ]
                writer.writerow([names.csv_cell(line.label), *cells])
        return text.getvalue()

    def save(self, folder: Path, formats: Sequence[str] = names.FIGURE_FORMATS) -> None:
        """Write the figure to an existing folder as one file `NAME.FORMAT` per format.

        The numbers of `lines`, if there are any, are written as `NAME.csv`. Existing files are replaced.
        """
        for kind in formats:
            with files.atomic_write(folder / f"{self.name}.{kind}") as file:
                file.write(self.content(kind))
        if self.lines:
            files.write_text(folder / f"{self.name}.csv", self.csv())


def rendered(figure: Figure, kind: str, name: str) -> bytes:
    """Return the content of a file with a figure in the format `kind`, one of `names.FIGURE_FORMATS`.

    `name` only seeds the identifiers within an SVG: equal figures with equal names give equal bytes.
    """
    from matplotlib import rc_context  # noqa: PLC0415  # as above

    options: dict[str, Any] = {
        "png": {"dpi": PIXELS_PER_INCH, "facecolor": "white"},
        "svg": {"transparent": True, "metadata": {"Date": None}},
        "pdf": {"facecolor": "white", "metadata": {"CreationDate": None}},
    }
    content = io.BytesIO()
    texts: dict[Any, Any] = {"svg.fonttype": STYLE["svg.fonttype"], "pdf.fonttype": 42}  # also after `style` has ended
    with any_glyph(), rc_context({**texts, "svg.hashsalt": name}):
        figure.savefig(content, format=kind, **options[kind])
    return content.getvalue()


def plain_texts(figure: Figure) -> None:
    """Change the texts of a figure so that matplotlib draws them literally and within the figure's width.

    Titles, labels and legends can contain names from outside, which matplotlib could read as formulas. Only the
    project's own symbols, such as `$x_1$`, stay formulas. Very long texts are cut, and lines wider than the figure are
    wrapped. The numbers at the axes are not changed. Call this before the layout of the figure is computed.
    """
    titles, labels, legends = [*figure.texts], [], [*figure.legends]
    for axis in figure.axes:
        titles += [*axis.texts, axis.title, axis._left_title, axis._right_title]  # type: ignore[attr-defined]  # there is no public way
        labels += [axis.xaxis.label, axis.yaxis.label]
        legends += filter(None, [axis.get_legend()])
    for legend in legends:
        labels += [legend.get_title(), *legend.get_texts()]
    for texts, limit in ((titles, names.LONGEST_TITLE), (labels, names.LONGEST_LABEL)):
        for text in texts:
            plain = names.plot_text(text.get_text(), limit)
            across = int(POINTS_PER_INCH * figure.get_figwidth() / (CHARACTER * float(text.get_fontsize())))
            text.set_text(plain if len(plain) <= across else "\n".join(textwrap.wrap(plain, across)))


@contextlib.contextmanager
def any_glyph() -> Iterator[None]:
    """Suppress, within a `with` block, matplotlib's warning about characters that its font lacks.

    A PNG then shows boxes instead of these characters; an SVG contains them as text.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield


def variables(dark: bool) -> str:
    """Return the CSS declarations of all colour variables, for the dark or the light theme."""
    return " ".join(f"--{name}: {DARK[name] if dark else light};" for light, name in NAMES.items())


def themed(svg: str) -> str:
    """Return SVG source in which each colour of the light theme is replaced by its CSS variable."""
    for light, name in NAMES.items():
        svg = svg.replace(light, f"var(--{name})")
    return svg
