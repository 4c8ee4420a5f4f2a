# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""What only one process of this machine may have at a time: a name, held by the lock on a file.

The lock ends with its process, however that ends; the file stays, and means nothing.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from pathlib import Path


def hold(folder: str, name: str) -> int | None:
    """Return the descriptor that holds a name, until it is closed; None: another one holds it, here or elsewhere.

    Args:
        folder: of the directory for temporary files, for users who share names as well.
        name: a file name.

    Raises:
        OSError: there is no telling: the file can be neither made nor opened.
    """
    directory = Path(tempfile.gettempdir()) / folder
    with contextlib.suppress(FileExistsError):
        directory.mkdir()
        directory.chmod(0o1777)  # like /tmp itself: other users lock here as well
    handle = _open(directory / f"{name}.lock")
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    return handle


def _open(path: Path) -> int:
    """Open a file for a lock: reading is enough, and Linux lets nobody "create" what is another user's."""
    try:
        return os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return os.open(path, os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
