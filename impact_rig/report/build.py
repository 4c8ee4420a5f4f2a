"""What the report says, in which order."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from impact_rig.campaign import run
from impact_rig.campaign.axes import NO_SPHERE
from impact_rig.campaign.paper import CURRENT_A, FREQUENCIES_HZ, FREQUENCY_HZ, REDUCTION_PERCENT
from impact_rig.campaign.results import Point
from impact_rig.campaign.run import Finished
from impact_rig.config import Origin
from impact_rig.drawing.style import Drawn, style
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.physics.contact import from_config
from impact_rig.report import curves as papers
from impact_rig.report.motion import phase_plane, time_trace
from impact_rig.report.page import escape, figures, folded, link, page, paragraph, section, table, tiles
from impact_rig.report.studies import study_figures
from impact_rig.rig.config import RigConfig, fields, to_flat
from impact_rig.studies.margins import Variation, variations
from impact_rig.system import files

PAGE_FILE, FIGURES_FOLDER = "report.html", "figures"
PEAK_HZ = 0.1
"""Studies that stay this near to 9.1 Hz are shown as the peaks of the curves."""


def build_report(directory: Path, target: Path | None = None, margins: Path | None = None) -> Path:
    """Write the report of the campaign in a directory, and its figures; return the page.

    Args:
        directory: of the campaign.
        target: the page; `report.html` in the directory if None.
        margins: directory of a campaign that varies constants, for the table of what the statements owe to them.

    Raises:
        ConfigError: a directory holds no campaign, or that of the margins no variation.
        RecordingError: nothing was measured yet, or the page cannot be written.
    """
    done = run.open_finished(directory)
    if not done.points:
        raise RecordingError(f"{directory} holds no measured point yet")
    varied = variations(run.open_finished(margins).points) if margins else variations(done.points)
    if margins and not varied:
        raise ConfigError(f"{margins} holds no campaign that varies constants: see config/campaigns/margins.yaml")
    target = target or directory / PAGE_FILE
    drawn: list[Drawn] = []
    with style():
        parts = list(filter(None, _parts(done, varied, drawn, target.parent)))
    try:
        folder = directory / FIGURES_FOLDER
        folder.mkdir(exist_ok=True)
        for one in drawn:
            one.save(folder)
        files.write_text(target, page(done.campaign.title, parts))
    except OSError as error:
        raise RecordingError(f"cannot write the report: {error.strerror} ({error.filename})") from error
    return target


def _parts(done: Finished, varied: list[Variation], drawn: list[Drawn], folder: Path) -> Iterator[str]:
    """Yield the parts of the page that goes into `folder`; figures are appended to `drawn`."""

    def keep(found: Iterator[Drawn]) -> str:
        new = list(found)
        drawn.extend(new)
        return figures(new)

    curves, config = done.curves, done.campaign.base
    reductions = keep(papers.reductions_by_gap(done.reductions()))
    whole = _chain(papers.figure_6(curves, config), papers.figure_7(curves))
    details = _chain(papers.peaks(curves), papers.amplitudes(curves), papers.regime_map(curves))
    yield f"<h1>{escape(done.campaign.title)}</h1>"
    yield from _opening(done)
    yield section("Reductions: the paper and this rig", *_reductions(done), reductions)
    yield section("The paper's statements", *_statements(done))
    yield section("What was chosen, and what a verdict is worth", *_chosen(config))
    yield section("What the statements owe to the choice", *_margins(varied))
    yield section("Without sphere, and all gaps", keep(whole))
    yield section("Each gap beside the curve without sphere", keep(papers.figure_8(curves)))
    yield section("Peak, amplitudes, regimes", keep(details))
    yield section("Motion", keep(_motions(done)))
    yield section("Further studies", keep(_studies(done)))
    yield section("Points without a settled measurement", _failed(done.failed()))
    yield section("The rig", *_configuration(done))
    yield section("Versions and files", *_files(done, folder))


def _chain(*parts: Iterator[Drawn]) -> Iterator[Drawn]:
    for part in parts:
        yield from part


def _opening(done: Finished) -> Iterator[str]:
    reductions, verdicts = done.reductions(), done.verdicts()
    judged = [verdict for verdict in verdicts if verdict.result is not None]
    held = sum(verdict.word == "pass" for verdict in judged)
    items = [(str(len(done.points)), "points measured"), (str(len(done.failed())), "without a settled measurement")]
    if judged:
        items.append((f"{held} of {len(verdicts)}", "statements of the paper hold"))
    if reductions.dt:
        items += [
            (f"{reductions.max_abs_error():.2f} points", "largest difference from the paper's reductions"),
            (f"{reductions.rms_error():.2f} points", "rms difference"),
            (f"{reductions.dt_no_sphere:.1f}", f"DT without sphere at {FREQUENCY_HZ:g} Hz"),
        ]
    yield paragraph(
        "Every number here was measured through the simulated instruments and the analysis, as in a laboratory; error "
        "bars are two combined standard uncertainties. Where the virtual rig's truth is shown, it says so."
    )
    yield tiles(items)


def _reductions(done: Finished) -> Iterator[str]:
    reductions = done.reductions()
    ours, spread, errors = reductions.percent(), reductions.percent_uncertainty, reductions.errors()
    if not ours:
        return
    u = reductions.dt_uncertainty
    rows = [["none", f"{reductions.dt_no_sphere:.2f} ± {2 * u[NO_SPHERE]:.2f}", "", "", ""]]
    rows += [
        [
            f"{gap * 1e3:g}", f"{reductions.dt[gap]:.2f} ± {2 * u[gap]:.2f}", f"{REDUCTION_PERCENT[gap]:.1f}",
            f"{ours[gap]:.2f} ± {2 * spread[gap]:.2f}", f"{round(errors[gap], 1) + 0.0:+.1f}",
        ]
        for gap in sorted(ours)
    ]  # fmt: skip
    yield table(["gap (mm)", f"DT at {FREQUENCY_HZ:g} Hz", "paper (%)", "ours (%)", "difference"], rows, range(5))
    yield paragraph(
        f"Largest difference {reductions.max_abs_error():.2f} points, rms {reductions.rms_error():.2f}. A fit, not a "
        "prediction: see below.",
        "muted",
    )


def _statements(done: Finished) -> Iterator[str]:
    verdicts = done.verdicts()
    if all(verdict.result is None for verdict in verdicts):
        return
    yield paragraph(
        "Each verdict is computed from the points of this campaign. What it is worth stands beside it: a statement "
        "that other values of the chosen constants would break is a fit, one that says again what was fitted follows "
        "from it, and only the rest are predictions. Limits in words of ours (“here”) are not the paper’s."
    )
    yield table(
        ["", "statement", "verdict", "worth", "figures"],
        [[str(i), one.text, one.word, one.kind.value, one.detail] for i, one in enumerate(verdicts, 1)],
    )


def _chosen(config: RigConfig) -> Iterator[str]:
    values = to_flat(config)
    rows = [
        [name, _text(values[name]), about.unit, about.doc]
        for name, about, _ in fields()
        if about.origin is Origin.IDENTIFIED
    ]
    rows.append(["current", _text(CURRENT_A), "A", "Constant coil current, peak."])
    yield paragraph(
        f"The paper prints neither amplitudes nor these {len(rows)} constants; they were chosen so that its five "
        "reductions, its natural frequency and its statements come out. The five reductions of this page are "
        "therefore a fit, not a validation; they determine the product m₁ζ, not m₁ and ζ apart "
        "(docs/identification.md)."
    )
    yield table(["value", "", "unit", "meaning"], rows, [1])
    yield paragraph(
        "For nothing on this page beyond that was anything chosen: DT above resonance, regimes, impacts per cycle, the "
        "optimum gap and everything beyond 10 mm."
    )
    law = from_config(config.contact)
    yield paragraph(
        f"The contact law {config.contact.law.replace('_', ' ')} with the nominal restitution {law.restitution:g} "
        f"really returns {law.realised_restitution():.3f}."
    )


def _margins(varied: list[Variation]) -> Iterator[str]:
    if not varied:
        return
    yield paragraph(
        "One constant differs from the rig of this page, the others are held: the figure of each statement, and "
        "whether it still holds. Empty: not judged."
    )
    judged = [verdict.result for verdict in varied[0].verdicts]
    rows = [["limit", *("" if result is None else f"{result.limit:.4g}" for result in judged)]]
    for one in varied:
        names = [f"{name} = {_text(value)}" for name, value in one.changed.items()]
        words = ["" if v.result is None else f"{v.result.value:.4g} {v.word}" for v in one.verdicts]
        rows.append([", ".join(names) or "the rig itself", *words])
    yield table(["rig", *(str(i) for i in range(1, len(judged) + 1))], rows)


def _motions(done: Finished) -> Iterator[Drawn]:
    shown: dict[float, Point] = {}
    for point in done.points:
        at_resonance = point.reference and point.frequency_hz == FREQUENCY_HZ and point.gap_m != NO_SPHERE
        if at_resonance and done.outcomes[point.key].trace:
            shown.setdefault(point.gap_m, point)
    for draw in (time_trace, phase_plane):
        for gap, point in shown.items():
            yield draw(done.outcomes[point.key].trace, gap, point.frequency_hz)


def _studies(done: Finished) -> Iterator[Drawn]:
    for study in done.campaign.studies:
        own = [point for point in done.points if point.study == study.name]
        known = set(study.frequencies_hz) == set(FREQUENCIES_HZ) or max(study.frequencies_hz) - FREQUENCY_HZ < PEAK_HZ
        if known and len(study.frequencies_hz) > 1 and all(point.reference for point in own):
            continue  # the paper's own curves and their peaks, above
        yield from study_figures(study.name, own, done.curves, done.calibration)


def _failed(failed: Sequence[Point]) -> str:
    if not failed:
        return paragraph("None.")
    return table(
        ["study", "case", "frequency (Hz)", "direction", "why"],
        [
            [point.study, ", ".join([point.label, *(f"{n}={v}" for n, v in point.axes.items())]),
             f"{point.frequency_hz:g}", point.direction, point.status]
            for point in failed
        ],
        [2],
    )  # fmt: skip


def _configuration(done: Finished) -> Iterator[str]:
    values = to_flat(done.campaign.base)
    varied = {name for study in done.campaign.studies for name in study.vary} | {"barriers.gap_m", "sphere.present"}
    rows = [
        [
            name, _text(values[name]), about.unit,
            "this campaign" if values[name] != default else about.origin.value,
            "varied" if name in varied else "", about.doc,
        ]
        for name, about, default in fields()
        if not name.startswith(("time.", "step.", "pluck.", "output."))
    ]  # fmt: skip
    yield paragraph(
        "Origin: paper = printed there, derived = computed from it, identified = chosen so that its published "
        "statements hold, assumed = plausible catalogue value or a choice of this project, this campaign = changed in "
        "its file."
    )
    headings = ["value", "", "unit", "origin", "", "meaning"]
    yield folded(f"All {len(rows)} values", table(headings, rows, [1]))


def _files(done: Finished, folder: Path) -> Iterator[str]:
    versions = json.loads((done.directory / run.PROVENANCE_FILE).read_text(encoding="utf-8"))
    yield table(["", ""], [[name.replace("_", " "), str(value)] for name, value in versions.items()])
    names = [run.CSV_FILE, "summary.json", run.CAMPAIGN_FILE, run.CONFIGURATION_FILE]
    paths = [done.directory / name for name in names if (done.directory / name).exists()]
    paths += sorted(done.directory.rglob("*.mcap"))
    items = "".join(f"<li>{link(_address(path, folder), path.name)}</li>" for path in paths)
    yield f"<ul>{items}</ul>"
    if not any(path.suffix == ".mcap" for path in paths):
        yield paragraph(
            "No MCAP files: this campaign was measured without the recorder. `impact-rig demo` records the same cases.",
            "muted",
        )


def _address(path: Path, folder: Path) -> str:
    """Return where a file is, as seen from the page: relative where it can be, so that the directory can be moved."""
    path, folder = path.resolve(), folder.resolve()
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.as_uri()


def _text(value: object) -> str:
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:.6g}"
    return ", ".join(value) if isinstance(value, tuple) else str(value)
