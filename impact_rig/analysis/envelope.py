# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Envelopes for plotters: least, largest and rms value of every interval, so that a pulse of 50 µs shows at 50 Hz."""

from __future__ import annotations

from collections.abc import Iterator

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.recent import Recent
from impact_rig.blocks import Table

INTERVALS_HZ = 50.0
"""Intervals per second: what plotters draw without falling behind."""


PULSES = "pulses"
"""Column of what `HighPass` lets through."""
PULSES_HZ = 500.0
"""Its corner: 50 times the vibration, a tenth of what a contact of 50 µs fills."""


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
        channel: column that is filtered.
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
