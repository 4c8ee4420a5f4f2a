# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the mean of a series whose values may be correlated: long-run variance, batch means."""

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


def student_2u(freedom: float) -> float:
    """Return the factor by which a standard uncertainty must grow so that ±2u covers 95.45 % of Student's t.

    The quantile by the expansion of Abramowitz & Stegun (1964), 26.7.5, at the normal quantile 2: within 0.3 % of
    the true one from 4 degrees of freedom on; fewer than 2 count as 2.
    """
    inverse = 1.0 / max(freedom, 2.0)
    return 1.0 + 1.25 * inverse + 1.531 * inverse**2 + 1.43 * inverse**3


def batch_variance(values: Complex, batches: int) -> Real:
    """Return the variances (real, imaginary) of the mean of a series from the scatter of the means of a few batches.

    Batches much longer than the correlation are as good as independent, however it decays (Schmeiser 1982, Operations
    Research 30, 556–568). Where they are not, what a variance from b batches lacks is in proportion to b: 2V_b − V_2b
    has none of it (Vats & Flegal 2022, Biometrika 109, 735–750). That they are few is in `student_2u`.

    Args:
        values: series, shape (n,), n >= batches; the first of them may be left out.
        batches: into how many parts it is cut, b.
    """
    coarse = _scatter_of_batches(values, batches)
    fine = _scatter_of_batches(values, 2 * batches) if len(values) >= 2 * batches else coarse
    return np.maximum(2.0 * coarse - fine, coarse) * student_2u(batches - 1.0) ** 2


def _scatter_of_batches(values: Complex, batches: int) -> Real:
    length = len(values) // batches
    means = values[len(values) - length * batches :].reshape(batches, length).mean(axis=1)
    return np.array([np.var(means.real, ddof=1), np.var(means.imag, ddof=1)]) / batches


def by_class_removed(values: Complex, period: int) -> Complex:
    """Return values less the mean of all values at the same place of the period: what a periodic orbit leaves over."""
    place: NDArray[np.int64] = np.arange(len(values)) % period
    means = np.array([values[place == p].mean() for p in range(period)])
    return np.asarray(values - means[place], dtype=np.complex128)
