# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Time traces and phase planes of single runs, from their last blocks."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from impact_rig.drawing.palette import INK, MUTED, SERIES
from impact_rig.drawing.style import Drawn, Line, legend_below, new_axes

CYCLES = 3
"""Drive cycles in a time trace."""
DRAWN_HZ = 2000.0
"""Displacements are drawn at this rate; pulses of the accelerometer keep every scan."""


Trace = Mapping[str, NDArray[np.generic]]


def time_trace(trace: Trace, gap_m: float, frequency_hz: float) -> Drawn:
    """Draw the motion over time.

    Args:
        trace: columns of `campaign.execution.columns`.
        gap_m: of the run.
        frequency_hz: of the drive.
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


def phase_plane(trace: Trace, gap_m: float, frequency_hz: float) -> Drawn:
    """Draw the sphere's motion between the barriers; arguments as in `time_trace`."""
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
