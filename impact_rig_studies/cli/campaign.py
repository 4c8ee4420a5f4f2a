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
"""`impact-rig campaign` and `report`: measurement, resumption and judgement of a campaign file, and its report."""

from __future__ import annotations

import argparse
import contextlib
import json
import time
from pathlib import Path

from impact_rig.cli.terminal import (
    Commands,
    Console,
    Counted,
    TextTable,
    add_figures,
    add_json,
    add_rig,
    figure,
    subcommand,
    tell_program,
    tell_results,
)
from impact_rig.errors import ConfigError
from impact_rig.system import files
from impact_rig_studies.campaign import paper, run
from impact_rig_studies.campaign.job import Job, execute
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.campaign.results import FILE_NAME
from impact_rig_studies.campaign.statements import Variation, Verdict, variations
from impact_rig_studies.campaign.store import Store
from impact_rig_studies.campaign.tasks import measure
from impact_rig_studies.cli import tasks

WAYS = ("process", "ros", "dask")
SHOWN = 20  # largest number of failing points that are printed; the CSV contains all


def add_command(commands: Commands) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "campaign", _run, "measure all points of a campaign file; run again to resume",
        [
            ("campaign config/paper.yaml", "the whole paper, on all cores"),
            ("campaign config/paper.yaml --only curves --check", "its 60 points; exit code 1 if they are wrong"),
            ("campaign my.yaml --through ros --record --output runs/mine", "through the real graph, with recordings"),
        ],
        "The last line is the directory of the results; `impact-rig report` makes a page of it.",
    )  # fmt: skip
    add_json(parser)
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE", help="campaign file, e.g. config/paper.yaml")
    parser.add_argument(
        "--through", nargs="+", default=["process"], metavar="WAY",
        help="way of measuring: process (all cores; default), ros (the real graph) or dask ADDRESS (a Dask cluster)",
    )  # fmt: skip
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="results, resumed if they exist (default: runs/campaign_<file>)"
    )
    parser.add_argument("--only", nargs="+", default=(), metavar="STUDY", help="studies to run (default: all)")
    parser.add_argument(
        "--seed", type=int, metavar="N", help="seed of noise and calibration errors (default: the file's)"
    )
    parser.add_argument("--scan-rate", type=int, metavar="HZ", help="scans per second (default: the file's)")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one per core)")
    parser.add_argument("--record", action="store_true", help="record every run as MCAP (with --through ros)")
    parser.add_argument(
        "--check", action="store_true", help="exit with 1 if a point failed or a measurement contradicts the paper"
    )


def _run(arguments: argparse.Namespace) -> int:
    file, directory, way, address = tasks.words(arguments, "campaign", "campaign config/paper.yaml", WAYS)
    overrides = {"daq.seed": arguments.seed, "daq.rate_hz": arguments.scan_rate}
    campaign = load_campaign(file, {name: value for name, value in overrides.items() if value is not None})
    if arguments.only:
        campaign = campaign.only(tuple(arguments.only))
    if arguments.record and way != "ros":
        raise ConfigError("--record needs --through ros, because messages are recorded")
    console = Console(quiet=arguments.json)
    started = time.monotonic()
    jobs = run.unique_jobs(campaign.planned())
    if way == "ros":
        from impact_rig_studies.ros_campaign import ros_runner  # noqa: PLC0415  # needs rclpy

        runner = ros_runner(directory, directory / "runs" if arguments.record else None)
    else:
        runner = tasks.runner(execute, address, arguments.workers)
    with files.results_in(directory, lambda: run.prepare(campaign, directory, way)) as store:
        _measure(jobs, store, runner)
    for what in store.damaged:
        console.print(f"{what}; it was measured again", style="yellow")
    done = run.finished(campaign, directory)
    run.write_results(done, time.monotonic() - started)
    verdicts = done.verdicts()
    close = _print_reductions(console, done)
    _print_verdicts(console, verdicts)
    _print_margins(console, variations(done.points))
    _print_failed(console, done)
    _print_quiet(console, done)
    console.print(f"{len(done.points)} points; figures for programs: {run.CSV_FILE}, summary.json")
    tell_results(directory, _content(done), as_json=arguments.json)
    sound = close and not done.failed() and all(verdict.word != "FAIL" for verdict in verdicts)
    return 1 if arguments.check and not sound else 0


def _content(done: run.Finished) -> dict[str, object]:
    """Return the printed results as data: `summary.json`, and the rest of the CSV."""
    return {
        **json.loads((done.directory / FILE_NAME).read_text(encoding="utf-8")),
        "verdicts": [
            {"name": one.name, "statement": one.text, "verdict": one.word, "worth": one.kind.value, "found": one.detail}
            for one in done.verdicts()
        ],
        "margins": [
            {
                "changed": dict(one.changed),
                "values": {v.name: None if v.result is None else v.result.value for v in one.verdicts},
            }
            for one in variations(done.points)
        ],
        "failed": [
            {
                "study": point.study, "case": point.label, "axes": dict(point.axes),
                "frequency_hz": point.frequency_hz, "direction": point.direction, "why": point.status,
            }
            for point in done.failed()
        ],
    }  # fmt: skip


def _measure(jobs: list[Job], store: Store, runner: run.Runner) -> None:
    failed = 0
    with (
        Counted(Console(stderr=True), "runs", len(jobs)) as shown,
        contextlib.closing(measure(jobs, store.get, store.put, runner)) as done,
    ):
        for number, (job, outcome) in enumerate(done, 1):
            failed += bool(outcome.failure)
            trouble = f"{failed} failed" if failed else ""
            shown.show(number, f"{job.describe()}, {trouble}" if failed else job.describe())
            shown.end = trouble or "done"


def _print_reductions(console: Console, done: run.Finished) -> bool:
    """Print the table of reductions; return whether the measured ones are close to the paper."""
    reductions = done.reductions()
    if not reductions.percent():
        return True
    ours, spread, errors = reductions.percent(), reductions.percent_uncertainty, reductions.errors()
    table = TextTable(
        f"Reduction of DT at {paper.FREQUENCY_HZ} Hz against no sphere (fitted, not predicted)",
        right=("gap [mm]", "DT", "± 2u", "paper [%]", "ours [%]", "± 2u", "difference"),
    )
    u = reductions.dt_uncertainty
    table.add_row("none", f"{reductions.dt_no_sphere:.2f}", figure(2 * u[0.0], ".2f"), "", "", "", "", end_section=True)
    for gap, value in sorted(ours.items()):
        table.add_row(
            f"{gap * 1e3:g}", f"{reductions.dt[gap]:.2f}", figure(2 * u[gap], ".2f"),
            f"{paper.REDUCTION_PERCENT[gap]:.1f}", f"{value:.2f}", figure(2 * spread[gap], ".2f"),
            f"{round(errors[gap], 1) + 0.0:+.1f}",
        )  # fmt: skip
    console.print(table)
    largest, rms = reductions.max_abs_error(), reductions.rms_error()
    close = largest <= paper.POINTS_LIMIT and rms <= paper.RMS_LIMIT
    console.print(
        f"largest difference {largest:.2f} points (limit {paper.POINTS_LIMIT}), rms {rms:.2f} (limit {paper.RMS_LIMIT})"
    )
    return close


def _print_verdicts(console: Console, verdicts: list[Verdict]) -> None:
    if all(verdict.result is None for verdict in verdicts):
        return  # the campaign has another subject
    table = TextTable(
        "The paper's statements, and how strong the evidence is",
        left=("", "statement", "verdict", "worth", "figures"),
    )
    colours = {"pass": "green", "FAIL": "red"}
    for number, verdict in enumerate(verdicts, 1):
        table.add_row(
            str(number), verdict.text, verdict.word, verdict.kind.value, verdict.detail,
            style=colours.get(verdict.word, "bright_black"),
        )  # fmt: skip
    console.print(table)


def _print_margins(console: Console, varied: list[Variation]) -> None:
    if not varied:
        return
    table = TextTable(
        "The figure of each statement on rigs that differ in one constant",
        left=("rig", *(str(number) for number in range(1, len(varied[0].verdicts) + 1))),
    )
    for one in varied:
        changed = ", ".join(f"{name.rpartition('.')[2]} {value}" for name, value in one.changed.items())
        cells = ["" if v.result is None else f"{figure(v.result.value, '.4g')} {v.word}" for v in one.verdicts]
        table.add_row(changed or "the rig itself", *cells)
    console.print(table)


def _print_quiet(console: Console, done: run.Finished) -> None:
    """Print how many points have no impacts despite a sphere, and what remains open."""
    notes = [point.note for point in done.points if point.settled and point.note]
    if notes:
        console.print(f"{len(notes)} of {len(done.points)} points: the sphere did not strike ({notes[0]})")


def _print_failed(console: Console, done: run.Finished) -> None:
    failed = done.failed()
    if not failed:
        return
    table = TextTable(
        f"{len(failed)} points without a settled measurement", left=("study", "case", "f [Hz]", "", "why")
    )
    for point in failed[:SHOWN]:
        axes = ", ".join(f"{name.rpartition('.')[2]}={value}" for name, value in point.axes.items())
        case = f"{point.label} {axes}".strip()
        table.add_row(point.study, case, f"{point.frequency_hz:g}", point.direction, point.status)
    console.print(table)


def add_report(commands: Commands) -> None:
    """Register `report`: the page of a campaign."""
    parser = subcommand(
        commands, "report", _report,
        "write the report of a campaign or a run: one HTML page, figures as PNG, SVG and PDF, numbers as JSON",
        [
            ("report runs/campaign_paper", "writes runs/campaign_paper/report.html"),
            ("report runs/demo/gap_6mm", "one run: result, uncertainty, conditions, motion"),
            ("report runs/campaign_paper --margins runs/campaign_margins", "with sensitivities to constants"),
        ],
    )  # fmt: skip
    parser.add_argument("directory", type=Path, metavar="DIR", help="directory of a campaign, or a run")
    parser.add_argument("--output", type=Path, metavar="DIR", help="directory of the page (default: DIR)")
    parser.add_argument(
        "--margins", type=Path, metavar="DIR",
        help="campaign with varied constants (config/campaigns/margins.yaml), for the statements' sensitivity",
    )  # fmt: skip
    parser.add_argument(
        "--branches", type=Path, metavar="DIR", nargs="+", default=(),
        help="directories of `impact-rig dynamics continue`, whose motions are drawn next to the measurements",
    )  # fmt: skip
    add_figures(parser, "directory of the figures (default: figures in that of the page)")
    add_rig(parser)


def _report(arguments: argparse.Namespace) -> int:
    from impact_rig_studies.report import build_report  # noqa: PLC0415  # loads SciPy, which no other command needs

    path = build_report(
        arguments.directory, arguments.output, arguments.margins, arguments.branches,
        figures=arguments.figures, formats=arguments.formats, rig=arguments.rig,
    )  # fmt: skip
    tell_program(path)
    return 0
