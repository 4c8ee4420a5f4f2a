# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Flight: the sphere is loose, the structure is linear, and both are known in closed form until a wall is reached.

**Drive.** Inside one segment u(t) = (A + B t) sin(ω t + φ). With y' = M y + b_0 u + b_1 u' and the resolvent
R(ω) = (jω − M)^-1 the linear system's particular answer to it is

    y_p(t) = Im[(P + Q t) exp(jωt)],   H = R (b_0 + jω b_1),   G = R (b_1 − H)
    Q = B e^{jφ} H,                    P = A e^{jφ} H + B e^{jφ} G

**Motion.** From the state y_0 at t_0, with the modes of `linear`,

    y(t) = Re Σ_n R_n c_n exp(λ_n (t − t_0)) + Im[(P + Q t) exp(jωt)] + static · friction_force
    c_n = L_n · (y_0 − y_p(t_0))
    x_2(t) = x_2(t_0) + v_2 (t − t_0) + braking (t − t_0)² / 2

`friction_force` [N] on the structure and `braking` [m/s²] of the sphere are the guide's friction, constant while the
sphere slides one way.

**Touch.** It is approached by conservative advancement. With speed v and acceleration a towards a target and
|jerk| <= j, a point covers within any h at most

    v t + (a + j h / 3) t² / 2,   0 <= t <= h

The first t at which that is the distance is safe if it comes before h, and h itself is safe otherwise. Repeated
advances close in on the first touch from before it and cannot step over it, however short or grazing the crossing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_rig.arithmetic.elementary import exp, modulus, power, sincos
from impact_rig.kernels import kernel
from impact_rig.physics.state import ORDERS, PARTED, STOPPED, TIME, TOUCHED, V1, X1

_THIRD = 1.0 / 3.0
_ROUNDS = 12
_CLOSE = 0.8  # how near to the best horizon is good enough
_TIME_RESOLUTION = 2.0**-51
_POSITION_RESOLUTION = 2.0**-47
_SHORTEST = 1e-3  # segments may be shorter than the time scale of rounding errors [s]

SEGMENT = np.dtype([(name, "f8") for name in ("duration", "omega", "phase", "amplitude", "slope", "begin")])
"""Drive segments, in order: seconds, rad/s, rad, and amplitude and its rate in A, m or V by drive. A segment begins a
tick of its own, or goes on `begin` > 0 seconds after the start of the tick of the one before."""


class Forcing(NamedTuple):
    """One segment of the drive."""

    omega: float
    phase: float
    amplitude: float
    slope: float
    begin: float


@kernel
def drive(f, t):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return u and u' at t."""
    level = f.amplitude + f.slope * t
    sine, cosine = sincos(f.omega * t + f.phase)
    return level * sine, f.slope * sine + level * f.omega * cosine


@kernel
def turned(angle):  # type: ignore[no-untyped-def]
    """Return exp(j angle)."""
    if angle == 0.0:  # at all times, where the drive is a straight line
        return 1.0 + 0.0j
    sine, cosine = sincos(angle)
    return complex(cosine, sine)


@kernel
def size(z):  # type: ignore[no-untyped-def]
    """Return |z|."""
    return modulus(z.real, z.imag)


@kernel
def bound_omega(system, omega):  # type: ignore[no-untyped-def]
    """Return the fastest rate [1/s] of the drive and the modes."""
    fastest = max(omega, 1e-9)
    for n in range(system.modes):
        fastest = max(fastest, size(system.rate[n]))
    return fastest


@kernel
def _half_reciprocal(z):  # type: ignore[no-untyped-def]
    """Return 1 / (2 z)."""
    scale = 0.5 / (z.real * z.real + z.imag * z.imag)
    return complex(z.real * scale, -z.imag * scale)


@kernel
def _resolve(system, omega, vector, out):  # type: ignore[no-untyped-def]
    """Fill out = (jω − M)^-1 vector; each kept mode stands for itself and its conjugate."""
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
def transfer(system, omega, flight):  # type: ignore[no-untyped-def]
    """Fill `flight.answer` (H) and `flight.drift` (G): what the system does for a steady and for a growing drive."""
    n = system.states
    vector = flight.steady  # scratch: `particular` fills it anew
    for i in range(n):
        vector[i] = complex(system.b_0[i], omega * system.b_1[i])
    _resolve(system, omega, vector, flight.answer)
    for i in range(n):
        vector[i] = complex(system.b_1[i] - flight.answer[i].real, -flight.answer[i].imag)
    _resolve(system, omega, vector, flight.drift)


@kernel
def particular(system, f, flight):  # type: ignore[no-untyped-def]
    """Fill `flight.steady` (P) and `flight.growing` (Q) for this segment's amplitude and phase."""
    turn = turned(f.phase)
    for i in range(system.states):
        flight.growing[i] = f.slope * turn * flight.answer[i]
        flight.steady[i] = f.amplitude * turn * flight.answer[i] + f.slope * turn * flight.drift[i]


@kernel
def safe_time(distance, v, a, jerk, horizon):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return a time, at most `horizon` [s], in which a point cannot cover `distance` [m]."""
    half = 0.5 * (a + jerk * horizon / 3.0)
    if v * horizon + half * horizon * horizon <= distance and (v <= 0.0 or v + 2.0 * half * horizon >= 0.0):
        return horizon  # most often: it ends nearer, and was never further out than there or where it began
    h = horizon
    if jerk > 0.0:
        h = min(
            h,
            3.0 * abs(a) / jerk + math.sqrt(6.0 * abs(v) / jerk) + power(6.0 * distance / jerk, _THIRD),
        )
    safe = 0.0
    for _ in range(_ROUNDS):
        half = 0.5 * (a + jerk * h / 3.0)
        under = v * v + 4.0 * half * distance
        reach = math.inf
        if v > 0.0:
            if under >= 0.0:
                reach = 2.0 * distance / (v + math.sqrt(under))
        elif half > 0.0:
            reach = (math.sqrt(under) - v) / (2.0 * half)
        if reach >= h:
            if h >= horizon:
                return horizon
            safe = h
            h = min(2.0 * h, reach, horizon)
        else:
            safe = max(safe, reach)
            if reach > _CLOSE * h or reach <= 0.0:
                break
            h = math.sqrt(h * reach)
    return safe


@kernel
def aim(system, f, flight, t_end):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Prepare a segment's particular solution and its part in the derivatives of x_1, with a bound on each."""
    particular(system, f, flight)
    jw = complex(0.0, f.omega)
    steady, growing = flight.steady[X1], flight.growing[X1]
    for order in range(ORDERS):
        flight.forced[order], flight.forced_growing[order] = steady, growing
        flight.forced_size[order] = size(steady) + size(growing) * t_end
        steady, growing = jw * steady + growing, jw * growing


@kernel
def decayed(rate, since):  # type: ignore[no-untyped-def]
    """Return exp(λ (t − t_0)): what has become of a mode's amplitude."""
    decay = exp(rate.real * since)
    sine, cosine = sincos(rate.imag * since)
    return decay, complex(decay * cosine, decay * sine)


@kernel
def launch(system, f, flight, y, t):  # type: ignore[no-untyped-def]
    """Fill the modes' amplitudes of the flight that begins at t with the state y, and their parts in x_1."""
    turn = turned(f.omega * t)
    flight.begin = t
    for i in range(system.states):
        forced = (flight.steady[i] + flight.growing[i] * t) * turn
        flight.y[i] = y[i] - forced.imag - system.static[i] * flight.friction_force
    for n in range(system.modes):
        amplitude = 0.0j
        for i in range(system.states):
            amplitude += system.left[n, i] * flight.y[i]
        flight.modal[n] = amplitude
        wave = system.right[n, X1] * amplitude
        for order in range(ORDERS):
            flight.wave[order, n] = wave
            flight.wave_size[order, n] = size(wave)
            wave = system.rate[n] * wave


@kernel
def evaluate(system, f, flight, t, order):  # type: ignore[no-untyped-def]
    """Fill `flight.x`, `v` and `a`: the derivatives of x_1 at t from `order` on; `flight.bound` bounds the next one."""
    since, wave = t - flight.begin, flight.wave
    turn = turned(f.omega * t)
    forced = (flight.forced[order] + flight.forced_growing[order] * t) * turn
    x = forced.imag
    forced = (flight.forced[order + 1] + flight.forced_growing[order + 1] * t) * turn
    v = forced.imag
    forced = (flight.forced[order + 2] + flight.forced_growing[order + 2] * t) * turn
    a = forced.imag
    bound = flight.forced_size[order + 3]
    if order == 0:
        x += system.static[X1] * flight.friction_force
    for n in range(system.modes):
        decay, z = decayed(system.rate[n], since)
        x += wave[order, n].real * z.real - wave[order, n].imag * z.imag
        v += wave[order + 1, n].real * z.real - wave[order + 1, n].imag * z.imag
        a += wave[order + 2, n].real * z.real - wave[order + 2, n].imag * z.imag
        bound += flight.wave_size[order + 3, n] * decay
    flight.x, flight.v, flight.a, flight.bound = x, v, a, bound


@kernel
def rounding(p, system, flight, t):  # type: ignore[no-untyped-def]
    """Return the rounding error [m] of the distance to a wall: that of the largest terms of x_1, with a margin."""
    largest = p.half_gap + size(flight.steady[X1]) + size(flight.growing[X1]) * t
    for n in range(system.modes):
        largest += flight.wave_size[0, n]
    return _POSITION_RESOLUTION * largest


@kernel
def arrive(system, f, flight, t):  # type: ignore[no-untyped-def]
    """Fill `flight.y` with the linear system's state at t."""
    turn = turned(f.omega * t)
    for i in range(system.states):
        forced = (flight.steady[i] + flight.growing[i] * t) * turn
        flight.y[i] = forced.imag + system.static[i] * flight.friction_force
    for n in range(system.modes):
        _, z = decayed(system.rate[n], t - flight.begin)
        wave = flight.modal[n] * z
        for i in range(system.states):
            right = system.right[n, i]
            flight.y[i] += right.real * wave.real - right.imag * wave.imag


@kernel
def negligible(step, t):  # type: ignore[no-untyped-def]
    """Whether a stride is lost in the rounding of the time."""
    return step <= _TIME_RESOLUTION * max(t, _SHORTEST)


@kernel
def wall_distance(p, s, side, d):  # type: ignore[no-untyped-def]
    """Return how far the sphere at d is from a wall [m]; a wall that has let it go stands where that was."""
    released = s.released if s.released_side == side else 0.0
    return max(0.0, p.half_gap + released - side * d)


@kernel
def fly(p, system, f, flight, s, t_end):  # type: ignore[no-untyped-def]
    """Advance a flight from s to the first touch or to t_end; return TOUCHED, STOPPED or TIME.

    On a touch the state is the one at the touch, with the distance to the wall `s.side` exactly zero;
    STOPPED: friction has brought the sphere to rest on its guide.
    """
    braking = -s.slide * p.friction
    launch(system, f, flight, s.y, s.t)
    evaluate(system, f, flight, s.t, 0)
    sphere_x, sphere_v = flight.x + s.d, flight.v + s.d_rate
    ended, t = TIME, s.t
    while p.sphere_present:
        since, rest = t - flight.begin, t_end - t
        d = sphere_x + since * (sphere_v + 0.5 * since * braking) - flight.x
        rate, bend, jerk = sphere_v + since * braking - flight.v, braking - flight.a, flight.bound
        ahead = 1.0 if rate >= 0.0 else -1.0  # the wall that the sphere moves to; the other one is seldom nearer
        step = safe_time(wall_distance(p, s, ahead, d), ahead * rate, ahead * bend, jerk, rest)
        behind = safe_time(wall_distance(p, s, -ahead, d), -ahead * rate, -ahead * bend, jerk, step)
        if behind < step:
            step, ahead = behind, -ahead
        stop, out = math.inf, math.inf
        if s.released > 0.0:
            out = safe_time(
                max(0.0, s.released_side * d - p.half_gap), -s.released_side * rate, -s.released_side * bend, jerk, rest
            )
            if negligible(out, t):
                s.released = 0.0  # the sphere is out of it: from here on the surface is whole again
                continue
        if s.slide != 0.0:
            evaluate(system, f, flight, t, 1)
            stop = safe_time(max(0.0, s.slide * rate), -s.slide * bend, s.slide * flight.a, flight.bound, rest)
        if min(step, stop, out) >= rest:
            break
        if stop < step and negligible(stop, t):
            ended = STOPPED
            break
        if step <= stop and negligible(step, t):
            ended, s.side = TOUCHED, ahead
            break
        t += min(step, stop, out)
        evaluate(system, f, flight, t, 0)
    if ended == TIME:
        t = t_end
    arrive(system, f, flight, t)
    for i in range(system.states):
        s.y[i] = flight.y[i]
    since = t - flight.begin
    s.t = t
    s.d_rate = 0.0 if ended == STOPPED else sphere_v + since * braking - s.y[V1]
    s.d = sphere_x + since * (sphere_v + 0.5 * since * braking) - s.y[X1]
    return ended


@kernel
def carry(p, system, f, flight, s, t_end):  # type: ignore[no-untyped-def]
    """Advance sphere and base as one body until they part or to t_end; return PARTED or TIME.

    `s.side` is the wall that presses the sphere, or 0 when guide friction holds it. It parts the way of `s.slide`.
    """
    launch(system, f, flight, s.y, s.t)
    t, ended = s.t, TIME
    while True:
        evaluate(system, f, flight, t, 2)
        rest = t_end - t
        # the structure may pull away to the right (the sphere lags: -1) or to the left (+1), but not through a wall
        lag, lead = math.inf, math.inf
        if s.side >= 0.0:
            lag = safe_time(max(0.0, p.friction - flight.x), flight.v, flight.a, flight.bound, rest)
        if s.side <= 0.0:
            lead = safe_time(max(0.0, p.friction + flight.x), -flight.v, -flight.a, flight.bound, rest)
        step = min(lag, lead)
        if step >= rest:
            t = t_end
            break
        if negligible(step, t):
            ended, s.slide = PARTED, -1.0 if lag < lead else 1.0
            break
        t += step
    arrive(system, f, flight, t)
    for i in range(system.states):
        s.y[i] = flight.y[i]
    s.t = t
    return ended
