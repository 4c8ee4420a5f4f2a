"""The rig's mechanics: flights in closed form, contacts integrated in a variable without kinks.

Never imports rclpy. `Simulation` advances by drive segments made by `FunctionGenerator` and returns a `Motion`, from
which instruments sample.
"""

import impact_rig.system.compiled  # noqa: F401  # first: finds what was compiled from these sources
from impact_rig.physics.forcing import SEGMENT
from impact_rig.physics.function_generator import FunctionGenerator
from impact_rig.physics.motion import IMPACT, SAMPLE, Motion
from impact_rig.physics.simulation import EnergyAccount, Simulation

__all__ = ["IMPACT", "SAMPLE", "SEGMENT", "EnergyAccount", "FunctionGenerator", "Motion", "Simulation"]
