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
"""Repair of shared-memory segments that a killed process left half created, for which others would wait forever.

Fast DDS opens the port of a peer through Boost, which creates the segment if it is missing. While another process
creates the segment, Boost waits without limit. If that process is killed before it writes the first word of the file,
all processes that send to the port or open it wait forever. This was observed in Fast DDS 2.14. Fast DDS discards and
recreates a segment that is marked as corrupt.

A process that waits during its start may hold Python's interpreter lock, so that none of its threads can repair the
segment. `Watch` therefore checks once when it is entered, before Fast DDS starts.
"""

from __future__ import annotations

import contextlib
import os
import re
import struct
import threading
import time
from pathlib import Path

from impact_rig.system.endings import block_signals

SHARED = Path("/dev/shm")  # noqa: S108  # directory of ports and segments of Fast DDS on Linux
POLL_S = 1.0
"""Interval between two checks [s]. To create a segment takes a fraction of a millisecond.

If a segment is half created in two successive checks, the process that created it must therefore have been killed.
"""
PORTS = ("fastrtps_port", "fastdds_port")
"""Beginnings of the names of ports: of Fast DDS 2, and of Fast DDS 3 (ROS 2 Kilted)."""
_PORT = re.compile(rf"({'|'.join(PORTS)})\d+")
_WORD = struct.Struct("<I")
# first word of a segment, as in Boost's `managed_open_or_create_impl`; 0 and 1 while it is created
_MADE, _CORRUPT = 2, 3
_BYTES = 52_400  # size of such a segment


class Watch:
    """Context manager whose thread marks half-created shared-memory ports of Fast DDS of this user as corrupt.

    Fast DDS then recreates these segments instead of waiting forever for the killed process that left them. A segment
    is marked if it is half created in two successive checks. Entering the context checks once, and a second time after
    `poll_s` if a segment is half created.

    Args:
        directory: directory of the segments.
        poll_s: interval between two checks [s]; much longer than it takes to create a segment.
    """

    def __init__(self, directory: Path = SHARED, poll_s: float = POLL_S) -> None:
        self._directory, self._period_s = directory, poll_s
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="segments", daemon=True)

    def __enter__(self) -> Watch:
        with contextlib.suppress(OSError):  # as below
            if before := invalidate_abandoned_segments(self._directory, set()):
                time.sleep(self._period_s)
                invalidate_abandoned_segments(self._directory, before)
        with block_signals():
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        before: set[tuple[str, int]] = set()
        while not self._end.wait(self._period_s):
            with contextlib.suppress(OSError):  # the directory is missing or not readable
                before = invalidate_abandoned_segments(self._directory, before)


def invalidate_abandoned_segments(directory: Path, before: set[tuple[str, int]]) -> set[tuple[str, int]]:
    """Mark each shared-memory segment as corrupt that is half created now and was half created at the last check.

    Only ports of this user are checked, because other processes wait for these.

    Args:
        directory: directory of the segments.
        before: result of the last check, `POLL_S` or more ago; an empty set at the first check.

    Returns:
        Name and inode of all segments that are half created now, for the next check.

    Raises:
        OSError: the directory cannot be read.
    """
    found = set()
    for path in [path for path in directory.iterdir() if _PORT.fullmatch(path.name)]:
        with contextlib.suppress(OSError):  # it is gone, owned by another user, or a link
            descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
            try:
                status = os.fstat(descriptor)
                known, word = (path.name, status.st_ino), os.pread(descriptor, _WORD.size, 0)
                made = len(word) == _WORD.size and _WORD.unpack(word)[0] >= _MADE
                if made or status.st_uid != os.geteuid():
                    continue
                found.add(known)
                if known in before:
                    length = _WORD.size if status.st_size else _BYTES
                    os.pwrite(descriptor, _WORD.pack(_CORRUPT).ljust(length, b"\0"), 0)
            finally:
                os.close(descriptor)
    return found
