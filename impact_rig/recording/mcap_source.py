# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""One finished MCAP file: its summary, checked on opening, and its chunks, checked when read."""

from __future__ import annotations

import fcntl
import os
import zlib
from collections.abc import Mapping
from pathlib import Path

import attrs

from impact_rig.errors import RecordingError
from impact_rig.recording import records
from impact_rig.recording.description import TopicDescription
from impact_rig.recording.provenance import Attachment
from impact_rig.recording.records import DamageError
from impact_rig.system import budget
from impact_rig.system.budget import BudgetError
from impact_rig.system.files import open_regular

_REMEDY = "impact-rig recover gives back what is whole"
_BEING_WRITTEN = (
    "it is being recorded now: it can be read when the recording has ended (Ctrl-C, or ~/stop of the recorder); "
    "impact-rig recover gives a copy of what is there so far"
)


@attrs.frozen
class Summary:
    """The index of a file, whose checksum has been verified (where the writer computed one)."""

    schemas: Mapping[int, records.SchemaRecord]
    channels: Mapping[int, records.ChannelRecord]
    chunks: tuple[records.ChunkIndex, ...]
    attachments: tuple[tuple[int, int], ...]
    metadata: tuple[tuple[int, int], ...]
    statistics: records.Statistics


class McapSource:
    """A finished MCAP file, opened for reading.

    Raises:
        RecordingError: it cannot be opened, is not finished or is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._fd = open_regular(path)
        except OSError as error:
            raise RecordingError(f"{path} cannot be opened: {error.strerror}") from error
        try:
            self.size = os.fstat(self._fd).st_size
            self.summary = read_summary(self._fd, self.size)
            self.topics = topics_of(self.summary)
        except DamageError as error:
            if self._is_being_written():
                self.close()
                raise RecordingError(f"{path}: {_BEING_WRITTEN}") from error
            self.close()
            raise DamageError(f"{path}: {error}; {_REMEDY}") from error
        except BudgetError as error:
            self.close()
            raise BudgetError(f"{path}: {error}") from error
        except OSError as error:
            self.close()
            raise RecordingError(f"{path} cannot be read: {error.strerror}") from error

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _is_being_written(self) -> bool:
        """Return whether the process lives that writes the file: it holds a lock on it."""
        try:
            fcntl.flock(self._fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        fcntl.flock(self._fd, fcntl.LOCK_UN)
        return False

    def chunk(self, index: records.ChunkIndex) -> memoryview:
        """Return the records of a chunk, decompressed and checked.

        Raises:
            RecordingError: the chunk is damaged.
        """
        try:
            chunk = records.parse_chunk(self._record(index.offset, index.length, records.CHUNK))
            if chunk.uncompressed_size != index.uncompressed_size:
                raise DamageError("its size is not that in the index")  # noqa: TRY301  (one place words both kinds)
            return records.decompress(chunk)
        except DamageError as error:
            where = f"{self.path}: the chunk at byte {index.offset} is damaged"
            raise DamageError(f"{where}: {error}; {_REMEDY}") from error

    def attachments(self) -> list[Attachment]:
        """Return the attachments.

        Raises:
            RecordingError: one is damaged.
        """
        found = []
        for offset, length in self.summary.attachments:
            try:
                attachment = records.parse_attachment(self._record(offset, length, records.ATTACHMENT))
                if not attachment.intact:
                    raise DamageError("its checksum does not fit")  # noqa: TRY301  (one place words both kinds of damage)
            except DamageError as error:
                raise DamageError(f"{self.path}: the attachment at byte {offset} is damaged: {error}") from error
            found.append(Attachment(attachment.name, attachment.data, attachment.media_type))
        return found

    def metadata(self) -> list[tuple[str, dict[str, str]]]:
        """Return the metadata records: name and content. Their content is not protected by MCAP.

        Raises:
            RecordingError: one is not a metadata record.
        """
        found = []
        for offset, length in self.summary.metadata:
            try:
                found.append(records.parse_metadata(self._record(offset, length, records.METADATA)))
            except DamageError as error:
                raise DamageError(f"{self.path}: the metadata record at byte {offset} is damaged: {error}") from error
        return found

    def _record(self, offset: int, length: int, opcode: int) -> memoryview:
        if length > self.size - offset:
            raise DamageError(f"it claims {length} bytes of a file of {self.size}")
        budget.allow("bytes in a record", length, budget.CHUNK_BYTES + budget.MIB)
        try:
            view = memoryview(os.pread(self._fd, length, offset))
        except OSError as error:  # a bad sector, or the run has been closed meanwhile
            raise RecordingError(f"{self.path} cannot be read at byte {offset}: {error.strerror}") from error
        if len(view) != length:
            raise DamageError("the file is shorter than its index says")
        found, content, end = records.split(view, 0)
        if found != opcode or end != length:
            raise DamageError("another record is in its place")
        return content


def read_summary(fd: int, size: int) -> Summary:
    """Read and check the summary of an open MCAP file of `size` bytes.

    Raises:
        DamageError: the file is no finished MCAP file, or the summary is damaged.
    """
    magic, tail_bytes = len(records.MAGIC), records.FOOTER_BYTES + len(records.MAGIC)
    if os.pread(fd, magic, 0) != records.MAGIC:
        raise DamageError("it does not begin like an MCAP file")
    tail = os.pread(fd, tail_bytes, max(0, size - tail_bytes))
    if size < magic + tail_bytes or not tail.endswith(records.MAGIC):
        raise DamageError("it is not finished: its writer was interrupted")
    opcode, content, _ = records.split(memoryview(tail), 0, end=records.FOOTER_BYTES)
    if opcode != records.FOOTER:
        raise DamageError("its footer is damaged")
    start, crc = records.parse_footer(content)
    footer_offset = size - tail_bytes
    if start == 0:
        raise DamageError("it has no index")
    if not magic <= start <= footer_offset:
        raise DamageError("its footer points outside the file")
    budget.allow("bytes in an index", footer_offset - start, budget.INDEX_BYTES)
    section = os.pread(fd, footer_offset - start, start)
    guarded = records.FOOTER_BYTES - 4  # the checksum covers the footer up to itself
    if crc not in (0, zlib.crc32(tail[:guarded], zlib.crc32(section))):
        raise DamageError("the checksum of its index does not fit")
    return parse_summary(memoryview(section))


def parse_summary(section: memoryview) -> Summary:
    """Return the content of a summary section.

    Raises:
        DamageError: it is not a sequence of records, or there are no statistics.
    """
    schemas: dict[int, records.SchemaRecord] = {}
    channels: dict[int, records.ChannelRecord] = {}
    chunks: list[records.ChunkIndex] = []
    attachments: list[tuple[int, int]] = []
    metadata: list[tuple[int, int]] = []
    statistics: records.Statistics | None = None
    offset = 0
    while offset < len(section):
        opcode, content, offset = records.split(section, offset)
        if opcode == records.SCHEMA:
            schema = records.parse_schema(content)
            schemas[schema.id] = schema
        elif opcode == records.CHANNEL:
            channel = records.parse_channel(content)
            channels[channel.id] = channel
        elif opcode == records.CHUNK_INDEX:
            chunks.append(records.parse_chunk_index(content))
        elif opcode == records.ATTACHMENT_INDEX:
            attachments.append(records.parse_index(content))
        elif opcode == records.METADATA_INDEX:
            metadata.append(records.parse_index(content))
        elif opcode == records.STATISTICS:
            statistics = records.parse_statistics(content)
    if statistics is None:
        raise DamageError("it has no statistics")
    if statistics.chunk_count != len(chunks):
        raise DamageError(f"its index lists {len(chunks)} of {statistics.chunk_count} chunks")
    if statistics.message_count and not chunks:
        raise DamageError("its messages are not in chunks, which alone carry checksums")
    _refuse_shared_bytes(chunks)
    return Summary(schemas, channels, tuple(chunks), tuple(attachments), tuple(metadata), statistics)


def _refuse_shared_bytes(chunks: list[records.ChunkIndex]) -> None:
    """Refuse an index that lists a chunk, or a part of one, twice: a short file would have to be read for ever."""
    ends_at = 0
    for index in sorted(chunks, key=lambda index: index.offset):
        if index.offset < ends_at:
            raise DamageError(f"its index lists the chunk at byte {index.offset} twice, or inside another")
        ends_at = index.offset + index.length


def topics_of(summary: Summary) -> dict[int, TopicDescription]:
    """Return the topic of every channel id.

    Raises:
        DamageError: a channel refers to a schema that is not there.
        BudgetError: there are too many.
    """
    budget.allow("topics", len(summary.channels), budget.TOPICS)
    topics = {}
    for channel in summary.channels.values():
        schema = summary.schemas.get(channel.schema_id)
        if schema is None:
            raise DamageError(f"topic {channel.topic} has no schema")
        text = schema.data.decode("utf-8", errors="replace")
        topics[channel.id] = TopicDescription.from_channel(channel.topic, schema.name, text, channel.metadata)
    return topics
