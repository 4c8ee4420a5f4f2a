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
"""One integration step of a contact, during which sphere and superior base press against each other and move together.

x_1 and x_2 are superior base (mass m_1, with the walls) and sphere (mass m), x_b the inferior base that the columns
k_1, c_1 stand on (mass m_a + m_b, on k_f, c_f), i the current of its coil. The gap g is the free way of the sphere
between the walls. The sphere indents the wall on `side` (−1 left, 1 right) by δ, beyond the residual indentation `dent`
of the state (not 0 only after a contact has let go at δ > 0): x_2 − x_1 = side (g/2 + `dent` + δ). In a contact the
structural state y holds the centre of mass of both, given as the position that x_1 has at δ = 0:

    x_1* = x_1 + side σ δ,   v_1* = v_1 + side σ δ',   σ = m / (m_1 + m)
    (m_1 + m) x_1*'' = F_c*,    F_c* = −k_1 (x_1* − x_b) − c_1 (v_1* − v_b)
    (m_a + m_b) x_b'' = K_f i − c_f x_b' − k_f x_b − F_c*,    voltage drive: L i' = U − R i − K_f x_b'

F_c* is the columns' force as it would be at δ = 0; F_c = −k_1 (x_1 − x_b) − c_1 (v_1 − v_b) is the real one. The
contact force is internal to the pair and does not appear. A prescribed base follows its commanded motion. These
equations give y as Taylor polynomials in time (`expand`), and the relative acceleration a_r = −side F_c* / m_1 [m/s²]
with which the columns press sphere and wall together: m_1 x_1'' = F_c + side F, m x_2'' = −side F.

These equations leave out F_c − F_c* = side σ (k_1 δ + c_1 δ'), usually a millionth of F_c, and its consequences. The
difference moves the pair by side σ z, its `correction`, starting from z = 0 at the start of each step. With side σ F_z,
the change of the columns' force by δ and z,

    z_x1' = z_v1,   (m_1 + m) z_v1' = F_z,    F_z = k_1 (δ − z_x1 + z_xb) + c_1 (δ' − z_v1 + z_vb)
    z_xb' = z_vb,   (m_a + m_b) z_vb' = K_f z_i − c_f z_vb − k_f z_xb − F_z,   L z_i' = −R z_i − K_f z_vb

**Indentation.** With m_eff = m m_1 / (m + m_1),

    δ'' = −F(δ, δ') / m_eff + a_r(t) − (σ/m_1) (k_1 δ + c_1 δ') + (σ/m_1) [k_1 (z_x1 − z_xb) + c_1 (z_v1 − z_vb)]

F has a kink where the contact starts and ends (δ^1.5), which limits every classical method to order 2.5. With w = √δ
and dt = w dχ, χ in s/m^0.5 (a Sundman transformation), the equations are smooth through w = 0:

    dw/dχ = δ'/2,    dt/dχ = w,    dδ'/dχ = w δ''

A step has a length h in χ. It solves the collocation equations of `collocation` at five stages (Radau IIA, order 9).
The method is L-stable: a sphere that rests on the wall is no harder than one that bounces off. w and t follow linearly
from the speeds δ' at the stages, which are the only unknowns of Newton's method. The last stage is the end of the step.

**Dense output.** The speeds at the start and at the stages define a polynomial of degree 5 in x = χ / h, and through
dw/dχ and dt/dχ also w and the time. Its error is between a thousandth and a millionth, larger than that of the step
itself. It predicts the next step for Newton's method and the approximate place of an event, but does not determine the
motion. The instruments read their polynomials in a contact from it (`sampling.fit`).

The functions share some argument names: p are the parameters, law is the contact law's force, f the drive, s the state,
and step the step with its stages. A slope is a derivative by χ.
"""

from __future__ import annotations

import math

from impact_rig.arithmetic.elementary import power, sincos
from impact_rig.kernels import Reals, Record, kernel
from impact_rig.physics.collocation import (
    INVERSE,
    LAST,
    MATRIX,
    REAL_EIGENVALUE,
    STAGE_AT,
    STAGES,
    TO_POLYNOMIAL,
    TO_START,
)
from impact_rig.physics.contact.law import CompiledForce
from impact_rig.physics.flight import DriveSegment
from impact_rig.physics.state import COIL, PRESCRIBED, STEP_TERMS, STRUCTURE, V1, VB, VOLTAGE, X1, XB

FEW_TERMS = 8
_FEW_VALID_RADIANS = 0.03  # of the fastest motion in one step: FEW_TERMS leave out 1e-16
_VALID_RADIANS = 0.25  # the same for STEP_TERMS
_AMPLE = 4.0  # the terms are chosen before the length is known, for this many times the expected length


@kernel
def expand(p: Record, f: DriveSegment, s: Record, step: Record) -> None:
    """Fill `step.path` and `step.acceleration` with Taylor coefficients in time about the state s under the drive f.

    `path` is the motion of sphere and superior base as one body, of the inferior base and of the coil's current.
    `acceleration` is a_r, the acceleration that presses sphere and wall together. Also set `step.terms`, the number of
    terms, and `step.valid_for`, the time [s] for which the terms are exact to rounding.
    """
    path = step.path
    fastest = max(p.fastest, f.omega)
    expected = _AMPLE * s.next_h * max(s.w, 0.5 * s.next_h * abs(s.speed))  # ∫ w dχ, with w + (δ'/2) χ
    step.terms, step.valid_for = FEW_TERMS, _FEW_VALID_RADIANS / fastest
    if expected > step.valid_for:
        step.terms, step.valid_for = STEP_TERMS, _VALID_RADIANS / fastest
    step.fastest_time_scale = 1.0 / fastest
    for q in range(STRUCTURE):
        path[q, 0] = s.y[q]
    amplitude = f.amplitude + f.growth * s.t
    sine, cosine = sincos(f.omega * s.t + f.phase)  # then their coefficients, order by order
    u = amplitude * sine
    for n in range(step.terms):
        per_order = 1.0 / (n + 1)
        sine_next, cosine_next = f.omega * cosine * per_order, -f.omega * sine * per_order
        u_next = amplitude * sine_next + f.growth * sine
        if p.drive_kind == PRESCRIBED:
            path[XB, n], path[VB, n] = u, (n + 1) * u_next
        columns_force = -p.k_1 * (path[X1, n] - path[XB, n]) - p.c_1 * (path[V1, n] - path[VB, n])
        step.acceleration[n] = -s.side * columns_force * p.per_m_1
        if n + 1 < step.terms:
            path[X1, n + 1] = path[V1, n] * per_order
            path[V1, n + 1] = columns_force * p.per_m_pair * per_order
            if p.drive_kind != PRESCRIBED:
                current = u
                if p.drive_kind == VOLTAGE:
                    current = path[COIL, n]
                    path[COIL, n + 1] = (u - p.resistance * current - p.force_factor * path[VB, n]) * (
                        p.per_inductance * per_order
                    )
                base_force = p.force_factor * current - p.c_f * path[VB, n] - p.k_f * path[XB, n] - columns_force
                path[XB, n + 1] = path[VB, n] * per_order
                path[VB, n + 1] = base_force * p.per_m_base * per_order
        sine, cosine, u = sine_next, cosine_next, u_next


@kernel
def polynomial(coefficients: Reals, since: float, terms: int) -> float:
    """Return the value of a Taylor polynomial with `terms` terms, `since` seconds after its point of expansion."""
    total = coefficients[terms - 1]
    for n in range(terms - 2, -1, -1):
        total = total * since + coefficients[n]
    return total


@kernel
def pair_at(step: Record, since: float, y: Reals) -> None:
    """Fill y with the structural state `since` seconds after the start of a contact's step.

    The state treats sphere and superior base as one body. The correction z for the indentation is not included.
    """
    for q in range(STRUCTURE):
        y[q] = polynomial(step.path[q], since, step.terms)


@kernel
def _integrate(step: Record, place: int, h: float) -> None:
    """Fill the correction z of one entry of the structural state y at the stages, by integrating its slope dz/dχ.

    `place` is the index of the entry in y. `h` is the step's length in χ, with dt = √δ dχ. The slopes at the stages are
    read from `step.correction_slope`.
    """
    slope, correction = step.correction_slope[place], step.correction[place]
    for i in range(STAGES):
        total = 0.0
        for j in range(STAGES):
            total += MATRIX[i, j] * slope[j]
        correction[i] = h * total


@kernel
def improve_correction(p: Record, step: Record, h: float) -> None:
    """Improve the correction z at the stages by one sweep of fixed-point iteration.

    z is the small motion of the structure that the indentation causes through the force of the columns. `h` is the
    step's length in χ. Each sweep increases the order of accuracy in h by one.
    """
    z, slope, w = step.correction, step.correction_slope, step.w
    force_z = slope[X1]  # scratch until it is filled
    # constants first: the compiler must assume that storing a result changes them
    k_1, c_1, per_m_pair, is_driven = p.k_1, p.c_1, p.per_m_pair, p.drive_kind != PRESCRIBED
    for j in range(STAGES):
        force_z[j] = k_1 * (w[j] * w[j] - z[X1, j] + z[XB, j]) + c_1 * (step.speed[j] - z[V1, j] + z[VB, j])
        slope[V1, j] = w[j] * force_z[j] * per_m_pair
    if is_driven:
        force_factor, c_f, k_f, per_m_base = p.force_factor, p.c_f, p.k_f, p.per_m_base
        for j in range(STAGES):
            force_z_base = force_factor * z[COIL, j] - c_f * z[VB, j] - k_f * z[XB, j] - force_z[j]
            slope[VB, j] = w[j] * force_z_base * per_m_base
    _integrate(step, V1, h)
    for j in range(STAGES):
        slope[X1, j] = w[j] * z[V1, j]
    _integrate(step, X1, h)
    if is_driven:
        _integrate(step, VB, h)
        for j in range(STAGES):
            slope[XB, j] = w[j] * z[VB, j]
        _integrate(step, XB, h)
    if p.drive_kind == VOLTAGE:
        for j in range(STAGES):
            voltage = -p.resistance * z[COIL, j] - p.force_factor * z[VB, j]
            slope[COIL, j] = w[j] * voltage * p.per_inductance
        _integrate(step, COIL, h)


@kernel
def add_correction(p: Record, side: float, step: Record, stage: int, y: Reals) -> None:
    """Add the correction `side` · σ z at one stage of a step to the structural state y.

    z is the small motion that the indentation causes through the force of the columns. σ is the mass of the sphere
    divided by the mass of sphere and superior base.
    """
    for q in range(STRUCTURE):
        y[q] += side * p.share * step.correction[q, stage]


_FAR = 1.6  # times the step's length: beyond it the polynomial is worse than a straight line


@kernel
def keep_dense_output(s: Record, step: Record) -> None:
    """Store the dense output of the solved step of length `s.h` from s.

    The dense output is the polynomial through δ' at the start and at the stages of the step.
    """
    for n in range(STAGES + 1):
        total = TO_POLYNOMIAL[n, 0] * s.speed
        for j in range(STAGES):
            total += TO_POLYNOMIAL[n, j + 1] * step.speed[j]
        step.dense[n] = total
    step.dense_length, step.dense_since = s.h, 0.0


@kernel
def drop_dense_output(step: Record) -> None:
    """Forget the stored dense output, so that the next step does not depend on what was solved before."""
    step.dense_length = 0.0


@kernel
def _dense_speed(step: Record, x: float) -> float:
    """Return δ' [m/s] at the fraction x of the step whose dense output was stored last.

    x is 0 at the start of that step and 1 at its end.
    """
    speed = step.dense[STAGES]
    for n in range(STAGES - 1, -1, -1):
        speed = speed * x + step.dense[n]
    return speed


@kernel
def dense_slope(step: Record, x: float) -> float:
    """Return the slope dδ'/dχ at the fraction x of the step whose dense output was stored last.

    x is 0 at the start of that step and 1 at its end.
    """
    slope = STAGES * step.dense[STAGES]
    for n in range(STAGES - 1, 0, -1):
        slope = slope * x + n * step.dense[n]
    return slope / step.dense_length


@kernel
def predict_speeds(s: Record, step: Record, h: float) -> None:
    """Fill `step.speed` with a guess of the speeds δ' at the stages of a step of length h from s.

    Newton's method starts from this guess.

    The guess extrapolates the dense output stored last, to at most 1.6 times its length. If no dense output is stored,
    or it does not reach that far, the guess is a straight line in χ with the slope at s.
    """
    if step.dense_since + h <= _FAR * step.dense_length:
        x_start, x_length = step.dense_since / step.dense_length, h / step.dense_length
        for i in range(STAGES):
            step.speed[i] = _dense_speed(step, x_start + STAGE_AT[i] * x_length)
    else:
        for i in range(STAGES):
            step.speed[i] = s.speed + STAGE_AT[i] * h * step.start_speed_slope


@kernel
def dense_output(s: Record, step: Record, x: float) -> tuple[float, float, float]:
    """Return (time since the start of the step [s], w [√m], δ' [m/s]) at the fraction x of the step from s.

    x is 0 at the start of the step and 1 at its end. w is the square root of the indentation δ, and δ' the time
    derivative of δ. The dense output of this step must be the one stored last.
    """
    time_sum, w_sum = 0.0, 0.0  # sums over the speeds [m/s]
    for n in range(STAGES, -1, -1):
        w_sum = w_sum * x + step.dense[n] / (n + 1)
        time_sum = time_sum * x + step.dense[n] / ((n + 1) * (n + 2))
    half_length = 0.5 * step.dense_length * x
    return step.dense_length * x * (s.w + half_length * time_sum), s.w + half_length * w_sum, _dense_speed(step, x)


ERROR_ORDER = 8.0  # in h, of the reduced estimate_error: between 6, where a constant reduces it, and 10
_RELIEF = 1e4  # found by trial: the largest value with which contacts still keep their tolerance
FEW_ROUNDS, ROUNDS = 12, 24  # most steps need three to six; one that needs many is better taken shorter
_SLOW = 0.1  # after a round that leaves more than this part of the change before, the next round renews the matrix
_CONVERGED = 0.1  # of the error that the contact's own speeds allow
_RESOLUTION = 2.0**-48  # of the speeds: Newton's method cannot come closer
_AT_REST = 0.1  # see `begin_step`: with more, the force on a resting sphere becomes inexact
_LEAST_PART = 1e-3  # of `speed_floor`: slower motion of a contact need not be resolved relatively


@kernel
def turned_at(s: Record) -> float:
    """Return the argument `turned_at` of the contact law's force for the state s (see `contact.law`).

    It is 0 while the indentation δ grows and is the largest so far. Otherwise it is the largest w = √δ so far.
    """
    return 0.0 if s.w >= s.deepest_w and s.speed > 0.0 else s.deepest_w


@kernel
def force_at(
    p: Record, law: CompiledForce, per_v0: float, turned_at: float, w: float, speed: float, step: Record
) -> tuple[float, float, float, float, float]:
    """Evaluate the contact law at w = √δ and δ' = `speed`: return (elastic, lossy, stored, ∂F/∂w, ∂F/∂δ').

    `contact.law` describes the five results. `step.point` is overwritten as scratch memory.
    """
    law.at_point(p, per_v0, turned_at, w, speed, step)
    point = step.point
    return point[0], point[1], point[2], point[3], point[4]


@kernel
def begin_step(p: Record, law: CompiledForce, s: Record, step: Record) -> None:
    """Evaluate the contact at the start of a step: force, slope, turning point, time scale and tolerances.

    The results are stored in `step`, which `expand` must have filled about s. `step.tolerance` is the allowed error of
    the speeds, and `step.goal` the accuracy of Newton's method [m/s]. Both follow from `rtol` and the contact's own
    speed. That is the largest of |δ'|, δ times the contact's natural frequency, and a thousandth of `speed_floor`. The
    tolerance also has a lower limit, because the contact's own speed is tiny where the sphere rests on the wall.
    """
    step.turned_at = turned_at(s)
    elastic, lossy, _, by_w, _ = force_at(p, law, s.per_v0, step.turned_at, s.w, s.speed, step)
    depth = s.w * s.w
    step.start_force = elastic + lossy
    from_columns = p.slowing_by_depth * depth + p.slowing_by_speed * s.speed  # subtracted from δ'' [m/s²]
    step.start_speed_slope = s.w * (step.acceleration[0] - from_columns - step.start_force * p.per_m_eff)
    vibration_speed = math.sqrt(0.5 * s.w * depth * abs(by_w) * p.per_m_eff)  # δ times the contact's own frequency
    step.contact_time_scale = depth / vibration_speed if vibration_speed > 0.0 else 0.0
    own_speed = max(abs(s.speed), vibration_speed, _LEAST_PART * p.speed_floor)
    step.goal = max(_CONVERGED * p.rtol * own_speed, _RESOLUTION * abs(s.speed))
    step.tolerance = p.rtol * max(own_speed, _AT_REST * abs(step.acceleration[0]) * step.fastest_time_scale)


@kernel
def _integrate_speeds(s: Record, step: Record, h: float) -> None:
    """Fill w, the square root of the indentation, and the time since the start of the step, at the stages of the step.

    w follows from the integral of the speeds δ' over χ, and the time from the integral of w. `h` is the step's length
    in χ.
    """
    for i in range(STAGES):
        w = 0.0
        for j in range(STAGES):
            w += MATRIX[i, j] * step.speed[j]
        step.w[i] = s.w + 0.5 * h * w
    for i in range(STAGES):
        since = 0.0
        for j in range(STAGES):
            since += MATRIX[i, j] * step.w[j]
        step.since[i] = h * since


@kernel
def _evaluate_acceleration(p: Record, step: Record) -> None:
    """Fill in the acceleration a_r at the stages, which presses sphere and wall together.

    a_r includes the effect of the correction z. It excludes the contact force and the columns' force due to δ itself.
    """
    z, k_1, c_1, share_per_m_1 = step.correction, p.k_1, p.c_1, p.share * p.per_m_1
    for i in range(STAGES):
        step.acceleration_at[i] = polynomial(step.acceleration, step.since[i], step.terms)
    for i in range(STAGES):
        step.acceleration_at[i] += share_per_m_1 * (k_1 * (z[X1, i] - z[XB, i]) + c_1 * (z[V1, i] - z[VB, i]))


@kernel
def _evaluate_slopes(p: Record, law: CompiledForce, s: Record, step: Record) -> None:
    """Fill in the contact force, the slope dδ'/dχ, and the derivatives of this slope by w and δ', at the stages.

    δ' is the rate of the indentation δ [m/s], w = √δ, and dt = w dχ. The derivatives treat the acceleration a_r, which
    presses sphere and wall together, as constant.
    """
    law.at_stages(p, s.per_v0, step)
    by_depth, by_speed, per_m_eff = p.slowing_by_depth, p.slowing_by_speed, p.per_m_eff
    for i in range(STAGES):
        w, speed = step.w[i], step.speed[i]
        from_columns = by_depth * w * w + by_speed * speed
        depth_acceleration = step.acceleration_at[i] - from_columns - step.force[i] * per_m_eff
        step.speed_slope[i] = w * depth_acceleration
        step.speed_slope_by_w[i] = depth_acceleration - w * (step.force_by_w[i] * per_m_eff + 2.0 * by_depth * w)
        step.speed_slope_by_speed[i] = -w * (step.force_by_speed[i] * per_m_eff + by_speed)


@kernel
def _set_newton(step: Record, h: float) -> None:
    """Fill `step.newton`, the matrix of Newton's method, with MATRIX⁻¹ − h ∂slope/∂δ' − (h²/2) ∂slope/∂w MATRIX.

    Newton's method solves δ' − δ'(start) − h MATRIX slope(δ') = 0 for the speeds δ' at the stages. The small part due
    to a_r(t) is missing; `_add_acceleration_to_newton` adds it.
    """
    newton = step.newton
    for i in range(STAGES):
        through_w = 0.5 * h * h * step.speed_slope_by_w[i]
        for j in range(STAGES):
            newton[i, j] = INVERSE[i, j] - through_w * MATRIX[i, j]
        newton[i, i] -= h * step.speed_slope_by_speed[i]


@kernel
def _add_acceleration_to_newton(step: Record, h: float) -> None:
    """Add to `step.newton`, the matrix of Newton's method, the part due to a_r(t): −(h³/2) ∂slope/∂t MATRIX².

    The slope is dδ'/dχ at the stages, and MATRIX the collocation matrix.
    """
    for i in range(STAGES):
        jerk = 0.0
        for n in range(step.terms - 1, 0, -1):
            jerk = jerk * step.since[i] + n * step.acceleration[n]
        through_time = 0.5 * h * h * h * step.w[i] * jerk
        for j in range(STAGES):
            matrix_squared = 0.0
            for q in range(STAGES):
                matrix_squared += MATRIX[i, q] * MATRIX[q, j]
            step.newton[i, j] -= through_time * matrix_squared


@kernel
def _invert_newton(step: Record) -> None:
    """Replace `step.newton`, the matrix of Newton's method, by its inverse (Gauss–Jordan, no pivoting)."""
    newton = step.newton
    for i in range(STAGES):
        per_pivot = 1.0 / newton[i, i]
        newton[i, i] = 1.0
        for j in range(STAGES):
            newton[i, j] *= per_pivot
        for row in range(STAGES):
            if row != i:
                factor = newton[row, i]
                newton[row, i] = 0.0
                for j in range(STAGES):
                    newton[row, j] -= factor * newton[i, j]


@kernel
def _newton_step(s: Record, step: Record, h: float) -> float:
    """Improve the speeds δ' at the stages by one step of Newton's method; return the largest change of a speed [m/s].

    The result is infinity if a change is not finite.
    """
    start_speed, change = s.speed, step.correction_slope[X1]  # the latter is scratch
    for i in range(STAGES):
        residual = h * step.speed_slope[i]
        for j in range(STAGES):
            residual += INVERSE[i, j] * (start_speed - step.speed[j])
        step.residual[i] = residual
    for i in range(STAGES):
        total = 0.0
        for j in range(STAGES):
            total += step.newton[i, j] * step.residual[j]
        change[i] = total
    largest = 0.0
    for i in range(STAGES):
        if not abs(change[i]) < math.inf:  # also for NaN, which `max` would ignore
            return math.inf
        step.speed[i] += change[i]
        largest = max(largest, abs(change[i]))
    return largest


@kernel
def solve(p: Record, law: CompiledForce, s: Record, step: Record, h: float, rounds: int) -> bool:
    """Solve the equations of a step of length h from s; return whether Newton's method converged in `rounds` rounds.

    The solution is stored in `step`, and its last stage is the end of the step. If the result is false, `step` contains
    no valid solution. A caller that may shorten the step passes FEW_ROUNDS, other callers pass ROUNDS. After
    FEW_ROUNDS, Newton's method also uses the derivative of the acceleration a_r(t), which matters while a sphere rests
    on the wall.
    """
    predict_speeds(s, step, h)
    step.correction[:] = 0.0
    last_change, contraction = 0.0, 1.0
    for n in range(rounds):
        _integrate_speeds(s, step, h)
        improve_correction(p, step, h)
        _evaluate_acceleration(p, step)
        _evaluate_slopes(p, law, s, step)
        if (n != 1 and contraction > _SLOW) or n >= FEW_ROUNDS:  # one round does not show how fast it converges
            _set_newton(step, h)
            if n >= FEW_ROUNDS:
                _add_acceleration_to_newton(step, h)
            _invert_newton(step)
        change = _newton_step(s, step, h)
        if change == math.inf:
            return False
        contraction = change / last_change if last_change > 0.0 else 1.0
        last_change = change
        remaining = change * contraction / (1.0 - contraction) if contraction < 0.5 else change
        if min(change, remaining) <= step.goal:
            _integrate_speeds(s, step, h)
            improve_correction(p, step, h)
            return True
    return False


@kernel
def estimate_error(step: Record, h: float) -> float:
    """Return the estimated error of the solved step as a multiple of the allowed error, `step.tolerance`.

    The estimate compares the slope at the start with the stages' slopes extrapolated to the start. A motion that decays
    within the step hardly counts (Hairer & Wanner, section IV.8).
    """
    defect = step.start_speed_slope
    for j in range(STAGES):
        defect -= TO_START[j] * step.speed_slope[j]
    filter_length = REAL_EIGENVALUE * h
    weight = filter_length / (
        1.0
        - filter_length * step.speed_slope_by_speed[LAST]
        - 0.5 * filter_length * filter_length * step.speed_slope_by_w[LAST]
    )
    stiff = h * abs(step.speed_slope_by_speed[LAST]) + 0.5 * h * h * abs(step.speed_slope_by_w[LAST])
    relief = max(1.0, _RELIEF / (1.0 + stiff * stiff))
    return abs(weight * defect) / (relief * step.tolerance)


@kernel
def next_length(h: float, error: float) -> float:
    """Return the length in χ [s/m^0.5] for the next step, or for another attempt at the same step.

    `h` is the length of the solved step, and `error` the result of `estimate_error` for it. The returned length is
    between 0.1 h and 4 h.
    """
    return h * min(4.0, max(0.1, 0.8 * power(max(error, 1e-9), -1.0 / ERROR_ORDER)))
