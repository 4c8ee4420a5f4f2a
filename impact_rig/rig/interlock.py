"""What protects the shaker: command limits, and the interlock on true table travel and coil current.

The interlock looks at fixed instants of the command grid, so that neither scan rate nor block length nor the cut into
calls decides whether it trips.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.config import Drive, Shaker
from impact_rig.errors import CommandError
from impact_rig.physics import Motion

LOOKS_PER_TICK = 10
"""1 ms apart: at the 30 Hz below which this shaker can reach its stops, a peak is underestimated by less than 0.5 %."""
CURRENT_TIME_S = 1.0
"""Averaging time of the rms current."""
OVER_TRAVEL, OVER_CURRENT = "over_travel", "over_current"


@attrs.frozen
class Trip:
    """Why the interlock tripped, and in which tick of the call."""

    tick: int
    reason: str
    measured: float
    limit: float

    def message(self) -> str:
        """Return one line for people."""
        unit = "m of travel" if self.reason == OVER_TRAVEL else "A rms"
        return f"{self.reason}: {self.measured:.4g} {unit}, limit {self.limit:.4g}"


class Interlock:
    """Watches the shaker tick by tick; a prescribed base motion has no shaker and never trips."""

    def __init__(self) -> None:
        self._mean_square = 0.0

    def reset(self) -> None:
        """Forget the current so far."""
        self._mean_square = 0.0

    def copy(self) -> Interlock:
        """Return an independent copy."""
        twin = Interlock()
        twin._mean_square = self._mean_square
        return twin

    def watch(self, motion: Motion, tick_s: float, drive: Drive, shaker: Shaker) -> Trip | None:
        """Return the first trip in simulated ticks, or None; remembers the current up to there."""
        if drive.kind == "prescribed":
            return None
        travel = _looks(motion, "x_b", tick_s)
        current = _looks(motion, "current", tick_s)
        worst = np.abs(travel).max(axis=1)
        square = np.square(current).mean(axis=1)
        gain = -math.expm1(-tick_s / CURRENT_TIME_S)
        limit, limit_rms = shaker.travel_limit_m, shaker.current_limit_a_rms
        for tick in range(len(worst)):
            self._mean_square += gain * (square[tick] - self._mean_square)
            if worst[tick] > limit:
                return Trip(tick, OVER_TRAVEL, float(worst[tick]), limit)
            if self._mean_square > limit_rms**2:
                return Trip(tick, OVER_CURRENT, math.sqrt(self._mean_square), limit_rms)
        return None


def _looks(motion: Motion, name: str, tick_s: float) -> NDArray[np.float64]:
    """Return a quantity at the instants of the interlock, shape (ticks, LOOKS_PER_TICK)."""
    ticks = len(motion.segments)
    segment = motion.first_segment + np.repeat(np.arange(ticks, dtype=np.int64), LOOKS_PER_TICK)
    offset = np.tile(np.arange(1, LOOKS_PER_TICK + 1) * (tick_s / LOOKS_PER_TICK), ticks)  # the last is the tick's end
    return motion.quantity(name, segment, offset).reshape(ticks, LOOKS_PER_TICK)


def check_frequency(frequency_hz: float, shaker: Shaker) -> None:
    """Refuse a frequency the shaker does not take.

    Raises:
        CommandError: names value and range.
    """
    low, high = shaker.frequency_min_hz, shaker.frequency_max_hz
    if not math.isfinite(frequency_hz) or not low <= frequency_hz <= high:
        raise CommandError(f"frequency must be >= {low:g} and <= {high:g} Hz, got {frequency_hz:g}")


def check_amplitude(amplitude: float, drive: Drive, shaker: Shaker) -> None:
    """Refuse an amplitude that is not finite, negative, or more than the shaker may carry.

    Raises:
        CommandError: names value and range.
    """
    name, unit, high, why = _amplitude_limit(drive, shaker)
    if not math.isfinite(amplitude) or not 0.0 <= amplitude <= high:
        raise CommandError(f"{name} must be >= 0 and <= {high:.4g} {unit} ({why}), got {amplitude:g}")


def _amplitude_limit(drive: Drive, shaker: Shaker) -> tuple[str, str, float, str]:
    if drive.kind == "prescribed":
        return "base amplitude", "m", shaker.travel_limit_m, "shaker.travel_limit_m"
    crest = 1.0 if drive.waveform == "random" else math.sqrt(2.0)
    limit = shaker.current_limit_a_rms * crest
    if drive.kind == "voltage":
        return "voltage", "V", limit * shaker.coil_resistance_ohm, "shaker.current_limit_a_rms in the coil at rest"
    form = "rms" if crest == 1.0 else "peak"
    return "current", f"A {form}", limit, f"shaker.current_limit_a_rms = {shaker.current_limit_a_rms:g} A"
