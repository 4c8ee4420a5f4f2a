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
"""Figures of the measurements of a run, with one function for each figure.

matplotlib is imported only when a figure is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Real
from impact_rig.analysis.frf import Frf
from impact_rig.analysis.sine import SineFit
from impact_rig.analysis.uncertainty_budget import COVERAGE
from impact_rig.drawing import MUTED, PAPER_RED, WIDE_INCH, new_axes, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHT_INCH = 4.5
MARK_ABOVE = 1.04  # height of the impact marks over an axis; 1 is its upper edge, so they hide no pulse
SMOOTHED_SAMPLES = 11


@style()
def transmissibility_curves(curves: Mapping[str, NDArray[np.void]]) -> Figure:
    """Draw the transmissibility DT and its phase over frequency, with error bars of ±2u.

    `curves` maps the label of each curve to its rows of `transmissibility/table`. Rows without numbers are left out.
    """
    from matplotlib.ticker import LogFormatter  # noqa: PLC0415  # heavy: imported only for drawing

    figure, (upper, lower) = _axes(2)
    for label, rows in curves.items():
        sound = rows[np.isfinite(rows["transmissibility"])]
        sound = sound[np.argsort(sound["frequency"], kind="stable")]
        frequency = sound["frequency"]
        for axis, name, factor in ((upper, "transmissibility", 1.0), (lower, "phase", math.degrees(1.0))):
            bars = COVERAGE * factor * sound[f"{name}_uncertainty"]
            shown = ", ".join(filter(None, [label, amplitudes(sound["current_amplitude"], "A"), "± 2u"]))
            axis.errorbar(frequency, factor * sound[name], bars, marker="o", markersize=3.0, capsize=2.0, label=shown)
    upper.set_yscale("log")
    upper.yaxis.set_major_formatter("{x:g}")
    upper.yaxis.set_minor_formatter(LogFormatter())  # labels on an axis of less than a decade
    upper.set_ylabel("transmissibility $|X_1|/|X_b|$")
    lower.set_ylabel("phase of $x_1$ to $x_b$ (°)")
    lower.set_xlabel("frequency (Hz)")
    if curves:
        upper.legend()
    return figure


def amplitudes(values: NDArray[np.float64], unit: str) -> str:
    """Return the range of measured amplitudes as text for a legend, such as `0.5 to 0.7 A`.

    Only finite positive values count. If there are none, the text is empty.
    """
    known = values[np.isfinite(values) & (values > 0.0)]
    if not len(known):
        return ""
    low, high = (f"{one:.3g}" for one in (known.min(), known.max()))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


TRACES = (("base", "b"), ("laser", "1"), ("accelerometer", "1"))
"""Channels that `time_traces` draws if the scans have them, with the index of their symbol: b base, 1 structure."""
MOTIONS = {"m": (1e3, "x", "mm"), "m/s": (1e3, "v", "mm/s"), "m/s^2": (1.0, "a", "m/s²"), "A": (1.0, "i", "A")}
"""Factor, symbol and unit with which a quantity is drawn, by its SI unit."""
SI = {"accelerometer": "m/s^2", "laser": "m", "base": "m", "current": "A"}


def symbol(index: str, unit: str) -> str:
    """Return the symbol of a motion as TeX, such as `$x_1$`.

    The SI unit determines the letter: x, v or a. `index` is 1 for the structure and b for the base.
    """
    return f"${MOTIONS[unit][1]}_{index}$"


@style()
def time_traces(
    rows: NDArray[np.void], impact_times: Real | None = None, remark: str = "", units: Mapping[str, str] = SI
) -> Figure:
    """Draw base motion, structure motion and acceleration over time, and mark impacts above the axes.

    Channels that the scans do not have are left out. If the scans have none of these three channels, the current is
    drawn.

    Args:
        rows: scans.
        impact_times: instants of the impacts on the time axis of the scans [s], shape (k,).
        remark: text above the lowest axes.
        units: SI unit of the values of each channel in `rows`, by name. The unit decides whether a channel is drawn as
            a displacement (in mm), a velocity (mm/s), an acceleration (m/s²) or a current (A).
    """
    shown = [one for one in TRACES if one[0] in (rows.dtype.names or ())] or [("current", "")]
    figure, axes = _axes(len(shown))
    for axis, (name, index) in zip(axes, shown, strict=True):
        factor, _, unit = MOTIONS[units[name]]
        axis.plot(rows["time"], factor * rows[name], linewidth=0.8)
        axis.set_ylabel(f"{symbol(index, units[name]) if index else name} ({unit})")
        if impact_times is not None and len(impact_times):  # marks of no impacts would take up the whole axis
            above = axis.get_xaxis_transform()
            axis.plot(
                impact_times, np.full(len(impact_times), MARK_ABOVE), "v",
                color=PAPER_RED, markersize=3.5, transform=above, clip_on=False, label="impact found",
            )  # fmt: skip
    if impact_times is not None and len(impact_times):
        axes[0].legend(
            handles=[axes[0].lines[1]],
            loc="lower right",
            bbox_to_anchor=(1.0, 1.06),
            borderaxespad=0.0,
            handlelength=1.0,
        )
    if remark:
        axes[-1].set_title(remark, loc="left", fontsize=7.5, color=MUTED, pad=9.0)
    axes[-1].set_xlabel("time (s)")
    return figure


@style()
def phase_plane(displacement: Real, rate_hz: float, smooth_s: float = 0.0, name: str = "$x_1$") -> Figure:
    """Draw the velocity over the displacement; the velocity is the slope of a cubic fitted around each sample.

    Args:
        displacement: samples of the displacement [m], shape (n,).
        rate_hz: samples per second.
        smooth_s: time that each fit spans [s], but at least 11 samples and at most all. A longer time removes more
            noise, but also faster motion.
        name: symbol of the displacement.
    """
    samples = max(SMOOTHED_SAMPLES, 2 * round(smooth_s * rate_hz / 2.0) + 1)
    samples = min(samples, (len(displacement) - 1) // 2 * 2 + 1)
    velocity = scipy.signal.savgol_filter(displacement, samples, 3, deriv=1, delta=1.0 / rate_hz)
    figure, (axis,) = _axes(1)
    axis.plot(1e3 * displacement, velocity, linewidth=0.6)
    axis.set_xlabel(f"{name} (mm)")
    axis.set_ylabel("velocity (m/s)")
    return figure


@style()
def spectrum(y: Real, rate_hz: float, unit: str, drive_hz: float | None = None, upto_hz: float | None = None) -> Figure:
    """Draw the amplitude spectrum of the samples `y`, with a flat-top window.

    A sine of amplitude A gives a line of height A. If `drive_hz` is a positive drive frequency, it and its harmonics up
    to the tenth are marked. The frequency axis ends at `upto_hz`, or at half the sample rate if `upto_hz` is 0 or None.
    `unit` is the unit of the samples.
    """
    frequency, power = scipy.signal.periodogram(y, rate_hz, window="flattop", scaling="spectrum", detrend="constant")
    end = upto_hz or rate_hz / 2.0
    shown = frequency <= end  # only these determine the scale of the other axis
    figure, (axis,) = _axes(1)
    axis.semilogy(frequency[shown], np.sqrt(2.0 * power[shown]), linewidth=0.8)
    if drive_hz is not None and drive_hz > 0.0:
        for harmonic in range(1, min(10, math.floor(end / drive_hz)) + 1):
            axis.axvline(harmonic * drive_hz, color=MUTED, linewidth=0.5, linestyle=":")
    axis.set_xlim(0.0, end)
    axis.set_xlabel("frequency (Hz)")
    axis.set_ylabel(f"amplitude ({unit})")
    return figure


@style()
def frequency_response(found: Frf, from_hz: float, upto_hz: float) -> Figure:
    """Draw |H1|, |H2|, |Hv|, the phase of H1 and the coherence of a frequency response from `from_hz` to `upto_hz`."""
    shown = (found.frequency_hz >= from_hz) & (found.frequency_hz <= upto_hz)
    frequency = found.frequency_hz[shown]
    figure, (upper, middle, lower) = _axes(3)
    for estimate, label, line in ((found.h1, "$H_1$", "-"), (found.h2, "$H_2$", "--"), (found.hv, "$H_v$", ":")):
        upper.semilogy(frequency, np.abs(estimate[shown]), line, linewidth=0.9, label=label)
    upper.set_ylabel("$|X_1|/|X_b|$")
    upper.legend()
    middle.plot(frequency, np.degrees(np.angle(found.h1[shown])), linewidth=0.9)
    middle.set_ylabel("phase (°)")
    lower.plot(frequency, found.coherence[shown], linewidth=0.9)
    lower.set_ylabel("coherence")
    lower.set_ylim(0.0, 1.05)
    lower.set_xlabel("frequency (Hz)")
    return figure


@style()
def sine_fits(rows: NDArray[np.void], fits: Mapping[str, SineFit], units: Mapping[str, str], rate_hz: float) -> Figure:
    """Draw the first samples of every fitted channel with the fitted sine, and state the rms of the residual.

    `rows` are the scans to draw, starting with the first fitted scan. The keys of `fits` and `units` are channel names.
    """
    figure, axes = _axes(len(fits))
    for axis, (name, fit) in zip(axes, fits.items(), strict=True):
        axis.plot(rows["time"], rows[name], linewidth=0.8, label="samples")
        axis.plot(rows["time"], fit.values(np.arange(len(rows)) / rate_hz), "--", linewidth=0.8, label="sine")
        axis.set_ylabel(f"{name} ({units[name]})", fontsize="small")
        axis.set_title(f"residual: {fit.residual_rms:.2g} {units[name]} rms", fontsize="small", loc="right")
    axes[0].legend(loc="upper left", fontsize="small")
    axes[-1].set_xlabel("time (s)")
    return figure


@style()
def restitution_by_drop(each: Real, mean: float, u_mean: float) -> Figure:
    """Draw the coefficient of restitution of every drop of a drop test, and their mean with a band of ±2u.

    `each` is √(rebound height / drop height) of every drop, shape (n,). `u_mean` is the standard uncertainty u of
    `mean`.
    """
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415  # heavy: imported only for drawing

    figure, (axis,) = _axes(1)
    axis.plot(np.arange(1, len(each) + 1), each, "o", markersize=4.0)
    axis.axhline(mean, linewidth=0.8)
    axis.axhspan(mean - COVERAGE * u_mean, mean + COVERAGE * u_mean, alpha=0.2)
    axis.set_xlabel("drop")
    axis.set_ylabel("coefficient of restitution")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def _axes(count: int) -> tuple[Figure, list[Axes]]:
    """Return a wide figure and its `count` axes, from top to bottom, which share the horizontal scale."""
    return new_axes(HEIGHT_INCH, (1.0,) * count, WIDE_INCH)
