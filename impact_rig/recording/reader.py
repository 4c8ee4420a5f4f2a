# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Reads a run: a directory or a single MCAP file, message by message in log-time order, every byte checked.

Chunks are read and decompressed some ahead in a thread (the decompressor releases the interpreter), so that an analysis
on another core hardly waits for them.

`McapSource` is one finished file: its summary is checked on opening, its chunks when they are read.
"""

from __future__ import annotations

import bisect
import contextlib
import fcntl
import os
import re
import zlib
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple  # Any: what YAML may hold

import attrs
from mcap import records as mcap_records
from mcap.records import ChunkIndex
from mcap.summary import Summary

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.errors import CodecError, RecordingError
from impact_rig.recording import description, records
from impact_rig.recording.description import RECORD_NAME, Attachment, TopicDescription, matches, resolve, verify
from impact_rig.recording.records import DamageError
from impact_rig.system import budget, files
from impact_rig.system.budget import BudgetError, Spending
from impact_rig.topics import Topic

LEAST_AHEAD, AHEAD_BYTES = 2, 4 * budget.MIB
"""Chunks that are read before the first of them is needed: at least so many, and as many as are together no larger."""
_TRAILING_NUMBER = re.compile(r"_(\d+)$")


class Message(NamedTuple):
    """One recorded message; `data` are its CDR bytes, a view of its chunk."""

    topic: str
    type_name: str
    log_time: int
    publish_time: int
    sequence: int
    data: memoryview


@attrs.frozen
class RecordedTopic:
    """A topic and how many messages of it a run holds."""

    topic: TopicDescription
    count: int


@attrs.frozen
class _Place:
    """A chunk of one of the files."""

    source: McapSource
    index: ChunkIndex


_Item = tuple[int, int, int, Message]  # log time, running number of the chunk, of the message: a total order


class Run:
    """A recorded run, opened for reading; a context manager.

    Args:
        path: a run directory or an MCAP file.

    Raises:
        RecordingError: there is no recording, it is not finished, or its index is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sources: list[McapSource] = []
        try:
            for file in run_files(path):
                self.sources.append(McapSource(file))
            self.topics = self._merge_topics()
            self._refuse_excess()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the files; a second call does nothing."""
        for source in self.sources:
            source.close()

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def message_count(self) -> int:
        """Messages in all files."""
        return sum(source.statistics.message_count for source in self.sources)

    @property
    def start_ns(self) -> int:
        """Log time of the earliest message; 0 without messages."""
        return min((s.statistics.message_start_time for s in self._with_messages()), default=0)

    @property
    def end_ns(self) -> int:
        """Log time of the latest message; 0 without messages."""
        return max((s.statistics.message_end_time for s in self._with_messages()), default=0)

    @property
    def provenance(self) -> dict[str, str]:
        """What the run says about itself (version, seed, wall_start_ns, …); empty for other recorders' files.

        Raises:
            RecordingError: the record is damaged.
        """
        return self.record(RECORD_NAME)

    def record(self, name: str) -> dict[str, str]:
        """Return the last metadata record of this name that carries its own checksum; empty if there is none.

        Raises:
            RecordingError: the record is damaged.
        """
        for source in reversed(self.sources):
            for found, content in reversed(source.metadata()):
                if found == name:
                    verified = verify(content)
                    if verified is None:
                        raise DamageError(f"{self.path}: the metadata record {name!r} does not fit its checksum")
                    return verified
        return {}

    def attachments(self) -> dict[str, bytes]:
        """Return the files kept inside the recording, by name; of several with one name the first: the run's start.

        Raises:
            RecordingError: one is damaged.
        """
        found: dict[str, bytes] = {}
        for source in self.sources:
            for one in source.attachments():
                found.setdefault(one.name, one.data)
        return found

    def resolve(self, wanted: str) -> str:
        """Return the full name of the topic `wanted`, which may lack its namespace.

        Raises:
            RecordingError: there is no such topic, or more than one.
        """
        return resolve(wanted, list(self.topics))

    def messages(
        self,
        topics: Iterable[str] | None = None,
        *,
        start_ns: int | None = None,
        end_ns: int | None = None,
        recorded_order: bool = False,
    ) -> Generator[Message, None, None]:
        """Yield messages in log-time order; equal times in the order they were recorded.

        Args:
            topics: only these, with or without namespace; None: all.
            start_ns: only messages at or after this log time.
            end_ns: only messages before this log time.
            recorded_order: yield them as they arrived at the recorder instead.

        Raises:
            RecordingError: a topic is not there, or a chunk is damaged (what was yielded before is right).
        """
        names = None if topics is None else frozenset(self.resolve(topic) for topic in topics)
        return self._merge(names, start_ns, end_ns, recorded_order=recorded_order)

    def holds(self, topic: str | Topic) -> bool:
        """Return whether a topic was recorded, under whatever namespace."""
        return any(matches(name, topic if isinstance(topic, str) else topic.name) for name in self.topics)

    def tables(self, topic: str | Topic, *, recorded_order: bool = False) -> Iterator[Table]:
        """Yield the tables of a PointCloud2 topic in log-time order, or as they arrived.

        Args:
            topic: a name: whatever tables were recorded under it; a row of `topics`: they are `codec.checked`.
            recorded_order: as they arrived.

        Raises:
            RecordingError: the topic is not there, carries no tables, or is damaged; or tables are none of the topic.
        """
        known = None if isinstance(topic, str) else topic
        name = self._table_topic(topic if isinstance(topic, str) else topic.name)
        return (self.table(message, known) for message in self.messages([name], recorded_order=recorded_order))

    def table(self, message: Message, topic: Topic | None = None, needs: tuple[str, ...] = ()) -> Table:
        """Return the table in a message of this run, `codec.checked` if its topic is given.

        Raises:
            RecordingError: it is none.
        """
        try:
            return codec.decode(message.data, topic, needs)
        except CodecError as error:
            raise RecordingError(
                f"{self.path}: {message.topic} at {message.log_time} ns is no table that can be read: {error}"
            ) from error

    def published_tables(self, topic: str) -> Iterator[tuple[int, Table]]:
        """Return the tables of a topic like `tables`, each with its publish time [ns of the system's clock].

        Raises:
            RecordingError: as `tables`.
        """
        name = self._table_topic(topic)
        return ((message.publish_time, self.table(message)) for message in self.messages([name]))

    def _table_topic(self, topic: str) -> str:
        name = self.resolve(topic)
        type_name = self.topics[name].topic.type_name
        if type_name != topics.TABLE:
            raise RecordingError(f"topic {name} carries {type_name}, not tables ({topics.TABLE})")
        return name

    def _with_messages(self) -> list[McapSource]:
        return [source for source in self.sources if source.statistics.message_count]

    def _refuse_excess(self) -> None:
        """Refuse what the index alone shows to be beyond the budget."""
        account = self._account()
        with _named(self.path):
            for source in self.sources:
                for index in source.summary.chunk_indexes:
                    account.chunk(index.uncompressed_size)
            budget.allow("topics", len(self.topics), budget.TOPICS)
            texts = sum(len(recorded.topic.offered_qos_text) for recorded in self.topics.values())
            budget.allow("characters of QoS profiles", texts, budget.QOS_CHARACTERS)

    def _account(self) -> Spending:
        return Spending(sum(source.size for source in self.sources))

    def _merge_topics(self) -> dict[str, RecordedTopic]:
        merged: dict[str, RecordedTopic] = {}
        for source in self.sources:
            for channel_id, topic in source.topics.items():
                count = source.statistics.channel_message_counts.get(channel_id, 0)
                known = merged.get(topic.name)
                merged[topic.name] = RecordedTopic(topic, count + (known.count if known else 0))
        return merged

    def _merge(
        self, names: frozenset[str] | None, start_ns: int | None, end_ns: int | None, *, recorded_order: bool
    ) -> Generator[Message, None, None]:
        places = [
            _Place(source, index)
            for source in self.sources
            for index in source.summary.chunk_indexes
            if _wanted(source, index, names)
            and (start_ns is None or index.message_end_time >= start_ns)
            and (end_ns is None or index.message_start_time < end_ns)
        ]
        recorded = list(places)
        running_number = {id(place): number for number, place in enumerate(recorded)}
        if not recorded_order:
            places.sort(key=lambda place: place.index.message_start_time)
        pending: list[_Item] = []
        account, most = self._account(), round(budget.HELD_BYTES // budget.MESSAGE_BYTES * budget.factor())
        coming, ahead = deque(places), deque[tuple[_Place, Future[memoryview]]]()
        with ThreadPoolExecutor(1, thread_name_prefix="read-ahead") as pool:
            while coming or ahead:
                while coming:
                    in_memory = [*(place for place, _ in ahead), coming[0]]
                    if len(in_memory) > LEAST_AHEAD and _size(*in_memory) > AHEAD_BYTES:
                        break
                    self._refuse_hoard(pending, recorded, in_memory)
                    ahead.append((coming[0], pool.submit(coming[0].source.chunk, coming[0].index)))
                    coming.popleft()
                place, reading = ahead.popleft()
                content = reading.result()
                place.source.refuse_if_closed(place.index)  # it may have been read before
                with _named(self.path):  # counted before any record becomes an object
                    account.records(records.count(content, most))
                pending += _items(place, content, names, running_number[id(place)])
                cut = len(pending)
                if not recorded_order:
                    pending.sort()
                    if ahead:  # nothing in the chunks to come is earlier than the next one's start
                        cut = bisect.bisect_left(pending, (ahead[0][0].index.message_start_time,))
                for log_time, _, _, message in pending[:cut]:
                    if (start_ns is None or log_time >= start_ns) and (end_ns is None or log_time < end_ns):
                        yield message
                del pending[:cut]

    def _refuse_hoard(self, pending: list[_Item], recorded: Sequence[_Place], coming: Iterable[_Place]) -> None:
        """Refuse to hold many chunks because each has a message that is much later than the others."""
        held = [*(recorded[number] for number in {item[1] for item in pending}), *coming]
        size = _size(*held) + budget.MESSAGE_BYTES * len(pending)
        with _named(self.path):
            budget.allow("bytes held until their time has come", size, budget.HELD_BYTES)


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """Say of which run or file something costs too much."""
    try:
        yield
    except BudgetError as error:
        raise BudgetError(f"{path}: {error}") from error


def _size(*places: _Place) -> int:
    return sum(place.index.uncompressed_size for place in places)


def open_run(path: Path | str) -> Run:
    """Open a run directory or an MCAP file; see `Run`."""
    return Run(Path(path))


def run_files(path: Path) -> list[Path]:
    """Return the MCAP files of a run in the order they were written.

    Raises:
        RecordingError: there are none, or one that `metadata.yaml` lists is missing.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise RecordingError(f"{path} is neither a run directory nor an MCAP file")
    files = mcap_files(path)
    missing = set(_listed_files(path)) - {file.name for file in files}
    if missing:
        raise RecordingError(f"{path}: {', '.join(sorted(missing))} is missing ({description.METADATA_FILE} lists it)")
    if not files:
        raise RecordingError(f"{path} holds no *.mcap file")
    return files


def mcap_files(directory: Path) -> list[Path]:
    """Return the MCAP files in a directory in the order they were written, whatever `metadata.yaml` lists."""
    return sorted(directory.glob("*.mcap"), key=_split_order)


def _split_order(file: Path) -> tuple[str, int]:
    match = _TRAILING_NUMBER.search(file.stem)
    return (file.stem[: match.start()], int(match[1])) if match else (file.stem, -1)


def _listed_files(directory: Path) -> list[str]:
    path = directory / description.METADATA_FILE
    try:
        size = path.stat().st_size
        budget.allow(f"bytes in {path}", size, budget.METADATA_BYTES)
        content: Any = budget.load_yaml(str(files.read_bytes(path, size), "utf-8"), size)
        listed = content[description.METADATA_KEY]["relative_file_paths"]
        return [str(name) for name in listed]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise RecordingError(f"{path} cannot be understood: {error}") from error


def _wanted(source: McapSource, index: ChunkIndex, names: frozenset[str] | None) -> bool:
    if names is None or not index.message_index_offsets:  # no message index: the chunk may hold anything
        return True
    return any(source.topics[i].name in names for i in index.message_index_offsets if i in source.topics)


def _items(place: _Place, content: memoryview, names: frozenset[str] | None, chunk_number: int) -> list[_Item]:
    """Return the wanted messages of a chunk, each with its sort key."""
    topics = place.source.topics
    wanted = None if names is None else frozenset(i for i, topic in topics.items() if topic.name in names)
    items = []
    try:
        for number, raw in enumerate(records.messages(content, wanted)):
            topic = topics[raw.channel_id]
            message = Message(topic.name, topic.type_name, raw.log_time, raw.publish_time, raw.sequence, raw.data)
            items.append((raw.log_time, chunk_number, number, message))
    except KeyError as error:
        raise DamageError(f"{place.source.path}: a message belongs to the unknown channel {error}") from error
    return items


_REMEDY = "impact-rig recover gives back what is whole"
_BEING_WRITTEN = (
    "it is being recorded now: it can be read when the recording has ended (Ctrl-C, or ~/stop of the recorder); "
    "impact-rig recover gives a copy of what is there so far"
)


class McapSource:
    """A finished MCAP file, opened for reading.

    Raises:
        RecordingError: it cannot be opened, is not finished or is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with files.errors_as(f"{path} cannot be opened"):
            self._fd = files.open_regular(path)
        try:
            self.size = os.fstat(self._fd).st_size
            self.summary = read_summary(self._fd, self.size)
            assert self.summary.statistics is not None
            self.statistics = self.summary.statistics
            self.topics = topics_of(self.summary)
        except DamageError as error:
            being_written = self._is_being_written()
            self.close()
            if being_written:
                raise RecordingError(f"{path}: {_BEING_WRITTEN}") from error
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

    def refuse_if_closed(self, index: ChunkIndex) -> None:
        """Refuse to go on with a chunk of a file that has been closed.

        Raises:
            RecordingError: it has.
        """
        if self._fd < 0:
            raise RecordingError(f"{self.path} cannot be read at byte {index.chunk_start_offset}: it has been closed")

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

    def chunk(self, index: ChunkIndex) -> memoryview:
        """Return the records of a chunk, decompressed and checked.

        Raises:
            RecordingError: the chunk is damaged.
        """
        try:
            chunk = records.parse(mcap_records.Chunk, self._record(index, records.CHUNK))
            if chunk.uncompressed_size != index.uncompressed_size:
                raise DamageError("its size is not that in the index")  # noqa: TRY301  (one place words both kinds)
            return records.decompress(chunk)
        except DamageError as error:
            where = f"{self.path}: the chunk at byte {index.chunk_start_offset} is damaged"
            raise DamageError(f"{where}: {error}; {_REMEDY}") from error

    def attachments(self) -> list[Attachment]:
        """Return the attachments.

        Raises:
            RecordingError: one is damaged.
        """
        found = []
        for index in self.summary.attachment_indexes:
            try:
                content = self._record(index, records.ATTACHMENT)
                attachment = records.parse(mcap_records.Attachment, content)
                if not records.attachment_is_intact(content):
                    raise DamageError("its checksum does not fit")  # noqa: TRY301  (one place words both kinds of damage)
            except DamageError as error:
                raise DamageError(f"{self.path}: the attachment at byte {index.offset} is damaged: {error}") from error
            found.append(Attachment(attachment.name, bytes(attachment.data), attachment.media_type))
        return found

    def metadata(self) -> list[tuple[str, dict[str, str]]]:
        """Return the metadata records: name and content. Their content is not protected by MCAP.

        Raises:
            RecordingError: one is not a metadata record.
        """
        found = []
        for index in self.summary.metadata_indexes:
            try:
                record = records.parse(mcap_records.Metadata, self._record(index, records.METADATA))
            except DamageError as error:
                raise DamageError(
                    f"{self.path}: the metadata record at byte {index.offset} is damaged: {error}"
                ) from error
            found.append((record.name, record.metadata))
        return found

    def _record(
        self, index: ChunkIndex | mcap_records.AttachmentIndex | mcap_records.MetadataIndex, opcode: int
    ) -> memoryview:
        if isinstance(index, ChunkIndex):
            offset, length = index.chunk_start_offset, index.chunk_length
        else:
            offset, length = index.offset, index.length
        if length > self.size - offset:
            raise DamageError(f"it claims {length} bytes of a file of {self.size}")
        budget.allow("bytes in a record", length, budget.CHUNK_BYTES + budget.MIB)
        with files.errors_as(f"{self.path} cannot be read at byte {offset}"):  # a bad sector, or it has been closed
            view = memoryview(os.pread(self._fd, length, offset))
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
    footer = records.parse(mcap_records.Footer, content)
    start, crc = footer.summary_start, footer.summary_crc
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
    found = Summary()
    offset = 0
    while offset < len(section):
        opcode, content, offset = records.split(section, offset)
        if opcode == records.SCHEMA:
            schema = records.parse(mcap_records.Schema, content)
            found.schemas[schema.id] = schema
        elif opcode == records.CHANNEL:
            channel = records.parse(mcap_records.Channel, content)
            found.channels[channel.id] = channel
        elif opcode == records.CHUNK_INDEX:
            found.chunk_indexes.append(records.parse(ChunkIndex, content))
        elif opcode == records.ATTACHMENT_INDEX:
            found.attachment_indexes.append(records.parse(mcap_records.AttachmentIndex, content))
        elif opcode == records.METADATA_INDEX:
            found.metadata_indexes.append(records.parse(mcap_records.MetadataIndex, content))
        elif opcode == records.STATISTICS:
            found.statistics = records.parse(mcap_records.Statistics, content)
    chunks, statistics = found.chunk_indexes, found.statistics
    if statistics is None:
        raise DamageError("it has no statistics")
    if statistics.chunk_count != len(chunks):
        raise DamageError(f"its index lists {len(chunks)} of {statistics.chunk_count} chunks")
    if statistics.message_count and not chunks:
        raise DamageError("its messages are not in chunks, which alone carry checksums")
    _refuse_shared_bytes(chunks)
    return found


def _refuse_shared_bytes(chunks: list[ChunkIndex]) -> None:
    """Refuse an index that lists a chunk, or a part of one, twice: a short file would have to be read for ever."""
    ends_at = 0
    for index in sorted(chunks, key=lambda index: index.chunk_start_offset):
        offset = index.chunk_start_offset
        if offset < ends_at:
            raise DamageError(f"its index lists the chunk at byte {offset} twice, or inside another")
        ends_at = offset + index.chunk_length


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
        text = str(schema.data, "utf-8", "replace")
        topics[channel.id] = TopicDescription.from_channel(channel.topic, schema.name, text, channel.metadata)
    return topics
