# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The truth beside the instruments: true states at scan instants, and contacts, kept until their block is cut.

Instants are reckoned in whole ticks and a remainder, so nothing depends on how the simulation was cut into calls.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import IMPACTS, TRUTH_SCAN, joined
from impact_rig.physics import Motion
from impact_rig.simtime import COMMAND_GRID_NS, COMMAND_GRID_S, NS_PER_S

TICKS_PER_S = NS_PER_S // COMMAND_GRID_NS

_NO_STATES = np.empty(0, TRUTH_SCAN)
_NO_IMPACTS = np.empty(0, IMPACTS)
_NO_SCANS = np.empty(0, np.int64)
_QUANTITIES = (TRUTH_SCAN.names or ())[1:]
_IMPACT_COLUMNS = [name for name in IMPACTS.names or () if name != "time"]


def monitor_step(rate_hz: int, monitor_hz: float) -> int:
    """Return how many scans lie between two monitor instants: the nearest whole number from above."""
    return max(1, math.ceil(rate_hz / monitor_hz - 1e-9))


class Truth:
    """Collects the truth of simulated ticks and gives it out by scans.

    Args:
        monitor_hz: wanted rate of the monitor; every k-th scan is taken, k the nearest from above.
        every_scan: keep the truth of every scan, not of the monitor instants only.
    """

    def __init__(self, rate_hz: int, monitor_hz: float, every_scan: bool) -> None:
        self._rate_hz = rate_hz
        self._states: list[NDArray[np.void]] = []
        self.configure(monitor_hz, every_scan)
        self._impacts: list[NDArray[np.void]] = []  # time: since scan 0; ends beside it
        self._ends: list[NDArray[np.float64]] = []
        self._first_end_s = math.inf

    def configure(self, monitor_hz: float, every_scan: bool) -> None:
        """Change what is kept, from the next tick on."""
        self.monitor_step = monitor_step(self._rate_hz, monitor_hz)
        self.every_scan = every_scan
        if not every_scan:
            self._states = [rows[rows["time"] % self.monitor_step == 0.0] for rows in self._states]

    @property
    def _step(self) -> int:
        return 1 if self.every_scan else self.monitor_step

    def take(self, motion: Motion, tick_s: float) -> None:
        """Keep what is wanted of simulated ticks, of `tick_s` seconds each."""
        self._take_states(motion, tick_s)
        self._take_impacts(motion, tick_s)

    def _take_states(self, motion: Motion, tick_s: float) -> None:
        step = self._step
        first, end = (-(-tick * self._rate_hz // TICKS_PER_S) for tick in (motion.first_tick, motion.last_tick + 1))
        first = -(-first // step) * step
        if first >= end:
            return
        scans = np.arange(first, end, step, dtype=np.int64)
        tick, rest = np.divmod(scans * TICKS_PER_S, self._rate_hz)
        values = np.empty((len(scans), 1 + len(_QUANTITIES)))
        values[:, 0] = scans  # turned into seconds when the block is known
        values[:, 1:] = motion.quantities(_QUANTITIES, tick, rest * (tick_s / self._rate_hz)).T
        self._states.append(np.frombuffer(values, TRUTH_SCAN))

    def _take_impacts(self, motion: Motion, tick_s: float) -> None:
        found = motion.impacts
        if len(found) == 0:
            return
        rows = np.empty(len(found), IMPACTS)
        for name in _IMPACT_COLUMNS:
            rows[name] = found[name]
        stretch = COMMAND_GRID_S / tick_s
        rows["time"] = found["tick"] * COMMAND_GRID_S + found["offset"] * stretch
        self._impacts.append(rows)
        self._ends.append(rows["time"] + found["duration"] * stretch)
        self._first_end_s = min(self._first_end_s, float(self._ends[-1].min()))

    def pop_states(self, first: int, count: int) -> tuple[NDArray[np.void], NDArray[np.int64]]:
        """Return the kept rows of scans first to first + count, with `time` since `first`, and forget them.

        The second array says which of the `count` scans they are.
        """
        if not self._states:
            return _NO_STATES, _NO_SCANS
        parts = []
        while self._states:
            kept = self._states[0]
            split = int(kept["time"].searchsorted(first + count))
            parts.append(kept[:split])
            if split < len(kept):
                self._states[0] = kept[split:]
                break
            del self._states[0]
        rows = joined(parts or [_NO_STATES])
        scans = rows["time"].astype(np.int64) - first
        rows["time"] = scans / self._rate_hz
        return rows, scans

    def pop_impacts(self, first: int, count: int) -> NDArray[np.void]:
        """Return the contacts that ended before the end of these scans, with `time` since `first`, and forget them."""
        end_s = (first + count) / self._rate_hz
        if self._first_end_s >= end_s:
            return _NO_IMPACTS
        rows, ends = joined(self._impacts), np.concatenate(self._ends)
        done = ends < end_s
        self._impacts, self._ends = [rows[~done]], [ends[~done]]
        self._first_end_s = self._ends[0].min(initial=math.inf)
        rows = rows[done]
        rows["time"] -= first / self._rate_hz
        return rows
