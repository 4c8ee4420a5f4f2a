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
"""State of one rig, live or recorded, derived from its messages (`RigView`), in the forms that the page needs.

Scans and motion are kept in ring buffers for pictures, journal and faults as lines of text, and measurements as rows.
An invalid message is counted under its topic and has no other effect. Times for the page are seconds since scan 0 of
the rig; earlier times are negative. Names that end in _ns are stamps in rig time.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, TypeVar  # Any: values for JSON

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import codec, topics
from impact_rig.analysis.transmissibility import note_on
from impact_rig.blocks import Table
from impact_rig.errors import CodecError, ImpactRigError, RecordingError
from impact_rig.instruments.instrument import FAULT_KINDS
from impact_rig.instruments.registry import INSTRUMENTS
from impact_rig.rig.config import parameters_in
from impact_rig.rig.journal import PLANNED, InputKind, JournalEntry, JournalView, decode
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S
from impact_rig.states import MEASURED, Status
from impact_rig_lab.scope import Scope

BODIES = 3  # number of bodies in a joint state: inferior base, superior base, sphere
MOST_ROWS = 400  # largest number of measurements kept of a live rig
MOST_ENTRIES = 300  # largest number of journal lines and of fault events kept of a live rig
MOST_APPLIED = 100  # largest number of changes of rig and of drive kept of a live rig
T = TypeVar("T")
ABOUT = {
    Status.ACCELEROMETER_OVER_RANGE.value: "accelerometer",
    Status.ACCELEROMETER_UNSOUND.value: "accelerometer",
    Status.CURRENT_UNSOUND.value: "current",
}
"""Channel that a status of the analysis concerns, for rows that have a measured value all the same.

In these rows the column `channel` has another meaning: the channel that contributes most to the uncertainty.
"""
NO_CHANGE = (InputKind.FAULT, InputKind.CLEAR_FAULT, InputKind.STREAM)
"""Kinds of journal entries after which a measurement continues, because they are no change of rig or drive.

Faults are counted from `truth/faults` instead.
"""
LAST_NS = 2**63  # stamp later than all others
SAME_M = 1e-9  # gaps that differ by less than this count as equal [m]
HIGHEST_RATE_HZ = 1e7  # highest scan rate that is accepted
LONGEST_RUN_S = 1e9  # longest rig time that is accepted
STREAM = ("buffered", "capacity", "playing", "late", "refused", "missing", "rate")  # columns of `shaker/stream` kept
UNITS = {"frequency": "Hz", "current": "A", "over_travel": "m", "over_current": "A"}
"""Units of the values of journal entries, by name of the entry."""
SHOWN_UNITS = {"m": ("mm", 1e-3), "-": ("", 1.0)}
"""Units of the rig that the page shows as another unit: the unit of the page, and its size in the unit of the rig."""


def text(raw: Any) -> str:
    """Decode a value of a text column of a table, which is padded with zero bytes."""
    return bytes(raw).rstrip(b"\0").decode("utf-8", errors="replace")


def fault_unit(kind: str, channel: str) -> str:
    """Return the unit of the size of an instrument fault; empty if this kind of fault has no size or no unit.

    Args:
        kind: kind of fault, a key of `FAULT_KINDS`.
        channel: channel that it affects.
    """
    if kind == "clock_drift":
        return "ppm"
    has_unit = "[unit" in FAULT_KINDS.get(kind, "") and channel in INSTRUMENTS
    return INSTRUMENTS[channel].unit if has_unit else ""


def amount(value: float, unit: str) -> str:
    """Return a value of the rig with its unit as text for the page; lengths are in mm, NaN is "nan".

    Args:
        value: the value in `unit`.
        unit: unit of the rig.
    """
    shown, size = SHOWN_UNITS.get(unit, (unit, 1.0))
    return f"{value / size:.6g} {shown}".strip()


def plain(word: str) -> str:
    """Return a key of the rig, such as "no_impacts", as text for the page: underscores become spaces."""
    return word.replace("_", " ")


class Rows:
    """Ring buffer of rows of numbers, from which several readers can each get the rows that are new to them.

    The first number of a row is the time [s since scan 0].

    Args:
        size: number of rows kept.
        columns: number of numbers in a row.
    """

    def __init__(self, size: int, columns: int) -> None:
        self._rows = np.zeros((size, columns))
        self.count = 0  # number of rows ever added

    def add(self, row: tuple[float, ...]) -> None:
        """Append a row; if the buffer is full, the oldest row is lost."""
        self._rows[self.count % len(self._rows)] = row
        self.count += 1

    def since(self, number: int, most: int = 2000) -> NDArray[np.float64]:
        """Return the rows added after the first `number` rows, shape (n, columns).

        At most `most` rows that are still kept are returned: the newest ones. `count` is the number of all rows ever
        added.
        """
        first = max(number, self.count - min(len(self._rows), most), 0)
        return self._rows[np.arange(first, self.count) % len(self._rows)]


class MotionBuffer:
    """Ring buffers of the newest motion in SI units, with 4096 rows each: true states, true and detected impacts.

    Attributes:
        states: rows of time, three positions x_b, x_1, x_2 and their velocities v_b, v_1, v_2. The indices b, 1 and 2
            denote inferior base, superior base and sphere.
        impacts: rows of time, wall (−1 left, +1 right), approach speed, separation speed, peak force of the true
            impacts.
        detected: rows of time, peak [m/s²], sign (+1 if the right wall is struck, else −1) of the impacts detected by
            the accelerometer.
    """

    def __init__(self) -> None:
        self.states = Rows(4096, 7)
        self.impacts = Rows(4096, 5)
        self.detected = Rows(4096, 3)

    def add_state(self, data: bytes, start_ns: int) -> None:
        """Add a true state of the rig from a message of `truth/joint_states`.

        Args:
            data: the serialised message.
            start_ns: stamp of scan 0.

        Raises:
            CodecError: the message is invalid, or has another number of bodies.
        """
        stamp, (positions, velocities, _efforts) = codec.joint_state(data)
        if not len(positions) == len(velocities) == BODIES:
            raise CodecError(
                f"a joint state of this rig must have {BODIES} positions and velocities, got {len(positions)} and "
                f"{len(velocities)}"
            )
        self.states.add(((stamp - start_ns) / NS_PER_S, *positions, *velocities))

    def add_rows(self, table: Table, start_ns: int) -> None:
        """Add true impacts from a table of `truth/impacts`, or detected impacts from a table of `impacts`.

        Args:
            table: the table; its columns decide which kind of impacts it has.
            start_ns: stamp of scan 0.
        """
        true = ("wall", "approach_speed", "separation_speed", "peak_force")
        is_true = "wall" in (table.rows.dtype.names or ())
        ring, names = (self.impacts, true) if is_true else (self.detected, ("peak", "sign"))
        begin = (table.stamp_ns - start_ns) / NS_PER_S
        for row in table.rows:
            ring.add((begin + row["time"], *(row[name] for name in names)))


class RigHistory:
    """History of a rig: journal, faults and remarks as lines of text for the page, and its state at past times.

    Args:
        most: number of newest journal entries kept; None means all entries and all lines. Past states are derived from
            the kept entries only. With a number, the newest `MOST_ENTRIES` lines are kept.
    """

    def __init__(self, most: int | None = MOST_APPLIED) -> None:
        self._view = JournalView()
        self._changes: deque[JournalEntry] = deque(maxlen=most)
        self._lines: deque[list[Any]] = deque(maxlen=None if most is None else MOST_ENTRIES)
        self._part: tuple[int, list[list[Any]]] | None = None

    def add(self, entry: JournalEntry) -> None:
        """Add an entry of `rig/journal`: as a change of the state, and as a line for the page.

        An entry that sets several parameters gives a line for each parameter.
        """
        self._view.follow(entry)
        self._changes.append(entry)
        if entry.kind is InputKind.PARAMETER:
            for name, value in entry.values.items():
                words = " ".join(value) if isinstance(value, tuple) else value
                self._add(entry.stamp_ns, "parameter", name, words if isinstance(words, str) else f"{words:.6g}")
        elif entry.fault is not None:
            self._add(
                entry.stamp_ns, "fault", f"{entry.fault.kind} {entry.fault.channel}".strip(), f"{entry.fault.value:g}"
            )
        else:
            self._add(entry.stamp_ns, entry.kind.value, entry.name, entry.text or _value(entry))

    @property
    def configuration(self) -> Mapping[str, Any]:
        """Return the parameters of the rig after the newest entry, by name; defaults if no entry has set them."""
        return self._view.configuration

    def remark(self, words: str, stamp_ns: int) -> None:
        """Add a remark of an operator as a line; longer remarks are cut to 200 characters.

        Args:
            words: the remark.
            stamp_ns: rig time of the remark.
        """
        self._add(stamp_ns, "note", "", words[:200])

    def fault(self, table: Table) -> None:
        """Add the beginnings and ends of instrument faults in a table of `truth/faults` as lines."""
        for row in table.rows:
            what = f"{text(row['kind'])} {text(row['channel'])}".strip()
            at_ns = table.stamp_ns + round(float(row["time"]) * NS_PER_S)
            self._add(at_ns, "fault", "begins" if row["active"] else "ends", what)

    def _add(self, *line: Any) -> None:
        self._part = None
        self._lines.append([*line])

    def part(self, start_ns: int) -> list[list[Any]]:
        """Return all lines for the page, ordered by time, each as [time in s since scan 0, kind, key, text].

        An example is [12.5, "parameter", name, value]. The beginning or end of a fault is [time, "fault",
        "begins" or "ends", which fault]. The command that requests a fault is [time, "fault", which fault, size]. A
        remark is [time, "note", "", remark]. If nothing is new, the result is the same object as before.

        Args:
            start_ns: stamp of scan 0.
        """
        if self._part is None or self._part[0] != start_ns:
            found = sorted(self._lines, key=lambda line: line[0])
            self._part = start_ns, [[round((stamp - start_ns) / NS_PER_S, 3), *words] for stamp, *words in found]
        return self._part[1]

    def at(self, instant_ns: int) -> tuple[JournalView, JournalEntry | None]:
        """Return the state of the rig at a rig time, and the last entry before it that makes a measurement restart.

        Entries about faults, and about the samples of a stream, do not make a measurement restart. The entry is None if
        there is no such entry. Only the kept entries count. Before the first of them, the parameters have their default
        values.
        """
        view, newest = JournalView(), None
        for change in list(self._changes):
            if change.stamp_ns <= instant_ns:
                view.follow(change)
                if change.kind not in NO_CHANGE and set(change.values) != {PLANNED}:
                    newest = change
        return view, newest


def _value(entry: JournalEntry) -> str:
    if entry.value is None:
        return "all" if entry.kind is InputKind.CLEAR_FAULT else ""
    return amount(entry.value, "m" if entry.kind is InputKind.PLUCK else UNITS.get(entry.name, ""))


class Faults:
    """History of the simulated instrument faults; it finds the faults that are active at any time.

    Args:
        most: number of beginnings and ends kept; None means all.
    """

    def __init__(self, most: int | None = MOST_ENTRIES) -> None:
        self._rows: deque[tuple[int, int, bool, str]] = deque(maxlen=most)

    def add(self, table: Table) -> None:
        """Add the beginnings and ends of instrument faults in a table of `truth/faults` to this history."""
        for row in table.rows:
            kind, channel = text(row["kind"]), text(row["channel"])
            stamp = table.stamp_ns + round(float(row["time"]) * NS_PER_S)
            what = f"{plain(kind)} {channel}".strip()
            if "`value`" in FAULT_KINDS.get(kind, ""):
                what += f" ({amount(float(row['value']), fault_unit(kind, channel))})"
            self._rows.append((stamp, int(row["id"]), bool(row["active"]), what))

    def in_force(self, start_ns: int, at_ns: int | None = None) -> list[str]:
        """Return the faults that are active at a rig time, each as text such as "gain error laser (0.02)".

        Args:
            start_ns: stamp of scan 0; faults that began earlier belong to another rig.
            at_ns: the rig time; None means now, after all messages received so far.
        """
        now_ns = LAST_NS if at_ns is None else at_ns
        return self.acting(start_ns, now_ns, now_ns)

    def acting(self, start_ns: int, begin_ns: int, end_ns: int) -> list[str]:
        """Return the faults that were active after `begin_ns` and up to `end_ns`, as texts like `in_force`.

        Args:
            start_ns: stamp of scan 0; faults that began earlier belong to another rig.
            begin_ns: rig time [ns]; a fault that ended then or earlier is left out.
            end_ns: rig time [ns]; a fault that begins later is left out.
        """
        found: dict[int, str] = {}
        for stamp, number, begins, words in self._rows:
            if begins and start_ns <= stamp <= end_ns:
                found[number] = words
            elif not begins and stamp <= begin_ns:
                found.pop(number, None)
        return list(found.values())


@attrs.frozen
class Judged:
    """Summary of a row of `transmissibility/table`: its measured scans, its status and its gap label."""

    begin_ns: int  # rig time of the first scan measured; scans while the response settled are not included
    end_ns: int  # rig time of the last scan measured
    status: str  # status of the measurement
    channel: str  # channel that the status concerns; empty if none
    gap_m: float  # gap according to the operator's label of the analysis; NaN without a label


class Curve:
    """Measurements of the transmissibility by the analysis, as rows for the page's curve and table.

    Args:
        most: number of rows kept; None means all.
    """

    def __init__(self, most: int | None = MOST_ROWS) -> None:
        self._rows: deque[tuple[int, dict[str, Any]]] = deque(maxlen=most)
        self.judged: deque[Judged] = deque(maxlen=most)
        """Statuses of all rows in order, including rows without a measured value."""
        self._part: tuple[int, list[dict[str, Any]]] | None = None

    def add(self, table: Table) -> None:
        """Add the rows of a `transmissibility/table`: all to `judged`, rows with a measured value also to `part`."""
        for row in table.rows:
            status = text(row["status"])
            channel = text(row["channel"]) if "channel" in row.dtype.names else ""
            sound = status in (Status.OK, Status.NO_IMPACTS, Status.NOT_SETTLED)
            cycles, frequency_hz = float(row["cycles"]), float(row["frequency"])
            length_s = cycles / frequency_hz if frequency_hz > 0.0 else 0.0
            begin_ns = table.stamp_ns - round(min(length_s, LONGEST_RUN_S) * NS_PER_S)
            about = "" if sound else ABOUT.get(status, channel)
            self.judged.append(Judged(begin_ns, table.stamp_ns, status, about, float(row["gap"])))
            if status in MEASURED:
                self._rows.append((table.stamp_ns, _measurement(row)))
                self._part = None

    def newest(self, at_ns: int | None = None) -> Judged | None:
        """Return the summary of the newest row of the analysis; None if there is no row.

        Args:
            at_ns: rig time up to which the scans of the row must have ended [ns]; None means now.
        """
        rows = [row for row in list(self.judged) if at_ns is None or row.end_ns <= at_ns]
        return rows[-1] if rows else None

    def health(self, at_ns: int | None = None) -> dict[str, str] | None:
        """Return the problem of a sensor's channel that the newest row of the analysis states, as text by channel.

        The result is empty if the row states no problem. It is None if there is no row, or if the row says nothing
        about the channels.

        Args:
            at_ns: rig time; None means now.
        """
        row = self.newest(at_ns)
        if row is None or not (row.channel or row.status in MEASURED):
            return None
        return {row.channel: plain(row.status)} if row.channel else {}

    def part(self, start_ns: int) -> list[dict[str, Any]]:
        """Return the rows with a measured value for the page, oldest first, with short keys such as "f" and "dt".

        "t" is the time in s since scan 0, the phase is in degrees, and all other values are in SI units. If nothing is
        new, the result is the same object as before.

        Args:
            start_ns: stamp of scan 0.
        """
        if self._part is None or self._part[0] != start_ns:
            found = [{"t": round((stamp - start_ns) / NS_PER_S, 3), **row} for stamp, row in self._rows]
            self._part = start_ns, found
        return self._part[1]


def _measurement(row: NDArray[np.void]) -> dict[str, Any]:
    return {
        "f": float(row["frequency"]), "dt": float(row["transmissibility"]),
        "u": float(row["transmissibility_uncertainty"]), "phase": math.degrees(float(row["phase"])),
        "settled": bool(row["settled"] == 1.0), "gap": float(row["gap"]), "ipc": float(row["impacts_per_cycle"]),
        "x1": float(row["laser_amplitude"]), "xb": float(row["base_amplitude"]), "i": float(row["current_amplitude"]),
        "spread": float(row["spread"]), "period": float(row["period"]), "thd": float(row["thd"]),
        "note": note_on(row), "regime": text(row["regime"]),
        "status": "" if text(row["status"]) == Status.OK else plain(text(row["status"])),
    }  # fmt: skip


class RigView:
    """State of one rig as its messages show it; each message, from ROS or from a file, is passed to `take`.

    Args:
        most: number of changes of rig and drive that are kept. None means that all changes, measurements and faults are
            kept, so that the state at any past time can be shown.
    """

    def __init__(self, most: int | None = MOST_APPLIED) -> None:
        self.scope: Scope | None = None
        """Newest scans; None until the calibration (`daq/info`) has stated the scan rate."""
        self.motion = MotionBuffer()
        self.journal = RigHistory(most)
        self.faults = Faults(None if most is None else MOST_ENTRIES)
        self.curve = Curve(None if most is None else MOST_ROWS)
        self.epoch = 0  # number of times that pictures began again; data with an earlier number are outdated
        self.start_ns = self.newest_ns = 0  # stamps of scan 0 and of the newest block of scans
        self.told_start_ns = 0
        """Stamp of scan 0 according to the rig's diagnostics.

        If it is later than `start_ns`, the `daq/info` of a new rig has not arrived, and all known data belong to the
        previous rig.
        """
        self.configuration = ""  # active configuration, as a ROS 2 parameter file
        self.knobs: dict[str, Any] = {}  # parameters of the active configuration, by name
        self.applied: deque[tuple[int, dict[str, float]]] = deque(maxlen=most)
        """Newest changes of the drive: rig time [ns], and frequency and current as in `drive`."""
        self.changes = 0  # number of changes of the drive received so far
        self.changed_at_s = 0.0  # time at which the newest change was received (`time.monotonic`)
        self.begun_at_s = 0.0
        """Time (`time.monotonic`) before which received changes of the drive belong to another rig.

        Stamps cannot decide this: a rig that runs faster than real time has later stamps than its successor.
        """
        self.refused: dict[str, list[Any]] = {}  # invalid messages, by topic: their number, and the last reason
        self.stream: dict[str, float] | None = None
        """Newest values of `shaker/stream` by column; None if the drive is not a stream."""
        self.lock = threading.Lock()  # to be held while ring buffers are written or read

    def since_ns(self, at_ns: int | None = None) -> int:
        """Return the stamp of scan 0 of the present rig, or of the rig that ran at a past rig time.

        Data with earlier stamps belong to another rig. Data with later stamps may also belong to another rig, for
        example to a previous rig that ran faster than real time.
        """
        if at_ns is None:
            return max(self.start_ns, self.told_start_ns)
        return max(self.start_ns, self.journal.at(at_ns)[0].start_ns or 0)

    def doubts(self, at_ns: int | None = None) -> list[str]:
        """Return reasons why the newest measurement may not describe the present rig, as text; empty if there are none.

        Reasons are faults active now or during the measurement, problems of channels, a change since the measurement
        began, and a wrong gap in the label of the analysis. Without a measurement, only active faults are reasons.

        Args:
            at_ns: rig time for which to judge; None means now.
        """
        since_ns, row = self.since_ns(at_ns), self.curve.newest(at_ns)
        faults = self.faults.in_force(since_ns, at_ns)
        found = [f"{fault} is active (truth)" for fault in faults]
        found += [f"{channel}: {word}" for channel, word in (self.curve.health(at_ns) or {}).items()]
        if row is None:
            return found
        over = [fault for fault in self.faults.acting(since_ns, row.begin_ns, row.end_ns) if fault not in faults]
        found += [f"{fault} was active during the measurement (truth)" for fault in over]
        view, change = self.journal.at(LAST_NS if at_ns is None else at_ns)
        if change is not None and not came_before(change.stamp_ns, row):
            found.append(f"the rig was changed after the measurement began ({plain(change.name or change.kind.value)})")
        configuration = self.journal.configuration if at_ns is None else view.configuration
        gap_m: Any = configuration["barriers.gap_m"] if configuration["sphere.present"] else 0.0
        if abs(row.gap_m - gap_m) > SAME_M:  # not without a label
            found.append(f"its label states a gap of {row.gap_m * 1e3:g} mm, the rig has {gap_m * 1e3:g} mm")
        return found

    def health(self, at_ns: int | None = None) -> dict[str, str] | None:
        """Return the problems of the sensors' channels as `Curve.health` does, if they apply to the present drive.

        Otherwise the result is None. This is the case until the analysis has published a row after a change of the
        drive. It is also the case without a drive current, because nothing is measured then.

        Args:
            at_ns: rig time; None means now.
        """
        change, row = self._change(at_ns), self.curve.newest(at_ns)
        if change is None or change[1]["current"] == 0.0 or row is None or row.end_ns <= change[0]:
            return None
        return self.curve.health(at_ns)

    def take(self, topic: topics.Topic, data: bytes, at_ns: int | None = None) -> None:
        """Process a message of the rig; an invalid message is only counted in `refused`.

        Args:
            topic: topic of the message.
            data: the serialised message.
            at_ns: rig time at which a remark was received; None means the time of the newest scans. It is ignored for
                other topics, whose messages have stamps.
        """
        guard(self.refused, topic.name, lambda: self._take(topic, data, at_ns))

    def _take(self, topic: topics.Topic, data: bytes, at_ns: int | None) -> None:
        if topic is topics.JOINT_STATES:
            self.motion.add_state(data, self.start_ns)
        elif topic is topics.NOTES:
            self.journal.remark(codec.text(data), self.newest_ns if at_ns is None else at_ns)
        elif topic is topics.JOURNAL:
            self.journal.add(decode(data))
        elif topic is topics.CONFIGURATION:
            content = codec.text(data)
            self.knobs, self.configuration = parameters_in(content), content
        else:
            self._take_table(topic, codec.decode(data, topic))

    def _take_table(self, topic: topics.Topic, table: Table) -> None:
        if topic is topics.SCAN:
            if self.scope is not None and len(table.rows):
                self.scope.add(table, self.start_ns)
                self.newest_ns = max(self.newest_ns, table.stamp_ns)
        elif topic is topics.STREAM:
            self.stream = {name: float(table.rows[name][0]) for name in STREAM}
        elif topic is topics.WAVEFORM:
            is_current = self.journal.configuration.get("drive.kind") == "current"
            if self.scope is not None and self.stream is not None and is_current:
                self.scope.command(table, self.stream["rate"], self.start_ns)
        elif topic in (topics.IMPACTS, topics.IMPACTS_TRUTH):
            self.motion.add_rows(table, self.start_ns)
        elif topic is topics.INFO:
            self._begin(table)
        elif topic is topics.APPLIED:
            for row in table.rows:
                stamp = table.stamp_ns + round(float(row["time"]) * NS_PER_S)
                self.applied.append((stamp, {name: float(row[name]) for name in ("frequency", "current")}))
                self.changes, self.changed_at_s = self.changes + 1, time.monotonic()
        elif topic is topics.FAULTS:
            self.faults.add(table)
            self.journal.fault(table)
        elif topic is topics.TRANSMISSIBILITY_TABLE:
            self.curve.add(table)

    def _begin(self, info: Table) -> None:
        rate_hz, begin_ns = scan_rate(info), start_ns(info)
        if self.scope is None or (begin_ns, rate_hz) != (self.start_ns, self.scope.rate_hz):
            with self.lock:
                self.start_ns, self.scope, self.stream = begin_ns, Scope(rate_hz), None
                self.forget_motion()

    def forget_motion(self) -> None:
        """Forget the motion kept so far and begin a new epoch, so that pages drop what they have drawn."""
        self.motion = MotionBuffer()
        self.epoch += 1

    def stream_part(self) -> dict[str, float] | None:
        """Return the state of the stream that drives the rig for the page; None if the drive is not a stream.

        `buffered` and `capacity` of the buffer, and the `missing` and `late` samples, are in seconds of the stream.
        `refused` is the number of rejected blocks of samples.
        """
        if self.stream is None:
            return None
        found = {name: self.stream[name] / self.stream["rate"] for name in ("buffered", "capacity", "missing", "late")}
        return {**{name: round(value, 3) for name, value in found.items()}, "refused": self.stream["refused"]}

    @property
    def drive(self) -> dict[str, float] | None:
        """Active drive of the present rig, with the keys `frequency` and `current`; None if it is not published yet.

        `frequency` is in Hz. `current` is the peak amplitude (rms for a random drive) in A, or in m or V by
        `drive.kind`.
        """
        change = self._change()
        return None if change is None else change[1]

    def _change(self, at_ns: int | None = None) -> tuple[int, dict[str, float]] | None:
        """Return rig time [ns] and values of the newest change of the drive, or None if there is no such change.

        The values have the keys of `drive`. If `at_ns` is None, only changes of the present rig count. Otherwise the
        changes of all rigs up to the rig time `at_ns` count.
        """
        if at_ns is not None:
            return next((one for one in reversed(list(self.applied)) if one[0] <= at_ns), None)
        newest = self.applied[-1] if self.applied else None
        is_old = newest is None or newest[0] < self.since_ns() or self.changed_at_s < self.begun_at_s
        return None if is_old else newest


def guard(refused: dict[str, list[Any]], what: str, work: Callable[[], T]) -> T | None:
    """Call a function that processes external data; a failure is counted and not raised.

    Args:
        refused: failures so far by key: their number, and the reason of the last one.
        what: key under which a failure is counted.
        work: the function.

    Returns:
        The result of the function, or None if it has failed.
    """
    try:
        return work()
    except Exception as error:
        count = refused.setdefault(what, [0, ""])
        count[0] += 1
        count[1] = str(error) if isinstance(error, ImpactRigError) else f"{type(error).__name__}: {error}"
        return None


def came_before(changed_ns: int, row: Judged) -> bool:
    """Return whether a change of the rig took place before the scans of a measurement began.

    The measurement then describes the changed rig. A tolerance of one interval of the command grid (10 ms) after the
    start of the scans applies.

    Args:
        changed_ns: rig time of the change.
        row: the measurement.
    """
    return changed_ns < row.end_ns and changed_ns <= row.begin_ns + COMMAND_GRID_NS


def start_ns(info: Table) -> int:
    """Return the stamp of scan 0 of a rig [ns], from which all times are counted.

    It follows from the first row of a table of `daq/info`.

    Raises:
        RecordingError: the table states an invalid time, or has no rows.
    """
    since_s = _first(info, "since_start")
    if not 0.0 <= since_s < LONGEST_RUN_S:
        raise RecordingError(
            f"daq/info states an invalid time since scan 0 (since_start): it must be >= 0 and < {LONGEST_RUN_S:g} s, "
            f"got {since_s:g}"
        )
    return info.stamp_ns - round(since_s * NS_PER_S)


def _first(info: Table, name: str) -> float:
    if not len(info.rows):
        raise RecordingError(f"daq/info has no rows, so that its {name} is unknown")
    return float(info.rows[name][0])


def scan_rate(info: Table) -> float:
    """Return the scans per second of a rig according to a table of `daq/info`.

    Raises:
        RecordingError: the rate is below 1 Hz, or too high for the memory of the ring buffers (`HIGHEST_RATE_HZ`), or
            the table has no rows.
    """
    rate_hz = _first(info, "rate")
    if not 1.0 <= rate_hz <= HIGHEST_RATE_HZ:
        raise RecordingError(f"daq/info has a rate of {rate_hz:g} Hz; 1 to {HIGHEST_RATE_HZ:g} Hz can be shown")
    return rate_hz
