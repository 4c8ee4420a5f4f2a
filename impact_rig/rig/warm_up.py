# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a rig runs that is compiled, in parts that compile side by side: each is run once, on nothing.

Only the tasks are for import by programs; everything compiled is loaded inside the functions.
"""

from __future__ import annotations

from types import SimpleNamespace

import attrs
import numpy as np

from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import COMMAND_GRID_S
from impact_rig.system.compile_ahead import Task

MECHANICS = Task(f"{__name__}:mechanics", ("arithmetic", "physics"))
SAMPLING = Task(f"{__name__}:sampling", ("arithmetic", "physics", "rig"))
INSTRUMENTS = Task(f"{__name__}:instruments", ("arithmetic", "instruments"))
TASKS = (MECHANICS, INSTRUMENTS, SAMPLING)
"""The longest first."""


def mechanics() -> None:
    """Advance a rig at rest by a tick, and draw one of a random drive."""
    from impact_rig.arithmetic.random import Random  # noqa: PLC0415  # compiled
    from impact_rig.physics import FunctionGenerator, Simulation  # noqa: PLC0415  # compiled

    config = RigConfig()
    sine = FunctionGenerator(config.drive, config.shaker, Random(0))
    Simulation(config).advance(sine.segments(1))
    FunctionGenerator(attrs.evolve(config.drive, waveform="random"), config.shaker, Random(0)).segments(1)


def sampling() -> None:
    """Let the interlock look at a motion that rests."""
    from impact_rig.arithmetic.records import for_kernels, records  # noqa: PLC0415  # compiled
    from impact_rig.physics.forcing import SEGMENT  # noqa: PLC0415  # compiled
    from impact_rig.physics.model import build  # noqa: PLC0415  # compiled
    from impact_rig.physics.motion import Motion  # noqa: PLC0415  # compiled
    from impact_rig.physics.state import IMPACT, STATE  # noqa: PLC0415  # compiled
    from impact_rig.rig.interlock import Interlock  # noqa: PLC0415  # compiled

    segments = for_kernels(np.zeros(1, SEGMENT))
    motion = Motion(build(RigConfig()), 0, segments, records(1, STATE), np.array([0, 1]), np.zeros(0, IMPACT))
    motion.breakpoints()
    Interlock().watch(motion, COMMAND_GRID_S, RigConfig().drive, RigConfig().shaker)


def instruments() -> None:
    """Measure a tick of a motion that rests, by real instruments and by ideal ones."""
    from impact_rig.instruments.chain import Chain  # noqa: PLC0415  # compiled
    from impact_rig.physics.state import IMPACT  # noqa: PLC0415  # compiled

    rest = SimpleNamespace(
        impacts=np.zeros(0, IMPACT),
        quantities=lambda names, segment, _offset: np.zeros((len(names), len(segment))),
        breakpoints=lambda: (np.zeros(1, np.int64), np.zeros(1)),
    )
    for ideal in (False, True):
        config = from_flat(RigConfig(), {"instruments.ideal": ideal})
        chain = Chain(config)
        chain.calibrate("laser", 1.0, 0.0, 1)
        chain.acquire(rest, 0, 1)
        chain.read(chain.ready)
