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
"""Motion cut into smooth pieces, each a polynomial, from which the sensors' exact response is computed.

Between two breakpoints, which are events of the motion or steps of its integration, every quantity is smooth. A piece
that contains breakpoints close together is still smooth enough for a polynomial of eight coefficients (see
`arithmetic.interpolation`). A contact of 40 µs becomes three pieces, a flight of 10 ms four. That makes some five
hundred pieces per second, independent of the scan rate.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from impact_rig.kernels import INTEGERS, REALS, Fields, Integers, Reals, entry, kernel

PIECES_PER_PERIOD = 2.0
"""Least number of pieces into which one period of a drive with the highest allowed frequency is cut."""


class PiecewiseMotion(Protocol):
    """Interface that instruments need of a motion; `impact_rig.physics.Motion` implements it.

    Another class can do so as well, such as a motion given by formulas. Quantities of the rig are functions of an
    instant, given as the number of a tick and the time since its start [s]. A tick takes 10 ms of the scan clock, which
    is more or less in the motion's time if that clock is wrong. The time since its start is in the motion's time.
    """

    @property
    def impacts(self) -> NDArray[np.void]:
        """Contacts, with fields tick, offset [s], wall, impulse [N s] and duration [s], that have ended in the motion.

        `tick` and `offset` are those of the begin of the contact. `wall` is −1 for left, +1 for right. `impulse` is
        positive, and `duration` is 0 for an instantaneous impact.
        """

    def quantities(
        self, names: tuple[str, ...], tick: NDArray[np.int64], offset_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the named quantities, such as `x_1` (SI), at each instant (tick, offset into it), shape (names, n)."""

    def polynomials(
        self, names: tuple[str, ...], tick: NDArray[np.int64], start_s: NDArray[np.float64], end_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return polynomials that interpolate the named quantities on n pieces of time, shape (names, n, NODES).

        Each piece lies in one tick, from `start_s` to `end_s` after its start, and may contain breakpoints that are
        close together. The last axis holds the coefficients of x^0, x^1, …, with x = −1 at the start of the piece and 1
        at its end. `arithmetic.interpolation.polynomials` can compute them from `quantities`.
        """

    def breakpoints(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the instants (tick, offset [s]), in order, between which every quantity is smooth.

        Starts and ends of ticks need not be included, because every tick is cut there anyway.
        """


class Limits(NamedTuple):
    """Lengths for cutting the ticks of a motion into pieces.

    Attributes:
        tick_s: duration of one tick [s].
        longest_s: largest length of a piece [s]; longer intervals between breakpoints are divided.
        joined_s: largest length up to which short intervals between breakpoints are joined to one piece [s].
    """

    tick_s: float
    longest_s: float
    joined_s: float


LIMITS = Fields(Limits, (float, float, float))


class Pieces(NamedTuple):
    """Pieces of some ticks, in order, smooth except for short intervals that are joined.

    Times [s] count from the start of the piece's tick.

    Attributes:
        first_piece: index of the first piece of each tick, then the number of all pieces; shape (ticks + 1,).
        start: start of each piece, shape (n,).
        end: end of each piece, shape (n,).
        tick: number of the piece's tick in the motion, shape (n,).
        tick_s: duration of one tick [s].
    """

    first_piece: NDArray[np.int64]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    tick: NDArray[np.int64]
    tick_s: float


PIECES = Fields(Pieces, (INTEGERS, REALS, REALS, INTEGERS, float))


def cut(
    breakpoints: tuple[NDArray[np.int64], NDArray[np.float64]], motion_tick: int, ticks: int, limits: Limits
) -> Pieces:
    """Cut some ticks of a motion at its breakpoints into pieces, and return these.

    Args:
        breakpoints: the motion's breakpoints (tick, offset [s]), in order; those of other ticks are ignored.
        motion_tick: number of the first of these ticks, as the motion counts its ticks.
        ticks: number of ticks.
        limits: intervals between breakpoints are cut into equal parts of at most `longest_s`; short neighbours are
            joined while their total length is at most `joined_s`.
    """
    tick, offset = breakpoints
    room = ticks * (math.ceil(limits.tick_s / limits.longest_s) + 1) + 2 * len(tick)
    first = np.empty(ticks + 1, np.int64)
    start, end = np.empty(room), np.empty(room)
    piece_tick = np.empty(room, np.int64)
    pieces = Pieces(first, start, end, piece_tick, limits.tick_s)
    n = _cut(tick, offset, motion_tick, limits, pieces)
    return Pieces(first, start[:n], end[:n], piece_tick[:n], limits.tick_s)


@entry(INTEGERS, REALS, int, LIMITS, PIECES, returns=int)
def _cut(tick: Integers, offset: Reals, motion_tick: int, limits: Limits, pieces: Pieces) -> int:
    """Cut as many ticks as `pieces.first_piece` has room for; write the pieces into `pieces` and return their number.

    The caller provides arrays that are long enough. Pieces are the intervals between the breakpoints (tick, offset),
    divided and joined as `limits` says. `motion_tick` is the number, counted in the motion, of the first tick.
    """
    tick_s, longest_s = limits.tick_s, limits.longest_s
    first, start, end, piece_tick = pieces.first_piece, pieces.start, pieces.end, pieces.tick
    ticks = first.shape[0] - 1
    count, next_break = 0, 0
    for tick_index in range(ticks):
        first[tick_index] = count
        while next_break < tick.shape[0] and tick[next_break] < motion_tick + tick_index:
            next_break += 1
        breaks_end = next_break
        while breaks_end < tick.shape[0] and tick[breaks_end] == motion_tick + tick_index:
            breaks_end += 1
        piece_start = 0.0
        while piece_start < tick_s:
            next_break, piece_end = _next_break(offset, next_break, breaks_end, piece_start, limits)
            parts = max(1, math.ceil((piece_end - piece_start) / longest_s))
            for i in range(parts):
                start[count] = piece_start + (piece_end - piece_start) * (i / parts)
                end[count] = (
                    piece_end if i == parts - 1 else piece_start + (piece_end - piece_start) * ((i + 1) / parts)
                )
                piece_tick[count] = motion_tick + tick_index
                count += 1
            piece_start = piece_end
    first[ticks] = count
    return count


@kernel
def _next_break(offset: Reals, next_break: int, breaks_end: int, from_s: float, limits: Limits) -> tuple[int, float]:
    """Return the index of the first breakpoint after the next piece, and that piece's end in its tick [s].

    The piece starts `from_s` seconds after the start of its tick. Without a breakpoint it ends with the tick. It joins
    short intervals between breakpoints up to the length `limits.joined_s`. The caller divides a piece that is longer
    than `limits.longest_s`.
    """
    tick_s, joined_s = limits.tick_s, limits.joined_s
    while next_break < breaks_end and offset[next_break] <= from_s:
        next_break += 1
    ahead, until_s = next_break, tick_s
    while ahead < breaks_end and offset[ahead] < tick_s:
        if ahead > next_break and offset[ahead] - from_s > joined_s:
            break
        until_s = offset[ahead]
        ahead += 1
    if ahead > next_break and tick_s - from_s <= joined_s:
        until_s = tick_s
    return ahead, until_s
