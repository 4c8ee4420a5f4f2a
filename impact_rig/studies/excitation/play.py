# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A history played as it is: what the shaker was asked for beside what the current sensor read."""

from __future__ import annotations

from collections.abc import Iterator

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from impact_rig.operate.hardware import Exchange, Hardware

Real = NDArray[np.float64]
STEP_S = 1.0


@attrs.frozen(eq=False, kw_only=True)
class Played:
    """What was played so far.

    Attributes:
        rate_hz: samples per second, and scans.
        asked: shape (n,), A, m or V by `drive.kind`.
        rows: of `daq/scan`, shape (n,): a scan a sample.
        whole: samples of the history.
        clipped: samples of it that were clipped.
    """

    rate_hz: int
    asked: Real
    rows: NDArray[np.void]
    whole: int
    clipped: int

    @property
    def error(self) -> float:
        """Rms of the current less what was asked, its mean left out, over the rms of what was asked."""
        apart = self.rows["current"] - self.asked
        return float(apart.std() / max(self.asked.std(), 1e-300))

    def kurtosis(self, name: str) -> float:
        """Return that of a channel: 1.5 of a sine, 3 of Gaussian noise."""
        return float(stats.kurtosis(self.rows[name].astype(float), fisher=False))


def play(hardware: Hardware, samples: Real, limit: float | None = None) -> Iterator[Played]:
    """Play samples; yields what was played so far once a second of it, and at its end.

    Args:
        hardware: output and acquisition, of one rate.
        samples: A, m or V by `drive.kind`, shape (n,).
        limit: samples are clipped there, either side; None: the rig refuses what is beyond the shaker.

    Raises:
        CommandError: the shaker trips, or refuses a sample.
        TimeoutError: the rig did not go on.
    """
    rate_hz = hardware.wire.rate_hz
    asked = samples if limit is None else np.clip(samples, -limit, limit)
    clipped = int(np.count_nonzero(asked != samples))
    step = max(1, round(STEP_S * rate_hz))
    exchange = Exchange(hardware, step)
    coming, rows = np.concatenate([asked, np.zeros(exchange.lag)]), np.empty(0, np.void)
    for at in range(0, len(coming), step):
        part = exchange.exchange(coming[at : at + step])[1]
        rows = rows if len(rows) else np.empty(len(coming), part.dtype)
        rows[at : at + step] = part
        done = min(at + step, len(coming)) - exchange.lag
        if done > 0:
            scans = rows[exchange.lag : exchange.lag + done]
            yield Played(rate_hz=rate_hz, asked=asked[:done], rows=scans, whole=len(asked), clipped=clipped)
    hardware.output.stop()
