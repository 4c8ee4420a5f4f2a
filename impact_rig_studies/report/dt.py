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
"""Figures of a campaign: DT over frequency and gap with paper and theory, residuals, motion and regimes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any  # Any: what matplotlib takes

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.uncertainty_budget import COVERAGE
from impact_rig.drawing import (
    CHAOTIC,
    GRID,
    INK,
    MEASURED,
    MODULATED,
    MUTED,
    PAPER_RED,
    PERIODIC,
    PREDICTED,
    QUIET,
    SERIES,
    Drawn,
    Line,
    legend_below,
    new_axes,
    style,
)
from impact_rig.rig.config import RigConfig
from impact_rig.rig.gaps import NO_SPHERE, case_of
from impact_rig.system import files
from impact_rig_studies.campaign import paper
from impact_rig_studies.campaign.job import Trace
from impact_rig_studies.campaign.paper import FREQUENCIES_HZ, FREQUENCY_HZ, REDUCTION_PERCENT, Reductions
from impact_rig_studies.campaign.results import Curves, Point
from impact_rig_studies.campaign.statements import MissingError, peak_hz
from impact_rig_studies.reduction import Damper, damper_effect
from impact_rig_studies.report.studies import Stretch, predicted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NEAR_HZ = (8.85, 9.35)  # range in which the cases differ
HEIGHT_INCH = 6.6
FINE = 400  # number of frequencies at which a prediction is drawn


def draw_without_sphere(curves: Curves, config: RigConfig) -> Iterator[Drawn]:
    """Draw the measured DT without the sphere over the frequency, and the closed form for the configured rig."""
    points = curve(curves, NO_SPHERE)
    if not points:
        return
    figure, (axis,) = new_axes(2.9)
    fine = np.linspace(FREQUENCIES_HZ[0], FREQUENCIES_HZ[-1], FINE)
    (exact,) = predicted(config, NO_SPHERE, fine, paper.CURRENT_A)
    axis.plot(fine, exact.dt, color=PREDICTED, linewidth=0.9, label="closed form")
    _errorbar(axis, points, MEASURED, "none", label="measured, ± 2u")
    axis.axvline(FREQUENCY_HZ, color=PAPER_RED, linewidth=0.9, linestyle=":", label="paper: 9.1 Hz")
    axis.set(xlabel="frequency (Hz)", ylabel="transmissibility", title=_title(NO_SPHERE), ylim=(0.0, None))
    axis.legend(loc="upper left")
    caption = "Displacement transmissibility without the sphere (the paper's Fig. 6)."
    lines = [curve_numbers(NO_SPHERE, points), _predicted_line(NO_SPHERE, exact)]
    yield Drawn("fig6_without_sphere", figure, caption, lines)


def draw_all_gaps(curves: Curves, config: RigConfig) -> Iterator[Drawn]:
    """Draw DT and phase over the frequency, measured and predicted, for the paper's gaps and without sphere.

    There are two figures: the complete range of the paper's frequencies, and the range near resonance. Only
    measurements at the paper's current are drawn. Nothing is drawn if fewer than two cases (a gap, or no sphere) were
    measured.
    """
    cases = [gap for gap in (NO_SPHERE, *REDUCTION_PERCENT) if curve(curves, gap)]
    if len(cases) < 2:
        return
    explained = (
        "Linear above, logarithmic in the middle, and the phase of the superior base to the inferior one. Points: "
        "measured, ± 2u. Solid lines: predicted without simulation. Dotted lines connect the points if there is no "
        "prediction. Diamonds: our DT without sphere, reduced by the percentage in the paper."
    )
    whole = (FREQUENCIES_HZ[0], FREQUENCIES_HZ[-1])
    ranges = (
        ("fig7_all_gaps", whole, "All cases over the frequency (the paper's Fig. 7)."),
        ("fig7_near_resonance", NEAR_HZ, "The same near resonance, where the cases differ."),
    )
    for name, (low, high), what in ranges:
        measured = {
            gap: [
                point
                for frequency, point in sorted(curves.by_gap[gap].items())
                if low <= frequency <= high and point.current_a == paper.CURRENT_A
            ]
            for gap in cases
        }
        theory = {gap: predicted(config, gap, np.linspace(low, high, FINE), paper.CURRENT_A) for gap in cases}
        lines = [curve_numbers(gap, points) for gap, points in measured.items()]
        lines += [_predicted_line(gap, part) for gap, parts in theory.items() for part in parts]
        figure, axes = new_axes(HEIGHT_INCH, (1.5, 1.5, 1.0))
        for gap in cases:
            _draw_case(axes, gap, measured[gap], theory[gap])
            wanted = papers_dt(curves, gap) if gap != NO_SPHERE else None
            if wanted is None:
                continue
            for axis in axes[:2]:
                axis.plot(FREQUENCY_HZ, wanted, "D", color=PAPER_RED, markerfacecolor="none", markersize=5.0)
        axes[2].plot([], [], "D", color=PAPER_RED, markerfacecolor="none", markersize=5.0, label="paper")
        axes[0].set(
            ylabel="transmissibility",
            ylim=(0.0, None),
            title=f"At {paper.CURRENT_A * 1e3:g} mA; points: measured, ± 2u",
        )
        axes[1].set(ylabel="transmissibility", yscale="log")
        axes[1].yaxis.set_major_formatter("{x:g}")
        axes[1].yaxis.set_minor_formatter(_label_if_first)
        axes[2].set(ylabel="phase (°)", xlabel="frequency (Hz)", ylim=(-190.0, 10.0))
        axes[2].set_yticks([-180, -90, 0])
        legend_below(axes[2], 4)
        yield Drawn(name, figure, f"{what} {explained}", lines)


def _label_if_first(value: float, _: float) -> str:
    """Return the label of a minor tick, or an empty text unless its first digit is 2 or 5."""
    return f"{value:g}" if f"{value:e}"[0] in "25" else ""


def _draw_case(axes: Sequence[Axes], gap: float, points: Sequence[Point], theory: Sequence[Stretch]) -> None:
    """Draw the measured points of one gap with error bars, and lines of the theory.

    The three axes show DT linear, DT logarithmic, and phase. Without a theory, dotted lines connect the points of DT.
    """
    frequency, shade = [p.frequency_hz for p in points], colour(gap)
    phases = _lag_deg([p.phase_rad for p in points])
    bars = [COVERAGE * math.degrees(float(p.rows["phase_uncertainty"][0])) for p in points]
    for axis in axes[:2]:
        _errorbar(axis, points, shade, "none", markersize=3.0, capsize=1.5)
        for part in theory:
            axis.plot(part.frequency_hz, part.dt, color=shade, linewidth=1.0, linestyle="-")
        if not theory:
            axis.plot(frequency, [p.dt for p in points], color=shade, linewidth=0.8, linestyle=":")
    axes[2].errorbar(
        frequency, phases, bars, color=shade, marker="o", markersize=3.0, linestyle="none", capsize=1.5, label=case(gap)
    )
    for part in theory:
        axes[2].plot(part.frequency_hz, _lag_deg(part.phase_rad), color=shade, linewidth=1.0, linestyle="-")


def _lag_deg(phase_rad: ArrayLike) -> NDArray[np.float64]:
    """Convert phases from radians in −π to π to degrees for drawing; a lead above 90° is shown as a lag.

    The result is above −270 and at most 90.
    """
    degrees = np.degrees(phase_rad)
    return np.where(degrees > 90.0, degrees - 360.0, degrees)


def _predicted_line(gap: float, part: Stretch) -> Line:
    columns = {
        "frequency_hz": part.frequency_hz.tolist(),
        "transmissibility": part.dt.tolist(),
        "phase_deg": np.degrees(part.phase_rad).tolist(),
    }
    return Line(f"{case(gap)}, predicted", columns)


# --- The reductions compared with the paper's


@style()
def draw_reductions(reductions: Reductions, path: Path) -> Path:
    """Draw DT and its reduction by gap, next to the paper's five numbers, into a PNG file at `path`; return `path`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  # a second of import, only for figures
    from matplotlib.figure import Figure  # noqa: PLC0415

    gaps = sorted(reductions.dt)
    names = [f"{gap * 1e3:g}" for gap in gaps]
    ours, spread = reductions.percent(), reductions.percent_uncertainty
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.35])

    heights = [reductions.dt_no_sphere, *(reductions.dt[gap] for gap in gaps)]
    left.bar(["none", *names], heights, color=[MUTED] + [MEASURED] * len(gaps), width=0.65)
    for i, height in enumerate(heights):
        left.text(i, height, f"{height:.1f}", ha="center", va="bottom", fontsize=8)
    left.set(xlabel="gap (mm)", ylabel="displacement transmissibility", title="DT at 9.1 Hz, constant current")
    left.margins(y=0.12)

    places = range(len(gaps))
    right.bar(
        [i - 0.2 for i in places], [REDUCTION_PERCENT.get(g, 0.0) for g in gaps], 0.38, color=PAPER_RED, label="paper"
    )
    right.bar(
        [i + 0.2 for i in places], [ours[g] for g in gaps], 0.38, yerr=[2.0 * spread[g] for g in gaps],
        color=MEASURED, ecolor=INK, capsize=3, label="this run (± 2u)",
    )  # fmt: skip
    for i, gap in enumerate(gaps):
        published = REDUCTION_PERCENT.get(gap, 0.0)
        for x, y, value in ((i - 0.2, published, published), (i + 0.2, ours[gap] + 2.0 * spread[gap], ours[gap])):
            right.text(x, y, f"{value:z.1f}", ha="center", va="bottom", fontsize=8)
    right.set_xticks(list(places), names)
    right.set(xlabel="gap (mm)", ylabel="reduction of DT (%)", title="Reduction by the sphere")
    right.legend(frameon=False, loc="upper left")
    right.margins(y=0.2)
    for axes in (left, right):
        axes.grid(visible=False, axis="x")
    with files.atomic_write(path) as file:
        figure.savefig(file, format="png", dpi=140)
    return path


# --- What is left: by gap, and without the sphere against theory


def draw_reductions_by_gap(reductions: Reductions) -> Iterator[Drawn]:
    """Draw the measured reductions of DT at 9.1 Hz over the gap, next to the paper's."""
    ours, spread = reductions.percent(), reductions.percent_uncertainty
    if not ours:
        return
    figure, (axis,) = new_axes(3.0)
    gaps = sorted(ours)
    millimetres = np.array(gaps) * 1e3
    axis.errorbar(
        millimetres, [ours[g] for g in gaps], [COVERAGE * spread[g] for g in gaps],
        color=MEASURED, marker="o", capsize=3.0, label="this rig, ± 2u",
    )  # fmt: skip
    published = [REDUCTION_PERCENT[g] for g in gaps]
    axis.plot(millimetres, published, "D", color=PAPER_RED, markerfacecolor="none", markersize=6.0, label="paper")
    axis.set(xlabel="gap (mm)", ylabel="reduction of DT at 9.1 Hz (%)", title="Reduction by the sphere", ylim=(20, 55))
    axis.set_xticks(millimetres)
    axis.legend(loc="lower right")
    caption = "Reduction at 9.1 Hz by gap. A fit: constants of the rig were chosen on these five numbers."
    numbers = {
        "gap_mm": millimetres.tolist(),
        "reduction_percent": [ours[g] for g in gaps],
        "expanded_uncertainty_points": [COVERAGE * spread[g] for g in gaps],
        "paper_percent": published,
    }
    yield Drawn("reductions", figure, caption, [Line("reduction at 9.1 Hz", numbers)])


def draw_residuals(reductions: Reductions) -> Iterator[Drawn]:
    """Draw the measured reductions at 9.1 Hz minus the paper's over the gap, in percentage points."""
    errors, spread = reductions.errors(), reductions.percent_uncertainty
    if not errors:
        return
    gaps = sorted(errors)
    x, y, bars = [gap * 1e3 for gap in gaps], [errors[gap] for gap in gaps], [COVERAGE * spread[gap] for gap in gaps]
    figure, axis = _residuals(x, y, bars, (PAPER_RED, "paper"), "this rig less the paper, ± 2u")
    reach = 1.25 * max(0.5, *(abs(error) for error in errors.values()))
    axis.set(xlabel="gap (mm)", ylabel="difference (points)", title="Residuals", ylim=(-reach, reach))
    axis.set_xticks(x)
    caption = "Our reduction at 9.1 Hz less the paper's, in points. The bars are ours; the paper states none."
    columns = {"gap_mm": x, "difference_points": y, "expanded_uncertainty_points": bars}
    yield Drawn("residuals", figure, caption, [Line("this rig less the paper", columns)])


def draw_errors_without_sphere(curves: Curves, config: RigConfig) -> Iterator[Drawn]:
    """Draw the differences of DT without the sphere from the closed form, in percent: the errors of the measurement."""
    points = curve(curves, NO_SPHERE)
    if not points:
        return
    frequency = np.array([p.frequency_hz for p in points])
    (exact,) = predicted(config, NO_SPHERE, frequency, paper.CURRENT_A)
    errors = 100.0 * (np.array([p.dt for p in points]) / exact.dt - 1.0)
    bars = 100.0 * COVERAGE * np.array([p.u_dt / p.dt for p in points])
    figure, axis = _residuals(frequency, errors, bars, (MUTED, "closed form"), "measured, ± 2u")
    axis.set(xlabel="frequency (Hz)", ylabel="difference (%)", title="Without sphere, against theory")
    caption = "DT without the sphere against the closed form of the configured rig: errors of instruments and analysis."
    columns = {
        "frequency_hz": frequency.tolist(),
        "difference_percent": errors.tolist(),
        "expanded_uncertainty_percent": bars.tolist(),
    }
    yield Drawn("residuals_without_sphere", figure, caption, [Line("no sphere", columns)])


def _residuals(
    x: ArrayLike, errors: ArrayLike, bars: ArrayLike, zero: tuple[str, str], label: str
) -> tuple[Figure, Axes]:
    """Draw differences with error bars about the line zero, and return figure and axes.

    `zero` is the colour and the legend text of the line zero. `label` is the legend text of the differences.
    """
    figure, (axis,) = new_axes(3.0)
    axis.axhline(0.0, color=zero[0], linewidth=1.0, label=zero[1])
    axis.errorbar(x, errors, bars, color=MEASURED, marker="o", linestyle="none", capsize=3.0, label=label)
    legend_below(axis, 2)
    return figure, axis


# --- The paper's figures from our runs: curves over frequency, base amplitude, regimes

FIGURE_8 = "abcde"
REGIMES = {"periodic": PERIODIC, "modulated": MODULATED, "chaotic": CHAOTIC}


def colour(gap_m: float) -> str:
    """Return the colour of a gap [m], or of `NO_SPHERE`, in these figures; `INK` for a gap that is not in the paper."""
    gaps = list(REDUCTION_PERCENT)
    return MUTED if gap_m == NO_SPHERE else SERIES[gaps.index(gap_m)] if gap_m in gaps else INK


def curve(curves: Curves, gap_m: float) -> list[Point]:
    """Return the settled points of one gap at the paper's frequencies, ascending, without unmeasured frequencies."""
    return [point for frequency in FREQUENCIES_HZ if (point := curves.at(gap_m, frequency)) is not None]


def papers_dt(curves: Curves, gap_m: float) -> float | None:
    """Return the DT at 9.1 Hz that follows from our DT without sphere and the paper's reduction for one of its gaps.

    The result is None if DT without sphere was not measured at 9.1 Hz.
    """
    without = curves.at(NO_SPHERE, FREQUENCY_HZ)
    return None if without is None else without.dt * (1.0 - REDUCTION_PERCENT[gap_m] / 100.0)


def case(gap_m: float) -> str:
    """Return the name of a gap [m] in legends, such as `4 mm`, or `no sphere` for `NO_SPHERE`."""
    return case_of(gap_m).removeprefix("gap ")


def curve_numbers(gap_m: float, points: Sequence[Point]) -> Line:
    """Return the numbers of a drawn curve for its CSV file.

    These are frequency, DT, expanded uncertainty of DT, and phase in degrees of all `points`. `gap_m` only names the
    curve.
    """
    return Line(
        case(gap_m),
        {
            "frequency_hz": [p.frequency_hz for p in points],
            "transmissibility": [p.dt for p in points],
            "expanded_uncertainty": [COVERAGE * p.u_dt for p in points],
            "phase_deg": [math.degrees(p.phase_rad) for p in points],
        },
    )


def draw_each_gap(curves: Curves) -> Iterator[Drawn]:
    """Draw the paper's Fig. 8: for each of its gaps DT over the frequency, next to the curve without sphere."""
    without = curve(curves, NO_SPHERE)
    for letter, gap in zip(FIGURE_8, REDUCTION_PERCENT, strict=True):
        points = curve(curves, gap)
        if not points:
            continue
        figure, (axis,) = new_axes(2.9)
        if without:
            _errorbar(axis, without, colour(NO_SPHERE), "--", label="no sphere")
        _errorbar(axis, points, colour(gap), "-", label=f"gap {gap * 1e3:g} mm")
        wanted = papers_dt(curves, gap)
        if wanted is not None:
            label = f"paper, −{REDUCTION_PERCENT[gap]:g} %"
            axis.plot(FREQUENCY_HZ, wanted, "D", color=PAPER_RED, markerfacecolor="none", markersize=6.0, label=label)
        axis.set(xlabel="frequency (Hz)", ylabel="transmissibility", title=_title(gap), ylim=(0.0, None))
        axis.legend(loc="upper left")
        lines = [curve_numbers(at, one) for at, one in ((NO_SPHERE, without), (gap, points)) if one]
        yield Drawn(f"fig8{letter}_gap_{gap * 1e3:g}mm", figure, f"Gap {gap * 1e3:g} mm (Fig. 8{letter}).", lines)


def _title(gap_m: float) -> str:
    return f"{case_of(gap_m)}, {paper.CURRENT_A * 1e3:g} mA, measured ± 2u"


def draw_peaks(curves: Curves) -> Iterator[Drawn]:
    """Draw DT within 0.1 Hz of 9.1 Hz for each case whose peak was measured, with a dotted vertical at the peak.

    A case is a gap of the paper, or no sphere. Nothing is drawn if no peak was measured.
    """
    figure, (axis,) = new_axes(3.4)
    lines: list[Line] = []
    for gap in (NO_SPHERE, *REDUCTION_PERCENT):
        try:
            peak = peak_hz(curves, gap)
        except MissingError:
            continue
        points = [p for f, p in sorted(curves.by_gap[gap].items()) if abs(f - FREQUENCY_HZ) < 0.0999]
        lines.append(curve_numbers(gap, points))
        dash = "--" if gap == NO_SPHERE else "-"
        axis.plot([p.frequency_hz for p in points], [p.dt for p in points], dash, color=colour(gap), label=case(gap))
        axis.axvline(peak, color=colour(gap), linewidth=0.7, linestyle=":")
    if not lines:
        return
    axis.set(xlabel="frequency (Hz)", ylabel="transmissibility", title="Where the curves peak")
    legend_below(axis, 3)
    caption = "Grid of 0.01 Hz. Dotted lines mark the peaks. With the sphere they are slightly lower, as in the paper."
    yield Drawn("peaks", figure, caption, lines)


def damper_effects(curves: Curves, calibration: Calibration) -> dict[float, dict[float, Damper]]:
    """Return the sphere's added mass and loss factor by gap [m] and frequency [Hz].

    A frequency is included only if DT was measured with this gap and without the sphere.
    """
    found: dict[float, dict[float, Damper]] = {}
    for gap in curves.gaps():
        for frequency, point in sorted(curves.by_gap[gap].items()):
            without = curves.at(NO_SPHERE, frequency)
            if without is not None:
                found.setdefault(gap, {})[frequency] = damper_effect(without.rows, point.rows, calibration)
    return found


def draw_damper(curves: Curves, calibration: Calibration) -> Iterator[Drawn]:
    """Draw added mass and loss factor of the sphere over the frequency in one figure, one line per gap, ± 2u.

    Gaps measured at fewer than two frequencies are left out. Nothing is drawn if no gap remains.
    """
    found = {gap: own for gap, own in damper_effects(curves, calibration).items() if len(own) > 1}
    if not found:
        return
    figure, (upper, lower) = new_axes(4.8, (1.0, 1.0))
    lines: list[Line] = []
    for gap, own in found.items():
        frequency = list(own)
        columns: dict[str, list[float]] = {"frequency_hz": frequency}
        for axis, name in ((upper, "added_mass"), (lower, "loss_factor")):
            columns[name] = [100.0 * getattr(one, name) for one in own.values()]
            columns[f"u_{name}"] = [100.0 * getattr(one, f"u_{name}") for one in own.values()]
            bars = [COVERAGE * u for u in columns[f"u_{name}"]]
            axis.errorbar(frequency, columns[name], bars, marker="o", capsize=2.0, color=colour(gap), label=case(gap))
        lines.append(Line(case(gap), columns))
    upper.set(ylabel="added mass (%)", title="What the sphere does to the structure")
    lower.set(ylabel="loss factor (%)", xlabel="frequency (Hz)")
    legend_below(lower, 3, upper)
    caption = (
        "Force of the sphere on the structure, divided by the structure's inertia force: the part in phase with the "
        "displacement (added mass, as a share of m_1), and the part in quadrature (loss factor). Both follow from DT "
        "and phase with and without the sphere."
    )
    yield Drawn("damper", figure, caption, lines)


def draw_amplitudes(curves: Curves) -> Iterator[Drawn]:
    """Draw the amplitudes of superior and inferior base over the frequency, one line per gap.

    The figure shows why DT falls: the damper increases the motion of the inferior base.
    """
    cases = {gap: points for gap in (NO_SPHERE, *REDUCTION_PERCENT) if (points := curve(curves, gap))}
    if not cases:
        return
    figure, (upper, lower) = new_axes(4.8, (1.0, 1.0))
    lines: list[Line] = []
    for gap, points in cases.items():
        frequency = [p.frequency_hz for p in points]
        dash = "--" if gap == NO_SPHERE else "-"
        columns = {"superior_base_mm": [p.laser_m * 1e3 for p in points], "base_um": [p.base_m * 1e6 for p in points]}
        lines.append(Line(case(gap), {"frequency_hz": frequency, **columns}))
        for axis, y, label in zip((upper, lower), columns.values(), (case(gap), None), strict=True):
            axis.plot(frequency, y, dash, marker="o", color=colour(gap), label=label)
    upper.set(ylabel="superior base (mm)", title=f"Amplitudes at {paper.CURRENT_A * 1e3:g} mA")
    lower.set(ylabel="inferior base (µm)", xlabel="frequency (Hz)", yscale="log")
    lower.set_yticks([50, 100, 200, 500], ["50", "100", "200", "500"])
    lower.minorticks_off()
    legend_below(lower, 3, upper)
    caption = (
        "At constant current, the superior base moves nearly as far with the sphere as without it; the motion of the "
        "inferior base changes. At resonance, the structure keeps the inferior base nearly at rest, like a tuned "
        "absorber. Losses in the sphere's impacts weaken this effect: the base moves more, so DT falls."
    )
    yield Drawn("amplitudes", figure, caption, lines)


def draw_regimes(curves: Curves) -> Iterator[Drawn]:
    """Draw the regime (periodic, modulated, chaotic, no impacts) and the impacts per cycle by gap and frequency."""
    cases = {gap: points for gap in REDUCTION_PERCENT if (points := curve(curves, gap))}
    if not cases:
        return
    figure, (axis,) = new_axes(0.55 + 0.36 * (len(cases) + 2))
    for row, gap in enumerate(cases):
        for column, frequency in enumerate(FREQUENCIES_HZ):
            point = curves.at(gap, frequency)
            # otherwise impacts were not counted
            counted = point is not None and not math.isnan(point.impacts_per_cycle)
            shade = GRID if point is None else REGIMES.get(point.regime, GRID)
            if point is not None and counted and not point.impacts:
                shade = QUIET
            axis.fill_between([column - 0.48, column + 0.48], row - 0.46, row + 0.46, color=shade, linewidth=0)
            if point is not None and counted:
                axis.text(column, row, f"{point.impacts_per_cycle:.1f}", ha="center", va="center", fontsize=8.0)
    axis.set_xticks(range(len(FREQUENCIES_HZ)), [f"{frequency:g}" for frequency in FREQUENCIES_HZ])
    axis.set_yticks(range(len(cases)), [f"{gap * 1e3:g}" for gap in cases])
    axis.set(xlabel="frequency (Hz)", ylabel="gap (mm)", xlim=(-0.6, len(FREQUENCIES_HZ) - 0.4))
    axis.grid(visible=False)
    for name, shade in (*REGIMES.items(), ("no impacts", QUIET)):
        axis.fill_between([], [], [], color=shade, label=name)
    legend_below(axis, 4)
    caption = "Regime of the response from cycle to cycle, and number of impacts per cycle, from the accelerometer."
    lines = [
        Line(case(gap), {name: [getattr(p, name) for p in one] for name in ("frequency_hz", "impacts_per_cycle")})
        for gap, one in cases.items()
    ]
    yield Drawn("regimes", figure, caption, lines)


def _errorbar(axis: Axes, points: Sequence[Point], shade: str, line: str, capsize: float = 2.0, **more: Any) -> None:
    frequency, bars = [p.frequency_hz for p in points], [COVERAGE * p.u_dt for p in points]
    dt = [p.dt for p in points]
    axis.errorbar(frequency, dt, bars, color=shade, marker="o", linestyle=line, capsize=capsize, **more)


# --- Time traces and phase planes of single runs, from their last blocks

CYCLES = 3  # drive cycles in a time trace
DRAWN_HZ = 2000.0  # displacements are drawn at this rate; pulses of the accelerometer keep every scan


def draw_time_trace(trace: Trace, gap_m: float, frequency_hz: float) -> Drawn:
    """Draw the motion of superior base (laser) and sphere (truth) over `CYCLES` cycles, and the accelerometer's signal.

    Args:
        trace: columns by name: scans, and true motion of the simulated rig, just after the measurement of a point.
        gap_m: gap [m].
        frequency_hz: drive frequency.
    """
    time = np.asarray(trace["time"], float)
    shown = time <= CYCLES / frequency_hz
    coarse = np.flatnonzero(shown)[:: max(1, round(1.0 / (time[1] - time[0]) / DRAWN_HZ))]
    laser, truth_1, truth_2 = (np.asarray(trace[column], float)[coarse] * 1e3 for column in ("laser", "x_1", "x_2"))
    half = gap_m * 500.0
    figure, (upper, lower) = new_axes(4.0, (1.5, 1.0))
    upper.fill_between(
        1e3 * time[coarse], truth_1 - half, truth_1 + half, color=MUTED, alpha=0.18, linewidth=0,
        label="between the barriers",
    )  # fmt: skip
    upper.plot(1e3 * time[coarse], laser, color=SERIES[0], label="superior base (laser)")
    upper.plot(1e3 * time[coarse], truth_2, color=SERIES[2], linewidth=1.0, label="sphere (truth)")
    upper.set(ylabel="displacement (mm)", title=_case(gap_m, frequency_hz))
    lower.plot(1e3 * time[shown], np.asarray(trace["accelerometer"], float)[shown], color=INK, linewidth=0.7)
    lower.set(xlabel="time (ms)", ylabel="accel. (m/s²)")
    legend_below(lower, 2, upper)
    caption = f"Time traces, gap {gap_m * 1e3:g} mm: {CYCLES} cycles. The spikes are impacts."
    columns = {"time_s": time[coarse].tolist(), "superior_base_mm": laser.tolist(), "sphere_mm": truth_2.tolist()}
    return Drawn(f"trace_gap_{gap_m * 1e3:g}mm", figure, caption, [Line("truth and laser", columns)])


def draw_phase_plane(trace: Trace, gap_m: float, frequency_hz: float) -> Drawn:
    """Draw the sphere's velocity over its position, both relative to the superior base, for the complete trace.

    The arguments are those of `draw_time_trace`.
    """
    place = 1e3 * (np.asarray(trace["x_2"], float) - np.asarray(trace["x_1"], float))
    speed = np.asarray(trace["v_2"], float) - np.asarray(trace["v_1"], float)
    figure, (axis,) = new_axes()
    axis.plot(place[::2], speed[::2], color=SERIES[2], linewidth=0.7)
    for wall in (-gap_m * 500.0, gap_m * 500.0):
        axis.axvline(wall, color=MUTED, linewidth=1.0)
    axis.set(
        xlabel="sphere less superior base (mm)", ylabel="relative velocity (m/s)", title=_case(gap_m, frequency_hz)
    )
    caption = f"Phase plane of the sphere between the barriers, gap {gap_m * 1e3:g} mm (truth)."
    columns = {"place_mm": place[::2].tolist(), "relative_velocity_m_s": speed[::2].tolist()}
    return Drawn(f"phase_gap_{gap_m * 1e3:g}mm", figure, caption, [Line("sphere (truth)", columns)])


def _case(gap_m: float, frequency_hz: float) -> str:
    return f"Gap {gap_m * 1e3:g} mm, {frequency_hz:g} Hz"
