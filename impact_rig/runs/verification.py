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
"""Verification of a run: comparison of its recorded data with a re-simulation, up to the first difference.

Everything that the rig publishes about itself is compared: scans, their true values, applied commands, the journal,
calibration and configuration, and the readings in its monitors. Scans must be complete from the first recorded one on.
A message of another topic counts as missing only if messages of the same topic precede and follow it, because a
recorder subscribes to one topic after the other.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any  # content of a message

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import codec, topics
from impact_rig.arithmetic import ARITHMETIC
from impact_rig.blocks import Table
from impact_rig.errors import CodecError, CommandError, ConfigError, RecordingError, SimulationError
from impact_rig.instruments.instrument import Instrument
from impact_rig.instruments.registry import INSTRUMENTS
from impact_rig.names import quoted
from impact_rig.recording import CONFIGURATION, Message, Run, arithmetic_of, is_measured
from impact_rig.recording.description import RECORD_NAME as PROVENANCE_RECORD
from impact_rig.recording.description import members
from impact_rig.recording.losses import last_scan_ns
from impact_rig.rig import Block
from impact_rig.rig.config import RigConfig, from_flat, parse, to_flat
from impact_rig.rig.description import joints, robot_description
from impact_rig.rig.journal import BEGINNINGS, PLANNED, InputKind, JournalEntry, deciding_samples, decode, last_journal
from impact_rig.rig.monitors import HALF_PERIODS, AntiAlias, Smoothed
from impact_rig.rig.resimulation import Resimulation, Sent
from impact_rig.rig.truth import monitor_step
from impact_rig.runs import structure
from impact_rig.runs.reanalysis import Compared, lag_s, texts
from impact_rig.runs.recovery import is_cut_short
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S, first_scan_at, stamp_ns

_NO_JOURNAL = (ConfigError, CommandError, SimulationError)  # errors of an incomplete or impossible journal
_NOT_COMPARED = {
    topics.CLOCK.name: "rig time, which the stamps contain",
    topics.STREAM.name: "time by which a controller is ahead, which no sample depends on",
    "analysis": "made by the analysis: `impact-rig analyze` compares it",
    "plot": "derived for plotters from tables that are compared",
    "stepped_sine": "made by the node stepped_sine from the measurements",
    "client": "an input of the rig, whose effect is in the journal",
    "every node": "status reports of nodes",
}
"""Reason why a topic is not compared, by the name of the topic or of its publisher."""
_FAMILIES = {topics.envelope("", "").name.rstrip("/"): "plot", topics.spectrum("", "").name.rstrip("/"): "plot"}
"""Publishers of topics that exist once per channel, by the prefix of their names."""
_FOREIGN = "it belongs to another rig"
_UNKNOWN = "not a topic of a rig"


_USE = "verify it with the version of impact_rig that recorded it"

NOT_CHECKED = (
    "metadata.yaml, which other tools read",
    "packing of messages into chunks",
    "who wrote the digests: a program that changes a recording can write new ones",
)
"""Aspects of a recording with digests that `verify` does not check, as its report lists them."""
NOT_CHECKED_WITHOUT_DIGESTS = (
    "commands and remarks of clients (the journal has their effects)",
    "what the analysis publishes (`impact-rig analyze` compares it)",
    "diagnostics and topics of other nodes",
    "publish times, log times and sequence numbers (`impact-rig info` compares these with the account)",
    "frame ids",
    "schemas, type hashes and quality of service of topics",
    f"attachments other than {CONFIGURATION}",
    "metadata.yaml, and metadata records other than the version of the arithmetic",
)
"""Aspects that `verify` does not check in a recording without digests, which other recorders do not write."""


@attrs.frozen
class Verification:
    """Result of verifying a run: whether a re-simulation gives the recorded data, and what was compared."""

    identical: bool | None  # True, False, or None if the run cannot be verified
    scans: int  # number of scans that were compared and agree
    reason: str = ""  # the first difference, or why the run cannot be verified; empty if identical
    topics: tuple[Compared, ...] = attrs.field(default=(), eq=False)
    """Result for each topic: what was compared, and what was left out and why."""
    not_checked: tuple[str, ...] = attrs.field(default=NOT_CHECKED_WITHOUT_DIGESTS, eq=False)
    """Aspects of the recording that were not checked, one clause each."""

    def __str__(self) -> str:
        if self.identical is None:
            return f"not verifiable: {self.reason}"
        if self.identical:
            return f"identical: {self.scans} scans re-simulated bit for bit"
        return f"different: {self.reason}; {self.scans} scans are identical"


def verify(run: Run) -> Verification:
    """Simulate a run again from its journal, and compare everything that the rig published with the result.

    Each start or reset of the rig in the run begins a new journal, which is simulated separately.

    Args:
        run: an open run.

    Returns:
        The result. `identical` is true if every compared value is equal bit for bit, false if one differs or the
        recording was changed, and None if the run cannot be verified. `reason` has the first difference or change, or
        says why the run cannot be verified; it is empty if `identical` is true. `scans` counts the scans that agree,
        and `topics` has the result of each topic. `str` describes the result in one line.

    Raises:
        RecordingError: the run has no topic `daq/scan`, has several rigs of which none was chosen, or is damaged.

    Examples:
        >>> import impact_rig
        >>> rig = impact_rig.LocalRig()
        >>> rig.run(seconds=1)
        >>> with impact_rig.open_run(rig.save("verified")) as run:
        ...     print(impact_rig.verify(run))
        identical: 10000 scans re-simulated bit for bit

    See Also:
        - `info`: checks checksums and losses, without a simulation.
        - docs/explanation/recordings.md: what is compared, and what is not.
    """
    if arithmetic_of(run.provenance) not in ("", str(ARITHMETIC)):
        version = arithmetic_of(run.provenance)
        return Verification(
            None, 0, f"recorded with arithmetic version {version}, this program has {ARITHMETIC}: {_USE}"
        )
    run.resolve(topics.SCAN.name)
    if is_measured(run.provenance):
        return Verification(None, 0, "an imported measurement: there is nothing to re-simulate")
    examined = structure.examine(run)
    if examined.contradictions:  # a topic missing in the index would pass for one that was never recorded
        return Verification(False, 0, examined.contradictions[0])
    changes = examined.changes
    if not examined.has_digests and any(
        name.startswith(PROVENANCE_RECORD) for source in run.sources for name, _ in source.metadata()
    ):
        changes = ("the digests that the recorder wrote are missing",)
    not_checked = NOT_CHECKED if examined.has_digests else NOT_CHECKED_WITHOUT_DIGESTS
    found = _verify_content(run, changes)
    if not found.identical and is_cut_short(run):
        blocks, ahead = _complete_blocks(run)
        shorter = _verify_content(run, changes, blocks)
        if shorter.identical:
            rest = f"the last {ahead} blocks: inputs that act on them may not have reached the recorder before its end"
            found, not_checked = shorter, (rest, *not_checked)
        elif found.identical is False and blocks == 0 and not changes:
            found = Verification(
                None, 0, "its recorder ended so early that inputs that act on all of its scans may not have reached it"
            )
    return attrs.evolve(found, not_checked=not_checked)


def _complete_blocks(run: Run) -> tuple[int, int]:
    """Return the numbers of complete and of incomplete blocks of a recording whose recorder was killed.

    A block is complete if no message of another topic can be missing for its time. The last blocks are incomplete,
    because messages of other topics may arrive up to `reanalysis.lag_s` later than scans.
    """
    stamps_ns = np.array([table.stamp_ns for table in run.tables(topics.SCAN, recorded_order=True)])
    lag_ns = NS_PER_S * lag_s(run, float(np.median(np.diff(stamps_ns))) / NS_PER_S) if len(stamps_ns) > 1 else 0
    before_end = stamps_ns[-1:] - stamps_ns
    complete = int((np.flatnonzero((before_end < 0) | (before_end > lag_ns)) + 1).max(initial=0))
    return complete, len(stamps_ns) - complete


def _verify_content(run: Run, changes: Sequence[str], blocks: int | None = None) -> Verification:
    """Simulate a run again, and compare all that the rig published.

    Changes after the recording count as differences.

    Args:
        run: an open run.
        changes: changes made after the recording, one sentence each.
        blocks: number of blocks of scans to compare, from the first one on, with the other messages of their time; None
            means all.
    """
    try:
        journals, waveforms, first, foreign = _journals(run)
    except (RecordingError, ConfigError) as error:
        return Verification(False if changes else None, 0, changes[0] if changes else str(error))
    if not journals:
        return Verification(
            False if changes else None,
            0,
            changes[0] if changes else f"the run has no message on {topics.JOURNAL.name}: choose a run that has them",
        )
    if blocks is not None:
        last = max((number for number, _ in _assigned(_scans(run, blocks), journals, first)), default=first)
        journals, waveforms = journals[: last + 1], waveforms[: last + 1]
    sent = list(zip(journals, waveforms, strict=True))
    with contextlib.closing(_OtherTopics(run, foreign, sent, blocks)) as others:
        found = _verify_all(_scans(run, blocks), journals, first, others)
        compared = (Compared(topics.SCAN.name, found.scans, what="scans"), *others.compared())
    differences = [*(str(one) for one in compared if one.difference), *changes]
    if found.identical is not False and (changes or (found.identical and differences)):
        found = attrs.evolve(found, identical=False, reason=differences[0])
    return attrs.evolve(found, topics=compared if found.identical is not None else ())


def _scans(run: Run, blocks: int | None) -> Iterator[Table]:
    return itertools.islice(run.tables(topics.SCAN, recorded_order=True), blocks)


def _verify_all(
    scans: Iterator[Table], journals: list[list[JournalEntry]], first: int, others: _OtherTopics
) -> Verification:
    compared, rest = 0, None
    for number, stretch in itertools.groupby(_assigned(scans, journals, first), key=lambda pair: pair[0]):
        beginning = journals[number][0]
        is_reset = beginning.kind is not InputKind.START  # otherwise it is unknown when the previous rig ended
        if rest is not None and is_reset and _is_missing(rest, beginning.stamp_ns):
            return _missing(rest, compared)
        following = journals[number + 1][0] if number + 1 < len(journals) else None
        found, rest = _verify(journals[number], (table for _, table in stretch), others, following)
        compared += found.scans
        if not found.identical:
            return attrs.evolve(found, scans=compared)
    nothing = "the run holds no block of daq/scan: choose a run with scans"
    return Verification(True, compared) if compared else Verification(None, 0, nothing)


def _journals(run: Run) -> tuple[list[list[JournalEntry]], list[list[Sent]], int, int]:
    """Return the journals of a run, the messages on `shaker/waveform` during each journal, and two numbers.

    A journal begins with a start or reset and lasts to the next one. Entries before the first start or reset form a
    journal of their own. The first number is the index of the journal to which the first scan belongs. The second
    number counts messages on `rig/journal` that are no journal entries; these are skipped.

    Raises:
        RecordingError: the run has no topic `rig/journal`, its journal is a table of an earlier version, or no message
            on the topic is a journal entry.
    """
    found: list[list[JournalEntry]] = []
    if run.topics[run.resolve(topics.JOURNAL.name)].topic.type_name == topics.TABLE:
        raise RecordingError(
            f"its journal (rig/journal) is a table, which only earlier versions of impact_rig can verify: {_USE}"
        )
    scan, journal = run.resolve(topics.SCAN.name), run.resolve(topics.JOURNAL.name)
    waveform = run.resolve(topics.WAVEFORM.name) if run.holds(topics.WAVEFORM) else ""
    sent: list[list[Sent]] = [[]]
    starts, foreign, scans_seen, problem, received_ns = 0, 0, False, None, 0
    for message in run.messages([scan, journal, *([waveform] if waveform else [])], recorded_order=True):
        if message.topic == scan:
            scans_seen = True
            if waveform:  # the time of a message is that of the newest scan before it
                received_ns = last_scan_ns(run.table(message, topics.SCAN))
            continue
        if message.topic == waveform:
            with contextlib.suppress(RecordingError):  # the rig rejected invalid tables as well
                table = run.table(message, topics.WAVEFORM)
                sent[-1].append(Sent(table.stamp_ns, table.rows["value"].astype(float), received_ns))
            continue
        try:
            entry = decode(message.data)
        except ConfigError as error:
            foreign, problem = foreign + 1, problem or error
            continue
        starts += 0 if scans_seen else int(entry.kind in BEGINNINGS)
        if not found or entry.kind in BEGINNINGS:
            sent += [[]] * bool(found)
            found.append([])
        found[-1].append(entry)
    if problem is not None and not found:
        raise RecordingError(f"no message on {journal} is a valid entry; the first error: {problem}")
    return found, _overlapping(found, sent), max(0, starts - 1), foreign


def _overlapping(journals: list[list[JournalEntry]], sent: list[list[Sent]]) -> list[list[Sent]]:
    """Return the messages on `shaker/waveform` by journal, with those near a reset in the lists of both journals.

    `sent` has the messages by the journal during which they were recorded. Stamps continue across a reset. A message
    recorded after a reset, with a stamp before it, is added to the journal before the reset. A message recorded before
    a reset, with a later stamp, is added to the journal after the reset, marked as doubtful.
    """
    found = [list(blocks) for blocks in sent]
    for number, journal in enumerate(journals[1:], start=1):
        reset_ns = journal[0].stamp_ns
        if journal[0].kind is InputKind.RESET:
            found[number - 1] += [one for one in sent[number] if one.stamp_ns < reset_ns]
            ahead = [one._replace(is_doubtful=True) for one in sent[number - 1] if one.stamp_ns >= reset_ns]
            found[number] = ahead + found[number]
    return found


def _assigned(scans: Iterable[Table], journals: list[list[JournalEntry]], first: int) -> Iterator[tuple[int, Table]]:
    """Yield each block of scans with the index of the journal to which it belongs, from the journal `first` on.

    Stamps normally continue from journal to journal, so a journal begins with the first block at or after its first
    entry. If a rig was started again with the same or an earlier stamp, such as 0, its journal begins with the first
    block whose stamp does not increase.
    """
    number, before_ns = first, None
    for table in scans:
        while number + 1 < len(journals):
            following, start_ns = journals[number + 1][0], journals[number][0].stamp_ns
            if following.kind is InputKind.RESET or following.stamp_ns > start_ns:
                is_next = table.stamp_ns >= following.stamp_ns  # stamps continue
            else:
                is_next = before_ns is not None and table.stamp_ns <= before_ns  # the rig was restarted, again at 0
            if not is_next:
                break
            number, before_ns = number + 1, None
        before_ns = table.stamp_ns
        yield number, table


def _verify(
    journal: list[JournalEntry], scans: Iterator[Table], others: _OtherTopics, following: JournalEntry | None
) -> tuple[Verification, Block | None]:
    """Compare the recorded blocks of one journal, and all other messages of their time, with its re-simulation.

    Args:
        journal: entries of the journal.
        scans: recorded blocks that belong to the journal.
        others: comparison of the other topics.
        following: first entry of the next journal; None for the last journal.

    Returns:
        The result, and a block for `_is_missing` to check if a reset ends the journal. The block is the next one of the
        re-simulation after the recorded ones and those that a fault withheld. It is None if no reset ends the journal,
        if it cannot be simulated, or if the comparison ended with a difference or an error.
    """
    compared = 0
    try:
        again = others.begin(journal, following)
        for table in scans:
            block = next(again.blocks)
            while block.scan.stamp_ns < table.stamp_ns:  # the recorder started after the first block of the rig
                if compared and not block.lost:
                    return _missing(block, compared), None
                others.compare(block)
                block = next(again.blocks)
            difference = _difference(table, block.scan)
            if difference:
                return Verification(False, compared, f"{topics.SCAN.name}{difference}"), None
            others.compare(block)
            compared += len(table.rows)
        # nothing is simulated beyond the recorded scans, which the rig may not have reached; a reset is the exception
        rest = None
        reset_ns = _reset_ns(following)
        if reset_ns is not None:
            rest = _next(again)
            while rest is not None and rest.lost and rest.end_ns <= reset_ns:  # withheld by a fault until the end
                others.compare(rest)
                rest = _next(again)
        others.end(reset_ns, last=following is None)
    except _NO_JOURNAL as error:
        return Verification(None, compared, str(error)), None
    return Verification(True, compared), rest


def _reset_ns(following: JournalEntry | None) -> int | None:
    """Return the stamp of the reset that ends a journal [ns]; None if no reset ends it.

    `following` is the first entry of the next journal, a reset or a start; None for the last journal.
    """
    return following.stamp_ns if following is not None and following.kind is InputKind.RESET else None


def _next(again: Resimulation) -> Block | None:
    """Return the next block of a re-simulation; None if the recording lacks an input that the block needs.

    Near a reset, a block may extend to times whose inputs were not recorded.
    """
    try:
        return next(again.blocks)
    except ConfigError:
        return None


def _is_missing(block: Block, reset_ns: int) -> bool:
    """Return whether an unrecorded block is missing, because the rig had published it before a reset.

    `block` is the re-simulated block, and `reset_ns` the stamp of the reset [ns]. The rig had published the block if it
    had simulated the whole 10 ms tick in which the block ends. A block that a fault withholds is never missing.
    """
    on_grid = (block.end_ns - block.scan.stamp_ns) % COMMAND_GRID_NS == 0
    return not block.lost and block.end_ns + (0 if on_grid else COMMAND_GRID_NS) <= reset_ns


def _missing(block: Block, compared: int) -> Verification:
    return Verification(False, compared, f"daq/scan: the block at {_s(block.scan.stamp_ns)} s is missing")


def _difference(logged: Table, again: Table) -> str:
    """Return the first difference between a recorded and a re-simulated table as text; empty if there is none.

    A difference is another stamp, number of rows or value, or a column that the recorded table lacks. Further columns
    of the recorded table are not compared.
    """
    if logged.stamp_ns != again.stamp_ns or len(logged.rows) != len(again.rows):
        return (
            f": logged {len(logged.rows)} rows at {_s(logged.stamp_ns)} s, "
            f"re-simulated {len(again.rows)} at {_s(again.stamp_ns)} s"
        )
    for name in again.rows.dtype.names or ():
        if name not in (logged.rows.dtype.names or ()):
            return f" at {_s(logged.stamp_ns)} s: column {name!r} is missing"
        ours, theirs = again.rows[name], logged.rows[name]
        unequal = np.flatnonzero(_bits(ours) != _bits(theirs))
        if len(unequal):
            i = int(unequal[0])
            differs = f"logged {quoted(theirs[i])}, re-simulated {quoted(ours[i])}"
            return f" in the table at {_s(logged.stamp_ns)} s, row {i} (from 0), {name}: {differs}"
    return ""


def _bits(column: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return the bits of a column as integers, so that NaN equals NaN, and 0.0 differs from -0.0; text is unchanged."""
    packed = np.ascontiguousarray(column)
    return packed if packed.dtype.kind == "S" else packed.view(f"u{packed.dtype.itemsize}")


def _s(time_ns: int) -> str:
    return f"{time_ns // NS_PER_S}.{time_ns % NS_PER_S:09d}"


class _Recorded:
    """Comparison of the recorded messages of one topic, in recorded order, with those of the re-simulation.

    Messages are paired by their stamps. After the first pair, a missing or additional message is a difference. The
    attribute `coming` holds stamp [ns] and content of the next recorded message; None if there is none.

    Args:
        run: an open run.
        topic: topic to compare, which need not be recorded.
        read: function that returns stamp [ns] and content of a message.
        differ: function that returns the first difference between a recorded and a re-simulated content, or an empty
            text.
    """

    def __init__(
        self, run: Run, topic: topics.Topic, read: Callable[[Message], Any], differ: Callable[[Any, Any], str]
    ) -> None:
        self.topic, self._read, self._differ = topic, read, differ
        self._messages = run.messages([topic.name] if run.holds(topic) else [], recorded_order=True)
        self._path = run.path
        self.count = self._outside = 0
        self.difference = ""
        self._last_ns = -(2**63)
        self._absent_ns: int | None = None
        self._is_restarted = False
        self.coming: tuple[int, Any] | None = None
        self._step()

    def begin(self, start_ns: int, ended_ns: int, *, is_restarted: bool) -> None:
        """Begin to compare the messages of the next journal.

        If the journal starts before the previous one ended, the rig was restarted. Remaining messages of the previous
        rig, with stamps from its end on, are then left out.

        Args:
            start_ns: stamp of the first scan of the journal [ns].
            ended_ns: end of the scans of the previous journal [ns].
            is_restarted: whether the rig is restarted (not reset) at the end of this journal, so that later stamps may
                be earlier than those of this journal.
        """
        if start_ns < ended_ns:
            while self.coming is not None and self.coming[0] >= ended_ns:
                self._outside += 1
                self._step()
        self._last_ns, self._is_restarted = start_ns, is_restarted

    def _has_ended(self) -> bool:
        """Return whether no recorded message of this topic is left that belongs to the present journal.

        A next message with an earlier stamp than the last one belongs to the next journal, if the rig was restarted
        after the present one.
        """
        return self.coming is None or (self._is_restarted and self.coming[0] < self._last_ns)

    def expect(self, stamp_ns: int, content: Any, *, optional: bool = False) -> None:
        """Compare the next recorded message with a re-simulated message; a difference is kept for the result.

        A recorded message with an earlier stamp is a difference, and so is a missing message. Neither counts before the
        first message of the topic has been compared. If no recorded message is left, `end` decides whether missing
        messages count.

        Args:
            stamp_ns: stamp of the re-simulated message [ns].
            content: content of the re-simulated message.
            optional: whether the message may be missing in the recording, which is then no difference.
        """
        self._leave_out_before(stamp_ns)
        if optional and (
            self.coming is None or self.coming[0] != stamp_ns or self._differ(self.coming[1], content) != ""
        ):
            return
        if self.coming is None or self._has_ended() or self.coming[0] > stamp_ns:
            if self._has_ended() and self.count:
                self._absent_ns = stamp_ns if self._absent_ns is None else self._absent_ns
            elif self.count:
                self._differs(f" at {_s(stamp_ns)} s: the message is missing")
        else:
            self.compare(content)

    def before(self, end_ns: int, first_ns: int) -> Iterator[int]:
        """Yield the stamp of each recorded message from `first_ns` to before `end_ns` [ns]; stop at a difference.

        Earlier messages are treated as in `expect`. The caller must call `compare` for each stamp before it asks for
        the next stamp.
        """
        self._leave_out_before(first_ns)
        while self.coming is not None and not self._has_ended() and self.coming[0] < end_ns and not self.difference:
            yield self.coming[0]

    def compare(self, content: Any) -> None:
        """Compare the next recorded message, which must exist, with re-simulated content.

        The content None means that no message should have been recorded.
        """
        assert self.coming is not None
        stamp, recorded = self.coming
        difference = "" if content is None else self._differ(recorded, content)
        if content is None:
            self._differs(f"at {_s(stamp)} s: a message is recorded that the re-simulation does not publish")
        elif difference:
            self._differs(
                difference if difference.startswith((" at", " in", ":")) else f" at {_s(stamp)} s: {difference}"
            )
        else:
            self.count += 1
        self._last_ns = stamp
        self._step()

    def end(self, end_ns: int, *, restarted: bool, lag_ns: int) -> None:
        """End the journal, and check whether messages are left over or missing.

        The next recorded message is a difference if its stamp is before `end_ns`. It is no difference if no message of
        the topic has agreed yet, or if another rig follows. A re-simulated message that was not recorded is a
        difference if its stamp is more than `lag_ns` before the end.

        Args:
            end_ns: end of the scans of the journal [ns].
            restarted: whether the start of another rig follows.
            lag_ns: duration before the end whose messages may not have reached the recorder [ns].
        """
        if not restarted and self.coming is not None and self.count and self._last_ns <= self.coming[0] < end_ns:
            self.compare(None)
        if self._absent_ns is not None and self._absent_ns < end_ns - lag_ns:
            self._differs(f" at {_s(self._absent_ns)} s: the message is missing")
        self._absent_ns = None

    def close(self) -> None:
        """Stop reading the recorded messages."""
        self._messages.close()

    def compared(self, present: bool) -> Compared:
        """Return the result of comparing this topic.

        Recorded messages that are left count as left out, because they belong to times without a recorded scan.
        `present` states whether the topic was recorded; if not, the result only says that.
        """
        while self.coming is not None:
            self._outside += 1
            self._step()
        if not present:
            return Compared(self.topic.name, left_out="it is not in this run")
        rest = f"{self._outside} more belong to times without a recorded scan" if self._outside else ""
        return Compared(self.topic.name, self.count, self.difference, rest, "messages")

    def _leave_out_before(self, stamp_ns: int) -> None:
        while self.coming is not None and not self._has_ended() and self.coming[0] < stamp_ns:
            if self.count:
                self.compare(None)
                return
            self._outside += 1
            self._step()

    def _differs(self, what: str) -> None:
        self.difference = self.difference or what.lstrip(": ")

    def _step(self) -> None:
        self.coming = None
        for message in self._messages:
            try:
                self.coming = self._read(message)
            except (CodecError, RecordingError) as error:
                self._differs(str(error))
                continue
            return


class _OtherTopics:
    """Comparison of all topics of a run except `daq/scan` with the re-simulation of its journals.

    Args:
        run: an open run.
        foreign: number of messages on `rig/journal` that are no journal entries.
        waveforms: pairs of a journal and the messages on `shaker/waveform` during it.
        blocks: number of blocks of scans to compare; None means all.
    """

    def __init__(
        self, run: Run, foreign: int, waveforms: Sequence[tuple[list[JournalEntry], list[Sent]]], blocks: int | None
    ) -> None:
        self._run = run
        self._blocks = blocks
        self._waveforms = waveforms

        def tables(topic: topics.Topic) -> _Recorded:
            return _Recorded(run, topic, lambda message: _stamped(run.table(message, topic)), _difference)

        self._applied, self._info = tables(topics.APPLIED), tables(topics.INFO)
        self._impacts, self._faults = tables(topics.IMPACTS_TRUTH), tables(topics.FAULTS)
        self._truth = tables(topics.TRUTH_SCAN)
        self._joints = _Recorded(
            run, topics.JOINT_STATES, lambda message: codec.joint_state(message.data), _joints_differ
        )
        self._monitor_rates_hz = _monitor_rates_hz(run)
        self._monitors = [_Monitor(run, name) for name, kind in INSTRUMENTS.items() if kind.monitor is not None]
        self._journal = Compared(
            topics.JOURNAL.name, left_out=f"{foreign} messages are not journal entries" * bool(foreign)
        )
        self._configurations: list[dict[str, object]] = []
        self._descriptions: set[str] = set()
        self._end_ns = 0

    def begin(self, journal: list[JournalEntry], following: JournalEntry | None) -> Resimulation:
        """Start and return the re-simulation of a journal, and prepare the comparison of all topics with it.

        `following` is the first entry of the next journal; None means that there is none.
        """
        every_scan = self._truth.coming is not None or self._joints.coming is not None
        entries, sent = last_journal(journal), next(sent for one, sent in self._waveforms if one is journal)
        try:
            self._again = Resimulation(journal, from_flat(RigConfig(), {"output.truth_scan": every_scan}), sent)
        except ConfigError:  # with so many scans in a block, the truth of every scan does not fit into a message
            self._again = Resimulation(journal, None, sent)
        self._entries: list[JournalEntry] = entries
        self._made: list[JournalEntry] = []
        self._calibrations = 0
        self._filters: list[AntiAlias] = []
        self._smoothed: dict[int, list[tuple[int, Smoothed]]] = {}
        is_restarted = following is not None and _reset_ns(following) is None
        for one in self._ordered():
            one.begin(entries[0].stamp_ns, self._end_ns, is_restarted=is_restarted)
        return self._again

    def compare(self, block: Block) -> None:
        """Compare recorded messages from the time of a re-simulated block, except scans, journal and configuration."""
        self._drain()
        self._end_ns = block.end_ns
        for recorded, table in ((self._impacts, block.impacts), (self._faults, block.faults)):
            if table is not None:
                recorded.expect(table.stamp_ns, table)
        rate, start_ns = self._again.rig.rate_hz, self._again.rig.start_ns
        for stamp in self._truth.before(block.end_ns, block.scan.stamp_ns):
            self._truth.compare(block.truth if block.truth is not None and block.truth.stamp_ns == stamp else None)
        for stamp in self._joints.before(block.end_ns, block.scan.stamp_ns):
            scan = first_scan_at(stamp, rate, start_ns)
            at, rows = scan - block.first_scan, block.truth.rows if block.truth is not None else None
            states = block.monitor_states[block.monitor_scans == at] if rows is None else rows[at : at + 1]
            exact = stamp_ns(scan, rate, start_ns) == stamp and len(states)
            self._joints.compare(states[0] if exact else None)
        self._compare_monitors(block)

    def _compare_monitors(self, block: Block) -> None:
        """Filter the scans of a re-simulated block as the monitors do, and compare the resulting monitor messages.

        The journal does not contain the monitor rate, so messages at the rates of all recorded configurations are
        accepted.
        """
        rig = self._again.rig
        if not self._filters:
            there = [one.channel for one in self._monitors if one.channel in (block.scan.rows.dtype.names or ())]
            steps = {monitor_step(rig.rate_hz, hz) for hz in self._monitor_rates_hz}
            self._filters = [AntiAlias(there, step) for step in sorted(steps)]
            for monitor in self._monitors:
                monitor.following.clear()
        first, end = block.first_scan, block.first_scan + len(block.scan.rows)
        for one in self._filters:
            for smoothed in one.feed(first, block.scan.rows):
                self._smoothed.setdefault(smoothed.sample, []).append((one.step, smoothed))
        self._compare_smoothed(end - self._filters[-1].half)

    def _compare_smoothed(self, end: float = math.inf) -> None:
        """Compare the monitor messages before scan index `end` with the re-simulated scans after the monitors' filter.

        Differences are stored with each monitor. The compared scans are dropped.
        """
        rig = self._again.rig
        fitted = [one for config in self._again.configurations for one in config.instruments.fitted()]
        for sample in sorted(sample for sample in self._smoothed if sample < end):
            made = self._smoothed.pop(sample)
            for monitor in self._monitors:
                if monitor.channel in self._filters[0].channels:
                    stamp = stamp_ns(sample, rig.rate_hz, rig.start_ns)
                    monitor.compare(stamp, made, fitted, self._again.calibrations)

    def end(self, reset_ns: int | None, *, last: bool) -> None:
        """Compare the remaining messages of a journal at its end.

        Args:
            reset_ns: stamp of the reset that ends the journal [ns]; None if no reset ends it.
            last: whether the recording ends with this journal, so that its last messages may be missing.
        """
        if reset_ns is not None:
            self._again.finish(reset_ns)
            self._end_ns = reset_ns
        self._compare_smoothed()
        self._drain()
        monitored_ns = self._end_ns
        if last and self._filters:  # the last monitor messages depend on scans that are not recorded
            monitored_ns += -self._filters[-1].half * NS_PER_S // self._again.rig.rate_hz
        ends_ns = {one.recorded: monitored_ns for one in self._monitors}
        rig = self._again.rig
        lag_ns = round(lag_s(self._run, rig.config.daq.block_scans / rig.rate_hz) * NS_PER_S)
        for recorded in self._ordered():
            recorded.end(
                ends_ns.get(recorded, self._end_ns),
                restarted=not last and reset_ns is None,
                lag_ns=lag_ns if last else 0,
            )
        self._compare_journal(reset_ns is not None, lag_ns)
        for config in (*self._again.configurations, *self._again.later_configurations()):
            self._configurations.append(_deciding(config))
            self._descriptions.add(robot_description(config))

    def compared(self) -> Iterator[Compared]:
        """Yield the result of each topic except the scans, also of those that are not in the run."""
        yield self._journal
        known = {topics.SCAN.name, topics.JOURNAL.name}
        for recorded in self._ordered():
            known.add(recorded.topic.name)
            yield recorded.compared(self._run.holds(recorded.topic))
        yield self._compare_configuration()
        yield self._compare_description()
        known |= {topics.CONFIGURATION.name, topics.ROBOT_DESCRIPTION.name}
        by_name = {topic.name: topic for topic in topics.COMMON}
        for name in self._run.topics:
            relative = name if name in by_name else self._run.relative(name)
            if relative is None:
                yield Compared(name, left_out=_FOREIGN)
            elif relative not in known:
                topic = by_name.get(relative)
                family = relative.rpartition("/")[0]
                publisher = topic.publisher if topic else _FAMILIES.get(family, "")
                why = _NOT_COMPARED.get(relative, _NOT_COMPARED.get(publisher, _UNKNOWN))
                yield Compared(relative, left_out=why)

    def close(self) -> None:
        """Stop reading the recorded messages of all topics."""
        for recorded in self._ordered():
            recorded.close()

    def _ordered(self) -> Sequence[_Recorded]:
        tables = self._applied, self._info, self._truth, self._impacts, self._faults, self._joints
        return *tables, *(one.recorded for one in self._monitors)

    def _drain(self) -> None:
        """Compare the applied commands and calibrations that the re-simulation has made since the last call.

        Also keep its new journal entries for `_compare_journal`.
        """
        rig = self._again.rig
        applied = rig.take_applied()
        for table, after in itertools.zip_longest(applied, applied[1:]):
            # two commands of one instant may have been sent together: then only their combined effect is published
            together = after is not None and after.stamp_ns == table.stamp_ns
            self._applied.expect(table.stamp_ns, table, optional=together)
        for table in self._again.calibrations[self._calibrations :]:
            self._info.expect(table.stamp_ns, table)
        self._calibrations = len(self._again.calibrations)
        self._made += rig.take_journal()

    def _compare_journal(self, whole: bool, lag_ns: int) -> None:
        """Compare the recorded entries of a journal with the re-simulated ones, and store the first difference.

        The first entry is not compared.

        Args:
            whole: whether a reset ended the journal, so that the re-simulation must have made all recorded entries;
                otherwise only those before the end of the scans.
            lag_ns: time before the end of the scans [ns]; entries in it may be missing, because they may not have
                reached the recorder.
        """
        end = self._end_ns
        # a planned fault is compared only if the re-simulation has reached its scan
        due = [e for e in self._entries if whole or e.stamp_ns < end]
        count = 0
        for recorded, made in zip(self._entries[1:], self._made[1:], strict=False):
            if recorded.line() != made.line():
                self._journal_differs(
                    f"entry {recorded.sequence} at {_s(recorded.stamp_ns)} s: logged {_quoted(recorded)}, "
                    f"re-simulated {_quoted(made)}"
                )
                return
            count += 1
        reached = [e for e in due if e.kind is not InputKind.FAULT]
        if reached and reached[-1].sequence >= len(self._made):
            extra = next(e for e in reached if e.sequence >= len(self._made))
            self._journal_differs(
                f"entry {extra.sequence} at {_s(extra.stamp_ns)} s: the re-simulation does not make {_quoted(extra)}"
            )
        elif len(self._made) > len(self._entries) and self._made[len(self._entries)].stamp_ns < end - lag_ns:
            missing = self._made[len(self._entries)]
            self._journal_differs(f"the entry {_quoted(missing)} at {_s(missing.stamp_ns)} s is missing")
        else:
            self._journal = attrs.evolve(self._journal, count=self._journal.count + count + 1)

    def _journal_differs(self, what: str) -> None:
        self._journal = attrs.evolve(self._journal, difference=self._journal.difference or what)

    def _compare_configuration(self) -> Compared:
        """Compare the recorded configurations (topic and attachment) with those of the re-simulations.

        Differing configurations are left out if they may be older than the first recorded scan.
        """
        name = topics.CONFIGURATION.name
        recorded = texts(self._run, topics.CONFIGURATION, self._blocks)
        attached = self._run.attachments().get(CONFIGURATION)
        count, found = 0, []
        try:
            found = [_parsed(text.encode()) for text in recorded]
            opened = None if attached is None else _parsed(attached)
        except ConfigError as error:
            is_topic = len(found) < len(recorded)
            where = f"text {len(found)}, counted from 0," if is_topic else f"the attachment {CONFIGURATION}"
            return Compared(name, count, f"{where} is no valid configuration of this version: {error}")
        self._descriptions |= {robot_description(config) for config in found}
        published = [_deciding(config) for config in found]
        other = [number for number, config in enumerate(published) if config not in self._configurations]
        since = other[-1] + 1 if other else 0  # older configurations may belong to times before the first recorded scan
        if other and (since == len(published) or self._explained(published[since:]) < self._explained(published)):
            return Compared(name, count, f"text {other[-1]}, counted from 0: {self._unlike(published[other[-1]])}")
        count = len(published) - since
        if opened is not None and _deciding(opened) not in [*published, *self._configurations]:
            return Compared(name, count, f"attachment {CONFIGURATION}: {self._unlike(_deciding(opened))}")
        if not recorded:
            return Compared(name, left_out="it is not in this run")
        rest = f"{len(recorded) - count} belong to times before the first scan" if count < len(recorded) else ""
        return Compared(name, count, left_out=rest, what="texts")

    def _explained(self, published: Sequence[dict[str, object]]) -> int:
        """Return how many configurations of the re-simulations occur in `published`, in the same order.

        Counting ends at the first configuration that does not occur. Equal configurations in a row count once.
        """
        wanted = [one for one, _ in itertools.groupby(self._configurations)]
        count = 0
        for config in published:
            count += count < len(wanted) and config == wanted[count]
        return count

    def _unlike(self, config: dict[str, object]) -> str:
        """Return a clause that says how a recorded configuration differs from the most similar one of the journal.

        The clause names the first value that differs.
        """
        if not self._configurations:
            return "the journal contains no configuration to compare it with"
        nearest = min(self._configurations, key=lambda one: sum(config[key] != one[key] for key in config))
        key = next(key for key in config if config[key] != nearest[key])
        similar = quoted(nearest[key])
        return f"{key} is {quoted(config[key])}, but {similar} in the most similar configuration of the journal"

    def _compare_description(self) -> Compared:
        name = topics.ROBOT_DESCRIPTION.name
        if not self._run.holds(name):
            return Compared(name, left_out="it is not in this run")
        recorded = texts(self._run, topics.ROBOT_DESCRIPTION, self._blocks)
        wrong = [text for text in recorded if text not in self._descriptions]
        return Compared(name, len(recorded), "it does not match the configuration" if wrong else "", what="texts")


class _Monitor:
    """Comparison of the recorded monitor messages of one channel with the filtered scans of the re-simulation.

    The first `HALF_PERIODS` messages at a monitor rate are not compared, nor as many after a gap, because the rig
    restarts its filter when the rate changes.
    """

    def __init__(self, run: Run, channel: str) -> None:
        topic = INSTRUMENTS[channel].monitor
        assert topic is not None
        self.channel = channel
        schema = run.topics[run.resolve(topic)].topic.schema if run.holds(topic) else ""
        try:
            layout = members(schema) if schema else []
        except RecordingError as error:
            raise RecordingError(f"{run.path}: the definition of messages on {topic.name}: {error}") from error

        def read(message: Message) -> tuple[int, dict[str, Any]]:
            return codec.header_stamp_ns(message.data), codec.plain(message.data, layout)

        self.recorded = _Recorded(run, topic, read, self._differ)
        self.following: Counter[int] = Counter()
        """Number of messages that followed one another without a gap, by the scans per monitor period."""

    def compare(
        self, stamp_ns: int, made: list[tuple[int, Smoothed]], fitted: list[Instrument], calibrations: list[Table]
    ) -> None:
        """Compare the recorded monitor message that has this stamp, if there is one.

        Args:
            stamp_ns: stamp of the message [ns].
            made: pairs of the number of scans per monitor period and the filtered scan at that time, one for each
                possible rate of the monitor.
            fitted: instruments of all configurations so far.
            calibrations: tables of `daq/info` of all calibrations so far.
        """
        is_recorded = False
        for _ in self.recorded.before(stamp_ns + 1, stamp_ns):
            is_recorded = True
            is_sure = any(self.following[step] >= HALF_PERIODS for step, _ in made)
            self.recorded.compare((made, fitted, calibrations) if is_sure else ())
        for step, _ in made:
            self.following[step] = self.following[step] + 1 if is_recorded else 0

    def _differ(self, found: dict[str, Any], made: tuple[Any, ...]) -> str:
        """Compare a recorded monitor message with all possible ones; return a difference, or "" if it equals one.

        `made` has the filtered scans at all possible rates, and the instruments and calibrations of all configurations
        so far. An empty `made` skips the comparison and gives "".
        """
        if not made:
            return ""
        smoothed, fitted, infos = made
        difference = ""
        instruments = [instrument for instrument in fitted if instrument.name == self.channel]
        for (_, one), instrument, info in itertools.product(smoothed, instruments, infos):
            (row,) = np.flatnonzero(info.rows["name"] == self.channel.encode())
            clipped, noise = bool(one.status & (1 << int(row))), float(info.rows["noise"][row])
            difference = _fields_differ(found, instrument.message(one.values[self.channel], clipped, noise))
            if not difference:
                return ""
        return difference


_parsed = functools.lru_cache(maxsize=8)(parse)
"""Configuration in a recorded text; a run repeats the same text, and two comparisons read it."""


def _monitor_rates_hz(run: Run) -> set[float]:
    """Return the monitor rates of all published and attached configurations [Hz].

    The default rate is among them if no configuration was published, or none is valid.
    """
    usual_hz = RigConfig().output.monitor_rate_hz
    recorded = [text.encode() for text in texts(run, topics.CONFIGURATION)]
    rates_hz = set() if recorded else {usual_hz}
    for found in [*recorded, run.attachments().get(CONFIGURATION)]:
        with contextlib.suppress(ConfigError):  # reported by the comparison of configurations
            rates_hz |= {_parsed(found).output.monitor_rate_hz} if found is not None else set()
    return rates_hz or {usual_hz}


def _fields_differ(found: dict[str, Any], wanted: Mapping[str, object]) -> str:
    """Return the first field of a recorded monitor message that differs, with both values; empty if none does.

    `wanted` has the re-simulated values by field. Other fields are not compared. A value may be rounded to a 32-bit
    float. NaN equals nothing.
    """
    for path, value in wanted.items():
        ours, theirs = (np.array(one, np.float64).reshape(-1) for one in (value, found.get(path, math.nan)))
        if ours.shape == theirs.shape:
            with np.errstate(over="ignore"):
                same = (theirs == ours) | (theirs == ours.astype(np.float32))  # with the precision of the field
            if same.all():
                continue
        return f"{path}: logged {quoted(found.get(path))}, re-simulated {quoted(value)}"
    return ""


def _stamped(table: Table) -> tuple[int, Table]:
    return table.stamp_ns, table


def _joints_differ(recorded: tuple[NDArray[np.float64], ...], truth: np.void) -> str:
    """Return the first quantity of a recorded joint state that differs from the true motion, with both values.

    They must agree bit for bit; the text is empty if all do.
    """
    for what, found, values in zip(("position", "velocity", "effort"), recorded, joints(truth), strict=True):
        true = np.array(values, np.float64)
        if len(found) != len(true) or (_bits(found) != _bits(true)).any():
            return f"{what}: logged {found.tolist()}, re-simulated {true.tolist()}"
    return ""


def _deciding(config: RigConfig) -> dict[str, object]:
    """Return the values of a configuration that determine samples, by full name, except the planned faults.

    The journal contains a planned fault as soon as it is injected.
    """
    return {name: value for name, value in deciding_samples(to_flat(config)).items() if name != PLANNED}


def _quoted(entry: JournalEntry) -> str:
    return entry.line().partition('"stamp_ns": ')[2].partition(", ")[2].rstrip("}") or entry.kind.value
