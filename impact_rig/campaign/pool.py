"""Run jobs on all cores; results come as they are done."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool

from impact_rig.campaign.in_process import execute
from impact_rig.campaign.job import Job, Outcome
from impact_rig.errors import ImpactRigError

AHEAD = 2
"""Jobs handed out per worker: enough to keep it busy, few enough to stop soon after Ctrl-C."""


class WorkerDiedError(ImpactRigError, RuntimeError):
    """A worker process was ended from outside."""


def run_parallel(jobs: Sequence[Job], workers: int | None = None) -> Iterator[tuple[Job, Outcome]]:
    """Yield every job with its outcome, in the order in which they are done.

    Whoever stops asking (Ctrl-C) lets the jobs under way end; what they gave is lost, nothing else.

    Args:
        jobs: what to run.
        workers: processes; None: one per usable core.

    Raises:
        WorkerDiedError: a worker was killed.
    """
    count = min(workers or len(os.sched_getaffinity(0)), len(jobs))
    if count <= 1:
        yield from ((job, execute(job)) for job in jobs)
        return
    waiting = iter(jobs)
    # spawned, not forked: a copy of a process that has threads (ROS, progress display) may hold their locks for ever
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, context, initializer=_ignore_interrupts) as pool:
        running = {pool.submit(execute, job): job for job in itertools.islice(waiting, AHEAD * count)}
        try:
            while running:
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job = running.pop(future)
                    following = next(waiting, None)
                    if following is not None:
                        running[pool.submit(execute, following)] = following
                    yield job, future.result()
        except BrokenProcessPool as error:
            raise WorkerDiedError("a worker process was killed; run the campaign again to go on") from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the parent, which ends in order."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
