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
"""Heat maps of a map study: reduction of DT and regimes over two axes, with predicted motions."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from impact_rig.drawing import INK, Drawn, legend_outside, new_axes, style
from impact_rig.errors import ConfigError
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_studies import prediction
from impact_rig_studies.dynamics.figures import label_of
from impact_rig_studies.maps.plan import BOTH, CURRENT, DOWN, FREQUENCY, GAP, POSITION, SPEED, UP, MapPlan
from impact_rig_studies.maps.run import FinishedMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

QUIET, TWO, OTHER, MODULATED, CHAOTIC, NONE = range(6)
REGIMES = {
    QUIET: ("no impacts", "#d9dde3"),
    TWO: ("two impacts per cycle", "#8ec5ea"),
    OTHER: ("periodic otherwise", "#0072b2"),
    MODULATED: ("modulated", "#e08a00"),
    CHAOTIC: ("chaotic or intermittent", "#1b1f24"),
    NONE: ("no result", "#ffffff"),
}
"""Legend text and colour of each class; the colours differ in lightness, for readers with any colour vision."""
PREDICTED = "#e5007d"  # colour of the predicted limits


def heat_maps(done: FinishedMap) -> Iterator[Drawn]:
    """Yield the figures of a map study: one for each layer and each value of the third axis.

    A layer is a direction of the measurement, or a start of the sphere. A map of two axes that was measured upwards and
    downwards has one more figure: DT down / DT up − 1 in percent.
    """
    plan = done.plan
    pages = list(plan.axes.items())[2:]
    for layer, values in done.values.items():
        for i, page in enumerate(pages[0][1] if pages else (None,)):
            cut = ... if page is None else (slice(None), slice(None), i)
            words = f"{plan.title}: {layer}" if page is None else f"{plan.title}: {layer}, {pages[0][0]} {page:g}"
            name = f"map_{layer}" if page is None else f"map_{layer}_{i}"
            reductions = np.asarray(values["reduction_percent"][cut], float)
            yield _drawn(plan, name, words, reductions, classes(values)[cut], "reduction of DT (%)", page)
    if plan.direction == BOTH and not pages:
        up, down = (np.asarray(done.values[layer]["dt"], float) for layer in (UP, DOWN))
        apart = 100.0 * (down / up - 1.0)
        yield _drawn(
            plan, "map_up_down", f"{plan.title}: down against up", apart, None, "DT down / DT up − 1 (%)", None
        )


def classes(values: dict[str, NDArray[np.generic]]) -> NDArray[np.int64]:
    """Return the class of motion at each point of a map, as one of the numbers `QUIET` to `CHAOTIC`, or `NONE`.

    `NONE` means a point without result: not measured yet, or its motion could not be simulated. `values` contains the
    arrays of the map's results, by field name of `Reading`. The arrays and the result have the same shape.
    """
    regime, impacts = values["regime"], np.asarray(values["impacts_per_cycle"], float)
    period = np.asarray(values["period"], float)
    found = np.full(regime.shape, NONE)
    found[regime == "periodic"] = OTHER
    found[(regime == "periodic") & (period == 1.0) & (np.abs(impacts - 2.0) < 0.01)] = TWO
    found[(regime == "periodic") & (impacts == 0.0)] = QUIET
    found[regime == "modulated"] = MODULATED
    found[np.isin(regime, ("chaotic", "intermittent"))] = CHAOTIC
    return found


def _drawn(
    plan: MapPlan,
    name: str,
    title: str,
    z: NDArray[np.float64],
    groups: NDArray[np.int64] | None,
    unit: str,
    page: float | None,
) -> Drawn:
    """Draw the values `z`, with `unit` as label, over the first two axes of a map.

    Args:
        plan: plan of the map, which defines its axes.
        name: name of the figure.
        title: title of the figure.
        z: values, shape (n, m) for n values of the first axis and m of the second.
        groups: class of motion at each point, shown in a second picture. None means that `z` contains signed
            differences, which are shown alone, in colours about zero.
        unit: label of the values, with their unit.
        page: value of the third axis, or None without one.
    """
    (x_name, x), (y_name, y) = list(plan.axes.items())[:2]
    (x_label, x_factor), (y_label, y_factor) = label_of(x_name), label_of(y_name)
    x_edges, y_edges = _edges(np.asarray(x) * x_factor), _edges(np.asarray(y) * y_factor)
    signed = groups is None
    with style():
        figure, panes = new_axes(4.0 if signed else 6.4, (1.0,) if signed else (1.0, 1.0))
        limit = float(np.nanmax(np.abs(z))) if signed and np.isfinite(z).any() else None
        mesh = panes[0].pcolormesh(
            x_edges, y_edges, z.T, cmap="RdBu_r" if signed else "viridis", rasterized=True,
            vmin=-limit if limit else None, vmax=limit,
        )  # fmt: skip
        figure.colorbar(mesh, ax=panes[0], label=unit)
        if groups is not None:
            _regimes(panes[1], x_edges, y_edges, groups)
            _predicted(panes, plan, page)
        for axis in panes:
            axis.grid(visible=False)
            axis.set(ylabel=y_label, xlim=x_edges[[0, -1]], ylim=y_edges[[0, -1]])
        panes[0].set_title(title, loc="left")
        panes[-1].set(xlabel=x_label)
        legend_outside(figure, panes[-1], 3)
        return Drawn(name, figure, f"{title}. Measured on the mechanics, without instruments.")


def _edges(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the borders between the cells around n ≥ 2 values of an axis, shape (n + 1,).

    Inner borders lie halfway between neighbours. Each outer value lies in the middle of its cell.
    """
    middle = 0.5 * (x[1:] + x[:-1])
    return np.concatenate([[1.5 * x[0] - 0.5 * x[1]], middle, [1.5 * x[-1] - 0.5 * x[-2]]])


def _regimes(axis: Axes, x: NDArray[np.float64], y: NDArray[np.float64], groups: NDArray[np.int64]) -> None:
    """Colour the cells of a map by the class of their motion, and name the classes in the legend.

    `x` and `y` are the edges of the cells, `groups` the classes, shape (len(x) − 1, len(y) − 1).
    """
    from matplotlib.colors import ListedColormap  # noqa: PLC0415  # only when something is drawn

    colours = ListedColormap([REGIMES[group][1] for group in sorted(REGIMES)])
    axis.pcolormesh(x, y, groups.T, cmap=colours, vmin=-0.5, vmax=len(REGIMES) - 0.5, rasterized=True)
    for group in np.unique(groups).tolist():
        word, colour = REGIMES[group]
        axis.plot([], [], "s", color=colour, markeredgecolor=INK, markeredgewidth=0.5, label=word)


def _predicted(panes: Sequence[Axes], plan: MapPlan, page: float | None) -> None:
    """Draw the predicted limits of stable motions with two symmetric impacts per cycle on a map of gap and frequency.

    `page` is the value of the map's third axis, or None. Nothing is drawn if the prediction does not apply.
    """
    names = list(plan.axes)
    if {*names[:2]} != {GAP, FREQUENCY} or plan.base.drive.kind != "current":
        return
    config, current = plan.base, plan.current_a
    if page is not None and names[2] == CURRENT:
        current = page
    elif page is not None and names[2] not in (POSITION, SPEED):  # on the start, a stable motion does not depend
        config = from_flat(config, {names[2]: page})
    frequencies = np.linspace(min(plan.axes[FREQUENCY]), max(plan.axes[FREQUENCY]), 60)
    try:
        ends = _stable_gaps(config, current, tuple(frequencies.tolist()))
    except ConfigError:
        return
    for gaps, label in zip(ends, ("two symmetric impacts: predicted", None), strict=True):
        x, y = (gaps, frequencies) if names[0] == GAP else (frequencies, gaps)
        for axis in panes:
            axis.plot(x, y, "--", color=PREDICTED, linewidth=1.4, label=label)


@functools.lru_cache(maxsize=8)  # of all pictures of a map: most show the same rig
def _stable_gaps(
    config: RigConfig, current_a: float, frequencies_hz: tuple[float, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and largest gap [mm] with a predicted stable motion at each frequency, NaN without one.

    Raises:
        ConfigError: the rig is outside the validity of the theory.
    """
    found = [prediction.branch(config, one, current_a=current_a) for one in frequencies_hz]
    stable = [one.take(one.stable).gap_m * 1e3 for one in found]
    least, most = (np.array([choose(gaps) if len(gaps) else np.nan for gaps in stable]) for choose in (np.min, np.max))
    return least, most
