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
"""Reader of a run (a directory or a single MCAP file), which yields messages in log-time order and checks checksums.

A thread reads and decompresses some chunks ahead, in parallel to the analysis of earlier messages.

`McapSource` is one finished file: its summary is checked on opening, its chunks when they are read.
"""

from __future__ import annotations

import bisect
import contextlib
import fcntl
import functools
import os
import re
import zlib
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple  # Any: values of YAML, and types of optional libraries

import attrs
from mcap import records as mcap_records
from mcap.records import ChunkIndex
from mcap.summary import Summary

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.errors import CodecError, RecordingError
from impact_rig.recording import columns, description, records, rigs
from impact_rig.recording.description import RECORD_NAME, Attachment, TopicDescription, verify
from impact_rig.recording.records import DamageError
from impact_rig.system import budget, files
from impact_rig.system.budget import BudgetError, ReadBudget
from impact_rig.topics import Topic

DATA_END_BYTES = records.RECORD_HEAD.size + 4
SEGMENT_BYTES = budget.MIB
"""Number of bytes that are read at once from a file whose messages are outside chunks."""
SQLITE_MAGIC = b"SQLite format 3\0"
CONVERT = (
    "convert it with ROS 2 (printf 'output_bags: [{uri: NEW, storage_id: mcap, all: true}]' > new.yaml; ros2 "
    "bag convert -i BAG -o new.yaml) or without (pip install rosbags; rosbags-convert --src BAG --dst NEW "
    "--dst-storage mcap)"
)
LEAST_AHEAD, AHEAD_BYTES = 2, 4 * budget.MIB
"""Limits of reading ahead: this number of chunks in any case, and more up to this total decompressed size [bytes]."""
_TRAILING_NUMBER = re.compile(r"_(\d+)$")


class Message(NamedTuple):
    """Recorded message: its log time [ns], the time at which it was published [ns], and its CDR bytes.

    `log_time` is rig time in runs of this package. `publish_time` is by the system clock of the publisher, or equals
    `log_time` if the recorder did not know it. `data` is a view of the message's chunk. The chunk stays in memory as
    long as the view exists.
    """

    topic: str
    type_name: str
    log_time: int
    publish_time: int
    sequence: int
    data: memoryview


@attrs.frozen
class RecordedTopic:
    """Topic of a run: its description, and the number of its messages in all files."""

    topic: TopicDescription
    count: int


@attrs.frozen
class Segment:
    """Part of a file that is read at once: a chunk, or consecutive messages outside chunks."""

    offset: int
    length: int
    first_ns: int  # smallest log time of its messages
    last_ns: int
    size: int  # size of its decompressed records [bytes]
    channels: frozenset[int]  # ids of the channels of its messages; empty if unknown
    chunk: ChunkIndex | None  # None if outside chunks

    @classmethod
    def of_chunk(cls, index: ChunkIndex) -> Segment:
        """Return the segment for the chunk that an index record describes."""
        times = index.message_start_time, index.message_end_time
        channels = frozenset(index.message_index_offsets)
        return cls(index.chunk_start_offset, index.chunk_length, *times, index.uncompressed_size, channels, chunk=index)


@attrs.frozen
class _Place:
    """Segment of a run, together with the file that contains it."""

    source: McapSource
    segment: Segment


_Item = tuple[int, int, int, Message]  # log time, number of the chunk, number of the message: a total order


class Run:
    """Recorded run, opened for reading; a context manager that closes its files.

    `tables` yields the rows of a topic block by block. `to_dataframe` and `to_xarray` return all rows at once.
    `messages` yields the messages of any topics. The name of a topic is absolute, or relative to the rig's namespace.
    Only the required parts of the files are read.

    Args:
        path: a run directory or an MCAP file.
        rig: namespace of the rig that relative names refer to; None means the only rig. If there are several rigs,
            relative names then raise an error.

    Attributes:
        topics: recorded topics by full name; each has a `count` of messages and a description `topic`.
        prefixes: prefix of the topics of each rig, such as `/rig/`.
        path: the run directory or file.

    Raises:
        RecordingError: there is no recording, it is not finished, its index is damaged, or it has no such rig.
        ImpactRigError: the recording exceeds a limit of reading, such as the size of a chunk.

    Examples:
        >>> import impact_rig
        >>> rig = impact_rig.LocalRig()
        >>> rig.run(seconds=1)
        >>> with impact_rig.Run(rig.save("recorded")) as run:
        ...     print(run.message_count, run.end_ns - run.start_ns)
        ...     scans = run.to_xarray("daq/scan")
        ...     print(scans["laser"].sizes["time"], scans["laser"].attrs["units"])
        103 990000000
        10000 m

    See Also:
        - `open_run`: opens a run.
        - `info`, `verify`, `export`: work on a whole run.
        - docs/reference/file_formats.md: content of the files.
    """

    def __init__(self, path: str | Path, rig: str | None = None) -> None:
        self.path: Path = Path(path)
        self._rig = rig
        self._ahead = ThreadPoolExecutor(1, thread_name_prefix="read-ahead")
        self.sources: list[McapSource] = []
        try:
            for file in run_files(self.path):
                self.sources.append(McapSource(file))
            self.topics: dict[str, RecordedTopic] = self._merge_topics()
            self._refuse_excess()
            self.prefixes: tuple[str, ...] = rigs.prefixes(
                {name: one.topic.type_name for name, one in self.topics.items()}
            )
            if rig is not None:
                rigs.choose(self.prefixes, rig, self.path)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the files; a second call has no effect."""
        self._ahead.shutdown(cancel_futures=True)  # shut down first, because it reads from these files
        for source in self.sources:
            source.close()

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def message_count(self) -> int:
        """Number of messages on all topics, in all files."""
        return sum(source.statistics.message_count for source in self.sources)

    @property
    def start_ns(self) -> int:
        """Log time [ns] of the earliest message, which is rig time in runs of this package; 0 without messages."""
        return min((s.statistics.message_start_time for s in self._with_messages()), default=0)

    @property
    def end_ns(self) -> int:
        """Log time [ns] of the latest message, which is rig time in runs of this package; 0 without messages."""
        return max((s.statistics.message_end_time for s in self._with_messages()), default=0)

    @functools.cached_property
    def provenance(self) -> dict[str, str]:
        """Provenance of the run: version, seed, wall_start_ns and others.

        It is empty for files of other recorders.

        Raises:
            RecordingError: the record has no checksum or does not match it, or a metadata record is damaged.
        """
        return self.record(RECORD_NAME)

    def record(self, name: str) -> dict[str, str]:
        """Return the content of a metadata record, after a check of its checksum.

        Args:
            name: name of the record; if the run has several of this name, the last one is returned.

        Returns:
            The content; empty if there is no such record.

        Raises:
            RecordingError: the record has no checksum or does not match it, or a metadata record is damaged.
        """
        for source in reversed(self.sources):
            for found, content in reversed(source.metadata()):
                if found == name:
                    verified = verify(content)
                    if verified is None:
                        raise DamageError(
                            f"{self.path}: the metadata record {name!r} has no checksum, or does not match it, so it "
                            "was damaged or changed after the recording: impact-rig recover writes a run without it"
                        )
                    return verified
        return {}

    def attachments(self) -> dict[str, bytes]:
        """Return the files stored inside the recording, by name.

        If several files have the same name, the first file is returned, which was attached at the start.

        Raises:
            RecordingError: an attachment is damaged.
            ImpactRigError: an attachment is larger than any record that may be read.
        """
        found: dict[str, bytes] = {}
        for source in self.sources:
            for one in source.attachments():
                found.setdefault(one.name, one.data)
        return found

    @property
    def rigs(self) -> tuple[str, ...]:
        """Namespaces of the rigs in this recording, such as `/rig`; empty if it contains no topic of a rig."""
        return tuple(map(rigs.namespace, self.prefixes))

    @property
    def prefix(self) -> str:
        """Prefix of the topics of the rig that relative names refer to: its namespace and a slash, such as `/rig/`.

        It is `/` if the recording contains no rig.

        Raises:
            RecordingError: there are several rigs, and none was chosen.
        """
        return rigs.choose(self.prefixes, self._rig, self.path)

    def name(self, wanted: str | Topic) -> str:
        """Return the full name of a topic, whether it was recorded or not.

        Args:
            wanted: a topic or its name; a relative name is completed with the rig's namespace. An absolute name is
                returned unchanged. So is a name that was recorded without a leading slash, unless the completed name
                was recorded as well.

        Raises:
            RecordingError: the name is relative, there are several rigs, and none was chosen.
        """
        text = wanted if isinstance(wanted, str) else wanted.name
        if text.startswith("/"):
            return text
        name = self.prefix + text
        return text if text in self.topics and name not in self.topics else name  # names without any slash are legal

    def relative(self, name: str) -> str | None:
        """Return the name of a recorded topic relative to the chosen rig's namespace.

        Args:
            name: full name of the topic.

        Returns:
            The relative name; None if the topic is not of this rig.

        Raises:
            RecordingError: there are several rigs, and none was chosen.
        """
        others = [one for one in self.prefixes if len(one) > len(self.prefix) and name.startswith(one)]
        return name.removeprefix(self.prefix) if name.startswith(self.prefix) and not others else None

    def resolve(self, wanted: str | Topic) -> str:
        """Return the full name of a topic, and check that the topic was recorded.

        Args:
            wanted: a topic or its name; a relative name is completed with the rig's namespace.

        Raises:
            RecordingError: the topic was not recorded; or the name is relative, there are several rigs, and none was
                chosen.
        """
        name = self.name(wanted)
        if name not in self.topics:
            there = ", ".join(sorted(self.topics)) or "none"
            text = wanted if isinstance(wanted, str) else wanted.name
            raise RecordingError(f"{self.path}: no topic {text!r} in this recording; there are: {there}")
        return name

    def messages(
        self,
        topics: Iterable[str] | None = None,
        *,
        start_ns: int | None = None,
        end_ns: int | None = None,
        recorded_order: bool = False,
    ) -> Generator[Message, None, None]:
        """Yield the messages of a run in log-time order, or in recorded order.

        Messages of equal log time are in recorded order.

        Args:
            topics: topics to read, by absolute names or names relative to the rig's namespace; None means all.
            start_ns: earliest log time of the messages [ns], inclusive; None means from the start.
            end_ns: end of the log times [ns], exclusive; None means to the end.
            recorded_order: whether to yield messages in the order in which they were recorded instead.

        Yields:
            Messages, with `topic`, `type_name`, `log_time` [ns], `publish_time` [ns], `sequence` and `data`: the CDR
            bytes.

        Raises:
            RecordingError: a topic is missing (raised by the call itself), or a chunk is damaged (raised when it is
                read; messages yielded before are valid).
            ImpactRigError: the recording exceeds a limit of reading (raised while messages are read).
        """
        names = None if topics is None else frozenset(self.resolve(topic) for topic in topics)
        return self._merge(names, start_ns, end_ns, recorded_order=recorded_order)

    def holds(self, topic: str | Topic) -> bool:
        """Return whether a topic was recorded.

        Args:
            topic: a topic or its name; a relative name is completed with the rig's namespace.

        Raises:
            RecordingError: the name is relative, there are several rigs, and none was chosen.
        """
        return self.name(topic) in self.topics

    def tables(self, topic: str | Topic, *, recorded_order: bool = False) -> Iterator[Table]:
        """Yield the tables of a topic in log-time order, or in the order of recording.

        Args:
            topic: name of the topic, absolute or relative to the rig's namespace; or an entry of `impact_rig.topics`.
                With an entry, the columns and values of each table are checked as well.
            recorded_order: whether to yield tables in the order in which they were recorded.

        Yields:
            Tables, one per message; for `daq/scan`, one per block of scans.

        Raises:
            RecordingError: the topic is missing or carries no tables (raised by the call itself); or a chunk is
                damaged, or a table does not match the topic (raised when it is read).
        """
        known = None if isinstance(topic, str) else topic
        name = self._table_topic(topic)
        return (self.table(message, known) for message in self.messages([name], recorded_order=recorded_order))

    def table(self, message: Message, topic: Topic | None = None, needs: tuple[str, ...] = ()) -> Table:
        """Decode the table in a message of this run.

        Args:
            message: the message, from `messages`.
            topic: entry of `impact_rig.topics`, with which the columns and values of the table must agree; None allows
                any.
            needs: names of further columns that the table must have, such as the channels of a scan.

        Raises:
            RecordingError: the message is not a valid table.
        """
        try:
            return codec.decode(message.data, topic, needs)
        except CodecError as error:
            raise RecordingError(
                f"{self.path}: the message of {message.topic} with log time {message.log_time} ns is not a valid "
                f"table: {error} (impact-rig recover cannot repair it; Run.messages in Python yields its bytes)"
            ) from error

    def received_tables(self, topic: str) -> Iterator[tuple[Message, Table]]:
        """Yield the messages of a table topic in log-time order, each with its decoded table.

        Args:
            topic: name of the topic.

        Yields:
            Pairs of message and table.

        Raises:
            RecordingError: the topic is missing or carries no tables (raised by the call itself); or a chunk is
                damaged, or a message is not a valid table (raised when it is read).
        """
        name = self._table_topic(topic)
        return ((message, self.table(message)) for message in self.messages([name]))

    def to_dataframe(self, topic: str) -> Any:
        """Return the rows of a table topic as a `pandas.DataFrame`.

        Args:
            topic: name of the topic, such as `daq/scan`.

        Returns:
            One row per row of the tables, with their columns in SI units. Three columns precede them: `time` [s],
            `timestamp`, the same time as a date, and `earlier`, 1 for messages that were published before the recording
            began. `time` counts from the first recorded scan of the topic's rig or, without scans, from the first
            message of the topic.

        Raises:
            RecordingError: the topic is missing, carries no tables, has no message or changes its columns; or a chunk
                or message is damaged.
            ImpactRigError: pandas is not installed.
        """
        return columns.to_dataframe(self, topic)

    def to_xarray(self, topic: str) -> Any:
        """Return the rows of a table topic as an `xarray.Dataset` over `time`.

        Args:
            topic: name of the topic, such as `daq/scan`.

        Returns:
            One variable per column of the tables, with unit and description, where known, as attributes. The
            coordinates are `time`, `timestamp` and `earlier` (published before the recording began), as in
            `to_dataframe`.

        Raises:
            RecordingError: the topic is missing, carries no tables, has no message or changes its columns; or a chunk
                or message is damaged.
            ImpactRigError: xarray is not installed.
        """
        return columns.to_xarray(self, topic)

    def _table_topic(self, topic: str | Topic) -> str:
        name = self.resolve(topic)
        type_name = self.topics[name].topic.type_name
        if type_name != topics.TABLE:
            carried = type_name or "messages of an unknown type"
            raise RecordingError(
                f"{self.path}: topic {name} carries {carried}, not tables ({topics.TABLE}): choose a topic "
                "with tables, or read the messages with Run.messages in Python"
            )
        return name

    def _with_messages(self) -> list[McapSource]:
        return [source for source in self.sources if source.statistics.message_count]

    def _refuse_excess(self) -> None:
        """Raise an error if the index of the recording shows that the recording exceeds the limits of reading.

        No chunk is decompressed for this check.

        Raises:
            BudgetError: chunks, topics or QoS profiles exceed a limit.
        """
        account = self._account()
        with _named(self.path):
            for source in self.sources:
                for segment in source.segments:
                    account.chunk(segment.size)
            budget.allow("topics", len(self.topics), budget.TOPICS)
            texts = sum(len(recorded.topic.offered_qos_text) for recorded in self.topics.values())
            budget.allow("characters of QoS profiles", texts, budget.QOS_CHARACTERS)

    def _account(self) -> ReadBudget:
        return ReadBudget(sum(source.size for source in self.sources))

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
            _Place(source, segment)
            for source in self.sources
            for segment in source.segments
            if _wanted(source, segment, names)
            and (start_ns is None or segment.last_ns >= start_ns)
            and (end_ns is None or segment.first_ns < end_ns)
        ]
        recorded = list(places)
        running_number = {id(place): number for number, place in enumerate(recorded)}
        if not recorded_order:
            places.sort(key=lambda place: place.segment.first_ns)
        pending: list[_Item] = []
        account, most = self._account(), budget.raised(budget.HELD_BYTES // budget.MESSAGE_BYTES)
        coming, ahead = deque(places), deque[tuple[_Place, Future[memoryview]]]()
        while coming or ahead:
            while coming:
                in_memory = [*(place for place, _ in ahead), coming[0]]
                if len(in_memory) > LEAST_AHEAD and _size(*in_memory) > AHEAD_BYTES:
                    break
                self._refuse_hoard(pending, recorded, in_memory)
                place = coming.popleft()
                place.source.refuse_if_closed(place.segment.offset)
                ahead.append((place, self._ahead.submit(place.source.content, place.segment)))
            place, reading = ahead.popleft()
            place.source.refuse_if_closed(place.segment.offset)  # its content may have been read earlier
            content = reading.result()
            with _named(place.source.path):  # counted before any record becomes an object
                account.records(records.count(content, most))
            pending += _items(place, content, names, running_number[id(place)], account)
            cut = len(pending)
            if not recorded_order:
                pending.sort()
                if ahead:  # no later chunk contains a message from before the start of the next one
                    cut = bisect.bisect_left(pending, (ahead[0][0].segment.first_ns,))
            for log_time, _, _, message in pending[:cut]:
                if (start_ns is None or log_time >= start_ns) and (end_ns is None or log_time < end_ns):
                    yield message
            del pending[:cut]

    def _refuse_hoard(self, pending: list[_Item], recorded: Sequence[_Place], coming: Iterable[_Place]) -> None:
        """Raise an error if the segments that must be in memory at the same time are too large.

        A segment is a chunk, or a part of a file outside chunks. It stays in memory until its latest message has been
        yielded, so a hostile recording could keep many segments in memory.

        Args:
            pending: messages that have been read but not yielded.
            recorded: all segments; the second item of a pending message is the index of its segment in this sequence.
            coming: segments that are already being read ahead, and the one to be read next.

        Raises:
            BudgetError: the decompressed segments of the pending messages and of `coming`, together with the messages
                themselves, exceed `budget.HELD_BYTES`.
        """
        held = [*(recorded[number] for number in {item[1] for item in pending}), *coming]
        size = _size(*held) + budget.MESSAGE_BYTES * len(pending)
        with _named(self.path):
            budget.allow("bytes of chunks in memory because messages are out of order", size, budget.HELD_BYTES)


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """Add the path of a run or file to the message of a BudgetError or DamageError raised in the `with` block.

    The message of a DamageError also gets the remedy.
    """
    try:
        yield
    except BudgetError as error:
        raise BudgetError(f"{path}: {error}") from error
    except DamageError as error:
        raise DamageError(f"{path}: {error}; {_REMEDY}") from error


def _size(*places: _Place) -> int:
    return sum(place.segment.size for place in places)


def open_run(path: Path | str, rig: str | None = None) -> Run:
    """Open a run directory or an MCAP file for reading.

    Args:
        path: a run directory or an MCAP file, also one of rosbag2.
        rig: namespace of the rig that relative names refer to; None means the only rig. If there are several rigs,
            relative names then raise an error.

    Returns:
        The run, a context manager that closes the files. Messages are read from the files when they are needed.

    Raises:
        RecordingError: there is no recording, it is not finished, its index is damaged, or it has no such rig.
        ImpactRigError: the recording exceeds a limit of reading, such as the size of a chunk.

    Examples:
        Record one second, and read it block by block:

        >>> import impact_rig
        >>> rig = impact_rig.LocalRig()
        >>> rig.run(seconds=1)
        >>> path = rig.save("opened")
        >>> with impact_rig.open_run(path) as run:
        ...     print(sum(len(table.rows) for table in run.tables("daq/scan")))
        10000

        All scans as a data frame of pandas:

        >>> with impact_rig.open_run(path) as run:
        ...     run.to_dataframe("daq/scan").shape
        (10000, 8)

    See Also:
        - `Run`: what an open run offers.
        - `info`: checks whether a run is complete.
        - `LocalRig` (`save`, `record`): writes runs.
    """
    return Run(path, rig)


def run_files(path: Path) -> list[Path]:
    """Return the MCAP files of a run, in the order of recording.

    The files are those that `metadata.yaml` lists. Without `metadata.yaml` they are all MCAP files in the directory,
    sorted as by `mcap_files`. If `path` is a file, the result is this file. For a directory without MCAP files, the
    result is its SQLite or compressed files: opening such a file raises an error that says how to convert it.

    Raises:
        RecordingError: `path` does not exist or contains no such file, `metadata.yaml` cannot be read, or a file that
            it lists is missing.
        BudgetError: `metadata.yaml` is too large.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        why = "is neither a run directory nor an MCAP file" if path.exists() else "does not exist: check the path"
        raise RecordingError(f"{path} {why}")
    listed = [_listed(path, name) for name in _listed_files(path)]
    missing = [file.name for file in listed if not file.exists()]
    if missing:
        raise RecordingError(
            f"{path} lacks {', '.join(sorted(missing))}, listed in its {description.METADATA_FILE}: copy what is "
            "missing there, or save the other files with impact-rig recover"
        )
    found = listed or mcap_files(path) or sorted(path.glob("*.db3")) or sorted(path.glob("*.mcap.zstd"))
    if not found:
        below = sorted({file.parent.name for file in path.glob("*/*.mcap")})
        remedy = f"; name one of the recordings in it: {', '.join(below)[:300]}" if below else ""
        raise RecordingError(f"{path} holds no *.mcap file, so it is not a recording{remedy}")
    return found


def _listed(directory: Path, name: str) -> Path:
    """Return the path of a file that `metadata.yaml` lists under `name`.

    For a compressed file `x.mcap.zstd`, it is the path of `x.mcap` if that file exists. Directories in `name`, which
    older versions of rosbag2 write, are ignored.
    """
    file = directory / Path(name).name
    unpacked = file.with_suffix("") if file.suffix == ".zstd" else file
    return unpacked if unpacked.exists() else file


def mcap_files(directory: Path) -> list[Path]:
    """Return the MCAP files in a directory, sorted by name; numbers at the end of names are sorted as numbers.

    `metadata.yaml` is not used.
    """
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
        if not isinstance(listed, list):
            raise TypeError(listed)  # noqa: TRY301  # one message for all of them
        return [str(name) for name in listed]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror}") from error
    except (KeyError, TypeError) as error:
        where = f"{description.METADATA_KEY}: relative_file_paths"
        raise RecordingError(f"cannot parse {path}: it has no list {where}; {_WITHOUT_METADATA}") from error
    except ValueError as error:
        raise RecordingError(f"cannot parse {path}: {error}; {_WITHOUT_METADATA}") from error


def _decompressed(chunk: mcap_records.Chunk, size: int) -> memoryview:
    """Return the decompressed records of a chunk.

    Raises:
        DamageError: the chunk is damaged, or does not state the decompressed `size` that the index states.
        BudgetError: the chunk is larger than any record that may be read.
    """
    if chunk.uncompressed_size != size:
        raise DamageError(f"it states a decompressed size of {chunk.uncompressed_size} bytes, the index {size} bytes")
    return records.decompress(chunk)


def _wanted(source: McapSource, segment: Segment, names: frozenset[str] | None) -> bool:
    if names is None or not segment.channels:  # the channels are unknown
        return True
    return any(source.topics[i].name in names for i in segment.channels if i in source.topics)


def _items(
    place: _Place, content: memoryview, names: frozenset[str] | None, number_of_place: int, account: ReadBudget
) -> list[_Item]:
    """Return the messages of the named topics in a decompressed segment, as tuples that sort by log time.

    `content` is the decompressed segment. `names` contains full names; None means all topics. A tuple is (log time,
    number of the segment, number of the message in the segment, message). If messages are compressed one by one, their
    decompressed sizes are added to `account`.
    """
    topics = place.source.topics
    wanted = None if names is None else frozenset(i for i, topic in topics.items() if topic.name in names)
    items = []
    with _named(place.source.path):
        for number, raw in enumerate(records.messages(content, wanted)):
            topic, data = topics.get(raw.channel_id), raw.data
            if topic is None:
                raise DamageError(f"its index lacks the topic (MCAP channel {raw.channel_id}) of a message")
            if topic.encoding == description.SERIALIZATION and bytes(data[:4]) == records.ZSTD_MAGIC:
                data = records.plain_message(data, budget.raised(budget.CHUNK_BYTES))
                account.chunk(len(data))
            message = Message(topic.name, topic.type_name, raw.log_time, raw.publish_time, raw.sequence, data)
            items.append((raw.log_time, number_of_place, number, message))
    return items


_REMEDY = "impact-rig recover saves the intact chunks, if there are any"
_WITHOUT_METADATA = f"impact-rig recover does not need it, and writes a new {description.METADATA_FILE}"
_BEING_WRITTEN = (
    "it is still being recorded: read it when the recording has ended (Ctrl-C, or ~/stop of the recorder), or "
    "copy its present content with impact-rig recover"
)


class McapSource:
    """One finished MCAP file, opened for reading; its index is checked on opening, its records when they are read.

    Raises:
        RecordingError: the file cannot be opened, is not finished or is damaged.
        BudgetError: the file exceeds a limit of reading, such as the size of the index.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with files.translate_errors(f"cannot open {path}"):
            self._fd = files.open_regular(path)
        try:
            self.size = os.fstat(self._fd).st_size
            self.summary = read_summary(self._fd, self.size)
            assert self.summary.statistics is not None
            self.statistics = self.summary.statistics
            self.topics = topics_of(self.summary)
            self.segments = self._segments()
        except DamageError as error:
            being_written = self._is_being_written()
            self.close()
            if being_written:
                raise RecordingError(f"{path}: {_BEING_WRITTEN}") from error
            raise DamageError(f"{path}: {error}; {_REMEDY}") from error
        except (ForeignBagError, BudgetError) as error:
            self.close()
            raise type(error)(f"{path}: {error}") from error
        except OSError as error:
            self.close()
            raise RecordingError(f"reading {path} failed: {error.strerror}") from error

    def close(self) -> None:
        """Close the file; a second call has no effect."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def refuse_if_closed(self, offset: int) -> None:
        """Raise an error if this file has been closed; `offset` is the byte of the segment to be read, for the message.

        Raises:
            RecordingError: the file has been closed.
        """
        if self._fd < 0:
            raise RecordingError(f"cannot read {self.path} at byte {offset}: the run has been closed; open it again")

    def _is_being_written(self) -> bool:
        """Return whether a recorder still writes this file.

        A recorder locks its file until the file is finished. The result is False on a file system without locks.
        """
        try:
            fcntl.flock(self._fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        fcntl.flock(self._fd, fcntl.LOCK_UN)
        return False

    def _segments(self) -> list[Segment]:
        """Return the segments of this file, in file order: its chunks, and parts with messages outside chunks.

        A part outside chunks has at most 1 MiB, or consists of one larger message. If the statistics of the file count
        no messages, only the chunks are listed.
        """
        chunks = (Segment.of_chunk(index) for index in self.summary.chunk_indexes)
        outside = self._outside_chunks() if self.statistics.message_count else ()
        return sorted([*chunks, *outside], key=lambda segment: segment.offset)

    def _outside_chunks(self) -> Iterator[Segment]:
        """Yield segments of consecutive messages outside chunks.

        Messages outside chunks have no index, so the heads of all records are read that the index does not list.

        Raises:
            DamageError: a record is truncated, a message is too short, the index lacks a chunk, or the data section has
                no end.
        """
        summary = self.summary
        indexed = {one.offset: one.length for one in summary.attachment_indexes}
        indexed |= {one.offset: one.length for one in summary.metadata_indexes}
        for chunk in summary.chunk_indexes:
            indexed[chunk.chunk_start_offset] = chunk.chunk_length + chunk.message_index_length
        position, view, base = len(records.MAGIC), b"", 0
        start = ended = 0
        times: list[int] = []
        channels: set[int] = set()
        while True:
            opcode, end = 0, position + indexed.get(position, 0)
            if end == position:  # the index does not list it
                if position + records.MESSAGE_HEAD.size > base + len(view):
                    base, view = position, os.pread(self._fd, SEGMENT_BYTES, position)
                if len(view) - (position - base) < records.RECORD_HEAD.size:
                    raise DamageError("its data section has no end (DataEnd record)")
                opcode, length = records.RECORD_HEAD.unpack_from(view, position - base)
                end += records.RECORD_HEAD.size + length
                if end > self.size:
                    left = self.size - position - records.RECORD_HEAD.size
                    raise DamageError(
                        f"the record at byte {position} of the file states {length} bytes, only {left} are left"
                    )
            if times and (opcode in {0, records.DATA_END} or end - start > SEGMENT_BYTES):
                size = ended - start
                yield Segment(start, size, min(times), max(times), size, frozenset(channels), chunk=None)
                times, channels = [], set()
            if opcode == records.DATA_END:
                return
            if opcode == records.CHUNK:
                raise DamageError(f"its index lacks the chunk at byte {position}")
            if opcode == records.MESSAGE:
                if end - position < records.MESSAGE_HEAD.size:
                    raise DamageError(f"the message at byte {position} of the file is too short")
                _, _, channel, _, log_time, _ = records.MESSAGE_HEAD.unpack_from(view, position - base)
                start, ended = start if times else position, end
                times.append(log_time)
                channels.add(channel)
            position = end

    def content(self, segment: Segment) -> memoryview:
        """Return the decompressed records of a segment, after a check of the checksum of its chunk, if there is one.

        Raises:
            RecordingError: the segment cannot be read, or is a damaged chunk; other segments are not checked here.
            BudgetError: the chunk is larger than any record that may be read.
        """
        if segment.chunk is None:
            with files.translate_errors(f"cannot read {self.path} at byte {segment.offset}"):
                return memoryview(os.pread(self._fd, segment.length, segment.offset))
        try:
            chunk = records.parse(mcap_records.Chunk, self._record(segment.chunk, records.CHUNK))
            return _decompressed(chunk, segment.size)
        except DamageError as error:
            where = f"{self.path}: the chunk at byte {segment.offset} is damaged"
            raise DamageError(f"{where}: {error}; {_REMEDY}") from error

    def attachments(self) -> list[Attachment]:
        """Return the files that are stored inside this file.

        Raises:
            RecordingError: an attachment is damaged.
            BudgetError: an attachment is larger than any record that may be read.
        """
        found = (record for record, _ in self.attachment_records())
        return [Attachment(record.name, bytes(record.data), record.media_type) for record in found]

    def attachment_records(self) -> list[tuple[mcap_records.Attachment, bool]]:
        """Return the attachment records of this file, each with a flag whether it carries a checksum.

        A checksum that is present has been checked, and matches.

        Raises:
            RecordingError: an attachment is damaged.
            BudgetError: an attachment is larger than any record that may be read.
        """
        found = []
        for index in self.summary.attachment_indexes:
            try:
                content = self._record(index, records.ATTACHMENT)
                attachment = records.parse(mcap_records.Attachment, content)
                fits = records.attachment_crc(content)
                if fits is False:
                    raise DamageError("its checksum does not match")  # noqa: TRY301  (one place words both kinds of damage)
            except DamageError as error:
                where = f"{self.path}: the attachment at byte {index.offset} is damaged"
                raise DamageError(f"{where}: {error}; {_REMEDY}") from error
            found.append((attachment, fits is not None))
        return found

    def metadata(self) -> list[tuple[str, dict[str, str]]]:
        """Return name and content of the metadata records of this file, in the order of its index.

        The content is not checked. `description.verify` checks the checksums that this package stores in its own
        records.

        Raises:
            RecordingError: a metadata record is damaged.
            BudgetError: a metadata record is larger than any record that may be read.
        """
        found = []
        for index in self.summary.metadata_indexes:
            try:
                record = records.parse(mcap_records.Metadata, self._record(index, records.METADATA))
            except DamageError as error:
                where = f"{self.path}: the metadata record at byte {index.offset} is damaged"
                raise DamageError(f"{where}: {error}; {_REMEDY}") from error
            found.append((record.name, record.metadata))
        return found

    @property
    def fd(self) -> int:
        """Descriptor of the open file, for `os.pread`; -1 after `close`."""
        return self._fd

    def crc(self, segment: Segment) -> int:
        """Return the checksum of the content of a chunk, as the head of the chunk states it.

        The result is 0 if the head states no checksum or is truncated. The segment must be a chunk.

        Raises:
            RecordingError: the chunk cannot be read.
        """
        head = records.RECORD_HEAD.size + records.CHUNK_HEAD.size
        with files.translate_errors(f"cannot read {self.path} at byte {segment.offset}"):
            data = os.pread(self._fd, head, segment.offset)
        return int(records.CHUNK_HEAD.unpack_from(data, records.RECORD_HEAD.size)[-1]) if len(data) == head else 0

    def data_end(self) -> int:
        """Return the offset [bytes] at which the DataEnd record must begin.

        This record must end where the summary begins.
        """
        tail_bytes = records.FOOTER_BYTES + len(records.MAGIC)
        tail = os.pread(self._fd, tail_bytes, self.size - tail_bytes)
        content = memoryview(tail)[records.RECORD_HEAD.size : records.FOOTER_BYTES]
        return records.parse(mcap_records.Footer, content).summary_start - DATA_END_BYTES

    def record_at(self, offset: int, opcode: int) -> memoryview:
        """Return the content of the record at an offset of the file, which must have this opcode.

        Raises:
            RecordingError: there is no complete record of this kind at the offset (a DamageError), or the file cannot
                be read.
            BudgetError: the record is larger than any that may be read.
        """
        with files.translate_errors(f"cannot read {self.path} at byte {offset}"):
            head = os.pread(self._fd, records.RECORD_HEAD.size, offset)
        if len(head) < records.RECORD_HEAD.size:
            raise DamageError("the file is shorter than its index says")
        return self._read_record(offset, len(head) + records.RECORD_HEAD.unpack(head)[1], opcode)

    def _record(
        self, index: ChunkIndex | mcap_records.AttachmentIndex | mcap_records.MetadataIndex, opcode: int
    ) -> memoryview:
        if isinstance(index, ChunkIndex):
            return self._read_record(index.chunk_start_offset, index.chunk_length, opcode)
        return self._read_record(index.offset, index.length, opcode)

    def _read_record(self, offset: int, length: int, opcode: int) -> memoryview:
        if length > self.size - offset:
            raise DamageError(f"its length is stated as {length} bytes, only {self.size - offset} are left in the file")
        budget.allow(f"bytes in the record at byte {offset} of {self.path}", length, budget.CHUNK_BYTES + budget.MIB)
        # a bad sector, or the file has been closed
        with files.translate_errors(f"cannot read {self.path} at byte {offset}"):
            view = memoryview(os.pread(self._fd, length, offset))
        if len(view) != length:
            raise DamageError("the file has become shorter since it was opened")
        head = records.RECORD_HEAD.size
        if length < head or records.RECORD_HEAD.unpack_from(view) != (opcode, length - head):
            raise DamageError("the record at this byte is of another kind or length than the index states")
        return view[head:]


class ForeignBagError(RecordingError):
    """Error of a rosbag2 recording that is not a plain MCAP file; the message contains a command that converts it."""


def refuse_foreign(fd: int) -> None:
    """Raise an error if a file is in SQLite or compressed as a whole with zstd.

    The error message has a command that converts the file. Other files raise no error, even if they are not MCAP files.

    Raises:
        ForeignBagError: the file is in SQLite, or compressed as a whole.
    """
    begin = os.pread(fd, len(SQLITE_MAGIC), 0)
    if begin.startswith(SQLITE_MAGIC):
        raise ForeignBagError(f"it is a bag in SQLite, only MCAP is read; {CONVERT}")
    if begin.startswith(records.ZSTD_MAGIC):
        raise ForeignBagError(
            f"it is compressed as a whole (compression_mode: file); unpack it (zstd -d), or {CONVERT}"
        )


def read_summary(fd: int, size: int) -> Summary:
    """Read and check the summary of an open MCAP file of `size` bytes.

    Raises:
        DamageError: the file is not a finished MCAP file, or the summary is damaged.
        ForeignBagError: the file is a bag in SQLite, or compressed as a whole.
        BudgetError: the summary is larger than `budget.INDEX_BYTES`.
    """
    magic, tail_bytes = len(records.MAGIC), records.FOOTER_BYTES + len(records.MAGIC)
    refuse_foreign(fd)
    if os.pread(fd, magic, 0) != records.MAGIC:
        raise DamageError("it does not begin like an MCAP file")
    tail = os.pread(fd, tail_bytes, max(0, size - tail_bytes))
    if size < magic + tail_bytes or not tail.endswith(records.MAGIC):
        raise DamageError("its end is missing: its recorder was interrupted or still writes, or the copy is incomplete")
    head = records.RECORD_HEAD.size
    if records.RECORD_HEAD.unpack_from(tail) != (records.FOOTER, records.FOOTER_BYTES - head):
        raise DamageError("its last record (footer) is damaged")
    footer = records.parse(mcap_records.Footer, memoryview(tail)[head : records.FOOTER_BYTES])
    start, crc = footer.summary_start, footer.summary_crc
    footer_offset = size - tail_bytes
    if start == 0:
        raise DamageError("it has no index")
    if not magic <= start <= footer_offset:
        raise DamageError(
            "its last record (footer) states that the index is outside the file: the footer is damaged, or "
            "a part of the file is missing"
        )
    budget.allow("bytes in an index", footer_offset - start, budget.INDEX_BYTES)
    section = os.pread(fd, footer_offset - start, start)
    guarded = records.FOOTER_BYTES - 4  # the checksum covers the footer up to itself
    if crc not in (0, zlib.crc32(tail[:guarded], zlib.crc32(section))):
        raise DamageError("the checksum of its index does not match")
    return parse_summary(memoryview(section))


def parse_summary(section: memoryview) -> Summary:
    """Parse the summary section of an MCAP file: its schemas, channels, indexes and statistics.

    Raises:
        DamageError: the section is not a sequence of records or has no statistics. Or it lists another number of
            chunks, fewer topics or fewer message definitions than its statistics state. Or chunks overlap.
    """
    try:
        found = _summary_records(section)
    except DamageError as error:
        raise DamageError(f"its index is damaged: {error}") from error
    chunks, statistics = found.chunk_indexes, found.statistics
    if statistics is None:
        raise DamageError("its index has no statistics (numbers of messages and topics)")
    if statistics.chunk_count != len(chunks):
        raise DamageError(f"its index lists {len(chunks)} chunks, but its statistics count {statistics.chunk_count}")
    for what, listed, count in (
        ("topics", len(found.channels), statistics.channel_count),
        ("message definitions", len(found.schemas), statistics.schema_count),
    ):
        if listed < count:
            raise DamageError(f"its index lists {listed} of the {count} {what} that its statistics count")
    _refuse_shared_bytes(chunks)
    return found


def _summary_records(section: memoryview) -> Summary:
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
    return found


def _refuse_shared_bytes(chunks: list[ChunkIndex]) -> None:
    """Raise a DamageError if two chunks in an index overlap.

    With overlapping chunks, a short file could claim endless content.
    """
    ends_at = 0
    for index in sorted(chunks, key=lambda index: index.chunk_start_offset):
        offset = index.chunk_start_offset
        if offset < ends_at:
            raise DamageError(f"its index lists the chunk at byte {offset} twice, or beginning inside another")
        ends_at = offset + index.chunk_length


def topics_of(summary: Summary) -> dict[int, TopicDescription]:
    """Return the topic of every channel in a summary, by the id of the channel.

    Raises:
        DamageError: a channel refers to a missing schema.
        BudgetError: there are too many topics.
    """
    budget.allow("topics", len(summary.channels), budget.TOPICS)
    topics = {}
    for channel in summary.channels.values():
        schema = summary.schemas.get(channel.schema_id)
        if schema is None and channel.schema_id:
            raise DamageError(f"its index lacks the message definition of topic {channel.topic}")
        topics[channel.id] = TopicDescription.from_channel(channel, schema)
    return topics
