# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A periodic timer whose first call comes when it is wanted.

A timer of rclpy first fires one period after it was made, so that a block would wait up to a period after its end.
Here a one-shot timer goes ahead of it. Where period and block differ by fractions of a nanosecond the phase wanders:
the timer is put in step again when calls have come late for a while.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol  # Any: rclpy timers

LATE_CALLS = 100
LATE_SHARE = 0.1
"""A call counts as late from this share of the period on."""
_AT_ONCE_S = 1e-6


class Timers(Protocol):
    """What is needed of a node."""

    def steady_timer(self, period_s: float, callback: Callable[[], None]) -> Any:
        """Make a timer that calls back every `period_s`, and is not brought down by what that raises."""

    def destroy_timer(self, timer: Any) -> Any:
        """End a timer."""


class WorkTimer:
    """Calls back with a period and a phase, on the monotonic clock.

    Args:
        node: owner, a `ManagedNode`.
        callback: called periodically.
    """

    def __init__(self, node: Timers, callback: Callable[[], None]) -> None:
        self._node = node
        self._callback = callback
        self._timer: Any = None
        self._period_s = 1.0
        self._late = 0

    def start(self, period_s: float, first_s: float) -> None:
        """Call back in `first_s` and then every `period_s`; replaces what was going on.

        What is overdue waits for the next call in step: a call at once would set a phase in which all are late.
        """
        self.stop()
        self._period_s = period_s
        if first_s < 0.0:
            first_s %= period_s
        self._timer = self._node.steady_timer(max(first_s, _AT_ONCE_S), self._first)

    def stop(self) -> None:
        """Call back no more."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        self._late = 0

    def keep_in_step(self, wait_s: float) -> None:
        """Tell after a call how long the next one should wait.

        A wait much below the period means that this call was late; a negative one, that the next will be: what it is
        for came due during this one.
        """
        self._late = self._late + 1 if wait_s < (1.0 - LATE_SHARE) * self._period_s else 0
        if self._late >= LATE_CALLS:
            self.start(self._period_s, wait_s)

    def _first(self) -> None:
        self._node.destroy_timer(self._timer)
        self._timer = self._node.steady_timer(self._period_s, self._callback)
        self._callback()
