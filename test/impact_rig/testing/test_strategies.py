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
"""A planted off-by-one is found, shrunk and repeated; a correct consumer is not blamed."""

from __future__ import annotations

import re
import time

import pytest

from impact_rig.testing import LocalRig
from impact_rig.testing.strategies import Command, Inject, LateJoin, Pause, Silence, repeat, search

QUICK = {"daq.rate_hz": 1000, "daq.block_scans": 10}
LIMIT_S = 30.0


class Losses:
    """Consumer that counts lost scans by their stamps, `planted` too many for each gap."""

    def __init__(self, rig, planted=0):
        self.rig, self.planted, self.lost, self.next = rig, planted, 0, None

    def feed(self, block):
        first = block.stamp_ns * self.rig.rate_hz // 10**9
        if self.next is not None and first > self.next:
            self.lost += first - self.next + self.planted
        self.next = first + len(block.rows)

    def matches(self):
        """Assert that the loss agrees with the rig's own number of lost scans between two blocks."""
        true = [end - first for first, end in self.rig.lost_samples() if first and self.next and end < self.next]
        assert self.lost == sum(true)


def sound(rig):
    losses = Losses(rig)
    rig.connect(losses.feed)
    return losses.matches


def off_by_one(rig):
    losses = Losses(rig, planted=1)
    rig.connect(losses.feed)
    return losses.matches


@pytest.mark.heavy
def test_an_off_by_one_error_is_found_shrunk_and_repeated_by_three_lines(virtual_rig):
    begin = time.process_time()
    with pytest.raises(AssertionError) as failure:
        search(virtual_rig, off_by_one, QUICK)
    assert time.process_time() - begin < LIMIT_S
    head, *lines = failure.value.__notes__[-1].splitlines()
    assert head.endswith("these lines repeat it:")
    assert len(lines) == 3
    actions = re.findall(r"(?:Command|Change|Inject|Pause|Silence)\(", lines[2])
    assert 1 <= len(actions) <= 3, lines[2]
    program = "\n".join(line.strip() for line in lines)
    with pytest.raises(AssertionError):
        exec(program, {"virtual_rig": virtual_rig, "off_by_one": off_by_one})  # what a reader would do
    exec(program, {"virtual_rig": virtual_rig, "off_by_one": sound})  # the bug is the consumer's


@pytest.mark.heavy
def test_a_correct_consumer_causes_no_failure(virtual_rig):
    search(virtual_rig, sound, QUICK, examples=40)


def test_every_action_has_its_described_effect():
    rig = LocalRig(QUICK)
    repeat(
        rig, lambda _: None,
        [Command(9.1, 0.5), Pause(5), Silence(10), Inject("lost_block", "", 2), Inject("saturation", "laser", 1, 1e-3)],
    )  # fmt: skip
    kinds = {entry.kind.value for entry in rig.journal()}
    assert {"command", "timeout", "parameter", "fault"} <= kinds
    assert sum(end - first for first, end in rig.lost_samples()) == 20
    assert rig.config.output.command_timeout_s == LocalRig(QUICK).config.output.command_timeout_s


def test_a_pipeline_can_join_any_rig_late():
    joined = []
    repeat(LocalRig(QUICK), lambda rig: joined.append(rig.sample), [LateJoin(4)])
    assert joined == [40]


@pytest.mark.ros
def test_a_rig_on_ros_runs_the_same_scenario(ros_rig):
    rig = ros_rig(QUICK, hosted=True)
    repeat(rig, lambda _: None, [Command(9.1, 0.5), Pause(5), Silence(10), Inject("lost_block", blocks=2)])
    kinds = {entry.kind.value for entry in rig.journal()}
    assert {"command", "timeout", "parameter", "fault"} <= kinds
    assert sum(end - first for first, end in rig.lost_samples()) == 20
