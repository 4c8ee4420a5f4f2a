# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""One MCAP file being written: whole records or nothing on disk, and a stop before the disk or the file size limit.

`mcap.writer.Writer` composes the records into memory, so that a failing disk never leaves it half way; `commit` moves
what is complete to the file and cuts the file back to the last whole record if that fails.

`Tail` is the second file beside it: what the open chunk of a recording holds, so that it outlives a killed process.

A chunk cannot be written piece by piece, because it is compressed and checked as a whole. So its messages go to
`run.mcap.tail` as well, an MCAP file of small chunks, one for each promise that what was accepted is safe; it is
removed once the chunk itself is written. Its chunks are composed here: the library would make indexes that nobody
reads. `recover` reads both. If the process was killed between writing the chunk and removing the tail, the messages are
in both files: the tail says from where on a chunk makes it superfluous.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import resource
import struct
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from mcap.writer import CompressionType, Writer

from impact_rig.errors import RecordingError
from impact_rig.recording.description import ENCODING, SERIALIZATION, TopicDescription
from impact_rig.recording.provenance import Attachment, protect
from impact_rig.recording.records import CHUNK, CHUNK_HEAD, MESSAGE, MESSAGE_HEAD, RECORD_HEAD
from impact_rig.system.files import NEW_FILE

SEQUENCE_MASK = 0xFFFFFFFF
"""MCAP keeps the low 32 bits of a sequence number."""
PROFILE = "ros2"
LIBRARY = "impact_rig"
COMPRESSIONS: Mapping[str, CompressionType] = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}

MIN_FREE_BYTES = 8 * 2**20
"""A recording stops when less is free: enough for its index and for whatever else the machine must still log."""
_INDEX_BYTES_PER_CHUNK = 128  # a ChunkIndex record without its 10 bytes per channel
_CLOSING_BYTES_PER_TOPIC = 1024  # its part of the metadata records that end a file
_INDEX_BYTES_FIXED = 4096  # statistics, summary offsets, footer, metadata and attachment indexes


class _Buffer(io.BytesIO):
    """Memory that knows its place in the file."""

    committed = 0

    def tell(self) -> int:
        return self.committed + super().tell()

    def pending(self) -> int:
        return super().tell()

    def drain(self) -> None:
        self.committed += super().tell()
        self.empty()

    def empty(self) -> None:
        self.seek(0)
        self.truncate()


class McapFile:
    """An MCAP file of profile `ros2`, opened exclusively.

    Args:
        path: must not exist.
        compression: `none`, `lz4` or `zstd`.
        chunk_bytes: a chunk is closed when it holds more than this.
        chunked: whether messages and definitions go into chunks.

    Raises:
        RecordingError: the file exists or cannot be created, or the limits leave no room for a single chunk.
    """

    def __init__(self, path: Path, *, compression: str, chunk_bytes: int, chunked: bool = True) -> None:
        if compression not in COMPRESSIONS:
            raise RecordingError(f"compression must be one of {', '.join(COMPRESSIONS)}, got {compression!r}")
        self.path = path
        self._chunk_bytes = chunk_bytes
        self._largest_message = 0
        self._chunks = 0
        self._channels = 0
        self._schema_ids: dict[str, int] = {}
        self._index_bytes = _INDEX_BYTES_FIXED
        self.finished = False
        self._fd = _create(path)
        self._buffer = _Buffer()
        self._writer = Writer(
            self._buffer, chunk_size=chunk_bytes, compression=COMPRESSIONS[compression], use_chunking=chunked
        )
        try:
            self._writer.start(PROFILE, LIBRARY)
            self.commit()
            self._refuse_shortage()
        except RecordingError:
            os.close(self._fd)
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Bytes on disk."""
        return self._buffer.committed

    def add_topic(self, topic: TopicDescription) -> int:
        """Register `topic` and return its channel id: 1 for the first, 2 for the next."""
        if topic.type_name not in self._schema_ids:
            data = topic.schema.encode()
            self._index_bytes += len(data) + len(topic.type_name) + 64
            known = self._writer.register_schema(topic.type_name, ENCODING, data)
            self._schema_ids[topic.type_name] = int(known)
        self._channels += 1
        metadata = topic.channel_metadata()
        self._index_bytes += (
            _CLOSING_BYTES_PER_TOPIC + len(topic.name) + sum(len(k) + len(v) for k, v in metadata.items()) + 64
        )
        return self._writer.register_channel(topic.name, SERIALIZATION, self._schema_ids[topic.type_name], metadata)

    def add_message(self, channel: int, log_time: int, data: bytes, publish_time: int, sequence: int) -> bool:
        """Add a message to the open chunk; return whether that closed the chunk (then it waits for `commit`)."""
        self._largest_message = max(self._largest_message, len(data))
        self._writer.add_message(channel, log_time, data, publish_time, sequence & SEQUENCE_MASK)
        return self._buffer.pending() > 0

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Add a metadata record; it waits for `commit`."""
        self._index_bytes += len(name) + 64
        self._writer.add_metadata(name, dict(record))

    def add_attachment(self, attachment: Attachment, log_time: int, create_time: int) -> None:
        """Add an attachment; it waits for `commit`."""
        self._index_bytes += len(attachment.name) + len(attachment.media_type) + 128
        self._writer.add_attachment(create_time, log_time, attachment.name, attachment.media_type, attachment.data)

    def add_record(self, record: bytes) -> None:
        """Add a complete record as it is; it waits for `commit`."""
        self._buffer.write(record)

    def take_back(self) -> bytes:
        """Return the records that wait for `commit`, which they then do no more."""
        self.close_chunk()
        records = self._buffer.getvalue()
        self._buffer.empty()
        return records

    def close_chunk(self) -> None:
        """End the open chunk, if it holds a message; it waits for `commit`."""
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap annotates arguments, not results

    def commit(self) -> None:
        """Hand all complete records to the operating system.

        Raises:
            RecordingError: they cannot be written; the file ends with the last record that could.
        """
        if not self._buffer.pending():
            return
        self._chunks += 1
        data = self._buffer.getbuffer()
        try:
            _write_all(self._fd, data)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, self._buffer.committed)
            raise RecordingError(
                f"{self.path} cannot be written: {error.strerror}; it ends with its last whole record"
                f" ({self.size} bytes) and has no index yet: impact-rig recover completes it"
            ) from error
        finally:
            data.release()
        self._buffer.drain()

    def shortage(self) -> str:
        """Return why one more chunk and the index might not fit, or an empty string."""
        needed = self._chunk_bytes + self._largest_message + self._reserve()
        limit, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
        if limit != resource.RLIM_INFINITY and self.size + needed > limit:
            return f"the file size limit of this process (RLIMIT_FSIZE, {limit} bytes) is reached"
        space = os.fstatvfs(self._fd)
        free = space.f_bavail * space.f_frsize
        if free < needed + MIN_FREE_BYTES:
            return f"only {free / 1e6:.0f} MB are free on its disk ({MIN_FREE_BYTES / 1e6:.0f} MB are left untouched)"
        return ""

    def finish(self) -> None:
        """Write summary, index and statistics and close the file.

        Raises:
            RecordingError: there is no room for them; the records before them are whole.
        """
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates arguments, not results
            self.commit()
            self.finished = True
        finally:
            self.close()

    def close(self) -> None:
        """Close the file as it is."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _refuse_shortage(self) -> None:
        shortage = self.shortage()
        if shortage:
            raise RecordingError(f"{self.path} cannot be recorded: {shortage}")

    def _reserve(self) -> int:
        return self._index_bytes + (self._chunks + 2) * (_INDEX_BYTES_PER_CHUNK + 10 * self._channels)


def _create(path: Path) -> int:
    """Create a file, locked as long as this process writes it: a reader sees by that whether its writer lives."""
    try:
        fd = os.open(path, NEW_FILE, 0o644)
    except FileExistsError as error:
        raise RecordingError(f"{path} exists already and is not overwritten") from error
    except OSError as error:
        raise RecordingError(f"{path} cannot be created: {error.strerror}") from error
    with contextlib.suppress(OSError):  # a file system without locks
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return fd


def _write_all(fd: int, data: memoryview) -> None:
    done = 0
    while done < len(data):
        done += os.write(fd, data[done:])


TAIL_SUFFIX = ".tail"
"""What follows the name of the recording."""
TAIL_RECORD_NAME = "impact_rig_tail"
FOLLOWS = "follows"
"""Key of that record: size of the recording when its open chunk began [bytes]."""

_SIZES = struct.Struct("<IQ")


def tail_of(recording: Path) -> Path:
    """Return where the tail of an MCAP file is, if there is one."""
    return recording.with_name(recording.name + TAIL_SUFFIX)


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
        self.add_metadata(TAIL_RECORD_NAME, protect({FOLLOWS: str(follows)}))
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
