# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""One step of a contact: the indentation δ under the law's force, pressed by what moves sphere and wall together.

    δ'' = −F(δ, δ') / m_eff + thrust(t) − (σ/m_1) (k_1 δ + c_1 δ') + (σ/m_1) [k_1 (z_x1 − z_xb) + c_1 (z_v1 − z_vb)]

m_1 is the superior base that carries the wall, k_1 and c_1 its columns, m the sphere, m_eff = m m_1 / (m + m_1),
σ = m / (m + m_1). The thrust is the relative acceleration with which the columns press both together, z how far the
indentation itself has moved both (its recoil, a small correction): see `pair`, which knows how they move.

F has a kink where the contact starts and ends (δ^1.5), which limits every classical method to order 2.5. With w = √δ
and dt = w ds, s in s/m^0.5 (a Sundman transformation), the equations are smooth through w = 0:

    dw/ds = δ'/2,    dt/ds = w,    dδ'/ds = w δ''

A step has a length h in s. It solves the collocation equations of `collocation` at five stages (Radau IIA, order 9,
L-stable: a sphere that rests on the wall is no harder than one that bounces off). w and t follow linearly from the
speeds δ' at the stages, which are the only unknowns of Newton's method. The last stage is the end of the step.
"""

from __future__ import annotations

import math

from impact_rig.arithmetic.elementary import power
from impact_rig.kernels import kernel
from impact_rig.physics.collocation import INVERSE, LAST, MATRIX, REAL_EIGENVALUE, STAGES, TO_START
from impact_rig.physics.foresight import guess
from impact_rig.physics.pair import improve_recoil
from impact_rig.physics.state import V1, VB, X1, XB

ERROR_ORDER = 8.0  # in h, of the relieved estimate: between 6, where it is relieved by a constant, and 10
_RELIEF = 1e4  # found by trial: the largest with which contacts still keep their tolerance
FEW_ROUNDS, ROUNDS = 12, 24  # most steps need three to six; one that needs many is better taken shorter
_SLOW = 0.1  # a round that shrinks the change by no more than this factor makes the next one renew the matrix
_CONVERGED = 0.1  # of what the contact's own speeds allow
_RESOLUTION = 2.0**-48  # of the speeds: Newton cannot come closer
_AT_REST = 0.1  # see `begin_step`: with more, the force on a resting sphere becomes inexact
_LEAST_PART = 1e-3  # of the floored approach speed: slower motion of a contact need not be resolved relatively


@kernel
def turned_at(s):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return the w from which the law unloads, 0 while it loads: see `contact.law`."""
    return 0.0 if s.w >= s.deepest and s.speed > 0.0 else s.deepest


@kernel
def begin_step(p, force, s, k):  # type: ignore[no-untyped-def]
    """Evaluate force and slope at the start of a step, and how exact its speeds must be [m/s].

    A step may be wrong by a part of the contact's own speeds: δ', and δ times its natural frequency. Where the sphere
    rests on the wall these are tiny, and a tenth of the speed that the thrust gives in the time of a radian of the
    structure's fastest motion is allowed instead. Newton's method never goes by the latter: instruments solve steps
    again, from another guess, and must find the same.
    """
    k.turned_at = turned_at(s)
    elastic, lossy, _, by_w, _ = force.one(p.stiffness, p.factor, s.per_v0, k.turned_at, s.w, s.speed)
    depth = s.w * s.w
    k.start_force = elastic + lossy
    by_columns = p.pair_stiffness * depth + p.pair_damping * s.speed
    k.start_slope = s.w * (k.thrust[0] - by_columns - k.start_force * p.per_m_eff)
    vibration = math.sqrt(0.5 * s.w * depth * abs(by_w) * p.per_m_eff)  # δ times the contact's own frequency
    own = max(abs(s.speed), vibration, _LEAST_PART * p.speed_floor)
    k.goal = max(_CONVERGED * p.rtol * own, _RESOLUTION * abs(s.speed))
    k.tolerance = p.rtol * max(own, _AT_REST * abs(k.thrust[0]) * k.fastest_time)


@kernel
def _place(s, k, h):  # type: ignore[no-untyped-def]
    """Fill w and time at the stages from the speeds there."""
    for i in range(STAGES):
        w = 0.0
        for j in range(STAGES):
            w += MATRIX[i, j] * k.speed[j]
        k.w[i] = s.w + 0.5 * h * w
    for i in range(STAGES):
        since = 0.0
        for j in range(STAGES):
            since += MATRIX[i, j] * k.w[j]
        k.since[i] = h * since


@kernel
def _push(p, k):  # type: ignore[no-untyped-def]
    """Fill the thrust at the stages, with what the recoil adds to it."""
    for i in range(STAGES):
        k.thrust_at[i] = k.thrust[k.terms - 1]
    for n in range(k.terms - 2, -1, -1):
        for i in range(STAGES):
            k.thrust_at[i] = k.thrust_at[i] * k.since[i] + k.thrust[n]
    z, per_m = k.recoil, p.share * p.per_m_1
    for i in range(STAGES):
        k.thrust_at[i] += per_m * (p.k_1 * (z[X1, i] - z[XB, i]) + p.c_1 * (z[V1, i] - z[VB, i]))


@kernel
def _press(p, force, s, k):  # type: ignore[no-untyped-def]
    """Fill force and slope at the stages, and the slope's derivatives at a given thrust."""
    force.at_stages(p, s.per_v0, k)
    for i in range(STAGES):
        w, speed = k.w[i], k.speed[i]
        by_columns = p.pair_stiffness * w * w + p.pair_damping * speed
        acceleration = k.thrust_at[i] - by_columns - k.force[i] * p.per_m_eff
        k.slope[i] = w * acceleration
        k.slope_by_w[i] = acceleration - w * (k.force_by_w[i] * p.per_m_eff + 2.0 * p.pair_stiffness * w)
        k.slope_by_speed[i] = -w * (k.force_by_speed[i] * p.per_m_eff + p.pair_damping)


@kernel
def _differentiate(k, h):  # type: ignore[no-untyped-def]
    """Fill `k.matrix` with A⁻¹ − h ∂slope/∂δ' − (h²/2) ∂slope/∂w A.

    That is A⁻¹ times the derivative of the equations v − v_0 − hA slope(v) = 0, but for the thrust's, which is small.
    """
    m = k.matrix
    for i in range(STAGES):
        through_w = 0.5 * h * h * k.slope_by_w[i]
        for j in range(STAGES):
            m[i, j] = INVERSE[i, j] - through_w * MATRIX[i, j]
        m[i, i] -= h * k.slope_by_speed[i]


@kernel
def _differentiate_thrust(k, h):  # type: ignore[no-untyped-def]
    """Add the thrust's part to `k.matrix`, −(h³/2) ∂slope/∂t A²."""
    for i in range(STAGES):
        rate = 0.0
        for n in range(k.terms - 1, 0, -1):
            rate = rate * k.since[i] + n * k.thrust[n]
        through_time = 0.5 * h * h * h * k.w[i] * rate
        for j in range(STAGES):
            square = 0.0
            for q in range(STAGES):
                square += MATRIX[i, q] * MATRIX[q, j]
            k.matrix[i, j] -= through_time * square


@kernel
def _invert(k):  # type: ignore[no-untyped-def]
    """Replace `k.matrix` by its inverse (Gauss–Jordan, no pivoting)."""
    m = k.matrix
    for i in range(STAGES):
        pivot = 1.0 / m[i, i]
        m[i, i] = 1.0
        for j in range(STAGES):
            m[i, j] *= pivot
        for row in range(STAGES):
            if row != i:
                factor = m[row, i]
                m[row, i] = 0.0
                for j in range(STAGES):
                    m[row, j] -= factor * m[i, j]


@kernel
def _improve(s, k, h):  # type: ignore[no-untyped-def]
    """Make one Newton step of the stages' speeds; return the largest change [m/s]."""
    for i in range(STAGES):
        miss = h * k.slope[i]
        for j in range(STAGES):
            miss += INVERSE[i, j] * (s.speed - k.speed[j])
        k.miss[i] = miss
    largest = 0.0
    for i in range(STAGES):
        change = 0.0
        for j in range(STAGES):
            change += k.matrix[i, j] * k.miss[j]
        if not abs(change) < math.inf:  # also where it is NaN, which `max` would pass over
            return math.inf
        k.speed[i] += change
        largest = max(largest, abs(change))
    return largest


@kernel
def solve(p, force, s, k, h, rounds):  # type: ignore[no-untyped-def]
    """Solve a step of length h; return whether Newton converged. The stages hold the step, the last one its end.

    A sphere that rests on the wall until the thrust lifts it off takes steps through which the thrust decides the
    indentation: where Newton's method does not come near enough without the thrust's derivative, it goes on with it.
    """
    guess(s, k, h)
    k.recoil[:] = 0.0
    before, contraction = 0.0, 1.0
    for n in range(rounds):
        _place(s, k, h)
        improve_recoil(p, k, h)
        _push(p, k)
        _press(p, force, s, k)
        if contraction > _SLOW or n >= FEW_ROUNDS:
            _differentiate(k, h)
            if n >= FEW_ROUNDS:
                _differentiate_thrust(k, h)
            _invert(k)
        change = _improve(s, k, h)
        if change == math.inf:
            return False
        contraction = change / before if before > 0.0 else 1.0
        before = change
        left = change * contraction / (1.0 - contraction) if contraction < 0.5 else change
        if min(change, left) <= k.goal:
            _place(s, k, h)
            improve_recoil(p, k, h)
            return True
    return False


@kernel
def estimate(k, h):  # type: ignore[no-untyped-def]
    """Return the error of the step solved last, in units of what is allowed.

    How far the stages' slopes, extrapolated to the start, miss the slope there is an error of order 6 in h, filtered so
    that fast decay counts only as much as it shows (Hairer & Wanner, section IV.8). The step itself is of order 9 where
    it is not stiff: there the estimate is relieved, by the less the stiffer the contact.
    """
    defect = k.start_slope
    for j in range(STAGES):
        defect -= TO_START[j] * k.slope[j]
    step = REAL_EIGENVALUE * h
    filtered = step / (1.0 - step * k.slope_by_speed[LAST] - 0.5 * step * step * k.slope_by_w[LAST])
    stiff = h * abs(k.slope_by_speed[LAST]) + 0.5 * h * h * abs(k.slope_by_w[LAST])
    relief = max(1.0, _RELIEF / (1.0 + stiff * stiff))
    return abs(filtered * defect) / (relief * k.tolerance)


@kernel
def rescaled(h, error):  # type: ignore[no-untyped-def]
    """Return the step length that this error asks for."""
    return h * min(4.0, max(0.1, 0.8 * power(max(error, 1e-9), -1.0 / ERROR_ORDER)))
