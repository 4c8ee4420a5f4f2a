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
"""Analyses of blocks of scans as they come: those with a topic of their own, and what plotters are given.

Every module of this folder that defines a `Blockwise` is found; the analysis node feeds it and publishes what it
returns (docs/how-to/extending.md). Plotters get envelopes, with least, largest and rms value of every interval, so that
a pulse of 50 µs shows at 50 Hz; the pulses alone; and amplitude spectra of the last seconds through a flat-top window
of five cosine terms (d'Antona and Ferrero, Digital Signal Processing for Measurement Systems, 2006): a line between two
bins is 0.1 % too low at worst, for which it is ten bins wide.
"""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Iterator
from typing import ClassVar

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Real
from impact_rig.analysis.scans import Recent
from impact_rig.blocks import Table
from impact_rig.topics import Topic


class Blockwise:
    """An analysis with a topic of its own."""

    topic: ClassVar[Topic]  # its row of the topic table; its publisher is `analysis`, and it carries tables
    needs: ClassVar[tuple[str, ...]]  # the channels without which it has nothing to say

    def feed(self, scan: Table) -> Table | None:
        """Return what there is to say of a block of `daq/scan`; blocks come in the order of their stamps."""
        raise NotImplementedError


INTERVALS_HZ = 50.0  # intervals per second: what plotters draw without falling behind
PULSES = "pulses"  # column of what `HighPass` lets through
PULSES_HZ = 500.0  # its corner: 50 times the vibration, a tenth of what a contact of 50 µs fills


@attrs.frozen
class Interval:
    """Some contiguous scans; `stamp_ns` is that of the first."""

    stamp_ns: int
    rows: NDArray[np.void]

    def extremes(self, channel: str) -> tuple[float, float, float]:
        """Return the least, the largest and the rms value of a channel, in its unit."""
        values = self.rows[channel]
        return float(values.min()), float(values.max()), float(np.sqrt(np.mean(values * values)))


class HighPass:
    """What is left of a channel above `PULSES_HZ`: pulses of impacts without the vibration they sit on.

    Args:
        rate_hz: scans per second; of fewer than five times the corner the upper part of the band is left.
    """

    def __init__(self, rate_hz: float, channel: str) -> None:
        from scipy import signal  # noqa: PLC0415  # 60 MB, which only those who plot pay

        self._signal = signal
        self._channel = channel
        self._sections = signal.butter(2, min(PULSES_HZ, rate_hz / 5.0), "highpass", fs=rate_hz, output="sos")
        self._state: NDArray[np.float64] | None = None

    def restart(self) -> None:
        """Forget the past: the stream has a gap."""
        self._state = None

    def feed(self, scan: Table) -> Table:
        """Return the block with the one column `pulses`; the first value of a stream is taken for its mean."""
        values = scan.rows[self._channel]
        if self._state is None:
            self._state = self._signal.sosfilt_zi(self._sections) * values[0]
        filtered, self._state = self._signal.sosfilt(self._sections, values, zi=self._state)
        rows = np.empty(len(values), dtype=[(PULSES, "<f8")])
        rows[PULSES] = filtered
        return attrs.evolve(scan, rows=rows)


class Intervals:
    """Cuts blocks into intervals, whatever the block length.

    Args:
        rate_hz: scans per second, from daq/info; slower ones than `INTERVALS_HZ` give intervals of one scan.
    """

    def __init__(self, rate_hz: float) -> None:
        self.length = max(1, round(rate_hz / INTERVALS_HZ))
        self._pending = Recent(rate_hz, 1 << 40)

    def follows(self, scan: Table) -> bool:
        """Whether a block goes on where the one before ended."""
        return self._pending.follows(scan)

    def feed(self, scan: Table) -> Iterator[Interval]:
        """Yield the intervals that the block completes; one that a lost block has cut is left out."""
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


WINDOW_S = 4.0  # length of the window: bins are 0.25 Hz apart, and lines closer than 2.5 Hz are not told apart
EVERY_S = 1.0  # rig time from one spectrum to the next
HIGHEST_HZ = 250.0
"""Highest frequency shown: the drive's 27th harmonic at 9.1 Hz; faster scans do not make the message longer."""


def amplitude_spectrum(samples: Real, rate_hz: float) -> tuple[Real, Real]:
    """Return frequencies [Hz] and amplitudes (peak, unit of the samples) up to `HIGHEST_HZ`, each of shape (bins,).

    The mean is taken away first.
    """
    window = _flat_top(len(samples))
    transformed = np.fft.rfft((samples - samples.mean()) * window)
    shown = min(len(transformed), int(HIGHEST_HZ * len(samples) / rate_hz) + 1)
    frequencies: Real = np.arange(shown) * np.float64(rate_hz / len(samples))
    amplitudes: Real = 2.0 * np.abs(transformed[:shown]) / window.sum()
    return frequencies, amplitudes


@functools.lru_cache(maxsize=2)
def _flat_top(length: int) -> Real:
    from scipy.signal import windows  # noqa: PLC0415  # 60 MB, which only those who plot pay

    window: Real = windows.flattop(length, sym=False)
    return window


def _found() -> tuple[type[Blockwise], ...]:
    found: list[type[Blockwise]] = []
    for place in sorted(pkgutil.iter_modules(__path__), key=lambda place: place.name):
        module = importlib.import_module(f"{__name__}.{place.name}")
        own = [kind for kind in vars(module).values() if getattr(kind, "__module__", None) == module.__name__]
        found += [kind for kind in own if isinstance(kind, type) and issubclass(kind, Blockwise)]
    return tuple(found)


ANALYSES = _found()  # every such analysis, in alphabetical order of modules
