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
"""Writer of a run: a directory with MCAP files for any ROS 2 tool, and `metadata.yaml` as in rosbag2.

A chunk is closed when it is full or has been open for half a second of wall time, and is then passed to the operating
system at once. A killed process loses only the messages of the open chunk. With a tail (`Tail`), it loses only the
messages since the last call of `RunWriter.secure`. `metadata.yaml` is written when the run is finished. A directory
without it is incomplete; `recover` writes its intact messages to a new run.

Only complete records are on disk. `mcap.writer.Writer` composes records in memory, and `McapFile.commit` writes the
complete records to the file. If that fails, the file is truncated to the last complete record. Writing stops before the
disk is full or the file size limit is reached.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import resource
import struct
import sys
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

import attrs
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Channel, McapRecord, Schema
from mcap.writer import CompressionType, Writer

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.errors import CodecError, RecordingError
from impact_rig.recording import description, digests, losses
from impact_rig.recording.description import (
    INFINITE_NS,
    RECORD_NAME,
    TOPIC_RECORD_NAME,
    Attachment,
    Extent,
    Provenance,
    TopicDescription,
    protect,
    starts_with_header,
)
from impact_rig.recording.losses import RECORD_NAME as LOSSES_RECORD_NAME
from impact_rig.recording.losses import Account
from impact_rig.recording.records import CHUNK, CHUNK_HEAD, MESSAGE, MESSAGE_HEAD, RECORD_HEAD
from impact_rig.recording.rigs import prefix_of
from impact_rig.system import files
from impact_rig.system.files import NEW_FILE

CONTINUES_RECORD_NAME = "impact_rig/continues"
"""Name of the metadata record in a file of a split run that names the next file."""
CHUNK_BYTES = 512 * 1024
"""Uncompressed size at which a chunk is closed.

To compress 4 MiB stalls the writer for 25 ms, a few hundred KiB for 1 to 3 ms.
"""
CHUNK_OPEN_S = 0.5  # wall time after which an open chunk is closed, even if it is small


@attrs.define
class _Channel:
    """Topic of a run that is being written, with its channel id in the open file and its number of messages."""

    topic: TopicDescription
    has_header: bool
    is_scan: bool
    id: int = 0
    count: int = 0


class RunWriter:
    """Writer of one run: a directory with MCAP files and `metadata.yaml`.

    Args:
        directory: the run directory, created with its parents; files are named after it. It may exist, but must belong
            to this user and contain neither `*.mcap`, `*.mcap.tail` nor `metadata.yaml`: nothing is overwritten.
        provenance: content of the `impact_rig` metadata record of every file; None means no record.
        attachments: files to store at the start of every MCAP file, until `attach` or `supersede` replaces them.
        account: account of received and lost messages; None means a new one that does not know the publishers.
        closing: function that returns further metadata records by name, which are written at the end of a file. It is
            called once per file.
        clock: function that returns a monotonic time [s]. A chunk that has been open for `CHUNK_OPEN_S` is closed by
            the next call of `write` or `flush_due`.
        compression: `none`, `lz4` or `zstd`.
        chunk_bytes: uncompressed size above which a chunk is closed [bytes].
        max_file_bytes: size on disk [bytes] at which the next message starts a new file; 0 means no limit. A file may
            exceed this size by a chunk and its index.
        max_file_duration_ns: log time [ns] since the first message of a file after which a new file is started; 0 means
            no limit.
        tail: whether to keep the messages of the open chunk in a second file (`Tail`); without it, `secure` has no
            effect.
        ros_distro: name of the distribution for `metadata.yaml`.

    Raises:
        RecordingError: the directory cannot be created, belongs to another user or contains a recording. Or the
            compression is unknown, or the disk is full.
    """

    def __init__(
        self,
        directory: str | Path,
        *,
        provenance: Provenance | None,
        clock: Callable[[], float],
        attachments: Iterable[Attachment] = (),
        account: Account | None = None,
        closing: Callable[[], Mapping[str, Mapping[str, str]]] = dict,
        compression: str = "zstd",
        chunk_bytes: int = CHUNK_BYTES,
        max_file_bytes: int = 0,
        max_file_duration_ns: int = 0,
        tail: bool = False,
        ros_distro: str = "jazzy",
    ) -> None:
        self.directory = Path(directory)
        self._provenance = provenance
        self._attachments = {attachment.name: attachment for attachment in attachments}
        self._account = account or Account()
        self._closing = closing
        self._clock = clock
        self._compression = compression
        self._chunk_bytes = chunk_bytes
        self._max_file_bytes = max_file_bytes
        self._max_file_duration_ns = max_file_duration_ns
        self._ros_distro = ros_distro
        self._clock_ns = LogClock()
        self._early: list[_Early] = []
        self._early_bytes = 0
        self._channels: dict[str, _Channel] = {}
        self._spans: list[Extent] = []
        self._bytes_before = 0
        self._chunk_opened_s: float | None = None
        self._closed = False
        self._failure: RecordingError | None = None
        make_room(self.directory)
        self._with_tail = tail
        self._tail: Tail | None = None
        self._definitions: bytes | None = None  # those of the newest tail; None after a further topic
        self._file = self._open_file()

    @property
    def closed(self) -> bool:
        """Return whether the run accepts no more messages: it is finished, or an error has stopped it."""
        return self._closed

    @property
    def message_count(self) -> int:
        """Number of messages accepted so far, including those that wait for the first scan."""
        return sum(span.count for span in self._spans) + len(self._early)

    @property
    def bytes_written(self) -> int:
        """Number of bytes on disk in all MCAP files of the run, without a tail (`Tail`)."""
        return self._bytes_before + self._file.size

    @property
    def files(self) -> list[Path]:
        """Paths of the MCAP files of the run, in the order of writing."""
        return [self.directory / span.name for span in self._spans]

    def add_topic(self, topic: TopicDescription) -> None:
        """Register a topic, before or during the recording.

        If the topic is already registered with the same type, the call has no effect.

        Raises:
            RecordingError: the topic is known with another type (the run continues). Or the run is finished, or an
                error has ended it, now or earlier.
        """
        self._refuse_if_closed()
        known = self._channels.get(topic.name)
        if known is None:
            is_scan = topic.type_name == topics.TABLE and prefix_of(topic.name, topics.SCAN) is not None
            channel = _Channel(topic, starts_with_header(topic.type_name, topic.schema), is_scan)
            with _StoppingOnError(self):
                self._file.close_chunk()  # the tail of the open chunk contains only the topics registered at its start
                self._commit()
                self._register(channel)
                self._file.commit()
            self._channels[topic.name] = channel
        elif known.topic.type_name != topic.type_name:
            raise RecordingError(
                f"topic {topic.name} is recorded with the type {known.topic.type_name}: messages of type "
                f"{topic.type_name} on it are not recorded; publish them on another topic"
            )

    def write(
        self, topic_name: str, data: bytes, publish_time_ns: int, sequence: int = 0, table: Table | None = None
    ) -> None:
        """Record one message, with the rig time of its reception as its log time.

        Messages before the first scan wait in memory, because the scan defines their log time. If no scan arrives, they
        are written by `finish`, or by `write` when too many wait. Their log time is then the newest of their header
        stamps or, if none has a stamp, their publish time.

        Args:
            topic_name: name of a registered topic.
            data: CDR bytes as received.
            publish_time_ns: time at which its publisher sent it (DDS source time) [ns, Unix].
            sequence: publication sequence number of the publisher (its low 32 bits are kept); 0 means none.
            table: the table in `data`, if it has been decoded.

        Raises:
            RecordingError: the topic is unknown (the run continues). Or the run is finished, or an error has ended it,
                now or earlier: see `closed`.
        """
        channel = self._channels.get(topic_name)
        if channel is None:
            raise RecordingError(f"topic {topic_name} has not been added to the recording: call add_topic first")
        self._refuse_if_closed()
        if channel.is_scan:
            scans = _block(data, table)
            if scans is not None:
                log_time = self._clock_ns.begin_block(*scans)
                self._write_early(log_time)
                self._write(channel, data, log_time, publish_time_ns, sequence, counted=True)
                self._clock_ns.end_block()
                return
        if self._clock_ns.now_ns is None:
            self._early.append(_Early(channel, data, publish_time_ns, sequence))
            self._early_bytes += len(data)
            if len(self._early) >= MOST_EARLY or self._early_bytes >= MOST_EARLY_BYTES:
                self._begin_without_scans()
            return
        self._write(channel, data, self._clock_ns.now_ns, publish_time_ns, sequence, counted=True)

    def _begin_without_scans(self) -> None:
        """Write the messages that wait for a first scan, although no scan has arrived.

        Call this when the run ends or too many messages wait. Their log time is the newest of their header stamps. If
        none has a stamp, the log time of each message is its publish time, or the log time before if that is later.
        """
        stamps = [_stamp(one.data) for one in self._early if one.channel.has_header]
        self._write_early(max(stamps, default=0) or None)

    def _write_early(self, time_ns: int | None) -> None:
        """Write the messages that wait for the first scan, with the log time `time_ns`.

        If `time_ns` is None, the log time of each message is its publish time, or the log time before if that is later.
        """
        waiting, self._early, self._early_bytes = self._early, [], 0  # a write may end the run, which calls this again
        for one in waiting:
            now_ns = self._clock_ns.go_on(one.publish_time_ns if time_ns is None else time_ns)
            self._write(one.channel, one.data, now_ns, one.publish_time_ns, one.sequence, counted=True)

    def write_at(self, topic_name: str, data: bytes, log_time_ns: int, publish_time_ns: int, sequence: int = 0) -> None:
        """Record one message at a given log time [ns], without counting it in the account of losses.

        The message is written at once, even before the first scan.

        Args:
            topic_name: name of a registered topic.
            data: CDR bytes.
            log_time_ns: log time [ns].
            publish_time_ns: time at which its publisher sent it [ns, Unix].
            sequence: publication sequence number of the publisher; 0 means none.

        Raises:
            KeyError: the topic is not registered.
            RecordingError: the run is finished, or an error has ended it, now or earlier.
        """
        self._write(self._channels[topic_name], data, log_time_ns, publish_time_ns, sequence, counted=False)

    def _write(
        self, channel: _Channel, data: bytes, log_time_ns: int, publish_time_ns: int, sequence: int, *, counted: bool
    ) -> None:
        self._refuse_if_closed()
        with _StoppingOnError(self):
            if self._file_is_full(log_time_ns):
                following = f"{self.directory.name}_{len(self._spans)}.mcap"
                self._finish_file({CONTINUES_RECORD_NAME: {"file": following}})
                self._bytes_before += self._file.size
                self._open_file()
            if self._chunk_opened_s is None:
                self._chunk_opened_s = self._clock()
            channel.count += 1
            self._spans[-1].add(log_time_ns)
            if counted:  # after the previous file has been finished, and before this message can be the last one
                self._account.take(channel.topic.name, sequence)
            message = (channel.id, log_time_ns, data, min(max(0, publish_time_ns), INFINITE_NS), sequence)
            if self._with_tail:
                if self._tail is None:
                    known = [one.topic for one in self._channels.values()]
                    self._tail = Tail(self._file.path, self._file.size, known, self._chunk_bytes, self._definitions)
                    self._definitions = self._tail.definitions
                self._tail.add_message(*message)
            if self._file.add_message(*message):
                self._commit()
            else:
                self._flush_if_due()

    def secure(self) -> None:
        """Write the messages of the open chunk to the tail, so that they survive if this process is killed.

        Messages that wait for the first scan are not written. Without `tail=True` the call has no effect.

        Raises:
            RecordingError: the run is finished, or an error has ended it, now or earlier.
        """
        self._refuse_if_closed()
        if self._tail is not None:
            with _StoppingOnError(self):
                self._tail.secure()

    def flush_due(self) -> None:
        """Close and write the open chunk if it has been open for `CHUNK_OPEN_S` (0.5 s); call this every 0.25 s.

        The call has no effect after the end of the run, or after an error that has ended the run.

        Raises:
            RecordingError: the chunk could not be written, or disk space runs short; the run has been closed.
        """
        if not self._closed:
            with _StoppingOnError(self):
                self._flush_if_due()

    def attach(self, attachment: Attachment, instead_of: str = "") -> None:
        """Store a file inside the recording, now and at the start of each further MCAP file of a split run.

        Args:
            attachment: the file.
            instead_of: name of the earlier attachment that this one replaces in further files; the open file keeps
                both. An empty name means the attachment with the same name as this one. After `attach(b, "a")`, the
                attachment that replaces b must name "a" again.

        Raises:
            RecordingError: the run is finished, or an error has ended it, now or earlier.
        """
        self._refuse_if_closed()
        self.supersede(attachment, instead_of)
        with _StoppingOnError(self):
            self._write_attachment(attachment)
            self._file.commit()

    def supersede(self, attachment: Attachment, instead_of: str = "") -> None:
        """Replace an attachment in further MCAP files of a split run; the open MCAP file stays unchanged.

        Args:
            attachment: the file.
            instead_of: name of the earlier attachment that this one replaces. An empty name means the attachment with
                the same name as this one. If there is none of this name, the attachment is added. After
                `supersede(b, "a")`, the attachment that replaces b must name "a" again.
        """
        self._attachments[instead_of or attachment.name] = attachment

    def finish(self) -> Path:
        """Finish the run (last chunk, index, `metadata.yaml`) and return its directory.

        A second call, or one after an error, has no effect.

        Raises:
            RecordingError: the last chunk, the index or `metadata.yaml` cannot be written, or the disk has too little
                room for all messages that wait for the first scan; the messages on disk are intact.
        """
        if not self._closed:
            self._begin_without_scans()
            self._closed = True
            self._finish_file()
            description.write_metadata(self.directory, self._information())
        return self.directory

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.finish()

    # --- files

    def _open_file(self) -> McapFile:
        splitting = self._max_file_bytes > 0 or self._max_file_duration_ns > 0
        stem = f"{self.directory.name}_{len(self._spans)}" if splitting else self.directory.name
        path = self.directory / f"{stem}.mcap"
        file = McapFile(path, compression=self._compression, chunk_bytes=self._chunk_bytes)
        self._file = file
        self._spans.append(Extent(path.name))
        self._chunk_opened_s = None
        file.add_metadata(description.BAG_RECORD_NAME, description.bag_record(self._information()))
        if self._provenance is not None:
            file.add_metadata(RECORD_NAME, protect(self._provenance.to_record()))
        for attachment in self._attachments.values():
            self._write_attachment(attachment)
        for channel in self._channels.values():
            self._register(channel)
        file.commit()
        return file

    def _register(self, channel: _Channel) -> None:
        topic = channel.topic
        channel.id, self._definitions = self._file.add_topic(topic), None
        repeated = {
            "id": str(channel.id),
            "name": topic.name,
            "type_name": topic.type_name,
            "schema": topic.schema,
            "schema_encoding": topic.schema_encoding,
            "encoding": topic.encoding,
        }
        self._file.add_metadata(TOPIC_RECORD_NAME, protect(repeated | topic.channel_metadata()))

    def _write_attachment(self, attachment: Attachment) -> None:
        span = self._spans[-1]
        created_ns = 0 if self._provenance is None else self._provenance.wall_start_ns
        self._file.add_attachment(attachment, span.end_ns, created_ns)

    def _file_is_full(self, log_time_ns: int) -> bool:
        span = self._spans[-1]
        if span.count == 0:
            return False
        too_long = 0 < self._max_file_duration_ns < log_time_ns - span.start_ns
        return too_long or 0 < self._max_file_bytes <= self._file.size

    def _finish_file(self, further: Mapping[str, Mapping[str, str]] = MappingProxyType({})) -> None:
        try:
            self._file.close_chunk()
            self._file.add_metadata(description.BAG_RECORD_NAME, description.bag_record(self._information()))
            for name, record in {LOSSES_RECORD_NAME: self._account.to_record(), **self._closing(), **further}.items():
                if record:
                    self._file.add_metadata(name, protect(record))
            self._file.finish()
            self._drop_tail()
        finally:
            self._close()

    def _close(self) -> None:
        """Close all open files in their present state.

        A tail whose messages are not in a chunk yet stays on disk.
        """
        self._file.close()
        if self._tail is not None:
            self._tail.close()

    def _information(self) -> description.Information:
        topics = [(channel.topic, channel.count) for channel in self._channels.values()]
        return description.bag_information(topics, self._spans, ros_distro=self._ros_distro)

    # --- chunks

    def _drop_tail(self) -> None:
        tail, self._tail = self._tail, None
        if tail is not None:
            tail.remove()

    def _flush_if_due(self) -> None:
        if self._chunk_opened_s is None:
            return
        open_for = self._clock() - self._chunk_opened_s
        if not 0 <= open_for < CHUNK_OPEN_S:  # a clock that went back counts as due
            self._file.close_chunk()
            self._commit()

    def _commit(self) -> None:
        self._chunk_opened_s = None
        self._file.commit()
        self._drop_tail()
        if shortage := self._file.shortage():
            self.finish()
            raise RecordingError(f"the recording {self.directory} was ended and can be read up to there: {shortage}")

    # --- errors

    def _refuse_if_closed(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._closed:
            raise RecordingError(
                f"the recording {self.directory} is finished, so it accepts no more messages: start another one"
            )

    def stop(self, error: RecordingError) -> None:
        """End the run because of `error`; later calls that record something raise this error again.

        An open MCAP file is closed without an index, so the run needs `recover`. If the last MCAP file is already
        finished when the error occurs, `metadata.yaml` is written, so that the run can be read. `finish` has no effect
        after this call.
        """
        self._failure = error
        finished = self._file.finished and not self._closed
        self._closed = True
        self._close()
        if finished:
            with contextlib.suppress(RecordingError):
                description.write_metadata(self.directory, self._information())


class _StoppingOnError:
    """Context manager that ends the run if its block raises a RecordingError.

    Later calls of the writer then raise this error again, so that nothing is written after a damaged position.
    """

    def __init__(self, writer: RunWriter) -> None:
        self._writer = writer

    def __enter__(self) -> None:
        pass

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        if isinstance(error, RecordingError):
            self._writer.stop(error)


MOST_EARLY, MOST_EARLY_BYTES = 20_000, 16 * 2**20
"""Limits of the messages that wait for the first scan, which defines their log time: number, and size [bytes]."""


@attrs.frozen
class _Early:
    """Message that was received before the first scan and waits for the scan."""

    channel: _Channel
    data: bytes
    publish_time_ns: int
    sequence: int


class LogClock:
    """Log time of a recording: the rig time at which a message is received, computed from the scans received so far.

    The log time never goes back. If the stamps go back because a rig was restarted, the log time continues from its
    last value, and advances by as much as the stamps do. It is unknown until the first scan or call of `go_on`.
    """

    def __init__(self) -> None:
        self.now_ns: int | None = None  # None if not known yet
        self._end_ns = 0  # end of the block that is being logged
        self._offset_ns = 0  # offset from the stamps of a restarted rig to log times

    def go_on(self, now_ns: int) -> int:
        """Advance the log time to `now_ns` [ns] unless it is already later; return the log time."""
        self.now_ns = max(_clamp(now_ns), self.now_ns or 0)
        return self.now_ns

    def begin_block(self, first_ns: int, last_ns: int) -> int:
        """Advance the log time to the first scan of a received block; return this log time of the block [ns].

        After a restart of the rig, whose stamps go back, the first block gets the last log time, and later blocks
        continue from there.

        Args:
            first_ns: stamp of its first scan [ns].
            last_ns: stamp of its last scan [ns], for `end_block`.
        """
        now_ns = _clamp(first_ns) if self.now_ns is None else self.now_ns
        if first_ns < now_ns and first_ns + self._offset_ns < now_ns:
            self._offset_ns = now_ns - first_ns
        log_time = _clamp(first_ns if first_ns >= now_ns else first_ns + self._offset_ns)
        self._end_ns = _clamp(log_time + max(0, last_ns - first_ns))
        self.now_ns = log_time
        return log_time

    def end_block(self) -> None:
        """Advance the log time to the last scan of the block given to `begin_block`.

        Call this after the block is written.
        """
        self.now_ns = self._end_ns


def _clamp(time_ns: int) -> int:
    """Return a time limited to 0 … INFINITE_NS, the range of times that MCAP and rosbag2 can both store."""
    return min(max(0, time_ns), INFINITE_NS)


def _stamp(data: bytes) -> int:
    try:
        return codec.header_stamp_ns(data)
    except CodecError:
        return 0


def _block(data: bytes, table: Table | None) -> tuple[int, int] | None:
    """Return the stamps of the first and last scan of a block [ns], or None if the message is not a table with scans.

    `data` is the message. `table` is the table in the message, if it has been decoded.
    """
    try:
        table = table or codec.decode(data)
    except CodecError:
        return None
    return (table.stamp_ns, losses.last_scan_ns(table)) if len(table.rows) and losses.has_times(table) else None


def make_room(directory: Path) -> None:
    """Create the directory of a run with its parents, and check that a recording may be written to it.

    Raises:
        RecordingError: the directory cannot be created, is a link, belongs to another user, or contains a recording:
            nothing is overwritten.
    """
    try:
        files.make_folder(directory)
        files.refuse_foreign(directory)
        present = sorted(path.name for path in directory.iterdir())
    except FileExistsError as error:
        raise RecordingError(f"{directory} is a file, not a directory to record into; choose another") from error
    except OSError as error:
        raise RecordingError(f"cannot use the run directory {directory}: {error.strerror}") from error
    for name in present:
        if name.endswith((".mcap", f".mcap{TAIL_SUFFIX}")) or name == description.METADATA_FILE:
            raise RecordingError(
                f"{directory} holds a recording already ({name}); nothing is overwritten: choose another directory"
            )


SEQUENCE_MASK = 0xFFFFFFFF  # MCAP keeps the low 32 bits of a sequence number
PROFILE = "ros2"
LIBRARY = "impact_rig"
COMPRESSIONS: Mapping[str, CompressionType] = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}

MIN_FREE_BYTES = 8 * 2**20
"""Free disk space below which a recording stops: enough for its index and for the machine's other logs."""
_INDEX_BYTES_PER_CHUNK = 128  # a ChunkIndex record without its 10 bytes per channel
_CLOSING_BYTES_PER_TOPIC = 1024  # size of its part of the metadata records at the end of a file
_INDEX_BYTES_FIXED = 4096  # statistics, summary offsets, footer, metadata and attachment indexes


class _Buffer(io.BytesIO):
    """Memory buffer for the records of an MCAP file that are not written yet.

    `tell` counts from the beginning of the file.
    """

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
    """New MCAP file of profile `ros2`, open for writing and locked until it is closed.

    Records wait in memory until `commit` writes them.

    Args:
        path: path of a new file.
        compression: `none`, `lz4` or `zstd`.
        chunk_bytes: uncompressed size [bytes] above which a chunk is closed.
        chunked: whether messages and definitions are stored in chunks.

    Raises:
        RecordingError: the file exists or cannot be created, the compression is unknown, or the disk or the file size
            limit of the process leaves no room for a chunk.
    """

    def __init__(self, path: Path, *, compression: str, chunk_bytes: int, chunked: bool = True) -> None:
        if compression not in COMPRESSIONS:
            raise RecordingError(f"compression must be one of {', '.join(COMPRESSIONS)}, got {compression!r}")
        self.path = path
        self._chunk_bytes = chunk_bytes
        self._largest_message = 0
        self._messages: list[tuple[int, int, bytes, int, int]] = []  # messages of the open chunk
        self._open_bytes = 0  # size of the open chunk
        self._chunks = 0
        self._channels = 0
        self._schemas: dict[tuple[str, str], Schema] = {}  # by name of the type, and encoding
        self._index_bytes = _INDEX_BYTES_FIXED
        self.finished = False
        self._digests = digests.Digests()
        self._fd = _create(path)
        self._buffer = _Buffer()
        self._writer = Writer(
            self._buffer, chunk_size=sys.maxsize, compression=COMPRESSIONS[compression], use_chunking=chunked
        )
        try:
            self._writer.start(PROFILE, LIBRARY)
            self.commit()
            if shortage := self.shortage():
                raise RecordingError(f"{self.path} cannot be recorded: {shortage}")  # noqa: TRY301  # undone as well
        except RecordingError:
            os.close(self._fd)
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Number of bytes of this file on disk."""
        return self._buffer.committed

    def add_topic(self, topic: TopicDescription) -> int:
        """Register a new topic and return its channel id: 1 for the first topic, 2 for the next."""
        key = topic.type_name, topic.schema_encoding
        if topic.type_name and key not in self._schemas:
            data = topic.schema_bytes()
            self._index_bytes += len(data) + len(topic.type_name) + 64
            known = int(self._writer.register_schema(topic.type_name, topic.schema_encoding, data))
            registered = Schema(known, data, topic.schema_encoding, topic.type_name)
            self._schemas[key] = registered
            self._open_bytes += _length(registered)
        self._channels += 1
        metadata = topic.channel_metadata()
        self._index_bytes += (
            _CLOSING_BYTES_PER_TOPIC + len(topic.name) + sum(len(k) + len(v) for k, v in metadata.items()) + 64
        )
        schema = self._schemas.get(key)
        schema_id = schema.id if schema is not None else 0
        number = self._writer.register_channel(topic.name, topic.encoding, schema_id, metadata)
        channel = Channel(number, topic.name, topic.encoding, metadata, schema_id)
        self._open_bytes += _length(channel)
        self._digests.add_topic(channel, schema)
        return number

    def add_message(self, channel: int, log_time: int, data: bytes, publish_time: int, sequence: int) -> bool:
        """Add a message to the open chunk; return whether the chunk is full and was closed.

        The next `commit` writes the closed chunk. Times are in ns.
        """
        self._largest_message = max(self._largest_message, len(data))
        sequence &= SEQUENCE_MASK
        self._messages.append((channel, log_time, data, publish_time, sequence))
        self._digests.add_message(channel, sequence, log_time, publish_time, data)
        self._open_bytes += MESSAGE_HEAD.size + len(data)
        if self._open_bytes <= self._chunk_bytes:
            return False
        self.close_chunk()
        return True

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Add a metadata record; `commit` writes it."""
        self._index_bytes += len(name) + 64
        self._writer.add_metadata(name, dict(record))
        self._digests.add_metadata(name, record)

    def add_attachment(self, attachment: Attachment, log_time: int, create_time: int) -> None:
        """Add an attachment with these times [ns]; `commit` writes it."""
        self._index_bytes += len(attachment.name) + len(attachment.media_type) + 128
        self._writer.add_attachment(create_time, log_time, attachment.name, attachment.media_type, attachment.data)
        self._digests.add_attachment(
            AttachmentRecord(create_time, log_time, attachment.name, attachment.media_type, attachment.data)
        )

    def add_record(self, record: bytes) -> None:
        """Add a complete record as bytes; `commit` writes it.

        Index and statistics of the file do not include this record.
        """
        self._buffer.write(record)

    def take_back(self) -> bytes:
        """Close the open chunk, remove all records that wait for `commit`, and return the bytes of these records."""
        self.close_chunk()
        records = self._buffer.getvalue()
        self._buffer.empty()
        return records

    def close_chunk(self) -> None:
        """Close the open chunk if it contains a message; `commit` then writes it."""
        for message in self._messages:
            self._writer.add_message(*message)
        if self._messages:
            self._messages, self._open_bytes = [], 0
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap annotates arguments, not results

    def commit(self) -> None:
        """Write all complete records to the file, so that they survive if this process is killed.

        The messages of the open chunk are not written.

        Raises:
            RecordingError: the records cannot be written; the file ends with the last complete record.
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
            rest = (
                f"; the file ends with its last complete record ({self.size} bytes) and has no index: copy the "
                f"messages of {self.path.parent} to a new run with impact-rig recover"
            )
            raise RecordingError(f"cannot write {self.path}: {error.strerror}{rest if self.size else ''}") from error
        finally:
            data.release()
        self._buffer.drain()

    def shortage(self) -> str:
        """Return why there may be too little space for one more chunk and the index; empty if there is enough.

        Both the free disk space and the file size limit of the process are checked.
        """
        index = self._index_bytes + (self._chunks + 2) * (_INDEX_BYTES_PER_CHUNK + 10 * self._channels)
        needed = self._chunk_bytes + self._largest_message + index
        limit, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
        if limit != resource.RLIM_INFINITY and self.size + needed > limit:
            return (
                f"the next chunk does not fit into the file size limit of this process (RLIMIT_FSIZE, {limit} bytes): "
                "raise this limit (ulimit -f)"
            )
        space = os.fstatvfs(self._fd)
        free = space.f_bavail * space.f_frsize
        if free < needed + MIN_FREE_BYTES:
            return (
                f"only {free / 1e6:.0f} MB are free on its disk, {(needed + MIN_FREE_BYTES) / 1e6:.0f} MB are needed: "
                f"the next chunk, the index, and {MIN_FREE_BYTES / 1e6:.0f} MB that stay free; "
                "free disk space, or choose a directory on another disk"
            )
        return ""

    def finish(self) -> None:
        """Write the last chunk, the digests, and the summary with index and statistics, and close the file.

        Raises:
            RecordingError: the records cannot be written; earlier records are intact.
        """
        try:
            self.close_chunk()
            self.add_metadata(digests.RECORD_NAME, protect(self._digests.to_record()))
            self._writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates arguments, not results
            self.commit()
            self.finished = True
        finally:
            self.close()

    def close(self) -> None:
        """Close the file in its present state; a second call has no effect."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


def _length(record: McapRecord) -> int:
    """Return the size of an MCAP record with its head of opcode and length [bytes]."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.count


def _create(path: Path) -> int:
    """Create a file, lock it and return its descriptor.

    The lock shows readers that this process still writes the file.

    Raises:
        RecordingError: the file exists, or cannot be created.
    """
    try:
        fd = os.open(path, NEW_FILE, 0o644)
    except FileExistsError as error:
        raise RecordingError(f"{path} exists already and is not overwritten; choose another directory") from error
    except OSError as error:
        raise RecordingError(f"cannot create {path}: {error.strerror}") from error
    with contextlib.suppress(OSError):  # file systems without locks
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return fd


def _write_all(fd: int, data: memoryview) -> None:
    done = 0
    while done < len(data):
        with data[done:] as rest:  # a traceback that held it would keep the buffer alive
            done += os.write(fd, rest)


TAIL_SUFFIX = ".tail"  # suffix of the recording's name
TAIL_RECORD_NAME = "impact_rig_tail"
FOLLOWS = "follows"  # key of that record: size of the recording when its open chunk began [bytes]

_SIZES = struct.Struct("<IQ")


def tail_of(recording: Path) -> Path:
    """Return the path of the tail of an MCAP file, the file with the messages of its open chunk.

    The tail need not exist.
    """
    return recording.with_name(recording.name + TAIL_SUFFIX)


class Tail(McapFile):
    """Tail of a recording: a second file with the messages of its open chunk, which a kill would otherwise lose.

    Args:
        recording: path of the MCAP file whose chunk is open.
        follows: size of the recording without its open chunk [bytes].
        topics: topics of the recording in the order of their registration, so that channel ids are equal in both files.
        chunk_bytes: chunk size of the recording [bytes].
        definitions: `definitions` of an earlier tail with the same topics, which saves time; None means that they are
            encoded from `topics`.

    Raises:
        RecordingError: the file exists, or cannot be written.
    """

    def __init__(
        self,
        recording: Path,
        follows: int,
        topics: Iterable[TopicDescription],
        chunk_bytes: int,
        definitions: bytes | None = None,
    ) -> None:
        super().__init__(tail_of(recording), compression="none", chunk_bytes=chunk_bytes, chunked=False)
        self._log_times: list[int] = []
        self.add_metadata(TAIL_RECORD_NAME, protect({FOLLOWS: str(follows)}))
        self.close_chunk()
        self.commit()
        if definitions is None:
            for topic in topics:
                self.add_topic(topic)
            definitions = self.take_back()
        self.definitions = definitions  # records of the topics
        self._records = [definitions]  # readers trust definitions only inside a chunk, which has a checksum

    def add_message(self, channel: int, log_time: int, data: bytes, publish_time: int, sequence: int) -> bool:
        """Keep a message in memory until the next `secure`; return False, because no message closes a chunk here."""
        length = MESSAGE_HEAD.size - RECORD_HEAD.size + len(data)
        head = MESSAGE_HEAD.pack(MESSAGE, length, channel, sequence & SEQUENCE_MASK, log_time, publish_time)
        self._records += head, data
        self._log_times.append(log_time)
        return False

    def shortage(self) -> str:
        """Return an empty text, which means enough space.

        The check of the recording already includes its open chunk.
        """
        return ""

    def secure(self) -> None:
        """Write the messages added since the last call to disk, so that they survive if this process is killed.

        Raises:
            RecordingError: the messages cannot be written.
        """
        if self._log_times:
            self.add_record(_chunk(b"".join(self._records), min(self._log_times), max(self._log_times)))
            self._records, self._log_times = [], []
        self.commit()

    def remove(self) -> None:
        """Delete the file of this tail, because its messages are now in a chunk of the recording.

        Raises:
            RecordingError: the file cannot be removed.
        """
        self.close()
        with files.translate_errors(f"cannot remove {self.path}"):
            self.path.unlink(missing_ok=True)


def _chunk(content: bytes, first_ns: int, last_ns: int) -> bytes:
    """Return the bytes of an uncompressed MCAP Chunk record with the records in `content`.

    The times are the earliest and latest log time of the messages in the chunk [ns]. Source: MCAP format specification,
    version 0.
    """
    head = CHUNK_HEAD.pack(first_ns, last_ns, len(content), zlib.crc32(content))
    sizes = _SIZES.pack(0, len(content))  # an empty compression name
    length = len(head) + len(sizes) + len(content)
    return b"".join((RECORD_HEAD.pack(CHUNK, length), head, sizes, content))
