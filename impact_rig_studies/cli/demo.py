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
"""Command `impact-rig demo`: measurement of the paper's five reductions with three ROS processes."""

from __future__ import annotations

import argparse
import contextlib
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.progress import BarColumn, Progress, TaskID, TimeElapsedColumn

from impact_rig import topics
from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.uncertainty_budget import rounded
from impact_rig.cli.rig_options import run_directory
from impact_rig.cli.terminal import Console, Steps, TextTable, Words, figure, tell_results
from impact_rig.errors import ImpactRigError
from impact_rig.recording import open_run
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.gaps import NO_SPHERE, case_of, gap_values
from impact_rig.rig.journal import not_default
from impact_rig.runs import RunInfo, info
from impact_rig.simtime import NS_PER_S
from impact_rig.system import files
from impact_rig_studies.campaign import paper
from impact_rig_studies.campaign.job import Job
from impact_rig_studies.campaign.paper import DEMO_POINTS_LIMIT, Reductions
from impact_rig_studies.campaign.results import Statement, write_summary
from impact_rig_studies.operate.stepped_sine import SteppedSine
from impact_rig_studies.report.dt import draw_reductions

MEASUREMENTS = 2
"""Number of settled measurements per gap; each takes 5 s of rig time, or 21 s if the response is not periodic."""
LINEAR_LIMIT = 0.02  # largest relative difference of DT without the sphere from the closed form


RUNS = {NO_SPHERE: "no_sphere", **{gap_m: f"gap_{gap_m * 1e3:g}mm" for gap_m in paper.REDUCTION_PERCENT}}
"""Gap [m] -> name of the directory into which its measurement is recorded."""


def run_demo(arguments: argparse.Namespace) -> int:
    """Run the demo and return the exit code: 0 if all its checks hold.

    The checks are: every reduction differs from the paper's by at most 3 percentage points, the reductions grow with
    the gap, DT without the sphere agrees with the closed form within 2 %, and no block of scans was lost.
    """
    console = Console(quiet=arguments.json)
    directory = _new_directory(arguments.output)
    config = from_flat(RigConfig(), {"daq.rate_hz": arguments.scan_rate, "daq.seed": arguments.seed})
    console.print(
        f"impact_rig demo: rig, analysis and recorder as three processes in lockstep, {arguments.scan_rate} scans/s"
    )
    started = time.monotonic()
    rows = _measure(config, directory)
    wall_s = time.monotonic() - started

    from impact_rig.physics.linear_response import transmissibility  # noqa: PLC0415  # compiles nothing, but loads SciPy

    runs = [info(directory / name) for name in RUNS.values()]
    lost = sum(_lost_blocks(run) for run in runs)
    simulated_s = sum(_scanned_s(run) for run in runs)
    with open_run(directory / RUNS[NO_SPHERE]) as recorded:
        calibration = Calibration.from_info(next(recorded.tables(topics.INFO.name)).rows)  # the certificate, published
    reductions = Reductions.of(rows, calibration)
    closed_form = float(abs(transmissibility(config, paper.FREQUENCY_HZ)))
    statements = {
        "dt_no_sphere_agrees_with_closed_form": _judge(abs(reductions.dt_no_sphere / closed_form - 1.0), LINEAR_LIMIT),
        "reductions_within_3_points": _judge(reductions.max_abs_error(), DEMO_POINTS_LIMIT),
        "reduction_grows_with_gap": Statement(reductions.grows_with_gap(), float(reductions.grows_with_gap()), 1.0),
        "no_block_lost": _judge(float(lost), 0.0),
    }
    draw_reductions(reductions, directory / "reductions.png")
    summary = write_summary(
        directory,
        reductions,
        statements,
        lost_blocks=lost,
        wall_s=wall_s,
        simulated_s=simulated_s,
        seed=config.daq.seed,
        more={"dt_no_sphere_closed_form": closed_form},
    )
    _print_table(console, reductions, closed_form)
    console.print(f"{simulated_s:.0f} s of rig time in {wall_s:.0f} s, {lost} blocks lost.")
    failed = [name for name, statement in statements.items() if not statement.passed]
    if failed:
        console.print(f"these checks failed: {', '.join(failed)}", style="red")
    console.print(f"figure: reductions.png; results for programs: summary.json; runs: {', '.join(RUNS.values())}")
    tell_results(directory, {"runs": list(RUNS.values()), **summary}, as_json=arguments.json)
    return 1 if failed else 0


def _measure(config: RigConfig, directory: Path) -> dict[float, NDArray[np.void]]:
    """Measure DT without the sphere and at the paper's gaps, and return the measurements by gap [m].

    The key `NO_SPHERE` means without the sphere. Each gap is recorded as one run in `directory`, named as in `RUNS`.
    ImpactRigError is raised if a gap could not be measured.
    """
    from impact_rig_studies.ros_campaign import ros_runner  # noqa: PLC0415  # needs rclpy

    rows: dict[float, NDArray[np.void]] = {}
    with Screen() as screen:
        runner = ros_runner(directory, directory, lambda job: RUNS[job.gap_m], screen.show)
        with contextlib.closing(runner([_job(config, gap_m) for gap_m in RUNS])) as done:
            for job, outcome in done:
                if outcome.failure:
                    raise ImpactRigError(
                        f"{case_of(job.gap_m)}: {outcome.failure}: remove the cause, then repeat the demo "
                        "with another --output"
                    )
                rows[job.gap_m] = outcome.rows
        screen.done()
    return rows


def _job(config: RigConfig, gap_m: float) -> Job:
    return Job(
        changes=not_default(from_flat(config, gap_values(gap_m))),
        gap_m=gap_m,
        frequencies_hz=(paper.FREQUENCY_HZ,),
        current_a=paper.CURRENT_A,
        repetitions=MEASUREMENTS,
    )


class Screen:
    """Progress display of the demo: a bar per gap on a terminal, otherwise lines of text, one per measurement."""

    def __init__(self) -> None:
        console = Console(stderr=True)
        self._plain = not console.is_terminal
        words, state = Words("{task.description:<12}"), Words("{task.fields[state]:<36}")
        columns = (words, BarColumn(24), state, TimeElapsedColumn())
        self._progress = Progress(*columns, console=console, disable=self._plain)
        self._starting = self._progress.add_task("processes", total=None, state="starting")
        self._tasks: dict[float, TaskID] = {}
        self._lines: dict[float, Steps] = {}

    def __enter__(self) -> Screen:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def show(self, job: Job, sweep: SteppedSine | None) -> None:
        """Show the progress of the measurement of one gap; `sweep` is None before its rig is prepared."""
        if sweep is None:
            self._progress.update(self._starting, total=1, completed=1, state="running")
            label = case_of(job.gap_m)
            self._tasks[job.gap_m] = self._progress.add_task(label, total=MEASUREMENTS, state="preparing")
            self._lines[job.gap_m] = Steps(label, MEASUREMENTS)
            if self._plain:
                self._lines[job.gap_m].show(0, "preparing")
            return
        rows = sweep.rows
        state = f"DT {rows['transmissibility'][-1]:.2f}" if len(rows) else "settling"
        self._progress.update(self._tasks[job.gap_m], completed=len(rows), state=state)
        if self._plain and len(rows):
            self._lines[job.gap_m].show(len(rows), state)

    def done(self) -> None:
        """Show that all gaps are measured."""
        self._progress.update(self._starting, state="done")


def _judge(value: float, limit: float) -> Statement:
    return Statement(value <= limit, value, limit)


def _lost_blocks(run: RunInfo) -> int:
    if run.scans is None:
        raise ImpactRigError(f"{run.path} contains no scans (topic daq/scan): repeat the demo with another --output")
    return run.scans.lost_blocks


def _scanned_s(run: RunInfo) -> float:
    scan = next(topic for topic in run.topics if topic.name.endswith(topics.SCAN.name))
    return (scan.last_ns - scan.first_ns) / NS_PER_S


def _new_directory(wanted: Path | None) -> Path:
    directory = run_directory(wanted, "demo")
    with files.translate_errors(f"cannot create {directory}"):
        files.make_folder(directory)
    return directory


def _print_table(console: Console, reductions: Reductions, closed_form: float) -> None:
    ours, spread, errors = reductions.percent(), reductions.percent_uncertainty, reductions.errors()
    table = TextTable(
        f"Reduction of DT at {paper.FREQUENCY_HZ} Hz against no sphere",
        right=("gap [mm]", "DT", "this run [%]", "± 2u", "paper [%]", "difference"),
    )
    table.add_row(
        "none", f"{reductions.dt_no_sphere:.2f}", "", "", "", f"closed form {closed_form:.2f}", end_section=True
    )
    for gap, value in sorted(ours.items()):
        table.add_row(
            f"{gap * 1e3:g}",
            figure(reductions.dt[gap], ".2f"),
            *rounded(value, spread[gap]),
            f"{paper.REDUCTION_PERCENT[gap]:.1f}",
            figure(errors[gap], "+.1f"),
        )
    console.print(table)
    largest, rms = reductions.max_abs_error(), reductions.rms_error()
    console.print(f"difference from the paper: largest {largest:.1f} points, rms {rms:.1f} points")
