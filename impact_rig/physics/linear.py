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
"""Linear part of the rig: the constants of the equations of motion from a configuration, and the linear systems' modes.

    y' = M y + b_0 u + b_1 u',   y = (x_1, v_1[, x_b, v_b[, i]]),   u = coil current, base displacement or coil voltage

Superior base (x_1, v_1), inferior base (x_b, v_b) and coil current i form the state y. A prescribed base is not part of
y, and i is part of y only with a voltage drive. In modal form y(t) = Re Σ_n Φ_n C_n exp(λ_n t) + y_p(t), with C_n = Γ_n
· (y − y_p) at t = 0. y_p is the particular solution for the drive. There are two such systems: with the sphere loose
(mass m_1) and with the sphere attached to the superior base (mass m_1 + m).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import PI, TWO_PI
from impact_rig.arithmetic.precise import (
    ONE,
    TWO,
    Complex,
    Matrix,
    dot,
    evaluate,
    evaluate_with_slope,
    modulus,
    resolvent,
    roots,
    with_70_digits,
)
from impact_rig.config.sections import Barriers, Drive, Shaker, Sphere, Structure
from impact_rig.errors import ConfigError
from impact_rig.physics.contact import Contact
from impact_rig.physics.state import COIL, V1, VB, X1, XB


class MechanicsSetup(Protocol):
    """Interface of a configuration for which the mechanics can be simulated.

    Its properties are those sections of `RigConfig` that the mechanics need.
    """

    @property
    def structure(self) -> Structure:
        """Section `structure` of the configuration: columns and superior base."""

    @property
    def shaker(self) -> Shaker:
        """Section `shaker` of the configuration: suspension, coil, and masses of moving element and inferior base."""

    @property
    def drive(self) -> Drive:
        """Section `drive` of the configuration: kind and waveform of the drive."""

    @property
    def sphere(self) -> Sphere:
        """Section `sphere` of the configuration: the loose sphere."""

    @property
    def barriers(self) -> Barriers:
        """Section `barriers` of the configuration: the two walls and the gap, the sphere's free path between them."""

    @property
    def contact(self) -> Contact:
        """Section `contact` of the configuration: contact law and its settings."""


def sphere_mass_kg(sphere: Sphere) -> float:
    """Return the mass of the sphere, m = ρ π d³ / 6 [kg], from its density ρ and diameter d."""
    return sphere.density_kg_m3 * PI * (sphere.diameter_m * sphere.diameter_m * sphere.diameter_m) / 6.0


def hertz_stiffness_n_m32(sphere: Sphere, barriers: Barriers) -> float:
    """Return the Hertz stiffness K of F = K δ^(3/2) for the sphere on a plane barrier [N/m^1.5].

    K = 4 sqrt(R) / {3 [(1 − ν₁²)/E₁ + (1 − ν₂²)/E₂]} with the sphere's radius R, Poisson's ratios ν and Young's moduli
    E: the paper's Eq. (4), Goldsmith (1960).
    """
    compliance = _compliance(sphere.poisson_ratio, sphere.young_modulus_pa) + _compliance(
        barriers.poisson_ratio, barriers.young_modulus_pa
    )
    return 4.0 * math.sqrt(sphere.diameter_m / 2.0) / (3.0 * compliance)


def _compliance(poisson_ratio: float, young_modulus_pa: float) -> float:
    return (1.0 - poisson_ratio * poisson_ratio) / young_modulus_pa


def effective_mass_kg(first_kg: float, second_kg: float) -> float:
    """Return m₁ m₂ / (m₁ + m₂) [kg], the effective mass of the relative motion of two free bodies."""
    return first_kg * second_kg / (first_kg + second_kg)


_WORST_CONDITION = Decimal("1e7")  # how much larger than the motion its modal parts may be
_GOOD_SIZE = Decimal("0.1")  # of the largest entry of a residue
_DETUNING = 1e-9  # relative nudge of the damping that separates two coinciding eigenvalues


class Constants(NamedTuple):
    """Constants of the structure and the shaker as the equations of motion use them, SI.

    The index 1 marks the superior base on its columns. `m_base` is the mass of moving element and inferior base, and
    c_f and k_f are the damping and stiffness of its suspension. `force_factor`, `resistance` and `inductance` belong to
    the coil.
    """

    m_1: float
    c_1: float
    k_1: float
    m_base: float
    c_f: float
    k_f: float
    force_factor: float
    resistance: float
    inductance: float


class Modes(NamedTuple):
    """Modes of y' = M y with n states: k rates λ [1/s], and their right and left vectors.

    `rate` has the shape (k,), `right` and `left` have the shape (k, n). One mode of a complex conjugate pair is kept,
    with its right vector doubled, so that the real part of the sum over the modes is y. Each left vector is 1 at one
    entry of the state, so the modal coordinate has the unit of that entry.
    """

    rate: NDArray[np.complex128]
    right: NDArray[np.complex128]
    left: NDArray[np.complex128]


def constants(config: MechanicsSetup) -> Constants:
    """Return the constants of the equations of motion from a configuration, with k_1 = m_1 ω_n², c_1 = 2 ζ m_1 ω_n."""
    structure, shaker = config.structure, config.shaker
    omega_n = TWO_PI * structure.natural_frequency_hz
    return Constants(
        m_1=structure.mass_kg,
        c_1=2.0 * structure.damping_ratio * structure.mass_kg * omega_n,
        k_1=structure.mass_kg * (omega_n * omega_n),
        m_base=shaker.armature_mass_kg + shaker.base_mass_kg,
        c_f=shaker.damping_n_s_m,
        k_f=shaker.suspension_stiffness_n_m,
        force_factor=shaker.force_factor_n_a,
        resistance=shaker.coil_resistance_ohm,
        inductance=shaker.coil_inductance_h,
    )


_STATES = {"prescribed": 2, "current": 4, "voltage": 5}  # number of entries of y by kind of drive


def state_matrix(c: Constants, kind: str, mass: float) -> NDArray[np.float64]:
    """Return M of y' = M y + b_0 u + b_1 u', shape (n, n), for a superior base of `mass` [kg] under the drive `kind`.

    n is 2 for a prescribed base, 4 for a current drive and 5 for a voltage drive.
    """
    n = _STATES[kind]
    matrix = np.zeros((n, n))
    matrix[X1, V1] = 1.0
    matrix[V1, :2] = -c.k_1 / mass, -c.c_1 / mass
    if n > 2:
        matrix[V1, XB : VB + 1] = c.k_1 / mass, c.c_1 / mass
        matrix[XB, VB] = 1.0
        matrix[VB, :4] = c.k_1 / c.m_base, c.c_1 / c.m_base, -(c.k_f + c.k_1) / c.m_base, -(c.c_f + c.c_1) / c.m_base
    if n > 4:
        matrix[VB, COIL] = c.force_factor / c.m_base
        matrix[COIL, VB] = -c.force_factor / c.inductance
        matrix[COIL, COIL] = -c.resistance / c.inductance
    return matrix


def input_vectors(c: Constants, kind: str, mass: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return b_0 and b_1 of y' = M y + b_0 u + b_1 u', shape (n,), for a superior base of `mass` [kg].

    They are the factors with which the drive u of this kind, and its rate u', enter the equations of motion.
    """
    b_0, b_1 = np.zeros((2, _STATES[kind]))
    if kind == "prescribed":
        b_0[V1], b_1[V1] = c.k_1 / mass, c.c_1 / mass
    elif kind == "current":
        b_0[VB] = c.force_factor / c.m_base
    else:
        b_0[COIL] = 1.0 / c.inductance
    return b_0, b_1


def modes(matrix: NDArray[np.float64]) -> Modes:
    """Return the modes of a real matrix M, real modes first, then one mode of each conjugate pair.

    The modes are computed with 70 digits and rounded once. A matrix with coinciding eigenvalues (critical damping) has
    no complete set of modes. Its diagonal, which holds the dampings, is then changed by one or two parts in 1e9.
    Method: (s I − M)⁻¹ = adj(s I − M) / p(s) has the residue right · left, a matrix of rank one, at each root of its
    characteristic polynomial p.

    Raises:
        ConfigError: the matrix is not finite, or has no usable modes because masses or stiffnesses are too far apart.
    """
    if not np.all(np.isfinite(matrix)):
        raise ConfigError(
            "structure and shaker have no modes, because a mass, stiffness or damping is too large or too small: "
            "correct the values in the sections structure, shaker and sphere"
        )
    for attempt in range(3):
        nudged = matrix.copy()
        for i in range(len(nudged)):
            nudged[i, i] *= 1.0 + attempt * _DETUNING
        found = _refined(nudged)
        if found is not None:
            return found
    raise ConfigError(
        "structure and shaker have no separable modes, because masses, stiffnesses or dampings are too far apart: "
        "correct the values in the sections structure, shaker and sphere"
    )


def static_answer(matrix: NDArray[np.float64], load: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the state −M⁻¹ load in which y' = M y + load is at rest, shape (n,), computed with 70 digits.

    Raises:
        ConfigError: no such state exists.
    """
    answer = _rest(matrix, load)
    if answer is None or not np.all(np.isfinite(answer)):
        raise ConfigError(
            "structure and shaker have no position of rest, because a stiffness or mass is too large or too small: "
            "correct the values in the sections structure, shaker and sphere"
        )
    return answer


@with_70_digits
def _rest(matrix: NDArray[np.float64], load: NDArray[np.float64]) -> NDArray[np.float64] | None:
    polynomial, adjugate = resolvent(_exactly(matrix))
    if not polynomial[0]:
        return None
    loads = [Decimal(float(value)) for value in load]
    return np.array([float(dot(row, loads) / polynomial[0]) for row in adjugate[0]])


@with_70_digits
def _refined(matrix: NDArray[np.float64]) -> Modes | None:
    """Return the modes of a real matrix, computed with 70 digits, or None if they cannot be separated.

    They cannot be separated if two eigenvalues coincide or are not found. The result is also None if a motion would be
    the sum of modes that nearly cancel, each more than `_WORST_CONDITION` times as large as the motion.
    """
    polynomial, adjugate = resolvent(_exactly(matrix))
    scale = _balance(matrix)
    start = np.linalg.eigvals(matrix * scale[np.newaxis, :] / scale[:, np.newaxis])  # the scaling keeps the roots
    rates = roots(polynomial, [complex(value) for value in start])
    if rates is None:
        return None
    scales = [Decimal(float(value)) for value in scale]
    right, left = [], []
    for rate in rates:
        _, slope = evaluate_with_slope(polynomial, rate)
        if not slope.square():
            return None
        residue = _residue(adjugate, rate, slope)
        size = [[scales[j] / scales[i] * modulus(z) for j, z in enumerate(row)] for i, row in enumerate(residue)]
        largest = max(max(row) for row in size)
        if not largest < _WORST_CONDITION:
            return None
        # the first entry of a sufficient size, so that no last digit decides between two equal entries
        i, j = next((i, j) for i, row in enumerate(size) for j, value in enumerate(row) if value > _GOOD_SIZE * largest)
        weight = Complex(TWO if rate.imag else ONE)
        right.append([complex(weight * row[j]) for row in residue])
        left.append([complex(z / residue[i][j]) for z in residue[i]])
    return Modes(np.array([complex(rate) for rate in rates]), np.array(right), np.array(left))


def _residue(adjugate: Sequence[Matrix], rate: Complex, slope: Complex) -> list[list[Complex]]:
    """Return adj(s I − M) / p'(s), the residue of (s I − M)⁻¹ at a root s = `rate` of p; `slope` is p'(s).

    `adjugate` holds the matrices of adj(s I − M) by power of s, the constant one first.
    """
    n = len(adjugate)
    per_slope = Complex(ONE) / slope
    return [[evaluate([power[i][j] for power in adjugate], rate) * per_slope for j in range(n)] for i in range(n)]


def _balance(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a unit for each entry of the state y, shape (n,), in which displacements and speeds are of similar size.

    The unit of a displacement is 1/ω [m], with ω² the stiffness of the columns over the mass on them. All other units
    are 1. Without these units the approximate eigenvalues would be inexact, because the time scales of the rig differ
    by decades.
    """
    scale = np.ones(len(matrix))
    scale[[X1, XB] if len(matrix) > 2 else [X1]] = 1.0 / max(1e-300, math.sqrt(abs(matrix[V1, X1])))
    return scale


def _exactly(matrix: NDArray[np.float64]) -> Matrix:
    return [[Decimal(float(value)) for value in row] for row in matrix]
