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
"""Tests of the command `impact-rig drive` with a sine: sweep, hold, lock and backbone."""

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from impact_rig.analysis.uncertainty_budget import plus_minus, rounded
from impact_rig.cli.quantities import positive
from impact_rig.cli.rig_options import rig_of, run_directory
from impact_rig.cli.terminal import Console, TextTable, figure, tell_results
from impact_rig.config.sections import DRIVE_UNITS
from impact_rig.driver import LocalRig, RigDriver
from impact_rig.errors import ConfigError
from impact_rig.rig.config import RigConfig, differences
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig.simtime import NS_PER_S
from impact_rig.system import files
from impact_rig_studies.campaign.job import Job
from impact_rig_studies.operate.operator import operate
from impact_rig_studies.operate.phase_lock import (
    FEWEST,
    AmplitudePoint,
    AmplitudeSweep,
    LockLoop,
    mean,
    measure_backbone,
    run_phase_lock,
    with_short_blocks,
)
from impact_rig_studies.operate.plans import Direction, Hold, HoldPlan, LockPlan
from impact_rig_studies.operate.stepped_sine import ControlledSine, SteppedSine, SweepState

HELD_UNITS: Mapping[str, str] = {Hold.BASE: "m", Hold.SUPERIOR: "m", Hold.CURRENT: "A"}
SHOWN = 12  # approximate number of rows of a phase lock that are printed; the CSV contains all


@contextlib.contextmanager
def _results(arguments: argparse.Namespace) -> Iterator[Path]:
    """Create and yield the directory of a test's results, before the test begins.

    If the test fails without a file in a new directory, the directory is removed again. ImpactRigError is raised if the
    directory is not empty, or cannot be written.
    """
    directory = run_directory(arguments.output, arguments.test)

    def prepare() -> Path:
        with files.translate_errors(f"cannot write {directory}"):
            files.make_folder(directory)
        return directory

    with files.results_in(directory, prepare):
        yield directory


def _job(arguments: argparse.Namespace) -> Job:
    config, gap_m = rig_of(arguments)
    return Job(
        changes=differences(config),
        gap_m=gap_m,
        frequencies_hz=tuple(arguments.frequencies),
        direction=Direction(arguments.direction),
        current_a=arguments.current,
        repetitions=arguments.measurements,
    )


def run_hold(arguments: argparse.Namespace) -> int:
    """Measure DT over the frequency while a controller holds an amplitude, and return the exit code.

    The amplitude is that of the coil current, or of the displacement of the inferior or superior base. The code is 1 if
    the test ended early, a frequency has no measurement (settled or not), or an amplitude is outside the tolerance;
    else 0.
    """
    unit = HELD_UNITS[arguments.what]
    try:
        target = positive(unit).number(arguments.target)
    except ConfigError as error:
        raise ConfigError(f"argument PEAK, amplitude at which {arguments.what} is held: {error}") from error
    job = _job(arguments)
    sweep = ControlledSine(job.plan(), HoldPlan(hold=arguments.what, target=target, tolerance=arguments.tolerance))
    return _measure_curve(arguments, job, sweep, f"{arguments.what} held at {target:g} {unit}")


def run_sweep(arguments: argparse.Namespace) -> int:
    """Measure DT over the frequency at constant current, and return the exit code.

    The code is 1 if the sweep ended early or a frequency has no measurement, settled or not; else 0.
    """
    job = _job(arguments)
    unit = DRIVE_UNITS[job.config().drive.kind]
    return _measure_curve(arguments, job, SteppedSine(job.plan()), f"Sweep at {job.current_a:g} {unit}")


def _measure_curve(arguments: argparse.Namespace, job: Job, sweep: SteppedSine, title: str) -> int:
    """Run a sweep over the frequency, write and print its curve, and return the exit code.

    The code is 1 if the sweep ended early, a frequency has no measurement (settled or not), or a controlled amplitude
    is outside the tolerance; else 0.
    """
    held = isinstance(sweep, ControlledSine)
    with _results(arguments) as directory:
        with _open(arguments.through, job.config(), job.labelled_settings()) as rig:
            operate(sweep, rig)
        rows = sweep.controlled if isinstance(sweep, ControlledSine) else sweep.rows
        reached = set(rows["frequency"].tolist())
        missing = [frequency for frequency in job.plan().frequencies_hz if frequency not in reached]
        ended = f"ended early: {sweep.reason}" if sweep.reason else ""
        if not ended and missing:
            ended = f"no measurement was made at {', '.join(f'{frequency:g}' for frequency in missing)} Hz"
        content = {"rows": rows, "ended_early": sweep.reason, "not_measured_hz": missing}
        _write(directory, arguments.test, rows.dtype.names or (), map(_texts, rows), content)
    table = TextTable(
        title,
        right=(
            "f [Hz]",
            "DT",
            "± 2u",
            "base [µm]",
            "superior [mm]",
            "current [A]",
            *(["error [%]"] if held else []),
        ),
        last=(*([""] if held else []), "regime"),
    )
    for row in rows:
        error = [figure(100 * row["error"], "+.2f"), "" if row["held"] else "NOT HELD"] if held else []
        table.add_row(
            f"{row['frequency']:g}",
            *rounded(row["transmissibility"], row["transmissibility_uncertainty"]),
            figure(row["base_amplitude"] * 1e6, ".2f"),
            figure(row["laser_amplitude"] * 1e3, ".3f"),
            figure(row["current_amplitude"], ".4f"),
            *error,
            row["regime"].decode(),
        )
    _tell(arguments, directory, table, ended, content)
    return 1 if ended or (held and not np.all(rows["held"] == 1.0)) else 0


def _texts(row: np.void) -> list[object]:
    return [cell.decode() if isinstance(cell, bytes) else cell for cell in row.tolist()]


def run_lock(arguments: argparse.Namespace) -> int:
    """Find a resonance by its phase, track it and measure DT there, and return the exit code.

    The code is 1 if the test ended early, or was locked too briefly for a mean with its uncertainty; else 0.
    """
    config, _ = rig_of(arguments)
    plan = LockPlan(
        start_hz=arguments.start, current_a=arguments.current, reference=arguments.reference, dwell_s=arguments.dwell
    )
    with _results(arguments) as directory:
        with _open(arguments.through, with_short_blocks(config)) as rig:
            lock = run_phase_lock(plan, LockLoop(rig))
        locked_s = None if lock.locked_ns is None else lock.locked_ns / NS_PER_S
        dwelt = lock.rows[lock.rows["time"] >= (math.inf if locked_s is None else locked_s)]
        early, missing = "" if lock.state is SweepState.FINISHED else lock.reason, ""
        if not early and len(dwelt) < FEWEST:
            missing = (
                f"locked after {locked_s:.1f} s, but {len(dwelt)} readings while locked are too few for a mean with "
                f"its uncertainty: at least {FEWEST} are needed, use --dwell {FEWEST * lock.sample_s:g} or more"
            )
        content = {"rows": lock.rows, "locked_ns": lock.locked_ns, "ended_early": early, "missing": missing}
        _write(directory, arguments.test, lock.rows.dtype.names or (), map(_texts, lock.rows), content)
    table = TextTable(
        f"Superior base against {arguments.reference}, −90° sought",
        right=("t [s]", "f [Hz]", "phase [°]", "DT", "superior [mm]", "locked"),
    )
    for row in lock.rows[:: max(1, len(lock.rows) // SHOWN)]:
        table.add_row(
            f"{row['time']:.1f}",
            f"{row['frequency']:.4f}",
            figure(math.degrees(row["phase"]), ".2f"),
            figure(row["transmissibility"], ".2f"),
            figure(row["laser_amplitude"] * 1e3, ".3f"),
            "yes" if row["locked"] else "",
        )
    if early or missing:
        _tell(arguments, directory, table, f"ended early: {early}" if early else missing, content)
        return 1
    found = mean(dwelt, lock.u_gain)
    slopes = [np.polyfit(dwelt["time"], dwelt[name], 1)[0] for name in ("frequency", "transmissibility")]
    sentence = (
        f"locked after {locked_s:.1f} s; {plus_minus(found.frequency_hz, found.u_frequency_hz)} Hz, "
        f"DT {plus_minus(found.dt, found.u_dt)} (2u); drift per minute: "
        f"{slopes[0] * 60e3:+z.2f} mHz, DT {slopes[1] * 60:+z.3f}"
    )
    _tell(arguments, directory, table, sentence, content)
    return 0


def run_backbone(arguments: argparse.Namespace) -> int:
    """Find the resonance at each of several currents, first rising, then falling; return the exit code.

    The code is 1 if the test ended early, for example because the phase does not lock at the first current; else 0.
    """
    config, gap_m = rig_of(arguments)
    currents = tuple(arguments.currents)
    if min(currents) <= 0.0:
        raise ConfigError(f"--currents must be > 0, got {min(currents):g}")
    if list(currents) != sorted(set(currents)):
        raise ConfigError(f"--currents must be strictly ascending, got {' '.join(map(str, currents))}")
    plan = LockPlan(start_hz=arguments.start, current_a=currents[0], reference=arguments.reference)
    with _results(arguments) as directory:
        with _open(arguments.through, with_short_blocks(config)) as rig:
            points, why = measure_backbone(AmplitudeSweep(currents_a=currents, lock=plan), LockLoop(rig))
        content = {"points": [attrs.asdict(one) for one in points], "ended_early": why}
        names = [field.name for field in attrs.fields(AmplitudePoint)]
        _write(directory, arguments.test, names, map(attrs.astuple, points), content)
    kind = config.drive.kind
    commanded, digits = ("I [A]", ".4f") if kind == "current" else (f"drive [{DRIVE_UNITS[kind]}]", ".4g")
    headings = ("", commanded, "f [Hz]", "± 2u", "DT", "± 2u", "superior [mm]", "g/X", "phase [°]")
    table = TextTable("Backbone", right=headings, last=("",))
    for one in points:
        words = [*(["not locked"] if not one.locked else []), *(["JUMP"] if one.jumped else [])]
        table.add_row(
            one.direction,
            figure(one.current_a, digits),
            *rounded(one.frequency_hz, one.u_frequency_hz),
            *rounded(one.dt, one.u_dt),
            figure(one.superior_m * 1e3, ".3f"),
            f"{gap_m / one.superior_m:.2f}" if gap_m != NO_SPHERE else "-",
            figure(one.phase_deg, ".2f"),
            ", ".join(words),
        )
    _tell(arguments, directory, table, f"ended early: {why}" if why else "", content)
    return 1 if why else 0


def _open(way: str, config: RigConfig, analysis: Mapping[str, Any] | None = None) -> RigDriver:
    """Create a new rig: in this process if `way` is `process`, else as ROS nodes in lockstep.

    `analysis` are the parameters of its analysis; None means no analysis.
    """
    if way == "process":
        return LocalRig(config, analysis=analysis)
    from impact_rig.driver.ros_rig import RosRig  # noqa: PLC0415  # needs rclpy

    return RosRig(config, analysis=analysis)


def _write(
    directory: Path, test: str, names: Sequence[str], rows: Iterable[Sequence[object]], content: Mapping[str, object]
) -> None:
    """Write the results of a test: the rows with the columns `names` as CSV, `content` as JSON."""
    files.write_csv(directory / f"{test}.csv", names, rows)
    files.write_json(directory / f"{test}.json", content)


def _tell(
    arguments: argparse.Namespace, directory: Path, table: TextTable, sentence: str, content: Mapping[str, object]
) -> None:
    """Print table, sentence and directory of a test's results; with `--json` only `content` and directory, as JSON."""
    console = Console(quiet=arguments.json)
    console.print(table)
    if sentence:
        console.print(sentence)
    tell_results(directory, content, as_json=arguments.json)
