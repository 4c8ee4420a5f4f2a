# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a change of a configuration value touches, and from when on."""

from __future__ import annotations

import attrs

from impact_rig.errors import ConfigError
from impact_rig.instruments.setup import Setup
from impact_rig.rig.config import RigConfig, to_flat
from impact_rig.rig.journal import NOT_SAMPLED, SAMPLED, Value

MECHANICS = ("structure.", "shaker.", "sphere.", "barriers.", "contact.")
INSTRUMENTS = ("instruments.", "daq.")
PLANNED = "instruments.faults.planned"
AT_RESET = ("drive.", "daq.seed")
"""What is drawn or commanded at the beginning only."""


def takes_effect(name: str) -> str:
    """Return from when on a new value of a parameter acts on a running rig, in words."""
    if name == PLANNED:
        return "next command instant, for the lines that are new or gone"
    if name.startswith(AT_RESET):
        return "next reset"
    if name.startswith(NOT_SAMPLED) and name not in SAMPLED:
        return "at once"
    if name.startswith(("sphere.", "barriers.", "contact.")):
        return "next command instant; the sphere rests at `sphere.start` again"
    return "next command instant"


def changed_values(before: RigConfig, after: RigConfig) -> dict[str, Value]:
    """Return the values of `after` that `before` has otherwise, by name.

    Raises:
        ConfigError: one is fixed at start.
    """
    if (after.daq.rate_hz, after.daq.block_scans) != (before.daq.rate_hz, before.daq.block_scans):
        raise ConfigError("daq.rate_hz and daq.block_scans are fixed at start")
    old = to_flat(before)
    return {name: value for name, value in to_flat(after).items() if value != old[name]}


def until_reset(present: Setup, config: RigConfig) -> RigConfig:
    """Return `config` with the seed and the planned faults of `present`: the instruments draw both at a reset."""
    return attrs.evolve(
        config,
        daq=attrs.evolve(config.daq, seed=present.daq.seed),
        instruments=attrs.evolve(config.instruments, faults=present.instruments.faults),
    )
