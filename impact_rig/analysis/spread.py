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
"""Regime of successive drive cycles (periodic, modulated or chaotic), and the uncertainty of their mean.

The regime is judged by ε_k, the relative deviation of the fundamental of x_1 in cycle k from the mean. An orbit that
repeats after p cycles has p classes of cycles, k mod p. Within each class, both ε_k and the phases of the impacts must
then be equal, within noise or a negligible tolerance. The phases are needed because a light sphere can strike
irregularly while the amplitude is constant.

If the response does not repeat, its spectrum decides: a few lines (modulated) or a continuum (chaotic). The boundary
between the two is a convention, as for any finite record.
"""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Complex, Real
from impact_rig.kernels import BYTES_2D, REALS_2D, Bytes, Reals, entry, kernel
from impact_rig.states import Regime


def variance_of_mean(values: Real) -> float:
    """Return the variance of the mean of a stationary series whose values may be correlated over up to n^(1/3) lags.

        S = γ_0 + 2 Σ_{l<=L} (1 − l/(L+1)) γ_l,   var = S / (n − L − 1),   L = ⌊n^(1/3)⌋

    The values have shape (n,), n >= 4. Source: Newey & West (1987), Econometrica 55, 703–708, with n − L − 1 instead of
    n to be unbiased for uncorrelated values.
    """
    n = len(values)
    deviation = values - values.mean()
    longest = _longest_lag(n)
    total = float(deviation @ deviation)
    for lag in range(1, longest + 1):
        total += 2.0 * (1.0 - lag / (longest + 1.0)) * float(deviation[lag:] @ deviation[:-lag])
    return max(total, 0.0) / (n * (n - longest - 1.0))


def student_factor(n: int) -> float:
    """Return the factor ν/(ν − 2) by which to multiply a variance that `variance_of_mean` estimated from n values.

    The estimate has ν = 3n / (2(L + 1)) degrees of freedom, but at least 3, where L is its longest lag. The factor is
    the variance of Student's t distribution divided by that of the normal distribution (GUM Supplement 1, 6.4.9).
    """
    freedom = max(1.5 * n / (_longest_lag(n) + 1.0), 3.0)
    return freedom / (freedom - 2.0)


def _longest_lag(n: int) -> int:
    return int(n ** (1.0 / 3.0) + 1e-9)


def student_2u(freedom: float) -> float:
    """Return the factor by which to enlarge a standard uncertainty u, so that ±2u covers 95.45 %.

    The factor is above 1 because u has only `freedom` degrees of freedom; fewer than 2 count as 2. It is the quantile
    of Student's t distribution divided by 2, by the expansion of Abramowitz & Stegun (1964), 26.7.5. It is accurate to
    0.3 % from 4 degrees of freedom on.
    """
    inverse = 1.0 / max(freedom, 2.0)
    return 1.0 + 1.25 * inverse + 1.531 * inverse**2 + 1.43 * inverse**3


def batch_variance(values: Complex, batches: int) -> Real:
    """Return the variances of the mean of a series (real, imaginary part), estimated from the means of its batches.

    A batch is one of `batches` parts of equal length; the oldest values that do not fill a batch are left out. The
    values have shape (n,), n >= batches >= 2, and the result has shape (2,).

    Batches much longer than the correlation are practically independent (Schmeiser 1982, Operations Research 30,
    556–568). For shorter batches, the variance V_b from b batches is too small, and 2V_b − V_2b corrects this error
    (Vats & Flegal 2022, Biometrika 109, 735–750). The larger of V_b and 2V_b − V_2b is used, or V_b if n < 2b. It is
    multiplied by the square of `student_2u`, because the number of batches is small.
    """
    coarse = _scatter_of_batches(values, batches)
    fine = _scatter_of_batches(values, 2 * batches) if len(values) >= 2 * batches else coarse
    return np.maximum(2.0 * coarse - fine, coarse) * student_2u(batches - 1.0) ** 2


def _scatter_of_batches(values: Complex, batches: int) -> Real:
    length = len(values) // batches
    means = values[len(values) - length * batches :].reshape(batches, length).mean(axis=1)
    return np.array([np.var(means.real, ddof=1), np.var(means.imag, ddof=1)]) / batches


def by_class_removed(values: Complex, period: int) -> Complex:
    """Return each value minus the mean of all values at the same position within a period of `period` values.

    If the series repeats with this period, only its noise remains.
    """
    place: NDArray[np.int64] = np.arange(len(values)) % period
    whole = len(values) - len(values) % period
    sums = values[:whole].reshape(-1, period).sum(axis=0)
    sums[: len(values) - whole] += values[whole:]
    return np.asarray(values - (sums / np.bincount(place))[place], dtype=np.complex128)


LONGEST_PERIOD = 8
NOISE_FACTOR = 2.0
"""Ratio of a scatter's variance to that of the noise up to which the scatter counts as noise.

The noise of 48 cycles exceeds it once in a million.
"""
SUPPORT = 0.6  # share of the cycles of a class that strike at a phase which belongs to the orbit
REGULAR_SHARE = 0.85  # share of the impacts at such phases from which the impacts repeat
LINES = 3
"""Number of strongest spectral lines; in a modulated response they hold at least LINE_SHARE of the fluctuation power.

Each is as wide as the main lobe of the window.
"""
LINE_SHARE = 0.8


@attrs.frozen
class Behaviour:
    """Behaviour of a response from drive cycle to drive cycle, as found by `classify`."""

    regime: Regime  # its regime
    period: float  # drive cycles after which it repeats; NaN if never
    spread: float  # relative cycle-to-cycle rms of the fundamental, including noise
    steady: bool  # whether the amplitude repeats, possibly with irregular impacts


def classify(deviation: Complex, noise_variance: float, tolerance: float, strikes: NDArray[np.uint8]) -> Behaviour:
    """Classify a response by its drive cycles as periodic, modulated or chaotic.

    The response is periodic if it repeats after at most `LONGEST_PERIOD` and at most n/4 cycles. Otherwise it is
    modulated if its spectrum has a few lines, and chaotic if the spectrum is a continuum. The spectrum is that of ε, or
    that of the impact phases if the amplitude repeats.

    Args:
        deviation: ε_k, the deviation of the fundamental of x_1 in each cycle from its mean, divided by the mean, shape
            (n,).
        noise_variance: E|ε|² that noise alone causes.
        tolerance: rms of ε up to which a deviation is negligible.
        strikes: 1 for each part of each cycle that has an impact, else 0 (`Cycles.strikes`), shape (n, bins).

    Returns:
        The behaviour; its regime is `unknown` for n < 4 or values that are not finite.
    """
    n = len(deviation)
    if n < 4 or not np.all(np.isfinite(deviation)):
        return Behaviour(Regime.UNKNOWN, float("nan"), float("nan"), steady=False)
    spread = rms_deviation(deviation)
    limit = max(NOISE_FACTOR * noise_variance, tolerance**2)
    parts = np.ascontiguousarray(deviation, np.complex128).view(np.float64).reshape(n, 2)
    period, steady = shortest_period(parts, np.ascontiguousarray(strikes), limit, min(LONGEST_PERIOD, n // 4))
    if period > 0:
        return Behaviour(Regime.PERIODIC, float(period), spread, steady)
    phases = 2.0 * np.pi * np.arange(strikes.shape[1]) / strikes.shape[1]
    telling = strikes @ np.exp(2j * phases) if steady else deviation
    regime = Regime.MODULATED if _line_share(telling) >= LINE_SHARE else Regime.CHAOTIC
    return Behaviour(regime, float("nan"), spread, steady)


def rms_deviation(values: Complex) -> float:
    """Return the rms deviation of values from their mean."""
    return float(np.sqrt(np.mean(np.abs(values - values.mean()) ** 2)))


@entry(REALS_2D, BYTES_2D, float, int, returns=(int, bool))
def shortest_period(deviation: Reals, strikes: Bytes, limit: float, longest: int) -> tuple[int, bool]:
    """Return the number of cycles after which a response repeats, and whether its amplitude repeats.

    The number is the smallest p from 1 to `longest` for which both amplitude and impacts repeat, or 0. The amplitude
    repeats with p if the variance of ε_k within the classes k mod p is at most `limit`. The impacts repeat if most
    cycles of a class have them at the same phases (`_strikes_repeat`). The second value says whether the amplitude
    repeats with any of these p. `deviation` are the real and imaginary parts of ε_k, shape (n, 2). ε_k and `strikes`
    are described at `classify`.
    """
    n, steady = deviation.shape[0], False
    for period in range(1, longest + 1):
        left = 0.0
        for start in range(period):
            count, real, imag = 0, 0.0, 0.0
            for k in range(start, n, period):
                count += 1
                real += deviation[k, 0]
                imag += deviation[k, 1]
            real, imag = real / count, imag / count
            for k in range(start, n, period):
                off_real, off_imag = deviation[k, 0] - real, deviation[k, 1] - imag
                left += off_real * off_real + off_imag * off_imag
        if left / (n - period) <= limit:
            steady = True
            if _strikes_repeat(strikes, period):
                return period, True
    return 0, steady


@kernel
def _strikes_repeat(strikes: Bytes, period: int) -> bool:
    """Return whether the impacts repeat every `period` cycles.

    `strikes` has shape (n, bins): 1 where a cycle has an impact in that bin of the drive phase, else 0. For each class
    of cycles k mod `period`, a bin is regular if most cycles of the class have an impact in it or in a neighbouring
    bin. The impacts repeat if nearly all of them are in regular bins, or if there are none. Missing impacts do not
    count.
    """
    n, bins = strikes.shape
    regular, impacts = 0, 0
    for start in range(period):
        cycles = (n - start + period - 1) // period
        for place in range(bins):
            before, after = (place - 1) % bins, (place + 1) % bins
            found, near = 0, 0
            for k in range(start, n, period):
                found += int(strikes[k, place])
                near += int(strikes[k, before] | strikes[k, place] | strikes[k, after])
            impacts += found
            if near >= SUPPORT * cycles:
                regular += found
    return regular >= REGULAR_SHARE * impacts


def _line_share(deviation: Complex) -> float:
    """Return the share of a series' fluctuation power in its `LINES` strongest spectral lines.

    Each line is 5 bins wide, as the main lobe of the Hann window that is used.
    """
    n = len(deviation)
    power = np.abs(np.fft.fft((deviation - deviation.mean()) * np.hanning(n + 1)[:n])) ** 2
    total = float(power.sum())
    share = 0.0
    for _ in range(LINES):
        lobe = (int(np.argmax(power)) + np.arange(-2, 3)) % n
        share += float(power[lobe].sum())
        power[lobe] = 0.0
    return share / total
