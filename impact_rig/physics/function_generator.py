# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The function generator: turns commands into drive segments, phase-continuous, with ramped amplitude.

One segment per tick of the command grid; a stream, see `stream`, cuts ticks at its samples as well. No phase depends on
how many segments are asked for at once: that of a sine is computed from the number of ticks since the last change, so
it does not drift; a chirp changes in every tick.

Random drive is band-passed noise of unit rms: a digital Butterworth band-pass of 8th order, refined with many digits
and rounded once, behind our own generator.

prototype     s_k = e^{jπ(2k + 5)/8}, k = 0 … 3, of the low-pass with corner 1
band-pass     s² − s_k B s + ω_0² = 0, B = ω_2 − ω_1, ω_0² = ω_1 ω_2, ω_i = tan(π f_i · tick)
digital       p = (1 + s) / (1 − s): g B(z), B = Π (1 − z⁻²) / (1 + a_1 z⁻¹ + a_2 z⁻²), four sections
unit rms      g⁻² = Σ b_n² of B(z) = Σ b_n z⁻ⁿ, which is a sum over its partial fractions
"""

from __future__ import annotations

import copy
import functools
import math
from decimal import Decimal
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import PI, TWO_PI
from impact_rig.arithmetic.precise import ONE, TWO, ZERO, Complex, pi, precise, product, square_root, unit
from impact_rig.arithmetic.random import Random
from impact_rig.config import Drive, Shaker
from impact_rig.errors import CommandError
from impact_rig.kernels import REALS, Fields, entry, kernel, records, room
from impact_rig.physics.flight import SEGMENT
from impact_rig.physics.stream import Stream
from impact_rig.simtime import COMMAND_GRID_S

SECTIONS = 4
_SECTION = np.dtype(
    [
        ("a_1", "f8"),  # coefficient of z⁻¹ below the line [-]
        ("a_2", "f8"),  # coefficient of z⁻² there [-]
    ]
)
_MEMORY = np.dtype(
    [
        ("first", "f8"),  # what is added to the next number [-]
        ("second", "f8"),  # what is added to the one after it [-]
    ]
)


class BandPass(NamedTuple):
    """A filter: `gain` of its input, then its sections, records of a_1 and a_2, the least resonant first."""

    gain: float
    sections: NDArray[np.void]


@functools.cache
@precise
def band_pass(low_hz: float, high_hz: float, tick_s: float) -> BandPass:
    """Return the filter that makes white noise of unit rms, a number per tick, band-passed noise of unit rms.

    Raises:
        ValueError: the band is empty or does not lie below half of the rate of ticks.
    """
    if not 0.0 < low_hz < high_hz < 0.5 / tick_s:
        raise ValueError(f"the band must lie within 0 to {0.5 / tick_s:g} Hz, got {low_hz!r} to {high_hz!r} Hz")
    turns = [unit(pi() * Decimal(f) * Decimal(tick_s)) for f in (low_hz, high_hz)]
    low, high = (turn.imag / turn.real for turn in turns)
    poles = sorted(
        (pole for k in range(2) for pole in _digital_poles(unit(pi() * (2 * k + 5) / 8), high - low, low * high)),
        key=lambda pole: pole.square(),
    )
    rows = [(float(-TWO * pole.real), float(pole.square())) for pole in poles]
    sections = records(SECTIONS, _SECTION)
    sections[:] = rows
    return BandPass(float(ONE / _power([*poles, *(pole.conjugate() for pole in poles)]).sqrt()), sections)


def _digital_poles(prototype: Complex, width: Decimal, centre_square: Decimal) -> list[Complex]:
    """Return two poles in the z plane, one of each conjugate pair that a prototype pole and its conjugate make."""
    half = prototype * Complex(width / 2)
    root = square_root(half * half - Complex(centre_square))
    return [(Complex(ONE) + s) / (Complex(ONE) - s) for s in (half + root, half - root)]


def _power(poles: list[Complex]) -> Decimal:
    """Return Σ b_n² of Π (1 − z⁻²)⁴ / Π (1 − p_k z⁻¹): of c + Σ r_k / (1 − p_k z⁻¹) with b_0 = 1."""
    residues = [_residue(k, poles) for k in range(len(poles))]
    later = ZERO
    for first, r in zip(poles, residues, strict=True):
        for second, q in zip(poles, residues, strict=True):
            both = first * second
            later += (r * q * both / (Complex(ONE) - both)).real
    return ONE + later


def _residue(k: int, poles: list[Complex]) -> Complex:
    per_pole = Complex(ONE) / poles[k]
    zeros = Complex(ONE) - per_pole * per_pole
    others = (Complex(ONE) - other * per_pole for j, other in enumerate(poles) if j != k)
    return product([zeros] * SECTIONS) / product(others)


class BandNoise:
    """A stream of band-passed noise: which numbers it gives does not depend on how they are asked for.

    Args:
        band: how it is filtered.
        random: where white noise comes from.
    """

    _CHUNK = 256  # numbers made at once: the filter's arrays stay small

    def __init__(self, band: BandPass, random: Random) -> None:
        self._filter, self._random = band, random
        self._memory = records(SECTIONS, _MEMORY)
        self._made: NDArray[np.float64] = np.empty(0)
        self._first = 0

    def copy(self) -> BandNoise:
        """Return a stream that goes on from here on its own."""
        twin = BandNoise(self._filter, self._random.copy())
        twin._memory, twin._made, twin._first = self._memory.copy(), self._made, self._first
        return twin

    def numbers(self, first: int, count: int) -> NDArray[np.float64]:
        """Return the numbers first … first + count − 1; the next call must not begin earlier, nor behind their end."""
        parts = [self._made[first - self._first :]]
        ready = len(parts[0])
        while ready < count:
            parts.append(self._random.normal(self._CHUNK) * self._filter.gain)
            filter_in_place(self._filter.sections, self._memory, parts[-1])
            ready += self._CHUNK
        self._first, self._made = first, np.concatenate(parts)
        return self._made[:count]


@entry(_SECTION, _MEMORY, REALS)
def filter_in_place(sections, memory, samples):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Filter samples in place, in transposed direct form II, records of both coefficients and of what they remember."""
    for i in range(samples.shape[0]):
        value = samples[i]
        for k in range(sections.shape[0]):
            section, past = sections[k], memory[k]
            out = value + past.first
            past.first = past.second - section.a_1 * out
            past.second = -value - section.a_2 * out
            value = out
        samples[i] = value


class Ramp(NamedTuple):
    """Of the amplitude, linear: first tick, amplitude there, target, and ticks until that."""

    first: int
    start: float
    target: float
    ticks: int


RAMP = Fields(Ramp, (int, float, float, int))


@kernel
def level_at(ramp, tick):  # type: ignore[no-untyped-def]
    """Return the amplitude at a tick."""
    part = (tick - ramp.first) / ramp.ticks if tick < ramp.first + ramp.ticks else 1.0
    return ramp.start + (ramp.target - ramp.start) * part


@entry(SEGMENT, REALS, float)
def fill_levels(rows, level, tick_s):  # type: ignore[no-untyped-def]
    """Fill in n segments of a tick [s] each, straight lines between n + 1 amplitudes at their ends."""
    for i in range(rows.shape[0]):
        row = rows[i]
        row.duration, row.omega, row.phase, row.begin = tick_s, 0.0, PI / 2.0, 0.0
        row.amplitude, row.growth = level[i], (level[i + 1] - level[i]) / tick_s


@entry(SEGMENT, int, RAMP, float, float, int, float)
def fill_sine(rows, tick, ramp, tick_s, frequency_hz, since, phase):  # type: ignore[no-untyped-def]
    """Fill in segments of one tick [s] each from `tick` on, `since` ticks after the phase [rad] was `phase`."""
    level, per_tick = level_at(ramp, tick), frequency_hz * tick_s
    for i in range(rows.shape[0]):
        row, after = rows[i], level_at(ramp, tick + i + 1)
        row.duration, row.amplitude, row.growth = tick_s, level, (after - level) / tick_s
        level = after
        turns = per_tick * (since + i)
        angle = phase + TWO_PI * (turns - int(turns))
        while angle >= TWO_PI:
            angle -= TWO_PI
        row.omega, row.phase, row.begin = TWO_PI * frequency_hz, angle, 0.0


class FunctionGenerator:
    """Sine with phase-continuous frequency changes, a chirp in steps of one tick, seeded band-limited noise, a stream.

    The amplitude moves linearly to a new command within `shaker.ramp_s`, rounded up to whole ticks. Random drive is
    Gaussian noise, band-passed, straight lines between ticks; its amplitude is the rms of its values there.

    Attributes:
        frequency_hz: commanded frequency from the next tick on; of a chirp its first.
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
        begin = drive.amplitude if self._ramp_ticks == 0 else 0.0
        self._ramp = Ramp(0, begin, drive.amplitude, self._ramp_ticks)
        self.stream = Stream(drive, shaker) if drive.waveform == "stream" else None
        if self.stream is not None:
            self._ramp = Ramp(0, 0.0, 0.0, 0)
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
        """Phase of the sine or chirp at the next tick, in [0, 2π)."""
        turns = self.frequency_hz * self._tick_s * (self.tick - self._anchor_tick)
        return math.fmod(self._anchor_phase + TWO_PI * math.fmod(turns, 1.0), TWO_PI)

    @property
    def amplitude(self) -> float:
        """Amplitude at the next tick."""
        return float(level_at(self._ramp, self.tick))

    @property
    def target_amplitude(self) -> float:
        """Amplitude that the ramp leads to."""
        return self._ramp.target

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
        self._ramp = Ramp(self.tick, now, amplitude, self._ramp_ticks)

    def set_ramp(self, ramp_s: float) -> None:
        """Ramp later amplitude changes within another time; a ramp under way starts again with it."""
        if self.stream is not None:
            self.stream.set_ramp(ramp_s)
            return
        now, target = self.amplitude, self.target_amplitude
        self._ramp_ticks = math.ceil(ramp_s / self._tick_s - 1e-9)
        self._ramp = Ramp(self.tick, now if self._ramp_ticks else target, target, self._ramp_ticks)

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
        """Return the drive segments of the next `count` ticks, dtype `SEGMENT`: one each, of a stream more."""
        if self.stream is not None:
            self.tick += count
            return self.stream.segments(self.tick - count, count, self._tick_s)
        rows: NDArray[np.void] = room(count, SEGMENT)
        if self._noise is not None:
            levels = [level_at(self._ramp, tick) for tick in range(self.tick, self.tick + count + 1)]
            fill_levels(rows, self._noise.numbers(self.tick, count + 1) * levels, self._tick_s)
        else:
            since = self.tick - self._anchor_tick
            fill_sine(rows, self.tick, self._ramp, self._tick_s, self.frequency_hz, since, self._anchor_phase)
        if self._drive.waveform == "chirp":
            self._fill_chirp(rows)
        self.tick += count
        return rows

    def _fill_chirp(self, rows: NDArray[np.void]) -> None:
        drive = self._drive
        per_sweep = max(1, round(drive.chirp_s / COMMAND_GRID_S))  # by the scan clock, whatever its error
        for i in range(len(rows)):
            place = ((self.tick + i) % per_sweep) / per_sweep
            frequency = drive.frequency_hz + place * (drive.chirp_end_hz - drive.frequency_hz)
            rows[i]["omega"], rows[i]["phase"] = TWO_PI * frequency, self._anchor_phase
            self._anchor_phase = math.fmod(self._anchor_phase + TWO_PI * frequency * self._tick_s, TWO_PI)
        self._anchor_tick = self.tick + len(rows)
