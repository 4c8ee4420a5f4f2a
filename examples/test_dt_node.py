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
"""Example (a): a third-party pipeline against the rig, with lost blocks and clipping."""

import pytest
from dt_node import DtNode
from lockin import LockIn

from impact_rig.testing import Fault

LINEAR = {"sphere.present": False}
TOLERANCE = 0.01  # calibration of laser and base: 0.3 % each


def expected(rig):
    return abs(rig.expected_transmissibility(9.1))


def test_the_node_measures_the_transmissibility_of_the_closed_form(ros_rig):
    rig = ros_rig(LINEAR, hosted=True)
    rig.host(DtNode)
    dt = rig.listen("dt")
    rig.command(frequency_hz=9.1, current_a=0.52, at_sample=1000)
    rig.wait_until(lambda: len(dt) >= 4, "four windows", limit_s=6)
    assert dt.messages[-1].data == pytest.approx(expected(rig), rel=TOLERANCE)


def test_each_gap_of_lost_blocks_costs_one_window(ros_rig):
    """Three gaps, the last of a single block; every value published is right all the same.

    Windows take a second, and a second of settling. They end at 2, 3 and 4 s (the first two while the rig still starts
    to move), none between the gaps at 4, 4.5 and 6 s, then at 8, 9 and 10 s.
    """
    gaps = [(40_000, 700), (45_000, 2_000), (60_000, 100)]
    faults = [Fault(kind="lost_block", start_sample=start, samples=count) for start, count in gaps]
    rig = ros_rig({**LINEAR, "drive.amplitude": 0.52}, faults, hosted=True)
    node = rig.host(DtNode)
    dt = rig.listen("dt")
    rig.run(seconds=10)
    assert rig.lost_samples() == [(start, start + count) for start, count in gaps]
    assert node.lockin.gaps == len(gaps)
    settled = [message.data for message in dt.messages[2:]]
    assert len(settled) == 4
    assert settled == pytest.approx([expected(rig)] * len(settled), rel=TOLERANCE)


def test_clipped_samples_yield_no_value_instead_of_a_wrong_one(virtual_rig):
    """The laser limits at +-3 mm for a second; the same pipeline without ROS, as the algorithm is what matters."""
    rig = virtual_rig(
        {**LINEAR, "drive.amplitude": 0.52},
        [Fault(kind="saturation", channel="laser", start_sample=50_000, samples=10_000, value=3e-3)],
    )
    lockin, found = LockIn(9.1, rig.rate_hz), {}

    def pipeline(block):
        for ratio in lockin.feed(block.stamp_ns, block.rows):
            found[rig.time_s] = ratio

    rig.connect(pipeline)
    rig.run(seconds=9)
    assert lockin.clipped > 50
    assert not [time_s for time_s in found if 5.0 < time_s < 7.9]
    values = [abs(ratio) for time_s, ratio in found.items() if time_s > 3]
    assert values == pytest.approx([expected(rig)] * len(values), rel=TOLERANCE)
    assert max(found) > 7.9, "it recovers"
