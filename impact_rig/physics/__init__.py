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
"""Mechanics of the simulated rig: flights of the sphere in closed form, and its contacts with the walls by integration.

A flight is the motion between contacts. A contact is integrated in w, the square root of the indentation, because the
force has no kinks in w. `FunctionGenerator` turns commands into drive segments. `Simulation` advances by these segments
and returns a `Motion`, which the instruments evaluate. This package never imports rclpy.
"""

from typing import TYPE_CHECKING

from impact_rig.system import lazily

if TYPE_CHECKING:
    from impact_rig.physics.flight import SEGMENT
    from impact_rig.physics.function_generator import FunctionGenerator
    from impact_rig.physics.simulation import IMPACT, SAMPLE, EnergyAccount, Motion, Simulation

__getattr__ = lazily(  # compiled code is loaded where it is used, not where a configuration is read
    __name__,
    SEGMENT="flight",
    FunctionGenerator="function_generator",
    IMPACT="state",
    SAMPLE="simulation",
    Motion="simulation",
    EnergyAccount="simulation",
    Simulation="simulation",
)

__all__ = ["IMPACT", "SAMPLE", "SEGMENT", "EnergyAccount", "FunctionGenerator", "Motion", "Simulation"]
