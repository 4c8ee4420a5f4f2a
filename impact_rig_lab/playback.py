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
"""Playback of recorded runs on the page: one run, or two side by side.

A player passes the messages of a run to a `RigView`, as for a live rig, at the speed chosen on the page. A thread reads
the rare messages (journal, measurements, faults, impacts, remarks) of the whole run in advance. The page shows them as
marks on its time line. The state of the rig at any time follows from them. An invalid message is counted and has no
other effect.
"""

from __future__ import annotations

import bisect
import contextlib
import math
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any  # values of parameters

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.config.sections import DRIVE_UNITS
from impact_rig.errors import ImpactRigError, RecordingError
from impact_rig.recording import Message, Run, open_run
from impact_rig.runs import recorded_journal, recover
from impact_rig.simtime import NS_PER_S
from impact_rig.states import MEASURED
from impact_rig_lab.protocol import Request
from impact_rig_lab.record import MOST_ROWS, RigView, came_before, guard, plain, scan_rate, start_ns
from impact_rig_lab.scope import LONGEST_S, Scope
from impact_rig_lab.state import KNOBS, Answer, Source
from impact_rig_lab.theory import KIND, closed_form

DRAWN = (topics.STREAM, topics.WAVEFORM, topics.SCAN, topics.JOINT_STATES, topics.IMPACTS_TRUTH, topics.IMPACTS)
RARE = (
    topics.JOURNAL, topics.APPLIED, topics.TRANSMISSIBILITY_TABLE, topics.FAULTS, topics.IMPACTS_TRUTH, topics.NOTES,
    topics.SCAN,
)  # fmt: skip
"""Topics that are read in advance through the whole run, for marks and past states; scans only to find missing blocks.
"""
MOST_FILLED = 250_000  # largest number of scans before the new time that are read at a jump
BINS = 400  # number of equal parts of a run in which impacts are counted
TICK_S = 0.025  # interval between two turns of the player's loop
TELL_S = 0.1  # interval between two updates of the state
MARKS_S = 1.0  # interval between two updates of the counted impacts
IMPACT_MARGIN_S = 0.05  # after a jump to an impact, the page shows the time that is later than the impact by this
AT_REST = {"frequency": 0.0, "current": 0.0}  # drive before the first recorded change


@attrs.frozen
class Instant:
    """State of a recorded rig at one time: parameters, drive, latch, pluck, and the time of the last change."""

    values: Mapping[str, Any]  # parameters of the rig by name
    applied: Mapping[str, float]  # drive, as `RigView.drive`
    latched: str  # reason why the shaker was latched; empty if it was not
    plucked: bool  # whether the inferior base was locked after a pluck
    changed_ns: int  # rig time of the last change of parameters or drive up to then; without one, the stamp of scan 0


class RunPlayer:
    """Player of one recorded run: it passes scans and motion up to the shown time to its record, and reads the marks.

    The marks are the rare messages of the whole run. Times of the page are seconds since scan 0 of the first run. The
    player of a second run adds `offset_s` to a time of the page to get the time since scan 0 of its own run.

    Args:
        path: a run directory or an MCAP file; a run that cannot be opened, such as a truncated one, is first recovered
            into a temporary directory.
        rig: namespace of the rig to show; None means the only one in the recording.

    Raises:
        RecordingError: `path` does not exist; or the run contains no intact message, no scans, no calibration or an
            invalid one, not this rig, or several rigs without `rig`.
    """

    def __init__(self, path: Path, rig: str | None = None) -> None:
        self.path, self._rig = path, rig
        self.recovered = False
        self.offset_s = 0.0  # offset to add to a time of the page to get the time since scan 0 of this run [s]
        self._stack = contextlib.ExitStack()
        with contextlib.ExitStack() as stack:
            self._run = stack.enter_context(self._open(path, stack))
            known = {self._run.name(topic): topic for topic in (*DRAWN, *RARE, topics.INFO)}
            self._topics = {name: topic for name, topic in known.items() if name in self._run.topics}
            info = next(self._messages([topics.INFO]), None)
            if info is None:
                raise RecordingError(
                    f"{path} contains no calibration (daq/info), so that its scans cannot be shown: choose another run"
                )
            try:
                calibration = codec.decode(info.data, topics.INFO)
                self.rate_hz, self.start_ns = scan_rate(calibration), start_ns(calibration)
            except ImpactRigError as error:
                raise RecordingError(
                    f"{path}: its calibration (daq/info) is unusable: {error}; choose another run"
                ) from error
            first = next(self._messages([topics.SCAN]), None)
            if first is None:
                raise RecordingError(
                    f"{path} contains no scans (daq/scan), so that there is nothing to show: choose a run with scans"
                )
            self.begin_ns, self.end_ns = codec.header_stamp_ns(first.data), self._run.end_ns
            self.start_ns = min(self.start_ns, self.begin_ns)
            self._stack = stack.pop_all()
        self.record = RigView(most=None)
        self.record.scope, self.record.start_ns = Scope(self.rate_hz), self.start_ns
        self.read_s = 0.0  # time up to which marks have been read [s since scan 0 of this run]
        self.whole = False  # whether all marks have been read
        self._impacts: list[float] = []
        self._lost: list[tuple[int, int]] = []
        self._expected_ns = self.begin_ns
        self._reading: Iterator[Message] | None = None
        self._next: Message | None = None
        self._end = threading.Event()
        self._quiet = threading.Event()
        self._quiet.set()
        self._marker = threading.Thread(target=self._mark, name="lab-marks", daemon=True)

    def _open(self, path: Path, stack: contextlib.ExitStack) -> Run:
        try:
            return open_run(path, self._rig)
        except RecordingError:
            if not path.exists():
                raise
        directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="impact_rig_lab_"))
        recover(path, Path(directory) / "run")
        self.recovered = True
        return open_run(Path(directory) / "run", self._rig)

    def _messages(self, wanted: Sequence[topics.Topic], from_ns: int | None = None) -> Iterator[Message]:
        names = [name for name, topic in self._topics.items() if topic in wanted]
        return iter(self._run.messages(names, start_ns=from_ns)) if names else iter(())

    def start(self) -> None:
        """Start a thread that reads the marks of the run: changes, measurements, faults, impacts, lost blocks.

        The marks up to `read_s` are available.
        """
        self._marker.start()

    def close(self) -> None:
        """Stop reading, and close the files of the run."""
        self._end.set()
        if self._marker.is_alive():
            self._marker.join()
        self._stop_reading()
        self._stack.close()

    @property
    def begin_s(self) -> float:
        """Time of the first recorded scan [s since scan 0 of this run]."""
        return (self.begin_ns - self.start_ns) / NS_PER_S

    @property
    def end_s(self) -> float:
        """Time of the last recorded message [s since scan 0 of this run]."""
        return (self.end_ns - self.start_ns) / NS_PER_S

    def instant_ns(self, page_s: float) -> int:
        """Return the stamp in this run [ns] for a time of the page [s]; the offset of this run is added."""
        return self.start_ns + round((page_s + self.offset_s) * NS_PER_S)

    # Playing

    def jump(self, page_s: float) -> None:
        """Move to another time, and refill the ring buffers with the scans and motion before this time.

        About `LONGEST_S` of data are read, or less at high scan rates. `play` continues from there.

        Args:
            page_s: the time of the page [s]. If nothing was recorded shortly before this time, the ring buffers stay
                empty.
        """
        self._quiet.clear()
        try:
            self._stop_reading()
            assert self.record.scope is not None
            self.record.scope.clear()
            self.record.forget_motion()
            back_s = min(LONGEST_S + 0.5, MOST_FILLED / self.rate_hz)
            self._reading = self._messages(DRAWN, self.instant_ns(page_s - back_s))
            self._next = next(self._reading, None)
            self.play(page_s)
        finally:
            self._quiet.set()

    def play(self, page_s: float) -> None:
        """Pass the next scans, motion and stream samples to the record, up to and including a time of the page [s].

        Playing continues from the last `jump`. Before the first `jump`, nothing is passed.
        """
        until = self.instant_ns(page_s)
        while self._next is not None and self._next.log_time <= until:
            self.record.take(self._topics[self._next.topic], bytes(self._next.data))
            self._next = next(self._reading, None) if self._reading is not None else None

    def _stop_reading(self) -> None:
        reading, self._reading, self._next = self._reading, None, None
        if reading is not None and hasattr(reading, "close"):
            reading.close()

    # Marks

    def _mark(self) -> None:
        try:
            for message in self._messages(RARE):
                self._quiet.wait()  # a jump has priority over reading marks
                if self._end.is_set():
                    return
                self._note(self._topics[message.topic], message)
                self.read_s = (message.log_time - self.start_ns) / NS_PER_S
        except RecordingError as error:
            self.record.refused["the file"] = [1, str(error)]  # the data read before are valid
            return
        self.whole = True

    def _note(self, topic: topics.Topic, message: Message) -> None:
        note = {topics.SCAN.name: self._count_lost, topics.IMPACTS_TRUTH.name: self._note_impacts}.get(topic.name)
        if topic is topics.JOURNAL:
            guard(self.record.refused, topic.name, lambda: self._note_entries(message))
        elif note is None:
            self.record.take(topic, bytes(message.data), message.log_time)
        else:
            guard(self.record.refused, topic.name, lambda: note(codec.decode(message.data, topic)))

    def _note_entries(self, message: Message) -> None:
        for entry in recorded_journal.entries(message):
            self.record.journal.add(entry)

    def _note_impacts(self, table: Table) -> None:
        begin = (table.stamp_ns - self.start_ns) / NS_PER_S
        self._impacts += [begin + float(time) for time in table.rows["time"]]

    def _count_lost(self, table: Table) -> None:
        """Store how many blocks of scans are missing between the previous block and this one.

        Missing blocks are assumed to be as long as this one. The time between two rigs in the recording does not count.
        """
        length_ns = round(len(table.rows) * NS_PER_S / self.rate_hz)
        if not length_ns:
            return
        expected_ns = self._expected_ns
        if table.stamp_ns > expected_ns:  # nothing is missing between two rigs
            expected_ns = max(expected_ns, self.record.since_ns(table.stamp_ns))
        lost = round((table.stamp_ns - expected_ns) / length_ns)
        if lost > 0:
            self._lost.append((table.stamp_ns, lost))
        self._expected_ns = table.stamp_ns + length_ns

    def lost_blocks(self, page_s: float) -> int:
        """Return the number of blocks of scans missing up to a time of the page [s], as far as marks have been read."""
        at = self.instant_ns(page_s)
        return sum(count for stamp, count in list(self._lost) if stamp <= at)

    def at(self, page_s: float) -> Instant:
        """Return the state of the rig at a time of the page [s since scan 0 of the first run].

        The state follows from the changes that have been read so far. Before the first change, the parameters have
        their default values, and the drive is at rest.
        """
        at_ns = self.instant_ns(page_s)
        view, change = self.record.journal.at(at_ns)
        changed_ns = 0 if change is None else change.stamp_ns
        drives = [one for one in list(self.record.applied) if one[0] <= at_ns] or [(self.start_ns, AT_REST)]
        latched = "" if view.latched is None else plain(view.latched.name) or "emergency stop"
        values = {
            name: list(value) if isinstance(value, tuple) else value for name, value in view.configuration.items()
        }
        return Instant(values, drives[-1][1], latched, view.plucked, max(changed_ns, drives[-1][0]))

    def present(self, page_s: float, then: Instant) -> dict[str, Any]:
        """Return whether the newest measurement at a time of the page applied then, in the form of `state.present`.

        It applied if it measured a settled response, the shaker was driven, and nothing had changed since it began.
        There must also be no doubts about it (`RigView.doubts`).

        Args:
            page_s: the time of the page [s].
            then: state of the rig at that time.
        """
        at_ns = self.instant_ns(page_s)
        judged = [row for row in list(self.record.curve.judged) if row.end_ns <= at_ns]
        rows = [row.status for row in judged if came_before(then.changed_ns, row)]
        drives = then.applied["current"] > 0.0 and not then.latched and not then.plucked
        state = "at_rest" if not drives else "settling" if not rows else "measuring"
        reason = ""
        if state == "measuring" and (rows[-1] not in MEASURED or rows[-1] == "not_settled"):
            state, reason = "unable", plain(rows[-1])
        return {
            "state": state, "holds": state == "measuring" and not self.record.doubts(at_ns), "reason": reason,
            "done": None, "of": None, "rest": None, "quiet": None, "quiet_of": None,
        }  # fmt: skip

    def rows(self, page_s: float) -> list[dict[str, Any]]:
        """Return a new list of the newest measurements up to a time of the page [s], with the keys of `Curve.part`.

        The list has at most `MOST_ROWS` measurements.
        """
        at_s = page_s + self.offset_s
        return [row for row in self.record.curve.part(self.start_ns) if row["t"] <= at_s][-MOST_ROWS:]

    def impact_after(self, page_s: float, direction: float) -> float | None:
        """Return the time of the page [s] of the next or previous true impact that has been read so far.

        An impact within 1 µs of `page_s` does not count.

        Args:
            page_s: time of the page from which to search [s].
            direction: > 0 for the next impact, otherwise the previous one.

        Returns:
            None if there is no such impact.
        """
        times, time_s = sorted(self._impacts), page_s + self.offset_s
        if direction > 0:
            place = bisect.bisect_right(times, time_s + 1e-6)
            return times[place] - self.offset_s if place < len(times) else None
        place = bisect.bisect_left(times, time_s - 1e-6)
        return times[place - 1] - self.offset_s if place else None

    def histogram(self) -> list[int]:
        """Return the number of true impacts in each of `BINS` equal parts of the run, as far as it has been read."""
        times: NDArray[np.float64] = np.array(list(self._impacts))
        return [int(n) for n in np.histogram(times, BINS, (self.begin_s, max(self.end_s, self.begin_s + 1e-3)))[0]]


class PlaybackSource(Source):
    """Source of pages that play back one recorded run, or two runs at once for comparison.

    The first run defines the record of the source and the time of the page. The second run is shifted so that the first
    recorded scans of both runs coincide. A page can request another alignment.

    Args:
        paths: path of one run, or of two.
        rig: namespace of the rig to show; None means the only one in each recording.

    Raises:
        RecordingError: a run cannot be read or shown.
    """

    def __init__(self, paths: Sequence[Path], rig: str | None = None) -> None:
        self._runs: list[RunPlayer] = []
        try:
            for path in paths:
                self._runs.append(RunPlayer(path, rig))
        except BaseException:
            for run in self._runs:
                run.close()
            raise
        first = self._runs[0]
        self._now_s, self._begin_s, self._end_s = 0.0, first.begin_s, first.end_s
        self._playing, self._speed, self._aligned = True, 1.0, "start"
        self._impact_s = self._jumped_s = math.nan
        """Times of the page [s]: of the impact of the last jump to one, and the time shown after that jump.

        The latter is `IMPACT_MARGIN_S` later, or less at the end of the run.
        """
        for run in self._runs[1:]:
            run.offset_s = run.begin_s - first.begin_s
        super().__init__("playback", first.record)
        self._move(self._begin_s)

    @property
    def other(self) -> Scope | None:
        """Scans of the second run; None if there is no second run, or it has no data at the time shown."""
        if len(self._runs) < 2:
            return None
        run = self._runs[1]
        return run.record.scope if run.begin_s <= self.now_s + run.offset_s <= run.end_s else None

    @property
    def now_s(self) -> float:
        """Time that the page shows [s since scan 0 of the first run]."""
        return self._now_s

    def start(self) -> None:
        """Start to read the marks of the runs (see `RunPlayer.start`), and to play while a page is open."""
        for run in self._runs:
            run.start()
        super().start()

    def close(self) -> None:
        """Stop playing, and close the files of the runs."""
        super().close()
        for run in self._runs:
            run.close()

    def _run(self) -> None:
        before = time.monotonic()
        reported = marked = 0.0
        while not self.end.wait(TICK_S):
            self.guard("requests", self._obey)
            now = time.monotonic()
            if self._playing and self.watchers:
                self.guard("playing", lambda: self._play(self.now_s + (now - before) * self._speed))  # noqa: B023
            before = now
            if now - reported >= TELL_S:
                reported = now
                self.guard("state", self._tell)
            if now - marked >= MARKS_S:
                marked = now
                self.guard("marks", lambda: self.snapshot.put(impact_marks=self._runs[0].histogram()))

    def _refusals(self) -> dict[str, list[Any]]:
        others = [
            (f"{name} of the second run", one) for run in self._runs[1:] for name, one in run.record.refused.items()
        ]
        return {**super()._refusals(), **dict(others)}

    def _play(self, until_s: float) -> None:
        with self.record.lock:
            self._now_s = min(until_s, self._end_s)
            for run in self._runs:
                run.play(self.now_s)
        if self.now_s >= self._end_s:
            self._playing = False

    def _move(self, to_s: float) -> None:
        with self.record.lock:
            self._now_s = min(max(to_s, self._begin_s), self._end_s)
            for run in self._runs:
                run.jump(self.now_s)

    # Requests of pages

    def _obey(self) -> None:
        """Run the waiting requests of pages and answer them.

        Only the last of several `seek` requests is run. The earlier ones are answered as successful.
        """
        asked: list[tuple[Request, Answer]] = []
        while not self._asked.empty():
            asked.append(self._asked.get())
        jumps = [number for number, (request, _) in enumerate(asked) if request.do == "seek"]
        for number, (request, answer) in enumerate(asked):
            if request.do == "seek" and number != jumps[-1]:
                answer(True, "")
                continue
            try:
                done = True, self._do(request)
            except ImpactRigError as error:
                done = False, str(error)
            self.guard("state", self._tell)  # the state for the page is up to date before the answer
            answer(*done)

    def _do(self, request: Request) -> str:
        value: Any = request.values.get("value")  # its type has been checked by the protocol
        match request.do:
            case "play":
                if value and self.now_s >= self._end_s:
                    self._move(self._begin_s)
                self._playing = value
            case "pause":
                self._playing = not value
            case "speed":
                self._speed = value
            case "seek":
                self._move(value)
            case "next_impact":
                shown_s = self._impact_s if self.now_s == self._jumped_s else self.now_s - IMPACT_MARGIN_S
                found = self._runs[0].impact_after(shown_s, value or 1.0)
                if found is None:
                    raise RecordingError("no further impact in this direction in the part of the run read so far")
                self._playing = False
                self._move(found + IMPACT_MARGIN_S)
                self._impact_s, self._jumped_s = found, self.now_s
            case "align":
                return self._align(request.values["by"], value)
            case _:
                raise RecordingError(f"{request.do}: not possible, because a recorded run cannot be changed")
        return ""

    def _align(self, by: str, at_s: float) -> str:
        """Shift the second run in time relative to the first, so that both can be compared.

        Args:
            by: what is aligned: `start` (the first recorded scans of both runs), `time` (equal times since scan 0), or
                `change`. For `change`, the change of the first run nearest to `at_s` is aligned with the first equal
                change of the second run. Changes are lines of `RigHistory.part`.
            at_s: time of the page [s]; only for `change`.

        Returns:
            Answer for the page.

        Raises:
            RecordingError: there is no second run, or no such change in the parts of the runs read so far.
        """
        if len(self._runs) < 2:
            raise RecordingError(
                "only one run is shown, so there is nothing to align: start the lab with two runs (impact-rig lab RUN "
                "RUN)"
            )
        first, second = self._runs
        words = {"start": "both runs begin together", "time": "both runs by their time since scan 0"}.get(by, "")
        offset_s = second.begin_s - first.begin_s if by == "start" else 0.0
        if by == "change":
            changes = [line for line in first.record.journal.part(first.start_ns) if line[0] >= first.begin_s]
            if not changes:
                raise RecordingError(
                    f"{first.path.name} contains no change of the rig in the part that has been read so far; align the "
                    "runs by start or by time"
                )
            chosen = min(changes, key=lambda line: abs(line[0] - at_s))
            same = [line for line in second.record.journal.part(second.start_ns) if line[1:] == chosen[1:]]
            if not same:
                raise RecordingError(
                    f"{second.path.name} contains no change {' '.join(chosen[1:]).strip()!r} in the part that has been "
                    "read so far; align the runs by start or by time"
                )
            offset_s = same[0][0] - chosen[0]
            words = f"both runs at {' '.join(chosen[1:]).strip()}"
        second.offset_s, self._aligned = offset_s, by
        self._move(self.now_s)
        return words

    # State for pages

    def _tell(self) -> None:
        run, record = self._runs[0], self.record
        then, at_ns = run.at(self.now_s), run.instant_ns(self.now_s)
        lost = run.lost_blocks(self.now_s)
        word = "playback" if self._playing else "paused playback"
        self.tell({
            "rig": lambda: {
                "word": word, "text": " ".join(map(self._words, self._runs)), "name": run.path.name, "age": 0,
                "time": round(self.now_s, 2), "speed": self._speed if self._playing else 0.0, "mode": "playback",
                "own": False, "over": {},
            },
            "applied": lambda: then.applied,
            "knobs": lambda: {name: then.values[name] for name in KNOBS},
            "dt": lambda: run.rows(self.now_s),
            "dt_now": lambda: run.present(self.now_s, then),
            **({"dt_b": lambda: self._runs[1].rows(self.now_s)} if len(self._runs) > 1 else {}),
            "closed_form": lambda: closed_form(then.values),
            "faults": lambda: record.faults.in_force(record.since_ns(at_ns), at_ns),
            "health": lambda: record.health(at_ns),
            "journal": lambda: record.journal.part(run.start_ns),
            "recorder": lambda: {"name": run.path.name},
            "stream": record.stream_part,
            "lost": lambda: {"blocks missing in the recording": lost} if lost else {},
            "playback": lambda: {
                "begin": self._begin_s, "end": round(self._end_s, 3), "now": round(self.now_s, 3),
                "playing": self._playing, "speed": self._speed,
                "read": 1.0 if run.whole else round(run.read_s / max(self._end_s, 1e-3), 2),
                "names": [one.path.name for one in self._runs], "aligned": self._aligned,
            },
        }, then.values)  # fmt: skip

    def _words(self, run: RunPlayer) -> str:
        """Return a sentence for the page: name of a run, and state of its rig at the time shown."""
        then = run.at(self.now_s)
        name = f"{run.path.name} (truncated; its intact part is shown)" if run.recovered else run.path.name
        if not run.begin_s <= self.now_s + run.offset_s <= run.end_s:
            found = "nothing was recorded at this time"
        elif then.latched:
            found = f"the shaker was latched by {then.latched}"
        elif then.plucked:
            found = "the base was locked after a pluck"
        elif run.record.stream is not None and run.record.stream["playing"]:
            found = "driven by a stream of samples"
        elif then.applied["current"]:
            unit = DRIVE_UNITS.get(then.values[KIND], "")
            found = f"driven at {then.applied['frequency']:g} Hz, {then.applied['current']:g} {unit}"
        else:
            found = "at rest"
        return f"{name}: {found}."
