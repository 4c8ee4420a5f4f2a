"""What protects the shaker: command limits, and the interlock on true table travel and coil current.

The interlock looks at fixed instants of the command grid, so that neither scan rate nor block length nor the cut into
calls decides whether it trips.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import exp
from impact_rig.config import Drive, Shaker
from impact_rig.errors import CommandError
from impact_rig.physics import Motion

LOOKS_PER_TICK = 10
"""1 ms apart, with the extremes between them from position and velocity: at the 30 Hz below which this shaker can reach
its stops, these are found to 3e-6 (h⁴ ω⁴ / 384)."""
CURRENT_TIME_S = 1.0
"""Averaging time of the rms current."""
OVER_CURRENT_MARGIN = 1.05
"""Trips above the limit times this: the average of a sine at the limit, which is a legal command, ripples by 0.8 % at
5 Hz."""
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
        travel, velocity, current = _looks(motion, ("x_b", "v_b", "current"), tick_s)
        worst = largest(travel, velocity, tick_s / LOOKS_PER_TICK)
        square = mean_square(current[:, 1:])
        gain = 1.0 - exp(-tick_s / CURRENT_TIME_S)
        limit, limit_rms = shaker.travel_limit_m, shaker.current_limit_a_rms
        for tick in range(len(worst)):
            self._mean_square += gain * (square[tick] - self._mean_square)
            if worst[tick] > limit:
                return Trip(tick, OVER_TRAVEL, float(worst[tick]), limit)
            if math.sqrt(self._mean_square) > OVER_CURRENT_MARGIN * limit_rms:
                return Trip(tick, OVER_CURRENT, math.sqrt(self._mean_square), limit_rms)
        return None


def _looks(motion: Motion, names: tuple[str, ...], tick_s: float) -> NDArray[np.float64]:
    """Return quantities at the instants of the interlock, shape (names, ticks, LOOKS_PER_TICK + 1): both ends count."""
    ticks = len(motion.segments)
    segment = motion.first_segment + np.repeat(np.arange(ticks, dtype=np.int64), LOOKS_PER_TICK + 1)
    offset = np.tile(np.arange(LOOKS_PER_TICK + 1) * (tick_s / LOOKS_PER_TICK), ticks)
    return motion.quantities(names, segment, offset).reshape(len(names), ticks, LOOKS_PER_TICK + 1)


def mean_square(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of the squares in each row, added up in order: NumPy's own sums need not be in any."""
    total = np.zeros(len(values))
    for column in values.T:
        total += column * column
    total /= values.shape[1]
    return total


def largest(position: NDArray[np.float64], velocity: NDArray[np.float64], step_s: float) -> NDArray[np.float64]:
    """Return the largest |position| of each row, between the samples as well.

    Args:
        position: [m], shape (rows, n), n samples `step_s` apart.
        velocity: its rate [m/s], same shape.
        step_s: distance of the samples [s]; short enough that the velocity changes its sign at most once in it.
    """
    y0, y1, d0, d1 = position[:, :-1], position[:, 1:], step_s * velocity[:, :-1], step_s * velocity[:, 1:]
    # the cubic through both ends: y0 + q (d0 + q (a + q b)), its slope d0 + q (2 a + 3 b q)
    a, b = 3.0 * (y1 - y0) - 2.0 * d0 - d1, d0 + d1 - 2.0 * (y1 - y0)
    turning = d0 * d1 < 0.0
    bottom = np.where(turning, a + np.copysign(np.sqrt(np.where(turning, a * a - 3.0 * b * d0, 0.0)), d1), 1.0)
    q = np.clip(np.divide(-d0, bottom, out=np.zeros_like(d0), where=bottom != 0.0), 0.0, 1.0)
    between = np.where(turning, np.abs(y0 + q * (d0 + q * (a + q * b))), 0.0)
    found: NDArray[np.float64] = np.maximum(np.abs(position).max(axis=1), between.max(axis=1))
    return found


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
