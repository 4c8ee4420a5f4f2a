# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The main figure: transmissibility of all cases over the frequency, linear and logarithmic, and its phase."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from impact_rig.campaign import paper
from impact_rig.campaign.axes import NO_SPHERE
from impact_rig.campaign.paper import FREQUENCIES_HZ, FREQUENCY_HZ, REDUCTION_PERCENT
from impact_rig.campaign.results import Curves, Point
from impact_rig.drawing.palette import MEASURED, PAPER_RED, PREDICTED
from impact_rig.drawing.style import Drawn, Line, legend_below, new_axes
from impact_rig.report.content import COVERAGE
from impact_rig.report.curves import case, colour, curve, measured_line, papers_dt
from impact_rig.report.predicted import Stretch, predicted
from impact_rig.rig.config import RigConfig

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NEAR_HZ = (8.85, 9.35)
"""Where the cases differ."""
HEIGHT_INCH = 6.6
FINE = 400
"""Frequencies at which a prediction is drawn."""


def without_sphere(curves: Curves, config: RigConfig) -> Iterator[Drawn]:
    """Draw DT without the sphere: measured, and the closed form of the configured rig."""
    points = curve(curves, NO_SPHERE)
    if not points:
        return
    figure, (axis,) = new_axes(2.9)
    fine = np.linspace(FREQUENCIES_HZ[0], FREQUENCIES_HZ[-1], FINE)
    (exact,) = predicted(config, NO_SPHERE, fine, paper.CURRENT_A)
    axis.plot(fine, exact.dt, color=PREDICTED, linewidth=0.9, label="closed form")
    axis.errorbar(
        [p.frequency_hz for p in points], [p.dt for p in points], [COVERAGE * p.u_dt for p in points],
        color=MEASURED, marker="o", linestyle="none", capsize=2.0, label="measured, ± 2u",
    )  # fmt: skip
    axis.axvline(FREQUENCY_HZ, color=PAPER_RED, linewidth=0.9, linestyle=":", label="paper: 9.1 Hz")
    axis.set(xlabel="frequency (Hz)", ylabel="transmissibility", title="DT without sphere", ylim=(0.0, None))
    axis.legend(loc="upper left")
    caption = "Displacement transmissibility without the sphere (the paper's Fig. 6)."
    lines = [measured_line(case(NO_SPHERE), points), _predicted_line(NO_SPHERE, exact)]
    yield Drawn("fig6_without_sphere", figure, caption, lines)


def by_frequency(curves: Curves, config: RigConfig) -> Iterator[Drawn]:
    """Draw DT of all cases, linear and logarithmic, the phase beneath, predictions as lines: whole, and at resonance.

    Near resonance everything measured is drawn, elsewhere the paper's frequencies are what there is.
    """
    cases = [gap for gap in (NO_SPHERE, *REDUCTION_PERCENT) if curve(curves, gap)]
    if len(cases) < 2:
        return
    explained = (
        "Linear above, logarithmic in the middle, and the phase of the superior base to the inferior one. Points: "
        "measured, ± 2u. Full lines: predicted without simulation; dotted: from point to point, where no prediction "
        "exists. Diamonds: our DT without sphere, less the reduction the paper prints."
    )
    ranges = (
        (
            "fig7_all_gaps",
            (FREQUENCIES_HZ[0], FREQUENCIES_HZ[-1]),
            "All cases over the frequency (the paper's Fig. 7).",
        ),
        ("fig7_near_resonance", NEAR_HZ, "The same near resonance, where the cases differ."),
    )
    for name, (low, high), what in ranges:
        measured = {gap: _within(curves, gap, low, high) for gap in cases}
        theory = {gap: predicted(config, gap, np.linspace(low, high, FINE), paper.CURRENT_A) for gap in cases}
        lines = [measured_line(case(gap), points) for gap, points in measured.items()]
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
        axes[0].set(ylabel="transmissibility", ylim=(0.0, None), title=f"At {paper.CURRENT_A * 1e3:g} mA")
        axes[1].set(ylabel="transmissibility", yscale="log")
        axes[1].yaxis.set_major_formatter("{x:g}")
        axes[1].yaxis.set_minor_formatter(_label_if_first)
        axes[2].set(ylabel="phase (°)", xlabel="frequency (Hz)", ylim=(-190.0, 10.0))
        axes[2].set_yticks([-180, -90, 0])
        legend_below(axes[2], 4)
        yield Drawn(name, figure, f"{what} {explained}", lines)


def _within(curves: Curves, gap: float, low: float, high: float) -> list[Point]:
    """Return everything that was measured of a case between two frequencies, at the paper's current."""
    points = (p for f, p in sorted(curves.by_gap[gap].items()) if low <= f <= high)
    return [p for p in points if p.current_a == paper.CURRENT_A]


def _label_if_first(value: float, _: float) -> str:
    """Return the label of a minor tick: 2 and 5 of a decade only, so that none stands in another."""
    return f"{value:g}" if f"{value:e}"[0] in "25" else ""


def _draw_case(axes: Sequence[Axes], gap: float, points: Sequence[Point], theory: Sequence[Stretch]) -> None:
    """Draw one case into the three axes: points with bars, the theory's lines, or a faint line from point to point."""
    frequency, shade = [p.frequency_hz for p in points], colour(gap)
    phases = [math.degrees(p.phase_rad) for p in points]
    bars = [COVERAGE * math.degrees(float(p.rows["phase_uncertainty"][0])) for p in points]
    for axis in axes[:2]:
        axis.errorbar(
            frequency, [p.dt for p in points], [COVERAGE * p.u_dt for p in points],
            color=shade, marker="o", markersize=3.0, linestyle="none", capsize=1.5,
        )  # fmt: skip
        for part in theory:
            axis.plot(part.frequency_hz, part.dt, color=shade, linewidth=1.0, linestyle="-")
        if not theory:
            axis.plot(frequency, [p.dt for p in points], color=shade, linewidth=0.8, linestyle=":")
    axes[2].errorbar(
        frequency, phases, bars, color=shade, marker="o", markersize=3.0, linestyle="none", capsize=1.5, label=case(gap)
    )
    for part in theory:
        axes[2].plot(part.frequency_hz, np.degrees(part.phase_rad), color=shade, linewidth=1.0, linestyle="-")


def _predicted_line(gap: float, part: Stretch) -> Line:
    columns = {
        "frequency_hz": part.frequency_hz.tolist(),
        "transmissibility": part.dt.tolist(),
        "phase_deg": np.degrees(part.phase_rad).tolist(),
    }
    return Line(f"{case(gap)}, predicted", columns)
