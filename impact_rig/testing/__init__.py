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
"""Tools for tests of a pipeline, described in `docs/how-to/testing.md`; other programs use `impact_rig.client`.

Use them directly, or through the fixtures `virtual_rig`, `virtual_rig_with_nodes`, `ros_rig` and `golden` of the pytest
plugin:

- `LocalRig`: a rig in the test's process, without ROS; the pipeline is a function of blocks.
- `LocalRigWithNodes`: such a rig that also runs ROS nodes, whose callbacks run in an order that a scenario decides.
- `RosRig`: a rig on its own ROS domain, in lockstep with the nodes under test.
- `Fault`: a fault of the instruments at exact samples.
- `Golden`: comparison with a run, or with numbers, that were checked once.

Importing this package imports neither rclpy nor compiled code; both are loaded with the first name that needs them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from impact_rig.system import lazily

if TYPE_CHECKING:
    from impact_rig.driver import LocalRig, NotReachedError, RigDriver, RosRig
    from impact_rig.instruments.fault import Fault
    from impact_rig.testing.golden import Golden, first_difference
    from impact_rig.testing.schedule import LocalRigWithNodes

__all__ = [
    "Fault",
    "Golden",
    "LocalRig",
    "LocalRigWithNodes",
    "NotReachedError",
    "RigDriver",
    "RosRig",
    "first_difference",
]

__getattr__ = lazily(
    __name__,
    needs_ros="schedule",
    Fault="impact_rig.instruments.fault",
    Golden="golden",
    LocalRig="impact_rig.driver",
    LocalRigWithNodes="schedule",
    NotReachedError="impact_rig.driver",
    RigDriver="impact_rig.driver",
    RosRig="impact_rig.driver",
    first_difference="golden",
)
