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
"""Protection of the shaker: limits of commands, and an interlock on the true travel of the base and the coil current.

The interlock samples the motion ten times per tick of 10 ms. Scan rate, block length and number of ticks per call
therefore do not affect whether it trips. The square of a streamed current is integrated exactly.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Container

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import exp
from impact_rig.config import Drive, Shaker
from impact_rig.errors import CommandError
from impact_rig.kernels import INTEGERS, REALS_2D, Integers, Reals, Records, entry, for_kernels, kernel
from impact_rig.physics import Motion
from impact_rig.physics.flight import SEGMENT
from impact_rig.physics.model import Model
from impact_rig.physics.sampling import QUERY, SAMPLED, Query, SamplingWorkspace, Trajectory, places, sample
from impact_rig.physics.stream import UNDERRUN

SAMPLES_PER_TICK = 10
"""Number of instants per tick at which the interlock samples the motion: one per 1 ms. The extremes of the position
between two instants follow from position and velocity at both. Their relative error is 3e-6 (spacing⁴ ω⁴ / 384) at
30 Hz, the highest frequency at which this shaker can reach its stops.
"""
CURRENT_TIME_S = 1.0
"""Time constant of the exponential average of the squared current [s]."""
OVER_CURRENT_MARGIN = 1.05
"""Multiple of the current limit at which the interlock trips. It is above 1 because a sine at the limit is a legal
command, whose average ripples by 0.8 % at 5 Hz.
"""
OVER_TRAVEL, OVER_CURRENT = "over_travel", "over_current"


@attrs.frozen
class Trip:
    """Reason why the rig stops the shaker by itself: over-travel, over-current or an underrun.

    The shaker stays latched, and the rig cannot be reset, until `Rig.clear_trip`.

    Attributes:
        tick: number of the 10 ms tick in which it tripped, from 0 for the first tick of the checked motion; 0 for an
            underrun.
        reason: `over_travel`, `over_current` or `underrun` (a sample of a stream did not arrive in time).
        measured: travel of the inferior base [m], current [A rms, averaged over about 1 s], or number of the missing
            sample.
        limit: limit of travel [m] or of the current [A rms]; 0 for an underrun. Travel trips above its limit, current
            at more than 1.05 times its limit.
    """

    tick: int
    reason: str
    measured: float
    limit: float

    def message(self) -> str:
        """Return the reason as one line for users: the measured value and its limit, or for an underrun the sample."""
        if self.reason == UNDERRUN:
            return f"{self.reason}: sample {self.measured:.0f} of the stream did not arrive in time"
        if self.reason == OVER_TRAVEL:
            return f"{self.reason}: {1e3 * self.measured:.4g} mm of travel, limit {1e3 * self.limit:.4g} mm"
        return f"{self.reason}: coil current {self.measured:.4g} A rms, limit {self.limit:.4g} A rms"


class Interlock:
    """Monitor of simulated ticks that trips if the base's travel or the shaker's coil current exceeds its limit.

    Travel beyond the limit trips at once. The current trips if its rms, averaged exponentially with a time constant of
    1 s, exceeds the limit by 5 %. A prescribed base motion has no shaker and never trips.
    """

    def __init__(self) -> None:
        self._mean_square = 0.0
        self._query: Query | None = None  # scratch memory for the sampled instants and quantities

    def reset(self) -> None:
        """Forget the average of the current, so that the past does not trip the shaker again."""
        self._mean_square = 0.0

    def copy(self) -> Interlock:
        """Return an independent copy, which allows ticks to be simulated again from an earlier state."""
        twin = Interlock()
        twin._mean_square = self._mean_square
        return twin

    def watch(
        self, motion: Motion, tick_s: float, drive: Drive, shaker: Shaker, known: Container[str] = ()
    ) -> Trip | None:
        """Check simulated ticks, and return the first trip by over-travel or over-current; None without a trip.

        The average of the current continues from the last call. A prescribed motion of the base never trips.

        Args:
            motion: the simulated ticks.
            tick_s: duration of a tick in the time of the motion [s]: 10 ms, scaled by the error of the scan clock.
            drive: drive that moved the base.
            shaker: shaker with its limits.
            known: reasons for which the shaker has tripped already; they do not trip again.
        """
        if drive.kind == "prescribed":
            return None
        ticks = motion.last_tick - motion.first_tick + 1
        if self._query is None or len(self._query.tick) != ticks * (SAMPLES_PER_TICK + 1):
            room = np.empty((4, ticks * (SAMPLES_PER_TICK + 1)))
            self._query = Query(places(("x_b", "v_b", "current")), np.empty(room.shape[1], np.int64), room[3], room[:3])
        found = np.empty((ticks, 2))
        travel_and_current(*motion.sampled, self._query, tick_s / SAMPLES_PER_TICK, found)
        if (drive.kind, drive.waveform) == ("current", "stream"):  # a stream may contain anything between the samples
            mean_square_of_lines(for_kernels(motion.segments), motion.first_segment, tick_s, found)
        gain = _gain(tick_s)
        limit, limit_rms = shaker.travel_limit_m, shaker.current_limit_a_rms
        for tick, (travel, current_square) in enumerate(found.tolist()):
            self._mean_square += gain * (current_square - self._mean_square)
            if travel > limit and OVER_TRAVEL not in known:
                return Trip(tick, OVER_TRAVEL, travel, limit)
            if math.sqrt(self._mean_square) > OVER_CURRENT_MARGIN * limit_rms and OVER_CURRENT not in known:
                return Trip(tick, OVER_CURRENT, math.sqrt(self._mean_square), limit_rms)
        return None


@functools.lru_cache(maxsize=4)
def _gain(tick_s: float) -> float:
    """Return the weight of a new tick in the exponential average of the squared coil current.

    The tick lasts `tick_s` seconds. The average has the time constant `CURRENT_TIME_S`.
    """
    return 1.0 - float(exp(-tick_s / CURRENT_TIME_S))


@entry(*SAMPLED, QUERY, float, REALS_2D)
def travel_and_current(
    model: Model, trajectory: Trajectory, work: SamplingWorkspace, query: Query, spacing_s: float, found: Reals
) -> None:
    """Compute the largest |travel| [m] and the mean square current [A²] of each tick, into `found` of shape (ticks, 2).

    The motion is sampled every `spacing_s` [s], from the start of each tick to its end. `query` must request travel,
    its rate and the current, and have room for all these instants. The mean square of a tick excludes its first
    instant.
    """
    per_tick = query.tick.shape[0] // found.shape[0]
    for i in range(query.tick.shape[0]):
        query.tick[i], query.offset[i] = trajectory.first_tick + i // per_tick, (i % per_tick) * spacing_s
    sample(model, trajectory, work, query)
    for tick in range(found.shape[0]):
        within = query.out[:, tick * per_tick : (tick + 1) * per_tick]
        found[tick, 0] = largest_travel(within[0], within[1], spacing_s)
        found[tick, 1] = mean_square(within[2])


@kernel
def mean_square(values: Reals) -> float:
    """Return the mean of the squares of all values except the first, which already counts in the tick before."""
    total = 0.0
    for i in range(1, values.shape[0]):
        total += values[i] * values[i]
    return total / (values.shape[0] - 1)


@entry(SEGMENT, INTEGERS, float, REALS_2D)
def mean_square_of_lines(segments: Records, first_segment: Integers, tick_s: float, found: Reals) -> None:
    """Compute the exact mean square of a streamed current [A²] in each tick, into `found[:, 1]`.

    The current is piecewise linear. Each row of `segments` is one line; tick i begins with the line `first_segment[i]`.
    `tick_s` is the duration of a tick [s].
    """
    for tick in range(found.shape[0]):
        total = 0.0
        for i in range(first_segment[tick], first_segment[tick + 1]):
            row = segments[i]
            start, end = row.amplitude, row.amplitude + row.growth * row.duration
            total += row.duration * (start * start + start * end + end * end) * (1.0 / 3.0)
        found[tick, 1] = total / tick_s


@kernel
def largest_travel(position: Reals, velocity: Reals, spacing_s: float) -> float:
    """Return the largest |position| [m] of a sampled motion, including the motion between the samples.

    `position` [m] and `velocity` [m/s] have shape (n,). The samples are `spacing_s` [s] apart. Between two samples, the
    position is the cubic polynomial that has the given position and velocity at both samples. The velocity must change
    its sign at most once between two samples.
    """
    found = abs(position[0])
    for i in range(position.shape[0] - 1):
        start, end = position[i], position[i + 1]
        start_rate, end_rate = spacing_s * velocity[i], spacing_s * velocity[i + 1]
        found = max(found, abs(end))
        if start_rate * end_rate < 0.0:  # it turns in between
            quadratic = 3.0 * (end - start) - 2.0 * start_rate - end_rate
            cubic = start_rate + end_rate - 2.0 * (end - start)
            # rounding may make a double root negative
            root = math.sqrt(max(0.0, quadratic * quadratic - 3.0 * cubic * start_rate))
            divisor = quadratic + math.copysign(root, end_rate)
            x = min(1.0, max(0.0, -start_rate / divisor)) if divisor != 0.0 else 0.0
            found = max(found, abs(start + x * (start_rate + x * (quadratic + x * cubic))))
    return found


def check_frequency(frequency_hz: float, shaker: Shaker) -> None:
    """Check that a commanded drive frequency is within the shaker's range.

    Raises:
        CommandError: the frequency is out of range; the message names value and range.
    """
    low, high = shaker.frequency_min_hz, shaker.frequency_max_hz
    if not math.isfinite(frequency_hz) or not low <= frequency_hz <= high:
        raise CommandError(f"frequency must be >= {low:g} and <= {high:g} Hz, got {frequency_hz:g} Hz")


def check_amplitude(amplitude: float, drive: Drive, shaker: Shaker) -> None:
    """Check that a commanded drive amplitude is finite, not negative, and within the shaker's limit.

    Raises:
        CommandError: the amplitude is not allowed; the message names value and range.
    """
    name, unit, high, why = amplitude_limit(drive, shaker)
    if not math.isfinite(amplitude) or not 0.0 <= amplitude <= high:
        raise CommandError(f"{name} must be >= 0 and <= {high:.4g} {unit} ({why}), got {amplitude:g} {unit}")


def check_stream(values: NDArray[np.float64], drive: Drive, shaker: Shaker) -> None:
    """Check that samples of a stream are finite and within the shaker's limit.

    Raises:
        CommandError: the shape is not (n,), or a sample is not allowed; the message names the first such sample and
            the limits.
    """
    if values.ndim != 1:
        raise CommandError(f"a block of samples must have the shape (n,), got {values.shape}")
    name, unit, high, why = amplitude_limit(drive, shaker)
    wrong = np.flatnonzero(~(np.abs(values) <= high))
    if len(wrong):
        got = f"got {values[wrong[0]]:g} {unit} in row {wrong[0]}, counted from 0"
        raise CommandError(f"each sample must have a {name} >= {-high:.4g} and <= {high:.4g} {unit} ({why}), {got}")


def amplitude_limit(drive: Drive, shaker: Shaker) -> tuple[str, str, float, str]:
    """Return name, unit and limit of the drive's amplitude, and a text with the parameter that determines the limit."""
    if drive.kind == "prescribed":
        return "base amplitude", "m", shaker.travel_limit_m, "shaker.travel_limit_m"
    crest = 1.0 if drive.waveform == "random" else math.sqrt(2.0)
    limit = shaker.current_limit_a_rms * crest
    if drive.kind == "voltage":
        return "voltage", "V", limit * shaker.coil_resistance_ohm, "shaker.current_limit_a_rms in the coil at rest"
    form = "rms" if crest == 1.0 else "peak"
    return "current", f"A {form}", limit, f"shaker.current_limit_a_rms = {shaker.current_limit_a_rms:g} A"
