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
"""`impact-rig loop`: hold an amplitude, lock on a resonance, follow a backbone; with a stream see `excite`."""

from __future__ import annotations

import argparse
import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.cli.quantities import positive
from impact_rig.cli.rig_options import add_rig, rig_of
from impact_rig.cli.terminal import Console, TextTable, add_json, figure, subcommand, tell_json
from impact_rig.driver import LocalRig, RigDriver
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.names import csv_cell
from impact_rig.rig.config import RigConfig, differences
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig.simtime import NS_PER_S
from impact_rig.system import files
from impact_rig_studies.campaign.job import Job
from impact_rig_studies.campaign.paper import CURRENT_A, FREQUENCIES_HZ
from impact_rig_studies.cli.excite import add_kinds
from impact_rig_studies.closed_loop import hold, with_short_blocks
from impact_rig_studies.operate.phase_lock import (
    FEWEST,
    Ladder,
    LockLoop,
    LockPlan,
    Reference,
    Rung,
    climb,
    lock_on,
    mean,
)
from impact_rig_studies.operate.stepped_sine import Direction, Hold, HoldPlan, SweepState

HELD_UNITS = {Hold.BASE: "m", Hold.SUPERIOR: "m", Hold.CURRENT: "A"}
SHOWN = 12  # looks of a lock that are printed; all of them are in the CSV


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "loop", _run,
        "closed-loop tests: hold an amplitude, lock a resonance, control random, replicate, shock",
        [
            ("loop hold base 60um --frequencies 8.8 9.1 9.4", "the base at 60 µm, at three frequencies"),
            ("loop lock --gap none", "search the resonance without a sphere, and stay there"),
            ("loop backbone --currents 0.1 0.2 0.4", "resonance over amplitude, up and down"),
            ("loop random --gap none", "a density of the base's acceleration, 5 to 200 Hz"),
            ("loop replicate road.csv --signal base --unit mm", "the base follows a history"),
            ("loop shock", "the base makes a half sine of 20 m/s², 11 ms"),
        ],
    )  # fmt: skip
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    holding = kinds.add_parser("hold", help="step the frequency with an amplitude held")
    holding.add_argument("what", choices=[*Hold], help="quantity whose amplitude is held")
    holding.add_argument("target", help="peak amplitude with its unit, e.g. 60um, or 0.5A for the current")
    holding.add_argument("--frequencies", type=float, nargs="+", default=FREQUENCIES_HZ, metavar="HZ")
    holding.add_argument("--direction", choices=[*Direction], default=Direction.UP)
    holding.add_argument("--tolerance", type=float, default=2e-3, help="relative error that counts as held")
    holding.add_argument("--measurements", type=int, default=1, metavar="N", help="per point")
    locking = kinds.add_parser("lock", help="search a resonance, track it, dwell there")
    locking.add_argument("--dwell", type=float, default=30.0, metavar="S", help="rig time locked")
    climbing = kinds.add_parser("backbone", help="lock, and step the current up and down")
    climbing.add_argument("--currents", type=float, nargs="+", required=True, metavar="A", help="ascending")
    for one in (holding, locking, climbing):
        one.add_argument(
            "--through", choices=("process", "ros"), default="process", help="a rig in this process, or behind topics"
        )
    for one in (locking, climbing):
        one.add_argument("--start", type=float, default=9.0, metavar="HZ", help="where the search begins")
        one.add_argument("--reference", choices=[*Reference], default=Reference.BASE)
    for one in (holding, locking):
        one.add_argument("--current", type=float, default=CURRENT_A, metavar="A", help="peak; to begin with, for hold")
    for one in (holding, locking, climbing):
        add_rig(one)
        add_json(one)
        one.add_argument("--output", type=Path, metavar="FILE", help="write everything as CSV; never over a file")
    add_kinds(kinds)


def _run(arguments: argparse.Namespace) -> int:
    config, gap = rig_of(arguments)
    if arguments.kind == "hold":
        try:
            arguments.target = positive(HELD_UNITS[Hold(arguments.what)]).number(arguments.target)
        except ConfigError as error:
            raise ConfigError(f"target of {arguments.what}: {error}") from error
    if arguments.output is not None and os.path.lexists(arguments.output):
        raise RecordingError(f"{arguments.output} exists already and is not overwritten")
    if arguments.output is not None:  # what cannot be written is told before anything is measured
        with files.errors_as(f"cannot write {arguments.output}"):
            arguments.output.parent.mkdir(parents=True, exist_ok=True)
    console = Console(quiet=arguments.json)
    return {"hold": _hold, "lock": _lock, "backbone": _backbone}[arguments.kind](arguments, config, gap, console)


def _hold(arguments: argparse.Namespace, config: RigConfig, gap: float, console: Console) -> int:
    job = Job(
        changes=differences(config),
        gap_m=gap,
        frequencies_hz=tuple(arguments.frequencies),
        direction=Direction(arguments.direction),
        current_a=arguments.current,
        repetitions=arguments.measurements,
    )
    plan = HoldPlan(hold=arguments.what, target=arguments.target, tolerance=arguments.tolerance)
    with _open(arguments.through, job.config(), job.labelled_settings()) as rig:
        found = hold(job, plan, rig)
    table = TextTable(
        f"{arguments.what} held at {arguments.target:g} {HELD_UNITS[Hold(arguments.what)]}",
        right=("f [Hz]", "DT", "± 2u", "base [µm]", "superior [mm]", "current [A]", "error [%]", "", "regime"),
    )
    for row in found.rows:
        table.add_row(
            f"{row['frequency']:g}", figure(row["transmissibility"], ".3f"),
            figure(2 * row["transmissibility_uncertainty"], ".3f"), figure(row["base_amplitude"] * 1e6, ".2f"),
            figure(row["laser_amplitude"] * 1e3, ".3f"), figure(row["current_amplitude"], ".4f"),
            figure(100 * row["error"], "+.2f"), "" if row["held"] else "NOT HELD",
            row["regime"].decode(),
        )  # fmt: skip
    console.print(table)
    _write(arguments.output, found.rows)
    reached = set(found.rows["frequency"].tolist())
    missing = [frequency for frequency in job.plan().frequencies_hz if frequency not in reached]
    if arguments.json:
        tell_json({"rows": found.rows, "ended_early": found.failure, "not_measured_hz": missing})
    if found.failure:
        console.print(f"ended early: {found.failure}")
    elif missing:
        console.print(f"no measurement was made at {', '.join(f'{frequency:g}' for frequency in missing)} Hz")
    return 1 if found.failure or missing or not np.all(found.rows["held"] == 1.0) else 0


def _lock(arguments: argparse.Namespace, config: RigConfig, _gap: float, console: Console) -> int:
    plan = LockPlan(
        start_hz=arguments.start, current_a=arguments.current, reference=arguments.reference, dwell_s=arguments.dwell
    )
    with _open(arguments.through, with_short_blocks(config)) as rig:
        lock = lock_on(plan, LockLoop(rig))
    table = TextTable(
        f"Superior base against {arguments.reference}, −90° sought",
        right=("t [s]", "f [Hz]", "phase [°]", "DT", "superior [mm]", "locked"),
    )
    for row in lock.rows[:: max(1, len(lock.rows) // SHOWN)]:
        table.add_row(
            f"{row['time']:.1f}", f"{row['frequency']:.4f}", figure(math.degrees(row["phase"]), ".2f"),
            figure(row["transmissibility"], ".2f"), figure(row["laser_amplitude"] * 1e3, ".3f"),
            "yes" if row["locked"] else "",
        )  # fmt: skip
    console.print(table)
    _write(arguments.output, lock.rows)
    locked_s = None if lock.locked_ns is None else lock.locked_ns / NS_PER_S
    dwelt = lock.rows[lock.rows["time"] >= (math.inf if locked_s is None else locked_s)]
    early, missing = "" if lock.state is SweepState.FINISHED else lock.reason, ""
    if not early and len(dwelt) < FEWEST:
        missing = (
            f"locked after {locked_s:.1f} s, but {len(dwelt)} readings while locked are too few for a mean with its "
            f"uncertainty: at least {FEWEST} are needed, use --dwell {FEWEST * lock.look_s:g} or more"
        )
    if arguments.json:
        tell_json({"rows": lock.rows, "locked_ns": lock.locked_ns, "ended_early": early, "missing": missing})
    if early or missing:
        console.print(f"ended early: {early}" if early else missing)
        return 1
    found = mean(dwelt, lock.u_gain)
    slopes = [np.polyfit(dwelt["time"], dwelt[name], 1)[0] for name in ("frequency", "transmissibility")]
    console.print(
        f"locked after {locked_s:.1f} s; {found.frequency_hz:.5f} ± "
        f"{2 * found.u_frequency_hz:.1g} Hz, DT {found.dt:.2f} ± {2 * found.u_dt:.2g} (2u); drift a minute: "
        f"{slopes[0] * 60e3:+.2f} mHz, DT {slopes[1] * 60:+.3f}"
    )
    return 0


def _backbone(arguments: argparse.Namespace, config: RigConfig, gap: float, console: Console) -> int:
    currents = tuple(arguments.currents)
    if list(currents) != sorted(set(currents)) or currents[0] <= 0.0:
        raise ConfigError(f"--currents must be > 0 and ascending, got {' '.join(map(str, currents))}")
    plan = LockPlan(start_hz=arguments.start, current_a=currents[0], reference=arguments.reference)
    with _open(arguments.through, with_short_blocks(config)) as rig:
        rungs, why = climb(Ladder(currents_a=currents, lock=plan), LockLoop(rig))
    headings = ("", "I [A]", "f [Hz]", "± 2u", "DT", "± 2u", "superior [mm]", "g/X", "phase [°]", "")
    table = TextTable("Backbone", right=headings)
    for one in rungs:
        words = [*(["not locked"] if not one.locked else []), *(["JUMP"] if one.jumped else [])]
        table.add_row(
            one.direction, f"{one.current_a:.4f}", figure(one.frequency_hz, ".4f"),
            figure(2 * one.u_frequency_hz, ".1g"), figure(one.dt, ".2f"), figure(2 * one.u_dt, ".2g"),
            figure(one.superior_m * 1e3, ".3f"), f"{gap / one.superior_m:.2f}" if gap != NO_SPHERE else "-",
            figure(one.phase_deg, ".2f"), ", ".join(words),
        )  # fmt: skip
    console.print(table)
    _write(arguments.output, rungs)
    if arguments.json:
        tell_json({"rungs": [attrs.asdict(one) for one in rungs], "ended_early": why})
    if why:
        console.print(f"ended early: {why}")
    return 1 if why else 0


def _open(way: str, config: RigConfig, analysis: Mapping[str, Any] | None = None) -> RigDriver:
    """Return a rig in this process or, in lockstep, behind topics."""
    if way == "process":
        return LocalRig(config, analysis=analysis)
    from impact_rig.driver.ros_rig import RosRig  # noqa: PLC0415  # needs rclpy

    return RosRig(config, analysis=analysis)


def _write(path: Path | None, rows: NDArray[np.void] | Sequence[Rung]) -> None:
    if path is None:
        return
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    if isinstance(rows, np.ndarray):
        writer.writerow(rows.dtype.names or ())
        writer.writerows([csv_cell(x.decode()) if isinstance(x, bytes) else x for x in row.tolist()] for row in rows)
    else:
        writer.writerow([field.name for field in attrs.fields(Rung)])
        writer.writerows(map(csv_cell, attrs.astuple(one)) for one in rows)
    with files.errors_as(f"cannot write {path}"), files.written_whole(path, replace=False) as file:
        file.write(text.getvalue().encode())
