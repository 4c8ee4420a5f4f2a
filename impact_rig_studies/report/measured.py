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
"""Report of an imported campaign, or of a single run, recorded or imported.

It contains only results of the data, and no comparison with the paper.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any  # Any: what matplotlib takes

import attrs
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

import impact_rig
from impact_rig.analysis import drawings
from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.scans import samples_of
from impact_rig.analysis.tracker import Findings
from impact_rig.analysis.uncertainty_budget import COVERAGE, Budget, budget, plus_minus
from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.drawing import SERIES, WIDTH_INCH, Drawn, Line, legend_below, new_axes, style
from impact_rig.recording import Run, open_run
from impact_rig.recording.description import MEASURED, MODE_KEY
from impact_rig.rig.gaps import NO_SPHERE, case_of
from impact_rig.runs import reanalysis
from impact_rig.runs.drawings import TRACED_CYCLES, channel_units, main_motion
from impact_rig.runs.excerpts import calibration_rows, last_excerpt
from impact_rig.runs.origin import origin
from impact_rig.simtime import NS_PER_S
from impact_rig.states import Method
from impact_rig_studies.campaign.run import Finished
from impact_rig_studies.reduction import reduction
from impact_rig_studies.report import cover
from impact_rig_studies.report.content import BUDGET_HEADINGS, Cell, Content, budget_rows, number, uncertain
from impact_rig_studies.report.page import contents, heading, page, paragraph, section, tiles, title
from impact_rig_studies.report.page import cover as cover_block

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOTION_INCH = 4.4  # height of a drawing of the motion
BATCHES = 4  # for a response that is not periodic: the smaller number, see docs/explanation/analysis.md


@attrs.frozen(eq=False, kw_only=True)
class MeasuredData:
    """Content of a report of measurements: the results of an imported campaign or of one run."""

    title: str
    kind: str  # description of the measurement, in one sentence
    about: Sequence[tuple[str, str]]  # pairs of label and value below the title
    rows: NDArray[np.void]  # settled rows of `transmissibility/table`, one per gap and frequency, shape (n,)
    info: NDArray[np.void]  # rows of `daq/info`
    failed: Sequence[tuple[str, str]] = ()  # places without a settled measurement, and the reasons
    drawn: Sequence[Drawn] = ()  # drawings of the motion


def of_campaign(done: Finished) -> MeasuredData:
    """Return the content of the report of an imported campaign.

    It contains the last measurement of each settled point, and the reason for each point that did not settle.
    """
    settled = [point for point in done.points if point.settled]
    parts = [point.rows[-1:] for point in settled]
    rows: NDArray[np.void] = np.concatenate(parts) if parts else np.empty(0, TRANSMISSIBILITY)
    files = sorted({path.parent.name for path in (done.directory / "runs").rglob("*.mcap")})
    return MeasuredData(
        title=done.campaign.title,
        kind="Report of an imported measurement: instruments, rates and labels are those given at the import.",
        about=[
            ("Files", ", ".join(files)),
            ("Imported", cover.written(done)),
            *_about(rows, done.info),
            *_origins(done.directory / "runs"),
        ],
        rows=rows,
        info=done.info,
        failed=[(f"{point.label} at {point.frequency_hz:g} Hz", point.status) for point in done.failed()],
    )


def _origins(directory: Path) -> Iterator[tuple[str, str]]:
    """Yield the assumptions and omissions of the import of all runs below a directory, as pairs of label and text."""
    found: dict[str, list[str]] = {"assumed": [], "left out": []}
    for path in sorted(path.parent for path in directory.rglob("metadata.yaml")):
        with open_run(path) as run:
            facts = origin(run.attachments())
        for what in found.keys() & facts.keys():
            found[what].append(f"{path.name}: {facts[what]}")
    yield from ((what.capitalize(), "; ".join(texts)) for what, texts in found.items() if texts)


def of_run(path: Path, rig: str | None = None) -> MeasuredData:
    """Return the content of the report of a run; `rig` is a namespace, needed only if the run has several rigs.

    It contains the newest settled measurement at each gap and frequency. If the run has no settled measurement, the
    content states the last status of the run.

    Raises:
        RecordingError: the run cannot be read or analysed.
    """
    with open_run(path, rig) as run, style():
        found = list(reanalysis.analyze(run))
        tables = reanalysis.measurements(iter(found))
        everything, rows, info = reanalysis.rows(tables), reanalysis.newest_settled(tables), calibration_rows(run)
        known = run.provenance
        imported = known.get(MODE_KEY) == MEASURED
        began = known.get("wall_start_ns", "")
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S%z", time.localtime(int(began) / NS_PER_S)) if began.isdecimal() else ""
        about = [
            ("Source", known.get("source", "") if imported else ""),
            ("Imported" if imported else "Recorded", stamp),
            ("Duration", f"{(run.end_ns - run.start_ns) / NS_PER_S:.6g} s"),
            ("Seed", "" if imported else known.get("seed", "")),
            ("Recorded by version", known.get("version", "")),
            *_about(rows, info),
            ("Remarks", "; ".join(reanalysis.remarks(run))),
            *((what.capitalize(), text) for what, text in origin(run.attachments()).items()),
        ]
        last = everything["status"][-1].decode() if len(everything) else "no measurement was begun"
        return MeasuredData(
            title=run.path.name,
            kind="Report of an imported run." if imported else "Report of a run of the virtual test rig.",
            about=about,
            rows=rows,
            info=info,
            failed=[] if len(rows) else [("the whole run", last)],
            drawn=list(_motion(run, found)),
        )


def document(data: MeasuredData, content: Content, links: Markup) -> str:
    """Return the HTML page of a report of measurements.

    Args:
        data: content of the report.
        content: collection to which tables and figures are added.
        links: HTML with links to the files of the measurement.
    """
    with style():
        calibration = Calibration.from_info(data.info)
        rows = data.rows
        best = rows[np.argmax(rows["transmissibility"])][None] if len(rows) else rows  # shape (1,), or no row
        sections = [
            section("Transmissibility", *_results(rows, content)),
            section("Reduction by the sphere", *_reductions(rows, calibration, content)),
            section("Uncertainty", *_uncertainty(best, calibration, content)),
            section("Motion", content.figures(data.drawn)),
            section("Instruments and their calibration", *cover.instruments_table(data.info, content)),
            section("Without a settled measurement", *_failed(data, content)),
            section("Files", links),
        ]
        found = [one for one in sections if one is not None]
        opening = [
            title(data.title),
            paragraph(data.kind, "muted"),
            cover_block([(what, content.fact(what.lower(), value)) for what, value in data.about]),
            tiles(_tiles(data, best, content)),
        ]
        return page(data.title, [*opening, contents(found), *found])


def _about(rows: NDArray[np.void], info: NDArray[np.void]) -> Iterator[tuple[str, str]]:
    """Yield the conditions of a measurement as pairs of label and text, such as rate, frequencies and amplitudes.

    `rows` are the settled measurements, `info` the rows of `daq/info`.
    """
    rates = sorted({float(row["rate"]) for row in info})
    yield "Rate", f"{', '.join(f'{rate:.10g}' for rate in rates)} scans/s"
    yield "Instruments", ", ".join(row["name"].decode() for row in info)
    yield "Frequency", _span(rows["frequency"], 1.0, "Hz")
    yield "Gap", ", ".join(dict.fromkeys(case_of(float(gap)) for gap in rows["gap"]))
    yield "Amplitude of the base", _span(rows["base_amplitude"], 1e6, "µm")
    yield "Amplitude of the structure", _span(rows["laser_amplitude"], 1e3, "mm")
    yield "Amplitude of the current", _span(rows["current_amplitude"], 1.0, "A")
    yield "Report", f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')}, impact_rig {impact_rig.__version__}"


def _span(values: NDArray[np.float64], factor: float, unit: str) -> str:
    """Return the range of the finite values > 0, times `factor`, as text with `unit`; empty if there are none."""
    known = factor * values[np.isfinite(values) & (values > 0.0)]
    if not len(known):
        return ""
    low, high = (f"{one:.4g}" for one in (known.min(), known.max()))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def _tiles(data: MeasuredData, best: NDArray[np.void], content: Content) -> Iterator[tuple[str, str]]:
    yield content.fact("measured", len(data.rows)), "settled measurement" + "s" * (len(data.rows) != 1)
    yield content.fact("failed", len(data.failed)), "without a settled measurement"
    for row in best:
        dt, u = float(row["transmissibility"]), float(row["transmissibility_uncertainty"])
        content.fact("largest_dt", dt)
        content.fact("largest_dt_expanded_uncertainty", COVERAGE * u)
        where = f"{case_of(float(row['gap']))}, {content.fact('largest_dt_hz', float(row['frequency']), '.6g')} Hz"
        yield plus_minus(dt, u), f"largest DT: {where}"


def _results(rows: NDArray[np.void], content: Content) -> Iterator[Markup]:
    if not len(rows):
        return
    if np.ptp(rows["frequency"]) > 0.0:  # a single frequency makes no curve
        yield content.figures([transmissibility(rows)], large=True)
    cells: list[list[str | Cell]] = [
        [
            case_of(float(row["gap"])),
            number(float(row["frequency"]), ".6g"),
            uncertain(float(row["transmissibility"]), float(row["transmissibility_uncertainty"])),
            uncertain(math.degrees(row["phase"]), math.degrees(row["phase_uncertainty"])),
            number(1e6 * float(row["base_amplitude"]), ".4g"),
            number(1e3 * float(row["laser_amplitude"]), ".4g"),
            number(float(row["current_amplitude"]) or math.nan, ".4g"),
            number(float(row["impacts_per_cycle"]), ".3g"),
            row["regime"].decode(),
        ]
        for row in rows
    ]
    headings = [
        "case", "frequency (Hz)", "DT ± 2u", "phase ± 2u (°)", "base (µm)", "structure (mm)", "current (A)",
        "impacts per cycle", "regime",
    ]  # fmt: skip
    yield content.table("measured", headings, cells, range(1, 8))


def transmissibility(rows: NDArray[np.void]) -> Drawn:
    """Draw DT and phase of settled measurements over the frequency, ± 2u, one line per gap.

    Call this within `drawing.style`.
    """
    figure, (upper, lower) = new_axes(4.8, (1.6, 1.0))
    lines: list[Line] = []
    for i, case in enumerate(dict.fromkeys(case_of(float(gap)) for gap in rows["gap"])):
        own = rows[[case_of(float(gap)) == case for gap in rows["gap"]]]
        own = own[np.argsort(own["frequency"], kind="stable")]
        columns = {
            "frequency_hz": own["frequency"],
            "transmissibility": own["transmissibility"],
            "expanded_uncertainty": COVERAGE * own["transmissibility_uncertainty"],
            "phase_deg": np.degrees(own["phase"]),
            "expanded_phase_uncertainty": COVERAGE * np.degrees(own["phase_uncertainty"]),
        }
        frequency, dt, u, phase, u_phase = columns.values()
        style: dict[str, Any] = {
            "color": SERIES[i % len(SERIES)],
            "marker": "o",
            "markersize": 3.0,
            "linewidth": 0.8,
            "capsize": 2.0,
        }
        current = drawings.amplitudes(own["current_amplitude"], "A")
        upper.errorbar(frequency, dt, u, label=", ".join(filter(None, [case, current, "± 2u"])), **style)
        lower.errorbar(frequency, phase, u_phase, **style)
        lines.append(Line(case, columns))
    upper.set(ylabel="transmissibility $|X_1|/|X_b|$", ylim=(0.0, None), title="Displacement transmissibility")
    lower.set(ylabel="phase (°)", xlabel="frequency (Hz)")
    legend_below(lower, 3, upper)
    caption = "Displacement transmissibility and the phase of the structure to the base, as measured, ± 2u."
    return Drawn("transmissibility", figure, caption, lines)


def _reductions(rows: NDArray[np.void], calibration: Calibration, content: Content) -> Iterator[Markup]:
    """Yield a table of the reductions of DT relative to the measurement without sphere at the same frequency, as HTML.

    Measurements without such a reference are left out. Nothing is yielded if no measurement remains.
    """
    without = {float(row["frequency"]): row[None] for row in rows if row["gap"] == NO_SPHERE}
    cells: list[list[str | Cell]] = []
    for row in rows:
        reference = without.get(float(row["frequency"]))
        if reference is None or not row["gap"] > NO_SPHERE:
            continue
        found = reduction(reference, row[None], calibration)
        cells.append(
            [
                case_of(float(row["gap"])),
                number(float(row["frequency"]), ".6g"),
                uncertain(found.percent, found.u_points),
            ]
        )
    if cells:
        yield content.table("reductions", ["case", "frequency (Hz)", "reduction of DT ± 2u (%)"], cells, [1, 2])


def _uncertainty(row: NDArray[np.void], calibration: Calibration, content: Content) -> Iterator[Markup]:
    """Yield the uncertainty of one DT as HTML: result, coverage factor, degrees of freedom, conditions and budget.

    `row` is the measurement, shape (1,). Nothing is yielded if `row` is empty.
    """
    if not len(row):
        return
    found = budget(row, calibration)
    of_a, effective = degrees_of_freedom(found, row[0])
    result = plus_minus(found.transmissibility, found.u_transmissibility)
    content.fact("budget_dt", found.transmissibility)
    content.fact("budget_expanded_uncertainty", COVERAGE * found.u_transmissibility)
    dof = "more than 1000" if effective > 1000.0 else content.fact("budget_degrees_of_freedom", effective, ".3g")
    yield paragraph(
        f"{case_of(float(row['gap'][0]))}, {content.fact('budget_hz', float(row['frequency'][0]), '.6g')} Hz: "
        f"DT = {result}. The number behind ± is an expanded uncertainty: the combined standard uncertainty "
        f"times the coverage factor k = {content.fact('coverage_factor', COVERAGE, 'g')}, coverage about 95 %. "
        f"Effective degrees of freedom (Welch–Satterthwaite): {dof}; type A has "
        f"{content.fact('budget_degrees_of_freedom_a', of_a, 'g')}, and Student's factor for them is part of its u; "
        "type B counts as known."
    )
    yield paragraph(
        f"Conditions: {content.fact('budget_cycles', float(row['cycles'][0]), 'g')} drive cycles after the transient "
        f"had died; amplitude of the base {_span(row['base_amplitude'], 1e6, 'µm')}, of the structure "
        f"{_span(row['laser_amplitude'], 1e3, 'mm')}; response {row['regime'][0].decode()}. Type A comes from the "
        "measurement itself, B from the calibration. The sensitivity of a sensor is that at the amplitude of this case."
    )
    yield heading("Budget")
    yield content.table("uncertainty_budget", BUDGET_HEADINGS, budget_rows(found), [3, 4, 5])


def degrees_of_freedom(found: Budget, row: np.void) -> tuple[float, float]:
    """Return the degrees of freedom of the type A uncertainty, and the effective ones of the combined uncertainty.

    The first value is the number of batches or cycles minus 1. The second value is infinite if the budget has no part
    of type A. `found` is the uncertainty budget of `row`, a measurement of `transmissibility/table`.

    Source: JCGM 100:2008 (GUM), G.4, with infinitely many for every part of type B.
    """
    batches = row["method"].decode() == Method.BATCH_MEANS.value
    own = float(BATCHES if batches else max(row["cycles"], 2.0)) - 1.0
    relative = found.u_transmissibility / found.transmissibility
    share = math.fsum(part.u_relative**4 for part in found.parts if part.evaluation == "A") / relative**4
    return own, own / share if share > 0.0 else math.inf


def _motion(run: Run, found: Sequence[Findings]) -> Iterator[Drawn]:
    """Yield drawings of the time traces and of the spectrum of a run.

    They show the last settled measurement, or the end of the run if no measurement settled. `found` contains the
    findings of the analysis of the run.

    Raises:
        RecordingError: the run has no calibration, or too few contiguous scans to draw.
    """
    excerpt = last_excerpt(run, found)
    traced = excerpt.newest(TRACED_CYCLES)
    units = channel_units(run)
    channel, factor, unit, name = main_motion(excerpt.rows, units)
    samples = samples_of(excerpt.rows, channel)
    upto_hz = min(10.5 * excerpt.drive_hz or 100.0, excerpt.rate_hz / 2.0)
    pictures: Sequence[tuple[str, Figure, str]] = (
        ("time_traces", drawings.time_traces(traced.rows, traced.impact_times, units=units), f"Time traces, {traced}."),
        (
            "spectrum",
            drawings.spectrum(factor * samples, excerpt.rate_hz, unit, excerpt.drive_hz, upto_hz),
            f"Spectrum of {name.strip('$')}, {excerpt}.",
        ),
    )
    for stem, figure, caption in pictures:
        figure.set_size_inches(WIDTH_INCH, MOTION_INCH)  # as wide as a phone
        yield Drawn(stem, figure, caption)


def _failed(data: MeasuredData, content: Content) -> Iterator[Markup]:
    if data.failed:
        yield content.table("failed", ["case", "why"], [list(one) for one in data.failed])
