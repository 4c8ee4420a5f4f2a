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
"""A sphere pressed on a wall for part of the cycle: no stall, no crawl, one body with the base."""

from __future__ import annotations

import numpy as np
import pytest
from kits.mechanics import rig, sine

from impact_rig.physics import Motion, Simulation
from impact_rig.physics.contact import LAWS
from impact_rig.physics.model import CONTACT_RTOL
from impact_rig.rig.config import RigConfig

FREQUENCY_HZ, CYCLES = 9.1, 10
CYCLE_S = 1.0 / FREQUENCY_HZ
AMPLITUDES = {"prescribed": 60e-6, "current": 0.5, "voltage": 2.0}


def run(config: RigConfig, rtol: float = CONTACT_RTOL, cycles: int = CYCLES) -> Motion:
    """Return a motion from rest with the sphere on the left wall, which soon presses it."""
    drive = sine(FREQUENCY_HZ, AMPLITUDES[config.drive.kind], CYCLE_S, cycles)
    return Simulation(config, rtol=rtol).advance(drive)


def longest(motion: Motion) -> np.void:
    """The longest contact of the first cycle."""
    first = motion.impacts[motion.impacts["tick"] == 0]
    return first[first["duration"].argmax()]


def narrow(law: str, kind: str = "current") -> RigConfig:
    """A gap so small that the sphere comes to rest on the walls."""
    return rig(drive={"kind": kind}, contact={"law": law}, barriers={"gap_m": 1e-3})


@pytest.mark.parametrize("kind", AMPLITUDES)
@pytest.mark.parametrize("law", ["flores", "kelvin_voigt"])
def test_resting_does_not_depend_on_the_tolerance(law, kind):
    plain, tight = (run(narrow(law, kind), rtol) for rtol in (CONTACT_RTOL, 1e-4 * CONTACT_RTOL))
    assert len(plain.impacts) == len(tight.impacts)
    rest, same = (longest(motion) for motion in (plain, tight))
    assert rest["duration"] > 0.2 * CYCLE_S, "the sphere is not at rest, so the test proves nothing"
    assert rest["duration"] == pytest.approx(same["duration"], rel=1e-7)
    assert rest["impulse"] == pytest.approx(same["impulse"], rel=1e-8)
    during = np.zeros(50, int), rest["offset"] + np.linspace(0.1, 0.9, 50) * rest["duration"]
    for name, tolerance in {"x_1": 1e-7, "v_1": 1e-7, "x_2": 1e-7, "force_left": 1e-5}.items():
        got, wanted = (motion.quantity(name, *during) for motion in (plain, tight))
        assert np.abs(got - wanted).max() <= tolerance * np.abs(wanted).max(), name


@pytest.mark.parametrize("kind", AMPLITUDES)
def test_a_resting_sphere_and_the_base_move_as_one_body(kind):
    """The compliant contact against the rigid one, which carries the sphere in closed form until the force is gone."""
    soft, rigid = run(narrow("flores", kind)), run(narrow("restitution", kind))
    rest = longest(soft)["offset"] + longest(soft)["duration"]
    during = np.zeros(50, int), np.linspace(0.1, 0.9, 50) * rest
    x, one_body = (motion.quantity("x_1", *during) for motion in (soft, rigid))
    assert np.abs(x - one_body).max() <= 1e-4 * np.abs(one_body).max()
    force, pressing = (motion.quantity("force_left", *during) for motion in (soft, rigid))
    assert force.mean() == pytest.approx(pressing.mean(), rel=1e-2)  # it trembles at the contact's own frequency
    released = np.flatnonzero(
        rigid.quantity("force_left", np.zeros(10_000, int), np.arange(10_000) * CYCLE_S / 1e4) > 0
    )
    assert released[-1] * CYCLE_S / 1e4 == pytest.approx(rest, abs=1e-3 * CYCLE_S)


@pytest.mark.parametrize("e", [0.05, 0.35, 0.9])
@pytest.mark.parametrize("law", LAWS)
def test_chatter_is_simulated_in_bounded_time(law, e):
    config = rig(contact={"law": law, "restitution": e}, barriers={"gap_m": 1e-3})
    segment, _ = run(config, cycles=40).breakpoints()
    assert len(segment) / 40 < 3000, "steps per cycle"


def test_rests_and_impacts_alternate_on_both_walls():
    motion = run(narrow("flores"), cycles=100)
    begin = motion.impacts["tick"] * CYCLE_S + motion.impacts["offset"]
    assert (np.diff(begin) >= motion.impacts["duration"][:-1]).all()
    assert motion.impacts["duration"].sum() < 100 * CYCLE_S
    assert {int(wall) for wall in motion.impacts["wall"]} == {-1, 1}
