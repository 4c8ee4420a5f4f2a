"""A motion cut into smooth pieces, each a polynomial: what the sensors' exact response is computed from.

Between breakpoints every quantity is smooth, so eight samples at Chebyshev points give it to 2 (ω h / 4)^8 / 8!: below
1e-5 at half a period, 1e-15 at the rig's 9 Hz. A contact of 40 µs becomes three pieces, a flight of 10 ms four: some
five thousand instants per second instead of one per scan and channel, and none of them depends on the scan rate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

NODES = 8
_X = np.cos(np.pi * (2 * np.arange(NODES)[::-1] + 1) / (2 * NODES))  # Chebyshev points on [-1, 1], ends excluded
_TO_MONOMIALS = np.ascontiguousarray(np.linalg.inv(np.vander(_X, increasing=True)))
PIECES_PER_PERIOD = 2.0
"""Of the fastest drive."""


class Pieces(NamedTuple):
    """Smooth pieces of some ticks, in order; offsets [s] count from the piece's tick.

    Attributes:
        first: index of the first piece of each tick, and the number of pieces; shape (ticks + 1,).
        start: where each piece starts, shape (n,).
        end: where it ends, shape (n,).
        hard: whether the quantity may be rough at its end, shape (n,).
        segment: segment of the piece's tick in the motion, shape (n,).
        tick_s: duration of one tick.
    """

    first: NDArray[np.int64]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    hard: NDArray[np.bool_]
    segment: NDArray[np.int64]
    tick_s: float

    def nodes(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the nodes of all pieces as (segment, offset [s]), shape (n · NODES,)."""
        nodes: tuple[NDArray[np.int64], NDArray[np.float64]] = _nodes(self.start, self.end, self.segment, _X)
        return nodes


def polynomials(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of each piece's polynomial in x = −1 … 1, constant first; shapes (n, NODES)."""
    coefficients: NDArray[np.float64] = _to_monomials(values, _TO_MONOMIALS)
    return coefficients


def cut(
    rough: tuple[NDArray[np.int64], NDArray[np.float64]],
    first_segment: int,
    ticks: int,
    tick_s: float,
    longest_s: float,
    joined_s: float,
) -> Pieces:
    """Cut ticks of a motion at its breakpoints.

    Args:
        rough: the motion's breakpoints (segment, offset [s]), in order; those of other ticks do not matter.
        first_segment: segment of the first tick.
        ticks: how many.
        tick_s: duration of one tick [s].
        longest_s: flights are cut into equal parts of at most this.
        joined_s: neighbours between breakpoints are joined as long as they are together no longer than this.
    """
    low, high = np.searchsorted(rough[0], (first_segment, first_segment + ticks))
    segment = np.ascontiguousarray(rough[0][low:high], dtype=np.int64)
    offset = np.ascontiguousarray(rough[1][low:high], dtype=np.float64)
    first, start, end, hard, of = _cut(segment, offset, first_segment, ticks, tick_s, longest_s, joined_s)
    return Pieces(first, start, end, hard, of, tick_s)


@njit(cache=True, nogil=True)
def _cut(segment, offset, first_segment, ticks, tick_s, longest_s, joined_s):  # type: ignore[no-untyped-def]
    per_tick = int(np.ceil(tick_s / longest_s)) + 1
    size = ticks * per_tick + 2 * offset.shape[0]
    first = np.empty(ticks + 1, np.int64)
    start, end = np.empty(size), np.empty(size)
    hard, of = np.empty(size, np.bool_), np.empty(size, np.int64)
    n, b = 0, 0
    for k in range(ticks):
        first[k] = n
        while b < segment.shape[0] and segment[b] < first_segment + k:
            b += 1
        since = 0.0
        while since < tick_s:
            until = tick_s
            while b < segment.shape[0] and segment[b] == first_segment + k and offset[b] <= since:
                b += 1
            ahead = b
            while ahead < segment.shape[0] and segment[ahead] == first_segment + k and offset[ahead] < tick_s:
                if ahead > b and offset[ahead] - since > joined_s:
                    break
                until = offset[ahead]
                ahead += 1
            if ahead > b and tick_s - since <= joined_s:
                until = tick_s
            b = ahead
            parts = max(1, int(np.ceil((until - since) / longest_s)))
            for i in range(parts):
                start[n] = since + (until - since) * (i / parts)
                end[n] = until if i == parts - 1 else since + (until - since) * ((i + 1) / parts)
                hard[n] = i == parts - 1
                of[n] = first_segment + k
                n += 1
            since = until
    first[ticks] = n
    return first, start[:n].copy(), end[:n].copy(), hard[:n].copy(), of[:n].copy()


@njit(cache=True, nogil=True)
def _nodes(start, end, segment, x):  # type: ignore[no-untyped-def]
    n, nodes = start.shape[0], x.shape[0]
    segments, offsets = np.empty(n * nodes, np.int64), np.empty(n * nodes)
    for i in range(n):
        centre, half = 0.5 * (start[i] + end[i]), 0.5 * (end[i] - start[i])
        for j in range(nodes):
            segments[i * nodes + j] = segment[i]
            offsets[i * nodes + j] = centre + half * x[j]
    return segments, offsets


@njit(cache=True, nogil=True)
def _to_monomials(values, matrix):  # type: ignore[no-untyped-def]
    # a loop and not BLAS: the bits must not depend on how many pieces there are
    n, nodes = values.shape
    coefficients = np.empty((n, nodes))
    for i in range(n):
        for j in range(nodes):
            total = 0.0
            for k in range(nodes):
                total += matrix[j, k] * values[i, k]
            coefficients[i, j] = total
    return coefficients
