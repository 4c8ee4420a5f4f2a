# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The operator's word for the gap, as a remark on the topic `notes`: `gap_m=0.006 at 12500000000`.

The rig does not tell the analysis its gap: it must measure without seeing the truth. A label carries the instant it
holds from, so that the live analysis and a later one of the recorded run apply it to the same scan.
"""

from __future__ import annotations

import re

import attrs

_PATTERN = re.compile(r"\s*gap_m\s*=\s*(?P<gap>nan|[0-9.eE+-]+)\s+at\s+(?P<stamp>[0-9]{1,19})\s*")
_END_NS = 2**31 * 1_000_000_000
"""A ROS stamp carries no later instant."""


@attrs.frozen
class GapLabel:
    """A gap [m] (0 = no sphere, NaN = unknown) from an instant of rig time on."""

    gap_m: float
    stamp_ns: int

    def text(self) -> str:
        """Return the remark; `parse_label` reads it back exactly."""
        return f"gap_m={self.gap_m!r} at {self.stamp_ns}"


def parse_label(remark: str) -> GapLabel | None:
    """Return the label in a remark, or None if it is any other remark."""
    match = _PATTERN.fullmatch(remark)
    if match is None:
        return None
    try:
        gap, stamp = float(match["gap"]), int(match["stamp"])
    except ValueError:
        return None
    if gap < 0 or gap > 1 or stamp >= _END_NS:
        return None
    return GapLabel(gap, stamp)
