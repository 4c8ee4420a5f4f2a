# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Steady motions with two symmetric impacts per cycle, known in closed form (Masri & Caughey 1966, with damping).

μ = m/m_1 is the ratio of sphere to structure. At the impact on the right wall (τ = 0) the sphere turns from +V to −V.
"""

from __future__ import annotations

import cmath
import math

import attrs
import numpy as np
import pytest
from kits.mechanics import TWO_PI, hit, prescribed, sine, sphere_kg

from impact_rig.physics import Motion, Simulation
from impact_rig.physics.linear import constants
from impact_rig.rig.config import RigConfig

FREQUENCY_HZ = 9.105
NO_IMPACT_AMPLITUDE_M = 2e-3  # X_s of all cases
MASS_KG = sphere_kg()


@attrs.frozen
class Case:
    """A row of the table: μ, ζ, e, g/X_s, r and what drives; then V/(ω X_s) to six digits."""

    mu: float
    zeta: float
    e: float
    gap: float
    r: float
    drive: str
    speed: float

    def config(self, **contact: object) -> RigConfig:
        return prescribed(
            structure={
                "mass_kg": MASS_KG / self.mu,
                "damping_ratio": self.zeta,
                "natural_frequency_hz": FREQUENCY_HZ,
            },
            barriers={"gap_m": self.gap * NO_IMPACT_AMPLITUDE_M},
            contact={"law": "restitution", "restitution": self.e} | contact,
        )


STABLE = (
    Case(0.1, 0.05, 0.8, 1.5, 1.0, "force", 0.674555),
    Case(0.05, 0.02, 0.35, 2.0, 1.02, "base", 0.638703),
    Case(0.01, 0.02, 0.35, 4.0, 1.0, "base", 1.241306),
)
UNSTABLE = Case(0.003, 0.001, 0.35, 0.6, 1.0, "base", 0.395677)


@attrs.frozen
class Orbit:
    """The closed form: sphere speed V, structure and drive phase at the impact, and x(τ) for half a period."""

    omega: float
    speed: float
    x: float
    before: float  # structure's velocity just before and just after the impact
    after: float
    drive_phase: float
    base_m: float
    relative_speed: float
    coefficients: tuple[float, float, float, float]
    decay: float
    omega_d: float

    def structure(self, tau: np.ndarray) -> np.ndarray:
        """x(τ), 0 <= τ <= π/ω."""
        a, b, p, q = self.coefficients
        free = np.exp(-self.decay * tau) * (a * np.cos(self.omega_d * tau) + b * np.sin(self.omega_d * tau))
        return free + p * np.sin(self.omega * tau) + q * np.cos(self.omega * tau)


def orbit(case: Case, e: float | None = None) -> Orbit:
    """Solve the periodicity conditions for a case."""
    e = case.e if e is None else e
    mu, zeta, r = case.mu, case.zeta, case.r
    omega_n = TWO_PI * FREQUENCY_HZ
    omega, omega_d = r * omega_n, omega_n * math.sqrt(1.0 - zeta**2)
    g, x_s = case.gap * NO_IMPACT_AMPLITUDE_M, NO_IMPACT_AMPLITUDE_M
    decay = zeta * omega_n
    big_e = math.exp(-decay * math.pi / omega)
    big_c, big_s = math.cos(omega_d * math.pi / omega), math.sin(omega_d * math.pi / omega)
    big_d = 1.0 + 2.0 * big_e * big_c + big_e**2
    a = -2.0 * mu * big_e * big_s / (omega_d * big_d)
    b = 2.0 * mu * (1.0 + big_e * big_c) / (omega_d * big_d)
    s_plus = -(1.0 - e - 2.0 * mu * e) / (1.0 + e)
    s_minus = -(1.0 - e + 2.0 * mu) / (1.0 + e)
    p = (s_plus + decay * a - omega_d * b) / omega
    q = math.pi / (2.0 * omega) - a
    square = p * p + q * q
    v = (q * g + math.sqrt(4.0 * square * x_s**2 - p * p * g * g)) / (2.0 * square)
    response = 1.0 / (1.0 - r * r + 2j * zeta * r)
    to_base = (1.0 + 2j * zeta * r) * response  # the base's motion whose column force drives the structure alike
    return Orbit(
        omega=omega,
        speed=v,
        x=a * v + q * v - g / 2.0,
        before=s_minus * v,
        after=s_plus * v,
        drive_phase=math.atan2(q * v - g / 2.0, p * v) - cmath.phase(to_base),
        base_m=x_s / abs(to_base),
        relative_speed=2.0 * v * (1.0 + mu) / (1.0 + e),
        coefficients=(a * v, b * v, p * v, q * v - g / 2.0),
        decay=decay,
        omega_d=omega_d,
    )


def started(case: Case, o: Orbit, cycles: int, config: RigConfig) -> Motion:
    """Start just after the impact on the right wall and run whole cycles, one drive segment each."""
    simulation = Simulation(config)
    simulation.place(x_1=o.x, v_1=o.after, d=config.barriers.gap_m / 2.0, d_rate=-o.speed - o.after)
    drive = sine(o.omega / TWO_PI, o.base_m, TWO_PI / o.omega, cycles)
    drive["phase"] = o.drive_phase
    return simulation.advance(drive)


@pytest.mark.parametrize("case", [*STABLE, UNSTABLE])
def test_the_formula_gives_the_published_table(case):
    o = orbit(case)
    assert o.speed / (o.omega * NO_IMPACT_AMPLITUDE_M) == pytest.approx(case.speed, abs=6e-7)
    # and is an orbit: half a period later the mirror image arrives at the left wall
    half = np.array([math.pi / o.omega])
    assert o.structure(half)[0] == pytest.approx(-o.x, rel=1e-12)
    assert o.x + case.gap * NO_IMPACT_AMPLITUDE_M / 2.0 - o.speed * half[0] == pytest.approx(
        -o.x - case.gap * NO_IMPACT_AMPLITUDE_M / 2.0, rel=1e-12
    )


def test_a_force_on_the_structure_is_a_base_motion():
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
    times = impacts["segment"] * 2.0 * half + impacts["offset"]
    assert np.abs(times[:100] / half - np.arange(1, 101)).max() <= 1e-9


def test_the_unstable_orbit_is_left():
    """Spectral radius 1.557 per half period: 1e-12 has grown a thousand million times after 50 of them."""
    o = orbit(UNSTABLE)
    motion = started(UNSTABLE, o, 600, UNSTABLE.config())
    assert np.abs(motion.impacts["approach_speed"][:4] / o.relative_speed - 1.0).max() <= 1e-9
    late = motion.impacts[motion.impacts["segment"] >= 300]
    assert len(late) / 300 == pytest.approx(2.5, abs=0.02), "it should settle at 2.5 impacts per cycle"


def test_a_compliant_contact_converges_to_the_orbit_as_it_stiffens():
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
