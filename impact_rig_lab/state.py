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
"""State for pages, live and in playback alike, and the `Source` that provides it.

`judge` summarises the state in one word and one sentence. It uses only the keys of `impact_rig.states`; no sentence is
parsed. A value that was never reported, or too long ago, is not shown as present. Times are seconds since scan 0;
earlier times are negative.
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
"""Speed from which pictures are drawn only occasionally.

Individual cycles are invisible, and rig and analysis need the machine.
"""
FOLLOWED = 4.5
"""Speed up to which the motion is drawn.

Beyond it the motion is too fast to follow, and publishing it slows the rig by a tenth.
"""
T = TypeVar("T")
STALE_S = 3.0  # time after which unchanged rig time counts as standing still
STANDING = (states.RigWord.INACTIVE, states.RigWord.NO_PEER, states.RigWord.SILENT_PEER, states.RigWord.PAUSED)
"""States in which rig time stands still, or has not started."""
GAP_S = 10.0  # largest interval between two readings from which a speed is computed
KNOBS = (
    "barriers.gap_m", "sphere.present", "sphere.start", "contact.law", "contact.restitution", "pluck.displacement_m",
    "shaker.frequency_min_hz", "shaker.frequency_max_hz", "shaker.current_limit_a_rms", "shaker.travel_limit_m",
    "structure.natural_frequency_hz", "structure.damping_ratio", "time.mode", "time.factor", "drive.kind", PLANNED,
)  # fmt: skip
"""Parameters of the rig that the page shows."""
Answer = Callable[[bool, str], None]
"""Function that reports the result of a request to the page, as success and a text; called once, from any thread."""
DEAD_S = 4.0  # time after which a silent node counts as absent


@attrs.frozen
class Seen:
    """Last report of a node, and its age."""

    state: str = ""  # word of its table in `impact_rig.states`; empty if it reported none
    reason: str = ""
    instance: str = ""  # activation of the node that reported it
    age_s: float | None = None  # age of the report [s]; None if there was none
    ended: str = ""  # how its process ended; empty if it is running, or is not one of the lab
    figures: Mapping[str, str] = attrs.field(factory=dict)  # all keys in its diagnostics

    @classmethod
    def of(cls, node: str, figures: Mapping[str, str], age_s: float | None, ended: str = "") -> Seen:
        """Parse the keys of a node's diagnostics; an unknown word counts as no word."""
        state = figures.get("state", "")
        known = {one.value for one in states.BY_NODE[node]} if node in states.BY_NODE else set()
        word = state if state in known else ""
        return cls(word, figures.get("reason", ""), figures.get("instance", ""), age_s, ended, figures)

    @property
    def lives(self) -> bool:
        """Return whether the node has reported recently, and its process has not ended."""
        return not self.ended and self.age_s is not None and self.age_s <= DEAD_S

    def part(self) -> dict[str, Any]:
        """Return the report for the page."""
        return {
            "state": self.state, "reason": self.reason, "instance": self.instance, "lives": self.lives,
            "age": None if self.age_s is None else round(self.age_s), "gone": self.gone,
        }  # fmt: skip

    @property
    def gone(self) -> str:
        """Reason why a known node is gone; empty if it is alive, or was never seen."""
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
    """Return the overall state in one word and one sentence.

    Only the word `measured` means that a measurement applies: the analysis reports one, and there are no doubts.
    `doubts` are active faults, unsound channels, and changes since the measurement began.
    """
    if rig.ended:
        return "dead", f"The rig is gone: {rig.ended}."
    if rig.age_s is None:
        return "starting", "Waiting for the rig."
    if not rig.lives:
        return "dead", f"No report from the rig for {rig.age_s:.0f} s."
    if not rig.state:
        return "unknown", "The rig does not report its state; is it of another version?"
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
        why = (
            MEASURING.get(states.AnalysisWord(analysis.state), "")
            if analysis.state
            else ("the analysis reports no state")
        )
        why = why.format(reason=plain(analysis.reason) or "no reason given")
        return "driving", f"{capitalised(why)}."
    if doubts:
        return "driving", f"The analysis reports a measurement, but {'; '.join(doubts)}."
    return "measured", "The measurement applies to the present drive."


def capitalised(text: str) -> str:
    """Return a text with its first letter capitalised and the others unchanged."""
    return text[:1].upper() + text[1:]


class Pace:
    """Speed of rig time, from readings that arrive once or twice a second."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.speed = 0.0  # from the last two different readings
        self._read_at = self._rig_s = 0.0
        self._instance = ""

    @property
    def is_hurried(self) -> bool:
        """Return whether rig time runs faster than real time."""
        return self.speed > FAST_FACTOR

    @property
    def is_followed(self) -> bool:
        """Return whether the motion is slow enough to follow."""
        return self.speed <= FOLLOWED

    def read(self, rig_s: float, instance: str = "", *, stands: bool = False) -> float:
        """Add a reading of the rig time [s]; return the speed, or 0 if rig time stands still or should do so.

        Times of two activations, or of two rigs in one namespace, are unrelated.
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
    """Return the available choices.

    Laws, starts, and faults with their descriptions and whether they concern the whole board.
    """
    about = {name: info for name, info, _ in fields()}
    return {
        "law": list(about["contact.law"].choices),
        "start": list(about["sphere.start"].choices),
        "faults": {kind: _fault_form(kind) for kind in FAULT_KINDS},
        "channels": list(CHANNELS),
    }


SIZES = {"accelerometer": 5.0, "laser": 1e-3, "base": 1e-4, "current": 0.1}
"""Suggested fault sizes by channel unit: visible, but without a trip."""
NOISE = 0.1  # the same for the rms of noise, as a fraction of the suggested size
SIZE_NAMES = {
    "gain_error": "fraction",
    "added_noise": "rms",
    "saturation": "limit ±",
    "spike_train": "height ±",
    "offset_step": "step",
}


def _fault_form(kind: str) -> dict[str, Any]:
    """Return the form for a kind of fault: description, whether it has a channel, a rate, and a size by channel.

    A kind without `value` has no sizes. The channel of a fault of the whole board is empty. A size is shown in `unit`;
    one unit of the page is `scale` units of the rig.
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
    """Return a figure of the diagnostics as a number; None if it is invalid."""
    try:
        return None if value is None else float(value)
    except ValueError:
        return None


def present(rig: Seen, analysis: Seen, doubts: Sequence[str] = ()) -> dict[str, Any]:
    """Return whether the newest measurement applies now, and the progress of the next measurement.

    It applies if `judge` returns `measured` for the same arguments, and while such a rig is paused.
    """
    moves = rig.lives and rig.state in (states.RigWord.DRIVING, states.RigWord.PAUSED)
    known = analysis.state if analysis.lives and moves else ""
    figures = analysis.figures if known else {}
    return {
        "state": known, "holds": known == states.AnalysisWord.MEASURING and not doubts,
        "reason": plain(analysis.reason) if known else "", "done": figure(figures.get("settling_windows")),
        "of": figure(figures.get("settling_windows_needed")), "rest": figure(figures.get("settling_remnant")),
        "quiet": figure(figures.get("no_impact_s")), "quiet_of": figure(figures.get("no_impact_limit_s")),
    }  # fmt: skip


class Snapshot:
    """State in named parts, each of which has a version: a session sends the parts that are new to it."""

    def __init__(self) -> None:
        self._parts: dict[str, Any] = {}
        self._versions: dict[str, int] = {}
        self._lock = threading.Lock()
        self.version = 0

    def put(self, **parts: Any) -> None:
        """Set parts, all at once: a session sees all of them or none. An equal value is not new."""
        with self._lock:
            new = {name: part for name, part in parts.items() if name not in self._parts or self._parts[name] != part}
            if new:
                self.version += 1
                self._parts.update(new)
                self._versions.update(dict.fromkeys(new, self.version))

    def get(self, name: str) -> Any:
        """Return a part, or None if it does not exist yet."""
        return self._parts.get(name)

    def since(self, version: int) -> tuple[int, Mapping[str, Any]]:
        """Return the present version, and the parts changed after an earlier one."""
        with self._lock:
            return self.version, {name: self._parts[name] for name, at in self._versions.items() if at > version}


class Source(abc.ABC):
    """Rig or runs as the source of pages: a thread runs their requests, and updates snapshot and record.

    Args:
        mode: `live` or `playback`.
    """

    def __init__(self, mode: str, record: RigView) -> None:
        self.record = record
        self.snapshot = Snapshot()
        self.failures: dict[str, list[Any]] = {}  # failed parts of the work: their number, and the last reason
        self.watchers = 0  # number of open pages
        self._asked: queue.SimpleQueue[tuple[Request, Answer]] = queue.SimpleQueue()
        self.end = threading.Event()
        self.theory = Theory(lambda found: self.snapshot.put(prediction=found))
        self._thread = threading.Thread(target=self._run, name=f"lab-{mode}", daemon=True)
        self.snapshot.put(mode=mode, choices=choices(), help=glossary())

    @property
    def other(self) -> Scope | None:
        """Scans of a second run, shown next to the first."""
        return None

    @property
    @abc.abstractmethod
    def now_s(self) -> float:
        """Time that the page shows [s since scan 0]."""

    @abc.abstractmethod
    def _run(self) -> None:
        """Work until `end` is set; runs in the thread of this source."""

    def ask(self, request: Request, answer: Answer) -> None:
        """Run the request of a page in the thread of this source."""
        self._asked.put((request, answer))

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the thread."""
        self.end.set()
        if self._thread.is_alive():  # otherwise the cause of the failed start is raised
            self._thread.join()
        self.theory.close()

    def guard(self, what: str, work: Callable[[], T]) -> T | None:
        """Run a part of a turn. If it fails, count the failure and continue, because STOP is sent from this loop."""
        return guard(self.failures, what, work)

    def tell(self, parts: Mapping[str, Callable[[], Any]], values: Mapping[str, Any]) -> None:
        """Update the snapshot; a part that fails does not prevent the update of the others.

        Args:
            parts: functions that return the parts; `applied`, `dt` and `dt_now` are among the names.
            values: the rig's parameters by name, for the theory; empty if unknown.
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
    """Return the meaning of each word that a page may show: states, statuses, regimes, laws, faults, figures."""
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
