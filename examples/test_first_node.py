# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The first node of the documentation, against the rig and its analysis: the value for a gap of 6 mm."""

import pytest
from first_node import FirstNode


def test_it_drives_the_rig_and_hears_what_is_measured(ros_rig):
    rig = ros_rig({"barriers.gap_m": 6e-3})
    rig.processes.start("analysis")
    rig.follow("analysis")
    node = rig.client.host(FirstNode)  # it answers no block: nobody waits for it
    rig.wait_until(lambda: node.heard, "a transmissibility", limit_s=60)
    assert node.heard[-1] == pytest.approx(63.4, rel=0.01)
