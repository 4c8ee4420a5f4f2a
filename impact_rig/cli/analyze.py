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
"""Command `impact-rig analyze`: analysis of a recorded run, like that of the live node or as selected by an option."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.transmissibility import note_on
from impact_rig.analysis.uncertainty_budget import plus_minus, rounded
from impact_rig.cli.options import call
from impact_rig.cli.parsers import WINDOWS, analyses
from impact_rig.cli.terminal import Console, TextTable, counted, figure, tell_json
from impact_rig.errors import ConfigError
from impact_rig.recording import Run, open_run
from impact_rig.states import MEASURED, Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from impact_rig.analysis.frf import Frf

LINES = 15  # largest number of printed lines of a frequency response
DRAWN_CYCLES = 4


def run_analyze(arguments: argparse.Namespace) -> int:
    """Run `impact-rig analyze`: analyse a run like the live analysis node, or as an option such as `--frf` selects.

    Return the exit code. With such an option, it is that of the selected analysis. Otherwise it is 1 if the results
    differ from the recorded results of the live analysis, else 0, also if there is nothing to compare.
    """
    console = Console(quiet=arguments.json)
    for name in ("segment", "window", "damping"):
        if getattr(arguments, name) is not None and not arguments.frf:
            raise ConfigError(f"--{name} has an effect only with --frf: add --frf, or omit --{name}")
    with open_run(arguments.path, arguments.rig) as run:
        for analysis in analyses():
            chosen = getattr(arguments, analysis.name)
            if chosen is not None and chosen is not False:  # 0 is chosen, as in --drop 0mm
                return call(analysis.run, console, run, arguments)
        return _as_live(console, run, arguments)


def _as_live(console: Console, run: Run, arguments: argparse.Namespace) -> int:
    from impact_rig.runs import drawings, reanalysis  # noqa: PLC0415

    if arguments.figures is not None:
        drawings.prepare(arguments.figures, arguments.formats)
    findings = list(reanalysis.analyze(run))
    found = reanalysis.measurements(iter(findings))
    comparison = reanalysis.compare(run, found, [table for one in findings for table in one.impacts])
    rows = reanalysis.rows(found)
    if arguments.json:
        keys = ("same", "identical", "compared", "reason")
        compared: dict[str, object] = {key: getattr(comparison, key) for key in keys}
        compared["others"] = [attrs.asdict(one) for one in comparison.others]
        tell_json({"run": str(run.path), "measurements": list(rows), "live": {**compared, "sentence": str(comparison)}})
    _print_last(console, rows)
    _print_measurements(console, rows, everything=arguments.all)
    console.print(str(comparison), style={True: "green", False: "red", None: "yellow"}[comparison.same])
    for one in comparison.others:
        console.print(str(one))
    if arguments.figures is not None:
        excerpt, files = drawings.draw(run, findings, arguments.figures, arguments.formats)
        console.print(f"drawn: {excerpt}")
        for file in files:
            console.print(f"wrote {file}", soft_wrap=True)
    return 1 if comparison.same is False else 0


def _print_last(console: Console, rows: NDArray[np.void]) -> None:
    """Print the newest settled measurement as a sentence.

    If no measurement is settled, print this fact, and then the newest unsettled measurement, if there is one.
    """
    settled = rows[rows["settled"] == 1.0]
    if not len(settled):
        console.print("no settled measurement in this run")
        unsettled = rows[rows["status"] == Status.NOT_SETTLED.value.encode()]
        if len(unsettled):
            row = unsettled[-1]
            console.print(
                f"DT {plus_minus(row['transmissibility'], row['transmissibility_uncertainty'])} (2u) of "
                f"{row['cycles']:g} cycles at {row['frequency']:g} Hz, not settled: it may contain a transient"
            )
        return
    row = settled[-1]
    console.print(
        f"DT {plus_minus(row['transmissibility'], row['transmissibility_uncertainty'])} (2u), phase "
        f"{math.degrees(row['phase']):z.2f}°, at {row['frequency']:g} Hz: the last of {len(settled)} settled "
        "measurements"
    )
    if note := note_on(row):
        console.print(note, style="yellow")


def _print_measurements(console: Console, rows: NDArray[np.void], *, everything: bool) -> None:
    """Print a table with one row per measurement of a run.

    Measurements without a value of DT are printed only if `everything` is true. Otherwise one line counts them by
    status.
    """
    measured = np.isin(rows["status"], [status.value.encode() for status in MEASURED])
    table = TextTable(right=("f [Hz]", "DT", "± 2u", "phase [deg]", "gap [mm]", "impacts per cycle"))
    table.add_column("regime", no_wrap=True)
    table.add_column("status")
    shown = rows if everything else rows[measured]
    for row in shown:
        table.add_row(
            figure(row["frequency"], ".3f"),
            *rounded(row["transmissibility"], row["transmissibility_uncertainty"]),
            figure(math.degrees(row["phase"]), ".2f"),
            figure(row["gap"] * 1e3, "g", "unknown"),
            figure(row["impacts_per_cycle"], ".2f"),
            row["regime"].decode(),
            row["status"].decode(),
        )
    if table.row_count:
        console.print(table)
    if not (everything or np.all(measured)):
        console.print(
            f"rows left out because they have no value of DT: {counted(rows['status'][~measured])} (--all shows them; "
            "docs/explanation/analysis.md explains these words)"
        )


def run_frf(console: Console, run: Run, arguments: argparse.Namespace) -> int:
    """Run `impact-rig analyze --frf`: print the frequency response x_1/x_b of a run, and with `--figures` draw it.

    For a sine drive, the response has a single line. Return exit code 0.
    """
    from impact_rig.analysis.drawings import frequency_response  # noqa: PLC0415  # heavy: after the run is open
    from impact_rig.runs.excerpts import response_of  # noqa: PLC0415  # as above

    for name, most in (("segment", math.inf), ("damping", 1.0)):
        value = getattr(arguments, name)
        if value is not None and not 0.0 < value < most:
            limit = "a finite number of seconds > 0" if most == math.inf else f"> 0 and < {most:g}"
            raise ConfigError(f"--{name} must be {limit}, got {value!r}")
    prepare_figure(arguments, "frf")
    window = arguments.window or WINDOWS[0]
    found = response_of(run, arguments.segment, window, arguments.damping)
    excited = found.excited
    peak = int(excited[np.argmax(np.abs(found.h1[excited]))])
    resonance = found.resonance
    if arguments.json:
        tell_json({
            "run": str(run.path), "averages": found.averages, "peak_hz": found.frequency_hz[peak],
            "segment_s": 1.0 / found.frequency_hz[1], "window": window, "sine": found.sine,
            "resonance_hz": None if resonance is None else resonance.frequency_hz,
            "damping_ratio": None if resonance is None else resonance.damping_ratio,
            "peak_bias": found.bias if math.isfinite(found.bias) else None,
            "lines": [
                {
                    "frequency_hz": found.frequency_hz[i], "h1": abs(found.h1[i]), "h2": abs(found.h2[i]),
                    "hv": abs(found.hv[i]), "coherence": found.coherence[i],
                    "u_relative": found.u_relative[i] if math.isfinite(found.u_relative[i]) else None,
                    "phase_rad": float(np.angle(found.h1[i])),
                }
                for i in excited
            ],
        })  # fmt: skip
    shown = excited[np.linspace(0, len(excited) - 1, min(LINES, len(excited))).round().astype(int)]
    table = TextTable(
        f"Frequency response x_1/x_b (structure/base), {found.averages:.1f} independent averages",
        right=("f [Hz]", "|H1|", "± 2u", "|H2|", "|Hv|", "phase [deg]", "coherence"),
    )
    for line in sorted({*shown.tolist(), peak}):
        size = abs(found.h1[line])
        table.add_row(
            f"{found.frequency_hz[line]:.3f}",
            *rounded(size, size * found.u_relative[line]),
            figure(abs(found.h2[line]), ".3f"),
            figure(abs(found.hv[line]), ".3f"),
            figure(math.degrees(np.angle(found.h1[line])), ".2f"),
            figure(found.coherence[line], ".4f"),
            style="bold" if line == peak else None,
        )
    console.print(table)
    low, high, top = found.frequency_hz[[excited[0], excited[-1], peak]]
    apart = found.frequency_hz[1]
    if found.sine:
        console.print(
            f"the drive is a sine of about {top:g} Hz, so only this line is excited; `impact-rig analyze` without "
            "--frf measures DT there, with its uncertainty"
        )
    else:
        console.print(f"{len(excited)} lines from {low:g} to {high:g} Hz are excited; |H1| is largest at {top:g} Hz")
        console.print(*_resolution(found, window, apart), sep="\n")
    draw_figure(console, run, arguments, "frf", lambda: frequency_response(found, low - apart, high + apart))
    return 0


def _resolution(found: Frf, window: str, apart_hz: float) -> list[str]:
    """Return sentences that compare the distance of the frequency lines with the width of the resonance.

    If the lines are too far apart to show the height of the resonance's peak, the last sentence is a warning. If no
    resonance was found, the only sentence says so.
    """
    from impact_rig.analysis.frf import RESOLVED, SEGMENTS, resolving_s  # noqa: PLC0415  # as above

    resonance = found.resonance
    lines = f"lines {apart_hz:.3g} Hz apart"
    if resonance is None:
        return [f"{lines}; no single resonance fits this record, so it is unknown whether the lines resolve a peak"]
    where = f"the resonance in the record is at {resonance.frequency_hz:.3f} Hz"
    wide = f"{resonance.width_hz:.3g} Hz wide at half power"
    said = [f"{lines}; {where}, with a damping ratio of {resonance.damping_ratio:.5f}, and is {wide}"]
    if found.bias > 1.1 * RESOLVED:
        above = f"{100 * found.bias:.0f} % higher than" if found.bias < 1.0 else "several times as high as"
        need = resolving_s(resonance, window)
        said.append(
            f"WARNING: the lines do not resolve the resonance's peak: the true peak may be {above} the printed one, "
            f"which ± 2u includes; --segment {need:.0f}, with a record of {SEGMENTS * need:.0f} s, reduces this error "
            f"to {100 * RESOLVED:.0f} %"
        )
    return said


def run_sine(console: Console, run: Run, arguments: argparse.Namespace) -> int:
    """Run `impact-rig analyze --sine`: print the sine fitted to each channel and DT, and with `--figures` draw them.

    The scans are those of the last settled measurement. If there is none, they are the scans at the end of the run.
    Return exit code 1 if laser and base were measured but give no valid DT, else 0.
    """
    from impact_rig.analysis.drawings import sine_fits  # noqa: PLC0415  # heavy: after the run is open
    from impact_rig.runs import reanalysis  # noqa: PLC0415  # as above
    from impact_rig.runs.excerpts import calibration_rows, last_excerpt, sines_of  # noqa: PLC0415  # as above

    prepare_figure(arguments, "sine")
    found = sines_of(run, last_excerpt(run, list(reanalysis.analyze(run))))
    info = calibration_rows(run)
    units = {row["name"].decode(): row["unit"].decode() for row in info}
    reference, measured = found.reference, found.measured
    if arguments.json:
        tell_json({
            "run": str(run.path), "frequency_hz": reference.frequency_hz,
            "channels": [
                {
                    "channel": name, "unit": units[name], "amplitude": fit.amplitude, "offset": fit.offset,
                    "u_amplitude": fit.u_amplitudes[0], "phase_rad": fit.phase_rad - reference.phase_rad,
                    "u_phase_rad": fit.u_phases_rad[0], "residual_rms": fit.residual_rms,
                }
                for name, fit in found.fits.items()
            ],
            "reference": found.reference_name,
            "transmissibility": measured.transmissibility if measured else None,
            "u_transmissibility": measured.u_transmissibility if measured else None,
            "phase_rad": measured.phase_rad if measured else None,
            "u_phase_rad": measured.u_phase_rad if measured else None,
            "status": measured.status.value if measured else "no_motion_pair",
        })  # fmt: skip
    table = TextTable(title=f"Sines of {plus_minus(reference.frequency_hz, reference.u_frequency_hz)} Hz")
    for heading in ("channel", "unit", "amplitude", "± 2u", "phase [deg]", "± 2u", "mean", "residual, rms"):
        table.add_column(heading, justify="left" if heading in {"channel", "unit"} else "right", no_wrap=True)
    for name, fit in found.fits.items():
        table.add_row(
            name,
            units[name],
            *rounded(fit.amplitude, fit.u_amplitudes[0]),
            *rounded(math.degrees(fit.phase_rad - reference.phase_rad), math.degrees(fit.u_phases_rad[0])),
            figure(fit.offset, ".4g"),
            figure(fit.residual_rms, ".2g"),
        )
    console.print(table)
    console.print(
        f"{found.excerpt}; phases are relative to the {found.reference_name}, as sampled: without correction of the "
        "sensors' lag and the channels' skew"
    )
    rows = found.excerpt.rows[: round(DRAWN_CYCLES / reference.frequency_hz * found.excerpt.rate_hz)]
    draw_figure(console, run, arguments, "sine", lambda: sine_fits(rows, found.fits, units, found.excerpt.rate_hz))
    if measured is None:
        missing = " and ".join(name for name in ("laser", "base") if name not in found.fits)
        console.print(
            f"no DT: it needs the channels laser (structure) and base, but the run has no {missing}; record a run with "
            "both"
        )
        return 0
    if measured.status not in MEASURED or not math.isfinite(measured.u_transmissibility):
        console.print(
            f"no DT from these scans, status {measured.status.value} (docs/explanation/analysis.md explains it)",
            style="red",
        )
        return 1
    phase, u_phase = math.degrees(measured.phase_rad), math.degrees(measured.u_phase_rad)
    console.print(
        f"DT {plus_minus(measured.transmissibility, measured.u_transmissibility)} (2u), phase "
        f"({plus_minus(phase, u_phase)})° (2u), corrected for lag and skew; status {measured.status.value}"
    )
    return 0


def prepare_figure(arguments: argparse.Namespace, stem: str) -> None:
    """Create the directory of `--figures` and check, before a long analysis, that the figure `stem` can be written.

    Without `--figures`, do nothing.

    Raises:
        RecordingError: the directory cannot be created or written to, or contains the figure already.
    """
    if arguments.figures is not None:
        from impact_rig.runs.drawings import prepare  # noqa: PLC0415  # heavy: after the run is open

        prepare(arguments.figures, arguments.formats, [stem])


def draw_figure(
    console: Console, run: Run, arguments: argparse.Namespace, stem: str, draw: Callable[[], Figure]
) -> None:
    """Draw a figure, save it in the directory of `--figures`, and print the path of each file.

    Without `--figures`, do nothing.

    Args:
        console: output of the command.
        run: run that the figure shows, named in its title.
        arguments: parsed options, with the directory and the formats of the figures.
        stem: name of the files, without suffix.
        draw: function that returns the figure.
    """
    if arguments.figures is None:
        return
    from impact_rig.runs.drawings import save, titled  # noqa: PLC0415  # heavy: after the run is open

    for file in save(titled(draw(), run), arguments.figures / stem, arguments.formats):
        console.print(f"wrote {file}", soft_wrap=True)
