# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The function generator: turns commands into drive segments, phase-continuous, with ramped amplitude.

One segment per tick of the command grid. Phases are computed from the number of ticks since the last change, never
added up, so they neither drift nor depend on how many segments are asked for at once.
"""

from __future__ import annotations

import copy
import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.random import Random
from impact_rig.arithmetic.scalars import PI, TWO_PI
from impact_rig.config import Drive, Shaker
from impact_rig.errors import CommandError
from impact_rig.physics.band_pass import BandNoise, band_pass
from impact_rig.physics.forcing import SEGMENT
from impact_rig.physics.stream import Stream
from impact_rig.simtime import COMMAND_GRID_S


class FunctionGenerator:
    """Sine with phase-continuous frequency changes, a chirp in steps of one tick, seeded band-limited noise, a stream.

    The amplitude moves linearly to a new command within `shaker.ramp_s`, rounded up to whole ticks. Random drive is
    Gaussian noise of unit rms,
    band-passed and held to first order between ticks; its amplitude is an rms value.

    Attributes:
        frequency_hz: commanded frequency from the next tick on.
        tick: number of ticks generated so far.
        stream: what plays the samples of a stream; None with any other waveform. It has no amplitude: that is 0.
    """

    def __init__(self, drive: Drive, shaker: Shaker, random: Random, tick_s: float = COMMAND_GRID_S) -> None:
        self._drive = drive
        self._tick_s = tick_s
        self._ramp_ticks = math.ceil(shaker.ramp_s / tick_s - 1e-9)
        self.tick = 0
        self.frequency_hz = drive.frequency_hz
        self._anchor_tick, self._anchor_phase = 0, 0.0
        self._ramp = (0, 0.0, drive.amplitude)  # first tick, amplitude there, target
        if self._ramp_ticks == 0 or drive.amplitude == 0.0:
            self._ramp = (0, drive.amplitude, drive.amplitude)
        self.stream = Stream(drive, shaker) if drive.waveform == "stream" else None
        if self.stream is not None:
            self._ramp = (0, 0.0, 0.0)
        self._noise: BandNoise | None = None
        if drive.waveform == "random":
            if drive.random_high_hz >= 0.45 / tick_s:
                raise CommandError(
                    f"drive.random_high_hz must be < {0.45 / tick_s:g} Hz, the band of a {tick_s:g} s grid, "
                    f"got {drive.random_high_hz:g}"
                )
            self._noise = BandNoise(band_pass(drive.random_low_hz, drive.random_high_hz, tick_s), random)

    @property
    def phase_rad(self) -> float:
        """Phase of the sine at the next tick, in [0, 2π)."""
        turns = self.frequency_hz * self._tick_s * (self.tick - self._anchor_tick)
        return math.fmod(self._anchor_phase + TWO_PI * math.fmod(turns, 1.0), TWO_PI)

    @property
    def amplitude(self) -> float:
        """Amplitude at the next tick."""
        return float(self._amplitude_at(np.array(self.tick)))

    @property
    def target_amplitude(self) -> float:
        """Amplitude that the ramp leads to."""
        return self._ramp[2]

    def set_frequency(self, frequency_hz: float) -> None:
        """Go on with another frequency from the next tick, without a jump of phase."""
        if not (math.isfinite(frequency_hz) and frequency_hz > 0.0):
            raise CommandError(f"frequency must be > 0 Hz, got {frequency_hz!r}")
        self._anchor_phase = self.phase_rad
        self._anchor_tick = self.tick
        self.frequency_hz = frequency_hz

    def set_amplitude(self, amplitude: float) -> None:
        """Ramp to another amplitude (A, m or V by drive; peak, or rms for random drive) from the next tick.

        A stream is stopped: what is buffered of it is forgotten.
        """
        if not (math.isfinite(amplitude) and amplitude >= 0.0):
            raise CommandError(f"amplitude must be >= 0, got {amplitude!r}")
        if self.stream is not None:
            self.stream.stop()
            return
        now = self.amplitude if self._ramp_ticks else amplitude
        self._ramp = (self.tick, now, amplitude)

    def set_ramp(self, ramp_s: float) -> None:
        """Ramp later amplitude changes within another time; a ramp under way starts again with it."""
        if self.stream is not None:
            self.stream.set_ramp(ramp_s)
            return
        now, target = self.amplitude, self.target_amplitude
        self._ramp_ticks = math.ceil(ramp_s / self._tick_s - 1e-9)
        self._ramp = (self.tick, now if self._ramp_ticks else target, target)

    def set_tick(self, tick_s: float) -> None:
        """Go on with ticks of another duration: the scan clock's error has changed. The phase does not jump."""
        if tick_s != self._tick_s:
            self._anchor_phase, self._anchor_tick = self.phase_rad, self.tick
            self._tick_s = tick_s

    def copy(self) -> FunctionGenerator:
        """Return a generator that goes on from here on its own, with the same noise."""
        twin = copy.copy(self)
        twin._noise = self._noise and self._noise.copy()
        twin.stream = self.stream and self.stream.copy()
        return twin

    def segments(self, count: int) -> NDArray[np.void]:
        """Return the drive segments of the next `count` ticks, dtype `SEGMENT`: one each, or one a sample."""
        if self.stream is not None:
            self.tick += count
            return self.stream.segments(self.tick - count, count, self._tick_s)
        rows = np.zeros(count, SEGMENT)
        rows["duration"] = self._tick_s
        self._fill_level(rows)
        if self._noise is not None:
            rows["phase"] = PI / 2.0
        elif self._drive.waveform == "chirp":
            self._fill_chirp(rows)
        else:
            rows["omega"] = TWO_PI * self.frequency_hz
            since = self.tick - self._anchor_tick
            turns = self.frequency_hz * self._tick_s * np.arange(since, since + count)
            rows["phase"] = np.fmod(self._anchor_phase + TWO_PI * np.fmod(turns, 1.0), TWO_PI)
        self.tick += count
        return rows

    def _fill_level(self, rows: NDArray[np.void]) -> None:
        first, start, target = self._ramp
        if self._noise is None and self.tick >= first + self._ramp_ticks:  # most of the time: nothing changes
            rows["amplitude"] = start + (target - start)
            return
        level = self._amplitude_at(np.arange(self.tick, self.tick + len(rows) + 1))
        if self._noise is not None:
            level = level * self._noise.numbers(self.tick, len(rows) + 1)
        rows["amplitude"] = level[:-1]
        rows["slope"] = np.diff(level) / self._tick_s

    def _fill_chirp(self, rows: NDArray[np.void]) -> None:
        drive = self._drive
        per_sweep = max(1, round(drive.chirp_s / self._tick_s))
        for i in range(len(rows)):
            place = ((self.tick + i) % per_sweep) / per_sweep
            frequency = drive.frequency_hz + place * (drive.chirp_end_hz - drive.frequency_hz)
            rows[i]["omega"], rows[i]["phase"] = TWO_PI * frequency, self._anchor_phase
            self._anchor_phase = math.fmod(self._anchor_phase + TWO_PI * frequency * self._tick_s, TWO_PI)

    def _amplitude_at(self, tick: NDArray[np.int64]) -> NDArray[np.float64]:
        first, start, target = self._ramp
        if start == target or self._ramp_ticks == 0:
            return np.full(tick.shape, target)
        part = np.clip((tick - first) / self._ramp_ticks, 0.0, 1.0)
        return np.asarray(start + (target - start) * part)
