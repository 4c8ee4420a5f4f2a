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
"""Pacing of blocks of scans: due times of blocks on a given clock, and a timer in phase with the blocks.

Rig time is the simulated time. The caller asks up to which rig time blocks are due, and reports each block that it has
published. Due times are computed from a fixed start, so errors do not accumulate. If the rig is too far behind, for
example after a suspension of the process, the pacer sets a new start and counts the time given up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any  # rclpy timers, settings of any node

import attrs
import numpy as np

from impact_rig.nodes.managed import ManagedNode
from impact_rig.simtime import NS_PER_S

Clock = Callable[[], int]  # a monotonic clock [ns], e.g. `time.monotonic_ns`

MAX_LAG_NS = NS_PER_S
"""Lag [ns of rig time] beyond which a rig in real time does not catch up: the blocks would overflow all queues."""
LATENESS_WINDOW = 3000  # number of blocks in the lateness statistics: 30 s of 10 ms blocks
LATE_CALLS = 100  # number of late calls in a row after which the work timer is started again in phase
LATE_SHARE = 0.1  # a call counts as late if it comes later than its time in phase by more than this share of a period
_AT_ONCE_S = 1e-6


@attrs.frozen
class Lateness:
    """Delay from when blocks were due to when they were published [ms], over the newest blocks, at most 3000.

    The diagnostics of a rig in real time show it as `lateness_…`.
    """

    median_ms: float
    p99_ms: float  # 99th percentile
    worst_ms: float  # maximum


class Pacer:
    """Conversion between a monotonic clock and the rig time up to which blocks are due, at `factor` times real time.

    Args:
        clock: monotonic clock [ns].
        factor: seconds of rig time per second of clock.
        max_lag_ns: lag in rig time [ns] beyond which the pacer gives up the lag instead of catching up.
    """

    def __init__(self, clock: Clock, factor: float = 1.0, max_lag_ns: int = MAX_LAG_NS) -> None:
        self._clock = clock
        self.factor = factor
        self._max_lag_ns = max_lag_ns
        self._origin_ns = clock()
        self._origin_rig_ns = 0
        self._late_ms: deque[float] = deque(maxlen=LATENESS_WINDOW)
        self.slips = 0  # number of re-bases after a lag
        self.slipped_ns = 0  # clock time given up by re-basing [ns]

    def rebase(self, produced_ns: int, factor: float | None = None) -> None:
        """Make the rig time `produced_ns` [ns] due now, and replace the factor if `factor` is given.

        Call this method at the start, after a pause and when the factor changes.
        """
        self._origin_ns, self._origin_rig_ns = self._clock(), produced_ns
        if factor is not None:
            self.factor = factor

    def due_ns(self, produced_ns: int) -> int:
        """Return the rig time [ns] up to which blocks of scans should be published now.

        If the rig is behind by more than `max_lag_ns`, the lag is given up and counted. The result is then
        `produced_ns`: nothing is due.

        Args:
            produced_ns: rig time up to which blocks have been produced [ns].
        """
        due = self._origin_rig_ns + int((self._clock() - self._origin_ns) * self.factor)
        if due - produced_ns > self._max_lag_ns:
            self.slips += 1
            self.slipped_ns += int((due - produced_ns) / self.factor)
            self.rebase(produced_ns)
            return produced_ns
        return due

    def wait_ns(self, rig_ns: int) -> int:
        """Return the time until the rig time `rig_ns` is due [ns of the clock]; negative if it is overdue."""
        return int(self._deadline_ns(rig_ns)) - self._clock()

    def published(self, end_ns: int) -> None:
        """Record, for `lateness`, that the block that ends at rig time `end_ns` has been published now."""
        self._late_ms.append((self._clock() - self._deadline_ns(end_ns)) * 1e-6)

    def _deadline_ns(self, rig_ns: int) -> float:
        return self._origin_ns + (rig_ns - self._origin_rig_ns) / self.factor

    def lateness(self) -> Lateness | None:
        """Return statistics of how late the newest blocks, at most 3000, were published; None before the first."""
        if not self._late_ms:
            return None
        median, p99, worst = np.percentile(self._late_ms, (50, 99, 100))
        return Lateness(float(median), float(p99), float(worst))


class WorkTimer:
    """Timer that calls back periodically, in phase with the times at which blocks of scans become due.

    The phase may drift. After 100 late calls in a row, `keep_in_step` starts the timer again in phase. A call is late
    if it comes later than its time by more than a tenth of a period.
    """

    def __init__(self, node: ManagedNode[Any], callback: Callable[[], None]) -> None:
        self._node = node
        self._callback = callback
        self._timer: Any = None
        self._period_s = 1.0
        self._late = 0

    def start(self, period_s: float, first_s: float) -> None:
        """Call back after `first_s` seconds and then every `period_s` seconds; this replaces a running timer.

        If `first_s` is negative (overdue) or longer than a period, the first call comes within one period, in the same
        phase.
        """
        self.stop()
        self._period_s = period_s
        if not 0.0 <= first_s <= period_s:
            first_s %= period_s
        self._timer = self._node.steady_timer(max(first_s, _AT_ONCE_S), self._first)

    def stop(self) -> None:
        """Stop calling back until the next `start`."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        self._late = 0

    def keep_in_step(self, wait_s: float) -> None:
        """Start the timer again in phase after 100 late calls in a row; call this method after each callback.

        Args:
            wait_s: time until the next block is due [s], negative if it is overdue. The call counts as late if this
                time is less than 0.9 periods.
        """
        self._late = self._late + 1 if wait_s < (1.0 - LATE_SHARE) * self._period_s else 0
        if self._late >= LATE_CALLS:
            self.start(self._period_s, wait_s)

    def _first(self) -> None:
        self._node.destroy_timer(self._timer)
        self._timer = self._node.steady_timer(self._period_s, self._callback)
        self._callback()
