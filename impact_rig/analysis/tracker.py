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
"""`Tracker`: measurement of the transmissibility of a running rig from its blocks of scans, in constant memory.

A tracker receives the tables of the rig. It measures when the response has settled, and states the reason if it cannot.
The rows of its results are the same bit for bit for any block length and any order in which the topics are delivered.
For this purpose, it delays the scans by `hold_s`; no table may arrive later than that. Cycles and windows are counted
from the first scan, and again from each gap, reset, or change of drive, gap label or calibration (`_begin`).
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterable
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.calibration import STEPS, Calibration
from impact_rig.analysis.cycles import Accumulator, Cycles, usable_harmonics
from impact_rig.analysis.impacts import NO_IMPACTS, ImpactDetector, counted, impact_tables
from impact_rig.analysis.scans import CHANNELS, PUBLISHER_REMEDY, SCAN, ScanBuffer, need_columns
from impact_rig.analysis.settings import GapLabel, ImpactSettings, TrackerSettings
from impact_rig.analysis.settling import NOTICED_CYCLES, NOTICED_S, ImpactPause, Judge, Progress, window_cycles
from impact_rig.analysis.transmissibility import Measurement, counts_impacts, measurement_table
from impact_rig.blocks import APPLIED, DAQ_INFO, LONGEST_S, Table, joined
from impact_rig.errors import ConfigError
from impact_rig.simtime import NS_PER_S, first_scan_at, scan_index, stamp_ns
from impact_rig.states import MEASURED, SETTLED, AnalysisWord, Status


@attrs.define
class Counters:
    """Counts of what a tracker has received, lost and reported since its creation, for diagnostics."""

    scans: int = 0
    lost_scans: int = 0
    duplicate_scans: int = 0
    unconfigured_scans: int = 0  # dropped: `daq/info` came more than `hold_s` later, or describes another record
    restarts: int = 0  # times at which the rig was reset, or its stamps went back
    late_events: int = 0  # changes that came after their scan had been measured, so that they act later
    measurements: int = 0  # rows with numbers
    refusals: int = 0  # rows with only a status
    impacts: int = 0


@attrs.frozen
class TrackerState:
    """State of a tracker's measurement: an `AnalysisWord`, its reason and its start.

    It depends only on the tables that the tracker has received, so a recorded run gives the same states again.
    """

    word: str  # of `states.AnalysisWord`
    reason: str = ""  # a status of `transmissibility/table`; empty if the word says enough
    since_ns: int | None = None  # rig time at which it began; None before the first scan


@attrs.frozen(eq=False)
class Findings:
    """New results of one call of a tracker.

    `measurements` are tables `transmissibility/table` of one row each. `impacts` are tables `impacts`.
    """

    measurements: tuple[Table, ...] = ()
    impacts: tuple[Table, ...] = ()


ADD_S = 0.05  # longest delay before scans are added to their cycle: few steps without a long buffer
MOST_EARLY = 1000  # largest number of blocks that wait for the first calibration
MIN_HOLD_SCANS = 16  # shortest delay before cycles are closed; all impacts in them must be known as well


class _Command(NamedTuple):
    frequency_hz: float
    current: float


class _Reset(NamedTuple):
    """Reset of the rig: the stamp [ns] of the new scan 0, and the new calibration.

    A reset is applied when the scans after it arrive.
    """

    start_ns: int
    calibration: Calibration


_Event = _Command | GapLabel | Calibration
_KINDS = (GapLabel, Calibration, _Command)
"""Kinds of events in the order in which simultaneous ones are applied.

It must be fixed, because it is random which of two topics is delivered first.
"""
NOTHING = Findings()


class Tracker:
    """Streaming measurement of transmissibility and impacts, in constant memory.

    Pass it the tables of the rig as they arrive: `daq/info` to `configure`, `shaker/applied` to `on_applied` and
    `daq/scan` to `feed`, which returns new results. It fits a sine with harmonics to each drive cycle, waits until the
    response has settled, and then gives DT with its uncertainty, or the reason why it cannot.
    docs/explanation/analysis.md describes the method and its sources.

    Args:
        settings: settings of the measurement; None means the defaults.
        impact_settings: settings of the impact detection; None means the defaults.

    Attributes:
        counters: counts of scans, losses, measurements and impacts, for diagnostics.

    Examples:
        >>> import impact_rig
        >>> rig, tracker = impact_rig.LocalRig(), impact_rig.Tracker()
        >>> first_scan = rig.command(frequency_hz=9.1, current_a=0.52)
        >>> rig.run(seconds=20)
        >>> tracker.configure(rig.tables("daq/info")[0])
        >>> for table in rig.tables("shaker/applied"):
        ...     tracker.on_applied(table)
        >>> rows = [table.rows[0] for scan in rig.tables() for table in tracker.feed(scan).measurements]
        >>> dt, u = rows[-1][["transmissibility", "transmissibility_uncertainty"]]
        >>> print(f"DT {dt:.2f}, standard uncertainty {u:.2f}")
        DT 63.57, standard uncertainty 0.16

    See Also:
        - `TrackerSettings`: windows, tolerances and limits.
        - `LocalRig`: runs a tracker if it is given `analysis`.
    """

    def __init__(self, settings: TrackerSettings | None = None, impact_settings: ImpactSettings | None = None) -> None:
        self.counters: Counters = Counters()
        self._settings = settings or TrackerSettings()
        self._impact_settings = impact_settings or ImpactSettings()
        self._calibration: Calibration | None = None
        self._info: tuple[int, bytes] | None = None
        self._early: list[Table] = []  # blocks that wait for the first calibration
        self._resets: list[_Reset] = []
        self._start_ns = 0
        self._rate = 0.0  # scans per second of the calibration
        self._hold = 0
        self._buffer = ScanBuffer()
        self._added = 0  # index of the scan before which all must have been added
        self._due = 0  # index before which the held scans need not be added to their cycles
        self._taken: tuple[object, ...] = ()  # type of the rows of the newest block, and the channels it may lack
        self._started = False
        self._last_block = -1
        self._judged = 0  # last scan of the newest window
        self._measured = 0  # index of the next scan to measure
        self._changed = 0  # index of the last change of the drive
        self._events: list[tuple[int, int, int, _Event]] = []  # time, order of the kind, number, event
        self._event_count = 0
        self._command: _Command | None = None
        self._gap_m = math.nan
        self._accumulator: Accumulator | None = None
        self._window = 0
        self._impacts_ahead: list[NDArray[np.void]] = []  # as returned by `ImpactDetector.find`
        self._struck = math.nan  # scan of the last impact before the last reported scan
        self._placed = 0  # scan from which the label applies, or the present drive started
        self._rows: list[Table] = []
        self._state = TrackerState(AnalysisWord.NO_SCANS)

    @property
    def is_calibrated(self) -> bool:
        """Return whether `daq/info` has arrived; without calibration, no scan can be measured."""
        return self._calibration is not None

    def configure(self, info: Table) -> None:
        """Register the calibration of the channels; a repetition of the last table is ignored.

        The first calibration applies to all scans. A later calibration applies from its stamp on. It discards the
        measurement in progress, whose row then has only a status. If the time of scan 0 or the scan rate differs from
        that of the last table, the rig was reset. The scans from the new scan 0 on are then measured as a new record.

        Args:
            info: a table `daq/info`, one row per channel.

        Raises:
            ConfigError: the table is invalid, for example because it lists a channel twice.
        """
        need_columns(info, DAQ_INFO, topics.INFO.name, later=STEPS)
        calibration = Calibration.from_info(info.rows)
        if not abs(info.rows["since_start"][0]) <= LONGEST_S:
            raise ConfigError(
                f"daq/info: since_start, the time from scan 0 to the stamp, must be within ±{LONGEST_S:g} s, got "
                f"{float(info.rows['since_start'][0]):g} s; {PUBLISHER_REMEDY}"
            )
        start_ns = info.stamp_ns - round(float(info.rows["since_start"][0]) * NS_PER_S)
        rows = info.rows.copy()
        rows["since_start"] = 0.0
        content = start_ns, rows.tobytes()
        if content == self._info:
            return
        self._info = content
        if self._calibration is None:
            self._use(_Reset(start_ns, calibration))
            return
        newest = self._resets[-1] if self._resets else _Reset(self._start_ns, self._calibration)
        same_rate = calibration.rate_hz == newest.calibration.rate_hz
        # months after scan 0, the seconds since then are not exact to the nanosecond
        if same_rate and scan_index(start_ns, calibration.rate_hz, newest.start_ns) == 0:
            self._schedule(info.stamp_ns, calibration)
            if not self._resets:
                self._prepare_detector(info.stamp_ns, calibration)
        else:
            self._resets.append(_Reset(start_ns, calibration))

    def on_applied(self, applied: Table) -> None:
        """Register commands to the drive; a command equal to the present one has no effect.

        A changed command discards the measurement in progress, whose row then has only a status.

        Args:
            applied: a table `shaker/applied`; each row applies from the stamp of the table plus its `time` on. If these
                scans have been measured already, the row applies from the first scan not measured yet, and is counted
                as late.

        Raises:
            ConfigError: the table is invalid, or one of its times is not a number or is too large.
        """
        need_columns(applied, APPLIED, topics.APPLIED.name)
        if not (np.abs(applied.rows["time"]) <= LONGEST_S).all():
            first = applied.rows["time"][np.argmax(~(np.abs(applied.rows["time"]) <= LONGEST_S))]
            raise ConfigError(
                f"shaker/applied: time, which counts from the stamp, must be within ±{LONGEST_S:g} s in every row, got "
                f"{first:g} s; {PUBLISHER_REMEDY}"
            )
        for row in applied.rows:
            instant = applied.stamp_ns + round(float(row["time"]) * NS_PER_S)
            self._schedule(instant, _Command(float(row["frequency"]), float(row["current"])))

    def label(self, gap_m: float, stamp_ns: int) -> None:
        """Register the operator's label of the gap, which is stated in the rows of the measurement.

        A changed label discards the measurement in progress, whose row then has only a status.

        Args:
            gap_m: total gap [m]; 0 = no sphere, NaN = unknown.
            stamp_ns: rig time from which the label applies [ns].
        """
        self._schedule(stamp_ns, GapLabel(gap_m, stamp_ns))

    def feed(self, scan: Table) -> Findings:
        """Process the next block of scans, and return new results; blocks must be passed in order.

        Blocks that arrive before the first calibration are kept until it arrives. Blocks older than `hold_s` at that
        time are dropped and counted. A repetition of the newest block is ignored. If blocks are missing, or the stamps
        go back, a row states this, and a new measurement begins.

        Args:
            scan: a table `daq/scan`.

        Returns:
            New results: `measurements`, tables `transmissibility/table` of one row each, and `impacts`, tables of the
            impacts detected. Both are often empty.

        Raises:
            ConfigError: the table lacks a column, or a column has text instead of numbers.
        """
        absent = CHANNELS if self._calibration is None else self._calibration.absent
        rows = scan.rows
        if self._taken != (rows.dtype, absent):
            why = f"it must have every channel that {topics.INFO.name} lists"
            need_columns(scan, SCAN, topics.SCAN.name, later=absent, why=why)
            self._taken = rows.dtype, absent
        if not len(rows):
            return NOTHING
        if self._calibration is None:
            hold_ns = round(self._settings.hold_s * NS_PER_S)
            self._early = [*self._take_early(scan.stamp_ns - hold_ns, scan.stamp_ns), scan]
            return NOTHING
        if self._early:
            return self._feed_each([*self._take_early(self._start_ns), scan])
        while self._resets and self._resets[0].start_ns <= scan.stamp_ns:
            self._begin_again(self._resets.pop(0))
        rate = self._calibration.rate_hz
        index = scan_index(scan.stamp_ns, rate, self._start_ns)
        times = rows["time"]
        first, last = float(times[0]) * rate, float(times[-1]) * rate
        if not math.isfinite(last - first) or round(first) != 0 or round(last) != len(rows) - 1:
            return self._feed_broken(scan, np.rint(times * rate))
        impacts: list[Table] = []
        if index != self._buffer.end or not self._started:
            if self._started and index == self._last_block:
                self.counters.duplicate_scans += len(rows)
                return NOTHING
            self._resume(index)
        self._last_block = index
        buffer = self._buffer
        buffer.append(rows, self._added)
        self.counters.scans += len(rows)
        found = self._detector.find(buffer.samples[0, buffer.column(index) : buffer.column(buffer.end)])
        if len(found):
            impacts = self._impacts(found)
        until = buffer.end - self._hold
        if self._events or until >= self._due:
            self._advance(until)
        else:
            self._measured = max(self._measured, until)
        if not self._rows and not impacts:
            return NOTHING
        measurements, self._rows = tuple(self._rows), []
        return Findings(measurements, tuple(impacts))

    @property
    def progress(self) -> Progress | None:
        """Progress towards the first row after the last change; None without a drive frequency that can be measured.

        The measurement has `windows` of the `needed` windows. If a sphere may still strike and delays the row, `reason`
        says how long; otherwise it is empty. After the first row, the progress is complete, or it is the progress
        towards a row that is overdue.
        """
        if self._accumulator is None:
            return None
        ahead = self._detector.timed(joined([NO_IMPACTS, *self._impacts_ahead]))["scan"]  # in no finished window yet
        struck = float(ahead[-1]) if len(ahead) else self._struck
        progress, quiet = self._judge.progress, self._quiet(self._measured - 1, struck)
        noticed_s = max(NOTICED_S, NOTICED_CYCLES / self._judge.frequency_hz)
        if self._state.word != AnalysisWord.SETTLING or quiet.since_s < noticed_s:
            return progress
        return attrs.evolve(progress, quiet=quiet)

    @property
    def state(self) -> TrackerState:
        """Present state of the measurement.

        It has a `word` (settling, measuring, …), a `reason`, and the rig time of its start, `since_ns` [ns].
        """
        return self._state

    def flush(self, *, take_unsettled: bool = False) -> Findings:
        """Measure the scans that are still delayed, and return the last results; call this at the end of a record.

        A row that is delayed because a sphere may still strike is returned as well.

        Args:
            take_unsettled: whether a record that ends before its first row gives one row of its cycles. The status of
                this row is `not_settled` or, without numbers, the reason.

        Returns:
            The last results. They contain impacts only of blocks that still waited for the calibration.
        """
        early = self._feed_each(self._take_early(self._start_ns if self.is_calibrated else math.inf))
        if self._started:
            self._advance(self._buffer.end)
            held = self._judge.finish() if self._accumulator is not None else None
            if held:
                self._emit(held, self._judged)
            if take_unsettled and not self.counters.measurements and not self.counters.refusals:
                self._take_unsettled()
        measurements, self._rows = (*early.measurements, *self._rows), []
        return Findings(measurements, early.impacts)

    def _take_early(self, first_ns: float, end_ns: float = math.inf) -> list[Table]:
        """Return the blocks kept for the first calibration that begin from `first_ns` to before `end_ns` [ns].

        At most the newest `MOST_EARLY` of these blocks are returned. All other kept blocks are dropped, and their scans
        are counted as `unconfigured_scans`.
        """
        early, self._early = self._early, []
        kept = [one for one in early if first_ns <= one.stamp_ns < end_ns][-MOST_EARLY:]
        self.counters.unconfigured_scans += sum(len(one.rows) for one in early) - sum(len(one.rows) for one in kept)
        return kept

    def _feed_each(self, scans: Iterable[Table]) -> Findings:
        found = [self.feed(scan) for scan in scans]
        return Findings(
            tuple(table for one in found for table in one.measurements),
            tuple(table for one in found for table in one.impacts),
        )

    def _take_unsettled(self) -> None:
        """Add a `not_settled` row of the kept cycles (`Judge.unsettled`), or a row with only the reason."""
        accumulator = self._accumulator
        if accumulator is None:
            self._emit_status(Status.NO_FREQUENCY, self._buffer.end - 1)
            return
        self._add(accumulator)
        count = accumulator.pending_cycles
        rest = self._counted(accumulator.take(count), accumulator) if count else None
        found = self._judge.unsettled(rest)
        if found:
            self._emit(found, self._buffer.end - 1)

    def _feed_broken(self, scan: Table, numbers: NDArray[np.float64]) -> Findings:
        """Split a block that lacks scans at its beginning or inside it into blocks without gaps, and process these.

        `numbers` are the indices of the scans relative to the stamp of the block. If they are not increasing or too
        large (wrong rate or invalid times), all scans count as lost.
        """
        rate = self._rate
        if not ((np.abs(numbers) <= LONGEST_S * rate).all() and (np.diff(numbers) > 0).all()):
            self.counters.lost_scans += len(numbers)
            return NOTHING
        cuts = np.flatnonzero(np.diff(numbers) != 1) + 1
        base = scan_index(scan.stamp_ns, rate, self._start_ns)
        runs = []
        for part, number in zip(np.split(scan.rows, cuts), np.split(numbers, cuts), strict=True):
            whole = part.copy()
            whole["time"] = np.arange(len(part)) / rate
            runs.append(Table(stamp_ns(base + int(number[0]), rate, self._start_ns), whole))
        return self._feed_each(runs)

    def _schedule(self, time_ns: int, event: _Event) -> None:
        """Queue an event until the scans reach its time; simultaneous events are ordered by their kind."""
        self._event_count += 1
        entry = time_ns, _KINDS.index(type(event)), self._event_count, event
        bisect.insort(self._events, entry, key=lambda entry: entry[:3])

    def _use(self, reset: _Reset) -> None:
        self._start_ns, self._calibration = reset.start_ns, reset.calibration
        self._rate = reset.calibration.rate_hz
        self._detector = ImpactDetector(reset.calibration, self._impact_settings)
        wanted = math.ceil(self._settings.hold_s * reset.calibration.rate_hz)
        self._hold = max(MIN_HOLD_SCANS, self._detector.behind, wanted)
        for time_ns, _, _, event in self._events:
            if isinstance(event, Calibration):
                self._prepare_detector(time_ns, event)

    def _prepare_detector(self, time_ns: int, calibration: Calibration) -> None:
        """Pass a calibration to the impact detector at once, with the first scan to which it applies.

        The detector processes scans as they arrive, so it needs the calibration before the delayed measurement does.
        """
        self._detector.recalibrate(first_scan_at(time_ns, calibration.rate_hz, self._start_ns), calibration)
        self._hold = max(self._hold, self._detector.behind)

    def _begin_again(self, reset: _Reset) -> None:
        """Apply a reset of the rig: measure the delayed scans before the reset, and begin a new record."""
        buffer, end = self._buffer, self._buffer.end
        cut = scan_index(reset.start_ns, self._rate, self._start_ns)
        if cut > end or not self._started:
            cut = end
        first = max(cut, self._measured)  # first of the scans after the reset that are not measured yet
        if self._started:
            if first > cut:
                self.counters.late_events += 1
            self._advance(first)
            self._interrupt(Status.RESTARTED)
            self.counters.restarts += 1
        self._use(reset)
        buffer.renumber(cut)
        self._last_block -= cut
        first -= cut
        self._measured = first
        self._struck, self._placed = math.nan, first
        self._detector.restart(first)
        self._impacts_ahead.clear()
        found = self._detector.find(buffer.samples[0, buffer.column(first) : buffer.column(buffer.end)])
        if len(found):
            self._impacts_ahead.append(found)  # reported already
        self._begin(first)

    def _resume(self, index: int) -> None:
        """Start to measure at scan `index`, which does not directly follow the last scan.

        The scan is the first scan of all, or blocks before it were lost, or the stamps went back. In the last two
        cases, a row states the reason, even without a drive.
        """
        back = self._started and index < self._buffer.end
        lost = self._started and not back
        if self._started:
            self._advance(self._buffer.end)
            if back:
                self.counters.restarts += 1
            else:
                self.counters.lost_scans += index - self._buffer.end
            self._refuse(Status.RESTARTED if back else Status.LOST_BLOCKS)
        if back or not self._started:
            self._struck, self._placed = math.nan, index
        self._started = True
        self._buffer.restart(index)
        self._measured = index
        self._detector.restart(index)
        self._impacts_ahead.clear()
        self._begin(index)
        if lost:
            self._enter(AnalysisWord.LOST_SCANS, Status.LOST_BLOCKS, index)

    def _advance(self, until: int) -> None:
        """Measure the scans before the index `until`, and apply each queued event at its scan."""
        rate = self._rate
        while self._events:
            at = first_scan_at(self._events[0][0], rate, self._start_ns)
            if at > until:
                break
            if at < self._measured and self._measured > self._changed:
                self.counters.late_events += 1
            at = max(at, self._measured)
            self._measure(at)
            self._apply(self._events.pop(0)[3], at)
        self._measure(until)

    def _apply(self, event: _Event, index: int) -> None:
        match event:
            case _Command():
                if event == self._command:
                    return
                self._interrupt(Status.COMMAND_CHANGED)
                if self._command is None or self._command.current == 0.0:
                    self._placed = index  # silence at rest proves nothing: slow impacts are not detected
                self._command = event
            case GapLabel(gap_m):
                if gap_m == self._gap_m or (math.isnan(gap_m) and math.isnan(self._gap_m)):
                    return
                self._interrupt(Status.LABEL_CHANGED)
                self._gap_m = gap_m
                self._take_impacts(index)  # of the interrupted window, which had another gap
                self._struck, self._placed = math.nan, index
            case Calibration():
                self._interrupt(Status.CALIBRATION_CHANGED)
                self._calibration, self._rate = event, event.rate_hz
        self._begin(index)

    def _enter(self, word: AnalysisWord, reason: str, scan: int) -> None:
        """Set the state from a scan on.

        If the state is set again, it keeps its start. Only `settling` without a reason starts again.
        """
        if (word, reason) != (self._state.word, self._state.reason) or (word, reason) == (AnalysisWord.SETTLING, ""):
            self._state = TrackerState(word, reason, stamp_ns(scan, self._rate, self._start_ns))

    def _begin(self, index: int) -> None:
        """Start new cycles and windows at scan `index`, with the present drive, calibration and settings.

        Index 0 is the scan at `_start_ns`. The column `waited` of the rows counts from the scan `index`.
        """
        assert self._calibration is not None
        rate, frequency = self._calibration.rate_hz, self._command.frequency_hz if self._command else 0.0
        self._changed = self._origin = self._added = self._due = index
        at_rest = self._command is None or self._command.current == 0.0
        self._enter(AnalysisWord.AT_REST if at_rest else AnalysisWord.SETTLING, "", index)
        harmonics = usable_harmonics(rate, frequency, self._settings.harmonics)
        if not harmonics:
            self._accumulator = None
            return
        self._window = window_cycles(frequency, self._settings)
        low, high = self._calibration.low, self._calibration.high
        self._accumulator = Accumulator(rate, frequency, harmonics, index, low, high)
        self._judge = Judge(self._calibration, frequency, self._settings)

    def _measure(self, until: int) -> None:
        """Add the scans before `until` to their cycles, and evaluate every window that they complete."""
        begin = self._measured
        if until <= begin:
            return
        self._measured = until
        accumulator = self._accumulator
        if accumulator is None:
            self._added = until
            self._report_no_frequency(until)
            return
        if until < self._due:
            return
        self._add(accumulator)
        while accumulator.pending_cycles >= self._window:
            window = self._counted(accumulator.take(self._window), accumulator)
            last = int(window.first[-1] + window.samples[-1]) - 1
            self._judged = last
            found = self._judge.add(window, self._quiet(last, self._struck))
            if found:
                self._emit(found, last)
            elif self._judge.late and self._state.word == AnalysisWord.MEASURING:
                self._enter(AnalysisWord.SETTLING, "", last)

    def _add(self, accumulator: Accumulator) -> None:
        """Add the scans before `_measured` to their cycles, and set `_due`, the scan at which to do this again.

        That is the end of the present window, but at most `ADD_S` after `_measured`.
        """
        buffer = self._buffer
        accumulator.add(buffer.samples, buffer.status, buffer.column(self._added), buffer.column(self._measured))
        self._added = self._measured
        soon = self._added + math.ceil(ADD_S * self._rate)
        self._due = min(soon, accumulator.end(self._window))

    def _quiet(self, scan: int, struck: float) -> ImpactPause:
        """Return the wait for a sphere at a scan: the time without impacts so far, and how long it may delay a row.

        `struck` is the scan of the last impact, NaN for none. The time counts from the last impact, the start of the
        drive or that of the label, whichever is latest. The longest wait is the time to cross the labelled gap at
        `slowest_speed`, at most `wait_limit_s`. Without a label, it is `wait_limit_s` after a first impact, and 0
        before. There is no wait if the gap is 0 or impacts cannot be counted.
        """
        assert self._calibration is not None
        never, unknown = math.isnan(struck), math.isnan(self._gap_m)
        if self._gap_m == 0.0 or (never and unknown) or not counts_impacts(self._calibration):
            return ImpactPause()
        since = (scan + 1 - (self._placed if never else max(self._placed, struck))) / self._calibration.rate_hz
        limit_s = self._settings.wait_limit_s
        return ImpactPause(since, limit_s if unknown else min(limit_s, self._gap_m / self._settings.slowest_speed))

    def _report_no_frequency(self, until: int) -> None:
        second = math.ceil(self._rate)  # scans
        while until - self._origin >= second:
            self._origin += second
            self._take_impacts(self._origin)
            self._emit_status(Status.NO_FREQUENCY, self._origin - 1)
        self._take_impacts(until)

    def _take_impacts(self, before: int) -> NDArray[np.void]:
        """Remove and return the detected impacts before scan `before` from those not yet used by the measurement.

        Impacts are detected at once, but the measurement is delayed.
        """
        onsets = joined([NO_IMPACTS, *self._impacts_ahead])
        impacts = self._detector.timed(onsets)
        later = int(np.searchsorted(impacts["scan"], before))
        self._impacts_ahead = [onsets[later:]] if later < len(onsets) else []
        if later:
            self._struck = float(impacts["scan"][later - 1])
        return impacts[:later]

    def _counted(self, window: Cycles, accumulator: Accumulator) -> Cycles:
        """Return a window of cycles with its impacts filled in, or unchanged if impacts cannot be counted."""
        assert self._calibration is not None
        if not counts_impacts(self._calibration):
            return window
        impacts = self._take_impacts(int(window.first[-1] + window.samples[-1]))
        return counted(window, impacts, accumulator.origin, accumulator.period)

    def _impacts(self, found: NDArray[np.void]) -> list[Table]:
        self.counters.impacts += len(found)
        self._impacts_ahead.append(found)
        return impact_tables(self._detector.timed(found), self._rate, self._start_ns)

    def _interrupt(self, status: Status) -> None:
        """Discard the measurement in progress, if there is one, and add a row with only `status`."""
        if self._accumulator is not None:
            self._add(self._accumulator)
            if self._accumulator.pending_cycles or self._judge.pending:
                self._refuse(status)

    def _refuse(self, status: Status) -> None:
        self._take_impacts(self._measured)
        self._emit_status(status, self._measured - 1)

    def _emit_status(self, status: Status, last_scan: int) -> None:
        """Add a row that has only a status and the present drive frequency, NaN without a command."""
        frequency = self._command.frequency_hz if self._command else math.nan
        self._emit(Measurement(status=status, frequency_hz=frequency), last_scan)

    def _emit(self, found: Measurement, last_scan: int) -> None:
        if found.status in MEASURED:
            self.counters.measurements += 1
        else:
            self.counters.refusals += 1
        if self._state.word != AnalysisWord.AT_REST:
            if found.status in SETTLED:
                self._enter(AnalysisWord.MEASURING, "", last_scan)
            else:
                waiting = found.status is Status.NOT_SETTLED
                self._enter(AnalysisWord.SETTLING if waiting else AnalysisWord.UNABLE, found.status, last_scan)
        waited, age = (last_scan + 1 - self._changed) / self._rate, (last_scan + 1 - self._struck) / self._rate
        stamp = stamp_ns(last_scan, self._rate, self._start_ns)
        self._rows.append(measurement_table(attrs.evolve(found, impact_age_s=age), stamp, self._gap_m, waited))
