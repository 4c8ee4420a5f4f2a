# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The drawing of a comparison: DT apart in units of u, the traces, the spectrum of what the model does not explain."""

from __future__ import annotations

import math

import numpy as np
from scipy import signal

from impact_rig.analysis.scans import samples_of
from impact_rig.drawing import MEASURED, MUTED, PREDICTED, WIDE_INCH, Drawn, Line, style
from impact_rig.studies.comparison import Comparison

TRACED_CYCLES = 6
HARMONICS = 10.5


@style()
def drawn(found: Comparison, name: str) -> Drawn:
    """Draw a comparison of the run of this name."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  # heavy: only when something is drawn
    from matplotlib.figure import Figure  # noqa: PLC0415  # as above

    figure = Figure(figsize=(WIDE_INCH, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    apart, traces, lines = figure.subplots(3, 1)
    rate, drive = found.excerpt.rate_hz, found.excerpt.drive_hz
    numbers: list[Line] = []
    apart.axhspan(-2.0, 2.0, color=MUTED, alpha=0.15, linewidth=0.0)
    for gap in dict.fromkeys(str(one.gap_m) for one in found.places):
        own = [one for one in found.places if str(one.gap_m) == gap]
        label = "gap unknown" if gap == "nan" else f"gap {1e3 * float(gap):g} mm" if float(gap) else "no sphere"
        frequency = [one.frequency_hz for one in own]
        dt, phase = ([one.off(column) for one in own] for column in ("transmissibility", "phase"))
        (line,) = apart.plot(frequency, dt, "o", label=f"DT, {label}")
        apart.plot(frequency, phase, "o", fillstyle="none", color=line.get_color(), label=f"phase, {label}")
        numbers.append(Line(label, {"frequency_hz": frequency, "dt_off_u": dt, "phase_off_u": phase}))
    apart.set(xlabel="frequency (Hz)", ylabel="measured − model (u)", title=f"{name}: driven by the {found.driven_by}")
    apart.set_yscale("symlog", linthresh=10.0)
    apart.margins(0.15)
    apart.legend(ncols=2)
    cycles = round(TRACED_CYCLES / drive * rate) if drive else len(found.model)
    newest = slice(max(0, len(found.model) - cycles), None)
    time = found.excerpt.rows["time"][newest]
    measured, model = (samples_of(rows, "laser")[newest] for rows in (found.excerpt.rows, found.model))
    residual = found.residual
    traces.plot(time, 1e3 * (measured - measured.mean()), color=MEASURED, label="$x_1$ measured")
    traces.plot(time, 1e3 * (model - model.mean()), "--", color=PREDICTED, label="$x_1$ model")
    traces.plot(time, 1e3 * residual[newest], color=MUTED, linewidth=0.8, label="difference")
    traces.set(xlabel="time (s)", ylabel="motion (mm)")
    traces.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    for y, colour, label in (
        (samples_of(found.excerpt.rows, "laser"), MEASURED, "$x_1$ measured"), (residual, MUTED, "difference"),
    ):  # fmt: skip
        frequency_hz, power = signal.periodogram(y, rate, window="flattop", scaling="spectrum", detrend="constant")
        shown = (frequency_hz > 0.0) & (frequency_hz <= min(HARMONICS * drive or math.inf, rate / 2.0))
        amplitude = 1e3 * np.sqrt(2.0 * power[shown])
        lines.semilogy(frequency_hz[shown], amplitude, color=colour, linewidth=0.8, label=label)
        numbers.append(Line(label, {"frequency_hz": frequency_hz[shown].tolist(), "amplitude_mm": amplitude.tolist()}))
    lines.set(xlabel="frequency (Hz)", ylabel="amplitude (mm)")
    lines.legend()
    return Drawn(
        "comparison", figure, f"{name}: measured and model, {found.excerpt}; the band is ± 2u.", numbers,
    )  # fmt: skip
