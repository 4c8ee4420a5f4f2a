"""Riding: the sphere is pressed on a wall for part of the cycle, on a contact spring far faster than everything else.

An explicit method would follow the contact's own 5 kHz; here steps as long as the structure allows are wanted. Radau
IIA collocation (L-stable, order 2 s − 1; Hairer & Wanner 1996, section IV.5) on δ' = v, v' = g: the stages' speeds
are the only unknowns, Newton solves them with the exact 2 × 2 coupling, and the slow centre of mass follows by
fixed-point iteration in the same rounds.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.special import roots_jacobi

from impact_rig.physics.collision import (
    FAILED,
    NOT_STIFF,
    OUT_OF_TIME,
    STIFF,
    stiffness_rate,
)
from impact_rig.physics.dynamics import LINEAR, contact_force, rates
from impact_rig.physics.forcing import drive
from impact_rig.physics.model import PRESCRIBED
from impact_rig.physics.series import WIDTH
from impact_rig.physics.state import (
    BETA,
    ELAPSED,
    GAP,
    IMPULSE,
    LOST,
    NEXT_STEP,
    PEAK_FORCE,
    PEAK_INDENTATION,
    RATE,
    SIDE,
    STEP,
    T,
    Y,
    add_knot,
)

STAGES = 5
DEPTH, SPEED, TIME, CENTRE, COIL = 0, 1, 2, 3, 7
"""Places in z = (δ, δ', t, X, V, x_b, v_b, i)."""

_ROUNDS = 15
_JACOBIANS = 3  # rounds that renew the Jacobian; later ones only polish
_SMALLEST = 1e-40  # m; keeps sqrt(δ) real while Newton looks around
_SPEED_RESOLUTION = 2.0**-46
_NOT_STIFF = 1.0
_SAFETY = 0.8
_REJECTIONS = 60
_STEPS_PER_CALL = 500
_ESTIMATE_EASE = 1e3  # the estimate is of order s, the step of order 2 s − 1: held by test_riding.py


def _collocation(stages: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return nodes c, Runge–Kutta matrix A and the weights that extrapolate stage values to the start of the step."""
    inner, _ = roots_jacobi(stages - 1, 1.0, 0.0)
    nodes = np.append((inner + 1.0) / 2.0, 1.0)
    matrix = np.empty((stages, stages))
    to_start = np.empty(stages)
    for j in range(stages):
        basis = Polynomial.fromroots(np.delete(nodes, j)) / np.prod(nodes[j] - np.delete(nodes, j))
        matrix[:, j] = basis.integ()(nodes)
        to_start[j] = basis(0.0)
    return nodes, matrix, to_start


_C, _A, _TO_START = _collocation(STAGES)
_GAMMA = float(np.max(np.real(np.linalg.eigvals(_A))))
_ERROR_ORDER = float(STAGES + 1)


@njit(cache=True, nogil=True, error_model="numpy")
def _invert(matrix):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Invert a small matrix in place (Gauss–Jordan); I − hA·(…) is far from singular, so no pivoting is needed."""
    n = matrix.shape[0]
    for p in range(n):
        pivot = 1.0 / matrix[p, p]
        matrix[p, p] = 1.0
        for j in range(n):
            matrix[p, j] *= pivot
        for i in range(n):
            if i != p:
                factor = matrix[i, p]
                matrix[i, p] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[p, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _gradient(p, beta, depth, speed):  # type: ignore[no-untyped-def]
    """Return ∂g/∂δ and ∂g/∂v of the relative acceleration g by the contact force."""
    if p.force.kind == LINEAR:
        return -p.force.stiffness / p.m_eff, -p.force.damping / p.m_eff
    root = math.sqrt(depth)
    stiff = p.force.stiffness * root / p.m_eff
    opening = 1.0 + beta * speed
    if opening <= 0.0:
        return 0.0, 0.0
    return -1.5 * stiff * opening, -stiff * depth * beta


@njit(cache=True, nogil=True, error_model="numpy")
def _stages(p, f, side, beta, z, h, work, tolerance):  # type: ignore[no-untyped-def]
    """Solve the collocation equations of one step from z; return whether they converged."""
    stage, slope, speed = work.stage, work.slope, work.speed
    width = CENTRE + 2 if p.drive == PRESCRIBED else WIDTH
    largest_speed = 0.0
    for i in range(STAGES):
        work.u[i], work.du[i] = drive(f, z[TIME] + _C[i] * h)
    for round_ in range(_ROUNDS):
        moved = 0.0
        for i in range(STAGES):
            depth = z[DEPTH]
            for j in range(STAGES):
                depth += h * _A[i, j] * speed[j]
            work.depth[i] = max(depth, _SMALLEST)
            if round_ > 0:
                for q in range(CENTRE, width):
                    value = z[q]
                    for j in range(STAGES):
                        value += h * _A[i, j] * slope[j, q]
                    if q % 2 == 0:
                        moved = max(moved, abs(value - stage[i, q]))
                        largest_speed = max(largest_speed, abs(value))
                    elif q == COIL:
                        moved = max(moved, abs(value - stage[i, q]) * h * p.c.force_factor * p.per_m_base)
                    stage[i, q] = value
        for i in range(STAGES):
            stage[i, DEPTH] = math.sqrt(work.depth[i])
            stage[i, SPEED] = speed[i]
            relative, centre, table, coil, p0, p1, p2, p3 = rates(
                p, side, beta, work.u[i], work.du[i], stage[i, DEPTH], speed[i], stage[i, 3], stage[i, 4], stage[i, 5],
                stage[i, 6], stage[i, 7]
            )  # fmt: skip
            slope[i, SPEED], slope[i, 4], slope[i, 6], slope[i, 7] = relative, centre, table, coil
            slope[i, 3], slope[i, 5] = stage[i, 4], stage[i, 6]
            work.powers[i, 0], work.powers[i, 1], work.powers[i, 2], work.powers[i, 3] = p0, p1, p2, p3
        if round_ < _JACOBIANS:
            for i in range(STAGES):
                work.stiff[i], work.damp[i] = _gradient(p, beta, work.depth[i], speed[i])
            for i in range(STAGES):
                for j in range(STAGES):
                    entry = 0.0
                    for q in range(STAGES):
                        entry -= h * h * _A[i, q] * work.stiff[q] * _A[q, j]
                    work.matrix[i, j] = entry - h * _A[i, j] * work.damp[j] + (1.0 if i == j else 0.0)
            _invert(work.matrix)
        for i in range(STAGES):
            residual = z[SPEED] - speed[i]
            for j in range(STAGES):
                residual += h * _A[i, j] * slope[j, SPEED]
            work.right[i] = residual
        for i in range(STAGES):
            change = 0.0
            for j in range(STAGES):
                change += work.matrix[i, j] * work.right[j]
            work.change[i] = change
        largest = 0.0
        for i in range(STAGES):
            speed[i] += work.change[i]
            largest = max(largest, abs(work.change[i]))
        if not largest < math.inf:
            return False
        if round_ > 1 and largest <= tolerance and moved <= max(tolerance, _SPEED_RESOLUTION * largest_speed):
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def ride(p, f, work, s, t_end, log, ledger):  # type: ignore[no-untyped-def]
    """Advance a sphere pressed on a wall until the segment ends or the motion is no longer stiff."""
    side, beta = s[SIDE], s[BETA]
    z, start, slope = work.z, work.at, work.slope
    z[DEPTH], z[SPEED], z[TIME] = s[GAP], s[RATE], s[T]
    for q in range(5):
        z[CENTRE + q] = s[Y + q]
    h = s[NEXT_STEP]
    rejected = 0
    for _ in range(_STEPS_PER_CALL):
        last = s[T] + h >= t_end
        if last:
            h = t_end - s[T]
        depth = z[DEPTH]
        root = math.sqrt(depth)
        u, du = drive(f, z[TIME])
        relative, centre, table, coil, _, _, _, _ = rates(
            p, side, beta, u, du, root, z[SPEED], z[3], z[4], z[5], z[6], z[7]
        )
        start[3], start[4], start[5], start[6], start[7] = z[4], centre, z[6], table, coil
        for i in range(STAGES):
            work.speed[i] = z[SPEED]
            for q in range(CENTRE, WIDTH):
                work.stage[i, q] = z[q] + _C[i] * h * start[q]
        stiff, damp = _gradient(p, beta, depth, z[SPEED])
        elastic_speed = depth * math.sqrt(-stiff)
        tolerance = p.rtol * max(elastic_speed, p.touch_speed)
        ok = _stages(p, f, side, beta, z, h, work, 0.01 * tolerance)
        defect_v, defect_centre, defect_table, defect_coil = relative, centre, table, coil
        for j in range(STAGES):
            defect_v -= _TO_START[j] * slope[j, SPEED]
            defect_centre -= _TO_START[j] * slope[j, 4]
            defect_table -= _TO_START[j] * slope[j, 6]
            defect_coil -= _TO_START[j] * slope[j, 7]
        step = _GAMMA * h
        error = max(abs(step * defect_v / (1.0 - step * damp - step * step * stiff)), abs(step * defect_centre))
        if p.drive != PRESCRIBED:
            by_coil = step * step * defect_coil * p.c.force_factor * p.per_m_base
            error = max(error, abs(step * defect_table), abs(by_coil))
        error /= _ESTIMATE_EASE * tolerance
        new_depth = depth
        for j in range(STAGES):
            new_depth += h * _A[STAGES - 1, j] * work.speed[j]
        if not ok or not error <= 1.0 or new_depth <= 0.0:
            rejected += 1
            if rejected > _REJECTIONS:
                return FAILED
            shrink = 0.25
            if ok and error > 1.0 and new_depth > 0.0:
                shrink = max(0.2, _SAFETY * error ** (-1.0 / _ERROR_ORDER))
            h *= shrink
            if h * stiffness_rate(p, beta, root) < _NOT_STIFF:
                s[STEP] = 0.0
                add_knot(log, s)
                return NOT_STIFF
            continue
        rejected = 0
        s[STEP] = h
        add_knot(log, s)
        before = z[4] + (1.0 - p.share) * side * z[SPEED]
        for i in range(STAGES):
            weight = h * _A[STAGES - 1, i]
            for term in range(4):
                ledger[term] += weight * work.powers[i, term]
            s[LOST] += weight * work.powers[i, 3]
            force, _ = contact_force(p.force, math.sqrt(work.depth[i]), work.speed[i], beta)
            s[PEAK_FORCE] = max(s[PEAK_FORCE], force)
            s[PEAK_INDENTATION] = max(s[PEAK_INDENTATION], work.depth[i])
            for q in range(CENTRE, WIDTH):
                z[q] += weight * slope[i, q]
        z[DEPTH] = new_depth
        z[SPEED] = work.speed[STAGES - 1]
        z[TIME] = t_end if last else z[TIME] + h
        s[ELAPSED] += h
        s[IMPULSE] -= side * p.m * (z[4] + (1.0 - p.share) * side * z[SPEED] - before)
        s[GAP], s[RATE], s[T] = z[DEPTH], z[SPEED], z[TIME]
        for q in range(5):
            s[Y + q] = z[CENTRE + q]
        h *= min(3.0, _SAFETY * max(error, 1e-9) ** (-1.0 / _ERROR_ORDER))
        s[NEXT_STEP] = h
        root = math.sqrt(z[DEPTH])
        ending = -1
        if last:
            ending = OUT_OF_TIME
        elif h * stiffness_rate(p, beta, root) < _NOT_STIFF:
            ending = NOT_STIFF
        if ending >= 0:
            s[STEP] = 0.0
            add_knot(log, s)
            return ending
    s[STEP] = 0.0
    add_knot(log, s)
    return STIFF
