"""Rig time: integer nanoseconds, sample stamps computed from the index, and the command grid.

Rig time *is* DAQ time. Nothing below the pacing layer reads a wall clock, and no period is ever added up:
at 25 600 S/s a period is 39 062.5 ns, so the stamp of scan i is `start_ns + i * 10**9 // rate_hz`.
"""

from __future__ import annotations

from typing import NewType

SimTime = NewType("SimTime", int)  # nanoseconds

NS_PER_S = 1_000_000_000
COMMAND_GRID_NS = 10_000_000
"""Commands take effect at the first multiple of this after the last simulated instant, whatever the block length."""
COMMAND_GRID_S = COMMAND_GRID_NS / NS_PER_S


def stamp_ns(index: int, rate_hz: int, start_ns: int = 0) -> int:
    """Return the time of scan `index` [ns]: exact integer arithmetic, rounded down."""
    return start_ns + index * NS_PER_S // rate_hz


def scans_before(until_ns: int, rate_hz: int, start_ns: int = 0) -> int:
    """Return how many scans lie strictly before `until_ns`: the smallest i with i / rate >= until - start."""
    return max(0, -(-(until_ns - start_ns) * rate_hz // NS_PER_S))


def grid_ceil(time_ns: int) -> int:
    """Return the first instant of the command grid that is not before `time_ns` (both relative to the rig's start)."""
    return -(-time_ns // COMMAND_GRID_NS) * COMMAND_GRID_NS
