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
"""Definition and measurement of a job, the unit of a campaign that is measured and stored once.

A job begins with a reset rig and a new analysis, so its result depends only on its own values. The result is the same
to the bit in other processes, on other machines of the same kind, through ROS, and after an interruption. A job is one
frequency, or a sweep that keeps the rig's state from point to point.

All jobs of one seed use the *same rig*, because `daq.seed` determines the instruments' calibration errors. As in a
laboratory, these errors are the same in each run, so that they can cancel in reductions.
"""

from __future__ import annotations

import functools
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
from impact_rig_studies.operate.plans import Direction, SweepPlan
from impact_rig_studies.operate.stepped_sine import SteppedSine, SweepState

UPDATES_PER_S = 4
"""Number of times per second of rig time that the operator reads the measurements and sends commands.

It is part of a job's definition, because in a sweep it determines when the next frequency begins.
"""
MAX_BLOCK_SCANS = 4000  # largest block of scans whose true motion (`truth/scan`) fits into one message
DWELL_FACTOR = 2.5  # time limit of a measurement in a sweep, in multiples of the time limit of the analysis
TRACED = (topics.TRUTH_SCAN.name,)  # topics that a job with traces needs in addition
TRACE_BLOCKS = 2  # number of blocks of scans kept as a trace after the last measurement


@attrs.frozen(kw_only=True, slots=False)  # with slots, older versions of attrs have no cached properties
class Job:
    """Definition of one run that starts with a reset rig: configuration, drive frequencies and current."""

    changes: Mapping[str, Value]  # configuration values that differ from the default rig, by dotted name
    analysis: Mapping[str, Value] = attrs.field(factory=dict)
    """Settings of the analysis that differ from the defaults of `TrackerSettings`."""
    gap_m: float  # operator's label for the analysis: gap, or `NO_SPHERE`
    frequencies_hz: tuple[float, ...]
    direction: Direction = Direction.UP  # order of the points
    current_a: float  # peak current
    repetitions: int = 1  # settled measurements per frequency, one after the other
    traces: bool = False  # whether to keep scans and true motion after the last measurement

    def config(self) -> RigConfig:
        """Return the configuration of the rig for this job.

        A block of scans lasts a quarter of a second (1 / `UPDATES_PER_S`), but has at most `MAX_BLOCK_SCANS` scans.

        Raises:
            ConfigError: a value is wrong.
        """
        config = from_flat(RigConfig(), self.changes)
        scans = max(1, min(config.daq.rate_hz // UPDATES_PER_S, MAX_BLOCK_SCANS))
        return from_flat(config, {"daq.block_scans": scans})

    def settings(self) -> TrackerSettings:
        """Return the settings of the analysis that measures the job.

        Raises:
            ConfigError: a value is wrong.
        """
        return TrackerSettings(**dict(self.analysis))  # type: ignore[arg-type]  # its validators check

    def labelled_settings(self) -> dict[str, Value]:
        """Return the parameters of the analysis by name: its settings, and the label `gap_m` ([m] or `NO_SPHERE`)."""
        return {**attrs.asdict(self.settings()), "gap_m": self.gap_m}

    def plan(self) -> SweepPlan:
        """Return the plan of the sweep that measures the job: frequencies, current, repetitions and limits.

        Raises:
            ConfigError: a value is wrong.
        """
        return SweepPlan(
            frequencies_hz=self.frequencies_hz,
            current_a=self.current_a,
            direction=self.direction,
            measurements_per_point=self.repetitions,
            dwell_limit_s=DWELL_FACTOR * self.settings().wait_limit_s * self.repetitions,
        )

    @functools.cached_property
    def key(self) -> str:
        """Digest of all values of the job that determine its results (not `traces`): 16 hexadecimal digits."""
        content = {
            "config": not_default(self.config()),
            "analysis": attrs.asdict(self.settings()),
            "plan": attrs.asdict(self.plan()),
            "gap_m": self.gap_m,
            "turn": [UPDATES_PER_S, COMMAND_GRID_NS, NS_PER_S],
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    def describe(self) -> str:
        """Return gap and frequencies as text, such as `gap 4 mm, 9.1 Hz` or `no sphere, 7.5 to 10.5 Hz up`."""
        gap = case_of(self.gap_m)
        first, last = min(self.frequencies_hz), max(self.frequencies_hz)
        return f"{gap}, {first:g} Hz" if first == last else f"{gap}, {first:g} to {last:g} Hz {self.direction.value}"


@attrs.frozen(eq=False, kw_only=True)
class Outcome:
    """Result of measuring a job: its measurements, and the reason if it failed."""

    rows: NDArray[np.void] = attrs.field(factory=lambda: np.zeros(0, TRANSMISSIBILITY))
    """Measurements that the sweep accepted, in their order: rows of `transmissibility/table`."""
    failure: str = ""  # why the run did not finish; empty if it did
    skipped_hz: tuple[float, ...] = ()  # frequencies without a measurement because a sensor was over range
    simulated_s: float = 0.0  # duration in rig time
    wall_s: float = 0.0  # duration by the clock of this machine
    lost_scans: int = 0  # number of scans that never reached the analysis
    trace: Mapping[str, NDArray[np.generic]] = attrs.field(factory=dict)
    """Scans and true motion at the end of the run, one array per column by name; empty unless the job requests them."""


Trace = Mapping[str, NDArray[np.generic]]
TRUE_COLUMNS = ("x_b", "x_1", "x_2", "v_1", "v_2")


def run_job(job: Job, start: Callable[[Job], RigDriver], on_update: OnUpdate = ignore) -> Outcome:
    """Measure a job on a new rig, and return its outcome.

    Errors of the rig or the sweep other than those below become the `failure` of the outcome.

    Args:
        job: job to measure.
        start: function that returns a new rig with its analysis for the job, in this process or as ROS nodes. `run_job`
            does not close the rig. If the rig has processes, `start` must store it for the caller to close.
        on_update: function that receives the sweep at its start, and after each block of scans with new measurements.

    Raises:
        ConfigError: the job has no valid plan.
        GoneError: a process of the rig died; the job has no result and can be measured again.
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
    """Advance the rig, and return scans and true motion of the last `TRACE_BLOCKS` blocks as columns, for figures.

    The rig advances by one block more, from which on it publishes its true motion (`truth/scan`).
    """
    rig.configure({"output.truth_scan": True})  # changes what is published, but no sample
    rig.step()  # only half of its truth was kept
    rig.clear()
    rig.step(TRACE_BLOCKS)
    count = TRACE_BLOCKS * rig.block_scans
    return columns(rig.newest(topics.SCAN.name, count), rig.newest(topics.TRUTH_SCAN.name, count), rig.rate_hz)


def columns(scans: NDArray[np.void], truth: NDArray[np.void], rate_hz: int) -> Trace:
    """Convert scans, and the true motion at the same times, into one array per column, by name.

    The result has the measured channels and the true motion (`TRUE_COLUMNS`) in single precision. Its column `time` has
    the time since the first row [s] in double precision. Other columns are left out.

    Args:
        scans: consecutive rows of `daq/scan`, shape (n,).
        truth: rows of `truth/scan` at the same times, shape (n,).
        rate_hz: scans per second.
    """
    found: dict[str, NDArray[np.generic]] = {"time": np.arange(len(scans)) / rate_hz}
    for rows, names in ((scans, channels_of(scans)), (truth, TRUE_COLUMNS)):
        found.update({name: rows[name].astype(np.float32) for name in names})
    return found


def start_local(job: Job) -> RigDriver:
    """Return a new rig with its analysis in this process, configured for a job.

    Raises:
        ConfigError: a value of the job is wrong, or the values are jointly infeasible.
    """
    return LocalRig(job.config(), analysis=job.labelled_settings(), also=TRACED)


def execute(job: Job) -> Outcome:
    """Measure a job by `run_job` on a new rig in this process (`start_local`)."""
    return run_job(job, start_local)
