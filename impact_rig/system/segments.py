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
"""Segments of shared memory that a killed process has left half made: all others would wait for it for ever.

Fast DDS opens the port of a peer through Boost, which makes the segment where there is none, and waits without end
where somebody is making it. Meanwhile it holds what every message of the process needs. Who is killed between making
the file and finishing its first word, be it only to send to another that was killed, stops everybody who sends there or
begins there. Seen in Fast DDS 2.14, by the stacks of three processes that waited for one empty file. A segment that is
marked as corrupt is given up and made anew, by Fast DDS itself.

A process that begins may wait with Python's lock held, and can look no more: it looks before.
"""

from __future__ import annotations

import contextlib
import os
import re
import struct
import threading
import time
from pathlib import Path

from impact_rig.system.endings import held

SHARED = Path("/dev/shm")  # noqa: S108  # where Fast DDS keeps its ports and segments on Linux
LOOK_S = 1.0
"""Between two looks. Making a segment takes a fraction of a millisecond: who is seen at it twice was killed."""
_PORT = re.compile(r"fastrtps_port\d+")
_WORD = struct.Struct("<I")
_MADE, _CORRUPT = 2, 3  # the first word of a segment, as Boost's `managed_open_or_create_impl` has it; before: 0 and 1
_BYTES = 52_400  # of such a segment


class Watch:
    """Looks for such segments as long as its context lasts, in a thread of its own.

    Args:
        directory: where the segments are.
        look_s: between two looks.
    """

    def __init__(self, directory: Path = SHARED, look_s: float = LOOK_S) -> None:
        self._directory, self._look_s = directory, look_s
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="segments", daemon=True)

    def __enter__(self) -> Watch:
        with contextlib.suppress(OSError):  # as below
            if before := look(self._directory, set()):
                time.sleep(self._look_s)
                look(self._directory, before)
        with held():
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        before: set[tuple[str, int]] = set()
        while not self._end.wait(self._look_s):
            with contextlib.suppress(OSError):  # there is no such directory here, or it is not ours to read
                before = look(self._directory, before)


def look(directory: Path, before: set[tuple[str, int]]) -> set[tuple[str, int]]:
    """Mark as corrupt what was half made at the look before and still is; return what is half made, by name and inode.

    Raises:
        OSError: the directory cannot be read.
    """
    found = set()
    for path in [path for path in directory.iterdir() if _PORT.fullmatch(path.name)]:
        with contextlib.suppress(OSError):  # it is gone, somebody else's, or a link
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
