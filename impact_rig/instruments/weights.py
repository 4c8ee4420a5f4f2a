# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The weights with which a mode answers a polynomial input over one step.

Each mode follows z' = p z + u. Over a step of length h in which u = Σ d_j (τ − 1/2)^j, τ = t/h in 0 … 1 and j = 0 … 3,

    z(h) = e^{ph} z(0) + Σ_j d_j W_j,    W_j = h ∫_0^1 e^{ph(1−τ)} (τ − 1/2)^j dτ

exactly, however long the step is against 1/p. With q = ph and φ_k = ∫_0^1 e^{q(1−τ)} τ^{k−1} / (k−1)! dτ, so that
φ_k = (φ_{k−1} − 1/(k−1)!) / q and φ_0 = e^q,

    W_0 = h φ_1         W_1 = h (φ_2 − φ_1/2)
    W_2 = h (2 φ_3 − φ_2 + φ_1/4)       W_3 = h (6 φ_4 − 3 φ_3 + 3/4 φ_2 − φ_1/8)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_rig.arithmetic.elementary import exp, sincos
from impact_rig.kernels import kernel

_PER_FACTORIAL = np.array([1 / math.factorial(k) for k in range(26)])


class Weights(NamedTuple):
    """What one step does to one mode: e^{ph} and W_j [s], each with its real and imaginary part."""

    decay_re: float
    decay_im: float
    w0_re: float
    w0_im: float
    w1_re: float
    w1_im: float
    w2_re: float
    w2_im: float
    w3_re: float
    w3_im: float


@kernel
def weigh(pole_re, pole_im, h):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return the weights of a step of h seconds for the mode with that pole [rad/s]."""
    q_re, q_im = pole_re * h, pole_im * h
    if abs(q_re) + abs(q_im) < 2.0:
        e, phi1, phi2, phi3, phi4 = _by_series(q_re, q_im)
    else:
        e, phi1, phi2, phi3, phi4 = _by_division(q_re, q_im)
    return Weights(
        e[0],
        e[1],
        h * phi1[0],
        h * phi1[1],
        h * (phi2[0] - 0.5 * phi1[0]),
        h * (phi2[1] - 0.5 * phi1[1]),
        h * (2.0 * phi3[0] - phi2[0] + 0.25 * phi1[0]),
        h * (2.0 * phi3[1] - phi2[1] + 0.25 * phi1[1]),
        h * (6.0 * phi4[0] - 3.0 * phi3[0] + 0.75 * phi2[0] - 0.125 * phi1[0]),
        h * (6.0 * phi4[1] - 3.0 * phi3[1] + 0.75 * phi2[1] - 0.125 * phi1[1]),
    )


@kernel
def _by_series(q_re, q_im):  # type: ignore[no-untyped-def]
    """Return e^q and φ_1 … φ_4 for small q: φ_4 = Σ q^i / (i + 4)!, then φ_{k−1} = 1/(k−1)! + q φ_k."""
    size = abs(q_re) + abs(q_im)
    terms = 8 if size < 0.1 else 13 if size < 0.5 else 22
    re, im = _PER_FACTORIAL[terms + 3], 0.0
    for i in range(terms + 2, 3, -1):
        re, im = _PER_FACTORIAL[i] + (q_re * re - q_im * im), q_re * im + q_im * re
    phi4 = (re, im)
    phi3 = _one_up(q_re, q_im, phi4, 1.0 / 6.0)
    phi2 = _one_up(q_re, q_im, phi3, 0.5)
    phi1 = _one_up(q_re, q_im, phi2, 1.0)
    return _one_up(q_re, q_im, phi1, 1.0), phi1, phi2, phi3, phi4


@kernel
def _one_up(q_re, q_im, phi, constant):  # type: ignore[no-untyped-def]
    return constant + (q_re * phi[0] - q_im * phi[1]), q_re * phi[1] + q_im * phi[0]


@kernel
def _by_division(q_re, q_im):  # type: ignore[no-untyped-def]
    """Return e^q and φ_1 … φ_4 for large q: φ_k = (φ_{k−1} − 1/(k−1)!) / q."""
    size = exp(q_re)
    sine, cosine = sincos(q_im)
    e = (size * cosine, size * sine)
    phi1 = _one_down(q_re, q_im, e, 1.0)
    phi2 = _one_down(q_re, q_im, phi1, 1.0)
    phi3 = _one_down(q_re, q_im, phi2, 0.5)
    return e, phi1, phi2, phi3, _one_down(q_re, q_im, phi3, 1.0 / 6.0)


@kernel
def _one_down(q_re, q_im, phi, constant):  # type: ignore[no-untyped-def]
    per_square = 1.0 / (q_re * q_re + q_im * q_im)
    real = phi[0] - constant
    return (real * q_re + phi[1] * q_im) * per_square, (phi[1] * q_re - real * q_im) * per_square
