# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The rig's mechanics: flights in closed form, contacts integrated in a variable without kinks.

Never imports rclpy. `Simulation` advances by drive segments made by `FunctionGenerator` and returns a `Motion`, which
instruments evaluate.
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
