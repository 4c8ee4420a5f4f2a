# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain of one's own: nothing else on this machine or network hears or disturbs what runs in it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from impact_rig.errors import ImpactRigError
from impact_rig.system import files

FOLDER = "impact_rig_domains"
FIRST_DOMAIN, LAST_DOMAIN = 1, 49
"""0 is everybody's default, and above 101 the ports of a domain fall into Linux's ephemeral range."""
FIRST_PORT, PORTS_PER_DOMAIN = 7400, 250
"""Of RTPS (DDSI-RTPS 2.2, 9.6.1.1)."""
SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  # where Fast DDS keeps it on Linux
DISCOVERY_VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


@contextmanager
def isolated_domain() -> Iterator[int]:
    """Reserve a domain id until the end of the block; discovery of this process and its children stays on this host.

    Two test workers, or two users of one machine, never get the same id: each holds a lock file while it uses one.

    Raises:
        ImpactRigError: all ids are in use.
    """
    before = os.environ.get(DISCOVERY_VARIABLE)
    for domain_id in _candidates():
        handle = _hold(domain_id)
        if handle is None:
            continue
        os.environ[DISCOVERY_VARIABLE] = "LOCALHOST"
        remove_litter(domain_id)
        try:
            yield domain_id
        finally:
            remove_litter(domain_id)
            os.close(handle)
            if before is None:
                del os.environ[DISCOVERY_VARIABLE]
            else:
                os.environ[DISCOVERY_VARIABLE] = before
        return
    folder = f"{tempfile.gettempdir()}/{FOLDER}"
    raise ImpactRigError(
        f"no free ROS domain id between {FIRST_DOMAIN} and {LAST_DOMAIN}: {folder} is full of locks, or not writable"
    )


def remove_litter(domain_id: int) -> None:
    """Remove the shared-memory ports that killed processes have left in a domain, as `fastdds shm clean` does.

    Who finds one half written may crash (https://github.com/eProsima/Fast-DDS/issues/6501). A port in use is
    locked, and left alone; one that is being made in this very instant is not yet, so the domain should be one's own.
    """
    first = FIRST_PORT + PORTS_PER_DOMAIN * domain_id
    for number in range(first, first + PORTS_PER_DOMAIN):
        port = SHARED_MEMORY / f"fastrtps_port{number}"
        if port.exists():
            _remove_unless_in_use(port)


def _remove_unless_in_use(port: Path) -> None:
    locks = [port.with_name(f"{port.name}_{kind}") for kind in ("el", "sl")]
    with contextlib.ExitStack() as held, contextlib.suppress(BlockingIOError, PermissionError):
        for path in locks:
            with contextlib.suppress(FileNotFoundError):
                handle = os.open(path, os.O_RDONLY)
                held.callback(os.close, handle)
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        for path in (port, *locks, SHARED_MEMORY / f"sem.{port.name}_mutex"):
            path.unlink(missing_ok=True)


def _candidates() -> Iterator[int]:
    count = LAST_DOMAIN - FIRST_DOMAIN + 1
    start = time.monotonic_ns() // 1000 % count  # spreads users; the locks decide
    for k in range(count):
        yield FIRST_DOMAIN + (start + k) % count


def _hold(domain_id: int) -> int | None:
    try:
        return files.hold(FOLDER, str(domain_id))
    except OSError:  # of a user who does not share
        return None
