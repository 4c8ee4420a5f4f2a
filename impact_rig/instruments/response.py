# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The exact response of a sensor's modes to a motion, read off at the instants of conversion.

Each mode follows z' = p z + u, the output is Σ Re(r z). On a piece of half length H the input is a polynomial,
u = Σ u_k x^k with x = −1 … 1, and the mode is the sum of a particular answer to it and of what it rings with:

    z = Σ g_k x^k + (z(−1) − Σ g_k (−1)^k) exp(p H (x + 1)),    with q = p H one of

    |q| >= 1    g_k = ((k + 1) g_{k+1} − H u_k) / q,    g_8 = 0        downwards: a polynomial of the same degree
    |q| < 1     g_{k+1} = (q g_k + H u_k) / (k + 1),    g_0 = 0        upwards: a power series, SERIES terms of it

The polynomials of all modes of a channel are added up once a piece; a conversion then costs one polynomial, and a
multiplication for each mode that still rings. Nothing depends on how conversions and pieces lie to each other, and no
pulse falls between two scans.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import exp, sincos
from impact_rig.arithmetic.interpolation import NODES
from impact_rig.kernels import kernel

MODE = np.dtype(
    [
        ("pole_re", "f8"),  # [rad/s]
        ("pole_im", "f8"),
        ("residue_re", "f8"),
        ("residue_im", "f8"),
        ("z_re", "f8"),  # value at the start of the piece [unit s]
        ("z_im", "f8"),
        ("decay_re", "f8"),  # exp(p h), h from one conversion to the next
        ("decay_im", "f8"),
        ("rings", "i8"),  # conversions after which nothing is left of it
        ("free_re", "f8"),  # what it rings with at a piece's first conversion, times the residue
        ("free_im", "f8"),
    ]
)
"""A mode of a channel."""

SERIES = 16
_SHORT = 10
"""Terms of the sum of all modes' polynomials, where what lies beyond is lost in the rounding of the others."""
_LOST = 2.0**-54
_SILENT = 45.0  # exp(−45) = 3e-20


@kernel
def turned(re, im, seconds):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return exp((re + j im) seconds)."""
    size = exp(re * seconds)
    if im == 0.0:
        return size, 0.0
    sine, cosine = sincos(im * seconds)
    return size * cosine, size * sine


@kernel
def weigh(modes, period_s):  # type: ignore[no-untyped-def]
    """Note what one scan period does to each mode."""
    for k in range(modes.shape[0]):
        mode = modes[k]
        mode.decay_re, mode.decay_im = turned(mode.pole_re, mode.pole_im, period_s)
        mode.rings = math.ceil(min(1e9, _SILENT / (-mode.pole_re * period_s)))


@kernel
def settle(modes, level):  # type: ignore[no-untyped-def]
    """Go on as if the input had been at `level` for ever: z = −level / pole."""
    for k in range(modes.shape[0]):
        mode = modes[k]
        per_square = 1.0 / (mode.pole_re * mode.pole_re + mode.pole_im * mode.pole_im)
        mode.z_re, mode.z_im = -level * mode.pole_re * per_square, level * mode.pole_im * per_square


@kernel
def first_value(u):  # type: ignore[no-untyped-def]
    """Return the polynomial at x = −1."""
    value = 0.0
    for k in range(NODES - 1, -1, -1):
        value = u[k] - value
    return value


@kernel
def _particular(mode, u, half, g):  # type: ignore[no-untyped-def]
    """Fill g, shape (2, SERIES), with the particular answer to u; return its values at x = −1 and 1, re and im."""
    q_re, q_im = mode.pole_re * half, mode.pole_im * half
    re, im = 0.0, 0.0
    even_re, even_im, odd_re, odd_im = 0.0, 0.0, 0.0, 0.0
    if abs(q_re) + abs(q_im) >= 1.0:
        per_square = 1.0 / (q_re * q_re + q_im * q_im)
        per_re, per_im = q_re * per_square, -q_im * per_square
        for k in range(NODES - 1, -1, -1):
            a, b = (k + 1) * re - half * u[k], (k + 1) * im
            re, im = a * per_re - b * per_im, a * per_im + b * per_re
            g[0, k], g[1, k] = re, im
            if k % 2 == 0:
                even_re, even_im = even_re + re, even_im + im
            else:
                odd_re, odd_im = odd_re + re, odd_im + im
        for k in range(NODES, SERIES):
            g[0, k], g[1, k] = 0.0, 0.0
    else:
        for k in range(SERIES):
            g[0, k], g[1, k] = re, im
            if k % 2 == 0:
                even_re, even_im = even_re + re, even_im + im
            else:
                odd_re, odd_im = odd_re + re, odd_im + im
            push = half * u[k] if k < NODES else 0.0
            per = 1.0 / (k + 1)
            re, im = ((q_re * re - q_im * im) + push) * per, (q_re * im + q_im * re) * per
    return even_re - odd_re, even_im - odd_im, even_re + odd_re, even_im + odd_im


@kernel
def through_piece(modes, u, length, since, work, out):  # type: ignore[no-untyped-def]
    """Carry the modes through a piece; fill `out` with what they put out at the conversions in it.

    Args:
        modes: of one channel.
        u: polynomial of the input, shape (NODES,).
        length: of the piece [s].
        since: time of its first conversion after its start, and from one conversion to the next [s].
        work: scratch, shape (3, SERIES).
        out: one place for each conversion.
    """
    half, count = 0.5 * length, out.shape[0]
    g, y = work[:2], work[2]
    y[:] = 0.0
    for n in range(modes.shape[0]):
        mode = modes[n]
        first_re, first_im, last_re, last_im = _particular(mode, u, half, g)
        free_re, free_im = mode.z_re - first_re, mode.z_im - first_im
        if count:
            r_re, r_im = mode.residue_re, mode.residue_im
            for k in range(SERIES):
                y[k] += r_re * g[0, k] - r_im * g[1, k]
            e_re, e_im = turned(mode.pole_re, mode.pole_im, since[0])
            a, b = e_re * free_re - e_im * free_im, e_re * free_im + e_im * free_re
            mode.free_re, mode.free_im = r_re * a - r_im * b, r_re * b + r_im * a
        e_re, e_im = turned(mode.pole_re, mode.pole_im, length)
        mode.z_re = (e_re * free_re - e_im * free_im) + last_re
        mode.z_im = (e_re * free_im + e_im * free_re) + last_im
    if count:
        largest = _add_polynomial(y, (since[0] - half) / half, since[1] / half, out)
        for n in range(modes.shape[0]):
            _add_ringing(modes[n], largest, out)


@kernel
def _add_polynomial(y, x, step, out):  # type: ignore[no-untyped-def]
    """Fill in the polynomial at x, x + step, …; return the size of its coefficients."""
    largest, beyond = 0.0, 0.0
    for k in range(SERIES):
        largest = max(largest, abs(y[k]))
        if k >= _SHORT:
            beyond = max(beyond, abs(y[k]))
    y_0, y_1, y_2, y_3, y_4, y_5, y_6, y_7, y_8, y_9 = y[0], y[1], y[2], y[3], y[4], y[5], y[6], y[7], y[8], y[9]
    for m in range(out.shape[0]):
        a = x + m * step
        upper = y_5 + a * (y_6 + a * (y_7 + a * (y_8 + a * y_9)))
        out[m] = y_0 + a * (y_1 + a * (y_2 + a * (y_3 + a * (y_4 + a * upper))))
    if beyond > _LOST * largest:
        for m in range(out.shape[0]):
            a = x + m * step
            total = y[SERIES - 1]
            for k in range(SERIES - 2, -1, -1):
                total = total * a + y[k]
            out[m] = total
    return largest


@kernel
def _add_ringing(mode, largest, out):  # type: ignore[no-untyped-def]
    """Add what a mode rings with, where it is not lost in the rounding of the rest."""
    re, im, decay_re, decay_im = mode.free_re, mode.free_im, mode.decay_re, mode.decay_im
    if abs(re) + abs(im) <= _LOST * largest:
        return
    count = min(out.shape[0], mode.rings)
    if mode.pole_im == 0.0:
        for m in range(count):
            out[m] += re
            re = decay_re * re
    else:
        for m in range(count):
            out[m] += re
            re, im = decay_re * re - decay_im * im, decay_re * im + decay_im * re


def records_of(poles: NDArray[np.complex128], residues: NDArray[np.complex128]) -> NDArray[np.void]:
    """Return MODE records, at zero."""
    rows = np.zeros(len(poles), MODE)
    rows["pole_re"], rows["pole_im"] = poles.real, poles.imag
    rows["residue_re"], rows["residue_im"] = residues.real, residues.imag
    return rows
