# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated reductions: what the rig of given constants would show ideal instruments."""

from __future__ import annotations

import numpy as np

from impact_rig.campaign.in_process import execute
from impact_rig.campaign.job import Job
from impact_rig.errors import SimulationError
from impact_rig.operate.plan import Direction
from impact_rig.physics.closed_form import transmissibility
from impact_rig.rig.config import RigConfig, from_flat, to_flat
from impact_rig.studies.identification.fisher import Real
from impact_rig.studies.identification.measurements import Reduced


def simulated_log_ratios(config: RigConfig, reduced: Reduced) -> Real:
    """Return ln(DT with sphere / DT without) for the gaps of `reduced`, in their order, shape (n,).

    Raises:
        SimulationError: a response did not settle.
    """
    return simulated(config, tuple(reduced.ratio), reduced.frequency_hz, reduced.current_a)


def simulated(config: RigConfig, gaps_m: tuple[float, ...], frequency_hz: float, current_a: float) -> Real:
    """Return ln(DT with sphere / DT without) by gap; without, it is known in closed form.

    Raises:
        SimulationError: a response did not settle.
    """
    default = to_flat(RigConfig())
    without = abs(complex(transmissibility(config, frequency_hz)))
    found = []
    for gap in gaps_m:
        ideal = {"instruments.ideal": True, "sphere.present": True, "barriers.gap_m": gap}
        changed = to_flat(from_flat(config, ideal))
        job = Job(
            changes={name: value for name, value in changed.items() if value != default[name]},
            analysis={}, gap_m=gap, frequencies_hz=(frequency_hz,), direction=Direction.UP, current_a=current_a,
            repetitions=1, traces=False,
        )  # fmt: skip
        outcome = execute(job)
        if outcome.failure or not len(outcome.rows):
            raise SimulationError(f"gap {gap * 1e3:g} mm, {frequency_hz:g} Hz: {outcome.failure or 'no measurement'}")
        found.append(float(outcome.rows["transmissibility"][0]) / without)
    return np.log(found)
