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
"""`Job`: one run of a reset rig, the unit that is measured, stored and never repeated.

A job begins with a reset rig and a new analysis, so it depends on nothing but its own values: it gives the same bits in
this process, in another one, on another machine of the same kind, through ROS, and after an interruption. Single points
are jobs of one frequency; a sweep that keeps the rig's state from point to point is one job of many.

All jobs of one seed are the *same rig*: `daq.seed` draws the instruments' calibration errors, which in a laboratory
stay what they are from run to run. So a job takes the campaign's seed as it is. A seed of its own for every point would
give every point other instruments, and reductions would carry errors that are common, and cancel, in reality.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from typing import Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import TRANSMISSIBILITY, joined
from impact_rig.config.tree import Value
from impact_rig.errors import GoneError, ImpactRigError
from impact_rig.instruments.section import channels_of
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.gaps import case_of
from impact_rig.rig.journal import not_default
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S
from impact_rig_studies.operate.operator import Applied, News, Note, PatientApparatus, operate, silent
from impact_rig_studies.operate.stepped_sine import Direction, Setpoint, SteppedSine, SweepPlan, SweepState

LOOKS_PER_S = 4
"""The operator looks at the measurements this often, in rig time, and commands then: part of a job's definition,
because in a sweep it decides when the next frequency begins."""
MAX_BLOCK_SCANS = 4000  # so that a block of truth fits a message
DWELL_FACTOR = 2.5  # a point may take this many times the analysis's own bound before it is given up
TRACE_BLOCKS = 2  # blocks that are kept as a trace after the last measurement


@attrs.frozen(kw_only=True)
class Job:
    """One run."""

    changes: Mapping[str, Value]  # configuration values that differ from the default rig, by dotted name
    analysis: Mapping[str, Value] = attrs.field(factory=dict)
    """Settings of the measurement that differ from `TrackerSettings`."""
    gap_m: float  # the operator's label: gap, or `NO_SPHERE`
    frequencies_hz: tuple[float, ...]
    direction: Direction = Direction.UP  # order in which a job of several points visits them
    current_a: float  # peak current
    repetitions: int = 1  # settled measurements per point, one after the other
    traces: bool = False  # keep scans and truth after the last measurement as well

    def config(self) -> RigConfig:
        """Return the rig's configuration; one block from one look to the next.

        Raises:
            ConfigError: a value is wrong.
        """
        config = from_flat(RigConfig(), self.changes)
        scans = max(1, min(config.daq.rate_hz // LOOKS_PER_S, MAX_BLOCK_SCANS))
        return from_flat(config, {"daq.block_scans": scans})

    def settings(self) -> TrackerSettings:
        """Return the settings of the measurement.

        Raises:
            ConfigError: a value is wrong.
        """
        return TrackerSettings(**dict(self.analysis))  # type: ignore[arg-type]  # its validators check

    def plan(self) -> SweepPlan:
        """Return what to command.

        Raises:
            ConfigError: a value is wrong.
        """
        return SweepPlan(
            frequencies_hz=self.frequencies_hz,  # type: ignore[arg-type]  # mypy cannot solve the generic converter
            current_a=self.current_a,
            direction=self.direction,
            measurements_per_point=self.repetitions,
            dwell_limit_s=DWELL_FACTOR * self.settings().wait_limit_s * self.repetitions,
        )

    @property
    def key(self) -> str:
        """Identify the job by all values that decide its numbers, not by traces or code: 16 hexadecimal digits."""
        content = {
            "config": not_default(self.config()),
            "analysis": attrs.asdict(self.settings()),
            "plan": attrs.asdict(self.plan()),
            "gap_m": self.gap_m,
            "turn": [LOOKS_PER_S, COMMAND_GRID_NS, NS_PER_S],
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    def describe(self) -> str:
        """Return a short name for people."""
        gap = case_of(self.gap_m)
        first, last = min(self.frequencies_hz), max(self.frequencies_hz)
        return f"{gap}, {first:g} Hz" if first == last else f"{gap}, {first:g} to {last:g} Hz {self.direction.value}"


@attrs.frozen(eq=False, kw_only=True)
class Outcome:
    """What a job gave."""

    rows: NDArray[np.void] = attrs.field(factory=lambda: np.zeros(0, TRANSMISSIBILITY))
    """Accepted rows of `transmissibility/table`, in the order of the visit."""
    failure: str = ""  # why the run did not reach its end; empty otherwise
    skipped_hz: tuple[float, ...] = ()  # points left out because a sensor was over range
    simulated_s: float = 0.0
    wall_s: float = 0.0
    lost_scans: int = 0  # scans that never reached the analysis
    trace: Mapping[str, NDArray[np.generic]] = attrs.field(factory=dict)
    """Arrays of the end of the run by name, if asked for."""


# --- How a job becomes an outcome. Whatever it is measured with, the rig in this process or one behind topics, answers
# the same calls with the same values, so the numbers are the same bits.

Trace = Mapping[str, NDArray[np.generic]]
TRUE_COLUMNS = ("x_b", "x_1", "x_2", "v_1", "v_2")


class JobApparatus(PatientApparatus, Protocol):
    """An apparatus made ready for one job."""

    def trace(self) -> Trace:
        """Let a few blocks pass and return their scans and truth, see `columns`."""
        ...

    def lost_scans(self) -> int:
        """Return how many scans the analysis has missed."""
        ...


def run_job(job: Job, prepare: Callable[[Job], JobApparatus], note: Note = silent) -> Outcome:
    """Measure a job; whatever goes wrong in it is its outcome, not an exception.

    Args:
        job: what is measured.
        prepare: gives an apparatus for it.
        note: told when the drive is set, and of every measurement.

    Raises:
        GoneError: a process of the apparatus died, which says nothing about the job.
    """
    started = time.perf_counter()
    apparatus: JobApparatus | None = None
    sweep = SteppedSine(job.plan())
    failure, trace = "", {}
    try:
        apparatus = prepare(job)
        operate(sweep, apparatus, note)
        failure = sweep.reason
        if job.traces and sweep.state is SweepState.FINISHED:
            trace = dict(apparatus.trace())
    except GoneError:
        raise
    except ImpactRigError as error:
        failure = str(error)
    return Outcome(
        rows=sweep.rows,
        failure=failure,
        skipped_hz=tuple(sweep.skipped),
        simulated_s=apparatus.now_ns() / NS_PER_S if apparatus else 0.0,
        wall_s=time.perf_counter() - started,
        lost_scans=apparatus.lost_scans() if apparatus else 0,
        trace=trace,
    )


def columns(scans: NDArray[np.void], truth: NDArray[np.void], rate_hz: int) -> Trace:
    """Return consecutive scans and the truth at the same instants as columns; time from their first scan on [s].

    Args:
        scans: rows of `daq/scan`, shape (n,).
        truth: rows of `truth/scan`, shape (n,).
        rate_hz: scans per second.
    """
    found: dict[str, NDArray[np.generic]] = {"time": np.arange(len(scans)) / rate_hz}
    for rows, names in ((scans, channels_of(scans)), (truth, TRUE_COLUMNS)):
        found.update({name: rows[name].astype(np.float32) for name in names})
    return found


# --- The rig and the analysis in this process: what the nodes run, without DDS between them. The analysis sees what the
# rig publishes: calibration, accepted commands, scans, and the operator's label.


class ProcessApparatus:
    """A `JobApparatus` in this process.

    Raises:
        ConfigError: the job's values together cannot be simulated.
    """

    def __init__(self, job: Job) -> None:
        self._rig = Rig(job.config())
        self._tracker = Tracker(job.settings())
        self._applied: list[Applied] = []
        info = self._rig.info()
        self._tracker.configure(info)
        self._tracker.label(job.gap_m, info.stamp_ns)

    def now_ns(self) -> int:
        """Return the rig time since the reset."""
        return self._rig.next_block_ns - self._rig.start_ns

    def set(self, setpoint: Setpoint) -> None:
        """Command frequency, then current."""
        rig = self._rig
        rig.accept(frequency_hz=setpoint.frequency_hz)
        rig.accept(amplitude=setpoint.current_a)
        for table in rig.take_applied():
            self._tracker.on_applied(table)
            self._applied += Applied.of(table, self.now_ns())

    def rest(self) -> None:
        """Do nothing: this rig is given up."""

    def wait(self) -> News:
        """Let one block pass."""
        rows: list[np.void] = []
        for block in self._advance():
            for table in self._tracker.feed(block.scan).measurements:
                rows.extend(table.rows)
        applied, self._applied = self._applied, []
        stopped = None if self._rig.latched is None else f"the rig tripped: {self._rig.latched}"
        return News(now_ns=self.now_ns(), applied=applied, rows=rows, stopped=stopped)

    def trace(self) -> Trace:
        """Let a few blocks pass and return their scans and truth."""
        self._rig.configure({"output.truth_scan": True})  # changes what is handed out, not one sample
        self._advance()  # half of its truth was not kept
        blocks = [block for _ in range(TRACE_BLOCKS) for block in self._advance()]
        scans = joined([block.scan.rows for block in blocks])
        truth = joined([block.truth.rows for block in blocks if block.truth is not None])
        return columns(scans, truth, self._rig.rate_hz)

    def lost_scans(self) -> int:
        """Return how many scans the analysis has missed."""
        return self._tracker.counters.lost_scans

    def _advance(self) -> list[Block]:
        return self._rig.advance(self._rig.block_end_ns(1))


def execute(job: Job) -> Outcome:
    """Measure a job in this process."""
    return run_job(job, ProcessApparatus)
