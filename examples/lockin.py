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
"""Displacement transmissibility by lock-in: a pipeline of a user, which does not import impact_rig.

From blocks of scans it computes complex ratios X_1 / X_b, one for each window of whole cycles. After a gap between
blocks or a clipped sample it starts again: a lock-in counts samples, so its phase would be wrong from there on.
"""

import dataclasses

import numpy as np
from scipy import signal

CLIPPED = {"laser": 1 << 1, "base": 1 << 2}
"""Bits of the column `status`."""


@dataclasses.dataclass
class LockIn:
    """Lock-in at one frequency.

    Args:
        frequency_hz: frequency of the drive [Hz].
        rate_hz: scans per second.
        cycles: cycles per window.
        settle_s: time that is left out after each start [s], for the transients of the filter and of the rig.
        gaps: number of gaps between blocks so far.
        clipped: number of blocks with a clipped sample so far.
    """

    frequency_hz: float
    rate_hz: float
    cycles: int = 9
    settle_s: float = 1.0
    gaps: int = 0
    clipped: int = 0

    def __post_init__(self):
        self.filter = signal.butter(2, (5.0, 20.0), "bandpass", fs=self.rate_hz, output="sos")
        self.window = round(self.cycles * self.rate_hz / self.frequency_hz)
        self.expected_ns = None
        self.restart()

    def restart(self):
        """Forget everything but the counters."""
        self.states = {name: np.zeros((len(self.filter), 2)) for name in CLIPPED}
        self.kept = {name: np.empty(0) for name in CLIPPED}
        self.to_skip = round(self.settle_s * self.rate_hz)

    def feed(self, stamp_ns, rows):
        """Process one block, and return the ratios of the windows that it completes: a list, mostly empty."""
        if self.expected_ns is not None and abs(stamp_ns - self.expected_ns) > 0.5e9 / self.rate_hz:
            self.gaps += 1
            self.restart()
        self.expected_ns = stamp_ns + round(len(rows) * 1e9 / self.rate_hz)
        if np.any(rows["status"] & sum(CLIPPED.values())):
            self.clipped += 1
            self.restart()
            return []
        skip = min(self.to_skip, len(rows))
        self.to_skip -= skip
        for name in CLIPPED:
            filtered, self.states[name] = signal.sosfilt(self.filter, rows[name], zi=self.states[name])
            self.kept[name] = np.append(self.kept[name], filtered[skip:])
        return [self._ratio() for _ in range(len(self.kept["laser"]) // self.window)]

    def _ratio(self):
        turn = np.exp(-2j * np.pi * self.frequency_hz / self.rate_hz * np.arange(self.window))
        laser, base = (self.kept[name][: self.window] @ turn for name in ("laser", "base"))
        self.kept = {name: kept[self.window :] for name, kept in self.kept.items()}
        return laser / base
