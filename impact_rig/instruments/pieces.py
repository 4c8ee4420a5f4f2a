# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A motion cut into smooth pieces, each a polynomial: what the sensors' exact response is computed from.

Between breakpoints every quantity is smooth, so eight samples at Chebyshev points x_j = cos((2j + 1) π/16) give it to
2 (ω h / 4)^8 / 8!: below 1e-5 at half a period, 1e-15 at the rig's 9 Hz. A contact of 40 µs becomes three pieces, a
flight of 10 ms four: some five thousand instants per second instead of one per scan and channel, and none of them
depends on the scan rate.

    u(x) = Σ_k c_k x^k, c = V⁻¹ u(x_j), V_jk = x_j^k;   column j of V⁻¹ holds Lagrange's Π_{i≠j} (x − x_i) / (x_j − x_i)
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.precise import ONE, ZERO, pi, precise, unit
from impact_rig.kernels import FLAGS, INTEGERS, REALS, TABLE, Fields, entry, kernel

NODES = 8
PIECES_PER_PERIOD = 2.0
"""Of the fastest drive."""


@precise
def _chebyshev() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the nodes, ascending, shape (NODES,), and V⁻¹, shape (NODES, NODES), of many digits and rounded once."""
    x = [unit(pi() * (2 * j + 1) / (2 * NODES)).real for j in reversed(range(NODES))]
    inverse = np.empty((NODES, NODES))
    for j, node in enumerate(x):
        factors, scale = [ONE], ONE  # coefficients of Π (x − x_i), constant first
        for other in x[:j] + x[j + 1 :]:
            factors = [above - other * here for above, here in zip([ZERO, *factors], [*factors, ZERO], strict=True)]
            scale *= node - other
        inverse[:, j] = [float(factor / scale) for factor in factors]
    return np.array([float(node) for node in x]), inverse


_X, _TO_MONOMIALS = _chebyshev()


class Motion(Protocol):
    """What an instrument needs to see of a motion: `impact_rig.physics.Motion` has it, any analytic motion can.

    Quantities of the rig are functions of (tick, offset within it); a tick takes 10 ms.
    """

    @property
    def impacts(self) -> NDArray[np.void]:
        """Contacts, with fields tick, offset [s], wall (-1 left, +1 right), impulse [N s] and duration [s]."""

    def quantities(
        self, names: tuple[str, ...], tick: NDArray[np.int64], offset_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return some quantities (SI) at each instant, shape (names, n)."""

    def breakpoints(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the instants (tick, offset [s]), in order, between which every quantity is smooth."""


class Limits(NamedTuple):
    """How ticks are cut [s]: length of a tick, longest piece of a flight, longest joined neighbours."""

    tick_s: float
    longest_s: float
    joined_s: float


LIMITS = Fields(Limits, (float, float, float))


class Pieces(NamedTuple):
    """Smooth pieces of some ticks, in order; offsets [s] count from the piece's tick.

    Attributes:
        first: index of the first piece of each tick, and the number of pieces; shape (ticks + 1,).
        start: where each piece starts, shape (n,).
        end: where it ends, shape (n,).
        hard: whether the quantity may be rough at its end, shape (n,).
        tick: the motion's number of the piece's tick, shape (n,).
        tick_s: duration of one tick.
    """

    first: NDArray[np.int64]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    hard: NDArray[np.bool_]
    tick: NDArray[np.int64]
    tick_s: float

    def nodes(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the nodes of all pieces as (tick, offset [s]), shape (n · NODES,)."""
        count = len(self.start) * NODES
        tick, offset = np.empty(count, np.int64), np.empty(count)
        _nodes(self.start, self.end, self.tick, tick, offset)
        return tick, offset


PIECES = Fields(Pieces, (INTEGERS, REALS, REALS, FLAGS, INTEGERS, float))


def polynomials(values: NDArray[np.float64], pieces: int) -> NDArray[np.float64]:
    """Return the coefficients of each polynomial in x = −1 … 1, constant first, shape (quantities, pieces, NODES).

    Args:
        values: some quantities at the nodes of all pieces, shape (quantities, pieces · NODES).
        pieces: how many.
    """
    coefficients = np.empty((len(values), pieces, NODES))
    _to_monomials(values.reshape(-1, NODES), coefficients.reshape(-1, NODES))
    return coefficients


def first_value(coefficients: NDArray[np.float64]) -> float:
    """Return the value at the very start, x = −1 of the first piece."""
    value = 0.0
    for c in coefficients[0, ::-1]:
        value = float(c) - value
    return value


def cut(rough: tuple[NDArray[np.int64], NDArray[np.float64]], motion_tick: int, ticks: int, limits: Limits) -> Pieces:
    """Cut ticks of a motion at its breakpoints.

    Args:
        rough: the motion's breakpoints (tick, offset [s]), in order; those of other ticks do not matter.
        motion_tick: the motion's number of the first tick.
        ticks: how many.
        limits: flights are cut into equal parts of at most `longest_s`; neighbours between breakpoints are joined as
            long as they are together no longer than `joined_s`.
    """
    tick, offset = rough
    low, high = tick.searchsorted(motion_tick), tick.searchsorted(motion_tick + ticks)
    room = ticks * (math.ceil(limits.tick_s / limits.longest_s) + 1) + 2 * int(high - low)
    first = np.empty(ticks + 1, np.int64)
    start, end = np.empty(room), np.empty(room)
    hard, of = np.empty(room, np.bool_), np.empty(room, np.int64)
    pieces = Pieces(first, start, end, hard, of, limits.tick_s)
    n = _cut(tick[low:high], offset[low:high], motion_tick, limits, pieces)
    return Pieces(first, start[:n], end[:n], hard[:n], of[:n], limits.tick_s)


@entry(INTEGERS, REALS, int, LIMITS, PIECES, returns=int)
def _cut(tick, offset, motion_tick, limits, pieces):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Fill `pieces`, which has room; return how many there are."""
    tick_s, longest_s = limits.tick_s, limits.longest_s
    first, start, end, hard, of = pieces.first, pieces.start, pieces.end, pieces.hard, pieces.tick
    ticks = first.shape[0] - 1
    n, b = 0, 0
    for k in range(ticks):
        first[k] = n
        while b < tick.shape[0] and tick[b] < motion_tick + k:
            b += 1
        behind = b
        while behind < tick.shape[0] and tick[behind] == motion_tick + k:
            behind += 1
        since = 0.0
        while since < tick_s:
            b, until = _next_break(offset, b, behind, since, limits)
            parts = max(1, math.ceil((until - since) / longest_s))
            for i in range(parts):
                start[n] = since + (until - since) * (i / parts)
                end[n] = until if i == parts - 1 else since + (until - since) * ((i + 1) / parts)
                hard[n] = i == parts - 1
                of[n] = motion_tick + k
                n += 1
            since = until
    first[ticks] = n
    return n


@kernel
def _next_break(offset, b, behind, since, limits):  # type: ignore[no-untyped-def]
    """Return the first breakpoint not yet reached, and where the pieces from `since` to it, or those joined, end."""
    tick_s, joined_s = limits.tick_s, limits.joined_s
    while b < behind and offset[b] <= since:
        b += 1
    ahead, until = b, tick_s
    while ahead < behind and offset[ahead] < tick_s:
        if ahead > b and offset[ahead] - since > joined_s:
            break
        until = offset[ahead]
        ahead += 1
    if ahead > b and tick_s - since <= joined_s:
        until = tick_s
    return ahead, until


@entry(REALS, REALS, INTEGERS, INTEGERS, REALS)
def _nodes(start, end, tick, ticks, offsets):  # type: ignore[no-untyped-def]
    for i in range(start.shape[0]):
        centre, half = 0.5 * (start[i] + end[i]), 0.5 * (end[i] - start[i])
        for j in range(NODES):
            ticks[i * NODES + j] = tick[i]
            offsets[i * NODES + j] = centre + half * _X[j]


@entry(TABLE, TABLE)
def _to_monomials(values, coefficients):  # type: ignore[no-untyped-def]
    for i in range(values.shape[0]):
        for j in range(NODES):
            total = 0.0
            for k in range(NODES):
                total += _TO_MONOMIALS[j, k] * values[i, k]
            coefficients[i, j] = total
