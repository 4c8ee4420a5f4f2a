"""The linear part of the rig and its modes: what moves between impacts, propagated exactly.

    y' = M y + b0 u + b1 u',   y = (x_1, v_1[, x_b, v_b[, i]]),   u = coil current, base displacement or coil voltage

In modal form y(t) = Re Σ_k R_k c_k exp(λ_k t) + y_p(t), with c_k = L_k · (y − y_p) and the drive's particular
solution y_p. Two such systems exist: with the sphere loose (mass m_1) and with the sphere attached to the superior
base (m_1 + m).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.config import RigConfig
from impact_rig.errors import ConfigError

X1, V1, XB, VB, COIL = range(5)
"""Places in the state y; a prescribed base has the first two only, a current drive the first four."""

_WORST_CONDITION = 1e7
_DETUNING = 1e-9  # relative nudge of the damping that separates two coinciding eigenvalues


class Constants(NamedTuple):
    """Constants of the structure and the shaker as the equations of motion use them, SI."""

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
    """Modes of y' = M y; complex pairs are kept once with doubled right vectors. Shapes: (k,), (k, n), (k, n)."""

    rate: NDArray[np.complex128]
    right: NDArray[np.complex128]
    left: NDArray[np.complex128]


def constants(config: RigConfig) -> Constants:
    """Return the constants of motion of a configuration: k_1 = m_1 ω_n², c_1 = 2 ζ m_1 ω_n."""
    structure, shaker = config.structure, config.shaker
    omega_n = 2.0 * math.pi * structure.natural_frequency_hz
    return Constants(
        m_1=structure.mass_kg,
        c_1=2.0 * structure.damping_ratio * structure.mass_kg * omega_n,
        k_1=structure.mass_kg * omega_n**2,
        m_base=shaker.armature_mass_kg + shaker.base_mass_kg,
        c_f=shaker.damping_n_s_m,
        k_f=shaker.suspension_stiffness_n_m,
        force_factor=shaker.force_factor_n_a,
        resistance=shaker.coil_resistance_ohm,
        inductance=shaker.coil_inductance_h,
    )


def state_matrix(c: Constants, kind: str, mass: float) -> NDArray[np.float64]:
    """Return M, shape (n, n), for a superior base of `mass` [kg] under the drive `kind`."""
    n = {"prescribed": 2, "current": 4, "voltage": 5}[kind]
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
    """Return b0 and b1, shape (n,): how u and its rate enter."""
    n = {"prescribed": 2, "current": 4, "voltage": 5}[kind]
    b0, b1 = np.zeros(n), np.zeros(n)
    if kind == "prescribed":
        b0[V1], b1[V1] = c.k_1 / mass, c.c_1 / mass
    elif kind == "current":
        b0[VB] = c.force_factor / c.m_base
    else:
        b0[COIL] = 1.0 / c.inductance
    return b0, b1


def modes(matrix: NDArray[np.float64]) -> Modes:
    """Return the modes of a stable real matrix.

    Coinciding eigenvalues (critical damping) have no full set of modes: the damping is then nudged by parts in 1e9.

    Raises:
        ConfigError: the matrix has no usable modes or is not stable: masses or stiffnesses are too far apart.
    """
    for attempt in range(3):
        nudged = matrix.copy()
        nudged[np.diag_indices_from(nudged)] *= 1.0 + attempt * _DETUNING
        # Time scales differ by decades: balance lengths and speeds before the eigenvalues are taken.
        scale = np.ones(len(matrix))
        scale[[X1, XB] if len(matrix) > 2 else [X1]] = 1.0 / max(1e-300, math.sqrt(abs(matrix[V1, X1])))
        balanced = nudged * scale[np.newaxis, :] / scale[:, np.newaxis]
        rate, right = np.linalg.eig(balanced)
        if not np.all(np.isfinite(right)):
            break
        if np.linalg.cond(right) < _WORST_CONDITION:
            left = np.linalg.inv(right) / scale[np.newaxis, :]
            right = right * scale[:, np.newaxis]
            return _halved(rate.astype(complex), right.astype(complex), left.astype(complex))
    raise ConfigError("structure and shaker have no separable modes: masses, stiffnesses or dampings are too far apart")


def _halved(rate: NDArray[np.complex128], right: NDArray[np.complex128], left: NDArray[np.complex128]) -> Modes:
    kept = rate.imag >= 0.0
    weight = np.where(rate.imag[kept] > 0.0, 2.0, 1.0)
    return Modes(
        np.ascontiguousarray(rate[kept]),
        np.ascontiguousarray((right[:, kept] * weight).T),
        np.ascontiguousarray(left[kept]),
    )
