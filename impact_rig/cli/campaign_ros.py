"""Run a campaign's jobs through the real graph: rig and analysis as processes, driven step by step through topics.

For every job the rig node is configured anew and the analysis activated anew, so both begin as they would in a process
of their own; the rig steps one turn at a time, and a step is answered when the analysis has acknowledged its blocks.
"""

from __future__ import annotations

import itertools
from collections.abc import Generator, Sequence
from pathlib import Path

import attrs

from impact_rig import topics
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.stepped import Command
from impact_rig.campaign.bench import Trace, Turn, columns, operate
from impact_rig.campaign.job import TRACE_TURNS, Job, Outcome
from impact_rig.campaign.run import Runner
from impact_rig.client import Client, Processes, isolated_domain
from impact_rig.errors import ImpactRigError
from impact_rig.rig import Kind
from impact_rig.rig.config import RigConfig, to_flat
from impact_rig.rig.interlock import OVER_TRAVEL, Trip, check_amplitude, check_frequency
from impact_rig.simtime import NS_PER_S

FIXED = ("time.", "step.", "daq.rate_hz", "daq.block_scans", "output.autostart")
"""Parameters that are read-only, or that say how the rig is driven here."""
GRACE_S = 0.005
"""Wall time for what was published before a step's answer and waits to be taken."""


def ros_runner(directory: Path, *, record: bool = False) -> Runner:
    """Return a runner whose processes log into `directory`/logs, and whose runs are recorded in `directory`/runs."""

    def run(jobs: Sequence[Job]) -> Generator[tuple[Job, Outcome], None, None]:
        # rate and block length of a rig node are fixed at its start
        for (rate, scans), group in itertools.groupby(sorted(jobs, key=_fixed), key=_fixed):
            yield from _run_group(list(group), rate, scans, directory, record)

    return run


def _fixed(job: Job) -> tuple[int, int]:
    config = job.config()
    return config.daq.rate_hz, config.daq.block_scans


def _run_group(
    jobs: Sequence[Job], rate: int, scans: int, directory: Path, record: bool
) -> Generator[tuple[Job, Outcome], None, None]:
    peers = ["analysis", "recorder"] if record else ["analysis"]
    with isolated_domain() as domain_id, Processes(domain_id, directory / "logs") as processes:
        processes.start("rig", {
            "time.mode": "stepped", "time.peers": peers, "daq.rate_hz": rate, "daq.block_scans": scans,
        })  # fmt: skip
        processes.start("analysis")
        if record:
            processes.start("recorder", {"record": False, "directory": str(directory / "runs")})
        with Client(domain_id, processes=processes, name="operator") as client:
            client.wait_active("rig", *peers)
            graph = Graph(client, record=record)
            for job in jobs:
                outcome = operate(job, graph.prepare)
                graph.finish()
                yield job, outcome


class Graph:
    """The running nodes, as a `Bench` for one job after the other.

    Args:
        client: connected to an active rig and analysis.
        record: there is a recorder, and every job becomes a run of its own.
    """

    def __init__(self, client: Client, *, record: bool = False) -> None:
        self._client = client
        self._record = record
        self._recording = False
        self._table = client.collect(topics.TRANSMISSIBILITY_TABLE.name)
        self._journal = client.collect(topics.JOURNAL.name)
        self._scans = client.collect(topics.SCAN.name)
        self._truth = client.collect(topics.TRUTH_SCAN.name)
        self._config = RigConfig()
        self._rate_hz = self._block_scans = self._blocks = 0

    def prepare(self, job: Job) -> Graph:
        """Begin anew with a job's configuration.

        Raises:
            ImpactRigError: a node refused.
        """
        client, config = self._client, job.config()
        client.change_state("analysis", "deactivate")
        client.change_state("rig", "deactivate")
        client.change_state("rig", "cleanup")  # its history goes with its publishers
        values = {name: value for name, value in to_flat(config).items() if not name.startswith(FIXED)}
        client.set_parameters("rig", {name: ("",) if value == () else value for name, value in values.items()})
        settings = {**attrs.asdict(TrackerSettings()), **job.analysis, "gap_m": job.gap_m}
        client.set_parameters("analysis", settings)
        for node, transition in (("rig", "configure"), ("rig", "activate"), ("analysis", "activate")):
            if not client.change_state(node, transition):
                raise ImpactRigError(f"{node} did not {transition}: {client.status(node).message}")
        client.wait_active("rig", "analysis")
        if self._record:
            case = job.describe().replace(", ", "_").replace(" ", "")
            client.set_parameters("recorder", {"name": f"{case}_{job.key}"})
            client.trigger("recorder/start")
            self._recording = True
        self._take()
        self._journal.clear()
        self._config, self._blocks = config, 0
        self._rate_hz, self._block_scans = config.daq.rate_hz, config.daq.block_scans
        return self

    def finish(self) -> None:
        """End the recording of a job, however it ended."""
        if self._recording:
            self._recording = False
            self._client.trigger("recorder/stop")

    def now_ns(self) -> int:
        """Return the rig time since the reset."""
        return self._blocks * self._block_scans * NS_PER_S // self._rate_hz

    def command(self, command: Command) -> Sequence[tuple[float, float]]:
        """Command frequency, then current; return the accepted changes.

        Raises:
            ImpactRigError: the rig would refuse them: it says so to people only, so they are checked here.
        """
        check_frequency(command.frequency_hz, self._config.shaker)
        check_amplitude(command.current_a, self._config.drive, self._config.shaker)
        client = self._client
        accepted = [
            client.command(frequency_hz=command.frequency_hz),
            client.command(current_a=command.current_a),
        ]
        return [(float(row["frequency"]), float(row["current"])) for row in accepted]

    def turn(self) -> Turn:
        """Let one block pass.

        Raises:
            ImpactRigError: a measurement came late, so that a command that followed it could be late, too.
        """
        self._take()
        before = self.now_ns()
        self._step()
        tables = self._table.tables()
        held_ns = round(TrackerSettings().hold_s * NS_PER_S)
        if any(table.stamp_ns + held_ns < before - self._block_scans * NS_PER_S // self._rate_hz for table in tables):
            raise ImpactRigError("a measurement arrived a turn late: this machine is too busy to step by")
        return Turn([row for table in tables for row in table.rows], self._trip())

    def trace(self) -> Trace:
        """Let a few blocks pass and return their scans and truth."""
        self._client.set_parameters("rig", {"output.truth_scan": True})
        self._step()  # half of its truth was not kept
        self._take()
        for _ in range(TRACE_TURNS):
            self._step()
        wanted = TRACE_TURNS * self._block_scans
        self._client.wait_until(
            lambda: len(self._scans.rows()) == len(self._truth.rows()) == wanted, f"{wanted} scans and their truth"
        )
        return columns(self._scans.rows(), self._truth.rows(), self._rate_hz)

    def lost_scans(self) -> int:
        """Return how many scans never arrived here; the analysis acknowledges each block, or the rig waits."""
        return self._scans.lost() * self._block_scans

    def _step(self) -> None:
        self._client.step()
        self._blocks += 1
        self._client.spin_for(GRACE_S)

    def _take(self) -> None:
        """Forget what arrived so far."""
        for collector in (self._table, self._scans, self._truth):
            collector.clear()

    def _trip(self) -> str | None:
        rows = self._journal.rows()
        trips = rows[rows["kind"] == Kind.TRIP.value.encode()]
        if not len(trips):
            return None
        reason, shaker = trips[0]["key"].decode(), self._config.shaker
        limit = shaker.travel_limit_m if reason == OVER_TRAVEL else shaker.current_limit_a_rms
        return Trip(0, reason, float(trips[0]["value"]), limit).message()
