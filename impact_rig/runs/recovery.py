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
"""Recovery of the intact messages of a damaged run, as a new run with complete index and statistics.

By default only chunks of messages, attachments and metadata with a matching checksum are recovered, so everything in
the new run is as it was recorded. Losses are listed, and counted as far as possible.

A damaged file is read record by record (`DamagedFile`). A record is accepted only if its lengths agree with each other
and with the size of the file. Otherwise, the search continues at the next position that looks like a chunk, an
attachment or a metadata record. The search never goes back, so its work is proportional to the size of the file.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from pathlib import Path

import attrs
from mcap import records as mcap_records
from mcap.records import Statistics

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.errors import CodecError, RecordingError
from impact_rig.recording import description, digests, losses, reader, records
from impact_rig.recording.description import Attachment, Extent, Provenance, TopicDescription
from impact_rig.recording.losses import check_contiguity, scan_rate_hz
from impact_rig.recording.reader import Run, mcap_files, run_files
from impact_rig.recording.records import RECORD_HEAD, DamageError, RawMessage, UncheckedError
from impact_rig.recording.rigs import prefix_of
from impact_rig.recording.writer import FOLLOWS, TAIL_RECORD_NAME, TAIL_SUFFIX, RunWriter, tail_of
from impact_rig.simtime import NS_PER_S
from impact_rig.system import budget, files
from impact_rig.system.budget import BudgetError, ReadBudget
from impact_rig.system.endings import defer_signals

_CHUNK_FIXED = struct.Struct("<QQQII")  # times, size, checksum, length of the compression's name
_LONGEST_NAME = 16
_CHUNK_HEAD_BYTES = RECORD_HEAD.size + _CHUNK_FIXED.size + _LONGEST_NAME + 8
# opcode, length below 4 GiB, two times, size below 4 GiB, checksum, name of the compression
_RECORD_PATTERN = re.compile(
    rb"\x06.{4}\x00{4}.{16}.{4}\x00{4}.{4}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4})"
    # opcode, length below 16 MiB, name of metadata that this package writes
    rb"|\x0c.{3}\x00{5}[\x07-\x40]\x00{3}(?:rosbag2|impact_rig)"
    # opcode, length below 4 GiB, two times, length of a short name and its first letter
    rb"|\x09.{4}\x00{4}.{16}[\x01-\x7f]\x00{3}[!-~]",
    re.DOTALL,
)
_PATTERN_BYTES = 64  # at least the longest possible match of the pattern
# bytes that the search reads at once: few at first, so that many damaged parts do not cause repeated reads of the same
# bytes; doubled until the next record is found
_FIRST_WINDOW_BYTES = 4096
_LAST_WINDOW_BYTES = 8 * 2**20


@attrs.frozen
class Found:
    """Position of a structurally valid MCAP record: opcode, offset in the file, and length with its head [bytes]."""

    opcode: int
    offset: int
    length: int


@attrs.frozen
class Damage:
    """Part of a file that cannot be recovered: name of the file, offset and length [bytes], and the reason.

    A length of 0 means that the damage is no part of the file: for example, one topic or `metadata.yaml` is unusable.
    """

    file: str
    offset: int
    length: int
    reason: str


class DamagedFile:
    """MCAP file that may be truncated or damaged anywhere, opened for recovery; a context manager.

    Raises:
        RecordingError: the file cannot be opened or read, is a bag in SQLite, or is compressed as a whole.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with files.translate_errors(f"cannot open {path}"):
            self.fd = files.open_regular(path)
            self.size = os.fstat(self.fd).st_size
        try:
            reader.refuse_foreign(self.fd)
        except RecordingError as error:
            os.close(self.fd)
            raise RecordingError(f"{path}: {error}") from error

    def __enter__(self) -> DamagedFile:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self.fd)

    def read(self, found: Found) -> bytes:
        """Return all bytes of a record that `walk` has found, with its head (opcode and length)."""
        return self._read(found.offset, found.length)

    def content(self, found: Found) -> memoryview:
        """Return the content of a record that `walk` has found, without its head."""
        return memoryview(self.read(found))[RECORD_HEAD.size :]

    def walk(self) -> Iterator[Found | Damage]:
        """Yield the positions of the records of the data section, and the damaged parts between, in file order.

        The records are structurally valid; checksums and the contents of chunks are not checked. The iteration ends at
        the DataEnd record, which is not yielded, or at the end of the file.
        """
        position = 0
        if self._read(0, len(records.MAGIC)) == records.MAGIC:
            position = len(records.MAGIC)
        else:
            yield Damage(self.path.name, 0, min(len(records.MAGIC), self.size), "it does not begin like an MCAP file")
        while position < self.size:
            try:
                found = self._record_at(position)
            except DamageError as error:
                following = self._next_record(position + 1)
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
            raise DamageError("the file ends inside this record")
        opcode, length = RECORD_HEAD.unpack_from(head)
        if length > self.size - offset - RECORD_HEAD.size:
            raise DamageError("the file ends inside this record, or its length is damaged")
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
            raise DamageError(f"the type of this record is {opcode}, which no MCAP record with data has")
        return found

    def _next_record(self, start: int) -> int:
        """Return the offset of the next chunk, attachment or metadata record from `start` on; else the file size.

        The lengths of the record are consistent. Only metadata records of this package and of rosbag2 are found.
        """
        window, width = start, _FIRST_WINDOW_BYTES
        while window < self.size:
            data = self._read(window, width + _PATTERN_BYTES)
            position = 0
            while match := _RECORD_PATTERN.search(data, position):
                if match.start() >= width:
                    break  # the next window contains the whole match
                try:
                    return self._record_at(window + match.start()).offset
                except DamageError:
                    position = match.start() + 1
            window += width
            width = min(2 * width, _LAST_WINDOW_BYTES)
        return self.size

    def _read(self, offset: int, length: int) -> bytes:
        parts = []
        with files.translate_errors(f"cannot read {self.path} at byte {offset}"):
            while length > 0 and (part := os.pread(self.fd, length, offset)):
                parts.append(part)
                offset += len(part)
                length -= len(part)
        return b"".join(parts)


def _check_chunk_head(head: bytes, length: int) -> None:
    fixed = _CHUNK_FIXED.size
    if length < fixed + 8 or len(head) < RECORD_HEAD.size + fixed + 8:
        raise DamageError(f"a chunk of {length} bytes is too short: it needs at least {fixed + 8}")
    _, _, _, _, name_length = _CHUNK_FIXED.unpack_from(head, RECORD_HEAD.size)
    at = RECORD_HEAD.size + fixed + name_length
    if name_length > _LONGEST_NAME or at + 8 > len(head):
        most = min(_LONGEST_NAME, len(head) - RECORD_HEAD.size - fixed - 8)
        raise DamageError(f"the name of a chunk's compression must have at most {most} bytes, got {name_length}")
    data_length = int.from_bytes(head[at : at + 8], "little")
    if data_length + fixed + name_length + 8 != length:
        room = length - fixed - name_length - 8
        raise DamageError(f"a chunk states {data_length} bytes of messages, but its record has {room} bytes for them")


def _check_message(content: memoryview) -> None:
    if len(content) < records.MESSAGE_HEAD.size - RECORD_HEAD.size:
        least = records.MESSAGE_HEAD.size - RECORD_HEAD.size
        raise DamageError(f"a message record of {len(content)} bytes is too short: it needs at least {least}")


def _check_message_index(content: memoryview) -> None:
    length = int.from_bytes(content[2:6], "little")
    if len(content) != 6 + length or length % 16:
        raise DamageError(f"a message index of {len(content)} bytes does not consist of complete entries")


_CHECKS: Mapping[int, Callable[[memoryview], object]] = {
    records.MESSAGE: _check_message,
    records.MESSAGE_INDEX: _check_message_index,
    **{
        opcode: functools.partial(records.parse, kind)
        for opcode, kind in (
            (records.HEADER, mcap_records.Header),
            (records.SCHEMA, mcap_records.Schema),
            (records.CHANNEL, mcap_records.Channel),
            (records.ATTACHMENT, mcap_records.Attachment),
            (records.METADATA, mcap_records.Metadata),
            (records.DATA_END, mcap_records.DataEnd),
        )
    },
}


_MAX_LISTED, _MAX_SHOWN = 1000, 5  # damaged parts in a report, and their reasons in an error
ACCEPT = "--accept-unchecked"


@attrs.define
class _Blocks:
    """Recovered blocks of scans of one rig, for the durations of recovered and missing scans."""

    _found: list[tuple[int, int]] = attrs.field(factory=list)  # stamp [ns] and number of scans of each block
    _rate_hz: float | None = None

    def add(self, table: Table) -> None:
        """Count a recovered block of scans, to find gaps between blocks; add them in the order of recording."""
        self._found.append((table.stamp_ns, len(table.rows)))
        self._rate_hz = self._rate_hz or scan_rate_hz(table)

    @property
    def seconds(self) -> float:
        """Duration of the recovered scans [s of rig time]; 0 if their rate is unknown."""
        return sum(length for _, length in self._found) / self._rate_hz if self._rate_hz else 0.0

    @property
    def missing_s(self) -> float:
        """Duration of the scans missing between the recovered blocks [s of rig time]; 0 if their rate is unknown."""
        return check_contiguity(self._found, self._rate_hz).lost_scans / self._rate_hz if self._rate_hz else 0.0


@attrs.define
class FileReport:
    """Report of what was recovered from one damaged file and its tail, and what was not."""

    name: str
    size: int
    chunks: int = 0  # number of intact chunks that contained recovered messages
    expected: Statistics | None = None  # statistics of the file's index; None without a credible index
    lost_bytes: int = 0  # number of bytes left out
    _scans: dict[str, _Blocks] = attrs.field(factory=dict)  # blocks of each rig, by topic
    _found: Extent = attrs.field(factory=Extent)

    def count(self, topic: TopicDescription, message: RawMessage) -> None:
        """Count a recovered message, and its scans if it is a block of scans."""
        self._found.add(message.log_time)
        if prefix_of(topic.name, topics.SCAN) is not None:
            with contextlib.suppress(CodecError):
                self._scans.setdefault(topic.name, _Blocks()).add(codec.decode(message.data))

    @property
    def messages(self) -> int:
        """Number of messages recovered from the file and its tail, the file with the messages of its open chunk."""
        return self._found.count

    @property
    def missing_messages(self) -> int | None:
        """Number of messages in the file, according to its index, that were not recovered; None without an index."""
        return None if self.expected is None else max(0, self.expected.message_count - self.messages)

    @property
    def given_s(self) -> float:
        """Duration of the recovered scans [s of rig time]; with several rigs, the longest."""
        return max((one.seconds for one in self._scans.values()), default=0.0)

    @property
    def missing_s(self) -> float | None:
        """Duration of the scans that are missing before, between and after the recovered ones [s of rig time].

        The durations before and after follow from the first and last log time in the index, which count as rig time.
        Gaps between recovered scans count as 0 if the scan rate is unknown. The result is None without an index.
        """
        if self.expected is None:
            return None
        if not self.messages:
            return (self.expected.message_end_time - self.expected.message_start_time) / NS_PER_S
        expected, found = self.expected, self._found
        outside = found.start_ns - expected.message_start_time + expected.message_end_time - found.end_ns
        inside = max((one.missing_s for one in self._scans.values()), default=0.0)
        return inside + max(0, outside) / NS_PER_S


@attrs.define
class RecoverReport:
    """Report of a recovery: what `recover` wrote to the new run, and what was damaged."""

    directory: Path
    files: list[FileReport] = attrs.field(factory=list)
    damages: list[Damage] = attrs.field(factory=list)  # damaged parts and reasons, in order (at most 1000)
    damage_count: int = 0
    account: ReadBudget = attrs.field(factory=lambda: ReadBudget(0), repr=False)

    @property
    def messages(self) -> int:
        """Number of recovered messages, in all files."""
        return sum(file.messages for file in self.files)

    @property
    def chunks(self) -> int:
        """Number of intact chunks from which messages were recovered, in all files and their tails."""
        return sum(file.chunks for file in self.files)

    @property
    def expected_messages(self) -> int | None:
        """Number of messages in the undamaged run, according to the indexes of its files; None if a file has none."""
        counts = [None if file.expected is None else file.expected.message_count for file in self.files]
        known = [count for count in counts if count is not None]
        return sum(known) if len(known) == len(counts) else None

    @property
    def missing_messages(self) -> int | None:
        """Number of messages, according to the indexes of the files, not recovered; None if a file has no index."""
        return None if self.expected_messages is None else max(0, self.expected_messages - self.messages)

    @property
    def lost_bytes(self) -> int:
        """Size of the damaged parts that were left out [bytes]."""
        return sum(file.lost_bytes for file in self.files)

    @property
    def complete(self) -> bool:
        """Return whether nothing is known to be missing.

        An unfinished run without damage also counts as complete.
        """
        return self.damage_count == 0 and not self.missing_messages

    def file(self, path: Path) -> FileReport:
        """Add an empty report for a damaged file and return it."""
        found = FileReport(path.name, path.stat().st_size)
        self.files.append(found)
        return found

    def note(self, damage: Damage) -> None:
        """Count a damaged part, list it here if it is one of the first 1000, and add its size to its file's report."""
        self.damage_count += 1
        for file in self.files:
            if file.name == damage.file.removesuffix(TAIL_SUFFIX):
                file.lost_bytes += damage.length
        if len(self.damages) < _MAX_LISTED:
            self.damages.append(damage)

    def heal(self, file: str, offset: int) -> None:
        """Remove the damage at `offset` of a file from the report, because the file's tail has the lost messages."""
        for damage in self.damages:
            if (damage.file, damage.offset) == (file, offset):
                self.damages.remove(damage)
                self.damage_count -= 1
                for report in self.files:
                    if report.name == file:
                        report.lost_bytes -= damage.length
                return


RECORD_NAME = "impact_rig/recovered"  # metadata record of a recovered run


@attrs.frozen
class Recovered:
    """Losses of a recovery, stored as a metadata record in the new run."""

    source: str  # name of the damaged run
    damages: int  # number of damaged parts
    lost_bytes: int  # their size [bytes]
    missing_messages: int | None
    """Number of messages, according to the index of the damaged run, that were not recovered; None without an index."""
    unfinished: bool  # whether a file of the damaged run has no index, so that its original content is unknown

    @property
    def incomplete(self) -> bool:
        """Return whether anything of the damaged run is known to be missing in the recovered one."""
        return self.damages > 0 or bool(self.missing_messages)

    def to_record(self) -> dict[str, str]:
        """Return the content of the metadata record `RECORD_NAME`: each attribute of these losses as text, by name."""
        missing = "" if self.missing_messages is None else self.missing_messages
        content = {**attrs.asdict(self), "missing_messages": missing, "unfinished": int(self.unfinished)}
        return {name: str(value) for name, value in content.items()}


def read_record(record: Mapping[str, str]) -> Recovered | None:
    """Return the losses of a recovery from the content of the metadata record `RECORD_NAME` of a run.

    The result is None if the content is empty, which means that no recovery wrote the run.

    Raises:
        DamageError: the record is invalid.
    """
    if not record:
        return None
    try:
        missing = int(record["missing_messages"]) if record["missing_messages"] else None
        counts = int(record["damages"]), int(record["lost_bytes"])
        return Recovered(record["source"], *counts, missing, record["unfinished"] == "1")
    except (KeyError, ValueError) as error:
        why = f"it has no entry {error}"
        if isinstance(error, ValueError):
            found = ", ".join(repr(record.get(name)) for name in ("missing_messages", "damages", "lost_bytes"))
            why = f"missing_messages, damages and lost_bytes must be whole numbers, got {found}"
        raise DamageError(
            f"the metadata record {RECORD_NAME!r}, the losses of the recovery that wrote this run, is invalid: {why}; "
            "impact-rig recover writes the same messages to a new run, which does not state these losses"
        ) from error


def is_cut_short(run: Run) -> bool:
    """Return whether a run was recovered from a file without a usable index, so that its end may be incomplete.

    A killed recorder leaves such a file. Other messages from the time of the last scans may be missing, because they
    can arrive later than scans.

    Raises:
        DamageError: the record of the recovery is invalid.
    """
    try:
        recovered = read_record(run.record(RECORD_NAME))
    except DamageError as error:
        raise DamageError(f"{run.path}: {error}") from error
    return recovered is not None and recovered.unfinished


def recover(path: Path | str, out: Path | str, *, accept_unchecked: bool = False) -> RecoverReport:
    """Write the messages of every intact chunk of a damaged or unfinished run to the new run directory `out`.

    Attachments and metadata that match their checksums are written as well. If the recorder was killed while a chunk
    was open, the messages of this chunk are taken from its tail, the file `*.mcap.tail`. A chunk or message that
    exceeds a limit of reading is left out as damaged.

    Args:
        path: a run directory or an MCAP file; it is only read.
        out: the new run directory; must not contain a recording.
        accept_unchecked: whether to accept chunks, messages outside chunks, attachments and metadata without a
            checksum. rosbag2 writes none by default. Damage in such parts is not detected.

    Returns:
        The report: the counts of recovered and missing messages, and each damaged part (at most 1000) with the
        reason.

    Raises:
        RecordingError: no message can be recovered (then nothing is written), `path` cannot be read, or `out` cannot be
            written.
        ImpactRigError: `metadata.yaml` exceeds a limit of reading, and there is no MCAP file.
    """
    source, target = Path(path), Path(out)
    report = RecoverReport(target)
    files = _files(source, report)
    report.account = ReadBudget(_bytes(files))
    salvages = [_Salvage(file, report, accept_unchecked=accept_unchecked) for file in files]
    origin = next((salvage.provenance for salvage in salvages if salvage.provenance is not None), None)
    attachments: dict[str, Attachment] = {}  # of several attachments with one name, the first: that of the run's start
    for one in itertools.chain.from_iterable(salvage.attachments for salvage in salvages):
        attachments.setdefault(one.name, one)
    earlier = next((salvage.recovered for salvage in reversed(salvages) if salvage.recovered is not None), None)
    accounts = [salvage.losses for salvage in salvages if salvage.losses]
    largest = max(file.stat().st_size for file in files) if len(files) > 1 else 0
    writer: RunWriter | None = None
    try:
        for salvage in salvages:
            for topic, message in salvage.messages():
                if writer is None:
                    writer = RunWriter(
                        target,
                        provenance=origin,
                        attachments=attachments.values(),
                        clock=lambda: 0.0,  # chunks are closed by size only
                        max_file_bytes=largest,
                        closing=lambda: {
                            **{name: one for salvage in salvages for name, one in salvage.metadata.items()},
                            losses.RECORD_NAME: accounts[-1] if accounts else {},
                            RECORD_NAME: _record(source, report, earlier).to_record(),
                        },
                    )
                    for known in salvages:
                        known.introduce_topics(writer)
                if not salvage.introduce(topic, writer):
                    continue
                writer.write_at(
                    topic.name, bytes(message.data), message.log_time, message.publish_time, message.sequence
                )
                salvage.figures.count(topic, message)
    finally:
        if writer is not None:
            with defer_signals():
                writer.finish()
    if writer is None:
        reasons = [*dict.fromkeys(damage.reason for damage in report.damages)] or ["it holds no messages"]
        more = f"; and {len(reasons) - _MAX_SHOWN} more reasons" if len(reasons) > _MAX_SHOWN else ""
        shown = [f"({i}) {one}" if len(reasons) > 1 else one for i, one in enumerate(reasons[:_MAX_SHOWN], 1)]
        raise RecordingError(f"no message can be recovered from {source}: {'; '.join(shown)}{more}")
    return report


def _record(source: Path, report: RecoverReport, earlier: Recovered | None) -> Recovered:
    """Return the losses of this recovery, plus those of an earlier recovery that wrote the damaged run.

    `earlier` is None if the damaged run was not written by a recovery.
    """
    before = earlier or Recovered(source.name, 0, 0, 0, unfinished=False)
    missing, missed = report.missing_messages, before.missing_messages
    return Recovered(
        source=source.name,
        damages=before.damages + report.damage_count,
        lost_bytes=before.lost_bytes + report.lost_bytes,
        missing_messages=None if missing is None or missed is None else missed + missing,
        unfinished=before.unfinished or report.expected_messages is None,
    )


def _files(path: Path, report: RecoverReport) -> list[Path]:
    """Return the MCAP files to recover: `path` itself if it is a file, or the files that its `metadata.yaml` lists.

    If `metadata.yaml` is missing, cannot be read or lists a missing file, the result is all MCAP files in the
    directory, in the order of the numbers in their names. Except for a missing `metadata.yaml`, the report then lists a
    damage.

    Raises:
        RecordingError: there is no MCAP file.
        BudgetError: there is none, and `metadata.yaml` is too large.
    """
    try:
        return run_files(path)
    except (RecordingError, BudgetError) as error:
        # `metadata.yaml` of a damaged run may be damaged as well, so the existing files count
        files = mcap_files(path)
        if not files:
            raise
        report.note(Damage(path.name, 0, 0, str(error)))
        return files


def _bytes(files: Iterable[Path]) -> int:
    """Return the size of MCAP files and of their tails together [bytes]."""
    return sum(path.stat().st_size for file in files for path in (file, tail_of(file)) if path.exists())


_Key = tuple[int, int, int, int, int]


def _key(message: records.RawMessage) -> _Key:
    """Return a key by which to recognise the same message in a chunk and in a tail."""
    return message.channel_id, message.sequence, message.log_time, message.publish_time, zlib.crc32(message.data)


_OWN_RECORDS = (
    description.RECORD_NAME,
    description.TOPIC_RECORD_NAME,
    losses.RECORD_NAME,
    RECORD_NAME,
    TAIL_RECORD_NAME,
    digests.RECORD_NAME,
)
"""Names of the metadata records of this package; each carries a checksum under a key of its content."""


class _Salvage:
    """Recovery of one damaged file.

    The constructor reads topics, attachments and metadata. The method `messages` reads the messages.

    Args:
        path: the damaged MCAP file, or the tail of one (`writer.Tail`).
        report: report to which damage is added.
        accept_unchecked: whether to accept chunks, messages, attachments and metadata without a checksum.
        figures: report of the file, which counts its chunks and messages; None means a new one, added to `report`.
        topics: topics that are already known, by channel id.
    """

    def __init__(
        self,
        path: Path,
        report: RecoverReport,
        *,
        accept_unchecked: bool,
        figures: FileReport | None = None,
        topics: Mapping[int, TopicDescription] | None = None,
    ) -> None:
        self.path = path
        self.attachments: list[Attachment] = []
        self.metadata: dict[str, dict[str, str]] = {}  # records of other programs, by name
        self.follows: int | None = None
        """Size that the recording had when the open chunk began that this tail contains [bytes].

        It is None if the file is no tail, or a tail that does not state it.
        """
        self.provenance: Provenance | None = None
        self.losses: dict[str, str] = {}
        self.recovered: Recovered | None = None
        self.figures = figures or report.file(path)
        self._report = report
        self._accept_unchecked = accept_unchecked
        self._schemas: dict[int, mcap_records.Schema] = {}
        self._topics: dict[int, TopicDescription] = dict(topics or {})
        with DamagedFile(path) as file:
            self._read_summary(file)
            for found in file.walk():
                if isinstance(found, Damage):
                    report.note(found)
                elif found.opcode == records.ATTACHMENT:
                    self._take_attachment(file, found)
                elif found.opcode == records.METADATA:
                    self._take_metadata(file, found)
                elif found.opcode in (records.SCHEMA, records.CHANNEL) and accept_unchecked:
                    try:
                        for definition in records.definitions(memoryview(file.read(found))):
                            self._define(definition)
                    except BudgetError as error:
                        report.note(self._damage(found, str(error)))
                elif found.opcode == records.MESSAGE and not accept_unchecked:
                    reason = f"a message outside a chunk carries no checksum ({ACCEPT} accepts it)"
                    report.note(self._damage(found, reason))

    def introduce_topics(self, writer: RunWriter) -> None:
        """Register the topics of this file in the writer of the new run, in the order of their channel ids.

        Only topics that are known so far are registered.
        """
        for _, topic in sorted(self._topics.items()):
            self.introduce(topic, writer)

    def introduce(self, topic: TopicDescription, writer: RunWriter) -> bool:
        """Register a topic in the writer of the new run; return whether its messages can be written.

        The result is False if the topic is already registered with another type. The report then lists a damage.
        """
        try:
            writer.add_topic(topic)
        except RecordingError:
            if writer.closed:
                raise
            reason = f"topic {topic.name} occurs with two types: messages of type {topic.type_name} are left out"
            self._report.note(Damage(self.path.name, 0, 0, reason))
            return False
        return True

    def messages(self) -> Iterator[tuple[TopicDescription, records.RawMessage]]:
        """Yield the messages of all intact chunks in file order, then those of the open chunk from the tail.

        Messages outside chunks, which carry no checksum, are included only with `accept_unchecked`.
        """
        last = -1  # offset of the last intact chunk
        newest: set[_Key] = set()  # messages in the last intact chunk
        has_tail = os.path.lexists(tail_of(self.path))
        with DamagedFile(self.path) as file:
            for found in file.walk():
                if isinstance(found, Found) and found.opcode == records.CHUNK:
                    chunks, held = self.figures.chunks, []
                    for topic, message in self._messages(file, found):
                        held += [_key(message)] if has_tail else []
                        yield topic, message
                    if self.figures.chunks > chunks:
                        last, newest = found.offset, set(held)
                elif isinstance(found, Found) and found.opcode == records.MESSAGE and self._accept_unchecked:
                    yield from self._messages(file, found)
        if has_tail:
            yield from self._open_chunk(last, newest)

    def _open_chunk(self, last: int, newest: Set[_Key]) -> Iterator[tuple[TopicDescription, records.RawMessage]]:
        """Yield the messages of the tail, unless the recording contains them already.

        The tail is a file next to the recording (`*.mcap.tail`) with the messages of the chunk that was still open.
        Normally it states the size of the recording when this chunk began. If an intact chunk begins there or later,
        the chunk was completed, and the recording contains its messages. If the tail does not state this size, its
        first message is searched in the last intact chunk instead.

        Args:
            last: offset of the last intact chunk of the recording; -1 if there is none.
            newest: keys of the messages in that chunk.
        """
        tail = tail_of(self.path)
        try:
            found = _Salvage(tail, RecoverReport(self._report.directory), accept_unchecked=False, topics=self._topics)
            if found.follows is None:
                first = next(found.messages(), None)
                superfluous = first is not None and _key(first[1]) in newest
            else:
                superfluous = found.follows <= last
            if superfluous:
                return
            if found.follows is not None:
                # the chunk itself may have been cut off while it was written
                self._report.heal(self.path.name, self._chunk_from(found.follows))
            yield from _Salvage(
                tail, self._report, accept_unchecked=False, figures=self.figures, topics=self._topics
            ).messages()
        except RecordingError as error:
            self._report.note(Damage(tail.name, 0, 0, str(error)))

    def _chunk_from(self, follows: int) -> int:
        """Return the offset of the first chunk, intact or not, from byte `follows` on; `follows` if there is none."""
        with DamagedFile(self.path) as file:
            for found in file.walk():
                if found.offset >= follows and os.pread(file.fd, 1, found.offset) == bytes([records.CHUNK]):
                    return found.offset
        return follows

    def _messages(self, file: DamagedFile, found: Found) -> Iterator[tuple[TopicDescription, records.RawMessage]]:
        """Yield topic and message for each message in a chunk, or for one message outside chunks.

        If the chunk or the message cannot be read or exceeds a limit, nothing is yielded, and the report lists a
        damage.
        """
        is_chunk = found.opcode == records.CHUNK
        try:
            content = self._records(file, found) if is_chunk else memoryview(file.read(found))
            known = list(self._unpack(found, content))
        except (DamageError, BudgetError) as error:
            unchecked = isinstance(error, UncheckedError)
            more = f", so its messages are left out ({ACCEPT} accepts it)" if unchecked else ""
            self._report.note(self._damage(found, f"{error}{more}"))
            return
        self.figures.chunks += is_chunk
        yield from known

    def _records(self, file: DamagedFile, found: Found) -> memoryview:
        """Return the decompressed records of a chunk, and store the topics that they define.

        Raises:
            DamageError: the chunk cannot be read, or lacks a required checksum.
            BudgetError: the chunk exceeds a limit.
        """
        chunk = records.parse(mcap_records.Chunk, file.content(found))
        self._report.account.chunk(chunk.uncompressed_size)
        content = records.decompress(chunk, need_crc=not self._accept_unchecked)
        self._report.account.records(records.count(content, most=len(content)))
        for definition in records.definitions(content):
            self._define(definition)
        return content

    def _unpack(self, found: Found, content: memoryview) -> Iterator[tuple[TopicDescription, records.RawMessage]]:
        """Yield topic and message for each message in the records `content`; decompress a message if necessary.

        Messages of unknown channels are left out, and the report lists them as a damage at `found`.

        Raises:
            DamageError: a message cannot be decompressed; `_messages` then leaves out the whole chunk.
            BudgetError: a message exceeds a limit.
        """
        unknown = 0
        for message in records.messages(content, None):
            topic = self._topics.get(message.channel_id)
            if topic is None:
                unknown += 1
                continue
            if topic.encoding == description.SERIALIZATION and bytes(message.data[:4]) == records.ZSTD_MAGIC:
                data = records.plain_message(message.data, budget.raised(budget.CHUNK_BYTES))
                self._report.account.chunk(len(data))
                yield topic, message._replace(data=data)
            else:
                yield topic, message
        if unknown:
            reason = f"{unknown} messages are left out, because the definitions of their topics are lost"
            self._report.note(self._damage(found, reason, length=0))

    def _read_summary(self, file: DamagedFile) -> None:
        try:
            summary = reader.read_summary(file.fd, file.size)
            self._topics.update(reader.topics_of(summary))
        except (DamageError, BudgetError):
            return  # the chunks have statistics of their own, and the limit is that of every reader
        self._schemas.update(summary.schemas)
        self.figures.expected = summary.statistics

    def _define(self, definition: mcap_records.Schema | mcap_records.Channel) -> None:
        if isinstance(definition, mcap_records.Schema):
            self._schemas[definition.id] = definition
            return
        schema = self._schemas.get(definition.schema_id)
        if schema is not None or definition.schema_id == 0:
            self._know(definition.id, TopicDescription.from_channel(definition, schema))

    def _know(self, channel_id: int, topic: TopicDescription) -> None:
        """Store the topic of a channel.

        Raises:
            BudgetError: there are too many topics.
        """
        if channel_id not in self._topics:
            budget.allow("topics", len(self._topics) + 1, budget.TOPICS)
        self._topics[channel_id] = topic

    def _take_attachment(self, file: DamagedFile, found: Found) -> None:
        content = file.content(found)
        attachment = records.parse(mcap_records.Attachment, content)
        fits = records.attachment_crc(content)
        if fits or (fits is None and self._accept_unchecked):
            self.attachments.append(Attachment(attachment.name, bytes(attachment.data), attachment.media_type))
        else:
            reason = f"carries no checksum ({ACCEPT} accepts it)" if fits is None else "does not fit its checksum"
            self._report.note(self._damage(found, f"the attachment {attachment.name!r} {reason}"))

    def _take_metadata(self, file: DamagedFile, found: Found) -> None:
        record = records.parse(mcap_records.Metadata, file.content(found))
        name, content = record.name, record.metadata
        if name == description.BAG_RECORD_NAME:
            return  # the new run has its own
        verified = description.verify(content)
        if name not in _OWN_RECORDS:  # from another program: the format has no checksum for it
            if verified is not None or self._accept_unchecked:
                self.metadata[name] = content
            else:
                self._report.note(
                    self._damage(found, f"the metadata record {name!r} carries no checksum ({ACCEPT} accepts it)")
                )
        elif verified is None:
            self._report.note(
                self._damage(found, f"the metadata record {name!r} does not fit its checksum or has none")
            )
        elif name == description.RECORD_NAME:
            self.provenance = Provenance.from_record(verified)
        elif name == description.TOPIC_RECORD_NAME:
            self._take_topic(found, verified)
        elif name == losses.RECORD_NAME:
            try:
                losses.read_record(verified)
                self.losses = verified
            except DamageError as error:
                self._report.note(self._damage(found, str(error)))
        elif name == RECORD_NAME:
            with contextlib.suppress(DamageError):
                self.recovered = read_record(verified)
        elif name == TAIL_RECORD_NAME:
            with contextlib.suppress(KeyError, ValueError):
                self.follows = int(verified[FOLLOWS])

    def _take_topic(self, found: Found, record: dict[str, str]) -> None:
        try:
            channel_id = int(record["id"])
            encoding = record.get("encoding", description.SERIALIZATION)
            channel = mcap_records.Channel(channel_id, record["name"], encoding, record, int(bool(record["type_name"])))
            kind = record.get("schema_encoding", description.ENCODING)
            data = record["schema"].encode("utf-8" if kind == description.ENCODING else "latin-1")
            topic = TopicDescription.from_channel(channel, mcap_records.Schema(1, data, kind, record["type_name"]))
            self._know(channel_id, self._topics.get(channel_id, topic))
        except (KeyError, ValueError, BudgetError) as error:
            why = f"no entry {error}" if isinstance(error, KeyError) else error
            self._report.note(self._damage(found, f"cannot use the definition of a topic: {why}"))

    def _damage(self, found: Found, reason: str, *, length: int | None = None) -> Damage:
        return Damage(self.path.name, found.offset, found.length if length is None else length, reason)
