# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`PhasorMeter`: what base, superior base and current do right now, as complex amplitudes, from the newest scans.

For loops that must be quicker than a settled measurement: of every stretch of constant frequency the scans of its last
whole cycles are fitted by a sine of that frequency, and corrected for skew and lag by the certificate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.channels import BASE, CHANNELS, CURRENT, LASER

MIN_CYCLES = 2


class Look(NamedTuple):
    """One stretch of scans.

    Attributes:
        end_ns: rig time of its end.
        frequency_hz: of the drive.
        base: complex amplitude [m]; only ratios of the three mean anything.
        superior: complex amplitude [m].
        current: complex amplitude [A].
        u_gain: relative standard uncertainty of DT by the sensitivities, at these amplitudes.
    """

    end_ns: int
    frequency_hz: float
    base: complex
    superior: complex
    current: complex
    u_gain: float = 0.0

    @property
    def dt(self) -> float:
        """|X_1| / |X_b|."""
        return abs(self.superior) / abs(self.base)

    @property
    def sound(self) -> bool:
        """Whether all three are numbers, and base and current move at all."""
        sizes = abs(self.base), abs(self.superior), abs(self.current)
        return all(map(math.isfinite, sizes)) and sizes[0] > 0.0 and sizes[2] > 0.0


class PhasorMeter:
    """Fits the newest scans.

    Args:
        info: rows of `daq/info`.
    """

    def __init__(self, info: NDArray[np.void]) -> None:
        self._calibration = Calibration.from_info(info)

    def look(self, rows: NDArray[np.void], frequency_hz: float, end_ns: int) -> Look | None:
        """Return the phasors of consecutive scans at one frequency, or None if they are fewer than `MIN_CYCLES`.

        Args:
            rows: of `daq/scan`, shape (n,).
            frequency_hz: of the drive during all of them.
            end_ns: rig time of the scan after the last.
        """
        period = self._calibration.rate_hz / frequency_hz
        cycles = math.floor(len(rows) / period)
        if cycles < MIN_CYCLES:
            return None
        kept = rows[len(rows) - round(cycles * period) :]
        angle = 2.0 * np.pi / period * np.arange(len(kept))
        basis = np.stack([np.ones(len(kept)), np.cos(angle), np.sin(angle)])
        values = np.stack([kept[CHANNELS[channel]].astype(float) for channel in (BASE, LASER, CURRENT)])
        found = np.linalg.solve(basis @ basis.T, basis @ values.T)
        phasors = found[1] - 1j * found[2]
        seen = [complex(self._calibration.response(channel, frequency_hz)) for channel in (BASE, LASER, CURRENT)]
        base, superior, current = (complex(y / r) for y, r in zip(phasors, seen, strict=True))
        u = [self._calibration.gain_uncertainty_at(ch, abs(x)) for ch, x in ((BASE, base), (LASER, superior))]
        return Look(end_ns, frequency_hz, base, superior, current, math.hypot(*u))
