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
"""The first touch is neither missed nor invented, however grazing, early or crowded."""

from __future__ import annotations

import math

import numpy as np
import pytest
from kits.mechanics import TWO_PI, at_rest, limit_case, prescribed, rig, sine

from impact_rig.physics import Simulation

ZETA, FREQUENCY_HZ, GAP_M = 1e-6, 9.105, 6e-3
OMEGA = TWO_PI * FREQUENCY_HZ


@pytest.mark.parametrize("excess", [1e-3, 1e-6, 1e-9, 1e-12, -1e-12, -1e-9, -1e-6])
def test_a_grazing_touch_is_found_exactly_if_the_peak_exceeds_half_the_gap(excess):
    """The base swings freely about a sphere at rest; its peak passes half the gap by `excess` of it, or stays below."""
    config = prescribed(structure={"damping_ratio": ZETA}, barriers={"gap_m": GAP_M}, contact={"law": "restitution"})
    simulation = Simulation(config)
    # x = A exp(−ζωt) sin(ω_d t): its first peak is A exp(−ζφ/√(1−ζ²)) √(1−ζ²), tan φ = √(1−ζ²)/ζ
    wide = math.sqrt(1.0 - ZETA**2)
    peak = math.exp(-ZETA * math.atan2(wide, ZETA) / wide) * wide
    amplitude = GAP_M / 2.0 * (1.0 + excess) / peak
    speed = amplitude * OMEGA * wide
    simulation.place(v_1=speed, d_rate=-speed)
    impacts = simulation.advance(at_rest(0.3 / FREQUENCY_HZ)).impacts
    if excess < 0.0:
        assert len(impacts) == 0
    else:
        assert len(impacts) == 1
        assert impacts["wall"][0] == -1
        # to second order in the time before the peak
        wanted = math.sqrt(2.0 * excess) * OMEGA * GAP_M / 2.0
        assert impacts["approach_speed"][0] == pytest.approx(wanted, rel=1e-3 + 1e-3 * (excess < 1e-9))


@pytest.mark.parametrize("speed", [50.0, 5e3])
def test_a_fast_sphere_meets_every_wall(speed):
    """A sphere far faster than the base meets the walls at e^n of its speed, one after another, in one segment."""
    e, gap = 0.9, 1e-3
    config = limit_case(
        drive={"kind": "prescribed"},
        structure={"mass_kg": 100.0, "natural_frequency_hz": 1e-3},
        barriers={"gap_m": gap},
        contact={"law": "restitution", "restitution": e},
    )
    simulation = Simulation(config)
    simulation.place(d_rate=speed)
    count = 40
    flights = np.append(0.5, e ** -np.arange(1.0, count)) * gap / speed
    impacts = simulation.advance(at_rest(flights.sum() * (1.0 + 1e-9))).impacts
    assert list(impacts["wall"]) == [1 if n % 2 == 0 else -1 for n in range(count)]
    assert impacts["approach_speed"] == pytest.approx(speed * e ** np.arange(count), rel=1e-9)
    assert impacts["offset"] == pytest.approx(np.cumsum(flights), rel=1e-9)


@pytest.mark.parametrize("gap", [1e-6, 1e-4, 2e-3, 6e-3, 30e-3])
def test_the_sphere_is_never_outside_the_walls(gap):
    """With instantaneous contacts the distance never exceeds half the gap by more than rounding."""
    simulation = Simulation(rig(contact={"law": "restitution"}, barriers={"gap_m": gap}))
    motion = simulation.advance(sine(9.1, 0.52, 0.01, 500))
    place = np.tile(np.linspace(0.0, 0.01, 200, endpoint=False), 500)
    x_1, x_2 = motion.quantities(("x_1", "x_2"), np.repeat(np.arange(500), 200), place)
    assert len(motion.impacts) > 20
    assert np.abs(x_2 - x_1).max() <= gap / 2.0 + 1e-14 * np.abs(x_2).max()
