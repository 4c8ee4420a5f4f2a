# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The drive inside one segment: u(t) = (A + B t) sin(ω t + φ), and the linear systems' particular answer to it.

With y' = M y + b_0 u + b_1 u' and the resolvent R(ω) = (jω − M)^-1,

    y_p(t) = Im[(P + Q t) exp(jωt)],   H = R (b_0 + jω b_1),   G = R (b_1 − H)
    Q = B e^{jφ} H,                    P = A e^{jφ} H + B e^{jφ} G
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_rig.arithmetic.elementary import modulus, sincos
from impact_rig.kernels import kernel

SEGMENT = np.dtype([(name, "f8") for name in ("duration", "omega", "phase", "amplitude", "slope", "begin")])
"""Drive segments, in order: seconds, rad/s, rad, and amplitude and its rate in A, m or V by drive. A segment begins a
tick of its own, or goes on `begin` > 0 seconds after the start of the tick of the one before."""


class Forcing(NamedTuple):
    """One segment of the drive."""

    omega: float
    phase: float
    amplitude: float
    slope: float
    begin: float


@kernel
def drive(f, t):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return u and u' at t."""
    level = f.amplitude + f.slope * t
    sine, cosine = sincos(f.omega * t + f.phase)
    return level * sine, f.slope * sine + level * f.omega * cosine


@kernel
def turned(angle):  # type: ignore[no-untyped-def]
    """Return exp(j angle)."""
    sine, cosine = sincos(angle)
    return complex(cosine, sine)


@kernel
def size(z):  # type: ignore[no-untyped-def]
    """Return |z|."""
    return modulus(z.real, z.imag)


@kernel
def bound_omega(system, omega):  # type: ignore[no-untyped-def]
    """Return the fastest rate [1/s] of the drive and the modes."""
    fastest = max(omega, 1e-9)
    for k in range(system.modes):
        fastest = max(fastest, size(system.rate[k]))
    return fastest


@kernel
def _half_reciprocal(z):  # type: ignore[no-untyped-def]
    """Return 1 / (2 z)."""
    scale = 0.5 / (z.real * z.real + z.imag * z.imag)
    return complex(z.real * scale, -z.imag * scale)


@kernel
def _resolve(system, omega, vector, out):  # type: ignore[no-untyped-def]
    """Fill out = (jω − M)^-1 vector; each kept mode stands for itself and its conjugate."""
    n = system.states
    for i in range(n):
        out[i] = 0.0j
    for k in range(system.modes):
        rate = system.rate[k]
        plus, minus = 0.0j, 0.0j
        for i in range(n):
            left = system.left[k, i]
            plus += left * vector[i]
            minus += complex(left.real, -left.imag) * vector[i]
        plus *= _half_reciprocal(complex(-rate.real, omega - rate.imag))
        minus *= _half_reciprocal(complex(-rate.real, omega + rate.imag))
        for i in range(n):
            right = system.right[k, i]
            out[i] += right * plus + complex(right.real, -right.imag) * minus


@kernel
def transfer(system, omega, k):  # type: ignore[no-untyped-def]
    """Fill `k.answer` (H) and `k.drift` (G): what the system does for a steady and for a growing drive."""
    n = system.states
    vector = k.steady  # scratch: `particular` fills it anew
    for i in range(n):
        vector[i] = complex(system.b_0[i], omega * system.b_1[i])
    _resolve(system, omega, vector, k.answer)
    for i in range(n):
        vector[i] = complex(system.b_1[i] - k.answer[i].real, -k.answer[i].imag)
    _resolve(system, omega, vector, k.drift)


@kernel
def particular(system, f, k):  # type: ignore[no-untyped-def]
    """Fill `k.steady` (P) and `k.growing` (Q) for this segment's amplitude and phase."""
    turn = turned(f.phase)
    for i in range(system.states):
        k.growing[i] = f.slope * turn * k.answer[i]
        k.steady[i] = f.amplitude * turn * k.answer[i] + f.slope * turn * k.drift[i]
