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
"""True states at scan instants and true contacts of a rig, stored until their block of scans is cut.

Instants are computed from integers, so nothing depends on how many ticks are simulated per call.
"""

from __future__ import annotations

import bisect
import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import IMPACTS, TRUTH_SCAN, joined
from impact_rig.kernels import REALS, REALS_2D, Fields, Reals, Records, entry, for_kernels, room
from impact_rig.physics import Motion
from impact_rig.physics.model import Model
from impact_rig.physics.sampling import QUERY, SAMPLED, Query, SamplingWorkspace, Trajectory, places, sample
from impact_rig.physics.state import IMPACT
from impact_rig.simtime import COMMAND_GRID_S, TICKS_PER_S

_NO_STATES = np.empty(0, TRUTH_SCAN)
_NO_IMPACTS = np.empty(0, IMPACTS)
_NO_SCANS = np.empty(0, np.int64)
_ALL: NDArray[np.bool_] | slice = slice(None)
_QUANTITIES = (TRUTH_SCAN.names or ())[1:]


def monitor_step(rate_hz: int, monitor_hz: float) -> int:
    """Return the smallest number of scans per monitor instant for a monitor rate of at most `monitor_hz` [Hz]."""
    return max(1, math.ceil(rate_hz / monitor_hz - 1e-9))


class Scans(NamedTuple):
    """Selection of every `step`-th scan.

    Attributes:
        first: index of the first selected scan, since the start or reset.
        step: number of scans from one selected scan to the next.
        rate_hz: rate of all scans, scans per second.
    """

    first: int
    step: int
    rate_hz: int


SCANS = Fields(Scans, (int, int, int))


@entry(*SAMPLED, QUERY, SCANS, float, REALS_2D)
def state_rows(
    model: Model,
    trajectory: Trajectory,
    work: SamplingWorkspace,
    query: Query,
    scans: Scans,
    tick_s: float,
    rows: Reals,
) -> None:
    """Fill `rows` with the true states of a motion at a selection of scans.

    Each row has the number of the scan, followed by the quantities that `query` requests. `rows` has the shape (n, 1 +
    q) for q quantities, and `query` has room for n instants. `tick_s` is the duration of a tick in the time of the
    motion [s]: 10 ms, scaled by the error of the scan clock.
    """
    seconds_per_rest = tick_s / scans.rate_hz
    for i in range(rows.shape[0]):
        scan = scans.first + i * scans.step
        rows[i, 0] = scan
        query.tick[i] = scan * TICKS_PER_S // scans.rate_hz
        query.offset[i] = (scan * TICKS_PER_S % scans.rate_hz) * seconds_per_rest
    sample(model, trajectory, work, query)
    for i in range(rows.shape[0]):
        for j in range(query.wanted.shape[0]):
            rows[i, 1 + j] = query.out[j, i]


@entry(IMPACT, float, IMPACTS, REALS)
def impact_rows(found: Records, clock_per_motion: float, rows: Records, ends: Reals) -> None:
    """Convert the impacts `found` in a motion to rows of truth/impacts (`rows`), and compute their ends (`ends`).

    The times in `rows` and `ends` count from scan 0 in seconds of the scan clock. A second of motion lasts
    `clock_per_motion` seconds of the scan clock. Durations are in seconds of motion.
    """
    for i in range(found.shape[0]):
        impact, row = found[i], rows[i]
        row.time = impact.tick * COMMAND_GRID_S + impact.offset * clock_per_motion
        ends[i] = row.time + impact.duration * clock_per_motion
        row.wall, row.approach_speed, row.separation_speed = impact.wall, impact.approach_speed, impact.separation_speed
        row.peak_force, row.peak_indentation = impact.peak_force, impact.peak_indentation
        row.impulse, row.duration, row.energy_lost = impact.impulse, impact.duration, impact.energy_lost


class Truth:
    """Collector of true states and contacts from simulated ticks of 10 ms, which returns them for blocks of scans.

    Args:
        rate_hz: scans per second.
        monitor_hz: highest rate of the monitor topics, > 0 [Hz]. The state at every k-th scan is kept, where k is the
            result of `monitor_step`.
        every_scan: whether to keep the state at every scan instead; `pop_states` then marks every k-th state.
    """

    def __init__(self, rate_hz: int, monitor_hz: float, every_scan: bool) -> None:
        self._rate_hz = rate_hz
        self.configure(monitor_hz, every_scan)
        self._states: list[NDArray[np.void]] = []
        self._impacts: list[NDArray[np.void]] = []  # time: since scan 0
        self._ends: list[float] = []  # their ends since scan 0, in order: a sphere has one contact at a time

    def configure(self, monitor_hz: float, every_scan: bool) -> None:
        """Choose the scans whose true states are kept, from the next tick on.

        Args:
            monitor_hz: highest rate of the monitor topics, > 0 [Hz]. The state at every k-th scan is kept, where k is
                the result of `monitor_step`.
            every_scan: whether to keep the state at every scan instead; `pop_states` then marks every k-th state.
        """
        self.monitor_step = monitor_step(self._rate_hz, monitor_hz)
        self.every_scan = every_scan

    def take(self, motion: Motion, tick_s: float) -> None:
        """Keep the true states at the selected scans of a motion, and its contacts.

        `tick_s` is the duration of a tick in the time of the motion [s]: 10 ms, scaled by the error of the scan clock.
        """
        self._take_states(motion, tick_s)
        self._take_impacts(motion, tick_s)

    def _take_states(self, motion: Motion, tick_s: float) -> None:
        step = 1 if self.every_scan else self.monitor_step
        first, end = (-(-tick * self._rate_hz // TICKS_PER_S) for tick in (motion.first_tick, motion.last_tick + 1))
        first = -(-first // step) * step
        if first >= end:
            return
        count = -(-(end - first) // step)
        wanted, rows = places(_QUANTITIES), np.empty((count, 1 + len(_QUANTITIES)))
        query = Query(wanted, np.empty(count, np.int64), np.empty(count), np.empty((len(wanted), count)))
        state_rows(*motion.sampled, query, Scans(first, step, self._rate_hz), tick_s, rows)
        self._states.append(np.frombuffer(rows, TRUTH_SCAN))

    def _take_impacts(self, motion: Motion, tick_s: float) -> None:
        found = motion.impacts
        if len(found) == 0:
            return
        rows, ends = room(len(found), IMPACTS), np.empty(len(found))
        impact_rows(for_kernels(found), COMMAND_GRID_S / tick_s, rows, ends)
        self._impacts.append(rows)
        self._ends = list(itertools.accumulate([*self._ends, *ends.tolist()], max))  # the clock's error may change

    def pop_states(
        self, first: int, count: int
    ) -> tuple[NDArray[np.void], NDArray[np.int64], NDArray[np.bool_] | slice]:
        """Return and remove the kept true states of scans first … first + count − 1.

        Returns:
            The states, with `time` since scan `first` [s]. The scan number of each state, from 0 for scan `first`. A
            mask of the states that are at monitor instants, or `slice(None)` if all states are.
        """
        if not self._states:
            return _NO_STATES, _NO_SCANS, _ALL
        kept = self._states[0] if len(self._states) == 1 else joined(self._states)
        taken = bisect.bisect_left(kept["time"], first + count)
        self._states = [kept[taken:]] if taken < len(kept) else []
        rows = joined([kept[:taken]])
        scans = [int(number) - first for number in rows["time"].tolist()]
        rows["time"] = [scan / self._rate_hz for scan in scans]
        found, monitor = np.array(scans, np.int64), _ALL
        if any((first + scan) % self.monitor_step for scan in scans):
            monitor = (first + found) % self.monitor_step == 0
        return rows, found, monitor

    def pop_impacts(self, first: int, count: int) -> NDArray[np.void]:
        """Return and remove the contacts that ended before the scan first + count, with `time` since scan `first` [s].

        A contact that began before scan `first` has a negative `time`.
        """
        end_s = (first + count) / self._rate_hz
        done = bisect.bisect_left(self._ends, end_s)
        if done == 0:
            return _NO_IMPACTS
        rows = joined(self._impacts)
        self._impacts, self._ends = [rows[done:]], self._ends[done:]
        rows = rows[:done]
        since = first / self._rate_hz
        rows["time"] = [time - since for time in rows["time"].tolist()]
        return rows
