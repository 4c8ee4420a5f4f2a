# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The rig and the analysis in this process: what the nodes run, without DDS between them.

What the analysis sees is what the rig publishes: calibration, accepted commands, scans, and the operator's label.
"""

from __future__ import annotations

import numpy as np

from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import joined
from impact_rig.campaign.execution import Trace, columns, run_job
from impact_rig.campaign.job import TRACE_BLOCKS, Job, Outcome
from impact_rig.operate.operator import Applied, News
from impact_rig.operate.plan import Setpoint
from impact_rig.rig import Block, Rig


class ProcessApparatus:
    """A `JobApparatus` in this process.

    Args:
        job: what it is made for.

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
        rig.accept(current_a=setpoint.current_a)
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
