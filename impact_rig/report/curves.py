# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's figures from our runs: curves over frequency, reductions, base amplitude, regimes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from impact_rig.campaign import paper
from impact_rig.campaign.axes import NO_SPHERE
from impact_rig.campaign.paper import FREQUENCIES_HZ, FREQUENCY_HZ, REDUCTION_PERCENT
from impact_rig.campaign.results import Curves, Point
from impact_rig.campaign.statements import MissingError, peak_hz
from impact_rig.drawing.palette import (
    CHAOTIC,
    GRID,
    INK,
    MODULATED,
    MUTED,
    PAPER_RED,
    PERIODIC,
    QUIET,
    SERIES,
)
from impact_rig.drawing.style import Drawn, Line, legend_below, new_axes
from impact_rig.report.content import COVERAGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURE_8 = "abcde"
REGIMES = {"periodic": PERIODIC, "modulated": MODULATED, "chaotic": CHAOTIC}


def colour(gap_m: float) -> str:
    """Return the colour of a case, the same in all figures."""
    gaps = list(REDUCTION_PERCENT)
    return MUTED if gap_m == NO_SPHERE else SERIES[gaps.index(gap_m)] if gap_m in gaps else INK


def curve(curves: Curves, gap_m: float) -> list[Point]:
    """Return a case's points at the paper's frequencies."""
    return [point for frequency in FREQUENCIES_HZ if (point := curves.at(gap_m, frequency)) is not None]


def papers_dt(curves: Curves, gap_m: float) -> float | None:
    """Return the DT at 9.1 Hz that the paper's reduction means for our curve without sphere."""
    without = curves.at(NO_SPHERE, FREQUENCY_HZ)
    return None if without is None else without.dt * (1.0 - REDUCTION_PERCENT[gap_m] / 100.0)


def case(gap_m: float) -> str:
    """Return the name of a case in legends."""
    return "no sphere" if gap_m == NO_SPHERE else f"{gap_m * 1e3:g} mm"


def measured_line(label: str, points: Sequence[Point]) -> Line:
    """Return what was measured of a case, as its curve is drawn."""
    return Line(
        label,
        {
            "frequency_hz": [p.frequency_hz for p in points],
            "transmissibility": [p.dt for p in points],
            "expanded_uncertainty": [COVERAGE * p.u_dt for p in points],
            "phase_deg": [math.degrees(p.phase_rad) for p in points],
        },
    )


def figure_8(curves: Curves) -> Iterator[Drawn]:
    """Draw each gap beside the curve without sphere."""
    for letter, gap in zip(FIGURE_8, REDUCTION_PERCENT, strict=True):
        points = curve(curves, gap)
        if not points:
            continue
        figure, (axis,) = new_axes(2.9)
        if curve(curves, NO_SPHERE):
            _errorbar(axis, curve(curves, NO_SPHERE), colour(NO_SPHERE), "no sphere", dashed=True)
        _errorbar(axis, points, colour(gap), f"gap {gap * 1e3:g} mm")
        wanted = papers_dt(curves, gap)
        if wanted is not None:
            label = f"paper, −{REDUCTION_PERCENT[gap]:g} %"
            axis.plot(FREQUENCY_HZ, wanted, "D", color=PAPER_RED, markerfacecolor="none", markersize=6.0, label=label)
        _finish(axis, f"Gap {gap * 1e3:g} mm")
        lines = [measured_line(case(one), curve(curves, one)) for one in (NO_SPHERE, gap) if curve(curves, one)]
        yield Drawn(f"fig8{letter}_gap_{gap * 1e3:g}mm", figure, f"Gap {gap * 1e3:g} mm (Fig. 8{letter}).", lines)


def peaks(curves: Curves) -> Iterator[Drawn]:
    """Draw the curves around their peaks, on the fine grid, with the peaks marked."""
    figure, (axis,) = new_axes(3.4)
    lines: list[Line] = []
    for gap in (NO_SPHERE, *REDUCTION_PERCENT):
        try:
            peak = peak_hz(curves, gap)
        except MissingError:
            continue
        points = [p for f, p in sorted(curves.by_gap[gap].items()) if abs(f - FREQUENCY_HZ) < 0.0999]
        lines.append(measured_line(case(gap), points))
        label = case(gap)
        style = "--" if gap == NO_SPHERE else "-"
        axis.plot([p.frequency_hz for p in points], [p.dt for p in points], style, color=colour(gap), label=label)
        axis.axvline(peak, color=colour(gap), linewidth=0.7, linestyle=":")
    if not lines:
        return
    axis.set(xlabel="frequency (Hz)", ylabel="transmissibility", title="Where the curves peak")
    legend_below(axis, 3)
    caption = "Grid of 0.01 Hz. Dotted: where each curve peaks; with the sphere a little lower, as the paper saw."
    yield Drawn("peaks", figure, caption, lines)


def amplitudes(curves: Curves) -> Iterator[Drawn]:
    """Draw the amplitudes of both bases over frequency: the damper works by raising the inferior one."""
    cases = [gap for gap in (NO_SPHERE, *REDUCTION_PERCENT) if curve(curves, gap)]
    if not cases:
        return
    figure, (upper, lower) = new_axes(4.8, (1.0, 1.0))
    lines: list[Line] = []
    for gap in cases:
        points = curve(curves, gap)
        frequency = [p.frequency_hz for p in points]
        style = "--" if gap == NO_SPHERE else "-"
        label = case(gap)
        columns = {"superior_base_mm": [p.laser_m * 1e3 for p in points], "base_um": [p.base_m * 1e6 for p in points]}
        lines.append(Line(case(gap), {"frequency_hz": frequency, **columns}))
        upper.plot(frequency, [p.laser_m * 1e3 for p in points], style, marker="o", color=colour(gap), label=label)
        lower.plot(frequency, [p.base_m * 1e6 for p in points], style, marker="o", color=colour(gap))
    upper.set(ylabel="superior base (mm)", title=f"Amplitudes at {paper.CURRENT_A * 1e3:g} mA")
    lower.set(ylabel="inferior base (µm)", xlabel="frequency (Hz)", yscale="log")
    lower.set_yticks([50, 100, 200, 500], ["50", "100", "200", "500"])
    lower.minorticks_off()
    legend_below(lower, 3, upper)
    caption = (
        "At constant current the superior base moves nearly as far with the sphere as without; what changes is the "
        "base beneath it. At resonance the structure holds the base still, like a tuned absorber; losses in the "
        "sphere's impacts weaken that hold, the base moves more, and so DT falls."
    )
    yield Drawn("amplitudes", figure, caption, lines)


def regime_map(curves: Curves) -> Iterator[Drawn]:
    """Draw, for each gap and frequency, what the response does and how often the sphere strikes."""
    cases = [gap for gap in REDUCTION_PERCENT if curve(curves, gap)]
    if not cases:
        return
    figure, (axis,) = new_axes(0.55 + 0.36 * (len(cases) + 2))
    for row, gap in enumerate(cases):
        for column, frequency in enumerate(FREQUENCIES_HZ):
            point = curves.at(gap, frequency)
            shade = GRID if point is None else REGIMES.get(point.regime, GRID) if point.impacts else QUIET
            axis.fill_between([column - 0.48, column + 0.48], row - 0.46, row + 0.46, color=shade, linewidth=0)
            if point is not None:
                axis.text(column, row, f"{point.impacts_per_cycle:.1f}", ha="center", va="center", fontsize=8.0)
    axis.set_xticks(range(len(FREQUENCIES_HZ)), [f"{frequency:g}" for frequency in FREQUENCIES_HZ])
    axis.set_yticks(range(len(cases)), [f"{gap * 1e3:g}" for gap in cases])
    axis.set(xlabel="frequency (Hz)", ylabel="gap (mm)", xlim=(-0.6, len(FREQUENCIES_HZ) - 0.4))
    axis.grid(visible=False)
    for name, shade in (*REGIMES.items(), ("no impacts", QUIET)):
        axis.fill_between([], [], [], color=shade, label=name)
    legend_below(axis, 4)
    caption = "Regime map: what the response does from cycle to cycle, and impacts per cycle, from the accelerometer."
    lines = [
        Line(
            case(gap),
            {"frequency_hz": [p.frequency_hz for p in one], "impacts_per_cycle": [p.impacts_per_cycle for p in one]},
        )
        for gap in cases
        if (one := curve(curves, gap))
    ]
    yield Drawn("regimes", figure, caption, lines)


def _errorbar(
    axis: Axes, points: Sequence[Point], shade: str, label: str, *, line: bool = True, dashed: bool = False
) -> None:
    axis.errorbar(
        [p.frequency_hz for p in points], [p.dt for p in points], [COVERAGE * p.u_dt for p in points],
        color=shade, marker="o", linestyle="--" if dashed else "-" if line else "none", capsize=2.0, label=label,
    )  # fmt: skip


def _finish(axis: Axes, title: str, *, legend: bool = True) -> None:
    axis.set(xlabel="frequency (Hz)", ylabel="transmissibility", title=title, ylim=(0.0, None))
    if legend:
        axis.legend(loc="upper left")
