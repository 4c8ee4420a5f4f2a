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
"""Strict reader of MCAP records, which checks each length and each checksum that it finds in a record.

The library `mcap` only parses the content of records here. Its own reader of files trusts the lengths in a file, so
damaged files could give wrong data, and hostile files could exhaust the memory. Source: the MCAP format specification,
version 0.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import Final, NamedTuple, TypeVar

import lz4.frame  # type: ignore[import-untyped]  # has no type stubs
import zstandard
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream

from impact_rig.errors import RecordingError
from impact_rig.system import budget

MAGIC: Final = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

RECORD_HEAD: Final = struct.Struct("<BQ")
CHUNK_HEAD: Final = struct.Struct("<QQQI")
MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
FOOTER_BYTES: Final = RECORD_HEAD.size + 20

Bytes = bytes | memoryview


class DamageError(RecordingError):
    """Error of a damaged recording: a record is truncated or malformed, or its checksum or index does not match."""


class UncheckedError(DamageError):
    """Error of a chunk that carries no checksum although the caller requires one."""


class RawMessage(NamedTuple):
    """Message as it is stored in a chunk, with times in ns.

    `data` is a view of the decompressed chunk. `offset` is the position at which the message's record begins in the
    decompressed chunk [bytes], as in a message index of MCAP.
    """

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: memoryview
    offset: int


class _Strict(ReadDataStream):
    """Stream from which the library `mcap` reads the fields of one record, without copies.

    `view` is the content of the record. A field that is longer than the remaining record raises a DamageError.
    """

    def __init__(self, view: memoryview) -> None:
        super().__init__(io.BytesIO())
        self._view = view

    def read(self, length: int) -> memoryview:  # type: ignore[override]  # the callers accept both types
        """Return the next `length` bytes of the record.

        Raises:
            DamageError: fewer bytes are left.
        """
        left = len(self._view) - self._count
        if length > left:
            raise DamageError(f"a field of {length} bytes does not fit into the {left} bytes left of its record")
        self._count += length
        return self._view[self._count - length : self._count]


Record = TypeVar("Record", bound=mcap_records.McapRecord)


def parse(kind: type[Record], content: memoryview) -> Record:
    """Parse the content of a record into an object of the class `kind`.

    The content is the bytes after the opcode and length of the record. Binary fields of the result are views of
    `content`, not copies.

    Raises:
        DamageError: a field does not fit into the content, a string is not UTF-8, or bytes follow the last field.
    """
    stream = _Strict(content)
    try:
        record: Record = kind.read(stream)  # type: ignore[attr-defined]  # all kinds have it, but not their base class
    except UnicodeDecodeError as error:
        raise DamageError(f"a string of a {kind.__name__} record is not UTF-8: {error}") from error
    if stream.count != len(content):
        raise DamageError(f"a {kind.__name__} record has {len(content) - stream.count} bytes after its last field")
    return record


def attachment_crc(content: memoryview) -> bool | None:
    """Return whether the checksum of an attachment record matches; None if the record carries no checksum.

    `content` is the content of the record. Its last 4 bytes are the checksum of the bytes before them; 0 means no
    checksum.
    """
    crc = int.from_bytes(content[-4:], "little")
    return zlib.crc32(content[:-4]) == crc if crc else None


def split(view: memoryview, offset: int) -> tuple[int, memoryview, int]:
    """Return opcode, content and end offset of the MCAP record at `offset` of `view`.

    Raises:
        DamageError: the record, or its head of 9 bytes, ends after the end of `view`.
    """
    stop = len(view)
    if offset + RECORD_HEAD.size > stop:
        raise DamageError(f"no complete record at byte {offset} of a chunk or index")
    opcode, length = RECORD_HEAD.unpack_from(view, offset)
    start = offset + RECORD_HEAD.size
    if length > stop - start:
        raise DamageError(
            f"the record at byte {offset} of a chunk or index states {length} bytes, only {stop - start} are left"
        )
    return opcode, view[start : start + length], start + length


def decompress(chunk: mcap_records.Chunk, *, need_crc: bool = False) -> memoryview:
    """Return the decompressed records of a chunk, checked against the size and checksum that the chunk states.

    Decompression never needs more memory than the stated size and one byte. A chunk without a checksum is accepted,
    unless `need_crc` is True.

    Raises:
        DamageError: size or checksum differ, the compression is unknown, or the data cannot be decompressed.
        UncheckedError: `need_crc` is True, and the chunk has no checksum.
    """
    size = chunk.uncompressed_size
    if chunk.compression not in _DECOMPRESS:
        raise DamageError(f"a chunk has the unknown compression {chunk.compression!r}; known are none, zstd and lz4")
    data = _DECOMPRESS[chunk.compression](chunk.data, size)
    if len(data) != size:
        raise DamageError(f"a chunk holds {len(data)} decompressed bytes instead of the {size} that it states")
    if chunk.uncompressed_crc == 0 and need_crc:
        raise UncheckedError("a chunk carries no checksum")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise DamageError("the checksum of a chunk does not match its content")
    return memoryview(data)


ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
"""First bytes of a zstd frame; a CDR message begins with 00."""


UNSTATED_BYTES = 2**30  # limit for a zstd frame that does not state its size: so much is allocated to decompress it


def plain_message(data: memoryview, most: int) -> memoryview:
    """Return the CDR bytes of a message, decompressed if the recorder compressed each message on its own with zstd.

    Args:
        data: message in CDR, which is returned unchanged, or a zstd frame that contains such a message.
        most: largest decompressed size [bytes], at most 1 GiB for a frame that does not state its size. The size of a
            message that is not compressed is not limited.

    Raises:
        DamageError: the message cannot be decompressed, or its decompressed size is larger than `most`.
    """
    if bytes(data[:4]) != ZSTD_MAGIC:
        return data
    try:
        claimed = zstandard.get_frame_parameters(data).content_size
        if claimed != zstandard.CONTENTSIZE_UNKNOWN and claimed > most:
            raise DamageError(
                f"a compressed message states a size of {claimed} bytes, the limit is {most} bytes; if you trust the "
                f"source, set the environment variable {budget.VARIABLE}=N to allow N times the default"
            )
        content = zstandard.ZstdDecompressor().decompress(data, max_output_size=min(most, UNSTATED_BYTES))
    except zstandard.ZstdError as error:
        raise DamageError(f"a compressed message cannot be decompressed: {error}") from error
    return memoryview(content)


def messages(records: memoryview, wanted: frozenset[int] | None) -> Iterator[RawMessage]:
    """Yield the messages of the wanted channels from the decompressed, checked content of a chunk.

    `wanted` contains the ids of these channels; None means all channels.

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
            if length >= skip and end <= stop:
                if wanted is None or channel_id in wanted:
                    yield RawMessage(channel_id, sequence, log_time, publish_time, records[offset + head : end], offset)
                offset = end
                continue
        opcode, content, offset = split(records, offset)
        if opcode == MESSAGE:
            raise DamageError(f"a message record of {len(content)} bytes is too short: it needs at least {skip}")


def count(records: memoryview, most: int) -> int:
    """Return the number of records in the decompressed content of a chunk, but at most `most` + 1.

    A result of `most` + 1 means that there are more than `most` records.

    Raises:
        DamageError: the content is not a sequence of records.
    """
    offset, stop, found = 0, len(records), 0
    unpack, head = RECORD_HEAD.unpack_from, RECORD_HEAD.size
    while offset < stop and found <= most:
        if offset + head > stop:
            raise DamageError(f"no complete record at byte {offset} of a chunk")
        _, length = unpack(records, offset)
        offset += head + length
        found += 1
    if offset > stop:
        raise DamageError(f"a record ends {offset - stop} bytes after the end of its chunk")
    return found


def definitions(records: memoryview) -> Iterator[mcap_records.Schema | mcap_records.Channel]:
    """Yield the schemas and channels that the decompressed content of a chunk (or a summary section) defines.

    Raises:
        DamageError: the content is not a sequence of records.
    """
    offset = 0
    while offset < len(records):
        opcode, content, offset = split(records, offset)
        if opcode == SCHEMA:
            yield parse(mcap_records.Schema, content)
        elif opcode == CHANNEL:
            yield parse(mcap_records.Channel, content)


def _plain(data: Bytes, _size: int) -> Bytes:
    return data


def _unzstd(data: Bytes, size: int) -> Bytes:
    try:
        claimed = zstandard.get_frame_parameters(data).content_size
        if claimed not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise DamageError(f"a zstd frame states a size of {claimed} bytes, its chunk states {size}")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    except zstandard.ZstdError as error:
        raise DamageError(f"a chunk cannot be decompressed: {error}") from error


def _unlz4(data: Bytes, size: int) -> Bytes:
    # the incremental decompressor never produces more than requested, whatever size the frame claims
    decompressor = lz4.frame.LZ4FrameDecompressor()
    try:
        content: bytes = decompressor.decompress(data, max_length=size + 1)  # one more shows a surplus
    except (RuntimeError, ValueError, EOFError) as error:
        raise DamageError(f"a chunk cannot be decompressed: {error}") from error
    if len(content) > size or not decompressor.eof:
        raise DamageError(f"a chunk cannot be decompressed: its lz4 frame is cut off or exceeds {size} bytes")
    return content


_DECOMPRESS: Final = {"": _plain, "zstd": _unzstd, "lz4": _unlz4}
