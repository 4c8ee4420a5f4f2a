# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Our reductions beside the paper's, and what is left: by gap, and without the sphere against theory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from impact_rig.campaign import paper
from impact_rig.campaign.axes import NO_SPHERE
from impact_rig.campaign.paper import REDUCTION_PERCENT, Reductions
from impact_rig.campaign.results import Curves
from impact_rig.drawing.palette import MEASURED, MUTED, PAPER_RED
from impact_rig.drawing.style import Drawn, Line, legend_below, new_axes
from impact_rig.report.content import COVERAGE
from impact_rig.report.curves import curve
from impact_rig.report.predicted import predicted
from impact_rig.rig.config import RigConfig


def reductions_by_gap(reductions: Reductions) -> Iterator[Drawn]:
    """Draw our reductions beside the paper's."""
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


def differences(reductions: Reductions) -> Iterator[Drawn]:
    """Draw by how much our reductions differ from the paper's."""
    errors, spread = reductions.errors(), reductions.percent_uncertainty
    if not errors:
        return
    figure, (axis,) = new_axes(3.0)
    gaps = sorted(errors)
    millimetres = [gap * 1e3 for gap in gaps]
    bars = [COVERAGE * spread[gap] for gap in gaps]
    axis.axhline(0.0, color=PAPER_RED, linewidth=1.0, label="paper")
    axis.errorbar(
        millimetres, [errors[gap] for gap in gaps], bars,
        color=MEASURED, marker="o", linestyle="none", capsize=3.0, label="this rig less the paper, ± 2u",
    )  # fmt: skip
    reach = 1.25 * max(0.5, *(abs(error) for error in errors.values()))
    axis.set(xlabel="gap (mm)", ylabel="difference (points)", title="Residuals", ylim=(-reach, reach))
    axis.set_xticks(millimetres)
    legend_below(axis, 2)
    caption = "Our reduction at 9.1 Hz less the paper's, in points. The bars are ours; the paper states none."
    columns = {
        "gap_mm": millimetres, "difference_points": [errors[g] for g in gaps], "expanded_uncertainty_points": bars,
    }  # fmt: skip
    yield Drawn("residuals", figure, caption, [Line("this rig less the paper", columns)])


def without_sphere(curves: Curves, config: RigConfig) -> Iterator[Drawn]:
    """Draw by how much DT without the sphere differs from the closed form: what the instruments add."""
    points = curve(curves, NO_SPHERE)
    if not points:
        return
    frequency = np.array([p.frequency_hz for p in points])
    (exact,) = predicted(config, NO_SPHERE, frequency, paper.CURRENT_A)
    errors = 100.0 * (np.array([p.dt for p in points]) / exact.dt - 1.0)
    bars = 100.0 * COVERAGE * np.array([p.u_dt / p.dt for p in points])
    figure, (axis,) = new_axes(3.0)
    axis.axhline(0.0, color=MUTED, linewidth=1.0, label="closed form")
    axis.errorbar(
        frequency, errors, bars, color=MEASURED, marker="o", linestyle="none", capsize=3.0, label="measured, ± 2u"
    )
    axis.set(xlabel="frequency (Hz)", ylabel="difference (%)", title="Without sphere, against theory")
    legend_below(axis, 2)
    caption = "DT without the sphere against the closed form of the configured rig: errors of instruments and analysis."
    columns = {
        "frequency_hz": frequency.tolist(), "difference_percent": errors.tolist(),
        "expanded_uncertainty_percent": bars.tolist(),
    }  # fmt: skip
    yield Drawn("residuals_without_sphere", figure, caption, [Line("no sphere", columns)])
