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

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.config.tree import Value
from impact_rig.driver import LocalRig, RigDriver
from impact_rig.errors import GoneError, ImpactRigError
from impact_rig.instruments.section import channels_of
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.gaps import case_of
from impact_rig.rig.journal import not_default
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S
from impact_rig_studies.operate.operator import OnUpdate, ignore, operate
from impact_rig_studies.operate.stepped_sine import Direction, SteppedSine, SweepPlan, SweepState

UPDATES_PER_S = 4
"""The operator looks at the measurements this often, in rig time, and commands then: part of a job's definition,
because in a sweep it decides when the next frequency begins."""
MAX_BLOCK_SCANS = 4000  # so that a block of truth fits a message
DWELL_FACTOR = 2.5  # a point may take this many times the analysis's own bound before it is given up
TRACED = (topics.TRUTH_SCAN.name,)
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
        scans = max(1, min(config.daq.rate_hz // UPDATES_PER_S, MAX_BLOCK_SCANS))
        return from_flat(config, {"daq.block_scans": scans})

    def settings(self) -> TrackerSettings:
        """Return the settings of the measurement.

        Raises:
            ConfigError: a value is wrong.
        """
        return TrackerSettings(**dict(self.analysis))  # type: ignore[arg-type]  # its validators check

    def labelled_settings(self) -> dict[str, Value]:
        """Return the parameters of the analysis: all its settings, and the operator's label."""
        return {**attrs.asdict(self.settings()), "gap_m": self.gap_m}

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
            "turn": [UPDATES_PER_S, COMMAND_GRID_NS, NS_PER_S],
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


Trace = Mapping[str, NDArray[np.generic]]
TRUE_COLUMNS = ("x_b", "x_1", "x_2", "v_1", "v_2")


def run_job(job: Job, start: Callable[[Job], RigDriver], on_update: OnUpdate = ignore) -> Outcome:
    """Measure a job; an error in it is its outcome, not an exception.

    Args:
        job: what is measured.
        start: gives a new rig with its analysis; in this process or behind topics, the numbers are the same bits.
        on_update: gets the sweep when the drive is set, and after every measurement.

    Raises:
        GoneError: a process of the rig died, which says nothing about the job.
    """
    started = time.perf_counter()
    rig: RigDriver | None = None
    sweep = SteppedSine(job.plan())
    failure, trace = "", {}
    try:
        rig = start(job)
        operate(sweep, rig, on_update)
        failure = sweep.reason
        if job.traces and sweep.state is SweepState.FINISHED:
            trace = dict(_trace(rig))
    except GoneError:
        raise
    except ImpactRigError as error:
        failure = str(error)
    return Outcome(
        rows=sweep.rows,
        failure=failure,
        skipped_hz=tuple(sweep.skipped),
        simulated_s=rig.now_ns / NS_PER_S if rig else 0.0,
        wall_s=time.perf_counter() - started,
        lost_scans=rig.lost_scans if rig else 0,
        trace=trace,
    )


def _trace(rig: RigDriver) -> Trace:
    """Let a few blocks pass and return their scans and truth."""
    rig.configure({"output.truth_scan": True})  # changes what is handed out, not one sample
    rig.step()  # half of its truth was not kept
    rig.clear()
    rig.step(TRACE_BLOCKS)
    count = TRACE_BLOCKS * rig.block_scans
    return columns(rig.newest(topics.SCAN.name, count), rig.newest(topics.TRUTH_SCAN.name, count), rig.rate_hz)


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


def start_local(job: Job) -> RigDriver:
    """Return a rig in this process for a job.

    Raises:
        ConfigError: the job's values together cannot be simulated.
    """
    return LocalRig(job.config(), analysis=job.labelled_settings(), also=TRACED)


def execute(job: Job) -> Outcome:
    """Measure a job in this process."""
    return run_job(job, start_local)
