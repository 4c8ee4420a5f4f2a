"""The rig and the analysis in this process: what the nodes run, without DDS between them.

What the analysis sees is what the rig publishes: calibration, accepted commands, scans, and the operator's label.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from impact_rig.analysis.stepped import Command
from impact_rig.analysis.tracker import Tracker
from impact_rig.campaign.bench import Trace, Turn, columns, operate
from impact_rig.campaign.job import TRACE_TURNS, Job, Outcome
from impact_rig.rig import Block, Rig


class ProcessBench:
    """A `Bench` in this process.

    Args:
        job: what it is made for.

    Raises:
        ConfigError: the job's values together cannot be simulated.
    """

    def __init__(self, job: Job) -> None:
        self._rig = Rig(job.config())
        self._tracker = Tracker(job.settings())
        info = self._rig.info()
        self._tracker.configure(info)
        self._tracker.label(job.gap_m, info.stamp_ns)

    def now_ns(self) -> int:
        """Return the rig time since the reset."""
        return self._rig.next_block_ns - self._rig.start_ns

    def command(self, command: Command) -> Sequence[tuple[float, float]]:
        """Command frequency, then current; return the accepted changes."""
        rig = self._rig
        rig.command(frequency_hz=command.frequency_hz)
        rig.command(current_a=command.current_a)
        applied = rig.take_applied()
        for table in applied:
            self._tracker.command(table)
        return [(float(row["frequency"]), float(row["current"])) for table in applied for row in table.rows]

    def turn(self) -> Turn:
        """Let one block pass."""
        rows: list[np.void] = []
        for block in self._advance():
            for table in self._tracker.feed(block.scan).measurements:
                rows.extend(table.rows)
        return Turn(rows, self._rig.latched)

    def trace(self) -> Trace:
        """Let a few blocks pass and return their scans and truth."""
        self._rig.configure({"output.truth_scan": True})  # changes what is handed out, not one sample
        self._advance()  # half of its truth was not kept
        blocks = [block for _ in range(TRACE_TURNS) for block in self._advance()]
        scans = np.concatenate([block.scan.rows for block in blocks])
        truth = np.concatenate([block.truth.rows for block in blocks if block.truth is not None])
        return columns(scans, truth, self._rig.rate_hz)

    def lost_scans(self) -> int:
        """Return how many scans the analysis has missed."""
        return self._tracker.counters.lost_scans

    def _advance(self) -> list[Block]:
        return self._rig.advance(self._rig.block_end_ns(1))


def execute(job: Job) -> Outcome:
    """Measure a job in this process."""
    return operate(job, ProcessBench)
