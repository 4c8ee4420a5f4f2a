# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Decides, window by window, when the response of one drive setting has settled, and measures it.

Three ways to a row, tried in this order after each window once enough windows have passed since the last row:

1. steady: the bias a dying transient leaves in the last `windows` windows is below `settle_tolerance` or twice the
   noise, and the amplitude repeats from cycle to cycle (or after a few). That is all one can see of it in these
   windows, but not little enough: the first row after a change would be taken as soon as the bias is just below the
   limit, and carry it, the same in every run. So it is waited for on, until at the pace at which it has died so far
   the bias is `REMNANT` of the limit;
2. stationary: the last `long_windows` windows have neither trend nor changing fluctuation: modulated or chaotic;
3. the bound `wait_limit_s` is reached: numbers as they are, status `not_settled`.
"""

from __future__ import annotations

import math
from collections import deque

import attrs
import numpy as np

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.channels import BASE, LASER
from impact_rig.analysis.cycles import Cycles, concatenate
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.settling import is_stationary, more_windows, transient_bias
from impact_rig.analysis.transmissibility import Measurement, complex_transmissibility, interruption, measure
from impact_rig.analysis.words import MEASURED, Status

CYCLE_MULTIPLE = 6
"""Windows hold a multiple of 6 cycles: orbits of period 2, 3 and 6 close in each, those of period 4 and 8 in pairs."""
NOISE_FACTOR = 2.0
REMNANT = 0.02
"""Share of the limit on the bias that a transient may leave in the first measurement after a change."""


def window_cycles(frequency_hz: float, settings: TrackerSettings) -> int:
    """Return the whole drive cycles per window."""
    return CYCLE_MULTIPLE * max(1, math.ceil(settings.window_s * frequency_hz / CYCLE_MULTIPLE))


@attrs.frozen
class Progress:
    """How far a first measurement is.

    Attributes:
        windows: taken since the last change.
        needed: how many it takes, as far as that is known: the count grows while the transient does not die.
        remnant: of the transient, over the transmissibility; NaN: not known yet.
    """

    windows: int
    needed: int
    remnant: float


class Judge:
    """Collects the windows of one drive setting, at most `long_windows` of them.

    Args:
        calibration: of the channels.
        frequency_hz: of the drive, commanded.
        settings: tolerances and lengths.
    """

    def __init__(self, calibration: Calibration, frequency_hz: float, settings: TrackerSettings) -> None:
        self._calibration = calibration
        self._frequency_hz = frequency_hz
        self._settings = settings
        self._windows: deque[Cycles] = deque(maxlen=settings.long_windows)
        self._ratios: deque[complex] = deque(maxlen=settings.long_windows)
        self._since_row = 0
        self._reported = False
        self._waited_windows = 0
        self._window_s = window_cycles(frequency_hz, settings) / frequency_hz
        self._broken: Status | None = None
        self._whole = 0  # windows since the change of the drive, or since the last broken one
        self._due: int | None = None  # of them, before the first measurement
        self._remnant = math.nan  # of the transient, over the newest transmissibility

    def add(self, window: Cycles) -> Measurement | None:
        """Take the next window; return a measurement if one is due.

        A window with lost, over-range or non-finite values is thrown away with all before it; it is reported when it
        begins a spell of such windows and every `windows` windows thereafter.
        """
        self._since_row += 1
        self._waited_windows += 1
        flags = int(np.bitwise_or.reduce(window.flags))
        broken = interruption(flags, window.mean)
        if broken:
            return self._break(broken)
        self._broken = None
        self._whole += 1
        self._windows.append(window)
        self._ratios.append(complex_transmissibility(window, self._calibration, self._frequency_hz))
        short = self._settings.windows
        if len(self._windows) < short or (self._reported and self._since_row < short):
            return None
        found = self._steady() or self._stationary() or self._overdue()
        if found:
            self._since_row, self._waited_windows, self._reported = 0, 0, True
        return found

    @property
    def pending(self) -> bool:
        """Whether windows have been taken that no row has told of."""
        return self._since_row > 0

    @property
    def progress(self) -> Progress:
        """How far the first measurement of this setting is."""
        needed = max(self._settings.windows, self._due or 0)
        if self._reported:
            return Progress(needed, needed, self._remnant)
        if self._due is None and self._whole >= needed:
            needed = self._whole + 1  # the transient is still there: at least one more
        return Progress(self._whole, needed, self._remnant)

    def _break(self, status: Status) -> Measurement | None:
        self._windows.clear()
        self._ratios.clear()
        self._whole, self._due, self._remnant = 0, None, math.nan
        if status is self._broken and self._since_row < self._settings.windows:
            return None
        self._broken, self._since_row = status, 0
        return Measurement(status=status, frequency_hz=self._frequency_hz)

    def _steady(self) -> Measurement | None:
        newest = abs(self._ratios[-1])
        limit = max(self._settings.settle_tolerance * newest, NOISE_FACTOR * self._noise(newest))
        bias = self._bias()
        self._remnant = abs(bias) / newest if newest > 0.0 else math.nan
        if abs(bias) > limit:
            return None
        if not self._reported and newest > 0.0:
            if self._due is None:
                taken = self._whole - self._settings.windows
                self._due = self._whole + more_windows(taken, limit / newest, REMNANT)
            if self._whole < self._due:
                return None
        found = self._measure(self._settings.windows, bias)
        return found if found.steady or found.status not in MEASURED else None

    def _stationary(self) -> Measurement | None:
        long = self._settings.long_windows
        if len(self._windows) < long or (self._reported and self._since_row < long):
            return None
        return self._measure(long, 0j) if is_stationary(np.array(self._ratios)) else None

    def _overdue(self) -> Measurement | None:
        if self._waited_windows * self._window_s < self._settings.wait_limit_s:
            return None
        found = self._measure(self._settings.windows, self._bias())
        return attrs.evolve(found, status=Status.NOT_SETTLED) if found.status in MEASURED else found

    def _bias(self) -> complex:
        ratios = np.array(self._ratios)
        return transient_bias(ratios, self._settings.windows) if np.all(np.isfinite(ratios)) else 0j

    def _measure(self, windows: int, bias: complex) -> Measurement:
        cycles = concatenate(list(self._windows)[-windows:])
        # one generator per measurement: the draws depend on the data's place, not on what was measured before
        rng = np.random.default_rng([self._settings.seed, abs(int(cycles.first[0]))])
        return measure(cycles, self._calibration, self._frequency_hz, self._settings, rng, bias)

    def _noise(self, ratio: float) -> float:
        """Return the standard uncertainty of X_1 / X_b by noise in `windows` windows, from the newest one."""
        window = self._windows[-1]
        residual = window.residual.sum(axis=0) / window.degrees_of_freedom
        per_channel = self._calibration.noise_crowding() * np.maximum(residual, self._calibration.noise**2)
        base = abs(complex(window.phasors[:, BASE, 0].mean()))
        scans = float(window.samples.sum()) * self._settings.windows
        if base == 0.0 or not np.isfinite(ratio):
            return math.inf
        return math.sqrt(2.0 * float(per_channel[LASER] + ratio**2 * per_channel[BASE]) / scans) / base
