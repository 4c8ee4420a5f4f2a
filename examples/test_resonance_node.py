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
"""Example (b): the loop closed over the topics, in lockstep: rig time stops while the controller computes."""

import math

import pytest
from resonance_node import ResonanceNode

RIG = {"drive.amplitude": 0.4, "daq.block_scans": 500}  # blocks of 50 ms
QUARTER = math.radians(3.0)
"""Phase error that counts as resonance: 2 mHz, as the phase turns by 24 rad per hertz there."""


def settle(rig, errors, limit_s):
    """Advance until the last three phase errors are small."""
    before = len(errors)

    def settled():
        last = [message.data for message in errors.messages[before:][-3:]]
        return len(last) == 3 and max(map(abs, last)) < QUARTER

    return rig.wait_until(settled, "three phase errors below 3 degrees", limit_s=limit_s, every_s=0.5)


def test_the_node_finds_the_resonance_of_the_structure(ros_rig):
    rig = ros_rig({**RIG, "sphere.present": False, "drive.frequency_hz": 8.5}, hosted=True)
    node = rig.host(ResonanceNode)
    settle(rig, rig.listen("phase_error"), limit_s=60)
    structure = rig.config.structure
    quarter_cycle_hz = structure.natural_frequency_hz / math.sqrt(1 - 4 * structure.damping_ratio**2)
    assert node.frequency_hz == pytest.approx(quarter_cycle_hz, abs=0.003)


def test_the_node_stays_at_the_resonance_while_the_gap_changes(ros_rig):
    """The sphere lowers the resonance by a few parts in a thousand; how much depends on the gap."""
    rig = ros_rig({**RIG, "barriers.gap_m": 0.010, "drive.frequency_hz": 9.0}, hosted=True)
    node = rig.host(ResonanceNode)
    errors = rig.listen("phase_error")
    settle(rig, errors, limit_s=60)
    for gap_m in (0.006, 0.003):
        rig.client.set_parameters("rig", {"barriers.gap_m": gap_m})
        settle(rig, errors, limit_s=30)
        assert 0.990 < node.frequency_hz / rig.config.structure.natural_frequency_hz < 1.0
        assert len(rig.rows("truth/impacts")) > 100, "the sphere takes part"
