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
"""Figures of the studies of a campaign: DT, or its reduction, over one varied quantity, with predictions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.uncertainty_budget import COVERAGE
from impact_rig.drawing import INK, PREDICTED, SERIES, Drawn, Line, legend_below, new_axes
from impact_rig.errors import ConfigError
from impact_rig.physics.linear_response import transmissibility
from impact_rig.rig.config import RigConfig, from_flat, to_flat
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig_studies import prediction
from impact_rig_studies.campaign.results import Curves, Point
from impact_rig_studies.dynamics import figures
from impact_rig_studies.dynamics.plan import FinishedStudy
from impact_rig_studies.reduction import reduction

AXIS_NAMES = {
    "frequency_hz": ("frequency", "Hz", 1.0),
    "gap_m": ("gap", "mm", 1e3),
    "current_a": ("current", "A", 1.0),
    "contact.restitution": ("nominal restitution", "", 1.0),
    "sphere.density_kg_m3": ("density of the sphere", "kg/m³", 1.0),
}
OF_INSTRUMENTS = ("daq.", "instruments.", "time.", "step.", "output.", "pluck.")
"""Beginnings of the names of configuration values that do not affect the mechanics."""
OPEN: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 5.0, "markerfacecolor": "white", "zorder": 3}
"""Style of drawn points with a sphere that did not strike."""
MOST_LINES = 2 * len(SERIES)  # the second half is dashed


def study_figures(
    study: str, points: Sequence[Point], curves: Curves, calibration: Calibration, theory: Line | None = None
) -> Iterator[Drawn]:
    """Yield the figure of a study: DT, or its reduction, over the axis with the most values.

    There is one line for each combination of the other values. Nothing is yielded if no numeric axis has three values,
    or if there are too many lines. The reduction is relative to the reference rig without the sphere. DT itself is
    shown over the frequency, and if reductions cannot be computed.

    Args:
        study: name of the study.
        points: points of the study; only settled ones are drawn.
        curves: settled points of the reference rig, which is that of the campaign's first job.
        calibration: calibration of the instruments.
        theory: predicted reduction over the gap, drawn only in a figure of the reduction over the gap; None means none.
    """
    settled = [point for point in points if point.settled]
    if not settled:
        return
    places = {id(point): _place(point) for point in settled}
    names = list(next(iter(places.values())))
    numeric = [name for name in names if all(isinstance(places[id(p)][name], float) for p in settled)]
    counts = {name: len({places[id(p)][name] for p in settled}) for name in names}
    if not numeric:
        return
    along = max(numeric, key=lambda name: counts[name])
    if counts[along] < 3:
        return
    others = [name for name in names if name != along and counts[name] > 1]
    one_set = not any(name.startswith(("daq.", "instruments.")) for name in names)
    relative = along != "frequency_hz" and one_set and all(curves.at(NO_SPHERE, p.frequency_hz) for p in settled)
    lines: dict[str, list[Point]] = {}
    for point in settled:
        if point.gap_m == NO_SPHERE and (relative or along == "gap_m"):
            continue
        label = ", ".join(_word(name, places[id(point)][name]) for name in others)
        lines.setdefault(label, []).append(point)
    if len(lines) > MOST_LINES:
        return
    figure, (axis,) = new_axes(3.5)
    name, unit, factor = AXIS_NAMES.get(along, (along.rpartition(".")[2], "", 1.0))
    numbers: list[Line] = []
    styles = [(shade, line) for line in ("-", "--") for shade in SERIES]
    for (shade, style), (label, line) in zip(styles, lines.items(), strict=False):
        ordered = line if along == "frequency_hz" else sorted(line, key=lambda p: float(places[id(p)][along]))
        x = [factor * float(places[id(p)][along]) for p in ordered]
        drawn = [_reduction(p, curves, calibration) if relative else (p.dt, p.u_dt) for p in ordered]
        y, u = zip(*drawn, strict=True)
        bars = COVERAGE * np.array(u)
        shown = "reduction_percent" if relative else "transmissibility"
        place = [float(places[id(p)][along]) for p in ordered]
        quiet = np.array([bool(p.note) for p in ordered])
        shown_columns = {along: place, shown: list(y), "expanded_uncertainty": bars.tolist()}
        numbers.append(Line(label, {**shown_columns, "no_impacts": quiet.astype(float).tolist()}))
        axis.errorbar(x, y, bars, color=shade, linestyle=style, marker="o", markersize=3.0, linewidth=1.0, label=label)
        if quiet.any():
            at = np.flatnonzero(quiet)
            axis.plot(np.array(x)[at], np.array(y)[at], color=shade, **OPEN)
    axis.set(
        xlabel=f"{name} ({unit})" if unit else name,
        ylabel="reduction of DT (%)" if relative else "transmissibility",
        title=f"Study: {study}",
    )
    if theory is not None and along == "gap_m" and relative:
        gaps, percent = (np.array(theory.columns[name]) for name in ("gap_m", "reduction_percent"))
        axis.plot(factor * gaps, percent, color=PREDICTED, linewidth=2.5, zorder=1, label=theory.label)
        numbers.append(theory)
    if len(numbers) > 1:
        legend_below(axis, 2)
    caption = f"Study “{study}”: {len(settled)} settled points, ± 2u."
    if notes := [point.note for point in settled if point.note]:
        caption += f" Open circles: the sphere did not strike ({notes[0]})."
    yield Drawn(f"study_{study}", figure, caption, numbers)


def _place(point: Point) -> dict[str, float | str]:
    """Return the value of each axis at a point, by name of the axis.

    The axes are frequency, gap (`NO_SPHERE` without a sphere), current, direction, and those that the study varies.
    Numbers are floats in SI units. Other values, and the seed, are texts.
    """
    place: dict[str, float | str] = {
        "frequency_hz": point.frequency_hz,
        "gap_m": point.gap_m,
        "current_a": point.current_a,
        "direction": point.direction,
    }
    for name, value in point.axes.items():
        number = isinstance(value, (int, float)) and not isinstance(value, bool) and name != "daq.seed"
        place[name] = float(value) if number else str(value)  # type: ignore[arg-type]  # a number is one
    return place


def _word(name: str, value: float | str) -> str:
    title, unit, factor = AXIS_NAMES.get(name, (name.rpartition(".")[2], "", 1.0))
    if name == "gap_m" and value == NO_SPHERE:
        return "no sphere"
    text = f"{factor * value:g}" if isinstance(value, float) else value.replace("_", " ")
    return text if isinstance(value, str) else f"{title} {text} {unit}".strip()


def _reduction(point: Point, curves: Curves, calibration: Calibration) -> tuple[float, float]:
    """Return the reduction of DT at a point relative to DT without sphere [%], and its standard uncertainty [points].

    The reference rig must have been measured without sphere at this frequency.
    """
    without = curves.at(NO_SPHERE, point.frequency_hz)
    assert without is not None
    found = reduction(without.rows, point.rows, calibration)
    return found.percent, found.u_points


def continued(name: str, study: FinishedStudy, points: Sequence[Point], config: RigConfig) -> Drawn:
    """Draw DT along continued branches of the model's motions, together with measurements.

    The measurements are the settled points with sphere of the reference rig, at the values that are constant along the
    branches. The reference rig is that of the campaign's first job.

    Args:
        name: name of the figure.
        study: branches that `impact-rig dynamics continue` computed.
        points: points of the campaign.
        config: configuration of the campaign's rig.

    Raises:
        ConfigError: the branches belong to another rig, or are over a parameter that a report does not show.
    """
    plan = study.plan
    others = {"barriers.gap_m", "sphere.start", "sphere.present"}
    ours, theirs = to_flat(config), to_flat(plan.base)
    for key in ours:
        if ours[key] != theirs[key] and key not in others and not key.startswith(OF_INSTRUMENTS):
            raise ConfigError(
                f"the branches belong to another rig: its {key} is {theirs[key]}, but {ours[key]} in the campaign; "
                "compute them with the configuration of the campaign"
            )
    task = plan.tasks[0]
    held = {"frequency_hz": task.frequency_hz, "current_a": task.current_a, "gap_m": plan.base.barriers.gap_m}
    if plan.over not in held:
        raise ConfigError(
            f"branches over {plan.over} cannot be shown in a report, only branches over {', '.join(held)}; leave their "
            "directory out of --branches"
        )
    del held[plan.over]
    at = [
        p
        for p in points
        if p.reference and p.settled and p.gap_m != NO_SPHERE and all(getattr(p, n) == v for n, v in held.items())
    ]
    figure, (axis,) = new_axes(3.5)
    label, factor = figures.label_of(plan.over)
    numbers: list[Line] = []
    for i, (one, rows) in enumerate(study.found):
        both = figures.draw_branch(axis, plan, rows, "dt", SERIES[i % len(SERIES)], one.name)
        for word, (x, y) in zip(("stable", "unstable"), both, strict=True):
            numbers.append(Line(f"{one.name}, {word}", {plan.over: [v / factor for v in x], "transmissibility": y}))
    x, y, bars = [getattr(p, plan.over) for p in at], [p.dt for p in at], [COVERAGE * p.u_dt for p in at]
    axis.errorbar(
        [factor * value for value in x], y, bars, color=INK, marker="o", markersize=3.0, linestyle="none",
        label="measured, ± 2u",
    )  # fmt: skip
    numbers.append(Line("measured", {plan.over: x, "transmissibility": y, "expanded_uncertainty": bars}))
    axis.set(xlabel=label, ylabel="transmissibility", title=f"Continued: {plan.title}")
    legend_below(axis, 2)
    where = ", ".join(f"{key} {value:g}" for key, value in held.items())
    caption = (
        f"Motions of the model without instruments ({where}); stable ones as solid lines, unstable ones dotted. "
        f"The points are {len(at)} measurements. The model may have further motions that are not drawn."
    )
    return Drawn(name, figure, caption, numbers)


# --- Predictions without simulation: closed form without the sphere, two impacts per cycle with it


@attrs.frozen(eq=False)
class Stretch:
    """Part of a predicted curve without interruption; every attribute has the shape (n,)."""

    frequency_hz: NDArray[np.float64]  # ascending
    dt: NDArray[np.float64]  # transmissibility
    phase_rad: NDArray[np.float64]  # phase of the superior base relative to the inferior one


def predicted(
    config: RigConfig, gap_m: float, frequencies_hz: NDArray[np.float64], current_a: float
) -> Sequence[Stretch]:
    """Return the predicted DT and phase over the frequency for a gap at constant current, as continuous parts.

    Without sphere, the prediction is the closed form of the linear rig. With sphere, it is that of stable motions with
    two impacts per cycle. The result is empty if there are no such motions or the theory does not apply.

    Args:
        config: configuration of the rig, whose own gap is ignored.
        gap_m: gap [m], or `NO_SPHERE`.
        frequencies_hz: ascending frequencies, shape (n,).
        current_a: peak current [A].
    """
    if gap_m == NO_SPHERE:
        ratio = transmissibility(config, frequencies_hz)
        return [Stretch(frequencies_hz, np.abs(ratio), np.angle(ratio))]
    try:
        rig = from_flat(config, {"sphere.present": True, "barriers.gap_m": gap_m})
        branches = prediction.curves(rig, frequencies_hz, gap_m, current_a=current_a)
    except ConfigError:  # outside the validity of the theory: friction, no loss, ...
        return []
    return [part for one in branches for part in _lasting(one)]


def reduction_over_gap(config: RigConfig, frequency_hz: float, current_a: float) -> Line | None:
    """Return the predicted reduction of DT [%] over the gap [m] at one frequency and constant current.

    The prediction is that of stable motions with two impacts per cycle. Returns None if the theory does not apply to
    the rig, or predicts such motions at fewer than two gaps.

    Args:
        config: configuration of the rig, whose own gap is ignored.
        frequency_hz: drive frequency.
        current_a: peak current [A].
    """
    try:
        rig = from_flat(config, {"sphere.present": True})
        found = prediction.branch(rig, frequency_hz, current_a=current_a)
    except ConfigError:  # as above
        return None
    lasting = np.flatnonzero(found.stable)
    order = lasting[np.argsort(found.gap_m[lasting])]
    if len(order) < 2:
        return None
    without = abs(complex(transmissibility(config, frequency_hz)))
    percent = 100.0 * (1.0 - found.dt[order] / without)
    return Line("predicted", {"gap_m": found.gap_m[order].tolist(), "reduction_percent": percent.tolist()})


def _lasting(branch: prediction.Branch) -> Sequence[Stretch]:
    """Return the parts of a branch on which the motion is stable, each with at least two points."""
    stable = np.flatnonzero(branch.stable)
    runs = np.split(stable, np.flatnonzero(np.diff(stable) > 1) + 1)
    return [Stretch(branch.frequency_hz[i], branch.dt[i], branch.phase_rad[i]) for i in runs if len(i) > 1]
