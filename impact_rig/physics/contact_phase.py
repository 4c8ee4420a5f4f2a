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
"""Integration of a contact between sphere and wall, step by step from touch to separation.

δ is the indentation, w = √δ, and a step has a length in χ, with dt = w dχ (see `contact_step`, which solves the step):

    dw/dχ = δ'/2,    dt/dχ = w,    dδ'/dχ = w δ'',    F: the law's force, elastic and lossy part together

In a contact the state y holds the centre of mass of superior base and sphere, x_1* = x_1 + side σ δ. `side` is −1 for
the left and 1 for the right wall, and σ is the mass of the sphere divided by the mass of both bodies. The functions
share some argument names: p are the parameters, law is the contact law's force, f the drive, s the state, and step the
step with its stages. A slope is a derivative by χ. The `excess` of an event is how far a point is beyond the event, in
units of the event's scale.

The error estimate determines where a step ends, unless one of these events comes first:

    SEPARATED  w = 0          the sphere is off the wall
    PAUSED     t = t_end      the drive segment is over
    RELEASED   F = 0, δ > 0   a law that lets go would pull: the surface stays behind until the sphere has left it
    TURNED     δ' = 0         a law with a memory changes branch at the largest indentation
    RELOADED   w = deepest_w  the sphere presses deeper than before, and the law changes branch again

A step that overshoots an event is solved again, with a length found by Newton's method, so that it ends at the event.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from impact_rig.arithmetic.elementary import power
from impact_rig.kernels import Record, kernel
from impact_rig.physics.collocation import GAUSS_NODES, GAUSS_WEIGHTS, LAST, MATRIX, POINTS, STAGES
from impact_rig.physics.contact_step import (
    FEW_ROUNDS,
    ROUNDS,
    add_correction,
    begin_step,
    dense_output,
    dense_slope,
    estimate_error,
    expand,
    force_at,
    keep_dense_output,
    next_length,
    pair_at,
    solve,
    turned_at,
)
from impact_rig.physics.energy import add_powers
from impact_rig.physics.state import FAILED, NOTHING, PAUSED, RELEASED, RELOADED, SEPARATED, TURNED, V1, X1

if TYPE_CHECKING:
    from impact_rig.physics.contact.law import CompiledForce
    from impact_rig.physics.flight import DriveSegment
    from impact_rig.physics.model import Model

_IN_ORDER = (SEPARATED, PAUSED, RELEASED, TURNED, RELOADED)  # after SEPARATED the others have no meaning

_REJECTIONS = 60
_ATTEMPTS = 12  # Newton's method needs two to four
_REACHED = 1e-10  # of the quantity's own scale: the accuracy to which Newton's method solves a step
_COLLAPSED = 1e-4  # of w at the step's start: a step with a smaller w at a stage is rejected, see `_first_event`
_SMALLEST = 1e-300
_FIRST_LENGTH = 0.2  # of √(time/v0), half of ∫ dt/√(v0 t), see `first_length`
_HOP = 3.0  # of the pressing acceleration, see `settles`
_GUESSES, _NEAR = 12, 1e-6  # of the event's scale: the accuracy of a step's polynomial
_PEAK_FOUND = 1e-5  # of a step: the force is flat there
_PEAK_MARGIN = 0.95  # of an earlier peak: a step whose stages all stay below this cannot exceed the peak between them
_PART_OF_FALL, _RADIANS = 0.4, 8.0  # see `_limit_length`


@kernel
def _force_and_slope(
    p: Record, law: CompiledForce, s: Record, step: Record, point: tuple[float, float, float]
) -> tuple[float, float]:
    """Return the contact force F [N] at a point of a step, and the derivative dF/dχ along the motion.

    `point` is (w, δ', dδ'/dχ), with w the square root of the indentation δ. χ is the variable of integration, dt = w
    dχ.
    """
    w, speed, slope = point
    elastic, lossy, _, by_w, by_speed = force_at(p, law, s.per_v0, step.turned_at, w, speed, step)
    return elastic + lossy, 0.5 * by_w * speed + by_speed * slope


@kernel
def _excess(
    p: Record, law: CompiledForce, s: Record, step: Record, event: int, at: tuple[float, float, float]
) -> float:
    """Return how far a point of a contact's step is beyond an event, as a multiple of the event's own scale.

    The value is at most 0 if the point is before the event, or if the law has no such event. `at` is the point: (time
    since the start of the step [s], w, δ'), with w the square root of the indentation δ.
    """
    since, w, speed = at
    if event == SEPARATED:
        return -w / max(s.w, s.deepest_w, _SMALLEST)
    if event == PAUSED:
        return (since - step.time_left) / step.time_left
    if event == RELEASED:
        if not p.lets_go:
            return -1.0
        elastic, lossy, _, _, _ = force_at(p, law, s.per_v0, step.turned_at, w, speed, step)
        return -(elastic + lossy) / max(step.start_force, s.peak_force, _SMALLEST)
    if event == TURNED:
        return -speed / s.speed if p.remembers and step.turned_at == 0.0 and s.speed > 0.0 else -1.0
    return (w - s.deepest_w) / s.deepest_w if p.remembers and s.w < s.deepest_w else -1.0


@kernel
def _excess_slope(p: Record, law: CompiledForce, s: Record, step: Record, event: int) -> float:
    """Return the derivative of `_excess` by the length of the step in χ, at the end of the solved step."""
    w, speed = step.w[LAST], step.speed[LAST]
    if event == SEPARATED:
        return -0.5 * speed / max(s.w, s.deepest_w, _SMALLEST)
    if event == PAUSED:
        return w / step.time_left
    if event == RELEASED:
        _, slope = _force_and_slope(p, law, s, step, (w, speed, step.speed_slope[LAST]))
        return -slope / max(step.start_force, s.peak_force, _SMALLEST)
    if event == TURNED:
        return -step.speed_slope[LAST] / s.speed
    return 0.5 * speed / s.deepest_w


@kernel
def _length_by_dense_output(p: Record, law: CompiledForce, s: Record, step: Record, event: int) -> float:
    """Return an estimate of the length in χ with which a step that has passed an event would end at the event.

    The step must be solved, and its dense output stored. The dense output is the polynomial through the step's stages.
    The estimate is the root of `_excess` on this polynomial, found by the Illinois method.
    """
    low, high, x, last_moved = 0.0, 1.0, 1.0, 0
    excess_low = _excess(p, law, s, step, event, dense_output(s, step, low))
    excess_high = _excess(p, law, s, step, event, dense_output(s, step, high))
    excess_low = excess_low if excess_low < 0.0 else -excess_high  # the step may have started at the same event
    for _ in range(_GUESSES):
        x = (low * excess_high - high * excess_low) / (excess_high - excess_low)
        excess = _excess(p, law, s, step, event, dense_output(s, step, x))
        if abs(excess) <= _NEAR:
            break
        if excess > 0.0:
            high, excess_high = x, excess
            excess_low *= 0.5 if last_moved == 1 else 1.0
            last_moved = 1
        else:
            low, excess_low = x, excess
            excess_high *= 0.5 if last_moved == -1 else 1.0
            last_moved = -1
    return x * s.h


@kernel
def _end_at(p: Record, law: CompiledForce, s: Record, step: Record, event: int) -> bool:
    """Solve the step again with other lengths until it ends at the event; return whether that succeeded.

    The length is searched between 0 and the old `s.h`, and stored in `s.h` [s/m^0.5]. The search fails if a step of
    some length has no solution.
    """
    low, high = 0.0, s.h
    s.h = _length_by_dense_output(p, law, s, step, event)
    for _ in range(_ATTEMPTS):
        if not solve(p, law, s, step, s.h, ROUNDS):
            return False
        excess = _excess(p, law, s, step, event, (step.since[LAST], step.w[LAST], step.speed[LAST]))
        if abs(excess) <= _REACHED:
            break
        if excess > 0.0:
            high = s.h
        else:
            low = s.h
        slope = _excess_slope(p, law, s, step, event)
        s.h = s.h - excess / slope if slope > 0.0 else low
        if not low < s.h < high:
            s.h = 0.5 * (low + high)
    else:  # as near as numbers resolve; solve once more, so that `step` is the step of length s.h
        if not solve(p, law, s, step, s.h, ROUNDS):
            return False
    keep_dense_output(s, step)
    return True


@kernel
def _first_event(p: Record, law: CompiledForce, s: Record, step: Record) -> int:
    """Shorten the solved step to the first event that it passed; return this event, NOTHING or FAILED.

    NOTHING means that the step passed no event. FAILED means that the caller must try a shorter step: the shortened
    step has no solution or is not exact enough, or its solution is not physical.
    """
    ended = NOTHING
    for event in _IN_ORDER:
        if _excess(p, law, s, step, event, (step.since[LAST], step.w[LAST], step.speed[LAST])) > _REACHED:
            if not _end_at(p, law, s, step, event) or estimate_error(step, s.h) > 1.0:
                return FAILED
            ended = event
    if ended == SEPARATED and step.speed[LAST] > 0.0:  # no sphere leaves inwards: another false solution
        return FAILED
    for i in range(STAGES):
        least_w = 0.0 if ended == SEPARATED and i >= LAST - 1 else _COLLAPSED * s.w
        if not step.w[i] > least_w and not (ended == SEPARATED and i == LAST):
            return FAILED
    return ended if step.since[LAST] > 0.0 else FAILED


@kernel
def _limit_length(s: Record, step: Record) -> float:
    """Return the length in χ for the next step: `s.next_h`, or less if polynomials are not valid for so long.

    Before a resting sphere lifts off, the length is also limited to a part of the time until the lift-off, because
    polynomials cannot follow the indentation up to there.
    """
    if not s.w > 0.0:
        return s.next_h
    longest = step.valid_for  # [s]
    constant, linear, quadratic = step.acceleration[0], step.acceleration[1], step.acceleration[2]
    discriminant = linear * linear - 4.0 * constant * quadratic
    if constant > 0.0 and discriminant > 0.0:
        fall_rate = math.sqrt(discriminant) - linear  # [m/s³]: a_r is zero 2 constant / fall_rate from here
        if fall_rate > 0.0:
            longest = min(longest, max(_PART_OF_FALL * 2.0 * constant / fall_rate, _RADIANS * step.contact_time_scale))
    return min(s.next_h, longest / s.w)


@kernel
def take_step(p: Record, law: CompiledForce, s: Record, step: Record) -> int:
    """Solve the next step of a contact; return the event at the end of the step, NOTHING or FAILED.

    NOTHING means that no event ends the step. FAILED means that no tried length gave a valid step. `expand` must have
    filled `step` about s, and `step.time_left` must be the time to the end of the drive segment [s]. `s.h` becomes the
    length of the step in χ, and `s.next_h` the proposed length of the following step. The rest of s does not change
    until `conclude` moves it.
    """
    begin_step(p, law, s, step)
    s.h = _limit_length(s, step)
    for _ in range(_REJECTIONS):
        if not solve(p, law, s, step, s.h, FEW_ROUNDS):
            s.h *= 0.25
        elif step.since[LAST] > step.valid_for:
            s.h *= 0.9 * step.valid_for / step.since[LAST]
        else:
            keep_dense_output(s, step)
            error = estimate_error(step, s.h)
            if error <= 1.0:
                s.next_h = next_length(s.h, error)
                ended = _first_event(p, law, s, step)
                if ended != FAILED:
                    return ended
                s.h *= 0.5  # closer to the event, the remaining step is easier to solve
            else:
                s.h = next_length(s.h, error)
    return FAILED


@kernel
def take_next_step(model: Model, f: DriveSegment, s: Record, step: Record, t_end: float) -> int:
    """Prepare and solve the next step of the contact in the state s; return the result of `take_step`.

    `t_end` is the end of the drive segment, since its start [s]. Only `h` and `next_h` of s change. `conclude` then
    moves the rest of s.
    """
    p = model.parameters[0]
    expand(p, f, s, step)
    if s.next_h == 0.0:
        s.next_h = first_length(p, s.approach, step.acceleration[0])
    step.time_left = t_end - s.t
    return take_step(p, model.law, s, step)


@kernel
def dissipated(step: Record, h: float) -> float:
    """Return the energy [J] that the contact loses during the solved step.

    `h` is the length of the step in χ, with dt = √δ dχ and δ the indentation. The quadrature is that of the
    collocation.
    """
    lost = 0.0
    for i in range(STAGES):
        lost += h * MATRIX[LAST, i] * step.w[i] * step.lossy[i] * step.speed[i]
    return lost


@kernel
def _find_peak(p: Record, law: CompiledForce, s: Record, step: Record, of_force: bool) -> float:
    """Return the point of the solved step at which the force (if `of_force`) or else the indentation is largest.

    The result is a fraction of the step's length in χ: 0 is the start of the step and 1 its end. The point is found by
    bisection, on the polynomial through the step's stages.
    """
    low, high = 0.0, 1.0
    while high - low > _PEAK_FOUND:
        middle = 0.5 * (low + high)
        _, w, slope = dense_output(s, step, middle)
        if of_force:
            _, slope = _force_and_slope(p, law, s, step, (w, slope, dense_slope(step, middle)))
        if slope > 0.0:
            low = middle
        else:
            high = middle
    return low


@kernel
def find_peaks(p: Record, law: CompiledForce, s: Record, step: Record) -> None:
    """Raise `s.peak_force` [N] and `s.deepest_w` [m^0.5] to the largest values in the step, also between its stages.

    To find a maximum between stages, another step is solved that ends at the predicted maximum. If w is largest at the
    end of the step, `conclude` updates `s.deepest_w` instead.
    """
    w, speed, slope = step.w[LAST], step.speed[LAST], step.speed_slope[LAST]
    _, start_slope = _force_and_slope(p, law, s, step, (s.w, s.speed, step.start_speed_slope))
    end_force, end_slope = _force_and_slope(p, law, s, step, (w, speed, slope))
    force_before, deepest_before = _PEAK_MARGIN * s.peak_force, _PEAK_MARGIN * s.deepest_w
    s.peak_force = max(s.peak_force, step.start_force, end_force)
    largest_force, largest_w = 0.0, 0.0
    for i in range(STAGES):
        largest_force, largest_w = max(largest_force, step.force[i]), max(largest_w, step.w[i])
    of_force = start_slope > 0.0 > end_slope and largest_force >= force_before
    of_depth = not p.remembers and s.speed > 0.0 > speed and largest_w >= deepest_before
    if of_force:
        h = s.h * _find_peak(p, law, s, step, True)
        if solve(p, law, s, step, h, ROUNDS):
            peak, _ = _force_and_slope(p, law, s, step, (step.w[LAST], step.speed[LAST], step.speed_slope[LAST]))
            s.peak_force = max(s.peak_force, peak)
    if of_depth:
        h = s.h * _find_peak(p, law, s, step, False)
        if solve(p, law, s, step, h, ROUNDS):
            w, speed, slope = step.w[LAST], step.speed[LAST], step.speed_slope[LAST]
            depth = w * w
            if slope < 0.0:
                depth -= 0.5 * w * speed * speed / slope  # δ'' = slope / w
            s.deepest_w = max(s.deepest_w, math.sqrt(depth))
    if of_force or of_depth:  # solve once more, so that `step` is the step of length s.h
        solve(p, law, s, step, s.h, ROUNDS)


@kernel
def account_step(p: Record, f: DriveSegment, s: Record, step: Record, ledger: Record) -> None:
    """Add the drive's work and the losses in columns and shaker during one step of a contact to `ledger` [J].

    The step must be solved, and the state s must still be at the start of the step.
    """
    half = 0.5 * step.since[LAST]
    for point in range(POINTS):
        since = half * (1.0 + GAUSS_NODES[point])
        pair_at(step, since, step.y)
        add_powers(p, f, step.y, s.t + since, half * GAUSS_WEIGHTS[point], ledger)
    for i in range(STAGES):
        weight = s.h * MATRIX[LAST, i] * step.w[i]
        pair_at(step, step.since[i], step.y)
        add_powers(p, f, step.y, s.t + step.since[i], -weight, ledger)
        add_correction(p, s.side, step, i, step.y)
        step.y[X1] -= p.share * s.side * step.w[i] * step.w[i]
        step.y[V1] -= p.share * s.side * step.speed[i]
        add_powers(p, f, step.y, s.t + step.since[i], weight, ledger)


@kernel
def conclude(p: Record, s: Record, step: Record, ended: int, t_end: float) -> None:
    """Move the state s to the end of its solved step; update the contact's duration, impulse and largest indentation.

    `ended` is the event at the end of the step. `t_end` is the end of the drive segment [s], to which `s.t` is set if
    `ended` is PAUSED.
    """
    since, w, speed = step.since[LAST], max(step.w[LAST], 0.0), step.speed[LAST]
    v_2_before = s.y[V1] + s.side * (1.0 - p.share) * s.speed
    pair_at(step, since, s.y)
    add_correction(p, s.side, step, LAST, s.y)
    s.impulse -= s.side * p.m * (s.y[V1] + s.side * (1.0 - p.share) * speed - v_2_before)
    s.elapsed += since
    step.dense_since = step.dense_length  # the next step starts where this one ends
    s.w = 0.0 if ended == SEPARATED else w
    s.speed = 0.0 if ended == TURNED else speed
    if ended == RELOADED:
        s.w = s.deepest_w
    s.deepest_w = max(s.deepest_w, s.w)
    s.t = t_end if ended == PAUSED else s.t + since


@kernel
def settles(p: Record, law: CompiledForce, s: Record, step: Record) -> bool:
    """Return whether a contact at its largest indentation now only rings slowly about its rest position.

    The caller asks this for a law with a memory only. The speed of the ringing must be at most `speed_floor`, and its
    acceleration at most 3 times the acceleration that presses sphere and wall together.
    """
    elastic, lossy, _, by_w, _ = force_at(p, law, s.per_v0, turned_at(s), s.w, s.speed, step)
    pressing = step.acceleration[0]  # a_r at the start of the step, which hardly changes within one
    ringing_acceleration = abs(pressing - (elastic + lossy) * p.per_m_eff)  # |δ''| [m/s²]
    return ringing_acceleration <= _HOP * pressing and ringing_acceleration <= p.speed_floor * math.sqrt(
        0.5 * by_w * p.per_m_eff / s.w
    )


@kernel
def t_0_of(p: Record, speed: float) -> float:
    """Return the time scale t_0 = (m_eff/K)^(1/(1+b)) v0^((1−b)/(1+b)) [s] of a contact with F ~ K δ^b.

    `speed` is the approach speed v0 [m/s].
    """
    return p.time_scale * power(speed, p.time_power)


@kernel
def first_length(p: Record, speed: float, acceleration: float) -> float:
    """Return the length in χ [s/m^0.5] for the first step of a contact.

    `speed` is the approach speed v0 [m/s], and `acceleration` [m/s²] presses sphere and wall together. The length is
    0.2 √(time/v0), with the shorter of two times: the contact's time scale `t_0_of`, and v0 / |`acceleration`|.
    """
    scale = min(t_0_of(p, speed), speed / max(abs(acceleration), _SMALLEST))
    return _FIRST_LENGTH * math.sqrt(scale / speed)
