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
"""The simulator on steady motions with two symmetric impacts per cycle, known in closed form."""

from __future__ import annotations

import math

import attrs
import numpy as np
import pytest
from kits.masri_caughey import NO_IMPACT_AMPLITUDE_M, STABLE, UNSTABLE, Case, Orbit, orbit
from kits.mechanics import TWO_PI, hit, sine

from impact_rig.physics import Motion, Simulation
from impact_rig.physics.linear import constants
from impact_rig.rig.config import RigConfig


def started(case: Case, o: Orbit, cycles: int, config: RigConfig) -> Motion:
    """Start just after the impact on the right wall and run whole cycles, one drive segment each."""
    simulation = Simulation(config)
    simulation.place(x_1=o.x, v_1=o.after, d=config.barriers.gap_m / 2.0, d_rate=-o.speed - o.after)
    drive = sine(o.omega / TWO_PI, o.base_m, TWO_PI / o.omega, cycles)
    drive["phase"] = o.drive_phase
    return simulation.advance(drive)


@pytest.mark.parametrize("case", [*STABLE, UNSTABLE])
def test_the_formula_yields_the_published_table(case):
    o = orbit(case)
    assert o.speed / (o.omega * NO_IMPACT_AMPLITUDE_M) == pytest.approx(case.speed, abs=6e-7)
    # and is an orbit: half a period later the mirror image arrives at the left wall
    half = np.array([math.pi / o.omega])
    assert o.structure(half)[0] == pytest.approx(-o.x, rel=1e-12)
    assert o.x + case.gap * NO_IMPACT_AMPLITUDE_M / 2.0 - o.speed * half[0] == pytest.approx(
        -o.x - case.gap * NO_IMPACT_AMPLITUDE_M / 2.0, rel=1e-12
    )


def test_a_force_on_the_structure_is_equivalent_to_a_base_motion():
    """The force row maps to a base whose k_1 x_b + c_1 v_b has the force's amplitude: X_s = |F| |H| / k_1."""
    case = STABLE[0]
    config, o = case.config(), orbit(case)
    c = constants(config)
    force = abs(c.k_1 + 1j * o.omega * c.c_1) * o.base_m
    response = abs(1.0 / (1.0 - case.r**2 + 2j * case.zeta * case.r))
    assert force / c.k_1 * response == pytest.approx(NO_IMPACT_AMPLITUDE_M, rel=1e-12)


@pytest.mark.parametrize("case", STABLE)
def test_instantaneous_impacts_stay_on_the_orbit(case):
    o, cycles = orbit(case), 300
    motion = started(case, o, cycles, case.config())
    impacts = motion.impacts
    assert len(impacts) == pytest.approx(2 * cycles, abs=1)
    assert list(impacts["wall"][:4]) == [-1, 1, -1, 1]
    assert np.abs(impacts["approach_speed"] / o.relative_speed - 1.0).max() <= 1e-9
    cycle = np.repeat(np.arange(cycles), 32)
    tau = np.tile(np.arange(32) / 32 * TWO_PI / o.omega, cycles)
    wanted = np.where(tau < math.pi / o.omega, o.structure(tau), -o.structure(tau - math.pi / o.omega))
    got = motion.quantity("x_1", cycle, tau)
    assert np.abs(got - wanted).max() <= 1e-9 * NO_IMPACT_AMPLITUDE_M
    half = TWO_PI / o.omega / 2.0
    times = impacts["tick"] * 2.0 * half + impacts["offset"]
    assert np.abs(times[:100] / half - np.arange(1, 101)).max() <= 1e-9


def test_the_motion_leaves_an_unstable_orbit():
    """Spectral radius 1.557 per half period: 1e-12 has grown a thousand million times after 50 of them."""
    o = orbit(UNSTABLE)
    motion = started(UNSTABLE, o, 600, UNSTABLE.config())
    assert np.abs(motion.impacts["approach_speed"][:4] / o.relative_speed - 1.0).max() <= 1e-9
    late = motion.impacts[motion.impacts["tick"] >= 300]
    assert len(late) / 300 == pytest.approx(2.5, abs=0.02), "it should settle at 2.5 impacts per cycle"


def test_the_orbit_of_a_compliant_contact_converges_as_it_stiffens():
    """Contact time falls as K^−0.4, and with it the distance to the orbit of the instantaneous law."""
    case = STABLE[2]
    o = orbit(case)
    factors, errors = np.array([1.0, 1e2, 1e4]), []
    for factor in factors:
        config = case.config(law="exact")
        with attrs.validators.disabled():  # no material is as stiff
            config = attrs.evolve(
                config,
                sphere=attrs.evolve(config.sphere, young_modulus_pa=210e9 * factor),
                barriers=attrs.evolve(config.barriers, young_modulus_pa=70e9 * factor),
            )
        late = started(case, o, 400, config).impacts[-2:]
        errors.append(abs(late["approach_speed"].mean() / o.relative_speed - 1.0))
    slope = np.polyfit(np.log(factors), np.log(errors), 1)[0]
    assert errors[0] < 3e-3
    assert slope == pytest.approx(-0.4, abs=0.03), errors
    assert hit(0.2, law="exact", restitution=case.e).restitution == pytest.approx(case.e, rel=1e-7)
