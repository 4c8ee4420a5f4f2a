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
"""Parallel execution of jobs, on all cores of this machine or on a Dask cluster; results arrive as they are completed.

The caller supplies the function that runs a job, and must store the results.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Generic, TypeVar  # futures of an optional dependency

import attrs

from impact_rig.errors import ConfigError, GoneError, ImpactRigError
from impact_rig.system.endings import SIGNALS, block_signals, defer_signals, end_with
from impact_rig_studies.campaign.store import DECIDING, code_fingerprint
from impact_rig_studies.campaign.tasks import WorkItem

J = TypeVar("J")
R = TypeVar("R")

BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables from which libraries for linear algebra read their number of threads when they are loaded."""
AHEAD = 2  # jobs submitted per worker: enough to keep it busy, few enough to stop soon after Ctrl-C
AHEAD_ON_CLUSTER = 8  # as AHEAD; more, because jobs and results also take time on the network
CLOSING_S = 2.0  # time limit for closing a pool whose workers were killed


class WorkerDiedError(GoneError):
    """Error that a worker process died, for example because the system killed it for lack of memory."""


def in_parallel(
    work: Callable[[J], R], jobs: Sequence[J], workers: int | None = None
) -> Generator[tuple[J, R], None, None]:
    """Run jobs in worker processes, and yield every job with its result, in the order of completion.

    With one worker or one job, everything runs in this process. If `work` raises an exception, it is raised here, and
    the other jobs are cancelled. If the caller stops iterating, the workers are killed, and results that were not
    yielded are lost. The workers end when this process ends.

    Args:
        work: function at module level that returns the result of a job; it and the jobs are sent to the workers.
        jobs: jobs to run.
        workers: number of processes; None means one per usable core.

    Raises:
        WorkerDiedError: a worker died.
    """
    count = min(workers or len(os.sched_getaffinity(0)), len(jobs))
    if count <= 1:
        yield from ((job, work(job)) for job in jobs)
        return
    waiting = iter(jobs)
    # spawned, not forked: a copy of a process with threads (ROS, progress display) may hold their locks forever
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, context, initializer=_begin_worker, initargs=(os.getpid(),))
    running: dict[Future[R], J] = {}
    try:
        with (
            block_signals(),
            _one_thread_each(),
        ):  # the workers start here: only the parent handles signals, and ends in order
            running |= {pool.submit(work, job): job for job in itertools.islice(waiting, AHEAD * count)}
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job = running.pop(future)
                following = next(waiting, None)
                if following is not None:
                    running[pool.submit(work, following)] = following
                yield job, future.result()
    except BrokenProcessPool as error:
        raise WorkerDiedError(
            "a worker process died, for example because the system killed it for lack of memory; run the command again "
            "to compute what is missing, with fewer --workers if memory is short"
        ) from error
    finally:
        with defer_signals():
            if running:
                for worker in set(multiprocessing.active_children()) - others:
                    worker.kill()  # it has nothing to save
                # its thread may hang after that, but the interpreter must not end while it closes resources
                closing = threading.Thread(target=pool.shutdown, kwargs={"cancel_futures": True}, daemon=True)
                closing.start()
                closing.join(CLOSING_S)
            else:
                pool.shutdown()


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Limit processes started in this context to one thread for linear algebra, unless the environment sets another."""
    added = dict.fromkeys((name for name in BLAS_THREADS if name not in os.environ), "1")
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


def _begin_worker(parent: int) -> None:
    """Prepare a worker process: it ignores Ctrl-C, which the parent handles, and ends when the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    end_with(parent, lambda: os._exit(1))


# --- Jobs on an existing Dask cluster, for studies that are too large for one machine; needs the extra `[cluster]`
#
# Scheduler and workers need this package, workers one thread each (`--nthreads 1`): a job keeps one core busy. Results
# are sent back to the client, which stores them. Workers may join and leave: each result states the code of its worker.

CONNECT_S = 10.0
WORKERS_S = 0.5  # time between two requests for the list of workers, while jobs run
UNLIMITED = 1_000_000  # number of threads assumed of a cluster without workers
NEEDS_DASK = "--through dask needs Dask: pip install 'impact_rig[cluster]'"
ROOMS = (*DECIDING, "campaign", "dynamics", "kernels", "maps")
"""Packages whose code determines the result of a job, so a cluster's workers must have the same."""
P = TypeVar("P", bound=WorkItem)


@attrs.frozen
class _Made(Generic[R]):
    """Reply of a cluster's worker to a job: the worker's code, and the result.

    There is no result if the worker has other code than the client.
    """

    worker: str  # address of the worker
    code: str  # its `code_fingerprint`
    result: R | None  # result of the job; None if it was not run, because the worker has other code than the client


def cluster_threads(address: str) -> int:
    """Return the number of worker threads of a Dask cluster, to estimate a computing time.

    If the cluster has no workers yet, return `UNLIMITED`, because workers may still join.

    Raises:
        ConfigError: Dask is not installed.
        ImpactRigError: the scheduler cannot be reached.
    """
    with _connected(address) as client:
        return sum(client.nthreads().values()) or UNLIMITED


def _connected(address: str) -> Any:
    try:
        from distributed import Client  # noqa: PLC0415  # an optional dependency
    except ImportError as error:
        raise ConfigError(NEEDS_DASK) from error
    try:
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ImpactRigError(
            f"cannot reach a Dask scheduler at {address}: {error}; start it, or correct the address of --through dask"
        ) from error


def _make(work: Callable[[P], R], job: P, code: str) -> _Made[R]:
    """Run a job on this Dask worker if the worker's code is `code`, the `code_fingerprint` of the client.

    Otherwise the reply has no result.
    """
    from distributed import get_worker  # noqa: PLC0415  # an optional dependency

    own = code_fingerprint(ROOMS)
    return _Made(get_worker().address, own, work(job) if own == code else None)


def on_cluster(work: Callable[[P], R], address: str) -> Callable[[Sequence[P]], Generator[tuple[P, R], None, None]]:
    """Return a function that runs jobs on the Dask cluster at `address`.

    The returned function yields each job with the result of `work`. It waits without a time limit if the cluster has no
    workers. A worker with other code than this process is reported on stderr and not used. The returned function raises
    an ImpactRigError if the scheduler cannot be reached or is lost, or if no worker has the code of this process. If
    jobs fail, it completes the other jobs first, and then raises an ImpactRigError.

    Raises:
        ConfigError: Dask is not installed.
    """
    try:
        from distributed import as_completed  # noqa: PLC0415  # an optional dependency
    except ImportError as error:
        raise ConfigError(NEEDS_DASK) from error

    def run(jobs: Sequence[P]) -> Generator[tuple[P, R], None, None]:
        client = _connected(address)
        try:
            yield from run_with(client, jobs)
        except ImpactRigError:
            raise
        except OSError as error:
            raise ImpactRigError(
                f"lost the connection to the Dask scheduler at {address}: {error}; run the command again to compute "
                "what is missing"
            ) from error

    def run_with(client: Any, jobs: Sequence[P]) -> Generator[tuple[P, R], None, None]:
        code, wrong, lost = code_fingerprint(ROOMS), dict[str, str](), list[str]()
        running: dict[Any, P] = {}
        with client:
            done = as_completed(loop=client.loop, with_results=True, raise_errors=False)
            asked_s, present = -math.inf, dict[str, int]()

            def usable() -> list[str]:
                nonlocal asked_s, present
                if time.monotonic() - asked_s > WORKERS_S:  # not for each job: the answer takes longer than a short one
                    present, asked_s = client.nthreads(), time.monotonic()
                if not present:
                    _warn(
                        f"waiting for a worker of the Dask cluster at {address}: start one with "
                        f"dask worker {address} --nthreads 1"
                    )
                    client.wait_for_workers(1)
                    present = client.nthreads()
                found = [worker for worker in present if worker not in wrong]
                if not found:
                    raise ImpactRigError(
                        f"no worker of the Dask cluster at {address} has the code of this process, {code}: install "
                        "this version of impact_rig for the workers"
                    )
                return found

            def submit(jobs: Sequence[P]) -> None:
                # a job gives the same bits wherever it runs, so one whose worker died is simply run again elsewhere
                # impure: a result of this key that another client has left there is not taken
                others = usable() if wrong else None
                futures = client.map(
                    _make, [work] * len(jobs), jobs, [code] * len(jobs), retries=2, pure=False, workers=others
                )
                running.update(zip(futures, jobs, strict=True))
                done.update(futures)

            waiting = iter(jobs)
            submit(list(itertools.islice(waiting, AHEAD_ON_CLUSTER * max(1, len(usable())))))
            while running:
                finished, again = [], []
                for future, made in done.next_batch():
                    job = running.pop(future)
                    if future.status != "finished":
                        lost.append(f"{job.describe()}: {future.exception() or future.status}")
                    elif made.code != code:
                        if made.worker not in wrong:
                            wrong[made.worker] = made.code
                            _warn(
                                f"worker {made.worker} has impact_rig {made.code}, but this process has {code}: the "
                                "worker is not used; install the same version there"
                            )
                        again.append(job)
                    else:
                        finished.append((job, made.result))
                    future.release()
                room = AHEAD_ON_CLUSTER * len(usable()) - len(running) - len(again)
                submit([*again, *itertools.islice(waiting, max(0, room))])
                yield from finished
        if lost:
            raise ImpactRigError(
                f"jobs that failed on the cluster: {len(lost)}; run the command again to repeat them. The first: "
                f"{lost[0]}"
            )

    return run


def _warn(text: str) -> None:
    sys.stderr.write(f"impact-rig: {text}\n")
