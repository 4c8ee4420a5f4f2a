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
"""Exact response of a sensor's modes to a motion, evaluated at the instants of conversion.

The value of a mode follows ψ' = λ ψ + S, with S the sensor's input and λ the mode's pole; the sensor's output is the
sum of Re(residue ψ) over its modes. On a piece of half length `half` the input is a polynomial, S = Σ S_k x^k, x = −1 …
1, and the mode is the sum of a particular answer to it and a free response:

    ψ = Σ ψ_k x^k + (ψ(−1) − Σ ψ_k (−1)^k) exp(λ half (x + 1))

    size >= 1    ψ_k = ((k + 1) ψ_{k+1} − half S_k) / (λ half),    ψ_8 = 0    downwards: of the same degree as S

    size < 1     ψ_{k+1} = (λ half ψ_k + half S_k) / (k + 1),      ψ_0 = 0    upwards: SERIES_TERMS of a power series

with size = |Re λ half| + |Im λ half|. The polynomials of all modes of a channel are added once per piece. A conversion
then costs one polynomial, and one multiplication for each mode that still rings. The result does not depend on the
alignment of conversions and pieces, and no pulse is missed between two scans.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import exp, sincos
from impact_rig.arithmetic.interpolation import NODES
from impact_rig.kernels import Reals, Record, Records, kernel

SENSOR_MODE = np.dtype(
    [
        ("pole_re", "f8"),  # real part of λ [1/s]
        ("pole_im", "f8"),  # imaginary part of λ [rad/s]
        ("residue_re", "f8"),  # real part of the residue, the factor of ψ in the channel's output [1/s]
        ("residue_im", "f8"),  # imaginary part of it [1/s]
        ("psi_re", "f8"),  # real part of ψ at the start of the piece [unit s]
        ("psi_im", "f8"),  # imaginary part of it [unit s]
        ("decay_re", "f8"),  # real part of exp(λ scan period) [-]
        ("decay_im", "f8"),  # imaginary part of it [-]
        ("rings_for", "i8"),  # number of conversions after which its free response is negligible
        ("free_re", "f8"),  # real part of the residue times the free response at a piece's first conversion [unit]
        ("free_im", "f8"),  # imaginary part of it [unit]
    ]
)
"""Record of a mode of a channel: one pole of its sensor's dynamics, with the state ψ."""

SERIES_TERMS = 16
_SHORT_TERMS = 10
"""Number of terms of the sum of all modes' polynomials that usually suffice, because the others are lost in the
rounding. If the others are not negligible, all SERIES_TERMS are used.
"""
_LOST = 2.0**-54
_SILENT = 45.0  # exp(−45) = 3e-20


@kernel
def decayed(re: float, im: float, seconds: float) -> tuple[float, float]:
    """Return exp((re + j im) seconds), the decay of a mode with the pole re + j im, as real and imaginary part."""
    envelope = exp(re * seconds)
    if im == 0.0:
        return envelope, 0.0
    sine, cosine = sincos(im * seconds)
    return envelope * cosine, envelope * sine


@kernel
def set_period(modes: Records, period_s: float) -> None:
    """Set each mode's decay in a scan period [s], and the number of periods for which its free response matters."""
    for k in range(modes.shape[0]):
        mode = modes[k]
        mode.decay_re, mode.decay_im = decayed(mode.pole_re, mode.pole_im, period_s)
        mode.rings_for = math.ceil(min(1e9, _SILENT / (-mode.pole_re * period_s)))


@kernel
def settle(modes: Records, level: float) -> None:
    """Set the states ψ of the modes as if the sensor's input had always been `level`: ψ = −level / λ."""
    for k in range(modes.shape[0]):
        mode = modes[k]
        per_square = 1.0 / (mode.pole_re * mode.pole_re + mode.pole_im * mode.pole_im)
        mode.psi_re, mode.psi_im = -level * mode.pole_re * per_square, level * mode.pole_im * per_square


@kernel
def input_at_start(coefficients: Reals) -> float:
    """Return the value of the sensor's input Σ coefficients[k] x^k at the start of a piece, x = −1."""
    value = 0.0
    for k in range(NODES - 1, -1, -1):
        value = coefficients[k] - value
    return value


@kernel
def output_at_start(modes: Records) -> float:
    """Return the sensor's output at the start of a piece, the sum of Re(residue ψ) over its modes."""
    value = 0.0
    for k in range(modes.shape[0]):
        mode = modes[k]
        value += mode.residue_re * mode.psi_re - mode.residue_im * mode.psi_im
    return value


@kernel
def _particular(mode: Record, coefficients: Reals, half: float, psi: Reals) -> tuple[float, float, float, float]:
    """Fill `psi` with the polynomial coefficients of a particular solution ψ of a mode's equation on a piece.

    `coefficients` is the polynomial of the sensor's input, and `half` is the half length of the piece [s]. `psi` has
    the shape (2, SERIES_TERMS), for real and imaginary part. The function returns real and imaginary part of ψ at the
    start of the piece, then at its end.
    """
    pole_half_re, pole_half_im = mode.pole_re * half, mode.pole_im * half
    re, im = 0.0, 0.0
    even_re, even_im, odd_re, odd_im = 0.0, 0.0, 0.0, 0.0
    if abs(pole_half_re) + abs(pole_half_im) >= 1.0:
        per_square = 1.0 / (pole_half_re * pole_half_re + pole_half_im * pole_half_im)
        reciprocal_re, reciprocal_im = pole_half_re * per_square, -pole_half_im * per_square
        for k in range(NODES - 1, -1, -1):
            numerator_re, numerator_im = (k + 1) * re - half * coefficients[k], (k + 1) * im
            re, im = (
                numerator_re * reciprocal_re - numerator_im * reciprocal_im,
                numerator_re * reciprocal_im + numerator_im * reciprocal_re,
            )
            psi[0, k], psi[1, k] = re, im
            if k % 2 == 0:
                even_re, even_im = even_re + re, even_im + im
            else:
                odd_re, odd_im = odd_re + re, odd_im + im
        for k in range(NODES, SERIES_TERMS):
            psi[0, k], psi[1, k] = 0.0, 0.0
    else:
        for k in range(SERIES_TERMS):
            psi[0, k], psi[1, k] = re, im
            if k % 2 == 0:
                even_re, even_im = even_re + re, even_im + im
            else:
                odd_re, odd_im = odd_re + re, odd_im + im
            half_coefficient = half * coefficients[k] if k < NODES else 0.0
            per_power = 1.0 / (k + 1)
            re, im = (
                ((pole_half_re * re - pole_half_im * im) + half_coefficient) * per_power,
                (pole_half_re * im + pole_half_im * re) * per_power,
            )
    return even_re - odd_re, even_im - odd_im, even_re + odd_re, even_im + odd_im


@kernel
def through_piece(
    modes: Records, coefficients: Reals, length: float, first_and_spacing: Reals, scratch: Reals, out: Reals
) -> None:
    """Advance the modes of a channel through a piece, and fill `out` with the sensor's output at its conversions.

    Args:
        modes: modes of one channel, to which `set_period` has applied the time between conversions.
        coefficients: polynomial coefficients of the sensor's input, constant first, shape (NODES,). The variable is −1
            at the start of the piece and 1 at its end.
        length: length of the piece [s].
        first_and_spacing: time from the start of the piece to its first conversion, and between conversions [s].
        scratch: scratch memory, shape (3, SERIES_TERMS).
        out: output at each conversion.
    """
    half, count = 0.5 * length, out.shape[0]
    psi, total = scratch[:2], scratch[2]
    total[:] = 0.0
    for n in range(modes.shape[0]):
        mode = modes[n]
        start_re, start_im, end_re, end_im = _particular(mode, coefficients, half, psi)
        free_re, free_im = mode.psi_re - start_re, mode.psi_im - start_im
        if count:
            residue_re, residue_im = mode.residue_re, mode.residue_im
            for k in range(SERIES_TERMS):
                total[k] += residue_re * psi[0, k] - residue_im * psi[1, k]
            decay_re, decay_im = decayed(mode.pole_re, mode.pole_im, first_and_spacing[0])
            re, im = decay_re * free_re - decay_im * free_im, decay_re * free_im + decay_im * free_re
            mode.free_re, mode.free_im = residue_re * re - residue_im * im, residue_re * im + residue_im * re
        decay_re, decay_im = decayed(mode.pole_re, mode.pole_im, length)
        mode.psi_re = (decay_re * free_re - decay_im * free_im) + end_re
        mode.psi_im = (decay_re * free_im + decay_im * free_re) + end_im
    if count:
        largest = _fill_polynomial(total, (first_and_spacing[0] - half) / half, first_and_spacing[1] / half, out)
        for n in range(modes.shape[0]):
            _add_ringing(modes[n], largest, out)


@kernel
def _fill_polynomial(total: Reals, first: float, spacing: float, out: Reals) -> float:
    """Fill `out` with the values of a polynomial at x = first, first + spacing, ….

    `total` holds its coefficients, constant first. The result is the magnitude of the largest coefficient.
    """
    largest, beyond = 0.0, 0.0
    for k in range(SERIES_TERMS):
        largest = max(largest, abs(total[k]))
        if k >= _SHORT_TERMS:
            beyond = max(beyond, abs(total[k]))
    o_0, o_1, o_2, o_3, o_4 = total[0], total[1], total[2], total[3], total[4]  # read once, not for each conversion
    o_5, o_6, o_7, o_8, o_9 = total[5], total[6], total[7], total[8], total[9]
    for i in range(out.shape[0]):
        x = first + i * spacing
        upper = o_5 + x * (o_6 + x * (o_7 + x * (o_8 + x * o_9)))
        out[i] = o_0 + x * (o_1 + x * (o_2 + x * (o_3 + x * (o_4 + x * upper))))
    if beyond > _LOST * largest:
        for i in range(out.shape[0]):
            x = first + i * spacing
            value = total[SERIES_TERMS - 1]
            for k in range(SERIES_TERMS - 2, -1, -1):
                value = value * x + total[k]
            out[i] = value
    return largest


@kernel
def _add_ringing(mode: Record, largest: float, out: Reals) -> None:
    """Add a mode's free response to `out`, the outputs at the conversions in a piece, unless it is negligible.

    `largest` is the result of `_fill_polynomial`, a scale of the output.
    """
    re, im, decay_re, decay_im = mode.free_re, mode.free_im, mode.decay_re, mode.decay_im
    if abs(re) + abs(im) <= _LOST * largest:
        return
    count = min(out.shape[0], mode.rings_for)
    if mode.pole_im == 0.0:
        for i in range(count):
            out[i] += re
            re = decay_re * re
    else:
        for i in range(count):
            out[i] += re
            re, im = decay_re * re - decay_im * im, decay_re * im + decay_im * re


def mode_records(poles: NDArray[np.complex128], residues: NDArray[np.complex128]) -> NDArray[np.void]:
    """Return SENSOR_MODE records with these poles and residues and with the state zero."""
    rows = np.zeros(len(poles), SENSOR_MODE)
    rows["pole_re"], rows["pole_im"] = poles.real, poles.imag
    rows["residue_re"], rows["residue_im"] = residues.real, residues.imag
    return rows
