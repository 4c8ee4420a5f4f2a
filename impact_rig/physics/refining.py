# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The instants between which a motion is smooth: its knots, and places inside contacts that were looked up whole."""

from __future__ import annotations

from impact_rig.kernels import FLAGS, INTEGERS, REALS, entry
from impact_rig.physics.sampling import TRAJECTORY
from impact_rig.physics.state import CONTACT, FREE

PARTS = 3
"""Pieces in which a contact that was looked up as a whole is smooth enough for the instruments' polynomials."""


@entry(TRAJECTORY, INTEGERS, REALS, FLAGS, returns=int)
def refine(trajectory, tick, offset, touching):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Fill in tick, offset [s] and whether sphere and wall touch from each instant on; return how many there are.

    The arrays have room for PARTS instants a knot.
    """
    knots, first, count = trajectory.knots, trajectory.first, 0
    i = -1
    for at in range(first.shape[0] - 1):
        begin = trajectory.segments[at].begin
        if at == trajectory.ticks[i + 1]:
            i += 1
        for row in range(first[at], first[at + 1]):
            knot = knots[row]
            tick[count], offset[count], touching[count] = trajectory.base + i, begin + knot.t, knot.phase != FREE
            count += 1
            if knot.phase == CONTACT and knot.whole != 0:
                length = knots[row + 1].t - knot.t
                for part in range(1, PARTS):
                    tick[count], touching[count] = trajectory.base + i, True
                    offset[count] = begin + (knot.t + length * (part / PARTS))
                    count += 1
    return count
