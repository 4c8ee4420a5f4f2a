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
"""Checks of the structure of a recording: checksums, digests, and agreement of index, statistics and messages.

A reader finds messages by the index. If an index lacks a topic, the topic seems never to have been recorded, although
all checksums match. Therefore index and messages are compared, record by record.
"""

from __future__ import annotations

import os
import zlib
from collections import Counter
from collections.abc import Iterator

import attrs
from mcap import records as mcap_records

from impact_rig.recording import Run, description, digests, records
from impact_rig.recording.reader import McapSource, Segment
from impact_rig.recording.records import DamageError
from impact_rig.system import files

_READ_BYTES = 2**20


@attrs.define
class Checksums:
    """Coverage of a recording by checksums: how many chunks, data sections and attachments carry one."""

    chunks: int = 0
    checked_chunks: int = 0
    outside: int = 0  # number of files with messages outside chunks
    checked_outside: int = 0  # number of those files whose data section carries a checksum, which matches
    attachments: int = 0
    checked_attachments: int = 0

    @property
    def complete(self) -> bool:
        """Return whether every message and every attachment carries a checksum."""
        return (self.chunks, self.outside, self.attachments) == (
            self.checked_chunks,
            self.checked_outside,
            self.checked_attachments,
        )

    def __str__(self) -> str:
        """Return a clause about the checksums for the verdict of `info`, if no checksum was wrong.

        It says whether all, some or none of the messages carry a checksum, and how many attachments carry none.
        """
        parts = self.chunks + self.outside
        checked = self.checked_chunks + self.checked_outside
        if not checked and parts:
            messages = "its messages carry no checksums"
        elif checked < parts:
            messages = f"every existing checksum fits, {checked} of {parts} chunks carry one"
        else:
            messages = "every checksum fits"
        bare = self.attachments - self.checked_attachments
        return messages + (f", {bare} of {self.attachments} attachments carry none" if bare else "")


def checksums(run: Run) -> Checksums:
    """Return how many checksums a recording has, after checking those that are not checked when messages are read.

    The result counts chunks, sections of messages outside chunks, and attachments, and how many of each have a
    checksum. Those of chunks are only counted, because they are checked when the chunks are read.

    Raises:
        RecordingError: the checksum of an attachment or data section does not match, or a file cannot be read.
    """
    found = Checksums()
    for source in run.sources:
        chunks = [segment for segment in source.segments if segment.chunk is not None]
        found.chunks += len(chunks)
        found.checked_chunks += sum(source.crc(segment) != 0 for segment in chunks)
        if len(chunks) < len(source.segments):
            found.outside += 1
            found.checked_outside += _check_data_section(source)
        crcs = [is_checked for _, is_checked in source.attachment_records()]
        found.attachments += len(crcs)
        found.checked_attachments += sum(crcs)
    return found


def _check_data_section(source: McapSource) -> bool:
    """Check the data section of a file against its checksum; return whether the section carries one.

    Raises:
        DamageError: the checksum does not match, the record at the section's end is damaged, or the file has become
            shorter.
    """
    end = source.data_end()
    try:
        crc = records.parse(mcap_records.DataEnd, source.record_at(end, records.DATA_END)).data_section_crc
    except DamageError as error:
        raise DamageError(
            f"{source.path}: the end of its data section (byte {end}) is damaged: {error}; impact-rig recover saves "
            "the intact chunks"
        ) from error
    if crc == 0:
        return False
    found, position = 0, 0
    with files.translate_errors(f"cannot read {source.path}"):
        while position < end:
            part = os.pread(source.fd, min(_READ_BYTES, end - position), position)
            if not part:
                raise DamageError(
                    f"{source.path} has become shorter since it was opened: copy it again, or save its intact chunks "
                    "with impact-rig recover"
                )
            found, position = zlib.crc32(part, found), position + len(part)
    if found != crc:
        raise DamageError(
            f"{source.path}: the checksum of its data section does not match; impact-rig recover saves the intact "
            "chunks, and with --accept-unchecked also the messages outside chunks, which may be damaged"
        )
    return True


@attrs.frozen
class Examination:
    """Result of `examine`: contradictions between the records of a recording, and changes since it was recorded."""

    contradictions: tuple[str, ...]
    """Contradictions between the messages and the index, statistics or definitions, one sentence each."""
    changes: tuple[str, ...]
    """Changes made after the recording, detected by the digests, one sentence each."""
    has_digests: bool
    """True if every file has digests, so that changes can be detected."""


def examine(run: Run) -> Examination:
    """Read every record of a recording, and compare it with the index, statistics, definitions and digests of its file.

    Definitions are those of topics and of their types: MCAP channels and schemas.

    Raises:
        RecordingError: a part is damaged.
    """
    contradictions: list[str] = []
    changes: list[str] = []
    has_digests = True
    for source in run.sources:
        found = digests.Digests()
        contradictions += [f"{source.path.name}: {problem}" for problem in _contradictions(source, found)]
        recorded = None
        for name, content in source.metadata():
            found.add_metadata(name, content)
            if name == digests.RECORD_NAME:
                recorded = description.verify(content) or {}
        for attachment, _ in source.attachment_records():
            found.add_attachment(attachment)
        if recorded is None:
            has_digests = False
        else:
            changes += [f"{source.path.name}: {one}" for one in found.differences(recorded)]
    return Examination(tuple(contradictions), tuple(changes), has_digests)


def _contradictions(source: McapSource, digest: digests.Digests) -> Iterator[str]:
    """Yield a sentence for each contradiction within a file, and add its topics and messages to `digest`."""
    for defined in source.summary.channels.values():
        digest.add_topic(defined, source.summary.schemas.get(defined.schema_id))
    counts: Counter[int] = Counter()
    times: list[int] = []
    summary, statistics = source.summary, source.statistics
    for segment in source.segments:
        content = source.content(segment)
        index: dict[int, list[tuple[int, int]]] = {}
        here: list[int] = []
        for message in records.messages(content, None):
            channel_id, sequence, log_time, publish_time, data, offset = message
            counts[channel_id] += 1
            here.append(log_time)
            digest.add_message(channel_id, sequence, log_time, publish_time, data)
            index.setdefault(channel_id, []).append((log_time, offset))
        for definition in records.definitions(content):
            known = summary.schemas if isinstance(definition, mcap_records.Schema) else summary.channels
            if known.get(definition.id) != definition:
                yield f"the chunk at byte {segment.offset} defines another {_what(definition)} than the index"
        if here:
            times += [min(here), max(here)]
        if segment.chunk is not None:
            yield from _index_problems(source, segment, index, here)
    found = {
        "messages": (statistics.message_count, sum(counts.values())),
        "message definitions": (statistics.schema_count, len(summary.schemas)),
        "topics": (statistics.channel_count, len(summary.channels)),
        "attachments": (statistics.attachment_count, len(summary.attachment_indexes)),
        "metadata records": (statistics.metadata_count, len(summary.metadata_indexes)),
    }
    yield from (
        f"its statistics count {said} {what}, but it holds {there}"
        for what, (said, there) in found.items()
        if said != there
    )
    claimed = {channel: count for channel, count in statistics.channel_message_counts.items() if count}
    if claimed and claimed != counts:
        channel = min(number for number in {*claimed, *counts} if claimed.get(number, 0) != counts[number])
        name = source.topics[channel].name if channel in source.topics else f"channel {channel}"
        yield f"its statistics count {claimed.get(channel, 0)} messages of {name}, but it holds {counts[channel]}"
    if times and (statistics.message_start_time, statistics.message_end_time) != (min(times), max(times)):
        yield "the first and last log time in its statistics are not those of its messages"


def _what(definition: mcap_records.Schema | mcap_records.Channel) -> str:
    if isinstance(definition, mcap_records.Schema):
        return f"message definition {definition.name}"
    return f"topic {definition.topic}"


def _index_problems(
    source: McapSource, segment: Segment, index: dict[int, list[tuple[int, int]]], times: list[int]
) -> Iterator[str]:
    assert segment.chunk is not None
    where = f"the index of the chunk at byte {segment.offset}"
    if times and (segment.first_ns, segment.last_ns) != (min(times), max(times)):
        yield f"{where} states a first and last log time that are not those of its messages"
    offsets = segment.chunk.message_index_offsets
    if not offsets:
        return  # message indexes are optional
    if set(offsets) != set(index):
        names = sorted(source.topics[one].name for one in set(offsets) ^ set(index) if one in source.topics)
        yield f"{where} does not match its messages of {', '.join(names) or 'unknown channels'}"
        return
    for channel, offset in offsets.items():
        try:
            record = records.parse(mcap_records.MessageIndex, source.record_at(offset, records.MESSAGE_INDEX))
        except DamageError as error:
            yield f"{where}: the message index at byte {offset} is damaged: {error}"
            return
        if record.channel_id != channel or sorted(record.records) != sorted(index[channel]):
            yield f"{where}: the message index of {source.topics[channel].name} does not match its messages"
            return
