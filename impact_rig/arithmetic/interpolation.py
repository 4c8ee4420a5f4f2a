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
"""Interpolation by polynomials of degree seven on a piece, x = −1 … 1, through eight Chebyshev points.

    S(x) = Σ_k S_k x^k,   S_k = Σ_q TO_MONOMIALS[k, q] S(node_q),   node_q = −cos((2q + 1) π/16)

Column q of TO_MONOMIALS holds the coefficients of Lagrange's polynomial Π_{i≠q} (x − node_i) / (node_q − node_i). For a
smooth S of angular frequency ω on a piece of the duration 2 half, the error is 2 (ω half / 2)^8 / 8!: below 1e-5 for a
piece of half a period.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.precise import ONE, ZERO, dot, pi, unit, with_70_digits
from impact_rig.kernels import INTEGERS, REALS, REALS_2D, Integers, Reals, entry, kernel

NODES = 8
PIECE_TERMS = 14
"""Number of terms of the power series that `shorten` reduces to NODES terms."""


@with_70_digits
def _chebyshev() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the Chebyshev nodes in ascending order, the matrix TO_MONOMIALS, and the matrix that `shorten` uses.

    The last matrix replaces x^k, for k = NODES … PIECE_TERMS − 1, by the polynomial that agrees with x^k at the nodes.
    Row k − NODES contains the coefficients of this polynomial, constant first.
    """
    x = [unit(pi() * (2 * j + 1) / (2 * NODES)).real for j in reversed(range(NODES))]
    columns = []
    for j, node in enumerate(x):
        factors, scale = [ONE], ONE  # coefficients of Π (x − x_i), constant first
        for other in x[:j] + x[j + 1 :]:
            factors = [above - other * here for above, here in zip([ZERO, *factors], [*factors, ZERO], strict=True)]
            scale *= node - other
        columns.append([factor / scale for factor in factors])
    inverse, powers, shortened = list(zip(*columns, strict=True)), [ONE for _ in x], []
    for k in range(PIECE_TERMS):
        if k >= NODES:
            shortened.append([float(dot(row, powers)) for row in inverse])
        powers = [power * node for power, node in zip(powers, x, strict=True)]
    return np.array([float(node) for node in x]), np.array(inverse, float), np.array(shortened)


NODE_AT, TO_MONOMIALS, _SHORTENED = _chebyshev()


@kernel
def through_nodes(values: Reals, coefficients: Reals) -> None:
    """Compute the coefficients, constant first, of the polynomial in x that has `values` at the nodes.

    The nodes are the Chebyshev points `NODE_AT`, in ascending order. Both arrays have the shape (NODES,). The result is
    written to `coefficients`.
    """
    for j in range(NODES):
        total = 0.0
        for k in range(NODES):
            total += TO_MONOMIALS[j, k] * values[k]
        coefficients[j] = total


@kernel
def shorten(series: Reals, coefficients: Reals) -> None:
    """Approximate a power series in x by the polynomial of NODES terms that agrees with the series at the nodes.

    `series` holds the PIECE_TERMS coefficients of the series, constant first. The coefficients of the polynomial are
    written to `coefficients`, constant first.
    """
    for j in range(NODES):
        total = series[j]
        for k in range(NODES + j % 2, PIECE_TERMS, 2):  # the others are even where this one is odd
            total += _SHORTENED[k - NODES, j] * series[k]
        coefficients[j] = total


def polynomials(
    of: Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.float64]],
    tick: NDArray[np.int64],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the coefficients, constant first, of polynomials that interpolate quantities on pieces of time.

    On each piece, x goes from −1 at its start to 1 at its end. The shape is (quantities, pieces, NODES).

    Args:
        of: function that returns the quantities at instants, shape (quantities, instants), from the tick of each
            instant and its offset into the tick [s].
        tick: number of the tick (10 ms of the scan clock) in which each piece lies.
        start: start of each piece, offset into its tick [s].
        end: end of each piece, offset into its tick [s].
    """
    at, offset = np.empty(len(start) * NODES, np.int64), np.empty(len(start) * NODES)
    _nodes(start, end, tick, at, offset)
    values = np.ascontiguousarray(of(at, offset))
    coefficients = np.empty((len(values), len(start), NODES))
    _to_monomials(values.reshape(-1, NODES), coefficients.reshape(-1, NODES))
    return coefficients


@entry(REALS, REALS, INTEGERS, INTEGERS, REALS)
def _nodes(start: Reals, end: Reals, tick: Integers, ticks: Integers, offsets: Reals) -> None:
    for i in range(start.shape[0]):
        centre, half = 0.5 * (start[i] + end[i]), 0.5 * (end[i] - start[i])
        for j in range(NODES):
            ticks[i * NODES + j] = tick[i]
            offsets[i * NODES + j] = centre + half * NODE_AT[j]


@entry(REALS_2D, REALS_2D)
def _to_monomials(values: Reals, coefficients: Reals) -> None:
    for i in range(values.shape[0]):
        through_nodes(values[i], coefficients[i])
