# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Run a campaign's jobs through the real graph: rig, analysis and recorder as processes, driven through topics."""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path

from impact_rig.campaign.execution import run_job
from impact_rig.campaign.job import Job, Outcome
from impact_rig.campaign.run import Runner
from impact_rig.client.client import Client
from impact_rig.client.domain import isolated_domain
from impact_rig.client.operator import FreewheelApparatus, RosApparatus, SteppedApparatus
from impact_rig.client.processes import ParameterValue, Processes
from impact_rig.operate.stepped_sine import SteppedSine
from impact_rig.rig.config import RigConfig

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
    """Start the nodes, and give what steps them through jobs.

    Args:
        directory: processes log into its `logs`, runs are recorded in its `runs`.
        rate_hz: of every job's scans.
        block_scans: of every job's blocks.
        record: record every job.
    """
    parameters: dict[str, ParameterValue] = {
        "time.mode": "stepped", "time.peers": ["analysis", "recorder"] if record else ["analysis"],
        "daq.rate_hz": rate_hz, "daq.block_scans": block_scans,
    }  # fmt: skip
    with _graph(directory, parameters, directory / "runs" if record else None) as client:
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
        with _graph(directory, parameters, directory) as client:
            yield from _run_all(jobs, FreewheelApparatus(client, config), name, watch)

    return run


@contextlib.contextmanager
def _graph(directory: Path, parameters: Mapping[str, ParameterValue], runs: Path | None) -> Iterator[Client]:
    """Start the nodes, and give a client of theirs once they are active.

    Args:
        directory: processes log into its `logs`.
        parameters: of the rig.
        runs: where a recorder writes; None: there is none.
    """
    nodes = ["rig", "analysis"]
    with isolated_domain() as domain_id, Processes(domain_id, directory / "logs") as processes:
        processes.start("rig", parameters)
        processes.start("analysis")
        if runs is not None:
            processes.start("recorder", {"record": False, "directory": str(runs)})
            nodes.append("recorder")
        with Client(domain_id, processes=processes, name="operator") as client:
            client.wait_active(*nodes)
            yield client


def _run_all(
    jobs: Sequence[Job],
    apparatus: RosApparatus,
    name: Callable[[Job], str],
    watch: Watch = lambda _job, _sweep: None,
) -> Generator[tuple[Job, Outcome], None, None]:
    for job in jobs:
        watch(job, None)
        outcome = run_job(job, lambda job: apparatus.prepare(job, name(job)), functools.partial(watch, job))
        apparatus.finish()
        yield job, outcome
