# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Strict reading of MCAP records: every length is compared with what is there, every checksum with what it guards.

Our own parser of a small, stable format, because the readers at hand trust lengths (a short read passes for a whole
record) and so hand out wrong data from damaged files. Source: the MCAP format specification, version 0.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Final, NamedTuple

import attrs
import lz4.frame  # type: ignore[import-untyped]  # ships no stubs
import zstandard

from impact_rig.errors import RecordingError

MAGIC: Final = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

RECORD_HEAD: Final = struct.Struct("<BQ")
CHUNK_HEAD: Final = struct.Struct("<QQQI")
MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
_FOOTER: Final = struct.Struct("<QQI")
_STATISTICS: Final = struct.Struct("<QHIIIIQQ")
FOOTER_BYTES: Final = RECORD_HEAD.size + _FOOTER.size

Bytes = bytes | memoryview


class DamageError(RecordingError):
    """Bytes are not the record they claim to be."""


class SchemaRecord(NamedTuple):
    """A message type and its definition."""

    id: int
    name: str
    encoding: str
    data: bytes


class ChannelRecord(NamedTuple):
    """A topic: its schema, encoding and metadata."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: dict[str, str]


class RawMessage(NamedTuple):
    """A message inside a chunk; `data` is a view of the chunk."""

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: memoryview


class Chunk(NamedTuple):
    """A compressed chunk as it stands in the file."""

    uncompressed_size: int
    crc: int
    compression: str
    data: memoryview


class ChunkIndex(NamedTuple):
    """Where a chunk is and which log times it holds."""

    start_ns: int
    end_ns: int
    offset: int
    length: int
    channel_ids: tuple[int, ...]
    compressed_size: int
    uncompressed_size: int


class AttachmentRecord(NamedTuple):
    """A file inside the recording; `intact`: its checksum fits."""

    name: str
    media_type: str
    log_time: int
    create_time: int
    data: bytes
    intact: bool


class Statistics(NamedTuple):
    """What the writer counted."""

    message_count: int
    chunk_count: int
    start_ns: int
    end_ns: int
    channel_counts: dict[int, int]


@attrs.define
class Fields:
    """Reads the fields of one record; `end` says that nothing may be left."""

    view: memoryview
    position: int = 0

    def take(self, count: int) -> memoryview:
        """Return the next `count` bytes."""
        start = self.position
        left = len(self.view) - start
        if count > left:
            raise DamageError(f"a field of {count} bytes does not fit the {left} bytes left of its record")
        self.position = start + count
        return self.view[start : self.position]

    def u2(self) -> int:
        """Return a 16-bit number."""
        return int.from_bytes(self.take(2), "little")

    def u4(self) -> int:
        """Return a 32-bit number."""
        return int.from_bytes(self.take(4), "little")

    def u8(self) -> int:
        """Return a 64-bit number."""
        return int.from_bytes(self.take(8), "little")

    def text(self) -> str:
        """Return a length-prefixed UTF-8 string."""
        try:
            return str(self.take(self.u4()), "utf-8")
        except UnicodeDecodeError as error:
            raise DamageError(f"a string is not UTF-8: {error}") from error

    def mapping(self) -> dict[str, str]:
        """Return a length-prefixed map of strings."""
        inner = Fields(self.take(self.u4()))
        content: dict[str, str] = {}
        while inner.position < len(inner.view):
            key = inner.text()
            content[key] = inner.text()
        return content

    def end(self) -> None:
        """Raise DamageError if bytes are left."""
        if self.position != len(self.view):
            raise DamageError(f"{len(self.view) - self.position} bytes too many in a record")


def split(view: memoryview, offset: int, *, end: int | None = None) -> tuple[int, memoryview, int]:
    """Return opcode, content and end of the record at `offset`.

    Raises:
        DamageError: the record does not fit before `end` (default: the end of `view`).
    """
    stop = len(view) if end is None else end
    if offset + RECORD_HEAD.size > stop:
        raise DamageError(f"no whole record at byte {offset}")
    opcode, length = RECORD_HEAD.unpack_from(view, offset)
    start = offset + RECORD_HEAD.size
    if length > stop - start:
        raise DamageError(f"the record at byte {offset} claims {length} bytes, only {stop - start} are there")
    return opcode, view[start : start + length], start + length


def parse_header(content: memoryview) -> tuple[str, str]:
    """Return profile and library."""
    fields = Fields(content)
    profile, library = fields.text(), fields.text()
    fields.end()
    return profile, library


def parse_schema(content: memoryview) -> SchemaRecord:
    """Return a schema."""
    fields = Fields(content)
    schema = SchemaRecord(fields.u2(), fields.text(), fields.text(), bytes(fields.take(fields.u4())))
    fields.end()
    return schema


def parse_channel(content: memoryview) -> ChannelRecord:
    """Return a channel."""
    fields = Fields(content)
    channel = ChannelRecord(fields.u2(), fields.u2(), fields.text(), fields.text(), fields.mapping())
    fields.end()
    return channel


def parse_chunk(content: memoryview) -> Chunk:
    """Return a chunk, still compressed."""
    fields = Fields(content)
    _, _, size, crc = CHUNK_HEAD.unpack(fields.take(CHUNK_HEAD.size))
    compression = fields.text()
    data = fields.take(fields.u8())
    fields.end()
    return Chunk(size, crc, compression, data)


def parse_message_index(content: memoryview) -> int:
    """Return the channel id of a message index, whose entries must be whole."""
    fields = Fields(content)
    channel_id = fields.u2()
    length = fields.u4()
    if length % 16:
        raise DamageError(f"a message index of {length} bytes does not hold whole entries")
    fields.take(length)
    fields.end()
    return channel_id


def parse_chunk_index(content: memoryview) -> ChunkIndex:
    """Return a chunk index."""
    fields = Fields(content)
    start_ns, end_ns, offset, length = fields.u8(), fields.u8(), fields.u8(), fields.u8()
    inner = Fields(fields.take(fields.u4()))
    channel_ids = []
    while inner.position < len(inner.view):
        channel_ids.append(inner.u2())
        inner.u8()
    fields.u8()
    fields.text()
    index = ChunkIndex(start_ns, end_ns, offset, length, tuple(channel_ids), fields.u8(), fields.u8())
    fields.end()
    return index


def parse_attachment(content: memoryview) -> AttachmentRecord:
    """Return an attachment and whether its checksum fits (a checksum of 0 counts as none, so as not intact)."""
    fields = Fields(content)
    log_time, create_time = fields.u8(), fields.u8()
    name, media_type = fields.text(), fields.text()
    data = fields.take(fields.u8())
    guarded = content[: fields.position]
    crc = fields.u4()
    fields.end()
    return AttachmentRecord(name, media_type, log_time, create_time, bytes(data), zlib.crc32(guarded) == crc)


def parse_metadata(content: memoryview) -> tuple[str, dict[str, str]]:
    """Return name and content of a metadata record."""
    fields = Fields(content)
    name, mapping = fields.text(), fields.mapping()
    fields.end()
    return name, mapping


def parse_index(content: memoryview) -> tuple[int, int]:
    """Return offset and length of the attachment or metadata record an index record points to."""
    fields = Fields(content)
    return fields.u8(), fields.u8()


def parse_statistics(content: memoryview) -> Statistics:
    """Return the statistics."""
    fields = Fields(content)
    messages, _, _, _, _, chunks, start_ns, end_ns = _STATISTICS.unpack(fields.take(_STATISTICS.size))
    inner = Fields(fields.take(fields.u4()))
    counts: dict[int, int] = {}
    while inner.position < len(inner.view):
        channel_id = inner.u2()
        counts[channel_id] = inner.u8()
    fields.end()
    return Statistics(messages, chunks, start_ns, end_ns, counts)


def parse_footer(content: memoryview) -> tuple[int, int]:
    """Return summary start (0: none) and summary checksum (0: none)."""
    if len(content) != _FOOTER.size:
        raise DamageError(f"a footer has {_FOOTER.size} bytes, not {len(content)}")
    start, _, crc = _FOOTER.unpack(content)
    return start, crc


def decompress(chunk: Chunk, *, need_crc: bool = False) -> memoryview:
    """Return the records of `chunk`, checked against its size and checksum; memory stays within its claimed size.

    Args:
        chunk: from `parse_chunk`.
        need_crc: whether a chunk without checksum (0) is refused.

    Raises:
        DamageError: size or checksum differ, or the data cannot be decompressed.
    """
    size = chunk.uncompressed_size
    if chunk.compression not in _DECOMPRESS:
        raise DamageError(f"unknown compression {chunk.compression!r}")
    data = _DECOMPRESS[chunk.compression](chunk.data, size)
    if len(data) != size:
        raise DamageError(f"a chunk holds {len(data)} bytes instead of {size}")
    if chunk.crc == 0 and need_crc:
        raise DamageError("a chunk carries no checksum")
    if chunk.crc not in (0, zlib.crc32(data)):
        raise DamageError("the checksum of a chunk does not fit its content")
    return memoryview(data)


def messages(records: memoryview, wanted: frozenset[int] | None) -> Iterator[RawMessage]:
    """Yield the messages of the wanted channels (None: of all) from decompressed, checked chunk content.

    Raises:
        DamageError: the content is not a sequence of records.
    """
    offset, stop = 0, len(records)
    unpack, head = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size
    skip = head - RECORD_HEAD.size
    while offset < stop:
        if offset + head <= stop and records[offset] == MESSAGE:
            _, length, channel_id, sequence, log_time, publish_time = unpack(records, offset)
            end = offset + RECORD_HEAD.size + length
            if length < skip or end > stop:
                raise DamageError(f"a message of {length} bytes does not fit its chunk")
            if wanted is None or channel_id in wanted:
                yield RawMessage(channel_id, sequence, log_time, publish_time, records[offset + head : end])
            offset = end
        else:
            _, _, offset = split(records, offset)


def count(records: memoryview, most: int) -> int:
    """Return how many records decompressed chunk content holds, or a number above `most` as soon as it is that many.

    Raises:
        DamageError: the content is not a sequence of records.
    """
    offset, stop, found = 0, len(records), 0
    unpack, head = RECORD_HEAD.unpack_from, RECORD_HEAD.size
    while offset < stop and found <= most:
        if offset + head > stop:
            raise DamageError(f"no whole record at byte {offset}")
        _, length = unpack(records, offset)
        offset += head + length
        found += 1
    if offset > stop:
        raise DamageError(f"a record ends {offset - stop} bytes behind its chunk")
    return found


def definitions(records: memoryview) -> Iterator[SchemaRecord | ChannelRecord]:
    """Yield schemas and channels in decompressed chunk content (or in a summary section).

    Raises:
        DamageError: the content is not a sequence of records.
    """
    offset = 0
    while offset < len(records):
        opcode, content, offset = split(records, offset)
        if opcode == SCHEMA:
            yield parse_schema(content)
        elif opcode == CHANNEL:
            yield parse_channel(content)


def _plain(data: Bytes, _size: int) -> Bytes:
    return data


def _unzstd(data: Bytes, size: int) -> Bytes:
    try:
        claimed = zstandard.get_frame_parameters(data).content_size
        if claimed not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise DamageError(f"a zstd frame claims {claimed} bytes, its chunk {size}")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    except zstandard.ZstdError as error:
        raise DamageError(f"a chunk cannot be decompressed: {error}") from error


def _unlz4(data: Bytes, size: int) -> Bytes:
    # the incremental decompressor never makes more than asked for, whatever size the frame claims
    decompressor = lz4.frame.LZ4FrameDecompressor()
    try:
        content: bytes = decompressor.decompress(data, max_length=size)
    except (RuntimeError, ValueError, EOFError) as error:
        raise DamageError(f"a chunk cannot be decompressed: {error}") from error
    return content


_DECOMPRESS: Final = {"": _plain, "zstd": _unzstd, "lz4": _unlz4}
