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
"""Reduction of the scans to sums for each drive cycle, in constant memory; every measurement is based on these sums.

The sums of a complete cycle contain all that the least-squares fit of IEEE Std 1057 needs. The fit has an offset and
harmonics of the known frequency:

    value_k = offset + Re Σ_n Y_n e^{jnφ_k},    φ_k = Ω k,    Ω = 2π frequency / rate

The normal matrix of the fit follows in closed form from the sample instants:

    Σ_k e^{jnφ_k} = e^{jn(φ_first + φ_last)/2} sin(samples n Ω/2) / sin(n Ω/2)

The sums are taken about the middle of a cycle. The matrix then depends only on the number of samples, and is inverted
once for each number. Scans are added to the sums in stretches of up to 64 consecutive scans. Each stretch is folded
about its own middle, because a cosine is even and a sine is odd. This halves the number of multiplications.

Cycle m holds the samples k with m·rate/f <= k < (m+1)·rate/f, with k counted from the last change of the drive. The
result does not depend on the division of the stream into blocks, to the last bit.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Complex, Real
from impact_rig.arithmetic.elementary import TWO_PI, sincos
from impact_rig.kernels import BYTES, INTEGERS, REALS, REALS_2D, REALS_3D, Reals, entry, kernel

RANGE_BIT = 256
"""Bit in a cycle's flags that is set if channel 0 is outside its range or not finite; channel j has RANGE_BIT << j."""
MIN_SAMPLES_PER_CYCLE = 8
HALF = 32
"""Number of pairs of scans in a stretch, which is added to the sums at once: it fits into the fastest cache."""
PHASE_BINS = 64
"""Number of parts of a drive cycle in which the phases of impacts are counted: 0.1 rad each."""


@attrs.frozen(eq=False)
class Cycles:
    """Fits of n consecutive complete drive cycles, for the 4 channels of `scans.CHANNELS` and H harmonics."""

    first: NDArray[np.int64]  # index of each cycle's first scan, counted like `Accumulator.origin`, shape (n,)
    samples: NDArray[np.int64]  # scans per cycle, shape (n,)
    phasors: Complex  # Y_n in the channel's unit, for drive phase zero at the origin, shape (n, 4, H)
    mean: Real  # mean per cycle, shape (n, 4)
    variance: Real  # variance about the mean per cycle, shape (n, 4)
    residual: Real  # residual sum of squares of the fit, shape (n, 4)
    flags: NDArray[np.int64]  # status bits and RANGE_BIT bits, shape (n,)
    jump: Real  # largest change from one scan to the next, shape (n, 4)
    impacts: Real  # impacts detected per cycle, NaN if not counted, shape (n,)
    strikes: NDArray[np.uint8]  # 1 if an impact fell into that part of the cycle, shape (n, PHASE_BINS)

    def __len__(self) -> int:
        return len(self.first)

    @property
    def harmonics(self) -> Real:
        """Numbers 1 … H of the fitted harmonics, as floats."""
        return np.arange(1.0, self.phasors.shape[2] + 1.0)

    @property
    def degrees_of_freedom(self) -> int:
        """Number of residual degrees of freedom of the fits of all cycles together, per channel."""
        return int(np.sum(self.samples - (2 * self.phasors.shape[2] + 1)))

    @property
    def residual_variance(self) -> Real:
        """Residual variance of the fits of all cycles together, per scan, for each channel [unit²], shape (4,).

        The variance is zero if the fits have as many unknowns as scans. The noise is then unknown.
        """
        return np.asarray(self.residual.sum(axis=0) / max(1, self.degrees_of_freedom), dtype=np.float64)

    def __getitem__(self, part: slice) -> Cycles:
        return Cycles(*(getattr(self, field.name)[part] for field in attrs.fields(Cycles)))


def concatenate(parts: list[Cycles]) -> Cycles:
    """Join groups of cycles into one group.

    Each group must begin where the previous group ends; this is not checked.
    """
    return Cycles(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in attrs.fields(Cycles)))


LOWEST_HZ = 1e-6
"""Lowest drive frequency that is measured: a cycle of twelve days.

A lower one comes from damaged data, and its period in scans would not fit into an integer.
"""


def distinct_phases(samples: int, period: float) -> int:
    """Return the number of distinct drive phases at which the samples of a record lie.

    The number is `samples`, unless the phases recur after a few cycles. The rounding error of a sample then recurs too.
    Phases count as recurring if they drift by less than half a sample within the record. `period` is the number of
    samples per cycle, which need not be an integer.
    """
    for cycles in range(1, int(samples / period / 2.0) + 1):
        drift = abs(cycles * period - round(cycles * period)) * samples / (cycles * period)
        if drift < 0.5:
            return round(cycles * period)
    return samples


def usable_harmonics(rate_hz: float, frequency_hz: float, wanted: int) -> int:
    """Return the number of harmonics of a drive frequency that can be fitted, at most `wanted`.

    The highest harmonic is at most 0.45 times the scan rate. The result is 0 if the frequency cannot be measured: it is
    not finite, is below `LOWEST_HZ`, or has fewer than `MIN_SAMPLES_PER_CYCLE` scans per cycle.
    """
    if (
        not (math.isfinite(frequency_hz) and frequency_hz >= LOWEST_HZ)
        or rate_hz / frequency_hz < MIN_SAMPLES_PER_CYCLE
    ):
        return 0
    per_cycle = rate_hz / frequency_hz
    return min(wanted, int(0.45 * per_cycle), (int(per_cycle) - 1) // 2)


class Accumulator:
    """Accumulator that reduces a stream of scans to one set of sums per drive cycle, and fits the cycles from them.

    Args:
        rate_hz: scans per second.
        frequency_hz: drive frequency.
        harmonics: number of harmonics to fit (see `usable_harmonics`).
        origin: index of the scan at which cycle 0 starts; this must be the first scan that is added.
        low: largest value that counts as below the range of each channel, shape (4,).
        high: smallest value that counts as above the range of each channel, shape (4,).
        capacity: largest number of cycles that one call of the compiled function completes; it does not limit `add`.

    Attributes:
        origin: index of the scan at which cycle 0 starts.
        period: scans per drive cycle, not necessarily an integer.
    """

    def __init__(
        self,
        rate_hz: float,
        frequency_hz: float,
        harmonics: int,
        origin: int,
        low: Real,
        high: Real,
        capacity: int = 64,
    ) -> None:
        self.origin = origin
        self.period = rate_hz / frequency_hz
        self._low, self._high = low, high
        self._place = np.array([0, 0, math.ceil(self.period), 0, 0], dtype=np.int64)
        orders, places = np.arange(1.0, harmonics + 1.0), np.arange(HALF) + 0.5
        angle = 2.0 * np.pi / self.period * orders[:, None] * places
        self._waves = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        size = 2 * harmonics + 2
        self._sums = np.zeros((size, 4))
        self._stretch = np.zeros((4, 2 * HALF))
        self._folded = np.empty((2, HALF, 4))
        self._last, self._jump = np.full(4, np.nan), np.zeros(4)
        self._out_jump = np.zeros((capacity, 4))
        self._out = np.zeros((capacity, 4, size))
        self._out_flags = np.zeros(capacity, dtype=np.int64)
        self._done: list[tuple[NDArray[Any], ...]] = []  # sums, flags and jumps
        self._cycle = 0
        self._inverse: dict[int, Real] = {}  # of the normal matrix, by the number of samples in a cycle

    @property
    def pending_cycles(self) -> int:
        """Number of complete cycles that `take` has not returned yet."""
        return int(self._place[1]) - self._cycle

    def end(self, count: int) -> int:
        """Return the index after the last scan of the oldest `count` cycles that `take` has not returned yet."""
        return self.origin + math.ceil((self._cycle + count) * self.period)

    def add(self, samples: Real, status: NDArray[np.uint8], begin: int, end: int) -> None:
        """Accumulate the next scans of the stream, which are the columns begin <= i < end of a `ScanBuffer`.

        `samples` has shape (4, capacity of the buffer), `status` has shape (capacity of the buffer,).
        """
        while begin < end:
            done, begin = _accumulate(
                samples, status, begin, end, self._low, self._high, self.period, self._waves, self._place,
                self._stretch, self._folded, self._sums, self._last, self._jump, self._out, self._out_flags,
                self._out_jump,
            )  # fmt: skip
            if done:
                self._done.append(tuple(out[:done].copy() for out in (self._out, self._out_flags, self._out_jump)))

    def take(self, count: int) -> Cycles:
        """Fit the oldest `count` complete cycles, remove them from the accumulator, and return their fits.

        Raises:
            ValueError: `count` is below 1, or fewer than `count` cycles are complete.
        """
        if not 0 < count <= self.pending_cycles:
            raise ValueError(f"count must be >= 1 and <= {self.pending_cycles} (complete cycles), got {count}")
        sums, flags, jump = (np.concatenate(parts) for parts in zip(*self._done, strict=True))
        self._done = [(sums[count:], flags[count:], jump[count:])] if len(sums) > count else []
        numbers = np.arange(self._cycle, self._cycle + count + 1)
        self._cycle += count
        edges = np.ceil(numbers * self.period).astype(np.int64)
        return self._fitted(sums[:count], flags[:count], jump[:count], edges, numbers[:-1])

    def _fitted(
        self, sums: Real, flags: NDArray[np.int64], jump: Real, edges: NDArray[np.int64], numbers: NDArray[np.int64]
    ) -> Cycles:
        """Return the fits of cycles, computed from their sums.

        The sums refer to the middle of each cycle. The returned phasors refer to the start of the cycle, where the
        drive phase is 0.
        """
        samples, size = edges[1:] - edges[:-1], sums.shape[2] - 1
        right = sums[:, :, :size]
        with np.errstate(invalid="ignore", over="ignore"):
            solution = right @ np.array([self._inverse_for(count) for count in samples.tolist()])
            explained = np.add.reduce(solution * right, axis=2)
            mean = sums[:, :, 0] / samples[:, None]
            variance = np.maximum(sums[:, :, size] / samples[:, None] - mean**2, 0.0)
            residual = np.maximum(sums[:, :, size] - explained, 0.0)
        step = 2.0 * np.pi / self.period
        middle = step * ((edges[:-1] + edges[1:] - 1) / 2.0 - numbers * self.period)
        back = np.exp(-1j * middle[:, None] * np.arange(1.0, size // 2 + 1.0))
        phasors = (solution[:, :, 1::2] - 1j * solution[:, :, 2::2]) * back[:, None, :]
        uncounted = np.full(len(samples), np.nan), np.zeros((len(samples), PHASE_BINS), dtype=np.uint8)
        return Cycles(self.origin + edges[:-1], samples, phasors, mean, variance, residual, flags, jump, *uncounted)

    def _inverse_for(self, samples: int) -> Real:
        """Return the inverse normal matrix of a cycle of `samples` scans.

        The matrix is computed once for each number of scans and kept.
        """
        found = self._inverse.get(samples)
        if found is None:
            step = 2.0 * np.pi / self.period
            first = np.array([-(samples - 1) * step / 2.0])
            found = np.linalg.inv(normal_matrix(first, np.array([samples]), step, len(self._waves))[0])
            self._inverse[samples] = found
        return found


def normal_matrix(phase: Real, samples: NDArray[np.int64], step: float, harmonics: int) -> Real:
    """Return the normal matrices of fits with the columns [1, cos φ, sin φ, cos 2φ, sin 2φ, …] in closed form.

    Args:
        phase: φ of the first sample of each of n fits [rad], shape (n,).
        samples: number of samples of each fit, shape (n,).
        step: increase of φ from one sample to the next [rad], with 2 H step < 2π.
        harmonics: number H of harmonics.

    Returns:
        Normal matrices, shape (n, 2H+1, 2H+1).
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
    """Return index arrays for `normal_matrix`.

    The first array holds the harmonic numbers 1 … 2H. The next three are matrices with an entry for each pair (a, b) of
    0 … H: |a − b|, a + b, and the sign of b − a. The last two hold row numbers of the normal matrix: those of the
    cosines (with the constant), and those of the sines.
    """
    a, b = np.meshgrid(np.arange(harmonics + 1), np.arange(harmonics + 1), indexing="ij")
    at_cos = np.concatenate([[0], np.arange(1, 2 * harmonics, 2)])
    at_sin = np.arange(2, 2 * harmonics + 1, 2)
    return np.arange(1, 2 * harmonics + 1), np.abs(a - b), a + b, np.sign(b - a), at_cos, at_sin


@kernel
def _outside(values: Reals, count: int, low: float, high: float) -> int:
    """Return how many of the first `count` values are not strictly between `low` and `high`; NaN counts as outside."""
    inside = 0
    for q in range(count):
        inside += (low < values[q]) & (values[q] < high)
    return count - inside


@kernel
def _largest_change(values: Reals, count: int, before: float, largest: float) -> float:
    """Return the largest absolute change to one of the first `count` values from its predecessor.

    `before` is the predecessor of the first value. The result is `largest` if no change is larger; NaN is ignored.
    """
    largest = _larger(abs(values[0] - before), largest)
    for q in range(1, count):
        largest = _larger(abs(values[q] - values[q - 1]), largest)
    return largest


@kernel
def _larger(change: float, largest: float) -> float:
    """Return the larger of two numbers, or `largest` if `change` is NaN."""
    return change if change > largest else largest


@kernel
def _fold(folded: Reals, stretch: Reals, half: int, plain: Reals, square: Reals) -> None:
    """Fold a stretch of scans about its middle into `folded`, and add its values and squares to the sums of the cycle.

    `stretch` holds the values by channel in its first 2 `half` columns. `plain` and `square` are the sums of values and
    squares by channel, shape (4,). Two values of channel j lie q + ½ scans before and after the middle: folded[0, q, j]
    is their sum, and folded[1, q, j] the later minus the earlier value.
    """
    for j in range(4):
        total, squares_after, squares_before = 0.0, 0.0, 0.0
        for q in range(half):
            after, before = stretch[j, half + q], stretch[j, half - 1 - q]
            folded[0, q, j], folded[1, q, j] = after + before, after - before
            total += after + before
            squares_after += after * after
            squares_before += before * before
        plain[j] += total
        square[j] += squares_after + squares_before


@kernel
def _add_wave(
    at_cosine: Reals, at_sine: Reals, folded: Reals, wave: Reals, half: int, cosine: float, sine: float
) -> None:
    """Add a folded stretch, multiplied by cosine and sine of one harmonic, to the sums of the cycle.

    The sums are `at_cosine` and `at_sine`, each of shape (4,). `wave` holds cosines and sines of the harmonic after the
    middle of the stretch, for phase 0 at the middle. `cosine` and `sine` belong to the actual phase at the middle.
    """
    even_0, even_1, even_2, even_3 = 0.0, 0.0, 0.0, 0.0
    odd_0, odd_1, odd_2, odd_3 = 0.0, 0.0, 0.0, 0.0
    for q in range(half):
        even, odd = wave[0, q], wave[1, q]
        even_0, odd_0 = even_0 + folded[0, q, 0] * even, odd_0 + folded[1, q, 0] * odd
        even_1, odd_1 = even_1 + folded[0, q, 1] * even, odd_1 + folded[1, q, 1] * odd
        even_2, odd_2 = even_2 + folded[0, q, 2] * even, odd_2 + folded[1, q, 2] * odd
        even_3, odd_3 = even_3 + folded[0, q, 3] * even, odd_3 + folded[1, q, 3] * odd
    _add_turned(at_cosine, at_sine, 0, even_0, odd_0, cosine, sine)
    _add_turned(at_cosine, at_sine, 1, even_1, odd_1, cosine, sine)
    _add_turned(at_cosine, at_sine, 2, even_2, odd_2, cosine, sine)
    _add_turned(at_cosine, at_sine, 3, even_3, odd_3, cosine, sine)


@kernel
def _add_turned(at_cosine: Reals, at_sine: Reals, j: int, even: float, odd: float, cosine: float, sine: float) -> None:
    """Rotate the sums of channel j over a stretch by the phase at its middle, and add them to the sums of the cycle.

    `even` and `odd` are the sums of the samples times cosine and sine of the phase since the middle. `cosine` and
    `sine` belong to the phase at the middle.
    """
    at_cosine[j] += even * cosine - odd * sine
    at_sine[j] += even * sine + odd * cosine


@kernel
def _add_stretch(sums: Reals, stretch: Reals, filled: int, angle: float, waves: Reals, folded: Reals) -> None:
    """Add the first `filled` scans of a stretch to the sums of a cycle.

    If `filled` is odd, a scan of zeros is appended to `stretch` first. `angle` is the drive phase at the middle of the
    stretch minus that at the middle of the cycle [rad].
    """
    half = (filled + 1) // 2
    if 2 * half > filled:
        for j in range(4):
            stretch[j, filled] = 0.0  # a scan that contributes nothing
    _fold(folded, stretch, half, sums[0], sums[sums.shape[0] - 1])
    first_sine, first_cosine = sincos(angle)
    cosine, sine = first_cosine, first_sine
    for n in range(waves.shape[0]):
        _add_wave(sums[2 * n + 1], sums[2 * n + 2], folded, waves[n], half, cosine, sine)
        product = cosine * first_cosine - sine * first_sine
        cosine, sine = product, sine * first_cosine + cosine * first_sine


@entry(
    REALS_2D, BYTES, int, int, REALS, REALS, float, REALS_3D, INTEGERS, REALS_2D, REALS_3D, REALS_2D, REALS, REALS,
    REALS_3D, INTEGERS, REALS_2D, returns=(int, int),
)  # fmt: skip
def _accumulate(
    samples: Real, status: NDArray[np.uint8], begin: int, end: int, low: Real, high: Real, period: float, waves: Real,
    place: NDArray[np.int64], stretch: Real, folded: Real, sums: Real, last: Real, jump: Real, out: Real,
    out_flags: NDArray[np.int64], out_jump: Real,
) -> tuple[int, int]:  # fmt: skip
    """Add scans begin <= i < end to the running sums, and write the sums of each completed cycle to `out`.

    The function stops early if `out` is full. The result is (number of completed cycles, index of the next scan to
    add). For cycle n of the call, out_jump[n] is the largest change of each channel from scan to scan. out_flags[n] are
    the status bits, and range bits for values that are not strictly between `low` and `high`.

    `place` = [sample since the origin, cycle, first sample of the next cycle, flags, scans in the unfinished stretch].
    `waves[n, :, q]` = cos, sin of harmonic n + 1 at q + ½ samples. `sums[q, j]` = Σ basis_q value_j, where j is the
    channel and basis_q the q-th function of the fit (1, cos, sin, cos 2, ...); its last row is Σ value_j².
    `last` and `jump` are the previous value of each channel and its largest change in the current cycle, shape (4,).
    """
    k, cycle, stop, flags, filled = place
    done = 0
    i = begin
    while i < end and done < len(out):
        count = min(end - i, stop - k, 2 * HALF - filled)
        for q in range(count):
            flags |= status[i + q]
        for j in range(4):
            new, kept = samples[j, i : i + count], stretch[j, filled : filled + count]
            for q in range(count):
                kept[q] = new[q]
        i += count
        k += count
        filled += count
        if filled == 2 * HALF or k == stop:
            start = math.ceil(cycle * period)
            middle = k - filled + (filled + 1) // 2 - 0.5 * (start + stop)
            for j in range(4):
                if _outside(stretch[j], filled, low[j], high[j]):
                    flags |= RANGE_BIT << j
                jump[j] = _largest_change(stretch[j], filled, last[j], jump[j])
                last[j] = stretch[j, filled - 1]
            _add_stretch(sums, stretch, filled, TWO_PI * middle / period, waves, folded)
            filled = 0
        if k == stop:
            for j in range(4):  # with an array expression, Numba would compile error messages for seconds
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
    place[0], place[1], place[2], place[3], place[4] = k, cycle, stop, flags, filled
    return done, i
