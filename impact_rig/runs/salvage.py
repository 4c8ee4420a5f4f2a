# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Walks through a damaged MCAP file: finds every record that is structurally whole, and says where nothing fits.

A record is believed only if its own lengths agree with each other and with the file. Where they do not, the walk looks
for the next place that is built like a chunk and goes on there; the content of a chunk is believed only if its checksum
fits. The work grows in proportion to the file, whatever it holds: the search never goes back, and a chunk whose content
is damaged is stepped over.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType

import attrs

from impact_rig.errors import RecordingError
from impact_rig.recording import records
from impact_rig.recording.records import RECORD_HEAD, DamageError
from impact_rig.system import budget
from impact_rig.system.budget import BudgetError
from impact_rig.system.files import open_regular

_CHUNK_FIXED = struct.Struct("<QQQII")  # times, size, checksum, length of the compression's name
_LONGEST_NAME = 16
_CHUNK_HEAD_BYTES = RECORD_HEAD.size + _CHUNK_FIXED.size + _LONGEST_NAME + 8
# opcode, length below 4 GiB, two times, size below 4 GiB, checksum, name of the compression
_CHUNK_PATTERN = re.compile(
    rb"\x06.{4}\x00{4}.{16}.{4}\x00{4}.{4}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4})", re.DOTALL
)
_PATTERN_BYTES = 64  # at least what the pattern can match
_FIRST_WINDOW_BYTES = 4096  # doubled until the next chunk is found: many damages do not read the same bytes many times
_LAST_WINDOW_BYTES = 8 * 2**20


@attrs.frozen
class Found:
    """A structurally whole record: opcode, place in the file and length with its head."""

    opcode: int
    offset: int
    length: int


@attrs.frozen
class Damage:
    """A part of a file that is lost.

    Attributes:
        file: name of the file.
        offset: where it begins [bytes].
        length: how long it is [bytes].
        reason: what does not fit.
    """

    file: str
    offset: int
    length: int
    reason: str


class DamagedFile:
    """A file that may be cut short or damaged anywhere, opened for salvage; a context manager.

    Raises:
        RecordingError: it cannot be opened or read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._fd = open_regular(path)
            self.size = os.fstat(self._fd).st_size
        except OSError as error:
            raise RecordingError(f"{path} cannot be opened: {error.strerror}") from error

    def __enter__(self) -> DamagedFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._fd)

    @property
    def fd(self) -> int:
        """The open file."""
        return self._fd

    def content(self, found: Found) -> memoryview:
        """Return the content of a record."""
        return memoryview(self._read(found.offset, found.length))[RECORD_HEAD.size :]

    def walk(self) -> Iterator[Found | Damage]:
        """Yield the records of the data section, and what lies between them where they do not follow each other."""
        position = 0
        if self._read(0, len(records.MAGIC)) == records.MAGIC:
            position = len(records.MAGIC)
        else:
            yield Damage(self.path.name, 0, min(len(records.MAGIC), self.size), "it does not begin like an MCAP file")
        while position < self.size:
            try:
                found = self._record_at(position)
            except DamageError as error:
                following = self._next_chunk(position + 1)
                yield Damage(self.path.name, position, following - position, str(error))
                position = following
                continue
            if found.opcode == records.DATA_END:
                return
            yield found
            position += found.length

    def _record_at(self, offset: int) -> Found:
        head = self._read(offset, _CHUNK_HEAD_BYTES)
        if len(head) < RECORD_HEAD.size:
            raise DamageError("the file ends inside a record")
        opcode, length = RECORD_HEAD.unpack_from(head)
        if length > self.size - offset - RECORD_HEAD.size:
            raise DamageError("the file ends inside a record, or the length of the record is damaged")
        try:
            budget.allow("bytes in a record", length, budget.CHUNK_BYTES + budget.MIB)
        except BudgetError as error:
            raise DamageError(str(error)) from error
        found = Found(opcode, offset, RECORD_HEAD.size + length)
        if opcode == records.CHUNK:
            _check_chunk_head(head, length)
        elif opcode in _CHECKS:
            _CHECKS[opcode](self.content(found))
        else:
            raise DamageError(f"no record of an MCAP data section has the opcode {opcode}")
        return found

    def _next_chunk(self, start: int) -> int:
        """Return the next offset from `start` that is built like a chunk; the file's size if there is none."""
        window, width = start, _FIRST_WINDOW_BYTES
        while window < self.size:
            data = self._read(window, width + _PATTERN_BYTES)
            position = 0
            while match := _CHUNK_PATTERN.search(data, position):
                if match.start() >= width:
                    break  # the next window sees it whole
                try:
                    return self._record_at(window + match.start()).offset
                except DamageError:
                    position = match.start() + 1
            window += width
            width = min(2 * width, _LAST_WINDOW_BYTES)
        return self.size

    def _read(self, offset: int, length: int) -> bytes:
        parts = []
        try:
            while length > 0 and (part := os.pread(self._fd, length, offset)):
                parts.append(part)
                offset += len(part)
                length -= len(part)
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be read at byte {offset}: {error.strerror}") from error
        return b"".join(parts)


def _check_chunk_head(head: bytes, length: int) -> None:
    fixed = _CHUNK_FIXED.size
    if length < fixed + 8 or len(head) < RECORD_HEAD.size + fixed + 8:
        raise DamageError("a chunk is too short")
    _, _, _, _, name_length = _CHUNK_FIXED.unpack_from(head, RECORD_HEAD.size)
    at = RECORD_HEAD.size + fixed + name_length
    if name_length > _LONGEST_NAME or at + 8 > len(head):
        raise DamageError("the name of a chunk's compression is too long")
    data_length = int.from_bytes(head[at : at + 8], "little")
    if data_length + fixed + name_length + 8 != length:
        raise DamageError("the lengths of a chunk contradict each other")


def _check_message(content: memoryview) -> None:
    records.Fields(content).take(22)


def _check_data_end(content: memoryview) -> None:
    fields = records.Fields(content)
    fields.u4()
    fields.end()


_CHECKS: Mapping[int, Callable[[memoryview], object]] = {
    records.HEADER: records.parse_header,
    records.SCHEMA: records.parse_schema,
    records.CHANNEL: records.parse_channel,
    records.MESSAGE: _check_message,
    records.MESSAGE_INDEX: records.parse_message_index,
    records.ATTACHMENT: records.parse_attachment,
    records.METADATA: records.parse_metadata,
    records.DATA_END: _check_data_end,
}
