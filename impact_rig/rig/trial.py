# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Values that are legal one by one may be none together: a short trial tells before they are taken."""

from __future__ import annotations

import attrs
import numpy as np

from impact_rig.arithmetic.random import Random
from impact_rig.errors import CommandError, ConfigError, SimulationError
from impact_rig.physics import FunctionGenerator, Simulation
from impact_rig.physics.model import Model, build
from impact_rig.rig.config import RigConfig
from impact_rig.rig.interlock import check_amplitude
from impact_rig.simtime import COMMAND_GRID_S

TRIAL_TICKS = 3
SLOWEST_RATE, FASTEST_RATE = 0.5, 1e5
"""Of the modes of structure and shaker, whose coil is one [1/s]. A slower one creeps in a tick of 10 ms by less than
the rounding of the position it creeps to, a faster one (a coil of L < 10 µs · R) makes the steps of a contact, which
resolve it, so short that a sphere at rest on a wall cannot be followed in real time."""
DRIVE_SEED = 0
"""`spawn_key` of the drive's random numbers under `daq.seed`; the instruments use their own."""


def generator(config: RigConfig) -> FunctionGenerator:
    """Return a new drive at its initial command.

    Raises:
        ConfigError: the shaker does not take that command.
    """
    seeds = np.random.SeedSequence(config.daq.seed, spawn_key=(DRIVE_SEED,))
    try:
        check_amplitude(config.drive.amplitude, config.drive, config.shaker)
        return FunctionGenerator(config.drive, config.shaker, Random(seeds))
    except CommandError as error:
        raise ConfigError(f"drive: {error}") from error


def tried(config: RigConfig) -> Model:
    """Return the model of values that are not only legal one by one but give finite motion together.

    Raises:
        ConfigError: they do not.
    """
    try:
        model = build(config)
        _check_together(config, model)
        sine = attrs.evolve(config.drive, waveform="sine") if config.drive.waveform == "stream" else config.drive
        trial, drive = Simulation(config, model=model), FunctionGenerator(sine, config.shaker, Random(0))
        drive.set_amplitude(1.0)
        motion = trial.advance(drive.segments(TRIAL_TICKS))
        last = motion.sample(np.array([motion.last_tick]), np.array([COMMAND_GRID_S]))
    except (ArithmeticError, ValueError, SimulationError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"these values together cannot be simulated: {error}") from error
    if not all(np.isfinite(last[name]).all() for name in last.dtype.names or ()):
        raise ConfigError("these values together give a motion that is not finite")
    return model


def _check_together(config: RigConfig, model: Model) -> None:
    """Raise ConfigError where the mechanics does not resolve masses and modes together."""
    mass_kg, structure_kg = float(model.parameters["m"][0]), config.structure.mass_kg
    if mass_kg > structure_kg:
        raise ConfigError(
            f"the sphere must not outweigh the superior base that carries it, structure.mass_kg = {structure_kg:g} kg, "
            f"got {mass_kg:.4g} kg of sphere.diameter_m and density_kg_m3"
        )
    for system in model.systems:
        for value in np.abs(system["rate"][: int(system["modes"])]):
            if not SLOWEST_RATE <= value <= FASTEST_RATE:
                raise ConfigError(
                    f"structure and shaker must have modes of rates >= {SLOWEST_RATE:g} and <= {FASTEST_RATE:g} 1/s "
                    f"(springs over dampings, dampings over masses, resistance over inductance), got {value:.3g}"
                )
