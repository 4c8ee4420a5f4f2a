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
"""Every contact law in a real contact, against closed forms and published numbers.

A law that enters the registry joins the parametrised tests by itself.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kits.mechanics import OF_HYSTERETIC_FORM, gauss, hit, of, sphere_kg, stiffness
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar
from scipy.special import gamma

from impact_rig.errors import ConfigError
from impact_rig.physics import contact, outcome
from impact_rig.physics.contact import LAWS, Contact, ContactPair, from_config, hunt_crossley
from impact_rig.physics.contact.law import LEAST_RESTITUTION, compiled_force
from impact_rig.physics.model import unit_parameters
from impact_rig.rig.config import RigConfig

RESTITUTIONS = (LEAST_RESTITUTION, 0.05, 0.2, 0.35, 0.6, 0.8, 0.95)
TOLERANCE = 1e-6
TOLERANCE_ENERGY = 1e-8  # of the energy before; the integrator's default gives 3e-9
MACHINERY = {"__init__", "law"}
HERTZ_DURATION = 2.0 * math.sqrt(math.pi) * gamma(1.4) / gamma(0.9)  # in units of δ_max / v


def closed_form(factor: float) -> float:
    """e of ln[(1 + a)/(1 − a e)] = a (1 + e) from a bracket in q = −ln(1 − a e), not by the package's Lambert W."""
    if factor == 0.0:
        return 1.0
    low, high = 0.5 * factor / (1.0 + factor), factor + 1.0
    q = brentq(lambda q: math.log1p(factor) + q - factor + math.expm1(-q), low, high, rtol=1e-14)
    return -math.expm1(-q) / factor


def test_every_law_of_the_folder_is_found():
    files = {path.stem for path in Path(contact.__file__).parent.glob("*.py")}
    assert {law.__module__.rpartition(".")[2] for law in LAWS.values()} == files - MACHINERY
    assert list(LAWS) == sorted(LAWS)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_a_law_states_formula_and_source_and_has_only_fields_of_its_section(law):
    assert law.formula
    assert "|" not in law.formula
    assert law.source
    names = {attribute.name for attribute in attrs.fields(Contact)}
    assert {attribute.name for attribute in attrs.fields(law)} <= names, "a law's fields are those of the section"


@pytest.mark.parametrize("e", RESTITUTIONS)
@pytest.mark.parametrize("law", LAWS)
def test_a_contact_has_the_restitution_that_its_law_predicts(law, e):
    realised = from_config(Contact(law=law, restitution=e)).realised_restitution()
    assert hit(0.3, law=law, restitution=e).restitution == pytest.approx(realised, rel=TOLERANCE)


@pytest.mark.parametrize("e", RESTITUTIONS)
@pytest.mark.parametrize("law", OF_HYSTERETIC_FORM)
def test_hysteretic_laws_obey_the_closed_form(law, e):
    factor = LAWS[law](e).hysteresis_factor()
    assert hit(1.0, law=law, restitution=e).restitution == pytest.approx(closed_form(factor), rel=TOLERANCE)


@pytest.mark.parametrize("law", LAWS)
def test_published_restitutions_for_a_nominal_035_are_reproduced(law):
    assert hit(0.5, law=law, restitution=0.35).restitution == pytest.approx(LAWS[law].returns, abs=5e-4)


def test_the_nominal_restitution_for_a_real_035_with_flores_is_known():
    assert hit(0.5, law="flores", restitution=0.38803).restitution == pytest.approx(0.35, abs=5e-6)
    assert hunt_crossley.factor_returning(0.35) == pytest.approx(2.52338, abs=5e-6)


@pytest.mark.parametrize("e", [LEAST_RESTITUTION, 0.35, 0.99])
@pytest.mark.parametrize("law", [law for law in OF_HYSTERETIC_FORM if law != "hertz"])
def test_exact_calibration_yields_the_requested_restitution(law, e):
    got = hit(0.2, law=law, restitution=e, calibration="exact")
    assert got.restitution == pytest.approx(e, rel=TOLERANCE)


@pytest.mark.parametrize("speed", [1e-3, 0.05, 0.5, 20.0])
@pytest.mark.parametrize("structure_kg", [1e9, 0.13, 1e-3])
def test_restitution_does_not_depend_on_speed_or_masses(speed, structure_kg):
    got = hit(speed, structure_kg=structure_kg, law="flores", speed_floor_m_s=1e-9)
    assert got.restitution == pytest.approx(closed_form(8 * 0.65 / (5 * 0.35)), rel=TOLERANCE)


@pytest.mark.parametrize("speed", [0.01, 0.5, 5.0])
@pytest.mark.parametrize("structure_kg", [1e9, 2e-3])
def test_indentation_duration_and_impulse_of_hertz_are_the_closed_forms(speed, structure_kg):
    got = hit(speed, structure_kg=structure_kg, law="hertz")
    mass = sphere_kg() * structure_kg / (sphere_kg() + structure_kg)
    deepest = (1.25 * mass * speed**2 / stiffness()) ** 0.4
    assert got.peak_indentation == pytest.approx(deepest, rel=TOLERANCE)
    assert got.peak_force == pytest.approx(stiffness() * deepest**1.5, rel=TOLERANCE)
    assert got.duration == pytest.approx(HERTZ_DURATION * deepest / speed, rel=TOLERANCE)
    assert got.impulse == pytest.approx(2.0 * mass * speed, rel=TOLERANCE)
    assert got.energy_lost == pytest.approx(0.0, abs=1e-12 * mass * speed**2)


def hysteretic_contact(factor: float, speed: float, mass: float, k: float) -> tuple[float, float, float]:
    """Duration, greatest indentation and greatest force on a fixed wall, from the phase plane.

    With r = δ'/v0 the motion obeys δ^(5/2) = (5 m v0²/2K) G(r), G = (1 − r)/a − ln[(1 + a)/(1 + a r)]/a².
    """
    returned = closed_form(factor)

    def depth(r: float) -> float:
        g = (1.0 - r) / factor - math.log((1.0 + factor) / (1.0 + factor * r)) / factor**2
        return (2.5 * mass * speed**2 / k * max(g, 0.0)) ** 0.4

    def force(r: float) -> float:
        return k * depth(r) ** 1.5 * (1.0 + factor * r)

    def pace(root: float, end: float, sign: float) -> float:
        """dt/du on the way from an end of the contact, with r = end ± u^(5/2): smooth in u."""
        r = end + sign * root**2.5
        return 2.5 * root**1.5 * mass * speed / k / ((1.0 + factor * r) * depth(r) ** 1.5)

    inward = quad(pace, 0.0, 1.0, args=(1.0, -1.0), epsabs=0.0, epsrel=1e-10)[0]
    outward = quad(pace, 0.0, returned**0.4, args=(-returned, 1.0), epsabs=0.0, epsrel=1e-10)[0]
    strongest = minimize_scalar(lambda r: -force(r), bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-9})
    return inward + outward, depth(0.0), -strongest.fun


@pytest.mark.parametrize("speed", [0.05, 0.5, 1.0])
@pytest.mark.parametrize("law", ["flores", "lee_wang", "exact"])
def test_duration_indentation_and_force_of_hysteretic_laws_agree_with_the_phase_plane(law, speed):
    got = hit(speed, law=law, restitution=0.35)
    duration, indentation, force = hysteretic_contact(
        LAWS[law](0.35).hysteresis_factor(), speed, sphere_kg(), stiffness()
    )
    assert got.duration == pytest.approx(duration, rel=TOLERANCE)
    assert got.peak_indentation == pytest.approx(indentation, rel=TOLERANCE)
    assert got.peak_force == pytest.approx(force, rel=TOLERANCE)


def test_peak_forces_of_flores_agree_with_an_independent_program():
    """It printed 138.9 N at 1 m/s, but as the force grows with v^1.2 its own 60.5 N at 0.5 m/s makes that 139.0 N."""
    factor = LAWS["flores"](0.35).hysteresis_factor()
    slow, fast = (hysteretic_contact(factor, speed, 1.0524e-3, 4.403e9) for speed in (0.5, 1.0))
    assert slow == pytest.approx((42.1e-6, 3.73e-6, 60.5), rel=2e-3)
    assert fast == pytest.approx((36.7e-6, 6.50e-6, 139.0), rel=2e-3)
    assert fast[2] / slow[2] == pytest.approx(2.0**1.2, rel=1e-9)


@pytest.mark.parametrize("e", RESTITUTIONS)
def test_kelvin_voigt_released_at_zero_indentation_is_the_closed_form(e):
    """Nagurka and Huang: the contact lasts t_c and returns e; both exactly."""
    got = hit(0.5, law="kelvin_voigt", restitution=e, contact_time_s=60e-6)
    assert got.restitution == pytest.approx(e, rel=TOLERANCE)
    assert got.duration == pytest.approx(60e-6, rel=TOLERANCE)
    rate, omega = -math.log(e) / 60e-6, math.pi / 60e-6
    peak = math.atan2(omega, rate) / omega
    assert got.peak_indentation == pytest.approx(
        0.5 / omega * math.exp(-rate * peak) * math.sin(omega * peak), rel=TOLERANCE
    )


def test_kelvin_voigt_released_at_zero_force_has_a_larger_restitution():
    got = hit(0.5, law="kelvin_voigt", restitution=0.35, release="force")
    assert got.restitution == pytest.approx(0.434, abs=5e-4)
    assert from_config(Contact(law="kelvin_voigt", release="force")).realised_restitution() == pytest.approx(
        got.restitution, rel=TOLERANCE
    )


def test_an_instantaneous_contact_takes_no_time_and_conserves_momentum():
    got = hit(0.5, structure_kg=1e-3, law="restitution", restitution=0.35)
    mass = sphere_kg() * 1e-3 / (sphere_kg() + 1e-3)
    assert (got.duration, got.peak_indentation) == (0.0, 0.0)
    assert got.restitution == pytest.approx(0.35, rel=1e-14)
    assert got.impulse == pytest.approx(1.35 * mass * 0.5, rel=1e-14)
    assert got.energy_lost == pytest.approx(0.5 * mass * 0.25 * (1.0 - 0.35**2), rel=1e-14)


@pytest.mark.parametrize("e", [0.05, 0.35, 0.95])
@pytest.mark.parametrize("law", [law for law in LAWS if law != "restitution"])
def test_contact_forces_never_pull_and_integrate_to_impulse_and_loss(law, e):
    got = hit(0.5, law=law, restitution=e, release="force")
    t = got.begin_s + np.linspace(0.0, 1.0, 20001)[1:-1] * got.duration
    force = of(got.motion, "force_right", t)
    assert force.min() >= 0.0, f"{law} pulls with {-force.min():g} N"
    assert not of(got.motion, "force_left", t).any()
    assert force.max() == pytest.approx(got.peak_force, rel=1e-3 if law == "kelvin_voigt" else 1e-6)  # grid of samples
    assert force.max() <= got.peak_force * (1.0 + 1e-8)
    # between breakpoints everything is smooth
    _, knots = got.motion.breakpoints()
    knots = np.unique(knots[(knots >= got.begin_s) & (knots <= got.begin_s + got.duration * (1 + 1e-12))])
    t, weight = (grid.ravel() for grid in gauss(knots[:-1], knots[1:]))
    force = of(got.motion, "force_right", t)
    speed = of(got.motion, "v_2", t) - of(got.motion, "v_1", t)
    assert (weight * force).sum() == pytest.approx(got.impulse, rel=1e-6)
    assert (weight * force * speed).sum() == pytest.approx(got.energy_lost, rel=1e-5, abs=1e-8 * sphere_kg())


@pytest.mark.parametrize("e", [0.05, 0.35, 0.95])
@pytest.mark.parametrize("law", LAWS)
def test_the_energy_lost_follows_from_the_speeds(law, e):
    got = hit(0.5, structure_kg=3e-3, law=law, restitution=e)
    mass = sphere_kg() * 3e-3 / (sphere_kg() + 3e-3)
    before, after = (0.5 * mass * speed**2 for speed in (got.approach_speed, got.separation_speed))
    assert got.energy_lost == pytest.approx(before - after, abs=TOLERANCE_ENERGY * before)
    assert got.impulse == pytest.approx(mass * (got.approach_speed + got.separation_speed), rel=1e-8)


@pytest.mark.heavy
@given(st.floats(0.0, 1e4))
def test_the_realised_restitution_solves_its_equation(factor):
    e = hunt_crossley.realised(factor)
    assert 0.0 < e <= 1.0
    if factor > 1e-3:
        assert e == pytest.approx(closed_form(factor), rel=1e-9)
    else:  # where the reference loses its own digits
        assert e == pytest.approx(1.0 - 2.0 * factor / 3.0, abs=max(factor**2, 1e-15))  # no closer than doubles are


@pytest.mark.heavy
@given(st.floats(1e-4, 1.0))
def test_damping_factor_and_restitution_are_inverse_functions(e):
    assert hunt_crossley.realised(hunt_crossley.factor_returning(e)) == pytest.approx(e, rel=1e-9)


@pytest.mark.parametrize("wrong", [0.0, 0.0099, -0.1, 1.0001, math.nan])
@pytest.mark.parametrize("law", LAWS)
def test_a_law_rejects_an_impossible_restitution(law, wrong):
    with pytest.raises(ConfigError, match=rf"restitution must be >= 0.01 and <= 1, got {wrong}"):
        LAWS[law](wrong)


def test_the_speed_at_which_a_barrier_yields_is_the_documented_one():
    """Hertz, as in docs/explanation/limits.md: p = (2/π) E* √(δ/R), K = 4/3 E* √R, δ elastic; p ~ v^(2/5)."""
    text = (Path(__file__).parents[3] / "docs" / "explanation" / "limits.md").read_text(encoding="utf-8")
    stated = r"put ([\d.]+) GPa .*?yield stress\s+([\d.]+) GPa\).*?reached at ([\d.]+) m/s"
    pressure_gpa, yield_gpa, speed = map(float, re.search(stated, text, re.DOTALL).groups())
    radius, k, mass = RigConfig().sphere.diameter_m / 2.0, stiffness(), sphere_kg()
    indentation = (5.0 * mass / (4.0 * k)) ** 0.4
    pressure = 2.0 / math.pi * 0.75 * k / math.sqrt(radius) * math.sqrt(indentation / radius)
    assert pressure_gpa == pytest.approx(pressure / 1e9, abs=0.05)
    assert speed == pytest.approx((1.6 * yield_gpa * 1e9 / pressure) ** 2.5, abs=0.0006)


def test_a_contact_does_not_depend_on_the_previous_one():
    """Each contact must use the pull of its own columns, not that of the previous contact."""
    force = from_config(RigConfig().contact).force(ContactPair(1.0, 1.0))
    contacts = outcome.Contacts(unit_parameters(force), compiled_force(force.function))
    before = contacts.rebound_squared(0.05)
    contacts.derivatives(0.05, 3)
    assert contacts.rebound_squared(0.05) == before
