# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A recorded run to play: any stretch of it into rings, and its rare messages, read in the background, as marks."""

from __future__ import annotations

import bisect
import contextlib
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any  # values of parameters

import numpy as np
from numpy.typing import NDArray

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.errors import CodecError, RecordingError
from impact_rig.lab.deeds import READ
from impact_rig.lab.motion import Motion
from impact_rig.lab.parts import Curve, Ledger, start_ns, text
from impact_rig.lab.scope import LONGEST_S, Scope
from impact_rig.recording import Message, Run, open_run
from impact_rig.rig.config import RigConfig, to_flat
from impact_rig.rig.journal import short_key
from impact_rig.runs import recover
from impact_rig.simtime import NS_PER_S

DRAWN = (topics.SCAN.name, topics.JOINT_STATES.name, topics.IMPACTS_TRUTH.name, "impacts")
RARE = (
    topics.JOURNAL.name,
    topics.APPLIED.name,
    topics.TRANSMISSIBILITY_TABLE.name,
    topics.FAULTS.name,
    topics.IMPACTS_TRUTH.name,
    "notes",
)
MOST_FILLED = 250_000
"""Scans read before the instant that is jumped to."""
BINS = 400
_NAMES = {short_key(name): name for name in READ}


class Reel:
    """One run.

    Args:
        path: a run directory or an MCAP file; one that was cut short is recovered into a temporary directory first.

    Raises:
        RecordingError: nothing whole is in it, or no scans.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.recovered = False
        self._stack = contextlib.ExitStack()
        with contextlib.ExitStack() as stack:
            self._run = stack.enter_context(self._open(path, stack))
            self._scan = self._run.resolve(topics.SCAN.name)
            info = next(self._run.tables(topics.INFO.name), None)
            if info is None:
                raise RecordingError(f"{path} has no calibration (daq/info)")
            self.rate_hz = float(info.rows["rate"][0])
            first = next(iter(self._run.messages([self._scan])), None)
            if first is None:
                raise RecordingError(f"{path} holds no scans")
            self.begin_ns, self.end_ns = codec.header_stamp_ns(first.data), self._run.end_ns
            self.start_ns = min(start_ns(info), self.begin_ns)
            self._stack = stack.pop_all()
        self.scope, self.motion = Scope(self.rate_hz), Motion()
        self.ledger, self.curve = Ledger(), Curve()
        self.read_s = 0.0
        """How far the marks are read [s since scan 0]."""
        self.whole = False
        self._changes: list[tuple[int, str, Any]] = []
        self._impacts: list[float] = []
        self._reading: Iterator[Message] | None = None
        self._next: Message | None = None
        self._names = [name for name in DRAWN if self._has(name)]
        self._end = threading.Event()
        self._quiet = threading.Event()
        self._quiet.set()
        self._marker = threading.Thread(target=self._mark, name="lab-marks", daemon=True)

    def _open(self, path: Path, stack: contextlib.ExitStack) -> Run:
        try:
            return open_run(path)
        except RecordingError:
            if not path.exists():
                raise
        directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="impact_rig_lab_"))
        recover(path, Path(directory) / "run")
        self.recovered = True
        return open_run(Path(directory) / "run")

    def _has(self, topic: str) -> bool:
        with contextlib.suppress(RecordingError):
            return bool(self._run.resolve(topic))
        return False

    def start(self) -> None:
        """Begin to read the marks."""
        self._marker.start()

    def close(self) -> None:
        """End."""
        self._end.set()
        if self._marker.is_alive():
            self._marker.join()
        self._stop_reading()
        self._stack.close()

    @property
    def begin_s(self) -> float:
        """Time of the first scan [s since scan 0]."""
        return (self.begin_ns - self.start_ns) / NS_PER_S

    @property
    def end_s(self) -> float:
        """Time of the last message."""
        return (self.end_ns - self.start_ns) / NS_PER_S

    # Playing

    def jump(self, time_s: float) -> None:
        """Fill the rings with what came before an instant."""
        self._quiet.clear()
        try:
            self._fill(time_s)
        finally:
            self._quiet.set()

    def _fill(self, time_s: float) -> None:
        self._stop_reading()
        self.scope.clear()
        self.motion = Motion()
        back_s = min(LONGEST_S + 0.5, MOST_FILLED / self.rate_hz)
        from_ns = self.start_ns + round((time_s - back_s) * NS_PER_S)
        self._reading = iter(self._run.messages(self._names, start_ns=from_ns))
        self._next = next(self._reading, None)
        self.play(time_s)

    def play(self, time_s: float) -> None:
        """Read on to an instant."""
        until = self.start_ns + round(time_s * NS_PER_S)
        while self._next is not None and self._next.log_time <= until:
            with contextlib.suppress(CodecError):  # what is no table of ours is not drawn
                self._take(self._next)
            self._next = next(self._reading, None) if self._reading is not None else None

    def _take(self, message: Message) -> None:
        name = message.topic.rsplit("/", 2)
        data = bytes(message.data)
        if message.topic == self._scan:
            self.scope.add(codec.decode(data), self.start_ns)
        elif name[-1] == "joint_states":
            self.motion.add_state(data, self.start_ns)
        elif name[-2:] == ["truth", "impacts"]:
            table = codec.decode(data)
            self.motion.add_impacts(table.stamp_ns, table.rows, self.start_ns)
        else:
            table = codec.decode(data)
            self.motion.add_detected(table.stamp_ns, table.rows, self.start_ns)

    def _stop_reading(self) -> None:
        reading, self._reading, self._next = self._reading, None, None
        if reading is not None and hasattr(reading, "close"):
            reading.close()

    # Marks

    def _mark(self) -> None:
        names = [name for name in RARE if self._has(name)]
        try:
            for message in self._run.messages(names):
                self._quiet.wait()  # a jump comes first
                if self._end.is_set():
                    return
                with contextlib.suppress(CodecError, ValueError, KeyError):
                    self._note(message)
                self.read_s = (message.log_time - self.start_ns) / NS_PER_S
        except RecordingError:
            return  # what was read before is right
        self.whole = True

    def _note(self, message: Message) -> None:
        name = message.topic
        if name.endswith("/notes") or name == "notes":
            self.ledger.remark(bytes(message.data[8:-1]).decode("utf-8", errors="replace"), message.log_time)
            return
        table = codec.decode(bytes(message.data))
        if name.endswith(topics.JOURNAL.name):
            self.ledger.add(table)
            self._changes += _changes(table)
        elif name.endswith(topics.APPLIED.name):
            stamps = [table.stamp_ns + round(float(row["time"]) * NS_PER_S) for row in table.rows]
            for stamp, row in zip(stamps, table.rows, strict=True):
                applied = {"frequency": float(row["frequency"]), "current": float(row["current"])}
                self._changes.append((stamp, "applied", applied))
        elif name.endswith(topics.TRANSMISSIBILITY_TABLE.name):
            self.curve.add(table)
        elif name.endswith(topics.FAULTS.name):
            self.ledger.fault(table)
        else:
            begin = (table.stamp_ns - self.start_ns) / NS_PER_S
            self._impacts += [begin + float(time) for time in table.rows["time"]]

    def knobs(self, time_s: float) -> dict[str, Any]:
        """Return the recorded parameters that are read at an instant, and the drive under `applied`."""
        at = self.start_ns + round(time_s * NS_PER_S)
        flat = to_flat(RigConfig())
        initial = {name: list(v) if isinstance(v := flat[name], tuple) else v for name in READ}
        found = dict(initial)
        latched = plucked = False
        for stamp, name, value in list(self._changes):
            if stamp > at:
                continue
            if name == "begin":
                applied = found.get("applied")
                found = dict(initial)
                if applied is not None:
                    found["applied"] = applied
                latched = plucked = False
            elif name == "latched":
                latched = value
            elif name == "plucked":
                plucked = True
            else:
                found[name] = bool(value) if isinstance(initial.get(name), bool) else value
        return {**found, "latched": latched, "plucked": plucked}

    def impact_after(self, time_s: float, direction: float) -> float | None:
        """Return the next impact after an instant, or the last one before it; None: there is none."""
        times = sorted(self._impacts)
        if direction > 0:
            place = bisect.bisect_right(times, time_s + 1e-6)
            return times[place] if place < len(times) else None
        place = bisect.bisect_left(times, time_s - 1e-6)
        return times[place - 1] if place else None

    def histogram(self) -> list[int]:
        """Return how many impacts there are in every four hundredth of the run."""
        times: NDArray[np.float64] = np.array(list(self._impacts))
        return [int(n) for n in np.histogram(times, BINS, (self.begin_s, max(self.end_s, self.begin_s + 1e-3)))[0]]


def _changes(table: Table) -> Iterator[tuple[int, str, Any]]:
    for row in table.rows:
        kind, key, words = text(row["kind"]), text(row["key"]), text(row["text"])
        if kind in ("start", "reset"):
            yield table.stamp_ns, "begin", None
        elif kind in ("trip", "stop"):
            yield table.stamp_ns, "latched", key.replace("_", " ") or "emergency stop"
        elif kind == "clear_trip":
            yield table.stamp_ns, "latched", ""
        elif kind == "pluck":
            yield table.stamp_ns, "plucked", True
        elif kind in ("initial", "parameter", "more") and key in _NAMES:
            yield table.stamp_ns, _NAMES[key], words or float(row["value"])
