# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Flight: the sphere is loose, the structure is linear, and both are known in closed form until a wall is reached.

**Drive.** Inside one segment u(t) = (A + B t) sin(ω t + φ). With y' = M y + b_0 u + b_1 u' and the resolvent
R(ω) = (jω − M)^-1 the linear system's particular answer to it is

    y_p(t) = Im[(P + Q t) exp(jωt)],   H = R (b_0 + jω b_1),   G = R (b_1 − H)
    Q = B e^{jφ} H,                    P = A e^{jφ} H + B e^{jφ} G

**Motion.** From the state y_0 at t_0, with the modes of `linear`,

    y(t) = Re Σ_k R_k c_k exp(λ_k (t − t_0)) + Im[(P + Q t) exp(jωt)] + static · push,   c_k = L_k · (y_0 − y_p(t_0))
    x_2(t) = x_2(t_0) + v_2 (t − t_0) + braking (t − t_0)² / 2

`push` [N] and `braking` [m/s²] are the guide's friction, constant while the sphere slides one way.

**Touch.** It is approached by conservative advancement. With speed v and acceleration a towards a target and
|jerk| <= j, a point covers within any h at most

    v τ + (a + j h / 3) τ² / 2,   0 <= τ <= h

The first τ at which that is the distance is safe if it comes before h, and h itself is safe otherwise. Repeated
advances close in on the first touch from before it and cannot step over it, however short or grazing the crossing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_rig.arithmetic.elementary import exp, modulus, power, sincos
from impact_rig.kernels import kernel
from impact_rig.physics.state import ORDERS, V1, X1

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
    for k in range(system.modes):
        fastest = max(fastest, size(system.rate[k]))
    return fastest


@kernel
def _half_reciprocal(z):  # type: ignore[no-untyped-def]
    """Return 1 / (2 z)."""
    scale = 0.5 / (z.real * z.real + z.imag * z.imag)
    return complex(z.real * scale, -z.imag * scale)


@kernel
def _resolve(system, omega, vector, out):  # type: ignore[no-untyped-def]
    """Fill out = (jω − M)^-1 vector; each kept mode stands for itself and its conjugate."""
    n = system.states
    for i in range(n):
        out[i] = 0.0j
    for k in range(system.modes):
        rate = system.rate[k]
        plus, minus = 0.0j, 0.0j
        for i in range(n):
            left = system.left[k, i]
            plus += left * vector[i]
            minus += complex(left.real, -left.imag) * vector[i]
        plus *= _half_reciprocal(complex(-rate.real, omega - rate.imag))
        minus *= _half_reciprocal(complex(-rate.real, omega + rate.imag))
        for i in range(n):
            right = system.right[k, i]
            out[i] += right * plus + complex(right.real, -right.imag) * minus


@kernel
def transfer(system, omega, k):  # type: ignore[no-untyped-def]
    """Fill `k.answer` (H) and `k.drift` (G): what the system does for a steady and for a growing drive."""
    n = system.states
    vector = k.steady  # scratch: `particular` fills it anew
    for i in range(n):
        vector[i] = complex(system.b_0[i], omega * system.b_1[i])
    _resolve(system, omega, vector, k.answer)
    for i in range(n):
        vector[i] = complex(system.b_1[i] - k.answer[i].real, -k.answer[i].imag)
    _resolve(system, omega, vector, k.drift)


@kernel
def particular(system, f, k):  # type: ignore[no-untyped-def]
    """Fill `k.steady` (P) and `k.growing` (Q) for this segment's amplitude and phase."""
    turn = turned(f.phase)
    for i in range(system.states):
        k.growing[i] = f.slope * turn * k.answer[i]
        k.steady[i] = f.amplitude * turn * k.answer[i] + f.slope * turn * k.drift[i]


_THIRD = 1.0 / 3.0
_ROUNDS = 12
_CLOSE = 0.8  # how near to the best horizon is good enough


@kernel
def stride(distance, speed, acceleration, jerk, horizon):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return a time, at most `horizon` [s], in which a point cannot cover `distance` [m]."""
    h = horizon
    if jerk > 0.0:
        h = min(
            h,
            3.0 * abs(acceleration) / jerk + math.sqrt(6.0 * abs(speed) / jerk) + power(6.0 * distance / jerk, _THIRD),
        )
    safe = 0.0
    for _ in range(_ROUNDS):
        half = 0.5 * (acceleration + jerk * h / 3.0)
        under = speed * speed + 4.0 * half * distance
        reach = math.inf
        if speed > 0.0:
            if under >= 0.0:
                reach = 2.0 * distance / (speed + math.sqrt(under))
        elif half > 0.0:
            reach = (math.sqrt(under) - speed) / (2.0 * half)
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


STOPPED = 2
"""Returned by `fly` when friction brings the sphere to rest on its guide."""

_TIME_RESOLUTION = 2.0**-51
_POSITION_RESOLUTION = 2.0**-47
_SHORTEST = 1e-3  # segments may be shorter than the time scale of rounding errors [s]


@kernel
def aim(system, f, k, t_end):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Prepare a segment's particular solution and its part in the derivatives of x_1, with a bound on each."""
    particular(system, f, k)
    jw = complex(0.0, f.omega)
    steady, growing = k.steady[X1], k.growing[X1]
    for n in range(ORDERS):
        k.forced[n], k.forced_growing[n] = steady, growing
        k.forced_size[n] = size(steady) + size(growing) * t_end
        steady, growing = jw * steady + growing, jw * growing


@kernel
def launch(system, f, k, y, t):  # type: ignore[no-untyped-def]
    """Fill the modes' amplitudes of the flight that begins at t with the state y, and their parts in x_1."""
    turn = turned(f.omega * t)
    k.begin = t
    for i in range(system.states):
        forced = (k.steady[i] + k.growing[i] * t) * turn
        k.y[i] = y[i] - forced.imag - system.static[i] * k.push
    for m in range(system.modes):
        amplitude = 0.0j
        for i in range(system.states):
            amplitude += system.left[m, i] * k.y[i]
        k.modal[m] = amplitude
        wave = system.right[m, X1] * amplitude
        for n in range(ORDERS):
            k.wave[n, m] = wave
            k.wave_size[n, m] = size(wave)
            wave = system.rate[m] * wave


@kernel
def look(system, f, k, t, order):  # type: ignore[no-untyped-def]
    """Fill `k.value`, `k.slope`, `k.bend`: the derivatives of x_1 at t from `order` on; `k.bound` bounds the next."""
    since = t - k.begin
    turn = turned(f.omega * t)
    forced = (k.forced[order] + k.forced_growing[order] * t) * turn
    value = forced.imag
    forced = (k.forced[order + 1] + k.forced_growing[order + 1] * t) * turn
    slope = forced.imag
    forced = (k.forced[order + 2] + k.forced_growing[order + 2] * t) * turn
    bend = forced.imag
    bound = k.forced_size[order + 3]
    if order == 0:
        value += system.static[X1] * k.push
    for m in range(system.modes):
        rate = system.rate[m]
        decay = exp(rate.real * since)
        sine, cosine = sincos(rate.imag * since)
        real, imag = decay * cosine, decay * sine
        value += k.wave[order, m].real * real - k.wave[order, m].imag * imag
        slope += k.wave[order + 1, m].real * real - k.wave[order + 1, m].imag * imag
        bend += k.wave[order + 2, m].real * real - k.wave[order + 2, m].imag * imag
        bound += k.wave_size[order + 3, m] * decay
    k.value, k.slope, k.bend, k.bound = value, slope, bend, bound


@kernel
def rounding(p, system, k, t):  # type: ignore[no-untyped-def]
    """Return the rounding error [m] of the distance to a wall: that of the largest terms of x_1, with a margin."""
    largest = p.half_gap + size(k.steady[X1]) + size(k.growing[X1]) * t
    for m in range(system.modes):
        largest += k.wave_size[0, m]
    return _POSITION_RESOLUTION * largest


@kernel
def arrive(system, f, k, t):  # type: ignore[no-untyped-def]
    """Fill `k.y` with the linear system's state at t."""
    turn = turned(f.omega * t)
    for i in range(system.states):
        forced = (k.steady[i] + k.growing[i] * t) * turn
        k.y[i] = forced.imag + system.static[i] * k.push
    for m in range(system.modes):
        rate = system.rate[m]
        decay = exp(rate.real * (t - k.begin))
        sine, cosine = sincos(rate.imag * (t - k.begin))
        wave = k.modal[m] * complex(decay * cosine, decay * sine)
        for i in range(system.states):
            right = system.right[m, i]
            k.y[i] += right.real * wave.real - right.imag * wave.imag


@kernel
def negligible(step, t):  # type: ignore[no-untyped-def]
    """Whether a stride is lost in the rounding of the time."""
    return step <= _TIME_RESOLUTION * max(t, _SHORTEST)


@kernel
def wall_distance(p, s, side, d):  # type: ignore[no-untyped-def]
    """Return how far the sphere at d is from a wall [m]; a wall that has let it go stands where that was."""
    dent = s.dent if s.dent_side == side else 0.0
    return max(0.0, p.half_gap + dent - side * d)


@kernel
def fly(p, system, f, k, s, t_end):  # type: ignore[no-untyped-def]
    """Advance a flight from s to the first touch or to t_end; return the wall reached, -1 or 1, 0 for none, or STOPPED.

    On a touch the state is the one at the touch, with the distance to that wall exactly zero.
    """
    braking = -s.slide * p.friction
    launch(system, f, k, s.y, s.t)
    look(system, f, k, s.t, 0)
    sphere_x, sphere_v = k.value + s.d, k.slope + s.d_rate
    touched, t = 0, s.t
    while p.sphere_present:
        since, rest = t - k.begin, t_end - t
        d = sphere_x + since * (sphere_v + 0.5 * since * braking) - k.value
        rate, bend, jerk = sphere_v + since * braking - k.slope, braking - k.bend, k.bound
        right = stride(wall_distance(p, s, 1.0, d), rate, bend, jerk, rest)
        left = stride(wall_distance(p, s, -1.0, d), -rate, -bend, jerk, rest)
        step, stop, out = min(left, right), math.inf, math.inf
        if s.dent > 0.0:
            out = stride(max(0.0, s.dent_side * d - p.half_gap), -s.dent_side * rate, -s.dent_side * bend, jerk, rest)
            if negligible(out, t):
                s.dent = 0.0  # the sphere is out of it: from here on the surface is whole again
                continue
        if s.slide != 0.0:
            look(system, f, k, t, 1)
            stop = stride(max(0.0, s.slide * rate), -s.slide * bend, s.slide * k.bend, k.bound, rest)
        if min(step, stop, out) >= rest:
            break
        if stop < step and negligible(stop, t):
            touched = STOPPED
            break
        if step <= stop and negligible(step, t):
            touched = 1 if right < left else -1
            break
        t += min(step, stop, out)
        look(system, f, k, t, 0)
    if touched == 0:
        t = t_end
    arrive(system, f, k, t)
    for i in range(system.states):
        s.y[i] = k.y[i]
    since = t - k.begin
    s.t = t
    s.d_rate = 0.0 if touched == STOPPED else sphere_v + since * braking - s.y[V1]
    s.d = sphere_x + since * (sphere_v + 0.5 * since * braking) - s.y[X1]
    return touched


@kernel
def carry(p, system, f, k, s, t_end):  # type: ignore[no-untyped-def]
    """Advance sphere and base as one body until they part or to t_end; return which way the sphere then goes.

    `s.side` is the wall that presses the sphere, or 0 when guide friction holds it.
    """
    launch(system, f, k, s.y, s.t)
    t, parted = s.t, 0.0
    while True:
        look(system, f, k, t, 2)
        rest = t_end - t
        # the base may pull away to the right (the sphere lags: -1) or to the left (+1), but not through a wall
        lag, lead = math.inf, math.inf
        if s.side >= 0.0:
            lag = stride(max(0.0, p.friction - k.value), k.slope, k.bend, k.bound, rest)
        if s.side <= 0.0:
            lead = stride(max(0.0, p.friction + k.value), -k.slope, -k.bend, k.bound, rest)
        step = min(lag, lead)
        if step >= rest:
            t = t_end
            break
        if negligible(step, t):
            parted = -1.0 if lag < lead else 1.0
            break
        t += step
    arrive(system, f, k, t)
    for i in range(system.states):
        s.y[i] = k.y[i]
    s.t = t
    return parted
