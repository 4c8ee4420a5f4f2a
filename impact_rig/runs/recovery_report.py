# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What `recover` gave back and what it could not, file by file."""

from __future__ import annotations

from pathlib import Path

import attrs

from impact_rig import codec, topics
from impact_rig.errors import CodecError
from impact_rig.recording.description import TopicDescription, matches
from impact_rig.recording.records import RawMessage, Statistics
from impact_rig.recording.tail import SUFFIX
from impact_rig.runs.contiguity import check_contiguity, scan_rate_hz
from impact_rig.runs.salvage import Damage
from impact_rig.simtime import NS_PER_S
from impact_rig.system.budget import Spending

_MAX_LISTED = 1000


@attrs.define
class FileReport:
    """What came out of one file, its tail included.

    Attributes:
        name: of the file.
        size: its bytes.
        messages: messages given back.
        chunks: whole chunks they came from.
        expected: what the file's index counts; None: it has none that can be believed.
        lost_bytes: bytes that are left out.
    """

    name: str
    size: int
    messages: int = 0
    chunks: int = 0
    expected: Statistics | None = None
    lost_bytes: int = 0
    _blocks: list[tuple[int, int]] = attrs.field(factory=list)
    _rate_hz: int | None = None
    _first_ns: int | None = None
    _last_ns: int = 0

    def expect(self, statistics: Statistics) -> None:
        """Note what the index counts."""
        self.expected = statistics

    def count(self, topic: TopicDescription, message: RawMessage) -> None:
        """Count a message that is given back."""
        self.messages += 1
        time_ns = message.log_time
        self._first_ns = time_ns if self._first_ns is None else min(self._first_ns, time_ns)
        self._last_ns = max(self._last_ns, time_ns)
        if matches(topic.name, topics.SCAN.name):
            try:
                table = codec.decode(message.data)
            except CodecError:
                return
            self._blocks.append((table.stamp_ns, len(table.rows)))
            self._rate_hz = self._rate_hz or scan_rate_hz(table)

    @property
    def missing_messages(self) -> int | None:
        """Messages that the index counts and that are not given back; None without an index."""
        return None if self.expected is None else max(0, self.expected.message_count - self.messages)

    @property
    def given_s(self) -> float:
        """Scans given back [s of rig time]."""
        return sum(length for _, length in self._blocks) / self._rate_hz if self._rate_hz else 0.0

    @property
    def missing_s(self) -> float | None:
        """Scans missing between those given back, and time before and after them [s]; None without an index."""
        if self.expected is None:
            return None
        if self._first_ns is None:
            return (self.expected.end_ns - self.expected.start_ns) / NS_PER_S
        outside = self._first_ns - self.expected.start_ns + self.expected.end_ns - self._last_ns
        inside = check_contiguity(self._blocks, self._rate_hz).lost_scans / self._rate_hz if self._rate_hz else 0.0
        return inside + max(0, outside) / NS_PER_S


@attrs.define
class RecoverReport:
    """What `recover` found.

    Attributes:
        directory: the new run.
        files: what came out of each file.
        damages: what is left out and why, in order (at most 1000 are listed).
        damage_count: how many there are.
        account: what reading has cost.
    """

    directory: Path
    files: list[FileReport] = attrs.field(factory=list)
    damages: list[Damage] = attrs.field(factory=list)
    damage_count: int = 0
    account: Spending = attrs.field(factory=lambda: Spending(0), repr=False)

    @property
    def messages(self) -> int:
        """Messages given back."""
        return sum(file.messages for file in self.files)

    @property
    def chunks(self) -> int:
        """Whole chunks they came from."""
        return sum(file.chunks for file in self.files)

    @property
    def expected_messages(self) -> int | None:
        """How many there were, if the index of every file tells; None otherwise."""
        counts = [None if file.expected is None else file.expected.message_count for file in self.files]
        known = [count for count in counts if count is not None]
        return sum(known) if len(known) == len(counts) else None

    @property
    def missing_messages(self) -> int | None:
        """How many of them are not given back; None where an index is missing."""
        return None if self.expected_messages is None else max(0, self.expected_messages - self.messages)

    @property
    def lost_bytes(self) -> int:
        """Bytes that are left out."""
        return sum(file.lost_bytes for file in self.files)

    @property
    def complete(self) -> bool:
        """Whether nothing is known to be missing; a run that was never finished has no index to tell."""
        return self.damage_count == 0 and not self.missing_messages

    def file(self, path: Path) -> FileReport:
        """Return the report of a file, which begins with this."""
        found = FileReport(path.name, path.stat().st_size)
        self.files.append(found)
        return found

    def note(self, damage: Damage) -> None:
        """Count and list a damage."""
        self.damage_count += 1
        for file in self.files:
            if file.name == damage.file.removesuffix(SUFFIX):
                file.lost_bytes += damage.length
        if len(self.damages) < _MAX_LISTED:
            self.damages.append(damage)

    def heal(self, file: str, offset: int) -> None:
        """Take back the damage that begins at `offset`: what was lost there is found elsewhere."""
        for damage in self.damages:
            if (damage.file, damage.offset) == (file, offset):
                self.damages.remove(damage)
                self.damage_count -= 1
                for report in self.files:
                    if report.name == file:
                        report.lost_bytes -= damage.length
                return
