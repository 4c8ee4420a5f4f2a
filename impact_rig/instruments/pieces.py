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
"""Division of a motion into smooth pieces, on which each quantity is approximated by a polynomial in time.

The exact response of the sensors is computed from these polynomials of eight coefficients (see
`arithmetic.interpolation`). The motion is cut at its breakpoints: events of the motion and steps of its integration.
Breakpoints that are close together may lie within one piece. There are some five hundred pieces per second.
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
    """Interface of a motion that the instruments measure; `impact_rig.physics.Motion` implements it.

    An instant is given by the number of a tick, and the time since the start of that tick in the motion's time [s]. A
    tick takes 10 ms of the scan clock, which is more or less in the motion's time if the scan clock is wrong.
    """

    @property
    def impacts(self) -> NDArray[np.void]:
        """Completed contacts, with fields tick, offset [s], wall, impulse [N s] and duration [s].

        `tick` and `offset` give the start of the contact. `wall` is −1 for left, +1 for right. `impulse` is positive.
        `duration` is 0 for an instantaneous impact.
        """

    def quantities(
        self, names: tuple[str, ...], tick: NDArray[np.int64], offset_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the named quantities, such as `x_1`, at n instants, in SI units, shape (names, n).

        Instant i is `offset_s[i]` seconds after the start of tick number `tick[i]`.
        """

    def polynomials(
        self, names: tuple[str, ...], tick: NDArray[np.int64], start_s: NDArray[np.float64], end_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return polynomials that interpolate the named quantities on n pieces of time, shape (names, n, NODES).

        Each piece lies in one tick, from `start_s` to `end_s` seconds after the start of the tick. The last axis holds
        the coefficients of x^0, x^1, …, with x = −1 at the start of the piece and 1 at its end. A piece may contain
        breakpoints that are close together. `arithmetic.interpolation.polynomials` can compute the result from
        `quantities`.
        """

    def breakpoints(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the instants (tick, offset [s]), in order, between which every quantity is smooth.

        Starts and ends of ticks need not be included.
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
    """Pieces of some ticks of a motion, in order of time.

    Times [s] count from the start of the tick in which the piece lies.

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
    """Cut some ticks of a motion into pieces at its breakpoints, and return the pieces.

    Args:
        breakpoints: the motion's breakpoints (tick, offset [s]), in order; breakpoints of other ticks are ignored.
        motion_tick: number of the first of these ticks, as the motion counts its ticks.
        ticks: number of ticks.
        limits: largest length of a piece, and largest length up to which short neighbouring intervals are joined.
            Longer intervals are cut into equal parts.
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
    """Cut ticks of a motion into pieces, write the pieces into `pieces`, and return their number.

    The arrays in `pieces` must be long enough; `first_piece` has one element more than there are ticks. `motion_tick`
    is the number of the first tick in the motion.
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
    """Return the index of the first breakpoint after a piece, and the end of the piece in its tick [s].

    The piece starts `from_s` seconds after the start of its tick. It ends at the next breakpoint or with the tick.
    Short intervals are joined to one piece up to the length `limits.joined_s`.
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
