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
"""Command `impact-rig record`: records one run at one frequency and current, and measures its transmissibility."""

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.cli.options import RUNNING, running_namespace
from impact_rig.cli.parsers import CURRENT_A, FREQUENCY_HZ
from impact_rig.cli.rig_options import open_rig, refuse_for_running, rig_of, run_directory
from impact_rig.cli.terminal import Console, Counted, TextTable, counted, figure, tell_results
from impact_rig.errors import CommandError, ConfigError, ImpactRigError
from impact_rig.recording import open_run
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.gaps import NO_SPHERE, case_of
from impact_rig.states import Status
from impact_rig.system.endings import defer_signals

if TYPE_CHECKING:
    from impact_rig.analysis.uncertainty_budget import Budget

SCANS_TIMEOUT_S = 30.0  # largest wall time of a rig for one block of scans
NEGLIGIBLE = 1e-6  # share of the variance below which a line of the budget is not printed


def run_record(arguments: argparse.Namespace) -> int:
    """Run `impact-rig record`: record a run, and print its DT (displacement transmissibility) and its directory.

    Return exit code 1 if the run ended early or DT was not measured, else 0.

    Raises:
        KeyboardInterrupt: the run was interrupted. The results so far have been printed.
        ImpactRigError: the options are invalid, nothing was recorded, or the rig is gone or cannot continue. No DT was
            printed. The directory of an incomplete recording was printed to stderr.
    """
    namespace = running_namespace(arguments)
    config, gap_m = _config(arguments)
    directory = run_directory(arguments.output, "record")
    console = Console(quiet=arguments.json)
    done_s, early, interrupted = 0.0, "", None
    what = f"the rig in {namespace}" if namespace else case_of(gap_m)
    with contextlib.ExitStack() as ending:  # a second signal does not interrupt the work after the run
        with Counted(Console(stderr=True), "seconds", math.ceil(arguments.seconds)) as shown:
            try:
                with contextlib.closing(_drive(arguments, config, gap_m, directory)) as passed:
                    for done_s, state in passed:
                        shown.show(math.floor(min(done_s, arguments.seconds)), f"{what}, {state}" if state else what)
            except CommandError as error:
                early = str(error)
            except KeyboardInterrupt as error:
                early, interrupted = "interrupted", error
            except ImpactRigError:
                if directory.is_dir() and any(directory.iterdir()):
                    shown.console.print(f"incomplete recording: {directory}", style="red", soft_wrap=True)
                raise
            ending.enter_context(defer_signals())
            shown.end = early or "done"
        if not directory.exists():
            raise interrupted or ImpactRigError(early)
        found = _measured(directory)
        missing = _why_nothing(found, done_s, early) if found.budget is None else ""
        if found.budget is not None:
            _print(console, found, found.budget)
        for line in [missing, f"ended early: {early}" if early else ""]:
            if line:
                console.print(line, style="red")
        content = {"ended_early": early, "missing": missing, **_content(found)}
        tell_results(directory, content, as_json=arguments.json)
        if interrupted:
            raise interrupted
    return 1 if early or missing else 0


def _config(arguments: argparse.Namespace) -> tuple[RigConfig, float]:
    """Return the configuration of the rig to start, and its gap [m] (0 without a sphere).

    A frequency or current that is not given is set to its default in `arguments`. For a running rig, `arguments` stays
    unchanged, and the returned values have no meaning.

    Raises:
        ConfigError: the file or an option is invalid, an option does not apply to a running rig, or the drive of the
            configuration is not a sine of current.
        CommandError: frequency or current is outside the limits of the rig to start.
    """
    if arguments.through == RUNNING:
        refuse_for_running(arguments, "config", "gap", "sphere_start", "seed", "scan_rate")
        return RigConfig(), NO_SPHERE
    config, gap_m = rig_of(arguments)
    rate_hz = arguments.scan_rate
    rate = {} if rate_hz is None else {"daq.rate_hz": rate_hz, "daq.block_scans": rate_hz // 100 or 1}
    seed = {} if arguments.seed is None else {"daq.seed": arguments.seed}
    config = from_flat(config, {**rate, **seed})
    drive = config.drive
    for key, present, needed in (("drive.kind", drive.kind, "current"), ("drive.waveform", drive.waveform, "sine")):
        if present != needed:
            raise ConfigError(
                f"{arguments.config}: {key} must be {needed}, because this command drives the rig with a sine current, "
                f"got {present}"
            )
    arguments.frequency = FREQUENCY_HZ if arguments.frequency is None else arguments.frequency
    arguments.current = CURRENT_A if arguments.current is None else arguments.current
    Rig(config).accept(frequency_hz=arguments.frequency, amplitude=arguments.current)  # before any file is created
    return config, gap_m


Passed = Generator[tuple[float, str], None, None]
"""Progress of a recording: rig time so far [s], and the newest DT or the reason for waiting as text, else empty."""


def _drive(arguments: argparse.Namespace, config: RigConfig, gap_m: float, directory: Path) -> Passed:
    running = arguments.through == RUNNING
    driven = arguments.frequency is not None or arguments.current is not None
    required = {"drive.waveform": "sine"} if driven else {}
    with open_rig(arguments, config, directory, required, {"gap_m": gap_m}) as rig:
        try:
            if driven:
                rig.command(arguments.frequency, arguments.current)
            rig.clear()
            began_s, done_s, dt = rig.time_s, 0.0, ""
            while done_s < arguments.seconds:
                rig.step(timeout_s=SCANS_TIMEOUT_S)
                for table in [] if running else rig.tables(topics.TRANSMISSIBILITY_TABLE.name):
                    dt = figure(table.rows["transmissibility"][-1], ".2f", "")
                rig.clear()
                if rig.stopped:
                    raise CommandError(rig.stopped)
                done_s = rig.time_s - began_s
                yield done_s, rig.waiting or (f"DT {dt}" if dt else "")
        finally:
            if running and arguments.current is not None and not rig.stopped:
                with defer_signals():  # the shaker must not stay driven because the user is in a hurry
                    rig.command(current_a=0.0)


@attrs.frozen(eq=False)
class RunMeasurements:
    """Measurements of a recorded run, found by a new analysis of the recording.

    Attributes:
        everything: all rows of `transmissibility/table`.
        rows: the settled rows with an uncertainty of DT, at the frequency and gap of the last such row. It is empty
            without such rows.
        budget: mean DT of `rows` with its uncertainty; None without rows.
    """

    everything: NDArray[np.void]
    rows: NDArray[np.void]
    budget: Budget | None


def _measured(directory: Path) -> RunMeasurements:
    from impact_rig.analysis.calibration import Calibration  # noqa: PLC0415  # as above
    from impact_rig.analysis.uncertainty_budget import budget  # noqa: PLC0415
    from impact_rig.runs import reanalysis  # noqa: PLC0415
    from impact_rig.runs.excerpts import calibration_rows  # noqa: PLC0415

    with open_run(directory) as run:
        rows = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(run)))
        settled = rows[(rows["settled"] == 1.0) & np.isfinite(rows["transmissibility_uncertainty"])]
        if len(settled):
            last = settled[-1]
            same_gap = (settled["gap"] == last["gap"]) | (np.isnan(settled["gap"]) & np.isnan(last["gap"]))
            settled = settled[(settled["frequency"] == last["frequency"]) & same_gap]
        calibration = Calibration.from_info(calibration_rows(run))
    return RunMeasurements(rows, settled, budget(settled, calibration) if len(settled) else None)


def _why_nothing(found: RunMeasurements, seconds: float, early: str) -> str:
    """Return why a run has no DT, as text.

    Args:
        found: measurements of the run, without a `budget`.
        seconds: length of the run in rig time [s].
        early: reason why the run ended early; empty if it has its full length.
    """
    statuses = found.everything["status"].tolist()
    if not statuses:
        remedy = "" if early else "; use a longer --seconds"
        return f"no DT: {seconds:.3g} s are too short for one measurement{remedy}"
    last = Status(statuses[-1].decode())
    return f"no DT: none of {len(statuses)} measurements is settled: {counted(statuses)}; {last}: {last.doc}"


def _print(console: Console, found: RunMeasurements, whole: Budget) -> None:
    from impact_rig.analysis.transmissibility import note_on  # noqa: PLC0415  # as above
    from impact_rig.analysis.uncertainty_budget import plus_minus  # noqa: PLC0415

    relative = whole.u_transmissibility / whole.transmissibility
    table = TextTable(
        f"Uncertainty budget of DT, mean of {len(found.rows)} settled measurements",
        left=("source", "error", "type"),
        right=("u/DT [%]", "u(DT)", "share [%]"),
    )
    for part in whole.parts:
        if whole.share(part) < NEGLIGIBLE:
            continue
        table.add_row(
            part.source,
            part.what,
            part.evaluation,
            figure(100.0 * part.u_relative, ".2g"),
            figure(part.u_relative * whole.transmissibility, ".2g"),
            figure(100.0 * whole.share(part), ".1f"),
        )
    table.add_row("combined", "", "", f"{100.0 * relative:.2g}", f"{whole.u_transmissibility:.2g}", "100")
    console.print(table)
    last = found.rows[-1]
    console.print(
        f"DT {plus_minus(whole.transmissibility, whole.u_transmissibility)} (2u) at {last['frequency']:g} Hz, "
        f"{case_of(last['gap'])}, {last['regime'].decode()}"
    )
    if note := note_on(last):
        console.print(note, style="yellow")


def _content(found: RunMeasurements) -> dict[str, object]:
    whole = found.budget
    if whole is None:
        return {"transmissibility": None}
    last = found.rows[-1]
    return {
        "frequency_hz": last["frequency"],
        "gap_m": last["gap"],
        "regime": last["regime"],
        "transmissibility": whole.transmissibility,
        "u_transmissibility": whole.u_transmissibility,
        "phase_rad": last["phase"],
        "settled_measurements": len(found.rows),
        "current_amplitude_a": last["current_amplitude"],
        "budget": [attrs.asdict(part) for part in whole.parts],
    }
