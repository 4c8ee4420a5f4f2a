# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Shocks: a half sine with compensation, so that a shaker can make it, and shock response spectra.

A half sine of acceleration changes the velocity for good, which no table can. Two low pulses of the opposite sign,
before and after, each a quarter of a cosine wide at its ends, take the velocity and the displacement back to zero.

    shock response spectrum: the largest |response| of x'' + 2ζω x' + ω² x = −a over time, for each natural frequency

by the ramp-invariant filter (Smallwood 1981, Shock and Vibration Bulletin 51, 279–287), which is exact for an
acceleration of straight lines between its samples.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy import signal

Real = NDArray[np.float64]


@attrs.frozen(kw_only=True)
class Pulse:
    """A half sine with its compensation.

    Attributes:
        peak: of the acceleration [m/s²].
        duration_s: of the half sine.
        compensation_s: of each of the two pulses beside it.
    """

    peak: float = attrs.field(default=20.0, validator=attrs.validators.gt(0.0))
    duration_s: float = attrs.field(default=11e-3, validator=attrs.validators.gt(0.0))
    compensation_s: float = attrs.field(default=0.15, validator=attrs.validators.gt(0.0))

    def acceleration(self, rate_hz: int) -> Real:
        """Return the acceleration [m/s²], shape (n,); its sum and the sum of its running sum are zero."""
        on, beside = round(self.duration_s * rate_hz), round(self.compensation_s * rate_hz)
        pulse = self.half_sine(rate_hz)
        hill = np.sin(np.pi * (np.arange(beside) + 0.5) / beside) ** 2
        before, after = np.zeros(on + 2 * beside), np.zeros(on + 2 * beside)
        whole = np.zeros(on + 2 * beside)
        before[:beside], after[-beside:], whole[beside : beside + on] = hill, hill, pulse
        sums = np.array([[one.sum(), one.cumsum().sum()] for one in (before, after)]).T
        low = np.linalg.solve(sums, [-whole.sum(), -whole.cumsum().sum()])
        return np.asarray(whole + low[0] * before + low[1] * after)

    def half_sine(self, rate_hz: int) -> Real:
        """Return the half sine alone [m/s²], shape (n,)."""
        on = round(self.duration_s * rate_hz)
        return np.asarray(self.peak * np.sin(np.pi * (np.arange(on) + 0.5) / on))

    def displacement(self, rate_hz: int) -> Real:
        """Return the base's displacement that has this acceleration [m], shape (n,); it begins and ends at zero."""
        acceleration = self.acceleration(rate_hz)
        velocity = np.cumsum(acceleration) / rate_hz
        return np.asarray((np.cumsum(velocity) - 0.5 * velocity) / rate_hz)


def shock_response_spectrum(acceleration: Real, rate_hz: float, frequency_hz: Real, quality: float = 10.0) -> Real:
    """Return the largest absolute acceleration of single degrees of freedom, during and after, shape as frequencies.

    Args:
        acceleration: of the base [m/s²], shape (n,).
        rate_hz: samples per second.
        frequency_hz: natural frequencies.
        quality: 1 / (2 ζ); infinite without damping.
    """
    zeta = 0.5 / quality
    found = np.empty(len(frequency_hz))
    for i, natural in enumerate(frequency_hz):
        omega, t = 2.0 * math.pi * natural, 1.0 / rate_hz
        damped = omega * math.sqrt(1.0 - zeta * zeta)
        e, k = math.exp(-zeta * omega * t), damped * t
        c, s = e * math.cos(k), e * math.sin(k)
        ratio = s / k
        numerator = (1.0 - ratio, 2.0 * (ratio - c), e * e - ratio)
        ring = np.zeros(math.ceil(rate_hz / natural))  # the residual: a whole period of what rings on
        response = signal.lfilter(numerator, (1.0, -2.0 * c, e * e), np.concatenate([acceleration, ring]))
        found[i] = np.abs(response).max()
    return found


def half_sine_spectrum(peak: float, duration_s: float, frequency_hz: Real) -> Real:
    """Return the undamped shock response spectrum of an ideal half sine, in closed form.

    With r = 2 f τ the residual is 2 r |cos(π r / 2)| / |1 − r²|; where r > 1, an extreme within the pulse may be larger
    (Harris & Piersol 2002, Shock and Vibration Handbook, chapter 8).
    """
    r = 2.0 * frequency_hz * duration_s
    found = np.empty(len(r))
    for i, ratio in enumerate(r):
        if abs(ratio - 1.0) < 1e-9:
            found[i] = 0.5 * math.pi
            continue
        residual = 2.0 * ratio * abs(math.cos(0.5 * math.pi * ratio) / (1.0 - ratio * ratio))
        primary = 0.0
        if ratio > 1.0:
            # x''_abs = r/(r² − 1) (r sin θ − sin r θ), θ = πt/τ in 0 … π: extremes at θ = 2 π n / (r + 1)
            at = 2.0 * math.pi * np.arange(1, int((ratio + 1.0) / 2.0) + 1) / (ratio + 1.0)
            primary = float(np.abs(ratio / (ratio**2 - 1.0) * (ratio * np.sin(at) - np.sin(ratio * at))).max())
        found[i] = max(primary, residual)
    return peak * found
