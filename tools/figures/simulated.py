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
"""Motions of the rig's mechanics for figures, with the same bits on every machine; and the first figure."""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.physics import SEGMENT, Motion, Simulation
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.gaps import gap_values
from impact_rig.simulation import simulate
from impact_rig_studies.campaign.paper import CURRENT_A, FREQUENCY_HZ
from tools.figures.style import finished

TICK_S = 0.01
SETTLE_S = 40.0
"""Ten time constants of the structure without the sphere."""
AVERAGED_CYCLES = 100
PER_CYCLE = 64
Real = NDArray[np.float64]


@attrs.frozen(eq=False)
class Steady:
    """The rig after its transient has decayed."""

    motion: Motion  # motion of the last part
    frequency_hz: float  # drive frequency
    begin_s: float  # start of complete cycles in rig time: the current passes zero upwards

    def at(self, names: tuple[str, ...], time_s: Real) -> Real:
        """Return quantities at instants after `begin_s` [s], SI, shape (names, n)."""
        ticks = (self.begin_s + time_s) / TICK_S
        segment = np.floor(ticks).astype(np.int64)
        return self.motion.quantities(names, segment, (ticks - segment) * TICK_S)

    def impact_times(self) -> Real:
        """Return the starts of the contacts, after `begin_s` [s], shape (k,)."""
        hits = self.motion.impacts
        return np.asarray(hits["tick"] * TICK_S + hits["offset"] - self.begin_s)


def steady(
    gap_m: float, frequency_hz: float = FREQUENCY_HZ, cycles: int = AVERAGED_CYCLES, settle_s: float = SETTLE_S
) -> Steady:
    """Return the steady motion at the paper's current; with gap 0 that without the sphere."""
    simulation = Simulation(from_flat(RigConfig(), gap_values(gap_m)))
    begin = math.ceil(settle_s * frequency_hz) / frequency_hz
    first = int(begin / TICK_S)
    simulation.advance(_drive(0, first, frequency_hz))
    count = math.ceil(cycles / frequency_hz / TICK_S) + 2
    return Steady(simulation.advance(_drive(first, count, frequency_hz)), frequency_hz, begin)


def transmissibility(gap_m: float, frequency_hz: float = FREQUENCY_HZ, settle_s: float = SETTLE_S) -> float:
    """Return |X_1| / |X_b| over whole cycles."""
    found = steady(gap_m, frequency_hz, settle_s=settle_s)
    time = np.arange(AVERAGED_CYCLES * PER_CYCLE) / (PER_CYCLE * frequency_hz)
    turn = np.exp(-2j * math.pi * frequency_hz * time)
    base, structure = found.at(("x_b", "x_1"), time) @ turn
    return float(abs(structure) / abs(base))


def draw_first_look() -> str:
    """Return the drawing of the five lines in docs/index.md, as SVG."""
    driven = {"drive.frequency_hz": 9.1, "drive.amplitude": 0.52, "barriers.gap_m": 0.006}
    words = "Half a second of base, structure and acceleration, with the impacts that the analysis found."
    return finished(simulate(20.0, driven).plot(), words)


def _drive(first: int, count: int, frequency_hz: float) -> NDArray[np.void]:
    segments = np.zeros(count, SEGMENT)
    segments["duration"], segments["omega"], segments["amplitude"] = TICK_S, 2.0 * math.pi * frequency_hz, CURRENT_A
    turns = frequency_hz * TICK_S * np.arange(first, first + count)
    segments["phase"] = 2.0 * math.pi * (turns - np.floor(turns))
    return segments
