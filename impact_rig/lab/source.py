# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a session draws from: a source of scans, motion and a snapshot, live or played back."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from typing import Any, Protocol  # Any: what the snapshot holds goes to JSON

from impact_rig.lab.motion import Motion
from impact_rig.lab.protocol import Request
from impact_rig.lab.scope import Scope

Answer = Callable[[bool, str], None]
"""Tells the page whether what it asked for was done, and in which words; may be called from any thread, once."""


GENTLE = 10
"""Priority (nice) of the lab's threads: on a busy machine pictures are late, not blocks."""


def be_gentle() -> None:
    """Lower the priority of the calling thread, and of those it will begin."""
    thread = threading.get_native_id()
    os.setpriority(os.PRIO_PROCESS, thread, max(GENTLE, os.getpriority(os.PRIO_PROCESS, thread)))


class Snapshot:
    """The state of things in named parts, each with a version: a session sends the parts that are new to it."""

    def __init__(self) -> None:
        self._parts: dict[str, Any] = {}
        self._versions: dict[str, int] = {}
        self._lock = threading.Lock()
        self.version = 0

    def put(self, name: str, value: Any) -> None:
        """Set a part; nothing happens where it is the same."""
        with self._lock:
            if name in self._parts and self._parts[name] == value:
                return
            self.version += 1
            self._parts[name], self._versions[name] = value, self.version

    def get(self, name: str) -> Any:
        """Return a part, None where there is none yet."""
        return self._parts.get(name)

    def since(self, version: int) -> tuple[int, Mapping[str, Any]]:
        """Return the present version, and the parts that have changed after an earlier one."""
        with self._lock:
            return self.version, {name: self._parts[name] for name, at in self._versions.items() if at > version}


class Source(Protocol):
    """A rig, or a run."""

    snapshot: Snapshot

    @property
    def scope(self) -> Scope | None:
        """The newest scans."""

    @property
    def other(self) -> Scope | None:
        """Those of a second run, shown beside the first."""

    @property
    def motion(self) -> Motion:
        """The newest true motion."""

    @property
    def lock(self) -> threading.Lock:
        """Held while scope and motion are written or read."""

    @property
    def now_s(self) -> float:
        """Instant the page shows [s since scan 0]."""

    @property
    def epoch(self) -> int:
        """Counts resets and jumps: what was drawn before belongs to another record."""

    def watched(self, count: int) -> None:
        """Know how many pages are looking."""

    def ask(self, request: Request, answer: Answer) -> None:
        """Do what a page asks for; returns at once."""
