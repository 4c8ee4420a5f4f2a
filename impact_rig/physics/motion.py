# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`Motion`: what an advance of the simulation leaves behind, to be sampled at any instants."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from impact_rig.physics.model import Model
from impact_rig.physics.refining import PARTS, refine
from impact_rig.physics.sampling import QUANTITIES, Bench, Query, Trajectory, new_bench, sample
from impact_rig.physics.state import IMPACT

__all__ = ["IMPACT", "SAMPLE", "Motion"]

SAMPLE = np.dtype([(name, "f8") for name in QUANTITIES])


@functools.cache
def _places(names: tuple[str, ...]) -> NDArray[np.int64]:
    return np.array([QUANTITIES.index(name) for name in names], np.int64)


class Motion:
    """The trajectory of consecutive ticks, numbered from `first_segment`: drive segments, where a tick has no more.

    Times are (tick, offset into the tick): no value depends on how the run was cut into advances. Motions that
    are asked in turn may share a `bench`, their scratch memory.

    Attributes:
        first_segment: number of the first tick, counted since the reset.
        segments: the drive, shape (n,), dtype `forcing.SEGMENT`.
        ticks: row of each tick's first segment, and the number of segments.
        impacts: contacts that ended in this motion, dtype `IMPACT`; a contact may have begun in an earlier one.
    """

    def __init__(
        self,
        model: Model,
        first_segment: int,
        segments: NDArray[np.void],
        ticks: NDArray[np.int64],
        knots: NDArray[np.void],
        first: NDArray[np.int64],
        impacts: NDArray[np.void],
        bench: Bench | None = None,
    ) -> None:
        self.first_segment = first_segment
        self.segments, self.ticks = segments, ticks
        self.impacts = impacts
        self._model = model
        self._trajectory = Trajectory(segments, first_segment, ticks, knots, first)
        self._bench = bench or new_bench()

    @property
    def last_segment(self) -> int:
        """Number of the last tick, inclusive."""
        return self.first_segment + len(self._trajectory.ticks) - 2

    def sample(self, segment: NDArray[np.int64], offset_s: NDArray[np.float64]) -> NDArray[np.void]:
        """Return all quantities (dtype `SAMPLE`, SI) at the instants, in their shape; fastest when in order."""
        found = np.moveaxis(self.quantities(QUANTITIES, segment, offset_s), 0, -1)
        rows: NDArray[np.void] = np.ascontiguousarray(found).view(SAMPLE)[..., 0]
        return rows

    def quantity(self, name: str, segment: NDArray[np.int64], offset_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return one quantity of `SAMPLE` at the given instants, in their shape."""
        column: NDArray[np.float64] = self.quantities((name,), segment, offset_s)[0]
        return column

    def quantities(
        self, names: tuple[str, ...], segment: NDArray[np.int64], offset_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return some quantities of `SAMPLE` at the given instants, shape (names, *instants): cheaper than one by one.

        Raises:
            ValueError: an instant is in none of the segments, or the shapes differ.
        """
        segment = np.ascontiguousarray(segment, np.int64)
        offset_s = np.ascontiguousarray(offset_s, np.float64)
        if segment.shape != offset_s.shape:
            raise ValueError(f"segment and offset must have one shape, got {segment.shape} and {offset_s.shape}")
        out = np.empty((len(names), segment.size))
        query = Query(_places(names), segment.reshape(-1), offset_s.reshape(-1), out)
        if not sample(self._model, self._trajectory, query, self._bench):
            raise ValueError(
                f"this motion holds segments {self.first_segment} to {self.last_segment}, "
                f"got {segment.min()} to {segment.max()}"
            )
        return out.reshape(len(names), *segment.shape)

    def breakpoints(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return (segment, offset) of the instants between which every quantity is smooth, in order.

        These are the segments' starts, the contacts' starts and ends, and the integration steps inside contacts.
        """
        segment, offset, _ = self._refined()
        return segment, offset

    def in_contact(self) -> NDArray[np.bool_]:
        """Return for every breakpoint whether the sphere touches a wall, or is held, from there on."""
        return self._refined()[2]

    def _refined(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return (segment, offset, whether touching) of the knots and of places inside contacts taken as a whole."""
        room = PARTS * len(self._trajectory.knots)
        segment, offset, touching = np.empty(room, np.int64), np.empty(room), np.empty(room, np.bool_)
        count = refine(self._trajectory, segment, offset, touching)
        return segment[:count], offset[:count], touching[:count]
