# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The parts of the snapshot, made of tables and figures: what live and played-back pages have in common.

Times are seconds since scan 0; what came before it is negative.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any  # what goes to JSON

import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.words import MEASURED, Status
from impact_rig.blocks import Table
from impact_rig.instruments.fault_kinds import BOARD_KINDS, FAULT_KINDS
from impact_rig.instruments.scan import CHANNELS
from impact_rig.rig.config import fields
from impact_rig.simtime import NS_PER_S

MOST_ROWS = 400
MOST_ENTRIES = 300
QUIET = frozenset({"initial"})
"""Kinds of journal rows that are no events."""
JOINED = "more"
WORDS = {
    "over_travel": "over-travel of the table",
    "over_current": "over-current of the coil",
}
UNITS = {"frequency": "Hz", "current": "A", "over_travel": "m", "over_current": "A"}


def text(raw: Any) -> str:
    """Return the text in a column."""
    return bytes(raw).rstrip(b"\0").decode("utf-8", errors="replace")


class Ledger:
    """The journal and remarks, as lines for people."""

    def __init__(self) -> None:
        self._lines: deque[list[Any]] = deque(maxlen=MOST_ENTRIES)
        self.tripped = ""
        """What has latched the shaker; empty: it is free."""
        self.plucked = False
        self.changed_ns = 0
        """Stamp of the last input that changed what the rig does."""
        self._part: tuple[int, list[list[Any]]] | None = None

    def add(self, table: Table) -> None:
        """Take a table of `rig/journal`."""
        self._part = None
        for row in table.rows:
            kind, key, value, words = text(row["kind"]), text(row["key"]), float(row["value"]), text(row["text"])
            self._remember(kind, key, value, table.stamp_ns)
            if kind in QUIET:
                continue
            if kind == JOINED:
                if words and self._lines:
                    self._lines[-1][3] += f" {words}" if not self._lines[-1][3] else words
                continue
            self._lines.append([table.stamp_ns, kind, key, words or _value(kind, key, value)])

    def _remember(self, kind: str, key: str, value: float, stamp_ns: int) -> None:
        if kind in ("start", "reset"):
            self.tripped, self.plucked = "", False
        elif kind == "trip":
            self.tripped = f"{WORDS.get(key, key)} ({_value(kind, key, value)})"
        elif kind == "stop":
            self.tripped = "the emergency stop"
        elif kind == "clear_trip":
            self.tripped = ""
        elif kind == "pluck":
            self.plucked = True
        if kind not in QUIET:
            self.changed_ns = max(self.changed_ns, stamp_ns)

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


def _value(kind: str, key: str, value: float) -> str:
    if kind in ("command", "trip"):
        return f"{value:.6g} {UNITS.get(key, '')}".strip()
    if kind in ("parameter", "clear_fault"):
        return f"{value:.6g}"
    return f"{value * 1e3:.4g} mm" if kind == "pluck" else ""


class Curve:
    """The measurements of the transmissibility."""

    def __init__(self) -> None:
        self._rows: deque[tuple[int, dict[str, Any]]] = deque(maxlen=MOST_ROWS)
        self.refusal = ""
        """Why the newest row is no measurement; empty: it is one."""
        self._part: tuple[int, list[dict[str, Any]]] | None = None

    def add(self, table: Table) -> None:
        """Take a table of `transmissibility/table`."""
        for row in table.rows:
            status = text(row["status"])
            self.refusal = "" if status in MEASURED else status
            if status in MEASURED:
                self._rows.append((table.stamp_ns, _measurement(row)))
                self._part = None

    def settled_since(self, stamp_ns: int) -> bool:
        """Return whether something has settled after an instant."""
        return any(row["settled"] for at, row in self._rows if at > stamp_ns)

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
        "status": "" if text(row["status"]) == Status.OK else text(row["status"]).replace("_", " "),
    }


def start_ns(info: Table) -> int:
    """Return the stamp of scan 0, of a table of `daq/info`."""
    return info.stamp_ns - round(float(info.rows["since_start"][0]) * NS_PER_S)


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
