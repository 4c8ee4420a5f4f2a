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
"""Phase of the work timer: blocks are published at their ends, not a period later."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from impact_rig.nodes.pacing import LATE_CALLS, WorkTimer

PERIOD_S = 0.01


class Node:
    """Timers with a time of their own, which the waiting test advances."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self._timers: dict[int, list[Any]] = {}
        self._numbers = itertools.count()

    def steady_timer(self, wait_s: float, callback: Callable[[], None]) -> int:
        number = next(self._numbers)
        self._timers[number] = [self.now_s + wait_s, wait_s, callback]
        return number

    def destroy_timer(self, timer: int) -> None:
        del self._timers[timer]

    def wait(self) -> None:
        """Advance to the next timer that is due, and call it."""
        number = min(self._timers, key=lambda one: self._timers[one][0])
        self.now_s, period_s, callback = self._timers[number]
        self._timers[number][0] += period_s
        callback()


def instants(wait_s: float, count: int, next_waits_s: Sequence[float] = ()) -> list[float]:
    """Instants at which a work timer calls back; each call sets the wait until the next one."""
    node, found = Node(), list[float]()

    def work() -> None:
        found.append(node.now_s)
        timer.keep_in_step(next_waits_s[len(found) - 1] if len(found) <= len(next_waits_s) else PERIOD_S)

    timer = WorkTimer(node, work)
    timer.start(PERIOD_S, wait_s)
    while len(found) < count:
        node.wait()
    return found


@pytest.mark.parametrize(
    ("wait_s", "expected_s"), [(0.004, 0.004), (0.0, 1e-6), (-0.101, 0.009), (-0.0999, 0.0001), (0.0255, 0.0055)]
)
def test_an_overdue_call_waits_for_the_next_call_in_step(wait_s: float, expected_s: float) -> None:
    assert instants(wait_s, 4) == pytest.approx([expected_s + number * PERIOD_S for number in range(4)])


@pytest.mark.parametrize("wait_s", [0.003, -0.001, -0.021])
def test_calls_that_are_late_for_a_while_are_put_in_step(wait_s: float) -> None:
    """A negative wait is as late as a short one: the next block became due during the call."""
    found = instants(0.001, LATE_CALLS + 3, [wait_s] * LATE_CALLS)
    steps = [after - before for before, after in itertools.pairwise(found)]
    assert steps[: LATE_CALLS - 1] == pytest.approx([PERIOD_S] * (LATE_CALLS - 1)), "a single one may be chance"
    assert steps[LATE_CALLS - 1 :] == pytest.approx([wait_s % PERIOD_S, PERIOD_S, PERIOD_S])


def test_calls_in_step_are_not_moved() -> None:
    found = instants(0.001, 3 * LATE_CALLS, [0.003, 0.0095] * (3 * LATE_CALLS // 2))
    assert found == pytest.approx([0.001 + number * PERIOD_S for number in range(3 * LATE_CALLS)])
