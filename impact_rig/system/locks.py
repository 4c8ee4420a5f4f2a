# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Locks that one process of this machine holds at a time; each ends with its process, however that ends.

A lock is on a file in the directory for temporary files. The file stays, and means nothing.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from pathlib import Path

PLACES = "impact_rig_places"
"""Folder of the locks on places in the graph."""


def place(domain_id: int, namespace: str) -> str:
    """Return the name of the lock that a rig of a domain and namespace holds."""
    return f"{domain_id}{namespace.replace('/', '.').rstrip('.')}"


def hold(folder: str, name: str) -> int | None:
    """Return the descriptor that holds a lock, until it is closed; None: it is held, by this process or another.

    Args:
        folder: where its file is, within the directory for temporary files; all users share it.
        name: of the lock, part of a file name.

    Raises:
        OSError: the file can be neither made nor opened, so there is no telling.
    """
    handle = _open(folder, name)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    return handle


def holder(folder: str, name: str) -> int | None:
    """Return the id of the process that holds a lock; None: nobody does, or there is no telling."""
    try:
        handle = _open(folder, name)
    except OSError:
        return None
    try:
        inode = os.fstat(handle).st_ino
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            words = line.split()  # number: FLOCK ADVISORY WRITE process major:minor:inode begin end
            if words[1] == "FLOCK" and words[5].rpartition(":")[2] == str(inode):
                return int(words[4])
    except (OSError, ValueError, IndexError):
        return None
    finally:
        os.close(handle)
    return None


def can_hold(folder: str, name: str) -> bool:
    """Return whether `hold` can tell who holds a lock."""
    try:
        os.close(_open(folder, name))
    except OSError:
        return False
    return True


def _open(folder: str, name: str) -> int:
    """Open the file: reading is enough for a lock, and Linux lets nobody "create" what is another user's."""
    directory = Path(tempfile.gettempdir()) / folder
    with contextlib.suppress(FileExistsError):
        directory.mkdir()
        directory.chmod(0o1777)  # like /tmp itself: other users lock here as well
    path = directory / f"{name}.lock"
    try:
        return os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return os.open(path, os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
