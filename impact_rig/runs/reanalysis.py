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
"""Analysis of a recorded run by the `Tracker` of the live node, and comparison with the live results.

A measurement begins at the last change (a command, a label, a reset) or at the start of the data. The live analysis and
the reanalysis may start with different scans. Their results can therefore be compared only from the first change that
both received.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.settings import GapLabel, TrackerSettings, machine_of, parse_label, read_settings, started_of
from impact_rig.analysis.tracker import Findings, Tracker
from impact_rig.arithmetic import ARITHMETIC
from impact_rig.blocks import TRANSMISSIBILITY, Table
from impact_rig.config.tree import parameters_in
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.recording import CONFIGURATION, Message, Run, arithmetic_of, is_measured
from impact_rig.recording.losses import check_contiguity, last_scan_ns
from impact_rig.runs.recovery import is_cut_short
from impact_rig.simtime import NS_PER_S, scan_index
from impact_rig.states import Status
from impact_rig.system.machine import fingerprint

_NEEDED = (topics.INFO, topics.APPLIED, topics.SCAN)


def analyze(run: Run, instead: Callable[[topics.Topic, Table], Table] = lambda _, table: table) -> Iterator[Findings]:
    """Analyse a recorded run as the live node does, and yield the findings of each block of scans.

    One more item follows: the findings that the analysis makes when the data end. The settings are the last ones of the
    live analysis in the run, or the defaults without a live analysis.

    Args:
        run: an open run.
        instead: function that receives topic and table of each message of `daq/info` and `daq/scan`, and returns the
            table to analyse; by default the same table.

    Raises:
        RecordingError: a topic that the analysis needs was not recorded, or a message is damaged or of another type.
    """
    settings, labels = as_set_live(run)
    tracker = Tracker(settings)
    for label in labels:
        tracker.label(label.gap_m, label.stamp_ns)
    found = {run.resolve(topic.name): topic for topic in _NEEDED}
    try:
        for message in _in_published_order(run, found):
            topic = found[message.topic]
            if topic is topics.INFO:
                tracker.configure(instead(topic, run.table(message, topic)))
            elif topic is topics.APPLIED:
                tracker.on_applied(run.table(message, topic))
            else:
                yield tracker.feed(instead(topic, run.table(message, topic)))
    except ConfigError as error:
        raise RecordingError(f"{run.path}: {error}") from error
    yield tracker.flush(take_unsettled=is_measured(run.provenance))


def _in_published_order(run: Run, names: Mapping[str, topics.Topic]) -> Iterator[Message]:
    """Yield messages of a run in the order in which the rig published them.

    Scans keep the order in which they were received. Other messages are inserted by their publish times, because each
    topic reaches a recorder independently and may be late. The first calibration (`daq/info`) precedes all scans in any
    case, because nothing can be measured without it.

    Args:
        run: an open run.
        names: topics to read, by full name; with `daq/scan` and `daq/info`.

    Raises:
        RecordingError: the run has no block of scans or no calibration.
    """
    scan = next(name for name, topic in names.items() if topic is topics.SCAN)
    first = next(run.messages([scan], recorded_order=True), None)
    if first is None:
        raise RecordingError(f"{run.path} holds no block of {topics.SCAN.name} to analyse: choose a run with scans")
    others = sorted(run.messages(set(names) - {scan}, recorded_order=True), key=lambda one: one.publish_time)
    calibration = next((message for message in others if names[message.topic] is topics.INFO), None)
    if calibration is None:
        raise RecordingError(
            f"{run.path} holds no calibration ({topics.INFO.name}), so the rate and units of its scans are unknown: "
            "choose a run that has it"
        )
    if calibration.publish_time >= first.publish_time:
        others.remove(calibration)
        yield calibration
    yield from heapq.merge(others, run.messages([scan], recorded_order=True), key=lambda one: one.publish_time)


def as_set_live(run: Run) -> tuple[TrackerSettings, list[GapLabel]]:
    """Return the last settings of the live analysis in a run, and the gap labels that the live analysis has published.

    If no live analysis was recorded, the settings are the defaults, and the labels are those in the operator's remarks.
    If the settings of two analyses alternate, the result has the settings that were published last, and no labels,
    because the source of each label is unknown. Call this before the scans are analysed, because a label may be
    recorded after the scan from which it applies.
    """
    if not run.holds(topics.ANALYSIS_SETTINGS):
        return TrackerSettings(), [label for label in map(parse_label, remarks(run)) if label is not None]
    found = _live_settings(run)
    active = [(one.since_ns, *read_settings(one.table)) for one in found]
    labels = [] if any(one.in_turn for one in found) else [GapLabel(gap_m, since_ns) for since_ns, _, gap_m in active]
    return (active[-1][1] if active else TrackerSettings()), labels


@attrs.frozen(eq=False)
class _LiveSettings:
    """Published settings of a live analysis, and the rig time from which they apply."""

    since_ns: int
    table: Table
    again: bool  # whether an analysis published them that was restarted during the run
    # whether another analysis published settings between two of this one: it is then unknown which one made a label
    in_turn: bool


def _live_settings(run: Run) -> list[_LiveSettings]:
    """Return the settings that live analyses of a run published, in order; invalid tables are skipped.

    Settings apply from the stamp of their table on. Those of an analysis that was restarted during the run apply only
    to scans after the restart. Of several analyses that started before the first scan, only the last one counts. The
    others ended before the run; their settings were recorded only because the topic is latched.

    Raises:
        RecordingError: all recorded settings are invalid.
    """
    topic = topics.ANALYSIS_SETTINGS
    if not run.holds(topic):
        return []
    scans = [topics.SCAN.name] if run.holds(topics.SCAN) else []
    start_ns = next((message.publish_time for message in run.messages(scans, recorded_order=True)), 0)
    found: list[_LiveSettings] = []
    invalid = []
    earlier: set[float | None] = set()
    received_ns = 0
    for number, message in enumerate(run.messages([topic.name], recorded_order=True)):
        try:
            table = run.table(message, topic)
            read_settings(table)
        except (ConfigError, RecordingError) as error:
            invalid.append(error)
            continue
        another = bool(found) and started_of(table) != started_of(found[-1].table)
        again = another and message.publish_time > start_ns
        if again:
            received_ns = _received_ns(run, topic, number)
        elif another:
            found.clear()
        found.append(
            _LiveSettings(max(table.stamp_ns, received_ns), table, again, another and started_of(table) in earlier)
        )
        earlier.add(started_of(table))
    if invalid and not found:
        raise RecordingError(
            f"{run.path}: no settings of its live analysis are valid, so choose another run; the first error: "
            f"{invalid[0]}"
        ) from invalid[0]
    return found


def _received_ns(run: Run, topic: topics.Topic, number: int) -> int:
    """Return the rig time [ns] at which message `number` (from 0) of a topic was received.

    It is the time of the last scan that was recorded before the message, or 0 without such a scan.
    """
    name, scan = run.resolve(topic), run.resolve(topics.SCAN)
    newest_ns, count = 0, 0
    for message in run.messages([name, scan], recorded_order=True):
        if message.topic == scan:
            newest_ns = last_scan_ns(run.table(message, topics.SCAN))
        elif count == number:
            break
        else:
            count += 1
    return newest_ns


def remarks(run: Run) -> list[str]:
    """Return the operator's remarks in a run (topic `notes`), in log-time order; empty if none was recorded."""
    return texts(run, topics.NOTES)


def measurements(findings: Iterator[Findings]) -> list[Table]:
    """Return the tables of `transmissibility/table` in findings, one row each; a row may have a status but no DT."""
    return [table for found in findings for table in found.measurements]


def rows(tables: list[Table]) -> NDArray[np.void]:
    """Return the rows of tables from `measurements` as one array of `TRANSMISSIBILITY`, shape (n,)."""
    return np.concatenate([table.rows for table in tables]) if tables else np.empty(0, TRANSMISSIBILITY)


def newest_settled(tables: list[Table]) -> NDArray[np.void]:
    """Return the last settled row at each gap and frequency, shape (n,), by gap (unknown first) and then frequency."""
    found = rows(tables)
    settled: NDArray[np.void] = found[found["settled"] == 1.0]
    keys = zip(np.nan_to_num(settled["gap"], nan=-1.0).tolist(), settled["frequency"].tolist(), strict=True)
    last = {key: place for place, key in enumerate(keys)}
    return settled[[last[key] for key in sorted(last)]]


def texts(run: Run, topic: topics.Topic, blocks: int | None = None) -> list[str]:
    """Return the texts on a topic of type std_msgs/String; empty if the topic was not recorded.

    Args:
        run: an open run.
        topic: the topic.
        blocks: None returns all texts, in log-time order. A number returns only the texts recorded before this block of
            scans, counted from 1, in the order of recording.
    """
    if not run.holds(topic):
        return []
    if blocks is None:
        return [_text(message.data) for message in run.messages([topic.name])]
    found, scan, seen = [], run.resolve(topics.SCAN.name), 0
    for message in run.messages([topic.name, scan], recorded_order=True):
        seen += message.topic == scan
        if seen >= blocks:
            break
        if message.topic != scan:
            found.append(_text(message.data))
    return found


def _text(cdr: bytes | memoryview) -> str:
    """Return the text of a serialized std_msgs/String: 4 bytes of encapsulation, length with terminator, UTF-8.

    Invalid bytes become U+FFFD; a message that is too short gives the text that is there.
    """
    length = int.from_bytes(cdr[4:8], "little")
    return bytes(cdr[8 : 8 + max(0, length - 1)]).decode(errors="replace")


TOLERANCE = 1e-9  # relative tolerance between machines that differ in the last bits
ABSOLUTE = frozenset({"phase", "phase_uncertainty", "frequency_deviation", "thd", "spread"})
"""Columns whose values can be nearly zero, so that their tolerance is absolute: 1e-9 in their unit."""
DEFAULT_AHEAD, MOST_AHEAD = 16, 1000  # number of blocks that a rig may run ahead of its peers (time.ack_window)
# number of measurements that one of two topics of an analysis may have more at the start or end of a recording
EDGE = 2
LAG_S = 1.0
"""Duration before the end of a recording in which messages may be missing, because scans overtake them [s]."""

_TABLE = topics.TRANSMISSIBILITY_TABLE


@attrs.frozen
class Compared:
    """Result of comparing one topic: what agrees, the first difference, and what was not compared, with the reason."""

    topic: str
    count: int = 0  # number of rows or messages that were compared and agree
    difference: str = ""  # the first difference; empty if there is none
    left_out: str = ""  # what of the topic was not compared, and why; empty if all was compared
    what: str = "rows"  # unit of the count, for the text

    def __str__(self) -> str:
        if self.difference:
            return f"{self.topic}: {self.difference}"
        if not self.count and self.left_out:
            return f"{self.topic}: not compared: {self.left_out}"
        return f"{self.topic}: {self.count} {self.what} agree" + (f"; {self.left_out}" if self.left_out else "")


@attrs.frozen
class Agreement:
    """Result of comparing the live results in a run with those of a later analysis of it."""

    same: bool | None  # whether everything that can be compared agrees; None if nothing can be compared
    identical: bool = False  # whether the compared results are equal bit for bit
    compared: int = 0  # number of rows compared
    elsewhere: bool | None = None
    """True if the live analysis ran on another machine or with other libraries; None if its machine is not recorded."""
    reason: str = ""  # the first difference, or why nothing could be compared; empty if all agrees
    left_out: tuple[int, int] = (0, 0)  # number of rows of the live and of the later analysis that were not compared
    others: tuple[Compared, ...] = ()  # comparison results of the other topics of the analysis

    def __str__(self) -> str:
        if self.same is None:
            return f"nothing to compare with: {self.reason}"
        live, offline = self.left_out
        rest = (
            f"; not compared are rows of scans that only one analysis received: {live} of the live analysis, "
            f"{offline} of this one"
        )
        where = (
            "on a machine that is not recorded"
            if self.elsewhere is None
            else "on another machine or with other libraries"
        )
        if not self.same:
            found = f"not identical to the live results: {self.reason}"
        elif self.identical:
            found = f"identical to the live results: {self.compared} rows, bit for bit"
        else:
            found = f"equal to the live results to {TOLERANCE:g}, not bit for bit: {self.compared} rows, made {where}"
        return found + (rest if live or offline else "")


@attrs.frozen
class _Blind:
    """Series of scans that one of the two analyses has not received: above `begin`, up to and including `end`.

    Both are scan indexes. `begin` is −∞ for all scans before the first one that the analysis received.
    """

    begin: float
    end: float


@attrs.frozen(eq=False)
class _Row:
    """Measurement of one of the two analyses, from the scans with indexes above `begin`, up to and including `end`."""

    begin: int
    end: int
    stamp_ns: int
    values: np.void

    @property
    def lost_blocks(self) -> bool:
        return bool(self.values["status"] == Status.LOST_BLOCKS.value.encode())


def compare(run: Run, offline: Iterable[Table], impacts: Iterable[Table] | None = None) -> Agreement:
    """Compare the results of a later analysis of a run with the live results that the run contains.

    If there are no live results, or they cannot be compared, `same` of the result is None and `reason` says why.

    Args:
        run: an open run.
        offline: tables of measurements of the later analysis.
        impacts: tables of impacts that the later analysis found; None skips their comparison.

    Raises:
        RecordingError: the run is damaged, or contains an invalid table.
    """
    if is_measured(run.provenance):
        return Agreement(None, reason="this run was imported; it has no live analysis")
    version = arithmetic_of(run.provenance)
    if version not in ("", str(ARITHMETIC)):
        reason = (
            f"the live results were made with arithmetic version {version}, this program has {ARITHMETIC}: analyze the "
            "run with the version of impact_rig that recorded it"
        )
        return Agreement(None, reason=reason)
    settings = _live_settings(run)
    if any(one.in_turn for one in settings):
        return Agreement(None, reason="two analyses labelled this run at once: the source of each gap label is unknown")
    calibration = next(run.tables(topics.INFO), None) if run.holds(topics.INFO) else None
    if calibration is None or not len(calibration.rows):
        return Agreement(None, reason=f"this run holds no {topics.INFO.name}, so its scan rate is unknown")
    rate_hz = round(float(calibration.rows["rate"][0]))
    blocks, tables = _recorded(run) if run.holds(_TABLE) else ([], [])
    live = _rows(tables, rate_hz)
    if not live:
        return Agreement(None, reason="this run holds no results of a live analysis")
    ours = _rows(offline, rate_hz)
    gaps = check_contiguity(blocks, rate_hz).gaps
    data_begin, data_end = scan_index(blocks[0][0], rate_hz) - 1, scan_index(blocks[-1][0], rate_hz) + blocks[-1][1] - 1
    our_blind = [_Blind(-math.inf, data_begin)]
    our_blind += [_Blind(*(scan_index(at, rate_hz) - 1 for at in (gap.expected_ns, gap.stamp_ns))) for gap in gaps]
    live_blind = _blind(live)
    # a restarted analysis knows no earlier scans, and no analysis measured in between
    again = next((one.since_ns for one in settings if one.again), None)
    live_end = data_end if again is None else max((row.end for row in live if row.stamp_ns < again), default=data_begin)
    theirs = [row for row in live if row.end <= live_end and _comparable(row, live_blind, our_blind, ours)]
    found = [
        row for row in ours if (again is None or row.end <= live_end) and _comparable(row, our_blind, live_blind, live)
    ]
    if not theirs:
        return Agreement(
            None,
            reason="no measurement of the live analysis began at a change that is in the recording: the recording "
            f"begins after scan {data_begin}, the first measurement of the live analysis after scan "
            f"{live_blind[0].end:.0f}, "
            + (f"that of this analysis after scan {ours[0].begin}" if ours else "and this analysis has no measurement"),
        )
    machines = {machine for one in settings if (machine := machine_of(one.table)) is not None}
    elsewhere = machines != {fingerprint()} if machines else None
    longest_s = max(length for _, length in blocks) / rate_hz
    late = data_end - round((TrackerSettings().hold_s + lag_s(run, longest_s)) * rate_hz)
    reason, identical = _difference(theirs, found, late, exact=elsewhere is False)
    if reason and is_cut_short(run):  # compare again without the last rows, which may lack a command
        complete = data_end - round(lag_s(run, longest_s) * rate_hz)
        shorter, ours_shorter = ([row for row in rows if row.end <= complete] for rows in (theirs, found))
        reason_before, identical_before = _difference(shorter, ours_shorter, late, exact=elsewhere is False)
        if not reason_before:
            reason, identical, theirs, found = "", identical_before, shorter, ours_shorter
            if not theirs:
                reason = "all live results are from the last moments of a killed recorder, which may lack data"
                return Agreement(None, reason=reason)
    left_out = len(live) - len(theirs), len(ours) - len(found)
    others = [_plotted(run, live)]
    if impacts is not None:
        ends = [int(one.begin) for one in (*our_blind[1:], *live_blind[1:]) if one.begin > data_begin]
        span = max(data_begin, int(live_blind[0].end)) + round(LAG_S * rate_hz), min([late, live_end, *ends])
        others.append(_impacts(run, impacts, rate_hz, span))
    reason = reason or next((str(one) for one in others if one.difference), "")
    return Agreement(not reason, identical and not reason, len(theirs), elsewhere, reason, left_out, tuple(others))


def lag_s(run: Run, block_s: float) -> float:
    """Return by how much messages of other topics may arrive later than the scans of the same time [s of rig time].

    A rig may run ahead of its peers by `time.ack_window` blocks (`DEFAULT_AHEAD` if the run does not state it). At the
    end of a recording, other messages may be missing for this time. The result is one block longer, and at least
    `LAG_S`.

    Args:
        run: an open run.
        block_s: duration of a block [s].
    """
    window: object = None
    with contextlib.suppress(ConfigError, UnicodeDecodeError):
        window = parameters_in(run.attachments().get(CONFIGURATION, b"").decode()).get("time.ack_window")
    blocks = window if isinstance(window, int) and 0 < window <= MOST_AHEAD else DEFAULT_AHEAD
    return max(LAG_S, (blocks + 1) * block_s)


def _recorded(run: Run) -> tuple[list[tuple[int, int]], list[Table]]:
    """Return stamp [ns] and number of scans of every recorded block, and the tables of the live measurements.

    Latched measurements from before the first recorded scan are left out.
    """
    scans, name = run.resolve(topics.SCAN.name), run.resolve(_TABLE.name)
    blocks: list[tuple[int, int]] = []
    tables: list[Table] = []
    for message in run.messages((scans, name), recorded_order=True):
        if message.topic == scans:
            table = run.table(message)
            blocks.append((table.stamp_ns, len(table.rows)))
        else:
            table = run.table(message, _TABLE)
            if blocks and table.stamp_ns >= blocks[0][0]:
                tables.append(table)
    return blocks, tables


def _plotted(run: Run, live: Sequence[_Row]) -> Compared:
    """Compare the values on the topic `transmissibility` with the settled live rows from which they were made.

    The values must be equal. At each end of the recording, one of the topics may lack up to `EDGE` values.
    """
    name = topics.TRANSMISSIBILITY.name
    if not run.holds(name):
        return Compared(name, left_out="it is not in this run")
    shown = [_number(message.data) for message in run.messages([name], recorded_order=True)]
    settled = [float(row.values["transmissibility"]) for row in live if row.values["settled"] == 1.0]
    if not shown or not settled:
        return Compared(name, left_out="this run has no settled measurement")
    # the two topics may begin and end with different measurements at the ends of a recording
    shift = next((k for k in range(-EDGE, EDGE + 1) if _agree(shown, settled, k)), None)
    if shift is None:
        return Compared(name, difference=f"its values are not those of the settled rows of {_TABLE.name}")
    return Compared(name, min(len(shown), len(settled)), what="values")


def _agree(shown: Sequence[float], settled: Sequence[float], shift: int) -> bool:
    """Return whether two lists of values agree where they overlap, if `shown` begins `shift` values after `settled`.

    They do not agree if they do not overlap, or if one ends more than `EDGE` values before the other.
    """
    ours, theirs = shown[max(0, -shift) :], settled[max(0, shift) :]
    both = min(len(ours), len(theirs))
    return both > 0 and abs(len(ours) - len(theirs)) <= EDGE and ours[:both] == theirs[:both]


def _number(cdr: bytes | memoryview) -> float:
    """Return the number in a serialized std_msgs/Float64, or NaN if it is too short."""
    return float(np.frombuffer(cdr, "<f8", 1, 4)[0]) if len(cdr) >= 12 else math.nan


def _impacts(run: Run, offline: Iterable[Table], rate_hz: int, span: tuple[int, int]) -> Compared:
    """Compare the impacts of the live and the later analysis between the two scan indexes of `span`, inclusive.

    An impact that only one analysis found is a difference. Values must agree within `TOLERANCE`.
    """
    name = topics.IMPACTS.name
    if not run.holds(topics.IMPACTS):
        return Compared(name, left_out="it is not in this run")
    live, ours = (
        [(scan, row) for scan, row in _instants(tables, rate_hz) if span[0] <= scan <= span[1]]
        for tables in (run.tables(topics.IMPACTS), offline)
    )
    for count, ((scan, theirs), (found, here)) in enumerate(zip(live, ours, strict=False)):
        where = f"at {min(scan, found) / rate_hz:.6f} s"
        if scan != found:
            side = "live" if scan < found else "later"
            return Compared(name, count, f"only the {side} analysis found an impact {where}")
        column = _different(theirs, here, exact=False)
        if column:
            return Compared(
                name,
                count,
                f"{column} {where}: {theirs[column].item()!r} in the live analysis, here {here[column].item()!r}",
            )
    if len(live) != len(ours):
        longer, side = (live, "live") if len(live) > len(ours) else (ours, "later")
        scan = longer[min(len(live), len(ours))][0]
        what = f"only the {side} analysis found an impact at {scan / rate_hz:.6f} s"
        return Compared(name, min(len(live), len(ours)), what)
    return Compared(name, len(live), left_out="those of the first and last second are left out", what="impacts")


def _instants(tables: Iterable[Table], rate_hz: int) -> list[tuple[int, np.void]]:
    """Return (index of the nearest scan, row) for each row of tables of impacts, in the order of scans."""
    found = [
        (scan_index(table.stamp_ns + round(float(row["time"]) * NS_PER_S), rate_hz), row)
        for table in tables
        for row in table.rows
    ]
    return sorted(found, key=lambda one: one[0])


def _rows(tables: Iterable[Table], rate_hz: int) -> list[_Row]:
    found = []
    for table in tables:
        end = scan_index(table.stamp_ns, rate_hz)
        found += [_Row(end - round(float(row["waited"]) * rate_hz), end, table.stamp_ns, row) for row in table.rows]
    return found


def _blind(live: Sequence[_Row]) -> list[_Blind]:
    """Return the series of scans that the live analysis has not received, according to its rows `live` (at least one).

    The first series contains the scans before the earliest measurement. Each row with the status `lost_blocks`, except
    the last row, adds the scans between this row and the next measurement.
    """
    lost = (_Blind(before.end, row.begin) for before, row in itertools.pairwise(live) if before.lost_blocks)
    return [_Blind(-math.inf, min(row.begin for row in live)), *lost]


def _comparable(row: _Row, own: Sequence[_Blind], other: Sequence[_Blind], others: Sequence[_Row]) -> bool:
    """Return whether the row of one analysis can be compared with the other analysis.

    The other analysis must have received all scans of the row. If the row begins where its own analysis began to
    receive scans, the other analysis must also begin to receive scans or to measure there. A row with the status of
    lost blocks is never compared.

    Args:
        row: row of one analysis.
        own: series of scans that the analysis of this row has not received.
        other: series of scans that the other analysis has not received.
        others: rows of the other analysis.
    """
    if row.lost_blocks or any(row.begin < blind.end and row.end > blind.begin for blind in other):
        return False
    begins = {blind.end for blind in other} | {one.begin for one in others}
    return row.begin not in {blind.end for blind in own} or row.begin in begins


def _difference(live: Sequence[_Row], ours: Sequence[_Row], late: int, *, exact: bool) -> tuple[str, bool]:
    """Return the first difference between the rows of both analyses, and whether all bits agree.

    Args:
        live: rows of the live analysis.
        ours: rows of the later analysis. Rows that end after scan `late` may be missing in the live analysis.
        late: index of a scan.
        exact: whether different bits are a difference; otherwise differences within `TOLERANCE` are accepted.

    Returns:
        The difference as text, empty if there is none, and whether all compared rows are equal bit for bit.
    """
    identical = True
    for theirs, found in zip(live, ours, strict=False):
        where = f"at {theirs.stamp_ns / NS_PER_S:.9f} s"
        if theirs.end != found.end:
            return f"the live analysis measured {where}, this one at {found.stamp_ns / NS_PER_S:.9f} s instead", False
        column = _different(theirs.values, found.values, exact=True)
        if column:
            identical = False
            if exact:
                return _named(where, column, theirs, found), False
            column = _different(theirs.values, found.values, exact=False)
            if column:
                return _named(where, column, theirs, found), False
    if len(live) > len(ours):
        return f"this analysis does not find the live row at {live[len(ours)].stamp_ns / NS_PER_S:.9f} s", False
    missing = [row for row in ours[len(live) :] if row.end <= late]
    if missing:
        at_s = missing[0].stamp_ns / NS_PER_S
        return (
            f"the live analysis published nothing at {at_s:.9f} s, where this one has a row; it may have ended before",
            False,
        )
    return "", identical


def _named(where: str, column: str, theirs: _Row, found: _Row) -> str:
    live, here = theirs.values[column].item(), found.values[column].item()
    return f"{column} {where}: {live!r} in the live analysis, {here!r} in this one"


def _different(theirs: np.void, ours: np.void, *, exact: bool) -> str:
    """Return the name of the first column in which two rows differ; an empty text if none does.

    With `exact`, every different bit counts. Otherwise real numbers that agree within `TOLERANCE` count as equal. The
    tolerance is relative, except for the columns `ABSOLUTE`, where it is absolute.
    """
    for name in ours.dtype.names or ():
        a, b = theirs[name].astype(ours.dtype[name]), ours[name]
        if a.tobytes() == b.tobytes():
            continue
        if exact or ours.dtype[name].kind != "f":
            return str(name)
        if not np.isclose(a, b, rtol=TOLERANCE, atol=TOLERANCE if name in ABSOLUTE else 0.0, equal_nan=True):
            return str(name)
    return ""
