# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""How fast rig time runs, which decides what is drawn and how often."""

from __future__ import annotations

import time
from collections.abc import Callable

HURRIED = 1.5
"""Speed from which on pictures come now and then: nobody sees every cycle, and rig and analysis need the machine."""
FOLLOWED = 4.5
"""Speed up to which the motion is drawn: beyond it nobody can follow, and publishing it costs the rig a tenth."""
STALE_S = 3.0
"""Rig time that has not moved for so long stands still."""
GAP_S = 10.0
"""Two readings further apart say nothing about the speed between them."""


class Pace:
    """Seconds of rig time per second, from readings that come once or twice a second.

    Args:
        clock: monotonic clock [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.speed = 0.0
        """At the last two different readings."""
        self._read_at = self._rig_s = 0.0

    @property
    def is_hurried(self) -> bool:
        """Whether rig time runs ahead of ours."""
        return self.speed > HURRIED

    @property
    def is_followed(self) -> bool:
        """Whether somebody could follow the motion."""
        return self.speed <= FOLLOWED

    def read(self, rig_s: float) -> float:
        """Take a reading of rig time [s]; return the speed, 0 where it stands still."""
        now = self._clock()
        if rig_s == self._rig_s:
            return 0.0 if now - self._read_at > STALE_S else self.speed
        if rig_s > self._rig_s and self._read_at and now - self._read_at < GAP_S:
            self.speed = (rig_s - self._rig_s) / (now - self._read_at)
        self._read_at, self._rig_s = now, rig_s
        return self.speed
