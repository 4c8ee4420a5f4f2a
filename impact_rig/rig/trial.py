"""Values that are legal one by one may be none together: a short trial tells before they are taken."""

from __future__ import annotations

import numpy as np

from impact_rig.config import RigConfig
from impact_rig.errors import ConfigError, SimulationError
from impact_rig.physics import FunctionGenerator, Simulation
from impact_rig.simtime import COMMAND_GRID_S

TRIAL_TICKS = 3


def built(config: RigConfig) -> Simulation:
    """Return a new simulation of values that are not only legal one by one but give finite motion together.

    Raises:
        ConfigError: they do not.
    """
    try:
        trial, drive = Simulation(config), FunctionGenerator(config.drive, config.shaker, np.random.default_rng(0))
        drive.set_amplitude(1.0)
        motion = trial.advance(drive.segments(TRIAL_TICKS))
        last = motion.sample(np.array([motion.last_segment]), np.array([COMMAND_GRID_S]))
    except (ArithmeticError, ValueError, SimulationError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"these values together cannot be simulated: {error}") from error
    if not all(np.isfinite(last[name]).all() for name in last.dtype.names or ()):
        raise ConfigError("these values together give a motion that is not finite")
    return Simulation(config)
