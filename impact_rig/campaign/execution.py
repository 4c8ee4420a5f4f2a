# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""How a job becomes an outcome, whatever it is measured with: the rig in this process, or one behind topics.

Every apparatus answers the same calls with the same values, so the numbers are the same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from impact_rig.campaign.job import Job, Outcome
from impact_rig.errors import GoneError, ImpactRigError
from impact_rig.instruments.section import channels_of
from impact_rig.operate.operator import Note, PatientApparatus, operate, silent
from impact_rig.operate.stepped_sine import State, SteppedSine
from impact_rig.simtime import NS_PER_S

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
        if job.traces and sweep.state is State.FINISHED:
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
