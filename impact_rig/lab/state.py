# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What pages are told, live and in playback alike: each node's state from its keys, journal, faults and curve.

States come from the keys of `impact_rig.states` alone: no sentence is read. What was never said, or too long ago, is
not shown as present. Times are seconds since scan 0; what came before it is negative.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any  # what goes to JSON

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import states
from impact_rig.analysis.words import MEASURED, Status
from impact_rig.blocks import Table
from impact_rig.errors import RecordingError
from impact_rig.instruments.instrument import BOARD_KINDS, FAULT_KINDS
from impact_rig.instruments.section import CHANNELS
from impact_rig.physics.contact import LAWS
from impact_rig.rig.config import fields
from impact_rig.simtime import NS_PER_S

MOST_ROWS = 400
MOST_ENTRIES = 300
QUIET = frozenset({"initial"})
"""Kinds of journal rows that are no events."""
JOINED = "more"
HURRIED = 1.5
"""Speed from which on pictures come now and then: nobody sees every cycle, and rig and analysis need the machine."""
FOLLOWED = 4.5
"""Speed up to which the motion is drawn: beyond it nobody can follow, and publishing it costs the rig a tenth."""
STALE_S = 3.0
"""Rig time that has not moved for so long stands still."""
GAP_S = 10.0
"""Two readings further apart say nothing about the speed between them."""
ACCELEROMETER = {Status.ACCELEROMETER_OVER_RANGE.value: "accelerometer"}
"""Statuses that name their channel themselves."""
PLANNED = "instruments.faults.planned"
KNOBS = (
    "barriers.gap_m", "sphere.present", "sphere.start", "contact.law", "contact.restitution", "pluck.displacement_m",
    "shaker.frequency_min_hz", "shaker.frequency_max_hz", "shaker.current_limit_a_rms", "shaker.travel_limit_m",
    "structure.natural_frequency_hz", "structure.damping_ratio", "time.mode", "time.factor", "drive.kind", PLANNED,
)  # fmt: skip
"""Parameters of the rig that the page shows."""
HIGHEST_RATE_HZ = 1e7
LONGEST_RUN_S = 1e9
DEAD_S = 4.0
"""A node that has said nothing for so long is not there."""
UNITS = {"frequency": "Hz", "current": "A", "over_travel": "m", "over_current": "A"}


def text(raw: Any) -> str:
    """Return the text in a column."""
    return bytes(raw).rstrip(b"\0").decode("utf-8", errors="replace")


@attrs.frozen
class Seen:
    """What a node has said of itself last, and how long ago.

    Attributes:
        state: word of its table in `impact_rig.states`; empty: it said none of them.
        reason: why, for people.
        instance: which activation of the node said it.
        age_s: since it was heard [s]; None: it never was.
        ended: how its process ended; empty: it runs, or is not ours.
        figures: all keys it publishes.
    """

    state: str = ""
    reason: str = ""
    instance: str = ""
    age_s: float | None = None
    ended: str = ""
    figures: Mapping[str, str] = attrs.field(factory=dict)

    @classmethod
    def of(cls, node: str, figures: Mapping[str, str], age_s: float | None, ended: str = "") -> Seen:
        """Return what the keys of a node say; a word that is not of its table counts as none."""
        state = figures.get("state", "")
        known = {one.value for one in states.BY_NODE[node]} if node in states.BY_NODE else set()
        word = state if state in known else ""
        return cls(word, figures.get("reason", ""), figures.get("instance", ""), age_s, ended, figures)

    @property
    def lives(self) -> bool:
        """Whether it was heard of a short while ago, and its process has not ended."""
        return not self.ended and self.age_s is not None and self.age_s <= DEAD_S

    def part(self) -> dict[str, Any]:
        """Return it for the page."""
        return {
            "state": self.state, "reason": self.reason, "instance": self.instance, "lives": self.lives,
            "age": None if self.age_s is None else round(self.age_s), "gone": self.gone,
        }  # fmt: skip

    @property
    def gone(self) -> str:
        """Return how a node that was there has gone; empty: it lives, or never was."""
        if self.ended:
            return self.ended
        return "" if self.age_s is None or self.lives else f"silent for {self.age_s:.0f} s"


SENTENCES = {
    states.Rig.INACTIVE: "Not running: {reason}.",
    states.Rig.RIVAL: "Two rigs in one namespace drive each other's shaker: {reason}.",
    states.Rig.NO_PEER: "Rig time stands still: {reason}.",
    states.Rig.SILENT_PEER: "Rig time stands still: {reason}.",
    states.Rig.TRIPPED: "The shaker is latched by {reason}; its current is zero.",
    states.Rig.PAUSED: "Rig time stands still.",
    states.Rig.PLUCKED: "Base locked, structure swings freely; reset unlocks it.",
    states.Rig.AT_REST: "The shaker is at rest: press R for 9.1 Hz, 0.52 A.",
}
MEASURING = {
    states.Analysis.INACTIVE: "the analysis is not active",
    states.Analysis.NO_SCANS: "the analysis gets no scans",
    states.Analysis.LOST_SCANS: "the analysis has lost scans and begins anew",
    states.Analysis.UNABLE: "DT cannot be measured now: {reason}",
    states.Analysis.AT_REST: "the analysis has not seen the drive yet",
}


def judge(rig: Seen, analysis: Seen, doubts: Sequence[str] = ()) -> tuple[str, str]:
    """Return the state of the whole in one word and one sentence.

    The word is `measured`, the only one that says that a measurement holds, where the analysis says so and nothing
    speaks against it.

    Args:
        rig: what the rig says.
        analysis: what the analysis says.
        doubts: what speaks against a measurement: faults in force, channels that are not well.
    """
    if rig.ended:
        return "dead", f"The rig is gone: {rig.ended}."
    if rig.age_s is None:
        return "starting", "Waiting for the rig."
    if not rig.lives:
        return "dead", f"Nothing was heard of the rig for {rig.age_s:.0f} s."
    if not rig.state:
        return "unknown", "The rig does not say its state: is it of another version?"
    if rig.state != states.Rig.DRIVING:
        sentence = SENTENCES[states.Rig(rig.state)].format(reason=plain(rig.reason) or "it does not say why")
        return plain(rig.state), sentence
    if not analysis.lives:
        why = f"the analysis is gone ({analysis.gone})" if analysis.gone else "there is no analysis"
        return "driving", f"Nobody measures: {why}."
    if analysis.state == states.Analysis.SETTLING:
        return "settling", "Waiting until the transient has died."
    if analysis.state != states.Analysis.MEASURING:
        why = MEASURING.get(states.Analysis(analysis.state), "") if analysis.state else "the analysis says no state"
        why = why.format(reason=plain(analysis.reason) or "it does not say why")
        return "driving", f"{why[:1].upper()}{why[1:]}."
    if doubts:
        return "driving", f"The analysis calls it measured, but {'; '.join(doubts)}."
    return "measured", "The measurement holds."


def plain(word: str) -> str:
    """Return a key as people write it."""
    return word.replace("_", " ")


class JournalView:
    """The journal, faults and remarks, as lines for people."""

    def __init__(self) -> None:
        self._lines: deque[list[Any]] = deque(maxlen=MOST_ENTRIES)
        self._part: tuple[int, list[list[Any]]] | None = None

    def add(self, table: Table) -> None:
        """Take a table of `rig/journal`."""
        self._part = None
        for row in table.rows:
            kind, key, value, words = text(row["kind"]), text(row["key"]), float(row["value"]), text(row["text"])
            if kind in QUIET:
                continue
            if kind == JOINED and not self._lines:
                continue  # of a change that nobody was there to hear
            if kind == JOINED and (not key or key == self._lines[-1][2]):  # one more part of a text
                self._lines[-1][3] += words
                continue
            kind = "parameter" if kind == JOINED else kind
            self._lines.append([table.stamp_ns, kind, key, words or _value(kind, key, value)])

    def remark(self, words: str, stamp_ns: int) -> None:
        """Take an operator's remark."""
        self._part = None
        self._lines.append([stamp_ns, "note", "", words[:200]])

    def fault(self, table: Table) -> None:
        """Take a table of `truth/faults`."""
        self._part = None
        for row in table.rows:
            what = f"{text(row['kind'])} {text(row['channel'])}".strip()
            self._lines.append([table.stamp_ns, "fault", "begins" if row["active"] else "ends", what])

    def part(self, start_ns: int) -> list[list[Any]]:
        """Return time, kind, key, words of every line, in order; the same list while nothing is new."""
        if self._part is None or self._part[0] != start_ns:
            found = sorted(self._lines, key=lambda line: line[0])
            self._part = start_ns, [[round((stamp - start_ns) / NS_PER_S, 3), *words] for stamp, *words in found]
        return self._part[1]


class Faults:
    """Instrument faults, of `truth/faults`: which are in force, now or at an instant."""

    def __init__(self) -> None:
        self._rows: deque[tuple[int, int, bool, str]] = deque(maxlen=MOST_ENTRIES)

    def add(self, table: Table) -> None:
        """Take a table of `truth/faults`."""
        for row in table.rows:
            what = f"{plain(text(row['kind']))} {text(row['channel'])}".strip()
            stamp = table.stamp_ns + round(float(row["time"]) * NS_PER_S)
            self._rows.append((stamp, int(row["id"]), bool(row["active"]), f"{what} ({float(row['value']):g})"))

    def in_force(self, start_ns: int, at_ns: int | None = None) -> list[str]:
        """Return the faults that are in force, in words.

        Args:
            start_ns: stamp of scan 0; a fault of before belongs to another record.
            at_ns: an instant; None: after everything that was heard.
        """
        active: dict[int, str] = {}
        for stamp, number, begins, words in self._rows:
            if stamp < start_ns or (at_ns is not None and stamp > at_ns):
                continue
            if begins:
                active[number] = words
            else:
                active.pop(number, None)
        return list(active.values())


def _value(kind: str, key: str, value: float) -> str:
    if kind in ("command", "trip"):
        return f"{value:.6g} {UNITS.get(key, '')}".strip()
    if kind in ("parameter", "clear_fault"):
        return f"{value:.6g}"
    return f"{value * 1e3:.4g} mm" if kind == "pluck" else ""


class Pace:
    """Seconds of rig time per second, from readings that come once or twice a second.

    Args:
        clock: monotonic clock [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.speed = 0.0
        """At the last two different readings."""
        self._read_at = self._rig_s = 0.0

    @property
    def is_hurried(self) -> bool:
        """Whether rig time runs ahead of ours."""
        return self.speed > HURRIED

    @property
    def is_followed(self) -> bool:
        """Whether somebody could follow the motion."""
        return self.speed <= FOLLOWED

    def read(self, rig_s: float) -> float:
        """Take a reading of rig time [s]; return the speed, 0 where it stands still."""
        now = self._clock()
        if rig_s == self._rig_s:
            return 0.0 if now - self._read_at > STALE_S else self.speed
        if rig_s > self._rig_s and self._read_at and now - self._read_at < GAP_S:
            self.speed = (rig_s - self._rig_s) / (now - self._read_at)
        self._read_at, self._rig_s = now, rig_s
        return self.speed


class Curve:
    """The measurements of the transmissibility."""

    def __init__(self) -> None:
        self._rows: deque[tuple[int, dict[str, Any]]] = deque(maxlen=MOST_ROWS)
        self.statuses: deque[tuple[int, str, str]] = deque(maxlen=MOST_ROWS)
        """Stamp, status and the channel it is about of every row, those without numbers too."""
        self._part: tuple[int, list[dict[str, Any]]] | None = None

    def add(self, table: Table) -> None:
        """Take a table of `transmissibility/table`."""
        for row in table.rows:
            status = text(row["status"])
            channel = text(row["channel"]) if "channel" in row.dtype.names else ""
            self.statuses.append((table.stamp_ns, status, ACCELEROMETER.get(status, channel)))
            if status in MEASURED:
                self._rows.append((table.stamp_ns, _measurement(row)))
                self._part = None

    def health(self, at_ns: int | None = None) -> dict[str, str] | None:
        """Return what the newest row, or that of an instant, says against a channel, in words.

        None: there is no row, so nothing is known; empty: it says nothing against any.
        """
        rows = [row for row in self.statuses if at_ns is None or row[0] <= at_ns]
        if not rows:
            return None
        _, status, channel = rows[-1]
        return {channel: plain(status)} if channel and status not in (Status.OK, Status.NOT_SETTLED) else {}

    def part(self, start_ns: int) -> list[dict[str, Any]]:
        """Return the rows, oldest first; the same list while nothing is new."""
        if self._part is None or self._part[0] != start_ns:
            found = [{"t": round((stamp - start_ns) / NS_PER_S, 3), **row} for stamp, row in self._rows]
            self._part = start_ns, found
        return self._part[1]


def _measurement(row: NDArray[np.void]) -> dict[str, Any]:
    return {
        "f": float(row["frequency"]),
        "dt": float(row["transmissibility"]),
        "u": float(row["transmissibility_uncertainty"]),
        "phase": math.degrees(float(row["phase"])),
        "settled": bool(row["settled"] == 1.0),
        "gap": float(row["gap"]),
        "ipc": float(row["impacts_per_cycle"]),
        "x1": float(row["laser_amplitude"]),
        "xb": float(row["base_amplitude"]),
        "i": float(row["current_amplitude"]),
        "spread": float(row["spread"]),
        "period": float(row["period"]),
        "thd": float(row["thd"]),
        "regime": text(row["regime"]),
        "status": "" if text(row["status"]) == Status.OK else plain(text(row["status"])),
    }


def start_ns(info: Table) -> int:
    """Return the stamp of scan 0, of a table of `daq/info`.

    Raises:
        RecordingError: it does not say when that was.
    """
    since_s = float(info.rows["since_start"][0]) if len(info.rows) else math.nan
    if not 0.0 <= since_s < LONGEST_RUN_S:
        raise RecordingError(f"daq/info says that scan 0 was {since_s:g} s before it")
    return info.stamp_ns - round(since_s * NS_PER_S)


def scan_rate(info: Table) -> float:
    """Return the scans per second, of a table of `daq/info`.

    Raises:
        RecordingError: it is no rate that a board can have: rings are as long as the rate says.
    """
    rate_hz = float(info.rows["rate"][0]) if len(info.rows) else math.nan
    if not 1.0 <= rate_hz <= HIGHEST_RATE_HZ:
        raise RecordingError(f"daq/info has a rate of {rate_hz:g} Hz; 1 to {HIGHEST_RATE_HZ:g} Hz can be shown")
    return rate_hz


def closed_form(values: dict[str, Any]) -> list[list[float]]:
    """Return frequency and transmissibility of the rig without the sphere, for the curve's background.

    Args:
        values: parameters by name; needs natural frequency and damping ratio of the structure.
    """
    natural, damping = values.get("structure.natural_frequency_hz"), values.get("structure.damping_ratio")
    if not natural or not damping:
        return []
    frequency = np.unique(np.concatenate([np.linspace(5.0, 14.0, 181), natural + np.linspace(-0.6, 0.6, 121)]))
    ratio = frequency / natural
    loss = 2.0j * damping * ratio
    found = np.abs((1.0 + loss) / (1.0 - ratio**2 + loss))
    return [[round(float(f), 4), round(float(v), 4)] for f, v in zip(frequency, found, strict=True)]


def choices() -> dict[str, Any]:
    """Return what can be chosen: laws, starts, faults with their words and whether they concern the whole board."""
    about = {name: info for name, info, _ in fields()}
    return {
        "law": list(about["contact.law"].choices),
        "start": list(about["sphere.start"].choices),
        "faults": {kind: [words, kind in BOARD_KINDS] for kind, words in FAULT_KINDS.items()},
        "channels": list(CHANNELS),
    }


def figure(value: str | None) -> float | None:
    """Return a figure of the diagnostics as a number; None: it is none."""
    try:
        return None if value is None else float(value)
    except ValueError:
        return None


def present(rig: Seen, analysis: Seen) -> dict[str, Any]:
    """Return whether the newest measurement holds now, and how far the next one is.

    Args:
        rig: what the rig says.
        analysis: what the analysis says; without it nothing holds.
    """
    moves = rig.lives and rig.state in (states.Rig.DRIVING, states.Rig.PAUSED)
    known = analysis.state if analysis.lives and moves else ""
    figures = analysis.figures
    return {
        "state": known, "holds": known == states.Analysis.MEASURING, "reason": plain(analysis.reason) if known else "",
        "done": figure(figures.get("settling_windows")), "of": figure(figures.get("settling_windows_needed")),
        "rest": figure(figures.get("settling_remnant")),
    }  # fmt: skip


def glossary() -> dict[str, str]:
    """Return what each word means that a page may show: states, statuses, regimes, laws, faults, figures."""
    laws = {plain(name): f"Contact law. {(law.__doc__ or '').splitlines()[0]}" for name, law in LAWS.items()}
    faults = {plain(kind): f"Fault of an instrument: {words}." for kind, words in FAULT_KINDS.items()}
    words: dict[str, str] = {}
    for node, table in states.BY_NODE.items():
        for word in table:
            told = f"Of the {plain(node)}: {word.doc}."
            words[plain(word)] = f"{words[plain(word)]} {told}" if plain(word) in words else told
    return {**laws, **faults, **words, **GLOSSARY}


GLOSSARY = {
    # the bar
    "rig time": "Time of the rig's scan clock since scan 0.",
    "speed": "Seconds of rig time per second.",
    "recording": "The run that is being recorded, and its size so far.",
    "lost blocks": "Blocks of scans that a fault withheld, that the analysis missed, or that the recorder missed.",
    "channels": "What the analysis says of the channels it measures with.",
    "faults in force": "Instrument faults that act now, as the rig tells the truth of it; no analysis sees them.",
    "status": "What else is to be known of the value.",
    "refused messages": "Messages on the rig's topics that made no sense; each costs itself alone.",
    # states of the page
    "offline": "The lab's server does not answer: what is shown is old.",
    "dead": "The rig's process has ended, or nothing was heard of the rig for 4 s.",
    "starting": "The rig was not heard of yet.",
    "choose": "Several rigs are running.",
    "unknown": "The rig does not say its state.",
    "playback": "A recorded run is played.",
    "paused playback": "A recorded run stands still.",
    "measured": "The analysis says that its newest value holds for the present drive, and nothing speaks against it.",
    # the measurement
    "at": "Drive frequency of the value.",
    "last, at": "Drive frequency of the last value, which does not hold now.",
    "phase": "Phase of the superior base's motion relative to the inferior base's.",
    "regime": "What the response of the structure does from cycle to cycle.",
    "periodic": "The response repeats after whole drive cycles.",
    "modulated": "The response has a few spectral lines beside the drive.",
    "chaotic": "The response has a continuous spectrum; DT is its coherent mean.",
    "no impacts at this gap": "The sphere lies or moves between the walls without striking them.",
    "impacts per cycle": "Impacts detected by the accelerometer per cycle of the drive.",
    "|X₁|": "Amplitude of the superior base, from the laser.",
    "|X_b|": "Amplitude of the inferior base, from its displacement sensor.",
    "law": "The contact law: how sphere and wall exchange momentum and lose energy.",
    "restitution": "Speed after an impact over speed before, as the law is told; what it returns may differ.",
    "gap": "Free play of the sphere between the walls.",
    "frequency": "Frequency of the drive.",
    "current": "Amplitude of the coil's current, peak.",
    "sphere at": "Where the sphere lies after a reset or a change of the gap.",
    # statuses of a row
    "ok": "A measurement.",
    "accelerometer over range": "The displacements are sound, the impacts may not be.",
    "not settled": "The longest wait is over and the response still changes: numbers are given, DT may drift.",
    "over range": "A displacement or the current was at or beyond the range of its channel.",
    "command changed": "Frequency or current changed while it was measured.",
    "label changed": "The gap was set anew while it was measured.",
    "calibration changed": "The calibration changed while it was measured.",
    "restarted": "The scans began anew.",
    "not finite": "A scan was no number.",
    "no frequency": "There is no drive frequency to measure at.",
    "too few cycles": "The record holds too few cycles of the drive.",
    "silence": "Neither base nor structure moves measurably.",
    "no signal": "A channel shows no vibration above its noise while another does.",
    "too uncertain": "Noise or scatter leave more doubt than a measurement may have.",
    "below resolution": "The vibration is too small for the steps of a sensor or of the converter.",
    "spikes": "A channel jumps and returns from scan to scan, as neither vibration nor noise does.",
    "level jump": "A channel jumps and stays there: a step of its zero.",
    "noisy": "The noise of a channel is far above that of its calibration.",
    "implausible": "A channel contradicts the others, or has changed while they have not.",
    "accelerometer unsound": "The accelerometer is dead, or contradicts the laser: the displacements are sound.",
    "intermittent": "Impacts came and stay away: the sphere may be drifting towards the next.",
    "constant": "One displacement channel stands still while the other moves: stuck, or its cable open.",
    "swapped channels": "Laser and base look exchanged.",
    "inverted channel": "Laser or base is wired the wrong way round: the structure seems to lead its base.",
    "no fit": "A fit did not converge, or to something unphysical.",
    "impacts": "A free decay with impacts: its damping is not that of the structure.",
    "not exponential": "A free decay whose halves decay at different rates: no single damping ratio describes it.",
}
