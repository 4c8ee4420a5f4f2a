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
"""Run jobs on all cores; results come as they are done. What a job is, and what is done with it, is the caller's."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from impact_rig.errors import ConfigError, GoneError, ImpactRigError
from impact_rig.system.endings import SIGNALS, end_with, held, unhurried
from impact_rig_studies.campaign.store import fingerprint
from impact_rig_studies.campaign.tasks import Portable

J = TypeVar("J")
R = TypeVar("R")

AHEAD = 2  # jobs handed out per worker: enough to keep it busy, few enough to stop soon after Ctrl-C
CLOSING_S = 2.0  # how long the end of a pool is waited for whose workers were killed


class WorkerDiedError(GoneError):
    """A worker process was ended from outside."""


def in_parallel(
    work: Callable[[J], R], jobs: Sequence[J], workers: int | None = None
) -> Generator[tuple[J, R], None, None]:
    """Yield every job with what `work` returns for it, in the order in which they are done.

    Who stops asking (Ctrl-C) loses the jobs under way, nothing else. Workers end with this process, however it ends.

    Args:
        work: a function of a module; it and the jobs travel to the workers.
        jobs: what to run.
        workers: processes; None: one per usable core.

    Raises:
        WorkerDiedError: a worker was killed.
    """
    count = min(workers or len(os.sched_getaffinity(0)), len(jobs))
    if count <= 1:
        yield from ((job, work(job)) for job in jobs)
        return
    waiting = iter(jobs)
    # spawned, not forked: a copy of a process that has threads (ROS, progress display) may hold their locks for ever
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, context, initializer=_begin_worker, initargs=(os.getpid(),))
    running: dict[Future[R], J] = {}
    try:
        with held():  # the workers begin here: signals are the parent's, which ends in order
            running |= {pool.submit(work, job): job for job in itertools.islice(waiting, AHEAD * count)}
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job = running.pop(future)
                following = next(waiting, None)
                if following is not None:
                    running[pool.submit(work, following)] = following
                yield job, future.result()
    except BrokenProcessPool as error:
        raise WorkerDiedError("a worker process was killed; run it again to go on") from error
    finally:
        with unhurried():
            if running:
                for worker in set(multiprocessing.active_children()) - others:
                    worker.kill()  # it has nothing to save
                # its thread may hang after that, but must not meet the interpreter's end while it closes what that uses
                closing = threading.Thread(target=pool.shutdown, kwargs={"cancel_futures": True}, daemon=True)
                closing.start()
                closing.join(CLOSING_S)
            else:
                pool.shutdown()


def _begin_worker(parent: int) -> None:
    """Leave Ctrl-C to the parent, which ends in order, and never outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    end_with(parent, lambda: os._exit(1))


# --- The same on an existing Dask cluster, for studies that outgrow one machine; needs the extra `[cluster]`
#
# The workers need this package in the same version, and one thread each (`--nthreads 1`): a job keeps one core busy.
# Results travel back, nothing is written there.

CONNECT_S = 10.0
P = TypeVar("P", bound=Portable)


def on_cluster(work: Callable[[P], R], address: str) -> Callable[[Sequence[P]], Generator[tuple[P, R], None, None]]:
    """Return what sends jobs to the scheduler at `address`, and yields every one with what `work` returns for it.

    Raises:
        ConfigError: Dask is not installed.
    """
    try:
        from distributed import Client, as_completed  # noqa: PLC0415  # an optional dependency
    except ImportError as error:
        raise ConfigError("--through dask needs Dask: pip install 'impact_rig[cluster]'") from error

    def run(jobs: Sequence[P]) -> Generator[tuple[P, R], None, None]:
        try:
            client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ImpactRigError(f"cannot reach a Dask scheduler at {address}: {error}") from error
        with client:
            _check_code(client.run(fingerprint))
            # a job gives the same bits wherever it runs, so one whose worker died is simply run again elsewhere
            futures = {client.submit(work, job, key=f"impact_rig-{job.key}", retries=2): job for job in jobs}
            lost = []
            for future in as_completed(list(futures), loop=client.loop):
                if future.status == "finished":
                    yield futures[future], future.result()
                else:
                    lost.append(f"{futures[future].describe()}: {future.exception()}")
            if lost:
                raise ImpactRigError(f"{len(lost)} runs were lost, run it again to go on; {lost[0]}")

    return run


def _check_code(found: dict[str, str]) -> None:
    if not found:
        raise ImpactRigError("the Dask cluster has no workers")
    for worker, code in found.items():
        if code != fingerprint():
            raise ImpactRigError(f"worker {worker} has impact_rig {code}, this is {fingerprint()}")
