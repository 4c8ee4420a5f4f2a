# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The playback source: one recorded run on the page, or two side by side; its knobs are those of the recording."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any  # values of parameters

from impact_rig.lab import parts
from impact_rig.lab.deeds import KNOBS
from impact_rig.lab.motion import Motion
from impact_rig.lab.protocol import Request
from impact_rig.lab.reel import Reel
from impact_rig.lab.scope import Scope
from impact_rig.lab.source import Answer, Snapshot
from impact_rig.lab.theory import Theory
from impact_rig.simtime import NS_PER_S

TICK_S = 0.025
TELL_S = 0.1
MARKS_S = 1.0
PEEK_S = 0.05
"""An impact that is jumped to stands this much before the end of the picture."""


class PlaybackSource:
    """Plays runs.

    Args:
        paths: of one run, or of two: the second is drawn beside the first.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self.snapshot = Snapshot()
        self.lock = threading.Lock()
        self.epoch = 0
        self.now_s = 0.0
        self._reels: list[Reel] = []
        try:
            for path in paths:
                self._reels.append(Reel(path))
        except BaseException:
            for reel in self._reels:
                reel.close()
            raise
        self._playing, self._speed = True, 1.0
        self._asked: queue.SimpleQueue[tuple[Request, Answer]] = queue.SimpleQueue()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="lab-playback", daemon=True)
        self._watchers = 0
        self._theory = Theory(lambda found: self.snapshot.put("prediction", found))
        self._begin_s = min(reel.begin_s for reel in self._reels)
        self._end_s = max(reel.end_s for reel in self._reels)
        self.snapshot.put("mode", "playback")
        self.snapshot.put("choices", parts.choices())
        self._move(self._begin_s)

    @property
    def scope(self) -> Scope | None:
        """The scans before the instant shown."""
        return self._reels[0].scope

    @property
    def other(self) -> Scope | None:
        """Those of the second run."""
        return self._reels[1].scope if len(self._reels) > 1 else None

    @property
    def motion(self) -> Motion:
        """The true motion before it."""
        return self._reels[0].motion

    def watched(self, count: int) -> None:
        """Know how many pages look: nothing is played to nobody."""
        self._watchers = count

    def ask(self, request: Request, answer: Answer) -> None:
        """Do what a page asks for."""
        self._asked.put((request, answer))

    def start(self) -> None:
        """Begin."""
        for reel in self._reels:
            reel.start()
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join()
        self._theory.close()
        for reel in self._reels:
            reel.close()

    def __enter__(self) -> PlaybackSource:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        before = time.monotonic()
        told = marked = 0.0
        while not self._end.wait(TICK_S):
            self._obey()
            now = time.monotonic()
            if self._playing and self._watchers:
                self._play(self.now_s + (now - before) * self._speed)
            before = now
            if now - told >= TELL_S:
                told = now
                self._tell()
            if now - marked >= MARKS_S:
                marked = now
                self.snapshot.put("impact_marks", self._reels[0].histogram())

    def _play(self, until_s: float) -> None:
        with self.lock:
            self.now_s = min(until_s, self._end_s)
            for reel in self._reels:
                reel.play(self.now_s)
        if self.now_s >= self._end_s:
            self._playing = False

    def _move(self, to_s: float) -> None:
        with self.lock:
            self.now_s = min(max(to_s, self._begin_s), self._end_s)
            for reel in self._reels:
                reel.jump(self.now_s)
            self.epoch += 1

    # What pages ask for

    def _obey(self) -> None:
        """Do what is asked; of several jumps that wait only the last one."""
        asked: list[tuple[Request, Answer]] = []
        while not self._asked.empty():
            asked.append(self._asked.get())
        jumps = [number for number, (request, _) in enumerate(asked) if request.do == "seek"]
        for number, (request, answer) in enumerate(asked):
            if request.do == "seek" and number != jumps[-1]:
                answer(True, "")
                continue
            self._do(request, answer)

    def _do(self, request: Request, answer: Answer) -> None:
        value = request.values.get("value")
        match request.do:
            case "play":
                if value and self.now_s >= self._end_s:
                    self._move(self._begin_s)
                self._playing = bool(value)
            case "pause":
                self._playing = not value
            case "speed":
                self._speed = float(value or 1.0)
            case "seek":
                self._move(float(value or 0.0))
            case "next_impact":
                found = self._reels[0].impact_after(self.now_s - PEEK_S, float(value or 1.0))
                if found is None:
                    answer(False, "there is no further impact in what was read so far")
                    return
                self._playing = False
                self._move(found + PEEK_S)
            case _:
                answer(False, f"{request.do}: a recorded run cannot be changed")
                return
        self._tell()
        answer(True, "")

    # What pages are told

    def _tell(self) -> None:
        reel, put = self._reels[0], self.snapshot.put
        knobs = reel.knobs(self.now_s)
        applied = knobs.pop("applied", None) or {"frequency": 0.0, "current": 0.0}
        word, words = self._state(knobs, applied)
        put("rig", {
            "word": word, "text": words, "name": reel.path.name, "age": 0, "time": round(self.now_s, 2),
            "speed": self._speed if self._playing else 0.0, "mode": "playback", "own": False, "over": {},
        })  # fmt: skip
        put("applied", applied)
        put("knobs", {name: knobs.get(name) for name in KNOBS})
        if self._watchers:
            self._theory.want(knobs, applied["current"])
        at = reel.start_ns + round(self.now_s * NS_PER_S)
        for part, one in (("dt", self._reels[0]), ("dt_b", self._reels[-1])):
            if part == "dt" or len(self._reels) > 1:
                put(part, [row for row in one.curve.part(one.start_ns) if row["t"] <= self.now_s])
        put("closed_form", parts.closed_form(knobs))
        put("journal", reel.ledger.part(reel.start_ns))
        settled = any(row["settled"] and row["t"] * NS_PER_S + reel.start_ns <= at for row in self.snapshot.get("dt"))
        put("settling", {"done": None, "of": None, "rest": None, "word": "driving" if settled else "", "refusal": ""})
        put("recorder", {"there": True, "text": "", "name": reel.path.name, "level": 0, "megabytes": None})
        put("playback", {
            "begin": self._begin_s, "end": self._end_s, "now": round(self.now_s, 3), "playing": self._playing,
            "speed": self._speed, "read": 1.0 if reel.whole else round(reel.read_s / max(self._end_s, 1e-3), 2),
            "names": [one.path.name for one in self._reels],
        })  # fmt: skip

    def _state(self, knobs: dict[str, Any], applied: dict[str, float]) -> tuple[str, str]:
        names = " and ".join(reel.path.name for reel in self._reels)
        if any(reel.recovered for reel in self._reels):
            names += " (cut short: what is whole is shown)"
        if knobs.pop("latched"):
            found = "the shaker was latched"
        elif knobs.pop("plucked", False):
            found = "the base was locked after a pluck"
        elif applied["current"]:
            found = f"driven at {applied['frequency']:g} Hz, {applied['current']:g} A"
        else:
            found = "at rest"
        knobs.pop("plucked", None)
        return ("playback" if self._playing else "paused playback"), f"{names}: {found}."
