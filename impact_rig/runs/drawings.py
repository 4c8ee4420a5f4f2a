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
"""Figures of one recorded run: DT over frequency, and traces, phase plane and spectrum of its last measurement."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis import drawings
from impact_rig.analysis.scans import samples_of
from impact_rig.analysis.tracker import Findings
from impact_rig.drawing import plain_texts, rendered, style
from impact_rig.errors import RecordingError
from impact_rig.names import FIGURE_FORMATS
from impact_rig.recording import Run
from impact_rig.runs import reanalysis
from impact_rig.runs.excerpts import Excerpt, calibration_rows, last_excerpt
from impact_rig.system import files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = ("time_traces", "phase_plane", "spectrum", "curves")
TRACED_CYCLES = 8
SMOOTHED_CYCLE = 40.0  # the velocity of the phase plane is smoothed over a cycle divided by this number
SHOWN = (("laser", "1"), ("base", "b"), ("accelerometer", "1"), ("current", ""))
"""Channels, each with the index of its symbol; phase plane and spectrum show the first of them that a run has."""
HARMONICS = 10.5  # the spectrum ends at this multiple of the drive frequency
UNDRIVEN_HZ = 100.0  # end of the spectrum without a drive frequency


def prepare(directory: Path, formats: Sequence[str], names: Sequence[str] = NAMES) -> None:
    """Create the directory of the figures, and check before a long analysis that they can be written there.

    Raises:
        RecordingError: the directory cannot be created or written to, or contains one of the figures already.
    """
    with files.translate_errors(f"cannot write figures to {directory}"):
        files.make_folder(directory)
        with tempfile.TemporaryFile(dir=directory):
            pass
    wanted = [directory / f"{name}.{kind}" for name in names for kind in formats]
    there = [path for path in wanted if path.exists()]
    if there:
        raise RecordingError(f"the figure {there[0]} exists already and is not overwritten; choose another directory")


def draw(
    run: Run, found: Sequence[Findings], directory: Path, formats: Sequence[str] = FIGURE_FORMATS
) -> tuple[Excerpt, list[Path]]:
    """Draw the figures of a run to files in an existing directory; return the excerpt shown and the paths of the files.

    `found` are the findings that `reanalysis.analyze` yields. Spectrum and phase plane show the `last_excerpt` of the
    run, and the time traces its last `TRACED_CYCLES` drive cycles. The phase plane is drawn only for a displacement,
    and the figure `curves` only if a gap has settled rows at several frequencies.

    Raises:
        RecordingError: the run has no calibration or too few scans, or a file exists or cannot be written.
    """
    excerpt = last_excerpt(run, found)
    traced = excerpt.newest(TRACED_CYCLES)
    remark = aliasing(calibration_rows(run))
    units = channel_units(run)
    channel, factor, unit, name = main_motion(excerpt.rows, units)
    samples = samples_of(excerpt.rows, channel)
    upto_hz = min(HARMONICS * excerpt.drive_hz or UNDRIVEN_HZ, excerpt.rate_hz / 2.0)
    spectrum = drawings.spectrum(factor * samples, excerpt.rate_hz, unit, excerpt.drive_hz, upto_hz)
    drawn = {
        "time_traces": titled(drawings.time_traces(traced.rows, traced.impact_times, remark, units), run, str(traced)),
        "spectrum": titled(spectrum, run, f"spectrum of {name}, {excerpt}"),
    }
    if unit == "mm":  # a displacement: its derivative is the velocity
        smooth_s = 1.0 / (SMOOTHED_CYCLE * excerpt.drive_hz or math.inf)
        plane = drawings.phase_plane(samples, excerpt.rate_hz, smooth_s, name)
        drawn["phase_plane"] = titled(plane, run, f"phase plane, {excerpt}")
    curves = measured_curves(reanalysis.rows(reanalysis.measurements(iter(found))))
    if curves:
        drawn["curves"] = titled(drawings.transmissibility_curves(curves), run, "settled measurements, ±2u")
    return excerpt, [path for stem, figure in drawn.items() for path in save(figure, directory / stem, formats)]


def channel_units(run: Run) -> dict[str, str]:
    """Return the SI unit of each channel of a run, by name, as its newest calibration states it.

    Raises:
        RecordingError: the run has no calibration.
    """
    return {row["name"].decode(): row["unit"].decode() for row in calibration_rows(run)}


def main_motion(rows: NDArray[np.void], units: Mapping[str, str]) -> tuple[str, float, str, str]:
    """Return the channel that phase plane and spectrum show: the first one of `SHOWN` that is a column of `rows`.

    Args:
        rows: scans with at least one of these channels.
        units: SI unit of each channel, by name.

    Returns:
        Name of the channel, factor from its SI unit to the drawn unit, drawn unit, and symbol for the axis.
    """
    channel, index = next(one for one in SHOWN if one[0] in (rows.dtype.names or ()))
    factor, _, unit = drawings.MOTIONS[units[channel]]
    return channel, factor, unit, drawings.symbol(index, units[channel]) if index else f"the {channel}"


def measured_curves(rows: NDArray[np.void]) -> dict[str, NDArray[np.void]]:
    """Return the settled rows of `transmissibility/table` by label, one curve per gap and direction of the sweep.

    A gap that was measured at only one frequency is left out. The rows of a curve keep their order.
    """
    rows = rows[rows["settled"] == 1.0]
    curves: dict[str, NDArray[np.void]] = {}
    for gap in sorted(set(np.nan_to_num(rows["gap"], nan=math.inf))):
        chosen = np.isnan(rows["gap"]) if math.isinf(gap) else rows["gap"] == gap
        steps = np.diff(rows["frequency"][chosen])
        if not np.any(steps):
            continue
        moves = np.flatnonzero(steps)
        # a point belongs to the frequency step that led to it; the first points belong to the step that follows
        upwards = steps[moves[np.maximum(np.searchsorted(moves, np.arange(len(steps) + 1)) - 1, 0)]] > 0
        label = "gap unknown" if math.isinf(gap) else f"gap {gap * 1e3:g} mm" if gap else "no sphere"
        for way, there in (("up", upwards), ("down", ~upwards)):
            if np.all(there):
                curves[label] = rows[chosen]
            elif np.any(there):
                curves[f"{label}, {way}"] = rows[chosen][there]
    return curves


def aliasing(info: NDArray[np.void]) -> str:
    """Return a remark for drawings if the scan rate is too low for the pulses of the accelerometer; otherwise empty.

    It is too low if the bandwidth of the accelerometer exceeds half the scan rate. `info` are the rows of `daq/info`.
    """
    found = info[info["name"] == b"accelerometer"]
    if not len(found):
        return ""
    channel = found[0]
    rate_hz, band_hz = float(channel["rate"]), float(channel["bandwidth"])
    if not band_hz > rate_hz / 2.0:
        return ""
    return (
        f"at {rate_hz / 1e3:g} kS/s, a scan every {1e6 / rate_hz:g} µs, pulses {band_hz / 1e3:g} kHz wide are "
        "aliased: their times are right, their heights are random"
    )


def titled(figure: Figure, run: Run, what: str = "") -> Figure:
    """Set the title of a figure to the name of the run, followed by `what` if given; return the figure."""
    name = run.path.name.replace("$", r"\$")  # next to the mathematical symbols of `what`
    figure.suptitle(f"{name}: {what}" if what else name, fontsize="medium")
    return figure


def save(figure: Figure, stem: Path, formats: Sequence[str]) -> list[Path]:
    """Write a figure to `stem` plus the suffix of each format, and return the paths.

    Raises:
        RecordingError: a file exists already, or cannot be written; the formats before it have been written.
    """
    plain_texts(figure)
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in formats]
    for path, kind in zip(paths, formats, strict=True):
        with files.translate_errors(f"cannot write {path}"), files.atomic_write(path, replace=False) as file, style():
            file.write(rendered(figure, kind, stem.name))
    return paths
