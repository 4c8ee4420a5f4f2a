# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Reads a run: a directory or a single MCAP file, message by message in log-time order, every byte checked.

Chunks are read and decompressed one ahead in a thread (the decompressor releases the interpreter), so that an analysis
on another core hardly waits for them.
"""

from __future__ import annotations

import bisect
import re
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple  # Any: what YAML may hold

import attrs

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.errors import CodecError, RecordingError
from impact_rig.recording import bag_metadata, records
from impact_rig.recording.description import TopicDescription, matches, resolve
from impact_rig.recording.mcap_source import McapSource
from impact_rig.recording.provenance import RECORD_NAME, verify
from impact_rig.recording.records import DamageError
from impact_rig.system import budget, files, plain_yaml
from impact_rig.system.budget import BudgetError, Spending
from impact_rig.topics import Topic

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
    index: records.ChunkIndex


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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def message_count(self) -> int:
        """Messages in all files."""
        return sum(source.summary.statistics.message_count for source in self.sources)

    @property
    def start_ns(self) -> int:
        """Log time of the earliest message; 0 without messages."""
        return min((s.summary.statistics.start_ns for s in self._with_messages()), default=0)

    @property
    def end_ns(self) -> int:
        """Log time of the latest message; 0 without messages."""
        return max((s.summary.statistics.end_ns for s in self._with_messages()), default=0)

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
        return {found.name: found.data for source in reversed(self.sources) for found in source.attachments()}

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
        return [source for source in self.sources if source.summary.statistics.message_count]

    def _refuse_excess(self) -> None:
        """Refuse what the index alone shows to be beyond the budget.

        Raises:
            BudgetError: it is.
        """
        account = self._account()
        try:
            for source in self.sources:
                for index in source.summary.chunks:
                    account.chunk(index.uncompressed_size)
            budget.allow("topics", len(self.topics), budget.TOPICS)
            texts = sum(len(recorded.topic.offered_qos_text) for recorded in self.topics.values())
            budget.allow("characters of QoS profiles", texts, budget.QOS_CHARACTERS)
        except BudgetError as error:
            raise BudgetError(f"{self.path}: {error}") from error

    def _account(self) -> Spending:
        return Spending(sum(source.size for source in self.sources))

    def _merge_topics(self) -> dict[str, RecordedTopic]:
        merged: dict[str, RecordedTopic] = {}
        for source in self.sources:
            for channel_id, topic in source.topics.items():
                count = source.summary.statistics.channel_counts.get(channel_id, 0)
                known = merged.get(topic.name)
                merged[topic.name] = RecordedTopic(topic, count + (known.count if known else 0))
        return merged

    def _merge(
        self, names: frozenset[str] | None, start_ns: int | None, end_ns: int | None, *, recorded_order: bool
    ) -> Generator[Message, None, None]:
        places = [
            _Place(source, index)
            for source in self.sources
            for index in source.summary.chunks
            if _wanted(source, index, names)
            and (start_ns is None or index.end_ns >= start_ns)
            and (end_ns is None or index.start_ns < end_ns)
        ]
        recorded = list(places)
        running_number = {id(place): number for number, place in enumerate(recorded)}
        if not recorded_order:
            places.sort(key=lambda place: place.index.start_ns)
        pending: list[_Item] = []
        account = self._account()
        with ThreadPoolExecutor(1, thread_name_prefix="read-ahead") as pool:
            ahead = [pool.submit(place.source.chunk, place.index) for place in places[:1]]
            for number, place in enumerate(places):
                content = ahead.pop().result()
                following = places[number + 1] if number + 1 < len(places) else None
                if following is not None:
                    self._refuse_hoard(pending, recorded, (place, following))
                    ahead.append(pool.submit(following.source.chunk, following.index))
                self._count(content, account)
                pending += _items(place, content, names, running_number[id(place)])
                cut = len(pending)
                if not recorded_order:
                    pending.sort()
                    if following is not None:  # nothing in the chunks to come is earlier than the next one's start
                        cut = bisect.bisect_left(pending, (following.index.start_ns,))
                for log_time, _, _, message in pending[:cut]:
                    if (start_ns is None or log_time >= start_ns) and (end_ns is None or log_time < end_ns):
                        yield message
                del pending[:cut]

    def _refuse_hoard(self, pending: list[_Item], recorded: Sequence[_Place], coming: Iterable[_Place]) -> None:
        """Refuse to hold many chunks because each has a message that is much later than the others.

        Raises:
            BudgetError: they are too large together.
        """
        held = [*(recorded[number] for number in {item[1] for item in pending}), *coming]
        size = sum(place.index.uncompressed_size for place in held) + budget.MESSAGE_BYTES * len(pending)
        try:
            budget.allow("bytes held until their time has come", size, budget.HELD_BYTES)
        except BudgetError as error:
            raise BudgetError(f"{self.path}: {error}") from error

    def _count(self, content: memoryview, account: Spending) -> None:
        """Count the records of a chunk before any of them becomes an object.

        Raises:
            DamageError: they are no records.
            BudgetError: there are too many.
        """
        most = round(budget.HELD_BYTES // budget.MESSAGE_BYTES * budget.factor())
        try:
            account.records(records.count(content, most))
        except BudgetError as error:
            raise BudgetError(f"{self.path}: {error}") from error


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
    files = sorted(path.glob("*.mcap"), key=_split_order)
    missing = set(_listed_files(path)) - {file.name for file in files}
    if missing:
        raise RecordingError(f"{path}: {', '.join(sorted(missing))} is missing ({bag_metadata.FILE_NAME} lists it)")
    if not files:
        raise RecordingError(f"{path} holds no *.mcap file")
    return files


def _split_order(file: Path) -> tuple[str, int]:
    match = _TRAILING_NUMBER.search(file.stem)
    return (file.stem[: match.start()], int(match[1])) if match else (file.stem, -1)


def _listed_files(directory: Path) -> list[str]:
    path = directory / bag_metadata.FILE_NAME
    try:
        size = path.stat().st_size
        budget.allow(f"bytes in {path}", size, budget.METADATA_BYTES)
        content: Any = plain_yaml.load(str(files.read_bytes(path, size), "utf-8"), size)
        listed = content[bag_metadata.TOP_KEY]["relative_file_paths"]
        return [str(name) for name in listed]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise RecordingError(f"{path} cannot be understood: {error}") from error


def _wanted(source: McapSource, index: records.ChunkIndex, names: frozenset[str] | None) -> bool:
    if names is None or not index.channel_ids:  # no message index: the chunk may hold anything
        return True
    return any(source.topics[i].name in names for i in index.channel_ids if i in source.topics)


def _items(place: _Place, content: memoryview, names: frozenset[str] | None, chunk_number: int) -> list[_Item]:
    """Return the wanted messages of a chunk, each with its sort key.

    Raises:
        DamageError: a message belongs to a channel the file's index does not know.
    """
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
