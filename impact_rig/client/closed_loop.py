# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A rig behind topics, stepped, for held amplitudes and phase locks: the bits are those of a rig in this process."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from impact_rig import topics
from impact_rig.campaign.job import Job
from impact_rig.client.campaign import stepped
from impact_rig.client.client import Client
from impact_rig.client.domain import isolated_domain
from impact_rig.client.processes import ParameterValue, Processes
from impact_rig.errors import ImpactRigError
from impact_rig.operate.phase_lock import Look, PhasorMeter
from impact_rig.operate.plan import Setpoint
from impact_rig.operate.stepped_sine import HoldPlan
from impact_rig.rig import Kind
from impact_rig.rig.config import RigConfig, from_flat, to_flat
from impact_rig.simtime import NS_PER_S
from impact_rig.studies.closed_loop import Held, hold, with_short_blocks


class SteppedLoop:
    """A `LoopApparatus` over topics.

    Args:
        client: connected to an active rig in stepped mode, which waits for nobody but this client's steps.
        config: that the rig has.
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
        rows = self._journal.rows()
        trips = rows[rows["kind"] == Kind.TRIP.value.encode()]
        return f"the rig tripped: {trips[0]['key'].decode()}" if len(trips) else None


def stepped_hold(directory: Path, job: Job, plan: HoldPlan) -> Held:
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
    config, default = with_short_blocks(config), to_flat(RigConfig())
    values = {name: value for name, value in to_flat(config).items() if value != default[name]}
    values |= {"time.mode": "stepped", "time.peers": ["operator"], "daq.block_scans": config.daq.block_scans}  # type: ignore[dict-item]  # lists are values of parameters
    with isolated_domain() as domain_id, Processes(domain_id, directory) as processes:
        processes.start("rig", values)
        with Client(domain_id, processes=processes, name="operator") as client:
            client.wait_active("rig")
            yield SteppedLoop(client, from_flat(config, {}))
