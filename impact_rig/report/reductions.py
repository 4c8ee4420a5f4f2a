# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of a comparison with the paper; matplotlib is imported only here and only when drawn."""

from __future__ import annotations

from pathlib import Path

from impact_rig.campaign.paper import REDUCTION_PERCENT, Reductions
from impact_rig.drawing.palette import INK, MEASURED, MUTED, PAPER_RED
from impact_rig.drawing.style import styled
from impact_rig.system import files


@styled
def draw_reductions(reductions: Reductions, path: Path) -> Path:
    """Draw transmissibility and its reduction by gap beside the paper's five numbers; return `path`."""
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
        [i + 0.2 for i in places],
        [ours[g] for g in gaps],
        0.38,
        yerr=[2.0 * spread[g] for g in gaps],
        color=MEASURED,
        ecolor=INK,
        capsize=3,
        label="this run (± 2u)",
    )
    for i, gap in enumerate(gaps):
        right.text(
            i - 0.2,
            REDUCTION_PERCENT.get(gap, 0.0),
            f"{REDUCTION_PERCENT.get(gap, 0.0):.1f}",
            ha="center",
            va="bottom",
            fontsize=8,
        )
        right.text(i + 0.2, ours[gap] + 2.0 * spread[gap], f"{ours[gap]:.1f}", ha="center", va="bottom", fontsize=8)
    right.set_xticks(list(places), names)
    right.set(xlabel="gap (mm)", ylabel="reduction of DT (%)", title="Reduction by the sphere")
    right.legend(frameon=False, loc="upper left")
    right.margins(y=0.2)
    for axes in (left, right):
        axes.grid(visible=False, axis="x")
    with files.written_whole(path) as file:
        figure.savefig(file, format="png", dpi=140)
    return path
