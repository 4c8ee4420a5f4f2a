# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Frequency response functions of sweeps and random excitation: H1, H2, Hv with coherence.

    H1 = S_xy / S_xx        unbiased by noise on the response
    H2 = S_yy / S_yx        unbiased by noise on the excitation
    Hv = [S_yy − κS_xx + √((S_yy − κS_xx)² + 4κ|S_xy|²)] / (2 S_yx)      total least squares, κ = S_noise,y / S_noise,x
    γ² = |S_xy|² / (S_xx S_yy),   u(|H|)/|H| = u(arg H) = √((1 − γ²) / (2 n_d γ²))

S_xy = E[X* Y] by Welch's method (scipy.signal). Shin & Hammond (2008), Fundamentals of Signal Processing, 9.3;
Bendat & Piersol (2010), Random Data, 9.3 for the uncertainty.
"""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy import signal

from impact_rig.analysis.calibration import Calibration, Complex, Real
from impact_rig.analysis.channels import BASE, LASER


@attrs.frozen(eq=False, kw_only=True)
class Frf:
    """Frequency response function of one pair of channels.

    Attributes:
        frequency_hz: shape (n,).
        h1: estimators, shape (n,); h2, hv likewise.
        coherence: γ², shape (n,).
        u_relative: standard uncertainty of |H1| relative to it, and of its phase [rad], by noise alone, shape (n,).
        averages: n_d, effective number of independent averages.
    """

    frequency_hz: Real
    h1: Complex
    h2: Complex
    hv: Complex
    coherence: Real
    u_relative: Real
    averages: float


def frf(
    x: Real,
    y: Real,
    rate_hz: float,
    segment: int,
    *,
    overlap: float = 0.5,
    window: str = "hann",
    noise_ratio: float = 1.0,
) -> Frf:
    """Estimate y / x.

    Args:
        x: excitation, shape (n,).
        y: response, shape (n,).
        rate_hz: samples per second.
        segment: samples per segment: frequency resolution rate / segment. For a periodic chirp one period, boxcar.
        overlap: share of a segment that overlaps the next.
        window: name of a window of scipy.signal.
        noise_ratio: κ of Hv, noise power of y over that of x.

    Raises:
        ValueError: lengths differ, values are not finite, a channel is constant, or the record is too short.
    """
    if x.shape != y.shape or x.ndim != 1:
        raise ValueError(f"x and y must be one-dimensional and of equal length, got {x.shape} and {y.shape}")
    if not 8 <= segment <= len(x) or not 0.0 <= overlap < 1.0:
        raise ValueError(f"segment must be 8 to {len(x)} and overlap 0 to < 1, got {segment} and {overlap}")
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(y))):
        raise ValueError("x and y must be finite")
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        raise ValueError("x and y must not be constant")
    shared = int(overlap * segment)
    options = {"fs": rate_hz, "window": window, "nperseg": segment, "noverlap": shared}
    frequency, s_xx = signal.welch(x, **options)
    _, s_yy = signal.welch(y, **options)
    _, s_xy = signal.csd(x, y, **options)
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = s_yy - noise_ratio * s_xx
        root = np.sqrt(difference**2 + 4.0 * noise_ratio * np.abs(s_xy) ** 2)
        coherence = np.clip(np.abs(s_xy) ** 2 / (s_xx * s_yy), 0.0, 1.0)
        averages = _effective_averages(len(x), segment, shared, window)
        return Frf(
            frequency_hz=frequency,
            h1=s_xy / s_xx,
            h2=s_yy / np.conj(s_xy),
            hv=(difference + root) / (2.0 * np.conj(s_xy)),
            coherence=coherence,
            u_relative=np.sqrt((1.0 - coherence) / (2.0 * averages * coherence)),
            averages=averages,
        )


def transmissibility_frf(
    rows: NDArray[np.void], info: NDArray[np.void], segment: int, *, overlap: float = 0.5, window: str = "hann"
) -> Frf:
    """Return x_1 / x_b of a sweep or random record, skew and lag corrected; u_relative includes the calibration.

    Args:
        rows: consecutive scans (`daq/scan`).
        info: rows of `daq/info`.
        segment: samples per segment.
        overlap: as in `frf`.
        window: as in `frf`.

    Raises:
        ConfigError: `info` does not describe the channels.
        ValueError: as `frf`.
    """
    calibration = Calibration.from_info(info)
    raw = frf(
        np.asarray(rows["base"], dtype=np.float64),
        np.asarray(rows["laser"], dtype=np.float64),
        calibration.rate_hz,
        segment,
        overlap=overlap,
        window=window,
    )
    lag = calibration.response(BASE, raw.frequency_hz) / calibration.response(LASER, raw.frequency_hz)
    gain = np.hypot(calibration.gain_uncertainty[LASER], calibration.gain_uncertainty[BASE])
    return attrs.evolve(
        raw, h1=raw.h1 * lag, h2=raw.h2 * lag, hv=raw.hv * lag, u_relative=np.hypot(raw.u_relative, gain)
    )


def _effective_averages(n: int, segment: int, shared: int, window: str) -> float:
    """Return the number of independent averages: overlapping segments are correlated (Welch 1967, Eq. 12)."""
    step = segment - shared
    count = (n - shared) // step
    shape = signal.get_window(window, segment)
    power = float(shape @ shape)
    correlation = 0.0
    for lag in range(1, min(count, -(-segment // step))):
        overlap = float(shape[lag * step :] @ shape[: segment - lag * step]) / power
        correlation += 2.0 * (1.0 - lag / count) * overlap**2
    return count / (1.0 + correlation)
