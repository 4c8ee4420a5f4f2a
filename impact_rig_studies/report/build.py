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
"""Construction of a report: the order of its sections, and the files that are written."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import quote

from markupsafe import Markup

from impact_rig.drawing import Drawn, style
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.names import FIGURE_FORMATS
from impact_rig.rig.config import fields, to_flat
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig.system import files
from impact_rig_studies.campaign import run
from impact_rig_studies.campaign.paper import FREQUENCIES_HZ, FREQUENCY_HZ
from impact_rig_studies.campaign.results import Point
from impact_rig_studies.campaign.run import Finished
from impact_rig_studies.campaign.statements import Variation, variations
from impact_rig_studies.campaign.tasks import CONFIGURATION_FILE
from impact_rig_studies.dynamics import plan as dynamics
from impact_rig_studies.report import content as kept
from impact_rig_studies.report import cover, dt, findings, measured
from impact_rig_studies.report.content import Cell, Content, number
from impact_rig_studies.report.dt import draw_phase_plane, draw_time_trace
from impact_rig_studies.report.findings import value_cell
from impact_rig_studies.report.page import Section, contents, folded, links, page, paragraph, section
from impact_rig_studies.report.studies import continued, reduction_over_gap, study_figures

PAGE_FILE, FIGURES_FOLDER = "report.html", "figures"
PEAK_HZ = 0.1  # studies within this distance of 9.1 Hz are shown as the peaks of the curves


def build_report(
    directory: Path,
    output: Path | None = None,
    margins: Path | None = None,
    branches: Sequence[Path] = (),
    *,
    figures: Path | None = None,
    formats: Sequence[str] = FIGURE_FORMATS,
    rig: str | None = None,
) -> Path:
    """Write the report of a campaign or of a run, with its numbers and figures, and return the path of the page.

    Args:
        directory: directory of the campaign or of the run; an MCAP file is a run.
        output: directory of `report.html` and `report.json`; None means that of the results.
        margins: directory of a campaign with varied constants, for the table of the statements' sensitivity to these;
            None means the campaign itself.
        branches: output directories of `impact-rig dynamics continue` for the campaign's rig; each adds a figure of its
            branches with the measured points.
        figures: directory of the figures; None means the folder `figures` next to the page.
        formats: formats of the figures, some of `impact_rig.names.FIGURE_FORMATS`.
        rig: namespace of the rig, for a recording with several rigs.

    Raises:
        ConfigError: `directory` contains neither campaign nor run, or `margins` has no complete results of two rigs or
            more. A directory in `branches` has no results, or results of another rig or over a parameter that a report
            does not show. `margins` or `branches` are given for a run or an imported campaign. `rig` is given for a
            campaign.
        RecordingError: a campaign has no measurement yet, a run cannot be read or analysed, or a file cannot be
            written.
    """
    folder = directory if directory.is_dir() else directory.parent
    target = (output or folder) / PAGE_FILE
    content = Content()

    def write(title: str, html: str) -> Path:
        return _write(figures or target.parent / FIGURES_FOLDER, formats, target, content, title, html)

    is_campaign = (directory / run.CAMPAIGN_FILE).exists()
    if not is_campaign and (directory.is_file() or any(directory.glob("*.mcap*"))):
        _refuse_comparisons(directory, margins, branches)
        data = measured.of_run(directory, rig)
        paths = [*directory.glob("*.mcap")] if directory.is_dir() else [directory]
        html = measured.document(data, content, _links([target.parent / kept.FILE_NAME, *sorted(paths)], target.parent))
        return write(data.title, html)
    if rig:
        raise ConfigError(f"--rig applies only to a run, but {directory} is not a run; leave it out")
    done = run.open_finished(directory)
    if not done.points:
        raise RecordingError(
            f"{directory} holds no measured point yet: wait for the first one or, if the campaign was interrupted, "
            "repeat the command that began it, which continues it"
        )
    if done.imported:
        _refuse_comparisons(directory, margins, branches)
        data = measured.of_campaign(done)
        html = measured.document(data, content, _links(_paths(done, target.parent), target.parent))
        return write(data.title, html)
    varied = variations(run.open_finished(margins).points) if margins else variations(done.points)
    if margins and not varied:
        raise ConfigError(
            f"the results in {margins} do not suffice to judge the paper's statements on two rigs or more: give "
            "--margins the directory of a completely measured campaign that varies constants, such as "
            "config/campaigns/margins.yaml"
        )
    with style():
        opening = list(cover.opening(done, content))
        drawn = [_continued(f"continued_{i}", one, done) for i, one in enumerate(branches)]
        sections = list(filter(None, _sections(done, varied, drawn, content, target.parent)))
    html = page(done.campaign.title, [*opening, contents(sections), *sections])
    return write(done.campaign.title, html)


def _continued(name: str, directory: Path, done: Finished) -> Drawn:
    """Draw the branches in an output directory of `impact-rig dynamics continue` as the figure `name`.

    Raises:
        ConfigError: the directory has no results, the branches belong to another rig than the campaign `done`, or they
            are over a parameter that a report does not show.
    """
    study = dynamics.open_study(directory, dynamics.CONTINUE)
    try:
        return continued(name, study, done.points, done.campaign.base)
    except ConfigError as error:
        raise ConfigError(f"{directory}: {error}") from error


def _refuse_comparisons(directory: Path, margins: Path | None, branches: Sequence[Path]) -> None:
    """Reject the options `--margins` and `--branches` for the report of a run or of an imported campaign.

    Raises:
        ConfigError: one of them is given.
    """
    if margins or branches:
        raise ConfigError(
            f"--margins and --branches need a simulated campaign, but {directory} is a run or an imported campaign; "
            "leave them out"
        )


def _write(folder: Path, formats: Sequence[str], target: Path, content: Content, title: str, html: str) -> Path:
    """Write the page `html` to `target`, its numbers next to it, and its figures into `folder`; return `target`.

    The figures of an earlier report at `target` are removed from `folder` first.

    Raises:
        RecordingError: a file cannot be written.
    """
    try:
        files.make_folder(folder)
        for name in kept.earlier_figures(target.parent / kept.FILE_NAME):
            for kind in (*FIGURE_FORMATS, "csv"):
                (folder / f"{name}.{kind}").unlink(missing_ok=True)
        for one in content.drawn:
            one.save(folder, formats)
        content.write(target.parent / kept.FILE_NAME, title)
        files.write_text(target, html)
    except OSError as error:
        raise RecordingError(f"cannot write the report: {error.strerror} ({error.filename or target})") from error
    return target


def _sections(
    done: Finished, varied: list[Variation], drawn: list[Drawn], content: Content, folder: Path
) -> Iterator[Section | None]:
    """Yield the sections of a campaign's report in order; a section without content is None.

    Args:
        done: campaign with its results.
        varied: verdicts on rigs with varied constants.
        drawn: figures of the model's branches.
        content: collection to which tables and figures are added.
        folder: directory of the page, to which links are relative.
    """
    curves, config, keep = done.curves, done.campaign.base, content.figures
    reductions = done.reductions()
    compared = itertools.chain(
        dt.draw_without_sphere(curves, config),
        dt.draw_reductions_by_gap(reductions),
        dt.draw_residuals(reductions),
        dt.draw_errors_without_sphere(curves, config),
    )
    details = itertools.chain(dt.draw_peaks(curves), dt.draw_amplitudes(curves), dt.draw_regimes(curves))
    yield section("Set-up and instruments", *cover.apparatus(done, content))
    yield section("Transmissibility", keep(dt.draw_all_gaps(curves, config), large=True))
    yield section("Reductions: the paper and this rig", *findings.reductions_table(done, content), keep(compared))
    by_frequency = keep(dt.draw_damper(curves, done.calibration))
    yield section("Effect of the damper according to DT", *findings.damper(done, content), by_frequency)
    yield section("The paper's statements", *findings.statements(done, content))
    yield section("Uncertainty of one transmissibility", *findings.uncertainty(done, content))
    yield section("Chosen constants, and the strength of each verdict", *findings.chosen(config, content))
    yield section("Sensitivity of the statements to the chosen constants", *findings.margins(varied, content))
    yield section("Each gap next to the curve without sphere", keep(dt.draw_each_gap(curves)))
    yield section("Peak, amplitudes, regimes", keep(details))
    yield section("Stable and unstable motions of the model", keep(drawn))
    yield section("Motion", keep(_motions(done)))
    yield section("Further studies", keep(_studies(done)))
    yield section("Points without a settled measurement", _failed(done.failed(), content))
    yield section("The rig", *_configuration(done, content))
    yield section("Versions and files", *_files(done, content, folder))


def _motions(done: Finished) -> Iterator[Drawn]:
    shown: dict[float, Point] = {}
    for point in done.points:
        at_resonance = point.reference and point.frequency_hz == FREQUENCY_HZ and point.gap_m != NO_SPHERE
        if at_resonance and done.outcomes[point.key].trace:
            shown.setdefault(point.gap_m, point)
    for draw in (draw_time_trace, draw_phase_plane):
        for gap, point in shown.items():
            yield draw(done.outcomes[point.key].trace, gap, point.frequency_hz)


def _studies(done: Finished) -> Iterator[Drawn]:
    for study in done.campaign.studies:
        own = [point for point in done.points if point.study == study.name]
        known = set(study.frequencies_hz) == set(FREQUENCIES_HZ) or max(study.frequencies_hz) - FREQUENCY_HZ < PEAK_HZ
        if known and len(study.frequencies_hz) > 1 and all(point.reference for point in own):
            continue  # the paper's own curves and their peaks are shown above
        theory = None
        if own and len(study.frequencies_hz) == 1 and all(set(point.axes) <= {"sphere.start"} for point in own):
            theory = reduction_over_gap(done.campaign.base, own[0].frequency_hz, own[0].current_a)
        yield from study_figures(study.name, own, done.curves, done.calibration, theory)


def _failed(failed: Sequence[Point], content: Content) -> Markup:
    if not failed:
        return paragraph("None.")
    rows: list[list[str | Cell]] = [
        [point.study, ", ".join([point.label, *(f"{n}={v}" for n, v in point.axes.items())]),
         number(point.frequency_hz, "g"), point.direction, point.status]
        for point in failed
    ]  # fmt: skip
    return content.table("failed", ["study", "case", "frequency (Hz)", "direction", "why"], rows, [2])


def _configuration(done: Finished, content: Content) -> Iterator[Markup]:
    values = to_flat(done.campaign.base)
    varied = {name for study in done.campaign.studies for name in study.vary} | {"barriers.gap_m", "sphere.present"}
    rows: list[list[str | Cell]] = [
        [
            name,
            value_cell(values[name]),
            about.unit,
            "this campaign" if values[name] != default else about.origin.value,
            "yes" if name in varied else "",
            about.doc,
        ]
        for name, about, default in fields()
        if not name.startswith(("time.", "step.", "pluck.", "output."))
    ]
    yield paragraph(
        "Origin: paper = printed there, identified = chosen so that its published statements hold, assumed = plausible "
        "catalogue value or a choice of this project, this campaign = changed in its file."
    )
    table = content.table("configuration", ["name", "value", "unit", "origin", "varied", "meaning"], rows, [1])
    yield folded(f"All {content.fact('values', len(rows))} values", table)


def _files(done: Finished, content: Content, folder: Path) -> Iterator[Markup]:
    rows = [[name.replace("_", " "), str(value)] for name, value in cover.versions(done).items()]
    yield content.table("versions", ["what", "version"], rows)
    paths = _paths(done, folder)
    yield _links(paths, folder)
    if not any(path.suffix == ".mcap" for path in paths):
        yield paragraph(
            "No MCAP files: this campaign was measured without the recorder. `impact-rig demo` records the same cases.",
            "muted",
        )


def _paths(done: Finished, folder: Path) -> list[Path]:
    """Return the paths of the files that the page of a campaign links to.

    These are the existing files of results and runs, and `report.json` in `folder`, the directory of the page.
    """
    names = [run.CSV_FILE, "summary.json", kept.FILE_NAME, run.CAMPAIGN_FILE, CONFIGURATION_FILE]
    if done.imported:
        names.remove(CONFIGURATION_FILE)  # it describes the nominal rig, on which nothing was measured
    paths = [folder / name if name == kept.FILE_NAME else done.directory / name for name in names]
    paths = [path for path in paths if path.exists() or path.name == kept.FILE_NAME]
    return paths + sorted(done.directory.rglob("*.mcap"))


def _links(paths: Sequence[Path], folder: Path) -> Markup:
    """Return links to files as HTML for a page in the directory `folder`.

    Links to files within `folder` are relative, so that the folder can be moved. Other links are absolute.
    """
    resolved, here = [path.resolve() for path in paths], folder.resolve()
    addresses = [
        quote(path.relative_to(here).as_posix()) if path.is_relative_to(here) else path.as_uri() for path in resolved
    ]
    return links(zip(addresses, (path.name for path in paths), strict=True))
