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
"""Function generator of the shaker: makes drive segments from commands, phase-continuous and with ramped amplitude.

There is one segment per tick (10 ms) of the command grid; a stream (see `stream`) splits ticks at its samples as well.
The drive does not depend on how many segments are requested at once. The phase of a sine is computed from the number of
ticks since the last change of its frequency, so it does not drift. The frequency of a chirp is constant within a tick
and changes from tick to tick.
"""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import PI, TWO_PI
from impact_rig.arithmetic.random import BandNoise, Random, band_pass
from impact_rig.config import Drive, Shaker
from impact_rig.errors import CommandError, ConfigError
from impact_rig.kernels import REALS, Fields, Reals, Records, entry, kernel, room
from impact_rig.physics.flight import SEGMENT
from impact_rig.physics.stream import Stream
from impact_rig.simtime import COMMAND_GRID_S


class Ramp(NamedTuple):
    """Linear ramp of the drive's amplitude from `initial` to `target`.

    It begins at the start of tick number `first_tick` and takes `ticks` ticks of nominally 10 ms. With 0 ticks the
    amplitude jumps to `target`. Amplitudes are in A, m or V, by kind of drive.
    """

    first_tick: int
    initial: float
    target: float
    ticks: int


RAMP = Fields(Ramp, (int, float, float, int))


@kernel
def amplitude_at(ramp: Ramp, tick: int) -> float:
    """Return the amplitude of a ramp at the start of `tick`: on the ramp, or `target` after its end.

    `tick` must be >= `first_tick`.
    """
    progress = (tick - ramp.first_tick) / ramp.ticks if tick < ramp.first_tick + ramp.ticks else 1.0
    return ramp.initial + (ramp.target - ramp.initial) * progress


@entry(SEGMENT, REALS, float)
def fill_lines(segments: Records, amplitudes: Reals, tick_s: float) -> None:
    """Fill drive segments of one tick each with a drive that is a straight line within each tick.

    `amplitudes` are the n + 1 values at the ends of the n ticks, and `tick_s` is the duration of a tick [s].
    """
    for i in range(segments.shape[0]):
        segment = segments[i]
        segment.duration, segment.omega, segment.phase, segment.begin = tick_s, 0.0, PI / 2.0, 0.0
        segment.amplitude, segment.growth = amplitudes[i], (amplitudes[i + 1] - amplitudes[i]) / tick_s


@entry(SEGMENT, int, RAMP, float, float, int, float)
def fill_sine(
    segments: Records, tick: int, ramp: Ramp, tick_s: float, frequency_hz: float, ticks_since: int, phase: float
) -> None:
    """Fill drive segments of one tick each with a sine, from tick number `tick` on.

    The amplitude follows `ramp`, and `tick_s` is the duration of a tick [s]. `phase` [rad] is the phase of the sine
    `ticks_since` ticks before `tick`, when its frequency or the duration of a tick last changed.
    """
    amplitude, cycles_per_tick = amplitude_at(ramp, tick), frequency_hz * tick_s
    for i in range(segments.shape[0]):
        segment, next_amplitude = segments[i], amplitude_at(ramp, tick + i + 1)
        segment.duration, segment.amplitude, segment.growth = tick_s, amplitude, (next_amplitude - amplitude) / tick_s
        amplitude = next_amplitude
        cycles = cycles_per_tick * (ticks_since + i)
        angle = phase + TWO_PI * (cycles - int(cycles))
        while angle >= TWO_PI:
            angle -= TWO_PI
        segment.omega, segment.phase, segment.begin = TWO_PI * frequency_hz, angle, 0.0


class FunctionGenerator:
    """Function generator for sines, chirps in steps of one tick, seeded band-limited noise, and streams of samples.

    The amplitude moves linearly to a new commanded amplitude within `shaker.ramp_s`, rounded up to whole ticks. A
    random drive is band-passed Gaussian noise with one value per tick and straight lines between the values. Its
    amplitude is the rms of these values.

    Args:
        drive: waveform, first frequency and first amplitude; the drive starts with a ramp from 0 to this amplitude.
        shaker: configuration of the shaker, of which the ramp time is used.
        random: random generator for a random drive.

    Attributes:
        frequency_hz: commanded frequency from the next tick on; for a chirp, its first frequency.
        tick: number of ticks generated so far.
        stream: player of a stream's samples, None with any other waveform. The amplitude of a stream is 0, except while
            it ramps to zero after a stop.

    Raises:
        ConfigError: the upper end of a random drive's band is too high for noise with one value per tick.
    """

    def __init__(self, drive: Drive, shaker: Shaker, random: Random) -> None:
        self._drive = drive
        self._tick_s = COMMAND_GRID_S
        self._ramp_ticks = self._ticks_of(shaker.ramp_s)
        self.tick = 0
        self._reached = 0.0  # amplitude at the end of the ticks generated so far
        self.frequency_hz = drive.frequency_hz
        self._anchor_tick, self._anchor_phase = 0, 0.0
        amplitude = drive.amplitude if self._ramp_ticks == 0 else 0.0
        self._ramp = Ramp(0, amplitude, drive.amplitude, self._ramp_ticks)
        self.stream = Stream(drive, shaker) if drive.waveform == "stream" else None
        if self.stream is not None:
            self._ramp = Ramp(0, 0.0, 0.0, 0)
        self._noise: BandNoise | None = None
        if drive.waveform == "random":
            if drive.random_high_hz >= 0.45 / self._tick_s:
                raise ConfigError(
                    f"drive.random_high_hz must be < {0.45 / self._tick_s:g} Hz, because the noise always has "
                    f"one value per {self._tick_s:g} s, got {drive.random_high_hz:g} Hz"
                )
            self._noise = BandNoise(band_pass(drive.random_low_hz, drive.random_high_hz, self._tick_s), random)

    @property
    def phase_rad(self) -> float:
        """Phase of the sine or chirp at the start of the next tick [rad], in [0, 2π).

        It has no meaning with other waveforms.
        """
        cycles = self.frequency_hz * self._tick_s * (self.tick - self._anchor_tick)
        return math.fmod(self._anchor_phase + TWO_PI * math.fmod(cycles, 1.0), TWO_PI)

    @property
    def amplitude(self) -> float:
        """Amplitude at the start of the next tick (A, m or V by drive; peak, or rms for random drive).

        For a stream it is 0, except during the ramp to zero after a stop: then it is the signed value of the ramp.
        """
        return float(amplitude_at(self._ramp, self.tick))

    @property
    def target_amplitude(self) -> float:
        """Amplitude at the end of the present ramp, or the present amplitude without a ramp (A, m or V by drive).

        It is 0 for a stream.
        """
        return self._ramp.target

    def set_frequency(self, frequency_hz: float) -> None:
        """Change the frequency of a sine from the next tick on, without a jump of the phase.

        With another waveform the drive does not change, although the attribute `frequency_hz` then has this value.

        Raises:
            CommandError: the frequency is not a finite number > 0.
        """
        if not (math.isfinite(frequency_hz) and frequency_hz > 0.0):
            raise CommandError(f"frequency must be finite and > 0 Hz, got {frequency_hz!r} Hz")
        self._anchor_phase = self.phase_rad
        self._anchor_tick = self.tick
        self.frequency_hz = frequency_hz

    def set_amplitude(self, amplitude: float) -> None:
        """Ramp to another amplitude (A, m or V by drive; peak, or rms for random drive) from the next tick on.

        A stream accepts only 0, which ramps it to zero and drops its buffered samples.

        Raises:
            CommandError: the amplitude is not a finite number >= 0, or not zero for a stream.
        """
        if not (math.isfinite(amplitude) and amplitude >= 0.0):
            raise CommandError(f"amplitude must be finite and >= 0, got {amplitude!r}")
        if self.stream is not None and amplitude > 0.0:
            raise CommandError(
                f"amplitude of a stream must be 0, which stops it (its samples set the amplitude), got {amplitude!r}"
            )
        self._ramp_to(amplitude, self._ramp_ticks)

    def stop(self, ramp_s: float) -> None:
        """Ramp the drive to zero in `ramp_s` seconds, rounded up to whole ticks.

        `ramp_s` replaces the usual ramp time for this stop. A stream is stopped, and its buffered samples are dropped.
        A ramp to zero that is already under way continues, unless the new ramp ends earlier.
        """
        self._ramp_to(0.0, self._ticks_of(ramp_s))

    def set_ramp(self, ramp_s: float) -> None:
        """Set the time [s] that later changes of the amplitude take; with 0 the amplitude jumps.

        A ramp under way starts again from the present amplitude with this time. A ramp to zero does so only if it then
        ends earlier. A stream uses the time for the ramp to zero at missing samples, and restarts such a ramp that is
        under way. Its ramp after a stop does not change.
        """
        self._ramp_ticks = self._ticks_of(ramp_s)
        if self.stream is not None:
            self.stream.set_ramp(ramp_s)
        else:
            self._ramp_to(self.target_amplitude, self._ramp_ticks)

    def _ticks_of(self, ramp_s: float) -> int:
        return math.ceil(ramp_s / self._tick_s - 1e-9)

    def _ramp_to(self, target: float, ticks: int) -> None:
        """Start a ramp from the present amplitude to `target` that takes `ticks` ticks; stop a stream.

        A ramp to zero that is already under way continues if the new ramp to zero would not end earlier.
        """
        present = self._reached
        if self.stream is not None:
            stopped = self.stream.stop(self.tick)
            present += stopped
            is_ending = stopped == 0.0
        else:
            is_ending = target == self._ramp.target == 0.0
        if not is_ending or self.tick + ticks < self._ramp.first_tick + self._ramp.ticks:
            self._ramp = Ramp(self.tick, present if ticks else target, target, ticks)

    def set_tick(self, tick_s: float) -> None:
        """Change the duration of later ticks [s] without a jump of the phase.

        The duration changes when the error of the scan clock changes.
        """
        if tick_s != self._tick_s:
            self._anchor_phase, self._anchor_tick = self.phase_rad, self.tick
            self._tick_s = tick_s

    def copy(self) -> FunctionGenerator:
        """Return an independent copy that will generate the same drive; only the buffer of a stream is shared."""
        twin = copy.copy(self)
        twin._noise = self._noise and self._noise.copy()
        twin.stream = self.stream and self.stream.copy()
        return twin

    def segments(self, count: int) -> NDArray[np.void]:
        """Generate the drive of the next `count` ticks; return it as drive segments, dtype `SEGMENT`.

        There is one segment per tick, or one or more per tick of a stream.
        """
        segments: NDArray[np.void]
        if self.stream is not None:
            segments = self.stream.segments(self.tick, count, self._tick_s)
            self._add_ramp(segments, count)
        elif self._noise is not None:
            segments = room(count, SEGMENT)
            fill_lines(segments, self._noise.numbers(self.tick, count + 1) * self._amplitudes(count), self._tick_s)
        else:
            segments = room(count, SEGMENT)
            ticks_since = self.tick - self._anchor_tick
            fill_sine(segments, self.tick, self._ramp, self._tick_s, self.frequency_hz, ticks_since, self._anchor_phase)
        if self._drive.waveform == "chirp":
            self._fill_chirp(segments)
        self.tick += count
        self._reached = self.amplitude
        return segments

    def _amplitudes(self, count: int) -> NDArray[np.float64]:
        """Return the ramp's amplitudes at the ends of the next `count` ticks, shape (count + 1,)."""
        return np.array([amplitude_at(self._ramp, tick) for tick in range(self.tick, self.tick + count + 1)])

    def _add_ramp(self, segments: NDArray[np.void], count: int) -> None:
        """Add a ramp to zero to the drive segments of a stopped stream, from the value at which the stream was stopped.

        `count` is the number of ticks. The segments of the stopped stream are zero until new samples take effect, so
        the sum is the ramp alone until then.
        """
        if self.tick >= self._ramp.first_tick + self._ramp.ticks:
            return
        amplitudes = self._amplitudes(count)
        growths = np.diff(amplitudes) / self._tick_s
        tick = np.cumsum(segments["begin"] == 0.0) - 1
        segments["amplitude"] += amplitudes[tick] + growths[tick] * segments["begin"]
        segments["growth"] += growths[tick]

    def _fill_chirp(self, segments: NDArray[np.void]) -> None:
        drive = self._drive
        ticks_per_sweep = max(1, round(drive.chirp_s / COMMAND_GRID_S))  # by the scan clock, regardless of its error
        for i in range(len(segments)):
            progress = ((self.tick + i) % ticks_per_sweep) / ticks_per_sweep
            frequency = drive.frequency_hz + progress * (drive.chirp_end_hz - drive.frequency_hz)
            segments[i]["omega"], segments[i]["phase"] = TWO_PI * frequency, self._anchor_phase
            self._anchor_phase = math.fmod(self._anchor_phase + TWO_PI * frequency * self._tick_s, TWO_PI)
        self._anchor_tick = self.tick + len(segments)
