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
"""Rig time: integer nanoseconds, stamps computed from the scan index, and the command grid.

Rig time is the simulated time, in which the data acquisition counts its scans. The rig itself reads no wall clock; only
the nodes do, to pace it. No stamp is computed by adding up rounded periods: at 25 600 scans/s a period is 39 062.5 ns.
The stamp of scan i is `start_ns + i * 10**9 // rate_hz`.
"""

from __future__ import annotations

NS_PER_S = 1_000_000_000
COMMAND_GRID_NS = 10_000_000
"""Length of a tick of the command grid [ns].

A command takes effect at the end of the last tick that is already simulated, regardless of the block length.
"""
COMMAND_GRID_S = COMMAND_GRID_NS / NS_PER_S
TICKS_PER_S = NS_PER_S // COMMAND_GRID_NS


def stamp_ns(index: int, rate_hz: float, start_ns: int = 0) -> int:
    """Return the rig time [ns] of scan `index`, if scan 0 is at `start_ns`: the exact time, rounded down."""
    over, under = rate_hz.as_integer_ratio()
    return start_ns + index * NS_PER_S * under // over


def scan_index(time_ns: int, rate_hz: float, start_ns: int = 0) -> int:
    """Return the index of the scan nearest to a rig time, if scan 0 is at `start_ns`; negative before scan 0.

    It is the inverse of `stamp_ns`, in integer arithmetic without rounding errors.
    """
    over, under = rate_hz.as_integer_ratio()
    return ((time_ns - start_ns) * over + under * NS_PER_S // 2) // (under * NS_PER_S)


def first_scan_at(time_ns: int, rate_hz: float, start_ns: int = 0) -> int:
    """Return the index of the first scan at or after a rig time, if scan 0 is at `start_ns`; negative before scan 0.

    It is computed in integer arithmetic without rounding errors.
    """
    over, under = rate_hz.as_integer_ratio()
    return -(-(time_ns - start_ns) * over // (under * NS_PER_S))
