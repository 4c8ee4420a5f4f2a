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
"""Steady motions with two symmetric impacts per cycle, known in closed form (Masri & Caughey 1966, with damping).

μ = m/m_1 is the ratio of sphere to structure. At the impact on the right wall (τ = 0) the sphere turns from +V to −V.
"""

from __future__ import annotations

import cmath
import math

import attrs
import numpy as np
from kits.mechanics import TWO_PI, prescribed, sphere_kg

from impact_rig.rig.config import RigConfig

FREQUENCY_HZ = 9.105
NO_IMPACT_AMPLITUDE_M = 2e-3  # X_s of all cases
MASS_KG = sphere_kg()


@attrs.frozen
class Case:
    """Row of the table: μ, ζ, e, g/X_s, r and the drive; then V/(ω X_s) to six digits, and the spectral radius."""

    mu: float
    zeta: float
    e: float
    gap: float
    r: float
    drive: str
    speed: float
    radius: float
    """Spectral radius of the half period."""

    def config(self, **contact: object) -> RigConfig:
        return prescribed(
            structure={"mass_kg": MASS_KG / self.mu, "damping_ratio": self.zeta, "natural_frequency_hz": FREQUENCY_HZ},
            barriers={"gap_m": self.gap * NO_IMPACT_AMPLITUDE_M},
            contact={"law": "restitution", "restitution": self.e} | contact,
        )


STABLE = (
    Case(0.1, 0.05, 0.8, 1.5, 1.0, "force", 0.674555, 0.862),
    Case(0.05, 0.02, 0.35, 2.0, 1.02, "base", 0.638703, 0.856),
    Case(0.01, 0.02, 0.35, 4.0, 1.0, "base", 1.241306, 0.901),
)
UNSTABLE = Case(0.003, 0.001, 0.35, 0.6, 1.0, "base", 0.395677, 1.557)


@attrs.frozen
class Orbit:
    """Closed form of an orbit: sphere speed V, structure and drive phase at the impact, and x(τ) for half a period."""

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
    widest_gap_m: float
    """Beyond it there is no such motion."""

    def structure(self, tau: np.ndarray) -> np.ndarray:
        """Return x(τ), 0 <= τ <= π/ω."""
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
        widest_gap_m=2.0 * x_s * math.sqrt(1.0 + (q / p) ** 2),
    )
