# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Gives back what is whole in a run that was cut short or damaged: a new run, index and statistics complete.

Only messages whose chunk fits its checksum are handed out, only attachments that fit theirs, only metadata that carries
one: everything in the result is as it was recorded. What is left out is listed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from impact_rig.errors import RecordingError
from impact_rig.recording import bag_metadata, losses, mcap_source, provenance, records
from impact_rig.recording.description import TopicDescription
from impact_rig.recording.provenance import Attachment, Provenance
from impact_rig.recording.reader import run_files
from impact_rig.recording.records import DamageError
from impact_rig.recording.tail import FOLLOWS, tail_of
from impact_rig.recording.tail import RECORD_NAME as TAIL_RECORD_NAME
from impact_rig.recording.writer import RunWriter
from impact_rig.runs import recovery_record
from impact_rig.runs.recovery_record import Recovered
from impact_rig.runs.recovery_report import FileReport, RecoverReport
from impact_rig.runs.salvage import Damage, DamagedFile, Found
from impact_rig.system.budget import BudgetError, Spending
from impact_rig.system.endings import unhurried


def recover(path: Path | str, out: Path | str, *, accept_unchecked: bool = False) -> RecoverReport:
    """Write every whole chunk of a damaged or unfinished run, and of its tail, to the new run directory `out`.

    Args:
        path: a run directory or an MCAP file; it is only read.
        out: the new run directory; must not hold a recording.
        accept_unchecked: also take chunks without a checksum, as rosbag2 writes them by default: they may be wrong.

    Raises:
        RecordingError: nothing whole was found (then nothing is written), `path` cannot be read or `out` written.
    """
    source, target = Path(path), Path(out)
    report = RecoverReport(target)
    files = _files(source, report)
    report.account = Spending(_bytes(files))
    salvages = [_Salvage(file, report, accept_unchecked=accept_unchecked) for file in files]
    origin = next((salvage.provenance for salvage in salvages if salvage.provenance is not None), None)
    attachments = {found.name: found for salvage in salvages for found in salvage.attachments}
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
                            losses.RECORD_NAME: accounts[-1] if accounts else {},
                            recovery_record.NAME: _record(source, report).to_record(),
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
            with unhurried():
                writer.finish()
    if writer is None:
        reasons = "; ".join(dict.fromkeys(damage.reason for damage in report.damages)) or "it holds no messages"
        raise RecordingError(f"nothing can be recovered from {source}: {reasons}")
    return report


def _record(source: Path, report: RecoverReport) -> Recovered:
    return Recovered(
        source=source.name,
        damages=report.damage_count,
        lost_bytes=report.lost_bytes,
        missing_messages=report.missing_messages,
        unfinished=report.expected_messages is None,
    )


def _files(path: Path, report: RecoverReport) -> list[Path]:
    try:
        return run_files(path)
    except (RecordingError, BudgetError) as error:
        # what metadata.yaml says of a damaged run may be damaged too: the files that are there count
        files = sorted(path.glob("*.mcap"))
        if not files:
            raise
        report.note(Damage(path.name, 0, 0, str(error)))
        return files


def _bytes(files: Iterable[Path]) -> int:
    """Return the size of recordings and their tails."""
    return sum(path.stat().st_size for file in files for path in (file, tail_of(file)) if path.exists())


class _Salvage:
    """One damaged file: first pass on construction (definitions, attachments, provenance), second for the messages."""

    def __init__(
        self, path: Path, report: RecoverReport, *, accept_unchecked: bool, figures: FileReport | None = None
    ) -> None:
        self.path = path
        self.attachments: list[Attachment] = []
        self.follows: int | None = None
        """Of a tail: size of the recording when the chunk began whose messages it holds [bytes]."""
        self.provenance: Provenance | None = None
        self.losses: dict[str, str] = {}
        self.figures = figures or report.file(path)
        self._report = report
        self._accept_unchecked = accept_unchecked
        self._schemas: dict[int, records.SchemaRecord] = {}
        self._topics: dict[int, TopicDescription] = {}
        with DamagedFile(path) as file:
            self._read_summary(file)
            for found in file.walk():
                if isinstance(found, Damage):
                    report.note(found)
                elif found.opcode == records.ATTACHMENT:
                    self._take_attachment(file, found)
                elif found.opcode == records.METADATA:
                    self._take_metadata(file, found)
                elif found.opcode == records.MESSAGE:
                    report.note(self._damage(found, "a message outside a chunk carries no checksum"))

    def introduce_topics(self, writer: RunWriter) -> None:
        """Make all topics that are known so far known to `writer`, in the order they were registered."""
        for _, topic in sorted(self._topics.items()):
            self.introduce(topic, writer)

    def introduce(self, topic: TopicDescription, writer: RunWriter) -> bool:
        """Make a topic known to `writer`; return False if it contradicts another of that name, which is noted."""
        try:
            writer.add_topic(topic)
        except RecordingError as error:
            if writer.closed:
                raise
            self._report.note(Damage(self.path.name, 0, 0, str(error)))
            return False
        return True

    def messages(self) -> Iterator[tuple[TopicDescription, records.RawMessage]]:
        """Yield the messages of all whole chunks in the order of the file, and those of the chunk that was open."""
        last = -1  # where the last whole chunk begins
        with DamagedFile(self.path) as file:
            for found in file.walk():
                if isinstance(found, Found) and found.opcode == records.CHUNK:
                    chunks = self.figures.chunks
                    yield from self._messages(file, found)
                    last = found.offset if self.figures.chunks > chunks else last
        yield from self._open_chunk(last)

    def _open_chunk(self, last: int) -> Iterator[tuple[TopicDescription, records.RawMessage]]:
        """Yield the messages of the tail, unless a chunk that begins no earlier than `last` has made it superfluous."""
        tail = tail_of(self.path)
        if not tail.exists():
            return
        follows = _Salvage(tail, RecoverReport(self._report.directory), accept_unchecked=False).follows
        if follows is not None and follows > last:
            self._report.heal(self.path.name, follows)  # the chunk itself may have been cut short in the writing
            yield from _Salvage(tail, self._report, accept_unchecked=False, figures=self.figures).messages()

    def _messages(self, file: DamagedFile, found: Found) -> Iterator[tuple[TopicDescription, records.RawMessage]]:
        try:
            chunk = records.parse_chunk(file.content(found))
            self._report.account.chunk(chunk.uncompressed_size)
            content = records.decompress(chunk, need_crc=not self._accept_unchecked)
            self._report.account.records(records.count(content, most=len(content)))
            for definition in records.definitions(content):
                self._define(definition)
            messages = list(records.messages(content, None))
        except (DamageError, BudgetError) as error:
            self._report.note(self._damage(found, str(error)))
            return
        self.figures.chunks += 1
        unknown = 0
        for message in messages:
            topic = self._topics.get(message.channel_id)
            if topic is None:
                unknown += 1
            else:
                yield topic, message
        if unknown:
            self._report.note(self._damage(found, f"{unknown} messages whose topic's definition is lost", length=0))

    def _read_summary(self, file: DamagedFile) -> None:
        try:
            summary = mcap_source.read_summary(file.fd, file.size)
            self._topics.update(mcap_source.topics_of(summary))
        except DamageError:
            return
        self._schemas.update(summary.schemas)
        self.figures.expect(summary.statistics)

    def _define(self, definition: records.SchemaRecord | records.ChannelRecord) -> None:
        if isinstance(definition, records.SchemaRecord):
            self._schemas[definition.id] = definition
            return
        schema = self._schemas.get(definition.schema_id)
        if schema is not None:
            text = schema.data.decode("utf-8", errors="replace")
            topic = TopicDescription.from_channel(definition.topic, schema.name, text, definition.metadata)
            self._topics[definition.id] = topic

    def _take_attachment(self, file: DamagedFile, found: Found) -> None:
        attachment = records.parse_attachment(file.content(found))
        if attachment.intact:
            self.attachments.append(Attachment(attachment.name, attachment.data, attachment.media_type))
        else:
            self._report.note(self._damage(found, f"the attachment {attachment.name!r} does not fit its checksum"))

    def _take_metadata(self, file: DamagedFile, found: Found) -> None:
        name, content = records.parse_metadata(file.content(found))
        if name == bag_metadata.RECORD_NAME:
            return  # written anew
        verified = provenance.verify(content)
        if verified is None:
            self._report.note(
                self._damage(found, f"the metadata record {name!r} does not fit its checksum or has none")
            )
        elif name == provenance.RECORD_NAME:
            self.provenance = Provenance.from_record(verified)
        elif name == provenance.TOPIC_RECORD_NAME:
            self._take_topic(verified)
        elif name == losses.RECORD_NAME:
            self.losses = verified
        elif name == TAIL_RECORD_NAME:
            with contextlib.suppress(KeyError, ValueError):
                self.follows = int(verified[FOLLOWS])

    def _take_topic(self, record: dict[str, str]) -> None:
        try:
            topic = TopicDescription.from_channel(record["name"], record["type_name"], record["schema"], record)
            self._topics.setdefault(int(record["id"]), topic)
        except (KeyError, ValueError):
            return

    def _damage(self, found: Found, reason: str, *, length: int | None = None) -> Damage:
        return Damage(self.path.name, found.offset, found.length if length is None else length, reason)
