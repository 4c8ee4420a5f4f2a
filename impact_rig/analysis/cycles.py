# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Drive cycles: a constant-memory reduction of the scans, from which every measurement is made.

Each whole cycle of the drive is reduced to sums; the least-squares fit of IEEE Std 1057 (offset and harmonics of the
known frequency) needs nothing else. With Ω the phase from one sample to the next, the fit is

    value_k = offset + Re Σ_n Y_n e^{jnφ_k},    φ_k = Ω k,    Ω = 2π frequency / rate

and its normal matrix follows from the sample instants in closed form:

    Σ_k e^{jnφ_k} = e^{jn(φ_first + φ_last)/2} sin(samples n Ω/2) / sin(n Ω/2)

Cycle m holds the samples k with m·rate/f <= k < (m+1)·rate/f, k counted from the last change of the drive, so neither
the cycles nor their bits depend on how the stream was cut into blocks.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Complex, Real
from impact_rig.kernels import BYTES, INTEGERS, REALS, REALS_2D, REALS_3D, entry, kernel

RANGE_BIT = 256
"""Bit in a cycle's flags for channel 0 outside its range or not finite; channel j uses RANGE_BIT << j."""
MIN_SAMPLES_PER_CYCLE = 8
STRETCH = 64
"""Scans that are added up together: what they need stays in the fastest cache."""
PHASE_BINS = 64
"""Parts of a drive cycle by which the phases of impacts are kept: 0.1 rad each."""


@attrs.frozen(eq=False)
class Cycles:
    """n consecutive whole cycles of the drive, 4 channels in the order of `scans.CHANNELS`, so many harmonics."""

    first: NDArray[np.int64]  # index of each cycle's first scan, counted like `Accumulator.origin`, shape (n,)
    samples: NDArray[np.int64]  # scans per cycle, shape (n,)
    phasors: Complex  # Y_n in the channel's unit, drive phase zero at the origin, shape (n, 4, harmonics)
    mean: Real  # mean per cycle, shape (n, 4)
    variance: Real  # variance about the mean per cycle, shape (n, 4)
    residual: Real  # residual sum of squares of the fit, shape (n, 4)
    flags: NDArray[np.int64]  # status bits seen, and RANGE_BIT bits, shape (n,)
    jump: Real  # largest change from one scan to the next, shape (n, 4)
    impacts: Real  # impacts detected per cycle, NaN where not counted, shape (n,)
    strikes: NDArray[np.uint8]  # 1 where an impact fell into that part of the cycle, shape (n, PHASE_BINS)

    def __len__(self) -> int:
        return len(self.first)

    @property
    def degrees_of_freedom(self) -> int:
        """Residual degrees of freedom of all fits together."""
        return int(np.sum(self.samples - (2 * self.phasors.shape[2] + 1)))

    def __getitem__(self, part: slice) -> Cycles:
        return Cycles(*(getattr(self, field.name)[part] for field in attrs.fields(Cycles)))


def concatenate(parts: list[Cycles]) -> Cycles:
    """Return several runs of cycles as one."""
    return Cycles(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in attrs.fields(Cycles)))


LOWEST_HZ = 1e-6
"""A cycle of twelve days: what is below is damaged, and its period fits no integer."""


def distinct_phases(samples: int, period: float) -> int:
    """Return at how many phases of the drive a run of samples is taken: all its samples, or fewer where they recur.

    Where a few cycles hold a whole number of samples, the same phases come again and again, and what rounding adds to
    each of them is the same each time. They recur if within the run they drift by less than half a sample. `period`:
    samples per cycle, fractions included.
    """
    for cycles in range(1, int(samples / period / 2.0) + 1):
        drift = abs(cycles * period - round(cycles * period)) * samples / (cycles * period)
        if drift < 0.5:
            return round(cycles * period)
    return samples


def usable_harmonics(rate_hz: int, frequency_hz: float, wanted: int) -> int:
    """Return how many of the wanted harmonics lie safely below half the rate (0: the frequency cannot be measured)."""
    if (
        not (math.isfinite(frequency_hz) and frequency_hz >= LOWEST_HZ)
        or rate_hz / frequency_hz < MIN_SAMPLES_PER_CYCLE
    ):
        return 0
    return max(1, min(wanted, int(0.45 * rate_hz / frequency_hz)))


class Accumulator:
    """Reduces scans to cycles of `period` scans, fractions included; the state is a few dozen numbers.

    `harmonics` (see `usable_harmonics`) are fitted; cycle 0 starts at scan `origin`; values at or below `low` and at or
    above `high`, shape (4,), are flagged.
    """

    def __init__(
        self, rate_hz: int, frequency_hz: float, harmonics: int, origin: int, low: Real, high: Real, capacity: int = 64
    ) -> None:
        self.origin = origin
        self.period = rate_hz / frequency_hz
        self._low, self._high = low, high
        step = 2.0 * math.pi / self.period
        self._rotor = np.array([1.0, 0.0, math.cos(step), math.sin(step)])
        self._place = np.array([0, 0, math.ceil(self.period), 0], dtype=np.int64)
        size = 2 * harmonics + 2
        self._sums = np.zeros((size, 4))
        self._scratch = np.empty((STRETCH, 4)), np.empty((STRETCH, 2 * harmonics))
        self._last, self._jump = np.full(4, np.nan), np.zeros(4)
        self._out_jump = np.zeros((capacity, 4))
        self._out = np.zeros((capacity, 4, size))
        self._out_flags = np.zeros(capacity, dtype=np.int64)
        self._done: list[tuple[NDArray[Any], ...]] = []  # sums, flags and jumps
        self._cycle = 0

    @property
    def pending_cycles(self) -> int:
        """Whole cycles accumulated and not yet taken."""
        return int(self._place[1]) - self._cycle

    def add(self, samples: Real, status: NDArray[np.uint8], begin: int, end: int) -> None:
        """Accumulate the scans begin <= i < end of a buffer; samples has shape (4, capacity), status (capacity,)."""
        while begin < end:
            done, begin = _accumulate(
                samples, status, begin, end, self._low, self._high, self.period, self._place, self._rotor, self._sums,
                *self._scratch, self._last, self._jump, self._out, self._out_flags, self._out_jump,
            )  # fmt: skip
            if done:
                self._done.append(tuple(out[:done].copy() for out in (self._out, self._out_flags, self._out_jump)))

    def take(self, count: int) -> Cycles:
        """Return and forget the oldest `count` whole cycles, fitted.

        Raises:
            ValueError: fewer cycles are complete.
        """
        if not 0 < count <= self.pending_cycles:
            raise ValueError(f"count must be 1 to {self.pending_cycles}, got {count}")
        sums, flags, jump = (np.concatenate(parts) for parts in zip(*self._done, strict=True))
        self._done = [(sums[count:], flags[count:], jump[count:])] if len(sums) > count else []
        numbers = np.arange(self._cycle, self._cycle + count + 1)
        self._cycle += count
        edges = np.ceil(numbers * self.period).astype(np.int64)
        return _solve(sums[:count], flags[:count], jump[:count], edges, numbers[:-1], self.period, self.origin)


def _solve(
    sums: Real, flags: NDArray[np.int64], jump: Real, edges: NDArray[np.int64], numbers: NDArray[np.int64],
    period: float, origin: int,
) -> Cycles:  # fmt: skip
    """Fit every cycle from its sums: one small normal system per cycle, all at once."""
    samples = np.diff(edges)
    size = sums.shape[2] - 1
    matrix = normal_matrix(
        2.0 * np.pi * (edges[:-1] - numbers * period) / period, samples, 2.0 * np.pi / period, (size - 1) // 2
    )
    right = np.swapaxes(sums[:, :, :size], 1, 2)
    with np.errstate(invalid="ignore", over="ignore"):
        solution = np.linalg.solve(matrix, right)
        explained = np.sum(solution * right, axis=1)
        mean = sums[:, :, 0] / samples[:, None]
        variance = np.maximum(sums[:, :, size] / samples[:, None] - mean**2, 0.0)
        residual = np.maximum(sums[:, :, size] - explained, 0.0)
    phasors = np.swapaxes(solution[:, 1::2] - 1j * solution[:, 2::2], 1, 2)
    uncounted = np.full(len(samples), np.nan), np.zeros((len(samples), PHASE_BINS), dtype=np.uint8)
    return Cycles(origin + edges[:-1], samples, phasors, mean, variance, residual, flags, jump, *uncounted)


def normal_matrix(phase: Real, samples: NDArray[np.int64], step: float, harmonics: int) -> Real:
    """Return the normal matrices of [1, cos φ, sin φ, cos 2φ, sin 2φ, …] in closed form.

    `phase` is φ of each run's first sample and `step` φ per sample [rad], 2 H step < 2π; `samples` are those of each
    run. Shapes (n,), (n,) and, returned, (n, 2H+1, 2H+1).
    """
    order, difference, total, sign, at_cos, at_sin = _places(harmonics)
    count = samples[:, None]
    middle = phase[:, None] + (count - 1) * step / 2.0
    ratio = np.sin(count * order * step / 2.0) / np.sin(order * step / 2.0)
    moments = np.concatenate([count.astype(np.complex128), ratio * np.exp(1j * order * middle)], axis=1)
    cosine, sine = moments.real, moments.imag
    cos_cos = 0.5 * (cosine[:, difference] + cosine[:, total])
    sin_sin = 0.5 * (cosine[:, difference] - cosine[:, total])
    cos_sin = 0.5 * (sine[:, total] + sign * sine[:, difference])
    matrix = np.empty((len(samples), 2 * harmonics + 1, 2 * harmonics + 1))
    matrix[:, at_cos[:, None], at_cos] = cos_cos
    matrix[:, at_sin[:, None], at_sin] = sin_sin[:, 1:, 1:]
    matrix[:, at_cos[:, None], at_sin] = cos_sin[:, :, 1:]
    matrix[:, at_sin[:, None], at_cos] = np.swapaxes(cos_sin[:, :, 1:], 1, 2)
    return matrix


@functools.lru_cache(maxsize=16)
def _places(harmonics: int) -> tuple[NDArray[np.int64], ...]:
    """Return the orders of the moments; of two harmonics the difference, sum and sign; the rows of both kinds."""
    a, b = np.meshgrid(np.arange(harmonics + 1), np.arange(harmonics + 1), indexing="ij")
    at_cos = np.concatenate([[0], np.arange(1, 2 * harmonics, 2)])
    at_sin = np.arange(2, 2 * harmonics + 1, 2)
    return np.arange(1, 2 * harmonics + 1), np.abs(a - b), a + b, np.sign(b - a), at_cos, at_sin


@kernel
def _add(plain, square, values):  # type: ignore[no-untyped-def]
    """Add values, shape (n, 4), and their squares to two sums, shape (4,)."""
    plain_0, plain_1, plain_2, plain_3 = plain[0], plain[1], plain[2], plain[3]
    square_0, square_1, square_2, square_3 = square[0], square[1], square[2], square[3]
    for i in range(values.shape[0]):
        plain_0, square_0 = plain_0 + values[i, 0], square_0 + values[i, 0] * values[i, 0]
        plain_1, square_1 = plain_1 + values[i, 1], square_1 + values[i, 1] * values[i, 1]
        plain_2, square_2 = plain_2 + values[i, 2], square_2 + values[i, 2] * values[i, 2]
        plain_3, square_3 = plain_3 + values[i, 3], square_3 + values[i, 3] * values[i, 3]
    plain[0], plain[1], plain[2], plain[3] = plain_0, plain_1, plain_2, plain_3
    square[0], square[1], square[2], square[3] = square_0, square_1, square_2, square_3


@kernel
def _add_waves(cosine, sine, values, waves, at):  # type: ignore[no-untyped-def]
    """Add values, shape (n, 4), times columns `at` and `at` + 1 of `waves` to two sums, shape (4,)."""
    cosine_0, cosine_1, cosine_2, cosine_3 = cosine[0], cosine[1], cosine[2], cosine[3]
    sine_0, sine_1, sine_2, sine_3 = sine[0], sine[1], sine[2], sine[3]
    for i in range(values.shape[0]):
        first, second = waves[i, at], waves[i, at + 1]
        cosine_0, sine_0 = cosine_0 + values[i, 0] * first, sine_0 + values[i, 0] * second
        cosine_1, sine_1 = cosine_1 + values[i, 1] * first, sine_1 + values[i, 1] * second
        cosine_2, sine_2 = cosine_2 + values[i, 2] * first, sine_2 + values[i, 2] * second
        cosine_3, sine_3 = cosine_3 + values[i, 3] * first, sine_3 + values[i, 3] * second
    cosine[0], cosine[1], cosine[2], cosine[3] = cosine_0, cosine_1, cosine_2, cosine_3
    sine[0], sine[1], sine[2], sine[3] = sine_0, sine_1, sine_2, sine_3


@entry(
    REALS_2D, BYTES, int, int, REALS, REALS, float, INTEGERS, REALS, REALS_2D, REALS_2D, REALS_2D, REALS, REALS,
    REALS_3D, INTEGERS, REALS_2D, returns=(int, int),
)  # fmt: skip
def _accumulate(
    samples: Real, status: NDArray[np.uint8], begin: int, end: int, low: Real, high: Real, period: float,
    place: NDArray[np.int64], rotor: Real, sums: Real, values: Real, waves: Real, last: Real, jump: Real, out: Real,
    out_flags: NDArray[np.int64], out_jump: Real,
) -> tuple[int, int]:  # fmt: skip
    """Add scans to the running sums; stop early when `out` is full. Return (cycles completed, next scan).

    place = [sample since the origin, cycle, first sample of the next cycle, flags],
    rotor = [cos φ, sin φ, cos Ω, sin Ω], sums[q, j] = Σ basis_q value_j, at last Σ value_j².
    The rotation is renewed from the sample number at each cycle, so its rounding never grows beyond one cycle.
    Each sum runs scan by scan; four channels and two sums side by side keep a processor busy.
    """
    harmonics = waves.shape[1] // 2
    k, cycle, stop, flags = place
    cosine, sine, scan_cosine, scan_sine = rotor
    done = 0
    i = begin
    while i < end and done < len(out):
        count = min(end - i, stop - k, STRETCH)
        for q in range(count):
            flags |= status[i + q]
            waves[q, 0], waves[q, 1] = cosine, sine
            wave_cosine, wave_sine = cosine, sine
            for n in range(1, harmonics):
                product = wave_cosine * cosine - wave_sine * sine
                wave_cosine, wave_sine = product, wave_sine * cosine + wave_cosine * sine
                waves[q, 2 * n], waves[q, 2 * n + 1] = wave_cosine, wave_sine
            cosine, sine = cosine * scan_cosine - sine * scan_sine, sine * scan_cosine + cosine * scan_sine
        for j in range(4):
            before, largest = last[j], jump[j]
            for q in range(count):
                value = samples[j, i + q]
                values[q, j] = value
                if not low[j] < value < high[j]:  # NaN compares false
                    flags |= RANGE_BIT << j
                change = abs(value - before)
                if change > largest:  # noqa: PLR1730  # false of the NaN before the first scan, whatever max says
                    largest = change
                before = value
            last[j], jump[j] = before, largest
        _add(sums[0], sums[2 * harmonics + 1], values[:count])
        for n in range(harmonics):
            _add_waves(sums[2 * n + 1], sums[2 * n + 2], values[:count], waves, 2 * n)
        i += count
        k += count
        if k >= stop:
            for j in range(4):  # as an array, Numba would compile the words of an error for seconds
                for q in range(sums.shape[0]):
                    out[done, j, q] = sums[q, j]
                    sums[q, j] = 0.0
                out_jump[done, j] = jump[j]
                jump[j] = 0.0
            out_flags[done] = flags
            done += 1
            cycle += 1
            flags = 0
            stop = math.ceil((cycle + 1) * period)
            angle = 2.0 * math.pi * (k - cycle * period) / period
            cosine, sine = math.cos(angle), math.sin(angle)
    place[0], place[1], place[2], place[3] = k, cycle, stop, flags
    rotor[0], rotor[1] = cosine, sine
    return done, i
