"""One step of a contact: the indentation δ under the law's force, pressed by the motion of the base.

    δ'' = −F(δ, δ') / m_eff + thrust(t) − (σ / m_1) (k_1 δ + c_1 δ')

F has a kink where the contact starts and ends (δ^1.5), which limits every classical method to order 2.5. With w = √δ
and dt = w ds (a Sundman transformation) the equations are smooth through w = 0:

    dw/ds = δ'/2,    dt/ds = w,    dδ'/ds = w δ''

A step solves the collocation equations of `collocation` (Radau IIA, order 9, L-stable: a sphere that rests on the wall
is no harder than one that bounces off). w and t follow linearly from the speeds at the stages, which are the only
unknowns of Newton's method.
"""

from __future__ import annotations

import math

from numba import njit

from impact_rig.arithmetic.elementary import power
from impact_rig.physics.collocation import INVERSE, LAST, MATRIX, NODES, REAL_EIGENVALUE, STAGES, TO_START

ERROR_ORDER = 8.0  # of the estimate: 6 of a smooth step, 10 of a stiff one, by the ease
_EASE = 1e4  # the estimate is of order 5, the step of order 9, but on a stiff contact of order 5 too
_STRICT = 0.03  # what is left out adds up over the steps of a long contact, always with one sign
_ROUNDS = 12
_JACOBIANS = 0  # rounds that renew it, beside the first: later ones only polish
_CONVERGED = 0.3  # of the step's tolerance
_RESOLUTION = 2.0**-48  # of the speeds: Newton cannot come closer
_LEAST_PART = 1e-3  # of the floored approach speed: slower motion of a contact need not be resolved relatively


@njit(cache=True, nogil=True, error_model="numpy")
def begin_step(p, force, s, k):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Evaluate force and slope at the start of a step, and the tolerance of its speeds [m/s]."""
    elastic, lossy, _, by_w, _ = force(p.stiffness, p.factor, s.per_v0, s.deepest, s.w, s.w_rate)
    depth = s.w * s.w
    k.start_force = elastic + lossy
    own = p.pair_stiffness * depth + p.pair_damping * s.w_rate
    k.start_slope = s.w * (k.thrust[0] - own - k.start_force * p.per_m_eff)
    vibration = math.sqrt(0.5 * s.w * depth * abs(by_w) * p.per_m_eff)  # δ times the contact's own frequency
    k.tolerance = p.rtol * max(abs(s.w_rate), vibration, _LEAST_PART * p.speed_floor)


@njit(cache=True, nogil=True, error_model="numpy")
def _place(s, k, h):  # type: ignore[no-untyped-def]
    """Fill w and time at the stages from the speeds there."""
    for i in range(STAGES):
        w = 0.0
        for j in range(STAGES):
            w += MATRIX[i, j] * k.rate[j]
        k.w[i] = s.w + 0.5 * h * w
    for i in range(STAGES):
        since = 0.0
        for j in range(STAGES):
            since += MATRIX[i, j] * k.w[j]
        k.since[i] = h * since


@njit(cache=True, nogil=True, error_model="numpy")
def _push_back(p, k, h):  # type: ignore[no-untyped-def]
    """Fill what the indentation does to the pair up to the stages: ∫ (k_1 δ + c_1 δ') dt, and its integral."""
    for i in range(STAGES):
        impulse = 0.0
        for j in range(STAGES):
            impulse += MATRIX[i, j] * k.w[j] * (p.k_1 * k.w[j] * k.w[j] + p.c_1 * k.rate[j])
        k.impulse[i] = h * impulse
    for i in range(STAGES):
        moment = 0.0
        for j in range(STAGES):
            moment += MATRIX[i, j] * k.w[j] * k.impulse[j]
        k.moment[i] = h * moment


@njit(cache=True, nogil=True, error_model="numpy")
def _push(p, k):  # type: ignore[no-untyped-def]
    """Fill the thrust at the stages, all five at once, with what the moved pair adds to it."""
    for i in range(STAGES):
        k.pushed[i] = k.thrust[k.terms - 1]
    for n in range(k.terms - 2, -1, -1):
        for i in range(STAGES):
            k.pushed[i] = k.pushed[i] * k.since[i] + k.thrust[n]
    for i in range(STAGES):
        k.pushed[i] += p.feedback * (p.k_1 * k.moment[i] + p.c_1 * k.impulse[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _press(p, force, s, k):  # type: ignore[no-untyped-def]
    """Fill force and slope at the stages, and the slope's derivatives."""
    for i in range(STAGES):
        w, rate = k.w[i], k.rate[i]
        elastic, lossy, _, by_w, by_rate = force(p.stiffness, p.factor, s.per_v0, s.deepest, w, rate)
        k.force[i], k.lossy[i] = elastic + lossy, lossy
        own = p.pair_stiffness * w * w + p.pair_damping * rate
        acceleration = k.pushed[i] - own - k.force[i] * p.per_m_eff
        k.slope[i] = w * acceleration
        k.by_w[i] = acceleration - w * (by_w * p.per_m_eff + 2.0 * p.pair_stiffness * w)
        k.by_rate[i] = -w * (by_rate * p.per_m_eff + p.pair_damping)


@njit(cache=True, nogil=True, error_model="numpy")
def _linearise(k, h):  # type: ignore[no-untyped-def]
    """Fill `k.matrix` with the inverse of A⁻¹ − h ∂slope/∂rate − (h²/2) ∂slope/∂w A (Gauss–Jordan, no pivoting).

    A times that matrix is the Jacobian of the equations v_0 + hA slope(v) − v = 0, with the sign turned.
    """
    m = k.matrix
    for i in range(STAGES):
        through_w = 0.5 * h * h * k.by_w[i]
        for j in range(STAGES):
            m[i, j] = INVERSE[i, j] - through_w * MATRIX[i, j]
        m[i, i] -= h * k.by_rate[i]
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


@njit(cache=True, nogil=True, error_model="numpy")
def _improve(s, k, h):  # type: ignore[no-untyped-def]
    """Make one Newton step of the stages' speeds; return the largest change [m/s]."""
    for i in range(STAGES):
        miss = h * k.slope[i]
        for j in range(STAGES):
            miss += INVERSE[i, j] * (s.w_rate - k.rate[j])
        k.miss[i] = miss
    largest = 0.0
    for i in range(STAGES):
        change = 0.0
        for j in range(STAGES):
            change += k.matrix[i, j] * k.miss[j]
        k.rate[i] += change
        largest = max(largest, abs(change))
    return largest


@njit(cache=True, nogil=True, error_model="numpy")
def solve(p, force, s, k, h):  # type: ignore[no-untyped-def]
    """Solve a step of length h; return whether Newton converged. The stages hold the step, the last one its end."""
    for i in range(STAGES):
        k.rate[i] = s.w_rate + NODES[i] * h * k.start_slope
    goal = max(_CONVERGED * k.tolerance, _RESOLUTION * abs(s.w_rate))
    for round_ in range(_ROUNDS):
        _place(s, k, h)
        _push_back(p, k, h)
        _push(p, k)
        _press(p, force, s, k)
        if round_ <= _JACOBIANS:
            _linearise(k, h)
        change = _improve(s, k, h)
        if not change < math.inf:
            return False
        if change <= goal:
            _place(s, k, h)
            _push_back(p, k, h)
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def estimate(p, k, h):  # type: ignore[no-untyped-def]
    """Return the error of the step solved last, in units of what is allowed.

    Two errors count: that of the collocation, and what the columns answer to the motion that the indentation gives the
    pair within the step, which the thrust leaves out.
    """
    defect = k.start_slope
    for j in range(STAGES):
        defect -= TO_START[j] * k.slope[j]
    step = REAL_EIGENVALUE * h
    filtered = step / (1.0 - step * k.by_rate[LAST] - 0.5 * step * step * k.by_w[LAST])
    stiff = h * abs(k.by_rate[LAST]) + 0.5 * h * h * abs(k.by_w[LAST])
    ease = max(1.0, _EASE / (1.0 + stiff * stiff))
    angle = k.fastest * k.since[LAST]
    left_out = k.w[LAST] * p.feedback * (p.k_1 * k.moment[LAST] + p.c_1 * k.impulse[LAST]) * angle * angle
    return max(abs(filtered * defect) / ease, abs(filtered * left_out) / _STRICT) / k.tolerance


@njit(cache=True, nogil=True, error_model="numpy")
def rescaled(h, error):  # type: ignore[no-untyped-def]
    """Return the step length that this error asks for."""
    return h * min(4.0, max(0.1, 0.8 * power(max(error, 1e-9), -1.0 / ERROR_ORDER)))
