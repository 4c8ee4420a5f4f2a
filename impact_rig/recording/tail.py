# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What the open chunk of a recording holds, in a second file beside it: it outlives a killed process.

A chunk cannot be written piece by piece, because it is compressed and checked as a whole. So its messages go to
`run.mcap.tail` as well, an MCAP file of small chunks, one for each promise that what was accepted is safe; it is
removed once the chunk itself is written. Its chunks are composed here: the library would make indexes that nobody
reads. `recover` reads both. If the process was killed between writing the chunk and removing the tail, the messages are
in both files: the tail says from where on a chunk makes it superfluous.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path

from impact_rig.errors import RecordingError
from impact_rig.recording.description import TopicDescription
from impact_rig.recording.mcap_file import SEQUENCE_MASK, McapFile
from impact_rig.recording.provenance import protect
from impact_rig.recording.records import CHUNK, CHUNK_HEAD, MESSAGE, MESSAGE_HEAD, RECORD_HEAD

SUFFIX = ".tail"
"""What follows the name of the recording."""
RECORD_NAME = "impact_rig_tail"
FOLLOWS = "follows"
"""Key of that record: size of the recording when its open chunk began [bytes]."""

_SIZES = struct.Struct("<IQ")


def tail_of(recording: Path) -> Path:
    """Return where the tail of an MCAP file is, if there is one."""
    return recording.with_name(recording.name + SUFFIX)


class Tail(McapFile):
    """The tail of one chunk.

    Args:
        recording: the MCAP file.
        follows: its size [bytes].
        topics: in the order they were registered there, so that they have the same ids here.
        chunk_bytes: of the recording.

    Raises:
        RecordingError: it exists, or cannot be written.
    """

    def __init__(self, recording: Path, follows: int, topics: Iterable[TopicDescription], chunk_bytes: int) -> None:
        super().__init__(tail_of(recording), compression="none", chunk_bytes=chunk_bytes, chunked=False)
        self._log_times: list[int] = []
        self.add_metadata(RECORD_NAME, protect({FOLLOWS: str(follows)}))
        self.close_chunk()
        self.commit()
        for topic in topics:
            self.add_topic(topic)
        self._records = [self.take_back()]  # definitions are believed inside a chunk only: it has a checksum

    def add_message(self, channel: int, log_time: int, data: bytes, publish_time: int, sequence: int) -> bool:
        """Keep a message for the next `secure`; nothing waits for `commit`."""
        length = MESSAGE_HEAD.size - RECORD_HEAD.size + len(data)
        head = MESSAGE_HEAD.pack(MESSAGE, length, channel, sequence & SEQUENCE_MASK, log_time, publish_time)
        self._records += head, data
        self._log_times.append(log_time)
        return False

    def shortage(self) -> str:
        """Return nothing: the recording leaves room for one more chunk, and for much more."""
        return ""

    def secure(self) -> None:
        """Hand the messages since the last call to the operating system.

        Raises:
            RecordingError: they cannot be written.
        """
        if self._log_times:
            self.add_record(_chunk(b"".join(self._records), min(self._log_times), max(self._log_times)))
            self._records, self._log_times = [], []
        self.commit()

    def remove(self) -> None:
        """Remove the file: the chunk is written.

        Raises:
            RecordingError: it cannot be removed.
        """
        self.close()
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be removed: {error.strerror}") from error


def _chunk(content: bytes, first_ns: int, last_ns: int) -> bytes:
    """Return an uncompressed Chunk record (MCAP format specification, version 0) of definitions and messages."""
    head = CHUNK_HEAD.pack(first_ns, last_ns, len(content), zlib.crc32(content))
    sizes = _SIZES.pack(0, len(content))  # no name of a compression
    length = len(head) + len(sizes) + len(content)
    return b"".join((RECORD_HEAD.pack(CHUNK, length), head, sizes, content))
