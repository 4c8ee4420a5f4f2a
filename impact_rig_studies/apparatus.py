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
"""A campaign's jobs through the real graph: rig, analysis and recorder as processes, driven through topics.

The running nodes are an operator's apparatus: stepped from look to look, or running as fast as their peers.
"""

from __future__ import annotations

import abc
import contextlib
import functools
import itertools
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path

import attrs

from impact_rig import topics
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.blocks import Table
from impact_rig.client.client import Client, Collector
from impact_rig.client.processes import ParameterValue, Processes, isolated_domain
from impact_rig.errors import ImpactRigError
from impact_rig.rig.config import RigConfig, differences, to_flat
from impact_rig.rig.interlock import OVER_TRAVEL, Trip
from impact_rig.rig.journal import InputKind, JournalEntry
from impact_rig.simtime import NS_PER_S
from impact_rig.system import files
from impact_rig_studies.campaign.job import TRACE_BLOCKS, Job, JobApparatus, Outcome, Trace, columns, run_job
from impact_rig_studies.campaign.run import Runner
from impact_rig_studies.closed_loop import HeldSweep, hold, with_short_blocks
from impact_rig_studies.operate.operator import Applied, News
from impact_rig_studies.operate.phase_lock import Look, PhasorMeter
from impact_rig_studies.operate.stepped_sine import HoldPlan, Setpoint, SteppedSine

FIXED = ("time.", "step.", "daq.rate_hz", "daq.block_scans", "output.autostart")
"""Parameters that are read-only, or that say how the rig is driven here."""
GRACE_S = 0.005  # wall time for what was published before a step's answer and waits to be taken
MEASUREMENT_TIMEOUT_S = 120.0  # wall time in which a running rig must have measured something
Watch = Callable[[Job, SteppedSine | None], None]
"""Told when a job is being prepared (no sweep yet), when its sweep begins, and of every measurement."""


def stepped_runner(directory: Path, *, record: bool = False) -> Runner:
    """Return a runner that steps the rig, deterministically: the numbers are those of the other ways, bit for bit.

    Args:
        directory: processes log into its `logs`, runs are recorded in its `runs`.
        record: record every job.
    """

    def run(jobs: Sequence[Job]) -> Generator[tuple[Job, Outcome], None, None]:
        # rate and block length of a rig node are fixed at its start
        for fixed, group in itertools.groupby(sorted(jobs, key=_fixed), key=_fixed):
            with stepped(directory, *fixed, record=record) as apparatus:
                yield from _run_all(list(group), apparatus, _file_name)

    return run


@contextlib.contextmanager
def stepped(directory: Path, rate_hz: int, block_scans: int, *, record: bool = False) -> Iterator[SteppedApparatus]:
    """Start the nodes, and give what steps them through jobs."""
    parameters: dict[str, ParameterValue] = {
        "time.mode": "stepped", "time.peers": ["analysis", "recorder"] if record else ["analysis"],
        "daq.rate_hz": rate_hz, "daq.block_scans": block_scans,
    }  # fmt: skip
    with _graph(directory / "logs", _measuring(parameters, directory / "runs" if record else None)) as client:
        yield SteppedApparatus(client, record=record)


def _fixed(job: Job) -> tuple[int, int]:
    config = job.config()
    return config.daq.rate_hz, config.daq.block_scans


def _file_name(job: Job) -> str:
    case = job.describe().replace(", ", "_").replace(" ", "")
    return f"{case}_{job.key}"


def freewheel_runner(directory: Path, config: RigConfig, name: Callable[[Job], str], watch: Watch) -> Runner:
    """Return a runner that lets the rig run as fast as analysis and recorder follow, and records every job.

    Args:
        directory: processes log into its `logs`, runs are recorded in itself.
        config: of the rig; jobs say what differs.
        name: of a job's run.
        watch: told how far it is.
    """
    peers = ["analysis", "recorder"]
    parameters: dict[str, ParameterValue] = {
        "time.mode": "freewheel", "time.peers": peers, "daq.rate_hz": config.daq.rate_hz,
        "daq.block_scans": config.daq.block_scans, "daq.seed": config.daq.seed,
    }  # fmt: skip

    def run(jobs: Sequence[Job]) -> Generator[tuple[Job, Outcome], None, None]:
        with _graph(directory / "logs", _measuring(parameters, directory)) as client:
            yield from _run_all(jobs, FreewheelApparatus(client, config), name, watch)

    return run


def _measuring(rig: Mapping[str, ParameterValue], runs: Path | None) -> dict[str, Mapping[str, ParameterValue]]:
    """Return the nodes that measure, and record into `runs`, with their parameters."""
    nodes: dict[str, Mapping[str, ParameterValue]] = {"rig": rig, "analysis": {}}
    if runs is not None:
        with files.errors_as(f"cannot record into {runs}"):
            files.make_folder(runs)
    return nodes if runs is None else {**nodes, "recorder": {"record": False, "directory": str(runs)}}


@contextlib.contextmanager
def _graph(logs: Path, nodes: Mapping[str, Mapping[str, ParameterValue]]) -> Iterator[Client]:
    """Start nodes in a domain of their own, and give a client of theirs once they are active."""
    with isolated_domain() as domain_id, Processes(domain_id, logs) as processes:
        for node, parameters in nodes.items():
            processes.start(node, parameters)
        with Client(domain_id, processes=processes, name="operator") as client:
            client.wait_active(*nodes)
            yield client


def _run_all(
    jobs: Sequence[Job], apparatus: RosApparatus, name: Callable[[Job], str], watch: Watch = lambda _job, _sweep: None
) -> Generator[tuple[Job, Outcome], None, None]:
    for job in jobs:
        watch(job, None)
        outcome = run_job(job, lambda job: apparatus.prepare(job, name(job)), functools.partial(watch, job))
        apparatus.finish()
        yield job, outcome


def _first_trip(journal: Collector) -> JournalEntry | None:
    """Return the first entry of `rig/journal` that says that the rig has tripped."""
    return next((entry for entry in journal.entries() if entry.kind is InputKind.TRIP), None)


class RosApparatus(JobApparatus):
    """The nodes `rig`, `analysis` and perhaps `recorder`, active, as a `JobApparatus` for one job after the other."""

    def __init__(self, client: Client, *, record: bool) -> None:
        self._client = client
        self._record = record
        self._recording = False
        self._measured = client.collect(topics.TRANSMISSIBILITY_TABLE.name)
        self._journal = client.collect(topics.JOURNAL.name)
        self._config = RigConfig()
        self._applied: list[Applied] = []

    @abc.abstractmethod
    def prepare(self, job: Job, run_name: str) -> RosApparatus:
        """Begin anew with a job's configuration, and record into `run_name` where there is a recorder.

        Raises:
            ImpactRigError: a node refused.
        """

    def set(self, setpoint: Setpoint) -> None:
        """Command frequency, then current, and wait until each is applied.

        Raises:
            ImpactRigError: the rig refused one of them.
        """
        before = len(self._client.applied)
        self._client.command(setpoint.frequency_hz, setpoint.current_a)
        for table in self._client.applied.tables(before):
            self._take(table)

    def finish(self) -> None:
        """End the recording of a job, however it ended."""
        if self._recording:
            self._recording = False
            self._client.trigger("recorder/stop")

    def trace(self) -> Trace:
        """Let a few blocks pass and return their scans and truth.

        Raises:
            ImpactRigError: this apparatus keeps no traces.
        """
        raise ImpactRigError("traces are kept of a stepped rig only")

    def lost_scans(self) -> int:
        """Return how many scans are known to be missing."""
        return 0

    @abc.abstractmethod
    def _take(self, applied: Table) -> None:
        """Keep accepted changes for the next news."""

    def _start_recording(self, run_name: str) -> None:
        if self._record:
            self._client.set_parameters("recorder", {"name": run_name})
            self._client.trigger("recorder/start")
            self._recording = True

    def _take_applied(self) -> list[Applied]:
        taken, self._applied = self._applied, []
        return taken

    def _stopped(self) -> str | None:
        """Return why the rig goes on no more, in the words of its interlock."""
        trip = _first_trip(self._journal)
        if trip is None:
            return None
        reason, shaker = trip.name, self._config.shaker
        limit = shaker.travel_limit_m if reason == OVER_TRAVEL else shaker.current_limit_a_rms
        return f"the rig tripped: {Trip(0, reason, trip.number, limit).message()}"


class SteppedApparatus(RosApparatus):
    """Steps the rig from one look to the next; a step is answered when the analysis has acknowledged its blocks.

    For every job the rig node is configured anew and the analysis activated anew, so both begin as they would in a
    process of their own: the bits are those of `impact_rig_studies.campaign.job`.
    """

    def __init__(self, client: Client, *, record: bool = False) -> None:
        super().__init__(client, record=record)
        self._scans = client.collect(topics.SCAN.name)
        self._truth = client.collect(topics.TRUTH_SCAN.name)
        self._blocks = 0

    def prepare(self, job: Job, run_name: str) -> SteppedApparatus:
        """Begin anew with a job's configuration."""
        client, config = self._client, job.config()
        if self._stopped() is not None:  # by the job before: the latch outlives the transitions
            client.trigger("rig/clear_trip")
        client.change_state("analysis", "deactivate")
        client.change_state("rig", "deactivate")
        client.change_state("rig", "cleanup")  # its history goes with its publishers
        values = to_flat(config)
        client.set_parameters("rig", {name: value for name, value in values.items() if not name.startswith(FIXED)})
        settings = {**attrs.asdict(TrackerSettings()), **job.analysis, "gap_m": job.gap_m}
        client.set_parameters("analysis", settings)
        for node, transition in (("rig", "configure"), ("rig", "activate"), ("analysis", "activate")):
            if not client.change_state(node, transition):
                raise ImpactRigError(f"{node} did not {transition}: {client.status(node).message}")
        client.wait_active("rig", "analysis")
        self._start_recording(run_name)
        self._forget()
        self._journal.clear()
        self._take_applied()
        self._config, self._blocks = config, 0
        return self

    def now_ns(self) -> int:
        """Return the rig time since the reset."""
        return self._blocks * self._config.daq.block_scans * NS_PER_S // self._config.daq.rate_hz

    def wait(self) -> News:
        """Let one block pass.

        Raises:
            ImpactRigError: a measurement came late, so that a command that followed it could be late, too.
        """
        self._forget()
        before = self.now_ns()
        self._step()
        tables = self._measured.tables()
        held_ns, daq = round(TrackerSettings().hold_s * NS_PER_S), self._config.daq
        if any(table.stamp_ns + held_ns < before - daq.block_scans * NS_PER_S // daq.rate_hz for table in tables):
            raise ImpactRigError("a measurement arrived a step late: this machine is too busy to step by")
        rows = [row for table in tables for row in table.rows]
        return News(now_ns=self.now_ns(), applied=self._take_applied(), rows=rows, stopped=self._stopped())

    def rest(self) -> None:
        """Do nothing: the rig is configured anew for the next job."""

    def trace(self) -> Trace:
        """Let a few blocks pass and return their scans and truth."""
        self._client.set_parameters("rig", {"output.truth_scan": True})
        self._step()  # half of its truth was not kept
        self._forget()
        for _ in range(TRACE_BLOCKS):
            self._step()
        wanted = TRACE_BLOCKS * self._config.daq.block_scans
        self._client.wait_until(
            lambda: len(self._scans.rows()) == len(self._truth.rows()) == wanted, f"{wanted} scans and their truth"
        )
        return columns(self._scans.rows(), self._truth.rows(), self._config.daq.rate_hz)

    def lost_scans(self) -> int:
        """Return how many scans never arrived here; the analysis acknowledges each block, or the rig waits."""
        return self._scans.lost() * self._config.daq.block_scans

    def _take(self, applied: Table) -> None:
        self._applied += Applied.of(applied, self.now_ns())

    def _step(self) -> None:
        self._client.step()
        self._blocks += 1
        self._client.spin_for(GRACE_S)

    def _forget(self) -> None:
        """Forget what arrived so far."""
        for collector in (self._measured, self._scans, self._truth):
            collector.clear()


class FreewheelApparatus(RosApparatus):
    """Lets the rig run as fast as its peers acknowledge, and looks when there is a measurement.

    For every job the rig is reset. It stands still from then until the first command, and stands still at the end.
    """

    def __init__(self, client: Client, config: RigConfig) -> None:
        super().__init__(client, record=True)
        self._config = config
        self._now_ns = 0
        self._gap_m = 0.0

    def prepare(self, job: Job, run_name: str) -> FreewheelApparatus:
        """Begin anew with a job's configuration; of the analysis only its label changes."""
        client = self._client
        client.pause()
        changes = differences(job.config(), self._config)
        client.set_parameters("rig", {name: value for name, value in changes.items() if not name.startswith(FIXED)})
        if self._stopped() is not None:  # by the job before: no latched rig is reset
            client.trigger("rig/clear_trip")
        client.trigger("rig/reset")
        client.set_parameters("analysis", {"gap_m": job.gap_m})
        self._start_recording(run_name)
        self._measured.clear()
        self._journal.clear()
        self._take_applied()
        self._config, self._gap_m = job.config(), job.gap_m
        return self

    def now_ns(self) -> int:
        """Return the newest instant heard of; stamps go on over a reset."""
        return self._now_ns

    def set(self, setpoint: Setpoint) -> None:
        """Command frequency, then current, and let the rig run."""
        super().set(setpoint)
        self._client.pause(False)

    def wait(self) -> News:
        """Wait for a measurement.

        Raises:
            WaitTimeoutError: there was none in `MEASUREMENT_TIMEOUT_S` of wall time.
        """
        check = self._client.given("a measurement")
        found, stopped = self._client.wait_until(self._heard, "a measurement", MEASUREMENT_TIMEOUT_S, check)
        rows = [row for table in found for row in table.rows]
        self._now_ns = max([self._now_ns, *(table.stamp_ns for table in found)])
        return News(now_ns=self._now_ns, applied=self._take_applied(), rows=rows, stopped=stopped)

    def rest(self) -> None:
        """Let the rig stand still."""
        self._client.pause()

    def _take(self, applied: Table) -> None:
        found = Applied.of(applied)
        self._applied += found
        self._now_ns = max([self._now_ns, *(one.at_ns for one in found)])

    def _heard(self) -> tuple[list[Table], str | None] | None:
        """Return the measurements of this job since the last command, or why there are no more."""
        tables = self._measured.tables()
        self._measured.clear()
        since = self._now_ns
        ours = [table for table in tables if table.stamp_ns >= since and (table.rows["gap"] == self._gap_m).all()]
        stopped = self._stopped()
        return (ours, stopped) if ours or stopped else None


class SteppedLoop:
    """A `LoopApparatus` over topics.

    Args:
        client: connected to an active rig in stepped mode, which waits for nobody but this client's steps.
    """

    def __init__(self, client: Client, config: RigConfig) -> None:
        self._client = client
        self._rate_hz, self._block_scans = config.daq.rate_hz, config.daq.block_scans
        self._scans = client.collect(topics.SCAN.name, acknowledge=True)
        self._info = client.collect(topics.INFO.name)
        self._journal = client.collect(topics.JOURNAL.name)
        self._frequency_hz, self._blocks = config.drive.frequency_hz, 0
        self._current_a = config.drive.amplitude

    def now_ns(self) -> int:
        """Return the rig time since the reset."""
        return self._blocks * self._block_scans * NS_PER_S // self._rate_hz

    def set(self, setpoint: Setpoint) -> None:
        """Command frequency, then current, where they are new, and wait until each is applied."""
        if self._stopped() is not None:
            return
        if setpoint.frequency_hz != self._frequency_hz:
            self._client.command(frequency_hz=setpoint.frequency_hz)
        if setpoint.current_a != self._current_a:
            self._client.command(current_a=setpoint.current_a)
        self._frequency_hz, self._current_a = setpoint.frequency_hz, setpoint.current_a

    def change(self, values: Mapping[str, ParameterValue]) -> None:
        """Change the rig's parameters under way, such as the gap."""
        self._client.set_parameters("rig", values)

    def look(self, seconds: float) -> Look | str:
        """Step, and return what the rig did.

        Raises:
            ImpactRigError: the rig's calibration never came.
        """
        blocks = max(1, round(seconds * self._rate_hz / self._block_scans))
        self._scans.clear()
        self._client.step(blocks)
        self._blocks += blocks
        self._client.wait_until(lambda: len(self._scans) >= blocks, f"{blocks} blocks of scans")
        stopped, info = self._stopped(), self._info.last()
        if stopped is not None:
            return stopped
        if info is None:
            raise ImpactRigError(f"nothing was heard on {topics.INFO.name}")
        rows = self._scans.rows()
        look = PhasorMeter(info.rows).look(rows, self._frequency_hz, self.now_ns())
        return look or f"{len(rows)} scans are too few to look at"

    def _stopped(self) -> str | None:
        trip = _first_trip(self._journal)
        return None if trip is None else f"the rig tripped: {trip.name}"


def stepped_hold(directory: Path, job: Job, plan: HoldPlan) -> HeldSweep:
    """Walk through a job's points with an amplitude held, behind topics; the processes log into `directory`.

    Raises:
        ImpactRigError: the rig refused, or this machine is too busy to step by.
    """
    daq = job.config().daq
    with stepped(directory, daq.rate_hz, daq.block_scans) as apparatus:
        return hold(job, plan, apparatus.prepare(job, ""))


@contextlib.contextmanager
def stepped_loop(directory: Path, config: RigConfig) -> Iterator[SteppedLoop]:
    """Start a rig node of this configuration in a domain of its own; it logs into `directory`."""
    config = with_short_blocks(config)
    values: dict[str, ParameterValue] = {
        **differences(config), "time.mode": "stepped", "time.peers": ["operator"],
        "daq.block_scans": config.daq.block_scans,
    }  # fmt: skip
    with _graph(directory, {"rig": values}) as client:
        yield SteppedLoop(client, config)
