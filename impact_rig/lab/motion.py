# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The true motion between two pictures: positions and velocities at monitor rate, and the impacts between them."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from impact_rig.codec import header_stamp_ns
from impact_rig.errors import CodecError
from impact_rig.simtime import NS_PER_S

BODIES = 3
_U4 = struct.Struct("<I")
_NUMBERS = struct.Struct("<3d")


def decode_joint_state(data: bytes) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    """Return stamp [ns], positions [m] and velocities [m/s] of a serialised `sensor_msgs/JointState` of three bodies.

    Raises:
        CodecError: it is none, or of another number of bodies.
    """
    stamp = header_stamp_ns(data)
    try:
        place = 12
        place += 4 + _U4.unpack_from(data, place)[0]  # frame_id
        place += -place % 4
        (names,) = _U4.unpack_from(data, place)
        place += 4
        if names > BODIES:
            raise CodecError(f"a joint state of this rig has {BODIES} bodies, got {names}")
        for _ in range(names):
            place += -place % 4
            place += 4 + _U4.unpack_from(data, place)[0]
        found = []
        for what in ("position", "velocity"):
            place += -place % 4
            (count,) = _U4.unpack_from(data, place)
            if count != BODIES:
                raise CodecError(f"a joint state of this rig has {BODIES} values of {what}, got {count}")
            place += 4
            place += (4 - place) % 8  # counted from the byte after the encapsulation
            found.append(_NUMBERS.unpack_from(data, place))
            place += _NUMBERS.size
    except struct.error as error:
        raise CodecError(f"the joint state at {stamp} ns is cut short: {error}") from error
    return stamp, found[0], found[1]


def encode_joint_state(stamp_ns: int, positions: Sequence[float], velocities: Sequence[float]) -> bytes:
    """Return a serialised `sensor_msgs/JointState` of three bodies without names and efforts."""
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    head = struct.pack("<4siII4x", b"\x00\x01\x00\x00", seconds, nanoseconds, 1)  # frame_id: empty
    return head + b"".join(
        (struct.pack("<II", 0, BODIES), _NUMBERS.pack(*positions), struct.pack("<I4x", BODIES),
         _NUMBERS.pack(*velocities), struct.pack("<I", 0))
    )  # fmt: skip


class Rows:
    """A ring of rows of numbers, of which each reader takes those that are new to it.

    Args:
        size: rows kept.
        columns: numbers per row; the first is the time [s].
    """

    def __init__(self, size: int, columns: int) -> None:
        self._rows = np.zeros((size, columns))
        self.count = 0
        """Rows ever added."""

    def add(self, row: tuple[float, ...]) -> None:
        """Append one row."""
        self._rows[self.count % len(self._rows)] = row
        self.count += 1

    def since(self, number: int, most: int = 2000) -> NDArray[np.float64]:
        """Return the rows from a number on, the newest if there are more than are kept or asked for; shape (n, …)."""
        first = max(number, self.count - min(len(self._rows), most), 0)
        return self._rows[np.arange(first, self.count) % len(self._rows)]


class Motion:
    """The last seconds of true motion.

    Attributes:
        states: time, x_b, x_1, x_2, v_b, v_1, v_2.
        impacts: time, wall, approach speed, separation speed, peak force.
        detected: time, peak, sign.
    """

    def __init__(self) -> None:
        self.states = Rows(4096, 7)
        self.impacts = Rows(4096, 5)
        self.detected = Rows(4096, 3)

    def add_state(self, data: bytes, start_ns: int) -> None:
        """Take a message of `truth/joint_states`.

        Raises:
            CodecError: it is none.
        """
        stamp, positions, velocities = decode_joint_state(data)
        self.states.add(((stamp - start_ns) / NS_PER_S, *positions, *velocities))

    def add_impacts(self, stamp_ns: int, rows: NDArray[np.void], start_ns: int) -> None:
        """Take a table of `truth/impacts`."""
        begin = (stamp_ns - start_ns) / NS_PER_S
        for row in rows:
            self.impacts.add((
                begin + row["time"], row["wall"], row["approach_speed"], row["separation_speed"], row["peak_force"],
            ))  # fmt: skip

    def add_detected(self, stamp_ns: int, rows: NDArray[np.void], start_ns: int) -> None:
        """Take a table of `impacts`."""
        begin = (stamp_ns - start_ns) / NS_PER_S
        for row in rows:
            self.detected.add((begin + row["time"], row["peak"], row["sign"]))
