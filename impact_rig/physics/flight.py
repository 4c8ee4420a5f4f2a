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
"""Closed forms of the motion between contacts: the structure is linear, the sphere is loose or one body with it.

**Drive.** Inside one segment the drive is u(t) = (A + B t) sin(ω t + φ), with u the current of the coil, the
displacement of the base or the voltage. The response of the linear system y' = M y + b_0 u + b_1 u' (see `linear`) to
it is

    y_p(t) = Im[(P + Q t) exp(jωt)],   H = (jω − M)⁻¹ (b_0 + jω b_1),   G = (jω − M)⁻¹ (b_1 − H)
    Q = B e^{jφ} H,                    P = A e^{jφ} H + B e^{jφ} G

**Motion.** From the state at t_b, where the flight begins, with the modes of `linear`,

    y(t) = y_p(t) + Re Σ_n Φ_n C_n exp(λ_n (t − t_b)) + static · friction_force
    C_n = Γ_n · (y(t_b) − y_p(t_b) − static · friction_force)
    x_2(t) = x_2(t_b) + v_2 (t − t_b) + braking (t − t_b)² / 2

`friction_force` [N] on the structure and `braking` [m/s²] of the sphere are the guide's friction, constant while the
sphere slides one way.

**Touch.** Conservative advancement finds it. With a speed and an acceleration towards a target and |jerk| <= J, a point
covers within a time called horizon at most

    speed t + (acceleration + J horizon / 3) t² / 2,   0 <= t <= horizon

The first t at which that is the distance is safe if it is before the horizon; otherwise the horizon itself is safe.
Repeated advances approach the first touch from before it and cannot step over it, however short or grazing the crossing
is. The same holds for a speed in place of the distance (a sliding sphere stops) and for an acceleration (the sphere
parts from the structure): speed, acceleration and J are then one and two derivatives higher.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from impact_rig.arithmetic.elementary import exp, modulus, power, sincos
from impact_rig.kernels import Complexes, Reals, Record, kernel
from impact_rig.physics.state import (
    ATTACHED,
    ORDERS,
    PARTED,
    PAUSED,
    SPHERE_ATTACHED,
    SPHERE_LOOSE,
    STOPPED,
    TOUCHED,
    V1,
    X1,
)

if TYPE_CHECKING:
    from impact_rig.physics.model import Model

_THIRD = 1.0 / 3.0
_ROUNDS = 12
_CLOSE = 0.8  # of the horizon: for a later crossing a shorter horizon is not worth trying
_TIME_RESOLUTION = 2.0**-51  # of t: an advance as short as this is lost in rounding
_POSITION_RESOLUTION = 2.0**-47  # of the largest terms of x_1, with a margin
_SHORTEST = 1e-3  # least t to which _TIME_RESOLUTION is relative [s]: earlier times are resolved as at that instant

SEGMENT = np.dtype(
    [
        ("duration", "f8"),  # of the segment [s]
        ("omega", "f8"),  # ω of the drive [rad/s]
        ("phase", "f8"),  # φ of the drive at the segment's start [rad]
        ("amplitude", "f8"),  # A of the drive at the segment's start [A, m or V, by drive]
        ("growth", "f8"),  # B, growth rate of the amplitude [A/s, m/s or V/s]
        ("begin", "f8"),  # when the segment begins, since the start of its tick [s]
    ]
)
"""Record of one drive segment, u(t) = (A + B t) sin(ω t + φ) with t from its start. A segment either begins a tick
(`begin` = 0) or continues the tick of the one before.
"""


class DriveSegment(NamedTuple):
    """One segment of the drive, u(t) = (amplitude + growth t) sin(omega t + phase), in the form of kernels' arguments.

    t counts from the start of the segment, and `begin` is the time from the start of the tick to that start [s].
    """

    omega: float
    phase: float
    amplitude: float
    growth: float
    begin: float


@kernel
def drive_segment(row: Record) -> DriveSegment:
    """Return one record of SEGMENT, without its duration, as the tuple that kernels pass to one another."""
    return DriveSegment(row.omega, row.phase, row.amplitude, row.growth, row.begin)


@kernel
def drive(f: DriveSegment, t: float) -> tuple[float, float]:
    """Return the drive u [A, m or V, by kind] and its rate u' at t seconds after the start of the segment f."""
    amplitude = f.amplitude + f.growth * t
    sine, cosine = sincos(f.omega * t + f.phase)
    return amplitude * sine, f.growth * sine + amplitude * f.omega * cosine


@kernel
def phasor(angle: float) -> complex:
    """Return exp(j angle), the angle in radians."""
    if angle == 0.0:  # always, if the drive is a straight line
        return 1.0 + 0.0j
    sine, cosine = sincos(angle)
    return complex(cosine, sine)


@kernel
def bound_omega(system: Record, omega: float) -> float:
    """Return the fastest rate in a flight [1/s]: the largest of |λ| of all modes and the drive's frequency `omega`."""
    fastest = max(omega, 1e-9)
    for n in range(system.modes):
        fastest = max(fastest, modulus(system.rate[n]))
    return fastest


@kernel
def _half_reciprocal(number: complex) -> complex:
    """Return 1 / (2 number) of a complex number."""
    scale = 0.5 / (number.real * number.real + number.imag * number.imag)
    return complex(number.real * scale, -number.imag * scale)


@kernel
def resolve(system: Record, omega: float, vector: Complexes, out: Complexes) -> None:
    """Compute `out` = (jω − M)⁻¹ `vector`, with M the system's matrix and ω = `omega` [rad/s].

    A mode of a conjugate pair is stored once and represents its conjugate, too.
    """
    for i in range(system.states):
        out[i] = 0.0j
    for n in range(system.modes):
        rate = system.rate[n]
        plus, minus = 0.0j, 0.0j
        for i in range(system.states):
            left = system.left[n, i]
            plus += left * vector[i]
            minus += complex(left.real, -left.imag) * vector[i]
        plus *= _half_reciprocal(complex(-rate.real, omega - rate.imag))
        minus *= _half_reciprocal(complex(-rate.real, omega + rate.imag))
        for i in range(system.states):
            right = system.right[n, i]
            out[i] += right * plus + complex(right.real, -right.imag) * minus


@kernel
def frequency_response(system: Record, omega: float, flight: Record) -> None:
    """Fill `flight.answer` (H) and `flight.growth_answer` (G) at the angular frequency `omega` [rad/s].

    H is the complex amplitude of the structural state y per unit of a drive of constant amplitude. G is the additional
    amplitude of y per unit of the growth rate of the drive's amplitude.
    """
    n = system.states
    vector = flight.steady  # scratch: `particular` overwrites it
    for i in range(n):
        vector[i] = complex(system.b_0[i], omega * system.b_1[i])
    resolve(system, omega, vector, flight.answer)
    for i in range(n):
        vector[i] = complex(system.b_1[i] - flight.answer[i].real, -flight.answer[i].imag)
    resolve(system, omega, vector, flight.growth_answer)


@kernel
def particular(system: Record, f: DriveSegment, flight: Record) -> None:
    """Compute `flight.steady` (P) and `flight.growing` (Q) of the response to a drive segment.

    The response is Im[(P + Q t) exp(jωt)], with t from the start of the segment. `flight.answer` and
    `flight.growth_answer` must belong to the frequency of the drive.
    """
    rotor = phasor(f.phase)
    for i in range(system.states):
        flight.growing[i] = f.growth * rotor * flight.answer[i]
        flight.steady[i] = f.amplitude * rotor * flight.answer[i] + f.growth * rotor * flight.growth_answer[i]


@kernel
def safe_time(distance: float, speed: float, acceleration: float, jerk_bound: float, longest: float) -> float:
    """Return a time [s], at most `longest`, before which a point certainly has not covered `distance` [m, >= 0].

    `speed` and `acceleration` are the present ones towards the target. `jerk_bound` limits the jerk in either direction
    during this time. At the distance 0 the result is 0 for a point that moves towards the target, and > 0 for a point
    that moves away from it. The docstring of this module explains the method.
    """
    half_acceleration = 0.5 * (acceleration + jerk_bound * longest / 3.0)  # the factor of t²
    if speed * longest + half_acceleration * longest * longest <= distance and (
        speed <= 0.0 or speed + 2.0 * half_acceleration * longest >= 0.0
    ):
        return longest  # most often: it ends nearer, and was never further out than there or at the start
    horizon = longest
    if jerk_bound > 0.0:
        shorter = 3.0 * abs(acceleration) / jerk_bound + math.sqrt(6.0 * abs(speed) / jerk_bound)
        if shorter < longest:  # otherwise the third part need not be known
            horizon = min(horizon, shorter + power(6.0 * distance / jerk_bound, _THIRD))
    safe = 0.0
    for _ in range(_ROUNDS):
        half_acceleration = 0.5 * (acceleration + jerk_bound * horizon / 3.0)
        discriminant = speed * speed + 4.0 * half_acceleration * distance
        crossing = math.inf
        if speed > 0.0:
            if discriminant >= 0.0:
                crossing = 2.0 * distance / (speed + math.sqrt(discriminant))
        elif half_acceleration > 0.0:
            crossing = (math.sqrt(discriminant) - speed) / (2.0 * half_acceleration)
        if crossing >= horizon:
            if horizon >= longest:
                return longest
            safe = horizon
            horizon = min(2.0 * horizon, crossing, longest)
        else:
            safe = max(safe, crossing)
            if crossing > _CLOSE * horizon or crossing <= 0.0:
                break
            horizon = math.sqrt(horizon * crossing)
    return safe


@kernel
def choose_system(model: Model, f: DriveSegment, s: Record, flight: Record) -> bool:
    """Set `flight.system` to the linear system that moves from the state s on; return whether anything was computed.

    The system is the structure with the sphere loose or attached. If the system or the frequency of the drive f has
    changed, `flight.answer` and `flight.growth_answer` are computed again, and the result is true. Otherwise they stay,
    and the result is false.
    """
    which = SPHERE_ATTACHED if s.phase == ATTACHED else SPHERE_LOOSE
    if f.omega == flight.omega and which == flight.system:
        return False
    frequency_response(model.systems[which], f.omega, flight)
    flight.omega, flight.system = f.omega, which
    return True


@kernel
def guide_friction(p: Record, s: Record) -> float:
    """Return the force of the guide's friction on the superior base [N], positive to the right.

    It is 0 in phase ATTACHED, in which the friction is an internal force of sphere and superior base.
    """
    return 0.0 if s.phase == ATTACHED else s.slide * p.m * p.friction_acceleration


@kernel
def prepare_segment(system: Record, f: DriveSegment, flight: Record, t_end: float) -> None:
    """Compute the response of a linear system to the drive segment f, and store it in `flight`.

    For x_1 and its derivatives, the response and a bound on it are stored as well. The bound is valid until `t_end`,
    the end of the segment [s].
    """
    particular(system, f, flight)
    jw = complex(0.0, f.omega)
    steady, growing = flight.steady[X1], flight.growing[X1]
    for order in range(ORDERS):
        flight.forced[order], flight.forced_growing[order] = steady, growing
        flight.forced_size[order] = modulus(steady) + modulus(growing) * t_end
        steady, growing = jw * steady + growing, jw * growing


@kernel
def mode_decay(rate: complex, since: float) -> tuple[float, complex]:
    """Return the modulus and the value of exp(λ since), the factor by which a mode changes in `since` seconds.

    λ is `rate`.
    """
    envelope = exp(rate.real * since)
    sine, cosine = sincos(rate.imag * since)
    return envelope, complex(envelope * cosine, envelope * sine)


@kernel
def begin_flight(system: Record, f: DriveSegment, flight: Record, y: Reals, t: float) -> None:
    """Compute the amplitudes of the modes in a flight that begins at t with the structural state y.

    Also compute the part of each mode in x_1 and its derivatives, and the modulus of this part as a bound. t is the
    time since the start of the drive segment [s].
    """
    rotor = phasor(f.omega * t)
    flight.t_b = t
    for i in range(system.states):
        forced = (flight.steady[i] + flight.growing[i] * t) * rotor
        flight.y[i] = y[i] - forced.imag - system.static[i] * flight.friction_force
    for n in range(system.modes):
        amplitude = 0.0j
        for i in range(system.states):
            amplitude += system.left[n, i] * flight.y[i]
        flight.modal[n] = amplitude
        wave = system.right[n, X1] * amplitude
        for order in range(ORDERS):
            flight.wave[order, n] = wave
            flight.wave_size[order, n] = modulus(wave)
            wave = system.rate[n] * wave


@kernel
def evaluate(system: Record, f: DriveSegment, flight: Record, t: float, order: int) -> None:
    """Compute three successive derivatives of x_1 at t, from the given `order` on; order 0 is x_1 itself.

    They are stored in `flight.x_1[order:order + 3]`. `flight.bound` becomes a bound on the derivative of order `order`
    + 3, valid from t to the end of the segment.
    """
    since, wave = t - flight.t_b, flight.wave
    rotor = phasor(f.omega * t)
    forced = (flight.forced[order] + flight.forced_growing[order] * t) * rotor
    derivative_0 = forced.imag
    forced = (flight.forced[order + 1] + flight.forced_growing[order + 1] * t) * rotor
    derivative_1 = forced.imag
    forced = (flight.forced[order + 2] + flight.forced_growing[order + 2] * t) * rotor
    derivative_2 = forced.imag
    bound = flight.forced_size[order + 3]
    if order == 0:
        derivative_0 += system.static[X1] * flight.friction_force
    for n in range(system.modes):
        envelope, decay = mode_decay(system.rate[n], since)
        derivative_0 += wave[order, n].real * decay.real - wave[order, n].imag * decay.imag
        derivative_1 += wave[order + 1, n].real * decay.real - wave[order + 1, n].imag * decay.imag
        derivative_2 += wave[order + 2, n].real * decay.real - wave[order + 2, n].imag * decay.imag
        bound += flight.wave_size[order + 3, n] * envelope
    x_1 = flight.x_1
    x_1[order], x_1[order + 1], x_1[order + 2], flight.bound = derivative_0, derivative_1, derivative_2, bound


@kernel
def rounding(p: Record, system: Record, flight: Record, t: float) -> float:
    """Return the rounding error [m] of a computed distance between sphere and wall at t, with a margin.

    The largest terms of x_1 determine it. A bounce lower than this cannot be computed. t counts from the start of the
    drive segment [s].
    """
    largest = p.half_gap + modulus(flight.steady[X1]) + modulus(flight.growing[X1]) * t
    for n in range(system.modes):
        largest += flight.wave_size[0, n]
    return _POSITION_RESOLUTION * largest


@kernel
def structure_at(system: Record, f: DriveSegment, flight: Record, t: float) -> None:
    """Fill `flight.y` with the structural state at t [s], since the start of the segment, by the closed form."""
    rotor = phasor(f.omega * t)
    for i in range(system.states):
        forced = (flight.steady[i] + flight.growing[i] * t) * rotor
        flight.y[i] = forced.imag + system.static[i] * flight.friction_force
    for n in range(system.modes):
        _, decay = mode_decay(system.rate[n], t - flight.t_b)
        modal = flight.modal[n] * decay
        for i in range(system.states):
            right = system.right[n, i]
            flight.y[i] += right.real * modal.real - right.imag * modal.imag


@kernel
def negligible(advance: float, t: float) -> bool:
    """Return whether the time step `advance` [s] is lost in the rounding of the time t [s].

    An event that is only so far ahead counts as reached. Times below `_SHORTEST` have the rounding of `_SHORTEST`.
    """
    return advance <= _TIME_RESOLUTION * max(t, _SHORTEST)


@kernel
def wall_distance(p: Record, s: Record, side: float, d: float) -> float:
    """Return the distance [m] from the sphere at d = x_2 − x_1 to the wall on `side` (−1 left, 1 right), at least 0.

    After a contact that ended at an indentation > 0, the surface of this wall is further back by `s.dent`, until the
    sphere has left the indentation.
    """
    dent = s.dent if s.dent_side == side else 0.0
    return max(0.0, p.half_gap + dent - side * d)


@kernel
def fly(p: Record, system: Record, f: DriveSegment, flight: Record, s: Record, t_end: float) -> int:
    """Advance a flight with a loose sphere to its first event or to `t_end`; return TOUCHED, STOPPED or PAUSED.

    The state s is moved to this instant. TOUCHED: the sphere touches the wall `s.side`; their distance is zero within
    rounding. STOPPED: friction has brought the sphere to rest relative to the superior base. PAUSED: `t_end` is
    reached, in seconds since the start of the segment. Without a sphere the result is always PAUSED.
    """
    braking, x_1 = -s.slide * p.friction_acceleration, flight.x_1
    begin_flight(system, f, flight, s.y, s.t)
    evaluate(system, f, flight, s.t, 0)
    x_2_start, v_2_start = x_1[0] + s.d, x_1[1] + s.d_rate  # where the flight begins
    ended, t = PAUSED, s.t
    while p.sphere_present:
        since, time_left = t - flight.t_b, t_end - t
        d = x_2_start + since * (v_2_start + 0.5 * since * braking) - x_1[0]
        d_rate, d_acceleration, jerk_bound = v_2_start + since * braking - x_1[1], braking - x_1[2], flight.bound
        side = 1.0 if d_rate >= 0.0 else -1.0  # the wall that the sphere moves to; the other one is rarely nearer
        time_to_wall = safe_time(
            wall_distance(p, s, side, d), side * d_rate, side * d_acceleration, jerk_bound, time_left
        )
        time_to_other = safe_time(
            wall_distance(p, s, -side, d), -side * d_rate, -side * d_acceleration, jerk_bound, time_to_wall
        )
        if time_to_other < time_to_wall:
            time_to_wall, side = time_to_other, -side
        time_to_stop, time_to_surface = math.inf, math.inf
        if s.dent > 0.0:
            inside, out = max(0.0, s.dent_side * d - p.half_gap), -s.dent_side
            time_to_surface = safe_time(inside, out * d_rate, out * d_acceleration, jerk_bound, time_left)
            if negligible(time_to_surface, t):
                s.dent = 0.0  # the sphere has left the indentation: from here on the surface is intact again
                continue
        if s.slide != 0.0:
            evaluate(system, f, flight, t, 1)
            time_to_stop = safe_time(
                max(0.0, s.slide * d_rate), -s.slide * d_acceleration, s.slide * x_1[3], flight.bound, time_left
            )
        if min(time_to_wall, time_to_stop, time_to_surface) >= time_left:
            break
        if time_to_stop < time_to_wall and negligible(time_to_stop, t):
            ended = STOPPED
            break
        if time_to_wall <= time_to_stop and negligible(time_to_wall, t):
            ended, s.side = TOUCHED, side
            break
        t += min(time_to_wall, time_to_stop, time_to_surface)
        evaluate(system, f, flight, t, 0)
    if ended == PAUSED:
        t = t_end
    structure_at(system, f, flight, t)
    for i in range(system.states):
        s.y[i] = flight.y[i]
    since = t - flight.t_b
    s.t = t
    s.d_rate = 0.0 if ended == STOPPED else v_2_start + since * braking - s.y[V1]
    s.d = x_2_start + since * (v_2_start + 0.5 * since * braking) - s.y[X1]
    return ended


@kernel
def fly_attached(p: Record, system: Record, f: DriveSegment, flight: Record, s: Record, t_end: float) -> int:
    """Advance sphere and superior base as one body until they part or to `t_end`; return PARTED or PAUSED.

    The state s is moved to this instant. `t_end` is the end of the drive segment, since its start [s]. `s.side` is the
    wall that presses the sphere, or 0 if guide friction holds it. They part when the acceleration |x_1''| reaches the
    limit of friction μ g_0, which is 0 without friction. A sphere at a wall parts only if this wall accelerates away
    from it. After PARTED, `s.slide` is the direction, −1 or 1, in which the sphere moves relative to the base.
    """
    begin_flight(system, f, flight, s.y, s.t)
    t, ended, x_1 = s.t, PAUSED, flight.x_1
    while True:
        evaluate(system, f, flight, t, 2)
        time_left = t_end - t
        # the structure may pull away to the right (the sphere lags: -1) or to the left (+1), but not through a wall
        time_to_lag, time_to_lead = math.inf, math.inf
        if s.side >= 0.0:
            time_to_lag = safe_time(max(0.0, p.friction_acceleration - x_1[2]), x_1[3], x_1[4], flight.bound, time_left)
        if s.side <= 0.0:
            time_to_lead = safe_time(
                max(0.0, p.friction_acceleration + x_1[2]), -x_1[3], -x_1[4], flight.bound, time_left
            )
        advance = min(time_to_lag, time_to_lead)
        if advance >= time_left:
            t = t_end
            break
        if negligible(advance, t):
            ended, s.slide = PARTED, -1.0 if time_to_lag < time_to_lead else 1.0
            break
        t += advance
    structure_at(system, f, flight, t)
    for i in range(system.states):
        s.y[i] = flight.y[i]
    s.t = t
    return ended
