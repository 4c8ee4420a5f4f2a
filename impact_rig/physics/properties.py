# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Material and geometry to the constants of the equations: sphere mass, Hertz stiffness, effective mass."""

from __future__ import annotations

import math

from impact_rig.arithmetic.scalars import PI
from impact_rig.config import Barriers, Sphere


def sphere_mass_kg(sphere: Sphere) -> float:
    """Return m = ρ π d³ / 6 [kg]."""
    return sphere.density_kg_m3 * PI * (sphere.diameter_m * sphere.diameter_m * sphere.diameter_m) / 6.0


def hertz_stiffness_n_m32(sphere: Sphere, barriers: Barriers) -> float:
    """Return K of F = K δ^(3/2) for a sphere on a plane [N/m^1.5].

    K = 4 sqrt(R) / {3 [(1 − ν₁²)/E₁ + (1 − ν₂²)/E₂]}: the paper's Eq. (4), Goldsmith (1960).
    """
    compliance = _compliance(sphere.poisson_ratio, sphere.young_modulus_pa) + _compliance(
        barriers.poisson_ratio, barriers.young_modulus_pa
    )
    return 4.0 * math.sqrt(sphere.diameter_m / 2.0) / (3.0 * compliance)


def _compliance(poisson_ratio: float, young_modulus_pa: float) -> float:
    return (1.0 - poisson_ratio * poisson_ratio) / young_modulus_pa


def effective_mass_kg(first_kg: float, second_kg: float) -> float:
    """Return the mass that the relative motion of two free bodies sees, m₁ m₂ / (m₁ + m₂) [kg]."""
    return first_kg * second_kg / (first_kg + second_kg)
