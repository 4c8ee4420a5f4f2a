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
"""A simple chain of instruments in NumPy and SciPy, written in an afternoon, as a comparison in the same run.

It has four channels at 50 kS/s in blocks of a second, or of 10 ms. Each channel has a Butterworth filter of fourth
order that keeps its state, white noise, rounding to 16 bit, and clipping with flags; the result is the rows of the
block. It has no pulses between the scans, no resonance, no calibration errors and no skew, and its bits depend on the
CPU.
"""

from __future__ import annotations

import time

import numpy as np
from scipy import signal

RATE_HZ, CHANNELS = 50_000, 4
ORDER, CORNER_HZ = 4, 10e3
STEP, NOISE, LARGEST = 3e-4, 1e-3, 32767
ROWS = np.dtype([("time", "f8"), *((f"c{j}", "f8") for j in range(CHANNELS)), ("status", "u1")])


class SciPyChain:
    """The chain, with a sine as its input."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(1)
        self._filter = signal.butter(ORDER, CORNER_HZ, fs=RATE_HZ, output="sos")
        self._states = [np.zeros((len(self._filter), 2)) for _ in range(CHANNELS)]
        self._time = np.arange(RATE_HZ) / RATE_HZ
        self._input = np.sin(2.0 * np.pi * 9.1 * self._time)

    def second(self, calls: int = 1) -> float:
        """Return the CPU time of one second of scans, divided into `calls` calls [s]."""
        scans = RATE_HZ // calls
        began = time.thread_time()
        for call in range(calls):
            self._block(slice(call * scans, (call + 1) * scans))
        return time.thread_time() - began

    def _block(self, part: slice) -> np.ndarray:
        t, seen = self._time[part], self._input[part]
        rows, status = np.empty(len(t), ROWS), np.zeros(len(t), np.uint8)
        rows["time"] = t
        for j in range(CHANNELS):
            y, self._states[j] = signal.sosfilt(self._filter, seen, zi=self._states[j])
            y += NOISE * self._random.standard_normal(len(t))
            codes = np.clip(np.rint(y / STEP), -LARGEST - 1, LARGEST)
            status |= (np.abs(codes) >= LARGEST).astype(np.uint8) << j
            rows[f"c{j}"] = codes * STEP
        rows["status"] = status
        return rows
