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
"""Figures of dynamics studies: one drawing function for each kind of study, labelled as results of the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from impact_rig.drawing import INK, SERIES, Drawn, legend_outside, new_axes, style
from impact_rig_studies.campaign.tasks import Row
from impact_rig_studies.dynamics import plan as plans
from impact_rig_studies.dynamics.plan import Found, Plan
from impact_rig_studies.maps.plan import CURRENT, FREQUENCY, GAP, POSITION, RESET, SPEED

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKS = {"fold": "o", "symmetry": "D", "flip": "s", "torus": "^", "grazing": "v", "lost": "x"}
"""Event of a row on a branch of orbits (a kind of change, or `lost` at its end) -> Matplotlib marker."""
LABELS = {
    FREQUENCY: ("frequency (Hz)", 1.0),
    CURRENT: ("current (A)", 1.0),
    GAP: ("gap (mm)", 1e3),
    POSITION: ("sphere at the beginning, from the middle (mm)", 1e3),
    SPEED: ("its speed (m/s)", 1.0),
}
DOTS_IN_LEGEND = 3.0  # size of a dot in the legend relative to that in the drawing
_SPHERE = "sphere at the section (mm)"


def drawn(plan: Plan, found: Found) -> Drawn:
    """Draw the results of a study as the diagram of its kind, such as a bifurcation diagram.

    `found` contains the rows of results of each task; tasks without rows leave gaps in the diagram.
    """
    draw, panels, what = _DRAWERS[plan.kind]
    with style():
        figure, panes = new_axes(3.0 if panels == 1 else 4.4, (1.0,) * panels)
        draw(panes, plan, found)
        panes[0].set_title(plan.title, loc="left")
        scale = DOTS_IN_LEGEND if plan.kind in (plans.SECTION, plans.BIFURCATION) else 1.0
        legend_outside(figure, panes[0], 3, markerscale=scale)
        return Drawn(f"dynamics_{plan.kind}", figure, f"{plan.title}: {what} Of the model, without instruments.")


def column(plan: Plan, rows: Sequence[Row], name: str) -> NDArray[np.float64]:
    """Return the numbers in the column `name` (one of `plan.columns`) of rows of results, shape (number of rows,)."""
    place = plan.columns.index(name)
    return np.array([row[place] for row in rows], float)


def label_of(name: str) -> tuple[str, float]:
    """Return the axis label of a parameter with its unit, and the factor from SI to that unit.

    For a configuration value, the label is its dotted name and the factor is 1.
    """
    return LABELS.get(name, (name, 1.0))


def along(
    plan: Plan, rows: Sequence[Row], quantity: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return the curve of one quantity along a branch of orbits, for drawing.

    Returns:
        The parameter of each orbit [SI], the quantity, and whether the orbit is stable, each of shape (n,). Rows of
        changes and of the end of the branch are left out.
    """
    path = [row for row in rows if row[plan.columns.index("event")] in ("orbit", "start")]
    across, height, stable = (column(plan, path, name) for name in (plan.columns[0], quantity, "stable"))
    return across, height, stable > 0.0


def _section(panes: Sequence[Axes], plan: Plan, found: Found) -> None:
    for i, (task, rows) in enumerate(found):
        if plans.without_results([(task, rows)]):
            continue
        x, v = column(plan, rows, "x_2_m"), column(plan, rows, "v_2_m_s")
        panes[0].plot(1e3 * x, v, ".", color=SERIES[i], markersize=1.5, label=task.name)
    panes[0].set(xlabel=_SPHERE, ylabel="its velocity (m/s)")


def _bifurcation(panes: Sequence[Axes], plan: Plan, found: Found) -> None:
    label, factor = label_of(plan.over)
    known: dict[str, int] = {}
    for task, rows in found:
        direction = plans.direction_of(task)
        name = f"{'each from rest' if direction == RESET else direction}, sphere from {plans.named(task.what['start'])}"
        first = name not in known
        colour = SERIES[known.setdefault(name, len(known))]
        across = factor * column(plan, rows, plan.columns[0])
        for pane, quantity, scale in zip(panes, ("x_2_m", "dt"), (1e3, 1.0), strict=True):
            pane.plot(
                across,
                scale * column(plan, rows, quantity),
                ".",
                color=colour,
                label=name if first else None,
                markersize=max(1.2, 3.0 - 1.4 * known[name]),  # lower markers show around upper ones
            )
    panes[0].set(ylabel=_SPHERE)
    panes[1].set(xlabel=label, ylabel="DT (-)")


def _basin(panes: Sequence[Axes], plan: Plan, found: Found) -> None:
    from matplotlib.colors import ListedColormap  # noqa: PLC0415  # imported only for drawing

    rows = [row for _, each in found for row in each]
    if not rows:
        return
    x, y = (np.unique(column(plan, rows, name)) for name in (POSITION, SPEED))
    place = np.searchsorted(x, column(plan, rows, POSITION)), np.searchsorted(y, column(plan, rows, SPEED))
    words = [motion(plan, row) for row in rows]
    kinds = sorted(set(words))
    grid = np.full((len(y), len(x)), np.nan)
    grid[place[1], place[0]] = [kinds.index(word) for word in words]
    colours = [SERIES[i % len(SERIES)] for i in range(len(kinds))]
    panes[0].grid(visible=False)
    panes[0].pcolormesh(
        1e3 * x, y, grid, cmap=ListedColormap(colours), vmin=-0.5, vmax=len(kinds) - 0.5, rasterized=True
    )
    for colour, kind in zip(colours, kinds, strict=True):
        panes[0].plot([], [], "s", color=colour, label=kind)
    panes[0].set(xlabel=LABELS[POSITION][0], ylabel=LABELS[SPEED][0])


def motion(plan: Plan, row: Row) -> str:
    """Return the legend text of the motion to which one start of a basin study leads.

    The text is "no impacts", the rounded DT of a periodic motion, or the regime of another motion.
    """
    cell = dict(zip(plan.columns, row, strict=True))
    if not cell["impacts_per_cycle"]:
        return "no impacts"
    return f"DT {cell['dt']:.0f}" if cell["regime"] == "periodic" else str(cell["regime"])


def _orbit(panes: Sequence[Axes], plan: Plan, found: Found) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    panes[0].plot(np.cos(angle), np.sin(angle), "-", color=INK, linewidth=0.8)
    for i, (task, rows) in enumerate(found):
        if plans.without_results([(task, rows)]):
            continue
        panes[0].plot(
            column(plan, rows, "multiplier_real"),
            column(plan, rows, "multiplier_imag"),
            "o",
            color=SERIES[i],
            label=task.name,
        )
    panes[0].set(xlabel="largest multiplier, real part", ylabel="imaginary part")
    panes[0].set_aspect("equal", adjustable="datalim")


def draw_branch(
    pane: Axes, plan: Plan, rows: Sequence[Row], quantity: str, colour: str, label: str | None
) -> list[tuple[list[float], list[float]]]:
    """Draw one quantity along a branch of orbits over the parameter.

    Stable orbits are drawn as a line, unstable orbits as a dotted line.

    Args:
        pane: axes to draw in.
        plan: the continuation study.
        rows: its rows of one branch.
        quantity: name of the column to draw.
        colour: colour of the branch.
        label: text in the legend, or None; there is no entry for a branch without orbits.

    Returns:
        The drawn points of the stable orbits, and those of the unstable orbits, each as (parameter in the unit of the
        axis, quantity).
    """
    across, height, stable = along(plan, rows, quantity)
    across = label_of(plan.over)[1] * across
    for which, line in ((stable, "-"), (~stable, ":")):
        if not which.any():
            continue
        name, label = label, None
        near = which | np.append(which[1:], False) if line == ":" else which
        pane.plot(across, np.where(near, height, np.nan), line, color=colour, label=name)
    return [(across[which].tolist(), height[which].tolist()) for which in (stable, ~stable)]


def _continue(panes: Sequence[Axes], plan: Plan, found: Found) -> None:
    label, factor = label_of(plan.over)
    events = plan.columns.index("event")
    for pane, quantity in zip(panes, ("dt", "loss_factor"), strict=True):
        for i, (task, rows) in enumerate(found):
            draw_branch(pane, plan, rows, quantity, SERIES[i], task.name)
        for event, mark in MARKS.items():  # after all branches, so that the legend lists them last
            if marked := [row for _, rows in found for row in rows if row[events] == event]:
                pane.plot(
                    factor * column(plan, marked, plan.columns[0]), column(plan, marked, quantity), mark, color=INK,
                    fillstyle="none", linestyle="none", label=event,
                )  # fmt: skip
    panes[0].set(ylabel="DT (-)")
    panes[1].set(xlabel=label, ylabel="loss factor (-)")


def _exponent(panes: Sequence[Axes], plan: Plan, found: Found) -> None:
    label, factor = label_of(plan.over)
    starts = list(dict.fromkeys(plans.named(task.what["start"]) for task, _ in found))
    for i, start in enumerate(starts):
        rows = [row for task, each in found for row in each if plans.named(task.what["start"]) == start]
        rate, doubt = column(plan, rows, "exponent_per_s"), column(plan, rows, "uncertainty_per_s")
        panes[0].errorbar(
            factor * column(plan, rows, plan.columns[0]), rate, 2.0 * doubt, fmt=".", color=SERIES[i], label=start
        )
    panes[0].axhline(0.0, color=INK, linewidth=0.8)
    panes[0].set(xlabel=label, ylabel="largest exponent (1/s)")


_DRAWERS: Mapping[str, tuple[Callable[[Sequence[Axes], Plan, Found], None], int, str]] = {
    plans.SECTION: (_section, 1, "one point per cycle of the drive."),
    plans.BIFURCATION: (_bifurcation, 2, "one point per cycle of the drive, after the motion has settled."),
    plans.BASIN: (_basin, 1, "the motion that each start of the sphere leads to, the rest of the rig at rest."),
    plans.ORBIT: (_orbit, 1, "an orbit is stable if its largest multiplier lies within the circle."),
    plans.CONTINUE: (_continue, 2, "stable orbits are solid lines, unstable ones dotted."),
    plans.EXPONENT: (_exponent, 1, "bars are two standard uncertainties."),
}
