# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Run a campaign's jobs on an existing Dask cluster: for studies that outgrow one machine. Needs the extra `[cluster]`.

The workers need this package in the same version, and one thread each (`--nthreads 1`): a job keeps one core busy.
Results travel back, nothing is written there.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import TYPE_CHECKING, Protocol, TypeVar

from impact_rig.campaign.code import fingerprint
from impact_rig.campaign.in_process import execute
from impact_rig.errors import ConfigError, ImpactRigError

if TYPE_CHECKING:
    from impact_rig.campaign.run import Runner

CONNECT_S = 10.0


class Portable(Protocol):
    """What can be sent to a cluster."""

    @property
    def key(self) -> str:
        """Identify it by all values that decide its result."""

    def describe(self) -> str:
        """Return a short name for people."""


J = TypeVar("J", bound=Portable)
R = TypeVar("R")


def dask_runner(address: str) -> Runner:
    """Return a runner that sends a campaign's jobs to the scheduler at `address`, see `on_cluster`."""
    return on_cluster(execute, address)


def on_cluster(work: Callable[[J], R], address: str) -> Callable[[Sequence[J]], Generator[tuple[J, R], None, None]]:
    """Return what sends jobs to the scheduler at `address`, and yields every one with what `work` returns for it.

    Raises:
        ConfigError: Dask is not installed.
    """
    try:
        from distributed import Client, as_completed  # noqa: PLC0415  # an optional dependency
    except ImportError as error:
        raise ConfigError("--through dask needs Dask: pip install 'impact_rig[cluster]'") from error

    def run(jobs: Sequence[J]) -> Generator[tuple[J, R], None, None]:
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
