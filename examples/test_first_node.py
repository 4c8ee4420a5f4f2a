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
"""The first node of the documentation, against the rig and its analysis: the value for a gap of 6 mm."""

import pytest
from first_node import FirstNode


def test_the_node_drives_the_rig_and_receives_the_measurements(ros_rig):
    rig = ros_rig({"barriers.gap_m": 6e-3})
    rig.processes.start("analysis")
    rig.follow("analysis")
    node = rig.client.host(FirstNode)  # it acknowledges no block, so the rig does not wait for it
    rig.wait_until(lambda: node.received, "a transmissibility", limit_s=60)
    assert node.received[-1] == pytest.approx(63.4, rel=0.01)
