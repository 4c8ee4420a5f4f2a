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
"""Digests of a recording: of each topic with all its messages, of the attachments and of the metadata.

The digests show every change of a definition, a message, an attachment or a metadata record, and every change of the
order, times and number of messages. The checksums of MCAP show damage only, because a program that changes a recording
renews them. The digests do not depend on how messages are packed into chunks. They do not prove who wrote them: a
program that changes a recording can also compute and write new digests.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterator, Mapping

from mcap.records import Attachment, Channel, Schema

RECORD_NAME = "impact_rig/digests"
"""Name of the metadata record with the digests. It is the last metadata record of a file, and no digest covers it."""
_TOPIC = "topic "  # prefix of a topic's name in a key of the record
_MESSAGE = struct.Struct("<IQQQ")  # sequence number, log time, publish time, length


class Digests:
    """BLAKE2b digests of one file: one for each topic, one for all attachments and one for all metadata records.

    The writer of a file adds all content that it writes. A program that checks the file adds all content that it reads,
    and then calls `differences`. Equal content in equal order gives equal digests.
    """

    def __init__(self) -> None:
        self._topics: dict[int, tuple[str, hashlib.blake2b]] = {}  # name and digest, by channel
        self._attachments = _new()
        self._metadata = _new()

    def add_topic(self, channel: Channel, schema: Schema | None) -> None:
        """Start the digest of a topic with the topic's definition.

        Messages of the topic that were added before this call are ignored.
        """
        digest = _new()
        _add(digest, channel.topic, channel.message_encoding, json.dumps(channel.metadata, sort_keys=True))
        if schema is not None:
            _add(digest, schema.name, schema.encoding, schema.data)
        self._topics[channel.id] = channel.topic, digest

    def add_message(
        self, channel: int, sequence: int, log_time: int, publish_time: int, data: bytes | memoryview
    ) -> None:
        """Add a message to the digest of its topic; call this in file order. Times are in ns.

        The message is ignored if `add_topic` has not been called for its channel.
        """
        if channel not in self._topics:
            return
        digest = self._topics[channel][1]
        digest.update(_MESSAGE.pack(sequence, log_time, publish_time, len(data)))
        digest.update(data)

    def add_attachment(self, attachment: Attachment) -> None:
        """Add an attachment to the digest of all attachments; call this in file order."""
        digest = self._attachments
        _add(digest, attachment.name, attachment.media_type, attachment.data)
        digest.update(struct.pack("<QQ", attachment.log_time, attachment.create_time))

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Add a metadata record to the digest of all metadata records; call this in file order.

        The record with the digests themselves (`RECORD_NAME`) is ignored.
        """
        if name != RECORD_NAME:
            _add(self._metadata, name, json.dumps(dict(content), sort_keys=True))

    def to_record(self) -> dict[str, str]:
        """Return the content of the metadata record `RECORD_NAME`: part of the file -> digest as hexadecimal text.

        A part is `attachments`, `metadata`, or `topic ` followed by the name of a topic.
        """
        topics = {_TOPIC + name: digest.hexdigest() for name, digest in self._topics.values()}
        return {"attachments": self._attachments.hexdigest(), "metadata": self._metadata.hexdigest(), **topics}

    def differences(self, recorded: Mapping[str, str]) -> Iterator[str]:
        """Yield an English sentence for each part of the file that was changed, added or removed after the recording.

        A part is a topic, the attachments or the metadata.

        Args:
            recorded: digests that the recorder of the file wrote into its metadata record `RECORD_NAME`.
        """
        found = self.to_record()
        for key in sorted({*found, *recorded}):
            name = key.removeprefix(_TOPIC)
            if key not in found:
                yield f"the file no longer lists {name}, which was recorded: it was removed after the recording"
            elif key not in recorded:
                yield f"{name} is not in the digests of the recorder: it was added after the recording"
            elif found[key] != recorded[key]:
                what = "messages or its definition" if key.startswith(_TOPIC) else "content"
                yield f"{name}: its digest does not match, so its {what} changed after the recording"


def _new() -> hashlib.blake2b:
    return hashlib.blake2b(digest_size=16)


def _add(digest: hashlib.blake2b, *parts: str | bytes) -> None:
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(struct.pack("<Q", len(data)))
        digest.update(data)
