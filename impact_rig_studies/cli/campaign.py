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
"""Commands `impact-rig campaign` and `report`: measurement and judgement of a campaign, and its report."""

from __future__ import annotations

import argparse
import contextlib
import time

from impact_rig.analysis.uncertainty_budget import rounded
from impact_rig.cli.terminal import Console, Counted, TextTable, figure, tell_program, tell_results
from impact_rig.errors import ConfigError
from impact_rig.system import files
from impact_rig_studies.campaign import paper, run
from impact_rig_studies.campaign.job import Job, execute
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.campaign.statements import Variation, Verdict, variations
from impact_rig_studies.campaign.store import Store
from impact_rig_studies.campaign.tasks import measure
from impact_rig_studies.cli import tasks

WAYS = ("process", "ros", "dask")
SHOWN = 20  # largest number of failed points that are printed; points.csv contains all


def run_campaign(arguments: argparse.Namespace) -> int:
    """Measure the missing jobs of a campaign file, write and print all results, and return the exit code.

    With `--check`, the code is 1 if a point failed, a statement failed, or the reductions differ from the paper's by
    more than `paper.POINTS_LIMIT` or `paper.RMS_LIMIT`. Statements that cannot be judged do not count. Otherwise the
    code is 0.
    """
    file, directory, way, address = tasks.words(arguments, "campaign", "campaign config/paper.yaml", WAYS)
    overrides = {"daq.seed": arguments.seed, "daq.rate_hz": arguments.scan_rate}
    campaign = load_campaign(file, {name: value for name, value in overrides.items() if value is not None})
    chosen = campaign.only(tuple(arguments.only)) if arguments.only else campaign
    if arguments.record and way != "ros":
        raise ConfigError("--record needs --through ros, because it records the messages of ROS nodes")
    console = Console(quiet=arguments.json)
    started = time.monotonic()
    jobs = run.unique_jobs(chosen.planned())
    if way == "ros":
        from impact_rig_studies.ros_campaign import ros_runner  # noqa: PLC0415  # needs rclpy

        runner = ros_runner(directory, directory / "runs" if arguments.record else None)
    else:
        runner = tasks.runner(execute, address, arguments.workers)
    with files.results_in(directory, lambda: run.prepare(campaign, directory, way)) as store:
        _measure(jobs, store, runner)
    for what in store.damaged:
        console.print(f"{what}; it was measured again", style="yellow")
    done = run.finished(campaign, directory)  # with what is stored of other studies: the results of a part never shrink
    old = sum(job.key in done.outcomes and store.get(job) is None for job in run.unique_jobs(campaign.planned()))
    if old:
        console.print(
            f"{old} runs of other studies were measured with other code, or lack the time trace that the report draws; "
            "without --only, they are measured again",
            style="yellow",
        )
    summary = run.write_results(done, time.monotonic() - started)
    verdicts = done.verdicts()
    close = _print_reductions(console, done)
    _print_verdicts(console, verdicts)
    _print_margins(console, variations(done.points))
    _print_failed(console, done)
    _print_quiet(console, done)
    console.print(f"{len(done.points)} points; results for programs: {run.CSV_FILE}, summary.json")
    tell_results(directory, {**summary, **_content(done)}, as_json=arguments.json)
    sound = close and not done.failed() and all(verdict.word != "FAIL" for verdict in verdicts)
    return 1 if arguments.check and not sound else 0


def _content(done: run.Finished) -> dict[str, object]:
    """Return verdicts, failed points, and the deciding value of each statement on every rig, as data for JSON.

    A point has failed if a measurement is missing or did not settle.
    """
    return {
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
                "study": point.study,
                "case": point.label,
                "axes": dict(point.axes),
                "frequency_hz": point.frequency_hz,
                "direction": point.direction,
                "why": point.status,
            }
            for point in done.failed()
        ],
    }


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
    """Print the measured reductions next to the paper's, and return whether they are within the limits.

    The limits are `paper.POINTS_LIMIT` and `paper.RMS_LIMIT`. Without measured reductions, nothing is printed, and the
    result is true.
    """
    reductions = done.reductions()
    if not reductions.percent():
        return True
    ours, spread, errors = reductions.percent(), reductions.percent_uncertainty, reductions.errors()
    table = TextTable(
        f"Reduction of DT at {paper.FREQUENCY_HZ} Hz against no sphere (fitted, not predicted)",
        right=("gap [mm]", "DT", "± 2u", "paper [%]", "ours [%]", "± 2u", "difference"),
    )
    u = reductions.dt_uncertainty
    table.add_row("none", *rounded(reductions.dt_no_sphere, u[0.0]), "", "", "", "", end_section=True)
    for gap, value in sorted(ours.items()):
        table.add_row(
            f"{gap * 1e3:g}",
            *rounded(reductions.dt[gap], u[gap]),
            f"{paper.REDUCTION_PERCENT[gap]:.1f}",
            *rounded(value, spread[gap]),
            figure(errors[gap], "+.1f"),
        )
    console.print(table)
    largest, rms = reductions.max_abs_error(), reductions.rms_error()
    close = largest <= paper.POINTS_LIMIT and rms <= paper.RMS_LIMIT
    console.print(
        f"difference from the paper: largest {largest:.2f} points (limit {paper.POINTS_LIMIT}), rms {rms:.2f} (limit "
        f"{paper.RMS_LIMIT})"
    )
    return close


def _print_verdicts(console: Console, verdicts: list[Verdict]) -> None:
    if all(verdict.result is None for verdict in verdicts):
        return  # the campaign has another subject
    table = TextTable(
        "The paper's statements, and how strong the evidence is", left=("", "statement", "verdict", "worth", "figures")
    )
    colours = {"pass": "green", "FAIL": "red"}
    for number, verdict in enumerate(verdicts, 1):
        table.add_row(
            str(number),
            verdict.text,
            verdict.word,
            verdict.kind.value,
            verdict.detail,
            style=colours.get(verdict.word, "bright_black"),
        )
    console.print(table)


def _print_margins(console: Console, varied: list[Variation]) -> None:
    if not varied:
        return
    table = TextTable(
        "Deciding value of each statement on rigs that differ in one constant",
        left=("rig", *(str(number) for number in range(1, len(varied[0].verdicts) + 1))),
    )
    for one in varied:
        changed = ", ".join(f"{name.rpartition('.')[2]} {value}" for name, value in one.changed.items())
        cells = ["" if v.result is None else f"{figure(v.result.value, '.4g')} {v.word}" for v in one.verdicts]
        table.add_row(changed or "the rig itself", *cells)
    console.print(table)


def _print_quiet(console: Console, done: run.Finished) -> None:
    """Print at how many settled points the sphere did not strike, with the remark on the first (`Point.note`)."""
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


def run_report(arguments: argparse.Namespace) -> int:
    """Write the report of a campaign or run, print the path of the page, and return the exit code, 0."""
    from impact_rig_studies.report import build_report  # noqa: PLC0415  # loads SciPy, which no other command needs

    path = build_report(
        arguments.directory, arguments.output, arguments.margins, arguments.branches,
        figures=arguments.figures, formats=arguments.formats, rig=arguments.rig,
    )  # fmt: skip
    tell_program(path)
    return 0
