# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The set-up, drawn: shaker, bases, columns, barriers and sphere, their symbols, and where the instruments look."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from impact_rig.drawing.palette import GRID, INK, MEASURED, MUTED, QUIET, TRUTH
from impact_rig.drawing.style import WIDTH_INCH, Drawn, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH, HEIGHT = 100.0, 76.0
"""Of the drawing, in its own units: hundredths of its width."""
SYMBOL = 9.5
"""Type size of symbols."""


def set_up() -> Drawn:
    """Draw the rig as the paper describes it; to be called within `drawing.style.style`."""
    figure, (axis,) = new_axes(WIDTH_INCH * HEIGHT / WIDTH)
    axis.set(xlim=(0.0, WIDTH), ylim=(0.0, HEIGHT), aspect="equal")
    axis.axis("off")
    _machine(axis)
    _damper(axis)
    _instruments(axis)
    _symbols(axis)
    caption = (
        "The set-up. A shaker moves the inferior base; elastic columns carry the superior base and its two barriers, "
        "between which the loose sphere moves. Blue: the instruments, in the order in which one converter reads them."
    )
    return Drawn("set_up", figure, caption)


def _box(axis: Axes, x: float, y: float, width: float, height: float, *, edge: str = INK, fill: str = QUIET) -> None:
    from matplotlib.patches import Rectangle  # noqa: PLC0415  # heavy: only when something is drawn

    axis.add_patch(Rectangle((x, y), width, height, edgecolor=edge, facecolor=fill, linewidth=1.0))


def _arrow(
    axis: Axes, start: tuple[float, float], end: tuple[float, float], kind: str = "->", shade: str = INK
) -> None:
    arrow = {"arrowstyle": kind, "color": shade, "linewidth": 0.9, "shrinkA": 0.0, "shrinkB": 0.0}
    axis.annotate("", xy=end, xytext=start, arrowprops=arrow)


def _machine(axis: Axes) -> None:
    from matplotlib.patches import Circle  # noqa: PLC0415  # as above

    axis.plot([0.0, WIDTH], [5.0, 5.0], color=MUTED, linewidth=1.0)
    _box(axis, 2.0, 5.0, 17.0, 17.0)
    axis.text(10.5, 13.5, "shaker", ha="center", va="center")
    axis.plot([19.0, 27.0], [13.5, 13.5], color=INK, linewidth=2.4)
    _box(axis, 27.0, 9.0, 44.0, 9.0)
    axis.text(49.0, 13.5, "inferior base", ha="center", va="center")
    for x in (34.0, 64.0):
        axis.add_patch(Circle((x, 7.0), 1.9, edgecolor=INK, facecolor=GRID, linewidth=0.8))
        axis.plot([x, x], [18.0, 46.0], color=INK, linewidth=2.0)
    _box(axis, 27.0, 46.0, 44.0, 8.0)
    axis.text(49.0, 50.0, "superior base", ha="center", va="center")


def _damper(axis: Axes) -> None:
    from matplotlib.patches import Circle  # noqa: PLC0415  # as above

    for x in (29.0, 65.0):
        _box(axis, x, 54.0, 4.0, 11.0, fill=GRID)
    axis.add_patch(Circle((49.0, 57.2), 3.2, edgecolor=TRUTH, facecolor=QUIET, linewidth=1.4))
    for wall, side in ((33.0, 45.8), (65.0, 52.2)):
        _arrow(axis, (wall, 57.2), (side, 57.2), "<->", MUTED)
        axis.text((wall + side) / 2.0, 58.2, "$g/2$", ha="center", va="bottom", fontsize=SYMBOL)


def _instruments(axis: Axes) -> None:
    for x, y, width, height in ((21.5, 47.5, 5.5, 5.0), (88.0, 46.5, 10.0, 7.0), (82.0, 10.5, 10.0, 6.0)):
        _box(axis, x, y, width, height, edge=MEASURED)
    axis.plot([71.0, 88.0], [50.0, 50.0], color=MEASURED, linewidth=1.0, linestyle=":")
    axis.plot([71.0, 82.0], [13.5, 13.5], color=MEASURED, linewidth=1.0, linestyle=":")
    axis.plot([10.5, 10.5], [22.0, 27.0], color=MEASURED, linewidth=1.0)
    for x, y, text, side in (
        (20.0, 50.0, "1 accelero-\nmeter", "right"), (93.0, 41.8, "2 laser", "center"),
        (87.0, 20.5, "3 base sensor", "center"), (10.5, 29.5, "4 coil current", "center"),
    ):  # fmt: skip
        axis.text(x, y, text, ha=side, va="center", color=MEASURED, fontsize=8.5)


def _symbols(axis: Axes) -> None:
    places: Sequence[tuple[float, float, str]] = (
        (10.5, 2.0, "$K_f,\\ k_f,\\ c_f$"), (49.0, 2.0, "$m_a + m_b$"), (49.0, 32.0, "$k_1,\\ c_1$"),
        (75.5, 57.5, "$m_1$"), (49.0, 66.5, "$m$"),
    )  # fmt: skip
    for x, y, text in places:
        axis.text(x, y, text, ha="center", va="center", fontsize=SYMBOL)
    for start, text in (((71.0, 26.0), "$x_b$"), ((71.0, 64.5), "$x_1$"), ((49.0, 71.0), "$x_2$")):
        _arrow(axis, start, (start[0] + 9.0, start[1]))
        axis.text(start[0] + 10.5, start[1], text, ha="left", va="center", fontsize=SYMBOL)
