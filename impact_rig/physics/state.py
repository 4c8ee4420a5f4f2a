"""Layout of the state that the event loop carries and of the knots it leaves behind.

A trajectory is a list of knots. A knot holds the state at one instant and the phase of motion that goes on from
there, which is enough to evaluate the motion up to the next knot: in closed form in flight, by Hermite interpolation
between the steps of a contact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

FREE, COLLISION, RIDING, ATTACHED = range(4)
"""Phases: in flight; in a collision; pressed on a wall by a compliant contact; one body with the superior base."""

T = 0  # time since the start of the drive segment [s]
PHASE = 1
SIDE = 2  # wall in contact: -1 left, +1 right; in FREE the sign of the sphere's sliding (friction only)
GAP = 3  # FREE, ATTACHED: d = x_2 - x_1 [m]; COLLISION: sqrt(δ) [m^0.5]; RIDING: δ [m]
RATE = 4  # d' in FREE, δ' in contact [m/s]
Y = 5  # y = (x_1, v_1, x_b, v_b, i); in contact the pair's centre of mass replaces (x_1, v_1)
BETA = 10  # contact: damping over approach speed, a / v0 [s/m]
UNIT = 11  # contact: unit of the regularised variable [s/m^0.5]
GRIP = 12  # contact: 1, or 0 once the force would pull
STEP = 13  # contact: length of the step that starts here (in UNIT, or seconds when RIDING); 0 ends a contact
KNOT = 14  # a knot is the state up to here

APPROACH = 14  # the contact under way: approach speed, where it started, what it has done so far
BEGIN_SEGMENT = 15
BEGIN_OFFSET = 16
PEAK_FORCE = 17
PEAK_INDENTATION = 18
IMPULSE = 19
LOST = 20
ELAPSED = 21
NEXT_STEP = 22  # what riding's step control proposes [s]
SLID = 23  # FREE with friction: d where this flight began
STATE = 24

LEDGER_WORK, LEDGER_COLUMNS, LEDGER_SHAKER, LEDGER_CONTACT, LEDGER_FRICTION = range(5)
LEDGER = 5

IMPACT_COLUMNS = (
    "segment",
    "offset",
    "wall",
    "approach_speed",
    "separation_speed",
    "peak_force",
    "peak_indentation",
    "impulse",
    "duration",
    "energy_lost",
)


class Log(NamedTuple):
    """What a run leaves behind: knots (n, KNOT), impacts (k, IMPACT_COLUMNS), and how many are filled."""

    knots: NDArray[np.float64]
    impacts: NDArray[np.float64]
    filled: NDArray[np.int64]  # knots, impacts
    first: NDArray[np.int64]  # row of each segment's first knot


@njit(cache=True, nogil=True, forceinline=True)
def add_knot(log, s):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Append the state as a knot; the event loop makes room before it calls a phase."""
    row = log.filled[0]
    if row < log.knots.shape[0]:
        for q in range(KNOT):
            log.knots[row, q] = s[q]
    log.filled[0] = row + 1
