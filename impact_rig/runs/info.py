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
"""Summary of a recorded run for `impact-rig info`: its contents, and a verdict about its integrity.

All messages are read, which also checks all checksums.
"""

from __future__ import annotations

import contextlib
import itertools
from array import array
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import codec, topics
from impact_rig.errors import CodecError, ConfigError
from impact_rig.recording import description, losses
from impact_rig.recording.description import CONFIGURATION
from impact_rig.recording.losses import Contiguity, check_contiguity, scan_rate_hz
from impact_rig.recording.reader import Message, Run, open_run
from impact_rig.recording.records import DamageError
from impact_rig.recording.rigs import prefix_of
from impact_rig.recording.writer import CONTINUES_RECORD_NAME
from impact_rig.rig.journal import InputKind
from impact_rig.runs import recorded_journal, recovery, structure
from impact_rig.runs.origin import origin
from impact_rig.runs.recovery import Recovered
from impact_rig.simtime import NS_PER_S

SAME_RATE = 1e-6  # relative deviation up to which the rate from the times in a block is that of the calibration


@attrs.frozen
class TopicInfo:
    """Figures of one recorded topic: number, rate, times and size of its messages.

    Attributes:
        first_ns, last_ns: earliest and latest log time [ns]; 0 without messages.
    """

    name: str
    type_name: str
    count: int
    rate_hz: float | None
    """Messages per second of log time between its first and last message; None with fewer than two log times."""
    first_ns: int
    last_ns: int
    bytes: int  # size of its messages as CDR [bytes]


@attrs.frozen
class RunInfo:
    """Summary of one recorded run, as `info` returns it."""

    path: Path
    files: tuple[tuple[str, int], ...]  # name and size [bytes] of each MCAP file
    start_ns: int  # log time of the earliest message [ns]; end_ns: of the latest
    end_ns: int
    topics: tuple[TopicInfo, ...]  # in order of registration
    rate_hz: float | None  # scans per second of `daq/scan`, of the first rig if there are two; None without scans
    last_block_s: float  # duration of a rig's last recorded block [s], the longest of all rigs; 0 if unknown
    rig_s: float | None  # rig time of scans and the gaps between them [s], longest of all rigs; None without scans
    scans: Contiguity | None  # numbers of blocks and scans, and gaps; None without scans, or if a rate is unknown
    provenance: Mapping[str, str]  # version, seed, wall_start_ns, and more; empty for files of other recorders
    attachments: Mapping[str, int]  # size of each file stored inside the run [bytes], by name
    configuration: str | None  # text of the attached configuration
    lost: Mapping[str, int]  # messages that never reached the recorder, by topic; topics without losses are left out
    accounted: bool  # whether the recorder kept an account of received and lost messages
    recovered: Recovered | None  # losses of a recovery; None for an original recording
    intact: bool  # whether no part is known to be damaged, changed or missing
    verdict: str  # one sentence about the integrity of the run
    checksums: structure.Checksums  # how many parts carry a checksum; all 0 if a part is damaged
    rigs: tuple[str, ...]  # namespaces of the recorded rigs, such as `/rig`
    origin: Mapping[str, str]  # for an imported run: what was read, assumed and left out; empty for others

    @property
    def log_s(self) -> float:
        """Time from the earliest to the latest log time of a message [s]."""
        return (self.end_ns - self.start_ns) / NS_PER_S

    @property
    def duration_s(self) -> float:
        """Rig time of scans and the gaps between them [s], the longest of all rigs (`rig_s`); `log_s` without scans."""
        return self.log_s if self.rig_s is None else self.rig_s

    @property
    def messages(self) -> int:
        """Number of messages read, on all topics; reading ends at the first damage."""
        return sum(topic.count for topic in self.topics)

    @property
    def bytes(self) -> int:
        """Size of all MCAP files of the run [bytes]."""
        return sum(size for _, size in self.files)


def info(path: Path | str) -> RunInfo:
    """Read a finished run completely, and return its summary: contents, losses, checksums and a verdict.

    Args:
        path: a run directory or an MCAP file.

    Returns:
        The summary. `verdict` is one sentence about the run's integrity, and `intact` is true if no part is known to be
        damaged, changed or missing. Damage to a part without a checksum may remain unknown. `start_ns` and `end_ns` are
        log times [ns], `rate_hz` is the scan rate, `topics` lists the recorded topics, `scans` counts scans and gaps,
        and `lost` counts the messages that never reached the recorder.

    Raises:
        RecordingError: there is no recording, it is not finished, or its index is damaged. A damaged chunk does not
            raise: the verdict names it, and the figures cover the messages before it.
        ImpactRigError: the recording exceeds a limit of reading.

    Examples:
        >>> import impact_rig
        >>> rig = impact_rig.LocalRig()
        >>> rig.run(seconds=1)
        >>> summary = impact_rig.info(rig.save("summarised"))
        >>> summary.rate_hz, summary.scans.scans, summary.intact
        (10000.0, 10000, True)
        >>> print(summary.verdict)
        whole: every checksum fits, 100 blocks of daq/scan without a gap, no message lost on any topic

    See Also:
        - `verify`: compares the content with a new simulation.
        - docs/reference/command_line.md: `impact-rig info` prints the summary; `impact-rig recover` writes the intact
          messages of a damaged run to a new one.
    """
    with open_run(path) as run:
        tally = _Tally(run)
        problem = ""
        provenance: Mapping[str, str] = {}
        attachments: Mapping[str, bytes] = {}
        account: Mapping[str, list[losses.PublisherStream]] = {}
        recovered: Recovered | None = None
        checked = structure.Checksums()
        try:
            provenance = run.provenance
            attachments = run.attachments()
            account = losses.read_record(run.record(losses.RECORD_NAME))
            recovered = recovery.read_record(run.record(recovery.RECORD_NAME))
            for message in run.messages(recorded_order=True):
                tally.add(message)
            checked = structure.checksums(run)
            examined = structure.examine(run)
            problem = "; ".join((*examined.contradictions, *examined.changes))
        except DamageError as error:
            problem = str(error)
        rigs = list(tally.rigs.values())
        rate_hz = next((rig.rate_hz for rig in rigs if rig.rate_hz), None)
        scans = _judged(rigs)
        replaced = {prefix + name for prefix in run.prefixes for name in losses.REPLACED}
        lost = {name: count for name, count in losses.lost(account).items() if name not in replaced}
        missing = [*_absent_files(run), *_gaps(scans), *_losses(lost), *_left_out(recovered)]
        if recovered is None:  # the account covers the original recording, not the recovered messages
            missing += _unaccounted(account, tally)
        configuration = attachments.get(CONFIGURATION)
        return RunInfo(
            path=run.path,
            files=tuple((source.path.name, source.size) for source in run.sources),
            start_ns=run.start_ns,
            end_ns=run.end_ns,
            topics=tally.topics(),
            rate_hz=rate_hz,
            last_block_s=max((rig.last_block_s for rig in rigs), default=0.0),
            rig_s=max((rig.span_s for rig in rigs if rig.blocks), default=None),
            scans=scans,
            provenance=provenance,
            attachments={name: len(data) for name, data in attachments.items()},
            configuration=None if configuration is None else configuration.decode("utf-8", errors="replace"),
            lost=lost,
            accounted=bool(account),
            recovered=recovered,
            intact=not problem and not missing,
            verdict=problem
            or _verdict(tally, scans, missing, checked, accounted=bool(account), recovered=recovered is not None),
            checksums=checked,
            rigs=run.rigs,
            origin=origin(attachments),
        )


def _verdict(
    tally: _Tally,
    scans: Contiguity | None,
    missing: list[str],
    checked: structure.Checksums,
    *,
    accounted: bool,
    recovered: bool,
) -> str:
    """Return the verdict on a run without damage, as one sentence.

    The sentence begins with "whole" only if nothing is missing, everything carries a checksum, the recorder kept an
    account of lost messages, and the run was not written by a recovery.

    Args:
        tally: counts over the messages.
        scans: gaps between the blocks of scans; None if a scan rate is unknown.
        missing: what is missing, one clause each.
        checked: how many parts carry a checksum.
        accounted: whether the recorder kept an account of received and lost messages.
        recovered: whether a recovery wrote the run.
    """
    begin = f"recovered: {checked}" if recovered else str(checked)
    if missing:
        return f"{begin}, but {'; '.join(missing)}"
    found = f"there is no {topics.SCAN.name}"
    if blocks := sum(len(rig.blocks) for rig in tally.rigs.values()):
        judged = "without a gap" if scans else "of an unknown rate, so gaps cannot be detected"
        found = f"{blocks} blocks of {topics.SCAN.name} {judged}"
    if recovered:
        return f"{begin}, {found}; losses of the original recorder are unknown"
    if not accounted:
        return f"{begin}, {found}; its recorder kept no account of lost messages"
    whole = "whole: " if checked.complete else ""
    return f"{whole}{begin}, {found}, no message lost on any topic"


def _judged(rigs: Sequence[_RigScans]) -> Contiguity | None:
    """Return the total numbers of blocks and scans of all rigs in a recording, and their gaps.

    The result is None if the scan rate of a rig with scans is unknown, or if no rig has a known scan rate.
    Gaps are found for each rig separately.
    """
    found = [
        check_contiguity(rig.blocks, rig.rate_hz, starts=rig.starts, resets=rig.resets) for rig in rigs if rig.rate_hz
    ]
    if not found or any(rig.blocks and not rig.rate_hz for rig in rigs):
        return None
    return Contiguity(
        blocks=sum(one.blocks for one in found),
        scans=sum(one.scans for one in found),
        gaps=tuple(gap for one in found for gap in one.gaps),
        lost_blocks=sum(one.lost_blocks for one in found),
        lost_scans=sum(one.lost_scans for one in found),
        restarts=sum(one.restarts for one in found),
    )


def _gaps(scans: Contiguity | None) -> list[str]:
    if scans is None or scans.whole:
        return []
    parts = [f"{len(scans.gaps)} gaps in {topics.SCAN.name}"]
    if scans.lost_blocks:
        parts.append(f"{scans.lost_blocks} blocks ({scans.lost_scans} scans) are missing")
    if scans.restarts:
        parts.append(f"the stamps go back {scans.restarts} times")
    return parts


def _losses(lost: Mapping[str, int]) -> list[str]:
    if not lost:
        return []
    return ["messages were lost on the way to the recorder: " + ", ".join(f"{n} of {name}" for name, n in lost.items())]


def _absent_files(run: Run) -> list[str]:
    """Return a clause for each missing file: `metadata.yaml` of a directory, or the next MCAP file.

    The last MCAP file of a run is expected to name no next file. If it names one, that file is missing.
    """
    last = run.sources[-1]
    follows = [content.get("file", "") for name, content in last.metadata() if name == CONTINUES_RECORD_NAME]
    missing = [f"{last.path.name} is not the last file of its run: {follows[-1]} is missing"] if follows else []
    if run.path.is_dir() and not (run.path / description.METADATA_FILE).exists():
        missing.append(f"{description.METADATA_FILE}, which a finished run has, is missing")
    return missing


def _unaccounted(account: Mapping[str, list[losses.PublisherStream]], tally: _Tally) -> list[str]:
    """Return a clause for each contradiction between the messages in the files and the account of the recorder.

    The account states how many messages of each publisher the recorder received, and their sequence numbers.
    """
    short, twice, uncounted = [], [], []
    for name, numbers in tally.sequences.items():
        streams = account.get(name)
        if streams is None:
            uncounted += [name] if account and len(numbers) else []
            continue
        received = sum(stream.received for stream in streams)
        again, absent = _compared(np.frombuffer(numbers, np.uint64), streams)
        absent = max(absent, received - len(numbers))
        short += [f"{absent} of {name}"] if absent > 0 else []
        again = max(again, len(numbers) - received)
        twice += [f"{again} of {name}"] if again > 0 else []
    for name, streams in account.items():
        if name not in tally.sequences and any(stream.received for stream in streams):
            short.append(f"{sum(stream.received for stream in streams)} of {name}")
    contradictions = {
        "messages that the recorder received are not in the files": short,
        "messages are in the files twice": twice,
        "topics without an account by the recorder": uncounted,
    }
    return [f"{what}: {', '.join(which)}" for what, which in contradictions.items() if which]


def _compared(numbers: NDArray[np.uint64], streams: list[losses.PublisherStream]) -> tuple[int, int]:
    """Return the number of duplicate messages of a topic, and the number of received messages missing in the files.

    A file does not name the sender of a message. A sequence number may therefore occur once for each publisher whose
    range of numbers includes it. Each further occurrence counts as a duplicate. Both results are 0 if messages or
    publishers have no numbers to compare.

    Args:
        numbers: sequence numbers of the messages of a topic in the files.
        streams: counts of the publishers of the topic in the recorder's account.
    """
    if any(not stream.first or stream.newest >= 2**32 for stream in streams):
        return 0, 0  # messages have no number, publishers were dropped, or only some messages have numbers
    present, counts = np.unique(numbers, return_counts=True)
    sent = sum(((present >= stream.first) & (present <= stream.newest)).astype(np.int64) for stream in streams)
    again = int(np.maximum(counts - sent, 0).sum())
    return again, again + sum(stream.received for stream in streams) - len(numbers)


def _left_out(recovered: Recovered | None) -> list[str]:
    if recovered is None or not recovered.incomplete:
        return []
    parts = f"{recovered.lost_bytes} bytes, damaged parts: {recovered.damages}"
    if recovered.missing_messages == 0:
        return [f"something other than the messages in its index could not be recovered ({parts})"]
    count = "an unknown number of" if recovered.missing_messages is None else recovered.missing_messages
    return [f"{count} messages could not be recovered ({parts})"]


@attrs.define
class _RigScans:
    """Stamps, lengths and rates of the blocks of one rig in a recording, and its starts and resets."""

    blocks: list[tuple[int, int]] = attrs.field(factory=list)  # stamp [ns] and number of scans
    starts: list[int] = attrs.field(factory=list)  # time of scan 0 of each start in the journal [ns]
    resets: list[int] = attrs.field(factory=list)  # time of scan 0 of each reset in the journal [ns]
    rates: list[float] = attrs.field(factory=list)  # scan rates from the calibrations [Hz]
    from_times: float | None = None  # scan rate from the times in the first block that shows one [Hz]

    @property
    def rate_hz(self) -> float | None:
        """Scans per second; None if unknown.

        The rate follows from the times in a block, else from the calibration, else from the stamps of blocks of one
        scan each.
        """
        found = self.from_times or next(iter(self.rates), None)
        if self.rates and found and abs(self.rates[0] / found - 1.0) < SAME_RATE:
            found = self.rates[0]  # the calibration has the full precision
        if found is None:
            steps = [after[0] - one[0] for one, after in itertools.pairwise(self.blocks) if one[1] == 1]
            least = min((step for step in steps if step > 0), default=0)
            found = round(NS_PER_S / least) or None if least else None
        return found

    @property
    def span_s(self) -> float:
        """Rig time from the first scan to the end of the last [s], with the gaps between them.

        If stamps go back, for example after a restart of the rig, the durations before and after are added.
        """
        total_ns = begin_ns = end_ns = before_ns = 0
        for number, (stamp_ns, length) in enumerate(self.blocks):
            if number == 0 or stamp_ns < before_ns:
                total_ns, begin_ns, end_ns = total_ns + end_ns - begin_ns, stamp_ns, stamp_ns
            scans_ns = round(length * NS_PER_S / self.rate_hz) if self.rate_hz else 0
            end_ns, before_ns = max(end_ns, stamp_ns + scans_ns), stamp_ns
        return (total_ns + end_ns - begin_ns) / NS_PER_S

    @property
    def last_block_s(self) -> float:
        """Duration of the last recorded block [s]; 0 if unknown."""
        return self.blocks[-1][1] / self.rate_hz if self.rate_hz and self.blocks else 0.0


class _Tally:
    """Counts over the messages of a run.

    For each topic they are number, size, first and last time of its messages, for each rig its blocks of scans, scan
    rates and starts (stamps of scan 0).
    """

    def __init__(self, run: Run) -> None:
        self._types = {name: recorded.topic.type_name for name, recorded in run.topics.items()}
        self._found = {name: description.Extent() for name in run.topics}
        self._bytes = dict.fromkeys(run.topics, 0)
        prefixes = run.prefixes
        self._scan_topics = {prefix + topics.SCAN.name for prefix in prefixes}
        self._journals = {prefix + topics.JOURNAL.name for prefix in prefixes}
        self._info_topics = {prefix + topics.INFO.name for prefix in prefixes}
        self.rigs: defaultdict[str, _RigScans] = defaultdict(_RigScans)  # by namespace
        self.sequences = {name: array("Q") for name in run.topics}
        """Sequence numbers of the messages of each topic, as given by their publishers."""

    def add(self, message: Message) -> None:
        """Count one message, and keep what a block of scans, a calibration or a journal entry says about its rig.

        Raises:
            DamageError: a message of `daq/scan` is not a valid table.
        """
        self._found[message.topic].add(message.log_time)
        self._bytes[message.topic] += len(message.data)
        self.sequences[message.topic].append(message.sequence)
        if message.topic in self._scan_topics:
            self._add_block(message)
        elif message.topic in self._info_topics:
            with contextlib.suppress(CodecError):  # an invalid table has no scan rate
                rates = self._rig(message, topics.INFO).rates
                rates += codec.decode(message.data, topics.INFO).rows["rate"][:1].tolist()
        elif message.topic in self._journals:
            with contextlib.suppress(ConfigError):
                for entry in recorded_journal.entries(message):
                    rig = self._rig(message, topics.JOURNAL)
                    if entry.kind is InputKind.START:
                        rig.starts.append(entry.stamp_ns)
                    if entry.kind is InputKind.RESET:
                        rig.resets.append(entry.stamp_ns)

    def _rig(self, message: Message, topic: topics.Topic) -> _RigScans:
        """Return the facts about the rig to which a message of this topic belongs."""
        prefix = prefix_of(message.topic, topic)
        assert prefix is not None
        return self.rigs[prefix]

    def _add_block(self, message: Message) -> None:
        try:
            table = codec.decode(message.data)
        except CodecError as error:
            raise DamageError(
                f"the message of {message.topic} with log time {message.log_time} ns is not a valid table: {error} "
                "(impact-rig recover cannot repair it)"
            ) from error
        rig = self._rig(message, topics.SCAN)
        rig.blocks.append((table.stamp_ns, len(table.rows)))
        if rig.from_times is None:
            rig.from_times = scan_rate_hz(table)

    def topics(self) -> tuple[TopicInfo, ...]:
        """Return number, rate, first and last time, and size of the messages of every topic.

        The topics are in the order in which the recording lists them.
        """
        found = []
        for name, one in self._found.items():
            span_s = one.duration_ns / NS_PER_S
            rate = (one.count - 1) / span_s if span_s > 0 else None
            first_ns = one.start_ns if one.count else 0
            found.append(TopicInfo(name, self._types[name], one.count, rate, first_ns, one.end_ns, self._bytes[name]))
        return tuple(found)
