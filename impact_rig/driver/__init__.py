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
"""Rig that a program operates, in this process (`LocalRig`) or over ROS topics (`RosRig`), by the same calls.

    rig = LocalRig({"barriers.gap_m": 0.006}, analysis={"gap_m": 0.006})
    rig.command(frequency_hz=9.1, current_a=0.52)
    rig.run(seconds=20)
    print(rig.rows("transmissibility/table")["transmissibility"])

`AnalogOutput` and `Acquisition` are the buffered analog output and input of such a rig; `Hardware` combines both.
Importing this package loads neither rclpy nor compiled code: both are loaded with the first name that needs them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from impact_rig.system import lazily

if TYPE_CHECKING:
    from impact_rig.driver.driver import NotReachedError, RigDriver
    from impact_rig.driver.hardware import Acquisition, AnalogOutput, Hardware, UnderrunError
    from impact_rig.driver.local_rig import LocalRig
    from impact_rig.driver.ros_rig import RosRig

__all__ = [
    "Acquisition",
    "AnalogOutput",
    "Hardware",
    "LocalRig",
    "NotReachedError",
    "RigDriver",
    "RosRig",
    "UnderrunError",
]

__getattr__ = lazily(
    __name__, needs_ros="ros_rig", Acquisition="hardware", Hardware="hardware", LocalRig="local_rig",
    NotReachedError="driver", AnalogOutput="hardware", RigDriver="driver", RosRig="ros_rig", UnderrunError="hardware",
)  # fmt: skip
