# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""For tests of a pipeline. `docs/testing.md` shows how to test one with it; `impact_rig.client` is for everything else.

Through the pytest plugin's fixtures of the same names, or by themselves:

- `VirtualRig`: a rig in the test's process, without ROS; the pipeline is a function of blocks.
- `RosRig`: a rig on a ROS domain of its own, in lockstep with the nodes under test.
- `Fault`: a fault of the instruments at exact samples.
- `Golden`: comparison with a run, or with numbers, that were right once.

Importing this imports neither rclpy nor compiled code: both are loaded when something that needs them is asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from impact_rig.system import lazily

if TYPE_CHECKING:
    from impact_rig.instruments.fault import Fault
    from impact_rig.testing.golden import Golden, first_difference
    from impact_rig.testing.ros_rig import RosRig
    from impact_rig.testing.virtual_rig import NotReachedError, SteppedRig, VirtualRig

__all__ = ["Fault", "Golden", "NotReachedError", "RosRig", "SteppedRig", "VirtualRig", "first_difference"]

__getattr__ = lazily(
    __name__,
    Fault="impact_rig.instruments.fault",
    Golden="golden",
    NotReachedError="virtual_rig",
    RosRig="ros_rig",
    SteppedRig="virtual_rig",
    VirtualRig="virtual_rig",
    first_difference="golden",
)
