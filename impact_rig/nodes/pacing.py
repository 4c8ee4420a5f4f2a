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
"""Pacing of blocks: due times on an injected clock, and a timer in phase with the blocks.

Nothing here sleeps: the owner of the loop queries up to which rig time blocks are due, and reports each block that it
has published. Deadlines are computed from the start and never accumulated, so pacing does not drift. After a suspension
of the process, the pacer re-bases, and reports by how much.
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
"""Lag in rig time beyond which catching up would overflow every subscriber's queue; a real-time rig is re-based."""
LATENESS_WINDOW = 3000  # number of blocks in the lateness statistics: 30 s of 10 ms blocks
LATE_CALLS = 100
LATE_SHARE = 0.1  # share of the period from which a call counts as late
_AT_ONCE_S = 1e-6


@attrs.frozen
class Lateness:
    """Statistics of the delay from the end of a block to its publication [ms]."""

    median_ms: float
    p99_ms: float
    worst_ms: float


class Pacer:
    """Mapping from a monotonic clock to the rig time that is due, at `factor` times real time.

    Args:
        factor: seconds of rig time per second of clock.
        max_lag_ns: lag in rig time beyond which the pacer re-bases instead of catching up.
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
        """Make `produced_ns` of rig time due now: at the start, after a pause, and when the factor changes."""
        self._origin_ns, self._origin_rig_ns = self._clock(), produced_ns
        if factor is not None:
            self.factor = factor

    def due_ns(self, produced_ns: int) -> int:
        """Return the rig time that should have been produced by now; re-bases when `produced_ns` is too far behind."""
        due = self._origin_rig_ns + int((self._clock() - self._origin_ns) * self.factor)
        if due - produced_ns > self._max_lag_ns:
            self.slips += 1
            self.slipped_ns += int((due - produced_ns) / self.factor)
            self.rebase(produced_ns)
            return produced_ns
        return due

    def wait_ns(self, rig_ns: int) -> int:
        """Return the time until `rig_ns` is due [ns of the clock]; negative if it is overdue."""
        return int(self._deadline_ns(rig_ns)) - self._clock()

    def published(self, end_ns: int) -> None:
        """Register that the block ending at rig time `end_ns` is published."""
        self._late_ms.append((self._clock() - self._deadline_ns(end_ns)) * 1e-6)

    def _deadline_ns(self, rig_ns: int) -> float:
        return self._origin_ns + (rig_ns - self._origin_rig_ns) / self.factor

    def lateness(self) -> Lateness | None:
        """Return the statistics of the last blocks, or None before the first."""
        if not self._late_ms:
            return None
        median, p99, worst = np.percentile(self._late_ms, (50, 99, 100))
        return Lateness(float(median), float(p99), float(worst))


class WorkTimer:
    """Timer with a period and a phase, on the monotonic clock.

    A timer of rclpy first fires one period after its creation, so a block would wait up to one period after its end.
    Here a one-shot timer precedes it. If period and block differ by fractions of a nanosecond, the phase wanders: the
    timer is realigned when its calls have been late for a while.
    """

    def __init__(self, node: ManagedNode[Any], callback: Callable[[], None]) -> None:
        self._node = node
        self._callback = callback
        self._timer: Any = None
        self._period_s = 1.0
        self._late = 0

    def start(self, period_s: float, first_s: float) -> None:
        """Call back in `first_s` and then every `period_s` [s]; this replaces the running timer.

        An overdue call waits for the next call in phase: an immediate call would set a phase in which all are late. If
        the first call is more than one period away, calls in phase come before it as well.
        """
        self.stop()
        self._period_s = period_s
        if not 0.0 <= first_s <= period_s:
            first_s %= period_s
        self._timer = self._node.steady_timer(max(first_s, _AT_ONCE_S), self._first)

    def stop(self) -> None:
        """Stop calling back."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        self._late = 0

    def keep_in_step(self, wait_s: float) -> None:
        """Set the wait until the next call [s], after a call.

        A wait far below the period means that this call was late. A negative wait means that the next one will be: its
        work became due during this call.
        """
        self._late = self._late + 1 if wait_s < (1.0 - LATE_SHARE) * self._period_s else 0
        if self._late >= LATE_CALLS:
            self.start(self._period_s, wait_s)

    def _first(self) -> None:
        self._node.destroy_timer(self._timer)
        self._timer = self._node.steady_timer(self._period_s, self._callback)
        self._callback()
