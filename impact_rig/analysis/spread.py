# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the mean of a series whose values may be correlated: long-run variance, bootstrap, batch means."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Complex, Real


def variance_of_mean(values: Real) -> float:
    """Return the variance of the mean of a stationary series, correlation up to n^(1/3) lags included.

        S = γ_0 + 2 Σ_{l<=L} (1 − l/(L+1)) γ_l,   var = S / (n − L − 1),   L = ⌊n^(1/3)⌋

    Newey & West (1987), Econometrica 55, 703–708; n − L − 1 instead of n makes it unbiased for uncorrelated values.

    Args:
        values: series, shape (n,), n >= 4.
    """
    n = len(values)
    deviation = values - values.mean()
    longest = _longest_lag(n)
    total = float(deviation @ deviation)
    for lag in range(1, longest + 1):
        total += 2.0 * (1.0 - lag / (longest + 1.0)) * float(deviation[lag:] @ deviation[:-lag])
    return max(total, 0.0) / (n * (n - longest - 1.0))


def student_factor(n: int) -> float:
    """Return ν/(ν − 2): the variance of a mean whose own variance is known from `variance_of_mean` of n values only.

    ν = 3n / (2(L + 1)) degrees of freedom; the variance of Student's t instead of the normal (GUM Supplement 1, 6.4.9).
    """
    freedom = max(1.5 * n / (_longest_lag(n) + 1.0), 3.0)
    return freedom / (freedom - 2.0)


def _longest_lag(n: int) -> int:
    return int(n ** (1.0 / 3.0) + 1e-9)


def block_length(values: Real) -> int:
    """Return the block length for the circular block bootstrap of the mean of `values`, shape (n,).

    Politis & White (2004), Econometric Reviews 23, 53–70, with the correction of Patton, Politis & White (2009):
    the flat-top kernel of twice the lag beyond which the autocorrelation is insignificant.
    """
    n = len(values)
    deviation = values - values.mean()
    if not np.any(deviation):
        return 1
    spectrum = np.abs(np.fft.rfft(deviation, 2 * n)) ** 2
    covariance = np.fft.irfft(spectrum)[:n] / n
    limit = 2.0 * math.sqrt(math.log10(n) / n)
    run = max(5, math.ceil(math.sqrt(math.log10(n))))
    longest = min(n // 3, math.ceil(math.sqrt(n)) + run)
    significant = np.abs(covariance[1 : longest + 1] / covariance[0]) >= limit
    cutoff = longest
    for lag in range(longest - run + 1):
        if not significant[lag : lag + run].any():
            cutoff = lag
            break
    bandwidth = max(1, min(2 * cutoff, longest))
    lags = np.arange(-bandwidth, bandwidth + 1)
    weights = np.minimum(1.0, 2.0 * (1.0 - np.abs(lags) / bandwidth))
    weighted = weights * covariance[np.abs(lags)]
    g, density = float(np.sum(np.abs(lags) * weighted)), float(np.sum(weighted))
    if density <= 0.0:
        return 1
    length = (2.0 * g**2 / (4.0 / 3.0 * density**2)) ** (1.0 / 3.0) * n ** (1.0 / 3.0)
    return int(np.clip(math.ceil(length), 1, max(1, math.ceil(min(3.0 * math.sqrt(n), n / 3.0)))))


def bootstrap_means(values: Complex, length: int, resamples: int, rng: np.random.Generator) -> Complex:
    """Return means of circular block resamples of rows.

    Args:
        values: n rows of c columns, resampled together, shape (n, c).
        length: block length, 1 <= length <= n.
        resamples: B.
        rng: source of the draws.

    Returns:
        Array of shape (B, c).
    """
    n = len(values)
    blocks = math.ceil(n / length)
    starts = rng.integers(0, n, size=(resamples, blocks))
    running = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(np.concatenate([values, values]), axis=0)])
    sizes = np.full(blocks, length)
    sizes[-1] = n - length * (blocks - 1)
    sums: Complex = (running[starts + sizes] - running[starts]).sum(axis=1)
    return sums / n


def student_2u(freedom: float) -> float:
    """Return the factor by which a standard uncertainty must grow so that ±2u covers 95.45 % of Student's t.

    The quantile by the expansion of Abramowitz & Stegun (1964), 26.7.5, at the normal quantile 2: within 0.3 % of
    the true one from 4 degrees of freedom on; fewer than 2 count as 2.
    """
    inverse = 1.0 / max(freedom, 2.0)
    return 1.0 + 1.25 * inverse + 1.531 * inverse**2 + 1.43 * inverse**3


def batch_variance(values: Complex, batches: int) -> Real:
    """Return the variances (real, imaginary) of the mean of a series from the scatter of the means of a few batches.

    Batches much longer than the correlation are as good as independent, however it decays; that they are few is in
    `student_2u`. Schmeiser (1982), Operations Research 30, 556–568.

    Args:
        values: series, shape (n,), n >= batches; the first of them may be left out.
        batches: into how many parts it is cut.
    """
    length = len(values) // batches
    means = values[len(values) - length * batches :].reshape(batches, length).mean(axis=1)
    scatter = np.array([np.var(means.real, ddof=1), np.var(means.imag, ddof=1)]) / batches
    return scatter * student_2u(batches - 1.0) ** 2


def by_class_removed(values: Complex, period: int) -> Complex:
    """Return values less the mean of all values at the same place of the period: what a periodic orbit leaves over."""
    place: NDArray[np.int64] = np.arange(len(values)) % period
    means = np.array([values[place == p].mean() for p in range(period)])
    return np.asarray(values - means[place], dtype=np.complex128)
