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
"""Invariances: mirror image, time shift, scale, momentum. They hold whatever the parameters are."""

from __future__ import annotations

import math

import attrs
import numpy as np
import pytest
from kits.mechanics import hit, rig, sine, sphere_kg

from impact_rig.physics import Simulation


@pytest.mark.parametrize("law", ["flores", "kelvin_voigt", "restitution"])
@pytest.mark.parametrize("gap", [0.5e-3, 6e-3])
def test_a_mirrored_start_yields_the_mirrored_run(law, gap):
    config = rig(contact={"law": law}, barriers={"gap_m": gap})
    runs = []
    for sign in (1.0, -1.0):
        simulation = Simulation(config)
        simulation.place(x_1=sign * 3e-3, v_1=sign * 0.02, d=sign * 0.1e-3, d_rate=sign * 0.1)
        runs.append(simulation.advance(sine(9.1, 1.0, 0.01, 100, phase=0.0 if sign > 0 else math.pi)))
    right, left = (motion.impacts for motion in runs)
    assert len(right) == len(left) > 5
    assert (right["wall"] == -left["wall"]).all()
    first = slice(10)  # chaos doubles the last digit with each impact
    # A touch is seen within the rounding r of the positions: at the speed v that is a time r / v, in which the base's
    # acceleration a changes the speed by a r / v. Of a chatter's last bounces that is what their speed is known to.
    speed = right["approach_speed"][first]
    rounding = np.spacing(3e-3 + 0.5 * gap)
    known = 1e-8 + 10.0 * (2.0 * math.pi * 9.105) ** 2 * 3e-3 * rounding / (speed * speed)
    for name, power in {"approach_speed": 1.0, "peak_force": 1.2, "duration": 0.2, "energy_lost": 2.0}.items():
        assert (np.abs(left[name] - right[name])[first] <= max(1.0, power) * known * right[name][first]).all(), name
    t = np.linspace(0.0, 0.01, 11)[:-1]
    x = [motion.quantity("x_1", np.zeros(10, int), t) for motion in runs]
    assert np.abs(x[0] + x[1]).max() <= 1e-12 * np.abs(x[0]).max()


def test_a_later_start_yields_the_same_run_later():
    """The segments' number means nothing: only phases do."""
    config = rig()
    early, late = Simulation(config), Simulation(config)
    late.advance(sine(9.1, 0.0, 0.01, 37))
    for simulation in (early, late):
        simulation.place(x_1=3e-3, d_rate=0.1)
    a, b = (simulation.advance(sine(9.1, 1.0, 0.01, 100)).impacts for simulation in (early, late))
    assert (b["tick"] - a["tick"] == 37).all()
    assert all((a[name] == b[name]).all() for name in a.dtype.names if name != "tick")


def test_lengths_scale_with_the_drive_if_contacts_take_no_time():
    """Twice the drive, gap and start give twice the motion."""
    runs = []
    for scale in (1.0, 2.0):
        simulation = Simulation(rig(contact={"law": "restitution"}, barriers={"gap_m": 4e-3 * scale}))
        simulation.place(x_1=3e-3 * scale, d_rate=0.1 * scale)
        runs.append(simulation.advance(sine(9.1, 1.0 * scale, 0.01, 50)).impacts)
    one, two = runs
    assert len(one) == len(two) > 5
    assert two["approach_speed"][:8] == pytest.approx(2.0 * one["approach_speed"][:8], rel=1e-9)
    assert two["offset"][:8] == pytest.approx(one["offset"][:8], rel=1e-9)


def test_the_peak_force_of_hertz_scales_with_a_power_of_the_speed():
    slow, fast = hit(0.1, law="hertz"), hit(1.0, law="hertz")
    assert fast.peak_force / slow.peak_force == pytest.approx(10.0**1.2, rel=1e-7)
    assert fast.peak_indentation / slow.peak_indentation == pytest.approx(10.0**0.8, rel=1e-7)
    assert slow.duration / fast.duration == pytest.approx(10.0**0.2, rel=1e-7)


@pytest.mark.parametrize("law", ["hertz", "flores", "kelvin_voigt", "restitution"])
def test_a_contact_conserves_momentum(law):
    """A structure on almost no columns and the sphere: m v_2 + m_1 v_1 stays."""
    got = hit(0.5, structure_kg=4e-3, law=law)
    t = np.array([0.9 * got.begin_s, got.begin_s + 1.5 * got.duration + 1e-6])
    v_1, v_2 = (got.motion.quantity(name, np.zeros(2, int), t) for name in ("v_1", "v_2"))
    momentum = 4e-3 * v_1 + sphere_kg() * v_2
    assert momentum[1] == pytest.approx(momentum[0], rel=1e-9)
    assert 4e-3 * (v_1[1] - v_1[0]) == pytest.approx(got.impulse, rel=1e-7)


def test_a_heavier_structure_with_a_heavier_sphere_moves_identically():
    """Only ratios of masses, and K/m, matter under a prescribed base."""
    small = rig(drive={"kind": "prescribed"})
    large = attrs.evolve(
        small,
        structure=attrs.evolve(small.structure, mass_kg=8.0 * small.structure.mass_kg),
        sphere=attrs.evolve(small.sphere, density_kg_m3=8.0 * small.sphere.density_kg_m3, young_modulus_pa=8 * 210e9),
        barriers=attrs.evolve(small.barriers, young_modulus_pa=8 * 70e9),
    )
    runs = []
    for config in (small, large):
        simulation = Simulation(config)
        simulation.place(x_1=4e-3, d_rate=0.1)
        runs.append(simulation.advance(sine(9.1, 1e-4, 0.01, 50)).impacts)
    assert runs[1]["approach_speed"][:8] == pytest.approx(runs[0]["approach_speed"][:8], rel=1e-7)
    assert runs[1]["peak_force"][:8] == pytest.approx(8.0 * runs[0]["peak_force"][:8], rel=1e-7)
