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
"""State of rig and measurement as pages show it, live and in playback, and the base class `Source` that provides it.

`judge` summarises the state in one word and one sentence. It uses only the state words of the nodes
(`impact_rig.states`), and does not parse their sentences. A value that was never reported, or too long ago, is not
shown as present. Times are seconds since scan 0; earlier times are negative.
"""

from __future__ import annotations

import abc
import json
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar  # Any: values for JSON

import attrs

from impact_rig import states
from impact_rig.config.sections import DRIVE_UNITS
from impact_rig.instruments.instrument import BOARD_KINDS, FAULT_KINDS
from impact_rig.instruments.registry import INSTRUMENTS
from impact_rig.instruments.section import CHANNELS
from impact_rig.physics.contact import LAWS
from impact_rig.rig.config import fields
from impact_rig.rig.journal import PLANNED
from impact_rig.states import Regime, Status
from impact_rig_lab.protocol import Request
from impact_rig_lab.record import SHOWN_UNITS, RigView, fault_unit, guard, plain
from impact_rig_lab.scope import Scope
from impact_rig_lab.theory import Theory, contradiction

FAST_FACTOR = 1.5
"""Speed (rig time over real time) above which pictures are drawn only occasionally.

At such a speed, individual cycles cannot be seen, and rig and analysis need the processor.
"""
FOLLOWED = 4.5
"""Speed (rig time over real time) up to which the motion is drawn.

At a higher speed the eye cannot follow the motion, and publishing it would slow the rig by a tenth.
"""
T = TypeVar("T")
STALE_S = 3.0  # time after which unchanged rig time counts as standing still
STANDING = (states.RigWord.INACTIVE, states.RigWord.NO_PEER, states.RigWord.SILENT_PEER, states.RigWord.PAUSED)
"""States of the rig in which its time stands still, or has not started."""
GAP_S = 10.0  # longest time between two readings of the rig time from which a speed is computed
KNOBS = (
    "barriers.gap_m", "sphere.present", "sphere.start", "contact.law", "contact.restitution", "pluck.displacement_m",
    "shaker.frequency_min_hz", "shaker.frequency_max_hz", "shaker.current_limit_a_rms", "shaker.travel_limit_m",
    "structure.natural_frequency_hz", "structure.damping_ratio", "time.mode", "time.factor", "drive.kind", PLANNED,
)  # fmt: skip
"""Parameters of the rig that the page shows."""
Answer = Callable[[bool, str], None]
"""Function that reports the result of a request to the page: whether it succeeded, and a text.

It is called once for each request, from any thread.
"""
DEAD_S = 4.0  # time after which a silent node counts as absent


@attrs.frozen
class Seen:
    """Last report of a node in `/diagnostics`, with its age; empty values if the lab has not received a report."""

    state: str = ""  # state word of the node, see `impact_rig.states`; empty if it reported none
    reason: str = ""  # reason for this state, in the words of the node
    instance: str = ""  # identifier of the activation of the node that reported it
    age_s: float | None = None  # age of the report [s]; None if there was none
    ended: str = ""  # text on how the process of the node ended; empty if it runs, or the lab did not start it
    figures: Mapping[str, str] = attrs.field(factory=dict)  # all values in its diagnostics, by key

    @classmethod
    def of(cls, node: str, figures: Mapping[str, str], age_s: float | None, ended: str = "") -> Seen:
        """Create the report of a node from its diagnostics.

        Args:
            node: name of the node, which determines the known state words; an unknown word becomes empty.
            figures: values of its diagnostics, by key.
            age_s: age of the report [s].
            ended: text on how the process of the node ended; empty if it did not.
        """
        state = figures.get("state", "")
        known = {one.value for one in states.BY_NODE[node]} if node in states.BY_NODE else set()
        word = state if state in known else ""
        return cls(word, figures.get("reason", ""), figures.get("instance", ""), age_s, ended, figures)

    @property
    def lives(self) -> bool:
        """Return whether the node has reported in the last `DEAD_S` seconds, and is not known to have ended."""
        return not self.ended and self.age_s is not None and self.age_s <= DEAD_S

    def part(self) -> dict[str, Any]:
        """Return state, reason, instance and age [s] of the node, `lives` and the text `gone`, as JSON for the page."""
        return {
            "state": self.state,
            "reason": self.reason,
            "instance": self.instance,
            "lives": self.lives,
            "age": None if self.age_s is None else round(self.age_s),
            "gone": self.gone,
        }

    @property
    def gone(self) -> str:
        """Reason why a node is gone: its process ended, or its reports stopped.

        The text is empty if the node lives, or has not reported yet.
        """
        if self.ended:
            return self.ended
        return "" if self.age_s is None or self.lives else f"silent for {self.age_s:.0f} s"


SENTENCES = {
    states.RigWord.INACTIVE: "Not running: {reason}.",
    states.RigWord.RIVAL: "Two rigs in one namespace: {reason}.",
    states.RigWord.NO_PEER: "Rig time stands still: {reason}.",
    states.RigWord.SILENT_PEER: "Rig time stands still: {reason}.",
    states.RigWord.TRIPPED: "The shaker is latched by {reason}; its current is zero.",
    states.RigWord.PAUSED: "Rig time stands still.",
    states.RigWord.PLUCKED: "Base locked, structure swings freely; reset unlocks it.",
    states.RigWord.AT_REST: "The shaker is at rest. Press R for 9.1 Hz, 0.52 A.",
}
MEASURING = {
    states.AnalysisWord.INACTIVE: "the analysis is not active",
    states.AnalysisWord.NO_SCANS: "the analysis receives no scans",
    states.AnalysisWord.LOST_SCANS: "the analysis has lost scans and restarts",
    states.AnalysisWord.UNABLE: "DT cannot be measured now: {reason}",
    states.AnalysisWord.AT_REST: "the analysis has not received the drive yet",
}


def judge(rig: Seen, analysis: Seen, doubts: Sequence[str] = ()) -> tuple[str, str]:
    """Summarise the state of a live rig and its measurement in one word and one sentence for the page.

    The word is `measured` only if a measurement of the present drive is available without doubts. If the rig is driven
    without such a measurement, the word is `settling` or `driving`. If the rig is not driven, the word is the state of
    the rig (`RigWord`, with spaces), `starting`, `dead` or `unknown`.

    Args:
        rig: last report of the rig.
        analysis: last report of the analysis.
        doubts: reasons why the newest measurement may not apply, see `RigView.doubts`.
    """
    if rig.ended:
        return "dead", f"The rig is gone: {rig.ended}."
    if rig.age_s is None:
        return "starting", "Waiting for the rig."
    if not rig.lives:
        return "dead", f"No report from the rig for {rig.age_s:.0f} s."
    if not rig.state:
        return "unknown", "The rig reports no state that this lab knows; does it run another version of impact_rig?"
    if rig.state != states.RigWord.DRIVING:
        sentence = SENTENCES[states.RigWord(rig.state)].format(reason=plain(rig.reason) or "no reason given")
        return plain(rig.state), sentence
    if not analysis.lives:
        why = f"the analysis is gone ({analysis.gone})" if analysis.gone else "there is no analysis"
        return "driving", f"No measurement: {why}."
    if analysis.state == states.AnalysisWord.SETTLING:
        waits = bool(figure(analysis.figures.get("no_impact_limit_s")))  # for a sphere: the reason says so
        return "settling", f"{capitalised(analysis.reason if waits else 'waiting until the transient has died')}."
    if analysis.state != states.AnalysisWord.MEASURING:
        why = MEASURING[states.AnalysisWord(analysis.state)] if analysis.state else "the analysis reports no state"
        why = why.format(reason=plain(analysis.reason) or "no reason given")
        return "driving", f"{capitalised(why)}."
    if doubts:
        return "driving", f"The analysis reports a measurement, but {'; '.join(doubts)}."
    return "measured", "The measurement applies to the present drive."


def capitalised(text: str) -> str:
    """Return a text with its first letter capitalised and the others unchanged."""
    return text[:1].upper() + text[1:]


class Pace:
    """Measurement of the speed of rig time (rig seconds per real second), from readings of the rig time.

    Args:
        clock: clock for real time [s].

    Attributes:
        speed: speed between the last two different readings. It is 0 before there are two, after a restart of the rig,
            or if the state of the rig implies that its time stands still. It keeps its value while the readings do not
            change.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.speed = 0.0  # from the last two different readings
        self._read_at = self._rig_s = 0.0
        self._instance = ""

    @property
    def is_hurried(self) -> bool:
        """Return whether rig time runs so fast (above `FAST_FACTOR`) that pictures are drawn only occasionally."""
        return self.speed > FAST_FACTOR

    @property
    def is_followed(self) -> bool:
        """Return whether rig time runs slowly enough (up to `FOLLOWED`) for the motion to be drawn."""
        return self.speed <= FOLLOWED

    def read(self, rig_s: float, instance: str = "", *, stands: bool = False) -> float:
        """Add a reading of the rig time, and return its present speed (rig seconds per real second).

        The speed is 0 for the first reading, and if the rig time has not changed for 3 s of real time. A reading that
        goes back, or arrives 10 s or more after the last change, does not change the speed.

        Args:
            rig_s: rig time [s].
            instance: identifier of the rig's activation; the speed is computed only from readings of the same one.
            stands: whether the state of the rig implies that its time stands still; the speed is then 0 at once.
        """
        now = self._clock()
        if instance != self._instance or stands:
            self._instance, self._read_at, self._rig_s, self.speed = instance, now, rig_s, 0.0
        if rig_s == self._rig_s:
            return 0.0 if now - self._read_at > STALE_S else self.speed
        if rig_s > self._rig_s and self._read_at and now - self._read_at < GAP_S:
            self.speed = (rig_s - self._rig_s) / (now - self._read_at)
        self._read_at, self._rig_s = now, rig_s
        return self.speed


def choices() -> dict[str, Any]:
    """Return the choices that the controls of the page offer, such as contact laws, faults and channels.

    `faults` maps each kind of fault to the content of its input form. `units` maps each kind of drive to its unit.
    """
    about = {name: info for name, info, _ in fields()}
    return {
        "law": list(about["contact.law"].choices),
        "start": list(about["sphere.start"].choices),
        "faults": {kind: _fault_form(kind) for kind in FAULT_KINDS},
        "channels": list(CHANNELS),
        "units": dict(DRIVE_UNITS),
    }


SIZES = {"accelerometer": 5.0, "laser": 1e-3, "base": 1e-4, "current": 0.1}
"""Suggested size of a fault in the SI unit of each channel: large enough to be seen, too small to trip the rig."""
NOISE = 0.1  # suggested rms of added noise, as a fraction of the size in `SIZES`
SIZE_NAMES = {
    "gain_error": "fraction",
    "added_noise": "rms",
    "saturation": "limit ±",
    "spike_train": "height ±",
    "offset_step": "step",
}


def _fault_form(kind: str) -> dict[str, Any]:
    """Return the content of the page's input form for a kind of instrument fault.

    The keys are `words` (description), `board` (whether the fault concerns all channels), `rate` (whether it occurs
    repeatedly) and `sizes`. `sizes` maps each channel to an input: name, default in the `unit` of the page, and
    `scale`, the factor from this unit to that of the rig. A fault of all channels has its size under an empty name. A
    kind of fault without a size has empty `sizes`.
    """
    words = FAULT_KINDS[kind]
    sizes: dict[str, dict[str, Any]] = {}
    if kind == "clock_drift":
        sizes[""] = {"name": "drift", "unit": "ppm", "scale": 1.0, "default": 100.0}
    elif "`value`" in words:
        for name in INSTRUMENTS:
            size = {"gain_error": 0.02, "added_noise": NOISE * SIZES.get(name, 1.0)}.get(kind, SIZES.get(name, 1.0))
            of_rig = fault_unit(kind, name)
            unit, scale = SHOWN_UNITS.get(of_rig, (of_rig, 1.0))
            sizes[name] = {"name": SIZE_NAMES[kind], "unit": unit, "scale": scale, "default": round(size / scale, 9)}
    return {"words": words, "board": kind in BOARD_KINDS, "rate": "`rate_hz`" in words, "sizes": sizes}


def figure(value: str | None) -> float | None:
    """Convert a value of the diagnostics to a number, which may be NaN; None if it is missing or not numeric."""
    try:
        return None if value is None else float(value)
    except ValueError:
        return None


def present(rig: Seen, analysis: Seen, doubts: Sequence[str] = ()) -> dict[str, Any]:
    """Return whether the newest measurement applies now (`holds`), and the progress of the next one, for the page.

    The measurement applies if `judge` returns `measured`, or would do so if the rig were not paused. The progress
    consists of the settling windows `done` and needed (`of`), and the remaining fraction of the transient (`rest`). It
    also has the time without impacts (`quiet`) [s] and its limit (`quiet_of`) [s]. Unknown numbers are None. `state`
    and `reason` are those of the analysis. They are empty unless both nodes report and the rig is driven or paused.

    Args:
        rig: last report of the rig.
        analysis: last report of the analysis.
        doubts: reasons why the newest measurement may not apply.
    """
    moves = rig.lives and rig.state in (states.RigWord.DRIVING, states.RigWord.PAUSED)
    known = analysis.state if analysis.lives and moves else ""
    figures = analysis.figures if known else {}
    return {
        "state": known,
        "holds": known == states.AnalysisWord.MEASURING and not doubts,
        "reason": plain(analysis.reason) if known else "",
        "done": figure(figures.get("settling_windows")),
        "of": figure(figures.get("settling_windows_needed")),
        "rest": figure(figures.get("settling_remnant")),
        "quiet": figure(figures.get("no_impact_s")),
        "quiet_of": figure(figures.get("no_impact_limit_s")),
    }


class Snapshot:
    """Newest state of a source in named parts; a session can get the parts that have changed since a version.

    The attribute `version` increases with each change. A snapshot may be used by several threads.
    """

    def __init__(self) -> None:
        self._parts: dict[str, Any] = {}
        self._versions: dict[str, int] = {}
        self._lock = threading.Lock()
        self.version = 0

    def put(self, **parts: Any) -> None:
        """Set parts by name, all at once: a reader gets all new parts or none of them.

        A part that equals the present one does not count as a change.
        """
        with self._lock:
            new = {name: part for name, part in parts.items() if name not in self._parts or self._parts[name] != part}
            if new:
                self.version += 1
                self._parts.update(new)
                self._versions.update(dict.fromkeys(new, self.version))

    def get(self, name: str) -> Any:
        """Return the newest value of the part `name`, or None if it was not set yet."""
        return self._parts.get(name)

    def since(self, version: int) -> tuple[int, Mapping[str, Any]]:
        """Return the present version, and the parts by name that have changed since an earlier `version`."""
        with self._lock:
            return self.version, {name: self._parts[name] for name, at in self._versions.items() if at > version}


class Source(abc.ABC):
    """Base class of a source of pages: a live rig, or recorded runs.

    The thread of the source runs requests and updates the snapshot.

    Args:
        mode: `live` or `playback`.
        record: state of the rig, in which the source keeps its data.
    """

    def __init__(self, mode: str, record: RigView) -> None:
        self.record = record
        self.snapshot = Snapshot()
        self.failures: dict[str, list[Any]] = {}  # failed parts of the work by name: their number, and the last reason
        self.watchers = 0  # number of open pages
        self._asked: queue.SimpleQueue[tuple[Request, Answer]] = queue.SimpleQueue()
        self.end = threading.Event()
        self.theory = Theory(lambda found: self.snapshot.put(prediction=found))
        self._thread = threading.Thread(target=self._run, name=f"lab-{mode}", daemon=True)
        self.snapshot.put(mode=mode, choices=choices(), help=glossary())

    @property
    def other(self) -> Scope | None:
        """Scans of a second recorded run, drawn together with those of `record`; None if there is none."""
        return None

    @property
    @abc.abstractmethod
    def now_s(self) -> float:
        """Time that pages show now [s since scan 0]."""

    @abc.abstractmethod
    def _run(self) -> None:
        """Run requests and update snapshot and record until the event `end` is set: body of the source's thread."""

    def ask(self, request: Request, answer: Answer) -> None:
        """Queue a request of a page for the thread of this source.

        Args:
            request: the request.
            answer: function that reports its result to the page; it is called in that thread.
        """
        self._asked.put((request, answer))

    def start(self) -> None:
        """Start the thread of the source."""
        self._thread.start()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the thread of the source, and wait until it and a running prediction have ended."""
        self.end.set()
        if self._thread.is_alive():  # otherwise the cause of the failed start is raised
            self._thread.join()
        self.theory.close()

    def guard(self, what: str, work: Callable[[], T]) -> T | None:
        """Call a function that is a part of the source's work; a failure is counted in `failures` by the name `what`.

        The exception is not raised, because the loop of the source must continue, for example to send STOP. Returns the
        result of the function, or None if the function has failed.
        """
        return guard(self.failures, what, work)

    def tell(self, parts: Mapping[str, Callable[[], Any]], values: Mapping[str, Any]) -> None:
        """Update the snapshot with the results of functions, and request the prediction for the present settings.

        If a function fails, the failure is counted, its part stays as it is, and the other parts are updated. The part
        `refused` gets all failures and invalid messages. The part `other_motion` gets the result of `contradiction` for
        the newest measurement if the measurement applies now. The prediction is requested only while a page is open and
        the drive is known.

        Args:
            parts: functions that return the parts, by name; `applied`, `dt` and `dt_now` are among them.
            values: parameters of the rig by name, for the prediction; empty if they are unknown.
        """
        content: dict[str, Any] = {}
        for name, make in parts.items():
            self.guard(f"state of {name}", lambda name=name, make=make: content.update({name: make()}))  # type: ignore[misc]
        content["refused"] = {name: list(found) for name, found in self._refusals().items()}
        rows, now = content.get("dt"), content.get("dt_now")
        prediction = self.snapshot.get("prediction") or {}
        content["other_motion"] = contradiction(prediction, rows[-1]["ipc"]) if rows and now and now["holds"] else ""
        self.snapshot.put(**content)
        drive = content.get("applied")
        if values and drive is not None and self.watchers:
            self.theory.want(values, drive["current"])

    def _refusals(self) -> dict[str, list[Any]]:
        return {**self.record.refused, **self.failures}


def glossary() -> dict[str, str]:
    """Return an explanation of each special word that a page may show, for its help texts.

    The words are states of nodes, statuses and regimes of measurements, contact laws, faults, and names of values.
    """
    laws = {plain(name): f"Contact law. {(law.__doc__ or '').splitlines()[0]}" for name, law in LAWS.items()}
    faults = {plain(kind): f"Fault of an instrument: {words}." for kind, words in FAULT_KINDS.items()}
    words: dict[str, str] = {}
    for node, table in states.BY_NODE.items():
        for word in table:
            sentence = f"Of the {plain(node)}: {word.doc}."
            words[plain(word)] = f"{words[plain(word)]} {sentence}" if plain(word) in words else sentence
    measured = {plain(word): word.doc for table in (Status, Regime) for word in table}
    own = json.loads((Path(__file__).parent / "words.json").read_text(encoding="utf-8"))
    return {**laws, **faults, **words, **measured, **own}
