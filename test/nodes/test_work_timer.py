# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The phase of the work timer: blocks come after their ends, not a period later."""

from __future__ import annotations

from collections.abc import Callable

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from impact_rig.nodes.pacing import LATE_CALLS, WorkTimer

PERIOD_S = 0.01


class Node:
    """What a work timer asks its node for: (wait, callback) of every timer made."""

    def __init__(self) -> None:
        self.made: list[tuple[float, Callable[[], None]]] = []

    def steady_timer(self, wait_s: float, callback: Callable[[], None]) -> int:
        self.made.append((wait_s, callback))
        return len(self.made)

    def destroy_timer(self, timer: int) -> None:
        assert timer == len(self.made)


def made() -> tuple[Node, WorkTimer]:
    node = Node()
    return node, WorkTimer(node, lambda: None)


@pytest.mark.parametrize(("wait_s", "expected_s"), [(0.004, 0.004), (0.0, 1e-6), (-0.101, 0.009), (-0.0999, 0.0001)])
def test_what_is_overdue_waits_for_the_next_call_in_step(wait_s: float, expected_s: float) -> None:
    node, timer = made()
    timer.start(PERIOD_S, wait_s)
    assert node.made[0][0] == pytest.approx(expected_s)
    node.made[0][1]()
    assert node.made[1][0] == PERIOD_S


@pytest.mark.parametrize("wait_s", [0.003, -0.001, -0.021])
def test_calls_that_are_late_for_a_while_are_put_in_step(wait_s: float) -> None:
    """A negative wait is as late as a short one: the next block came due during the call."""
    node, timer = made()
    timer.start(PERIOD_S, 0.0)
    for _ in range(LATE_CALLS):
        timer.keep_in_step(wait_s)
    assert node.made[-1][0] == pytest.approx(wait_s % PERIOD_S)
    assert len(node.made) == 2


def test_calls_in_step_are_left_alone() -> None:
    node, timer = made()
    timer.start(PERIOD_S, 0.0)
    for number in range(3 * LATE_CALLS):
        timer.keep_in_step(0.003 if number % 2 else 0.0095)
    assert len(node.made) == 1
