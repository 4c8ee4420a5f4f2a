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
"""Results of the tests of `impact-rig drive` that play samples: key figures, sentences, drawings and HTML page.

Such tests are random vibration, replicated and played histories, shocks and frequency responses.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
import scipy

import impact_rig
from impact_rig.analysis.frf import Frf
from impact_rig.drawing import GRID, INK, MEASURED, MUTED, PREDICTED, SERIES, Drawn, Line, legend_below, new_axes, style
from impact_rig_studies.excitation.history import Played, Replicated
from impact_rig_studies.excitation.random import Reached
from impact_rig_studies.excitation.shock import Shocked
from impact_rig_studies.report import page

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_POINTS = 4000  # largest number of points of a drawn line
COHERENT = 0.9  # lowest coherence with which a line counts as measured
CHANCE = 1.25  # error of a repetition over that of the best trial, above which the difference is not noise
SHOWN_S = 1.0  # duration of the drawn part of a played history, around its largest sample


@attrs.frozen(eq=False)
class ResultSummary:
    """Summary of the latest result of a test of `impact-rig drive`, for the terminal, the JSON file and the page."""

    progress: str  # progress so far, in one line
    figures: Mapping[str, object]  # key figures by name, for the JSON file
    sentences: Sequence[str]  # results as sentences for the user
    draw: Callable[[], list[Drawn]]  # function that makes the drawings
    missing: str = ""  # reason why there is no result, as a sentence; empty if there is one


def tell(found: object, unit: str = "") -> ResultSummary:
    """Summarise a result of a test that plays samples.

    If the result is not usable, for example because a key figure cannot be computed, `missing` of the summary states
    why. This is then also its only sentence.

    Args:
        found: the result, such as a `Reached` or an `Frf`.
        unit: unit of the response, or of the frequency response.
    """
    summary = _TELLERS[type(found)](found, unit)
    lacking = [name for name, value in summary.figures.items() if not _is_known(value)]
    if lacking and not summary.missing:
        names = ", ".join(name.replace("_", " ") for name in lacking)
        why = f"No result: {names} cannot be computed, because the signals are too short or do not change."
        summary = attrs.evolve(summary, progress=f"no result yet: {names}", missing=why)
    return attrs.evolve(
        summary, draw=style()(summary.draw), sentences=[summary.missing] if summary.missing else summary.sentences
    )


def _is_known(value: object) -> bool:
    """Return whether a key figure is finite; for a mapping, whether all its figures are finite.

    Values other than floats and mappings, such as arrays, count as known.
    """
    if isinstance(value, Mapping):
        return all(_is_known(one) for one in value.values())
    return not isinstance(value, float) or math.isfinite(value)


def document(
    title: str, about: Sequence[tuple[str, str]], summary: ResultSummary, early: str, *, drawn: bool = True
) -> str:
    """Return the HTML page with the results of a test of `impact-rig drive`.

    Args:
        title: title of the page.
        about: pairs of label and value for the block below the title.
        summary: the results.
        early: reason why the test ended early; empty otherwise.
        drawn: whether the page contains the drawings.
    """
    written = ("Written", f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')}, impact_rig {impact_rig.__version__}")
    parts = [page.title(title), page.cover([*about, written])]
    parts += [page.paragraph(f"Ended early: {early}")] if early else []
    parts += [page.paragraph(sentence) for sentence in summary.sentences]
    return page.page(title, [*parts, page.figures(summary.draw() if drawn else (), large=True)])


def _panes(axes: Sequence[Axes], *labels: str, x: str) -> None:
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
    axes[-1].set_xlabel(x)
    legend_below(axes[-1], 3, *axes[:-1])


def _learning(errors: Sequence[float], label: str, what: str) -> Drawn:
    """Draw the errors of successive loops or trials; `label` has their unit, `what` is `loop` or `trial`."""
    figure, (axis,) = new_axes(2.4)
    number = np.arange(1, len(errors) + 1)
    axis.plot(number, errors, "o-", color=MEASURED)
    axis.set(xlabel=what, ylabel=label, ylim=(0.0, None), xticks=number)
    return Drawn("learning", figure, f"Error by {what}.", [Line(what, {what: list(number), label: errors})])


# --- random


def _random(found: Reached, unit: str) -> ResultSummary:
    shares = {"distortion": found.share(found.distortion), "noise": found.share(found.noise)}
    figures = {
        "within_1_db": found.within(1.0), "within_3_db": found.within(3.0), "rms_error_db": found.loops,
        "worst_db": float(np.abs(found.error_db).max()), "drive_rms_a": found.drive_rms, "kurtosis": found.kurtosis,
        "clipped_samples": found.clipped, "lines": len(found.frequency_hz), "not_linear_share": shares["distortion"],
        "noise_share": shares["noise"], "coherence_median": float(np.median(found.coherence)),
    }  # fmt: skip
    sentences = [
        (
            f"{100 * found.within(1.0):.1f} % of {len(found.frequency_hz)} lines are within 1 dB of the request, "
            f"{100 * found.within(3.0):.1f} % within 3 dB; the worst is {figures['worst_db']:.1f} dB off."
        ),
        (
            f"Of the mean square, {100 * shares['distortion']:.2g} % is distortion, caused by the drive but "
            f"not proportional to it, and {100 * shares['noise']:.2g} % is noise of the sensor. "
            f"Kurtosis {found.kurtosis:.2f} (3: Gaussian), drive {found.drive_rms:.3g} A rms, {found.clipped} of its "
            "samples clipped."
        ),
    ]
    return ResultSummary(
        f"loop {len(found.loops)}: rms error {found.loops[-1]:.2f} dB, drive {found.drive_rms:.3g} A rms",
        figures,
        sentences,
        lambda: _draw_random(found, unit),
    )


def _draw_random(found: Reached, unit: str) -> list[Drawn]:
    f = found.frequency_hz
    figure, axes = new_axes(5.6, (2.0, 1.0, 1.0))
    axes[0].loglog(f, found.reached, color=MEASURED, label="reached", linewidth=0.8)
    axes[0].loglog(f, found.asked, color=INK, label="asked")
    shown = found.distortion > 1e-3 * found.asked
    axes[0].loglog(f[shown], found.distortion[shown], ".", color=SERIES[2], markersize=2, label="not linear")
    axes[0].set_ylim(1e-3 * found.asked.min(), 10.0 * max(found.asked.max(), found.reached.max()))
    for bound in (-3.0, -1.0, 1.0, 3.0):
        axes[1].axhline(bound, color=MUTED, linewidth=0.6)
    axes[1].plot(f, found.error_db, color=MEASURED, linewidth=0.8)
    axes[1].set_ylim(-6.0, 6.0)
    axes[2].plot(f, found.coherence, color=MEASURED, linewidth=0.8)
    axes[2].set_ylim(0.0, 1.05)
    _panes(axes, f"density (({unit})²/Hz)", "error (dB)", "coherence", x="frequency (Hz)")
    columns = {
        "frequency (Hz)": f, "asked": found.asked, "reached": found.reached, "error (dB)": found.error_db,
        "coherence": found.coherence, "not linear": found.distortion, "noise": found.noise,
    }  # fmt: skip
    one = Drawn(
        "random",
        figure,
        "Requested and reached density, its error, and its coherence with the drive.",
        [Line("random", columns)],
    )
    return [one, _learning(found.loops, "rms error (dB)", "loop")]


# --- histories


def _replicated(found: Replicated, unit: str) -> ResultSummary:
    error = found.relative(found.reached - found.asked)
    bent = found.relative(found.reached - found.linear)
    figures = {
        "error": error, "error_floor": found.floor, "errors": found.errors, "error_repeated": found.repeated,
        "burst_s": found.burst / found.rate_hz, "not_linear_or_noise": bent,
        "drive_peak_a": float(np.abs(found.drive).max()),
        "kurtosis_asked": float(scipy.stats.kurtosis(found.asked, fisher=False)),
        "kurtosis_reached": float(scipy.stats.kurtosis(found.reached, fisher=False)), "clipped_samples": 0,
    }  # fmt: skip
    trials = "1 trial" if len(found.errors) == 1 else f"{len(found.errors)} trials"
    sentences = [
        (
            f"After {trials}, the rms error of the motion is {100 * error:.2f} % of the requested rms. The "
            f"uncertainty of the sensor's noise and gain is {100 * found.floor:.2f} % of it (2u).{_repetition(found)}"
        ),
        (
            f"The response differs by {100 * bent:.2f} % from that of a linear rig with the measured response "
            "function. The difference is distortion, and noise of the sensor."
        ),
    ]
    last = ("repetition", found.repeated) if found.repeated else (f"trial {len(found.errors)}", found.errors[-1])
    return ResultSummary(
        f"{last[0]}: error {100 * last[1]:.2f} %",
        figures,
        sentences,
        lambda: [_history(found, unit), _learning([100 * one for one in found.errors], "error (%)", "trial")],
    )


def _repetition(found: Replicated) -> str:
    """Return sentences about the repetition of the best drive; empty if there was no repetition."""
    if found.repeated is None:
        return ""
    text = f" A repetition of its drive has an error of {100 * found.repeated:.2f} %."
    if found.repeated > CHANCE * min(found.errors):
        text += " Equal drives give different responses, so the smaller error is chance; expect the larger one."
    if found.burst:
        text += (
            f" Each trial begins with {found.burst / found.rate_hz:.0f} s for a burst at the resonance of the superior "
            "base, because equal trials differed without it."
        )
    return text


def _history(found: Replicated, unit: str) -> Drawn:
    asked, reached, linear = found.asked, found.reached, found.linear
    t, part = np.arange(len(asked)) / found.rate_hz, slice(None, None, -(-len(asked) // MOST_POINTS))
    figure, axes = new_axes(4.2, (2.0, 1.0))
    axes[0].plot(t[part], reached[part], color=MEASURED, label="reached")
    axes[0].plot(t[part], asked[part], "--", color=INK, label="asked", linewidth=0.8)
    axes[1].plot(t[part], (reached - asked)[part], color=MEASURED, label="error", linewidth=0.8)
    axes[1].plot(t[part], (reached - linear)[part], color=SERIES[2], label="not linear", linewidth=0.8)
    _panes(axes, f"response ({unit})", f"({unit})", x="time (s)")
    columns = {"time (s)": t[part], "asked": asked[part], "reached": reached[part], "linear": linear[part]}
    caption = "Requested and reached history; below, the remaining error and the nonlinear part of the response."
    return Drawn("history", figure, caption, [Line("history", columns)])


def _shocked(found: Shocked, unit: str) -> ResultSummary:
    summary = _replicated(found.followed, unit)
    figures = {
        **summary.figures, "peak_error": found.peak_error, "velocity_change_error": found.velocity_error,
        "displacement_left_m": found.left_m, "srs_worst_db": found.srs_worst_db,
        "peak_error_floor": found.floors["peak_error"], "velocity_change_error_floor": found.floors["velocity_error"],
        "displacement_left_floor_m": found.floors["left_m"], "srs_floor_db": found.floors["srs_worst_db"],
    }  # fmt: skip
    first = (
        f"Peak {_error(found, 'peak_error', 100, '%')}, "
        f"change of velocity {_error(found, 'velocity_error', 100, '%')}, "
        f"residual displacement {_error(found, 'left_m', 1e6, 'µm')} "
        f"of {1e3 * np.abs(found.followed.asked).max():.2f} mm, "
        f"shock response spectrum {_error(found, 'srs_worst_db', 1, 'dB')}."
    )
    return attrs.evolve(
        summary,
        figures=figures,
        sentences=[first, *summary.sentences],
        draw=lambda: [_draw_shock(found), *summary.draw()],
    )


def _error(found: Shocked, name: str, factor: float, unit: str) -> str:
    """Return one error of a shock as text, together with its noise floor.

    The noise floor is the error that noise and gain error of the sensor can cause. An error within the noise floor is
    described as "as requested". `name` is the attribute of `found` with the error. Both values are multiplied by
    `factor` and shown in `unit`.
    """
    value, floor = factor * getattr(found, name), factor * found.floors[name]
    if abs(value) <= floor:
        return f"as requested, within the noise floor of {floor:.2g} {unit}"
    return f"off by {value:+z.2g} {unit} (noise floor {floor:.2g} {unit})"


def _draw_shock(found: Shocked) -> Drawn:
    f = found.frequency_hz
    t = np.arange(len(found.asked)) / found.followed.rate_hz
    figure, (upper, lower) = new_axes(5.0, (1.0, 1.0), share=False)
    upper.plot(t, found.reached, color=MEASURED, label="reached")
    upper.plot(t, found.asked, "--", color=INK, label="asked", linewidth=0.8)
    upper.set(ylabel="acceleration (m/s²)", xlabel="time (s)")
    lower.loglog(f, found.srs_reached, color=MEASURED, label="reached")
    lower.loglog(f, found.srs_asked, "--", color=INK, label="asked")
    lower.loglog(f, found.srs_ideal, ":", color=PREDICTED, label="half sine alone")
    lower.set(ylabel="shock response (m/s²)", xlabel="natural frequency (Hz)")
    legend_below(lower, 3)
    columns = {"natural frequency (Hz)": f, "asked": found.srs_asked, "reached": found.srs_reached}
    caption = "The pulse, and its shock response spectrum (Q = 10; of the half sine alone without damping)."
    return Drawn("shock", figure, caption, [Line("shock", columns)])


# --- played, frequency response


def _played(found: Played, _unit: str) -> ResultSummary:
    done = len(found.asked) / found.rate_hz
    figures = {
        "seconds": done,
        "whole_s": found.whole / found.rate_hz,
        "current_error": found.error,
        "clipped_samples": found.clipped,
        "peak_asked": float(np.abs(found.asked).max()),
        "kurtosis": {name: found.kurtosis(name) for name in ("current", "base", "laser")},
        "rms": {name: float(found.rows[name].std()) for name in ("current", "base", "laser", "accelerometer")},
    }
    sentences = [
        (
            f"{done:.2f} of {found.whole / found.rate_hz:.2f} s played. The current differs from the requested one by "
            f"{100 * found.error:.2f} % of its rms. {found.clipped} samples clipped. Kurtosis of the current "
            f"{found.kurtosis('current'):.2f}, of base and superior base {found.kurtosis('base'):.2f} and "
            f"{found.kurtosis('laser'):.2f}."
        )
    ]
    return ResultSummary(f"{done:.0f} s played", figures, sentences, lambda: [_draw_played(found)])


def _draw_played(found: Played) -> Drawn:
    middle, half = int(np.argmax(np.abs(found.asked))), round(0.5 * SHOWN_S * found.rate_hz)
    part = slice(max(0, middle - half), middle + half)
    rows, asked = found.rows[part], found.asked[part]
    t = (np.arange(len(asked)) + part.start) / found.rate_hz
    figure, axes = new_axes(5.0, (1.0, 1.0, 1.0))
    axes[0].plot(t, rows["current"], color=MEASURED, label="measured")
    axes[0].plot(t, asked, "--", color=INK, label="asked", linewidth=0.8)
    axes[1].plot(t, 1e3 * rows["base"], color=SERIES[1])
    axes[2].plot(t, 1e3 * rows["laser"], color=SERIES[2])
    _panes(axes, "current (A)", "base (mm)", "superior (mm)", x="time (s)")
    columns = {"time (s)": t, "asked": asked, **{name: rows[name] for name in ("current", "base", "laser")}}
    return Drawn("played", figure, "Around the largest sample.", [Line("played", columns)])


def _frf(found: Frf, unit: str) -> ResultSummary:
    good = found.excited[found.coherence[found.excited] > COHERENT]
    u = found.u_relative[good]
    peak = found.excited[np.argmax(np.abs(found.h1[found.excited]))]
    figures = {
        "frames": found.averages, "lines": len(found.excited), "lines_coherent": len(good),
        "random_error_median": float(np.median(u)) if len(u) else None,
        "coherence_median": float(np.median(found.coherence[found.excited])),
        "peak_hz": float(found.frequency_hz[peak]), "peak": float(abs(found.h1[peak])),
        "peak_u_relative": float(found.u_relative[peak]),
        "table": {
            "frequency_hz": found.frequency_hz[found.excited], "real": found.h1[found.excited].real,
            "imag": found.h1[found.excited].imag, "coherence": found.coherence[found.excited],
            "u_relative": found.u_relative[found.excited],
        },
    }  # fmt: skip
    missing = ""
    if not len(good):
        missing = (
            f"No result: none of {len(found.excited)} excited lines has a coherence above {COHERENT}: noise of the "
            "sensors or distortion by the sphere hides the response. Against noise, drive harder (--rms); against "
            "distortion, measure without the sphere (--gap none)."
        )
    sentences = [
        (
            f"{len(good)} of {len(found.excited)} excited lines have a coherence above {COHERENT}; there u is "
            f"{100 * float(np.median(u)) if len(u) else 0.0:.2g} % in the median. The largest response is "
            f"{abs(found.h1[peak]):.4g} {unit} at {found.frequency_hz[peak]:.4g} Hz."
        ),
        (
            "Without the sphere, noise is the only reason for a coherence below 1. With the sphere, the response is "
            "the best linear approximation at this level, and the main reason is distortion. Distortion "
            "differs from frame to frame, so u includes it like noise."
        ),
    ]
    frames = f"{found.averages:.0f} frames"
    return ResultSummary(frames, figures, sentences, lambda: [_draw_frf(found, unit)], missing)


def _draw_frf(found: Frf, unit: str) -> Drawn:
    lines = found.excited
    f, h, u = found.frequency_hz[lines], np.abs(found.h1[lines]), found.u_relative[lines]
    figure, axes = new_axes(5.2, (2.0, 1.0, 1.0))
    axes[0].fill_between(f, h * np.maximum(1.0 - 2.0 * u, 1e-3), h * (1.0 + 2.0 * u), color=GRID, label="± 2u")
    axes[0].semilogy(f, h, color=MEASURED, label="H1", linewidth=0.8)
    axes[1].plot(f, np.degrees(np.angle(found.h1[lines])), ".", color=MEASURED, markersize=2)
    axes[2].plot(f, found.coherence[lines], color=MEASURED, linewidth=0.8)
    axes[2].set_ylim(0.0, 1.05)
    _panes(axes, f"|H| ({unit})", "phase (°)", "coherence", x="frequency (Hz)")
    columns = {"frequency (Hz)": f, "|H|": h, "u relative": u, "coherence": found.coherence[lines]}
    return Drawn("frf", figure, "Frequency response, its uncertainty, and coherence.", [Line("frf", columns)])


_TELLERS: Mapping[type, Callable[[Any, str], ResultSummary]] = {
    Reached: _random,
    Replicated: _replicated,
    Shocked: _shocked,
    Played: _played,
    Frf: _frf,
}
