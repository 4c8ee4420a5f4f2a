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
"""Base class of analyses that process scans block by block, and tools that prepare data for plotters.

Every class derived from `Blockwise` in a module of this folder is found automatically. The analysis node feeds it with
scans and publishes its results (docs/how-to/extending.md).

Plotters receive the minimum, maximum and rms value of each interval, so that a pulse of 50 µs is visible at 50 Hz. They
also receive the pulses alone, and amplitude spectra of the last seconds. The spectra use a flat-top window of five
cosine terms (d'Antona and Ferrero, Digital Signal Processing for Measurement Systems, 2006). A line between two bins is
at most 0.1 % too low, but ten bins wide.
"""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Iterator
from typing import ClassVar

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Real
from impact_rig.analysis.scans import Recent
from impact_rig.blocks import Table
from impact_rig.topics import Topic


class Blockwise:
    """Base class of analyses that receive the blocks of `daq/scan` and publish their results on their own topic."""

    topic: ClassVar[Topic]  # its entry in the topics table; its publisher is `analysis`, and it carries tables
    needs: ClassVar[tuple[str, ...]]  # the channels that it requires

    def feed(self, scan: Table) -> Table | None:
        """Process the next block of `daq/scan`; return the completed results as a table of `topic`, or None.

        Blocks arrive in the order in which they are published. Blocks may be missing, and stamps may go back after a
        reset of the rig.
        """
        raise NotImplementedError


INTERVALS_HZ = 50.0  # intervals per second that plotters can draw without falling behind
PULSES = "pulses"  # column of the output of `HighPass`
PULSES_HZ = 500.0  # corner frequency: 50 times the vibration, a tenth of the bandwidth of a contact of 50 µs


@attrs.frozen
class Interval:
    """Interval of consecutive scans, for one point of an envelope; `stamp_ns` is the stamp of its first scan."""

    stamp_ns: int
    rows: NDArray[np.void]

    def extremes(self, channel: str) -> tuple[float, float, float]:
        """Return the minimum, maximum and rms value of a channel in this interval, in its unit."""
        values = self.rows[channel]
        return float(values.min()), float(values.max()), float(np.sqrt(np.mean(values * values)))


class HighPass:
    """High-pass filter that removes the vibration of a channel and keeps the pulses of impacts.

    The corner frequency is `PULSES_HZ` (500 Hz), but at most a fifth of the scan rate.

    Args:
        rate_hz: scans per second.
        channel: name of the channel to filter.
    """

    def __init__(self, rate_hz: float, channel: str) -> None:
        self._channel = channel
        self._sections = scipy.signal.butter(2, min(PULSES_HZ, rate_hz / 5.0), "highpass", fs=rate_hz, output="sos")
        self._state: NDArray[np.float64] | None = None

    def restart(self) -> None:
        """Reset the filter; call this if the next block does not directly follow the last one."""
        self._state = None

    def feed(self, scan: Table) -> Table:
        """Filter the channel in the next block, and return the result as a table with one row per scan.

        The single column `pulses` has the unit of the channel. The filter does not detect gaps between blocks: call
        `restart` after each gap.
        """
        values = scan.rows[self._channel]
        if self._state is None:
            self._state = scipy.signal.sosfilt_zi(self._sections) * values[0]
        filtered, self._state = scipy.signal.sosfilt(self._sections, values, zi=self._state)
        rows = np.empty(len(values), dtype=[(PULSES, "<f8")])
        rows[PULSES] = filtered
        return attrs.evolve(scan, rows=rows)


class Intervals:
    """Division of a stream of blocks into intervals of equal length, about 1 / `INTERVALS_HZ` (20 ms).

    The length is rounded to whole scans, at least one. An interval may span several blocks.

    Args:
        rate_hz: scans per second, from daq/info.
    """

    def __init__(self, rate_hz: float) -> None:
        self.length = max(1, round(rate_hz / INTERVALS_HZ))
        self._pending = Recent(rate_hz, 1 << 40)

    def follows(self, scan: Table) -> bool:
        """Return whether a block directly follows the newest block that was fed.

        The result is False after a gap, and for the first block.
        """
        return self._pending.follows(scan)

    def feed(self, scan: Table) -> Iterator[Interval]:
        """Add a block, and yield the intervals that the block completes.

        Intervals start at the first scan after the last gap. An interval that a gap interrupts is dropped. The block is
        added by the iteration, so iterate to the end before the next call.
        """
        self._pending.add(scan)
        if self._pending.count < self.length:
            return
        rows = self._pending.rows()
        whole = len(rows) // self.length * self.length
        for first in range(0, whole, self.length):
            yield Interval(self._pending.stamp_ns(first), rows[first : first + self.length])
        rest, stamp = rows[whole:], self._pending.stamp_ns(whole)
        self._pending.clear()
        self._pending.add(attrs.evolve(scan, stamp_ns=stamp, rows=rest))


WINDOW_S = 4.0  # length of the window: bins are 0.25 Hz apart, and lines closer than 2.5 Hz are not resolved
EVERY_S = 1.0  # rig time between two spectra
HIGHEST_HZ = 250.0
"""Highest frequency of a spectrum, the 27th harmonic of a drive at 9.1 Hz.

Because of this limit, a higher scan rate does not lengthen the published message.
"""


def amplitude_spectrum(samples: Real, rate_hz: float) -> tuple[Real, Real]:
    """Return the amplitude spectrum of samples up to `HIGHEST_HZ` (250 Hz).

    The mean of the samples is removed first, and a flat-top window is applied. The result is (frequencies [Hz], peak
    amplitudes [unit of the samples]), each of shape (bins,).
    """
    window = _flat_top(len(samples))
    transformed = np.fft.rfft((samples - samples.mean()) * window)
    shown = min(len(transformed), int(HIGHEST_HZ * len(samples) / rate_hz) + 1)
    frequencies: Real = np.arange(shown) * np.float64(rate_hz / len(samples))
    amplitudes: Real = 2.0 * np.abs(transformed[:shown]) / window.sum()
    return frequencies, amplitudes


@functools.lru_cache(maxsize=2)
def _flat_top(length: int) -> Real:
    window: Real = scipy.signal.windows.flattop(length, sym=False)
    return window


def _found() -> tuple[type[Blockwise], ...]:
    found: list[type[Blockwise]] = []
    for place in sorted(pkgutil.iter_modules(__path__), key=lambda place: place.name):
        module = importlib.import_module(f"{__name__}.{place.name}")
        own = [kind for kind in vars(module).values() if getattr(kind, "__module__", None) == module.__name__]
        found += [kind for kind in own if isinstance(kind, type) and issubclass(kind, Blockwise)]
    return tuple(found)


ANALYSES = _found()  # all such analyses, in alphabetical order of modules
