"""Flight: the sphere is loose, the structure is linear, and both are known in closed form until a wall is reached.

The next touch is found by conservative strides: with the third derivative of the gap bounded, a cubic tells how long
no wall can be reached; repeated, the strides close in on the first touch from before it and cannot step over it,
however short or grazing the crossing.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from impact_rig.physics.forcing import drive, particular
from impact_rig.physics.linear import COIL, V1, VB, X1, XB
from impact_rig.physics.model import PRESCRIBED, VOLTAGE
from impact_rig.physics.state import (
    GAP,
    LEDGER_COLUMNS,
    LEDGER_FRICTION,
    LEDGER_SHAKER,
    LEDGER_WORK,
    RATE,
    SIDE,
    SLID,
    T,
    Y,
)

_TIME_RESOLUTION = 2.0**-51
_POSITION_RESOLUTION = 2.0**-47
_ROUNDS = 12
_SHORTEST = 1e-3  # segments may be shorter than the time scale of rounding errors [s]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def prepare(system, f, work, y, push, t):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Fill `work.modal` with the modal amplitudes at t of the state y under a constant `push` [N] on the structure."""
    rate, left = system.modes.rate, system.modes.left
    turn = np.exp(1j * f.omega * t)
    for k in range(rate.shape[0]):
        amplitude = 0.0j
        for i in range(system.b0.shape[0]):
            own = y[i] - ((work.steady[i] + work.growing[i] * t) * turn).imag - system.static[i] * push
            amplitude += left[k, i] * own
        work.modal[k] = amplitude


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def wall(system, f, work, push, since, t, order):  # type: ignore[no-untyped-def]
    """Return three derivatives of x_1 at t, from `order` on, and a bound on the next one from t on."""
    rate, right = system.modes.rate, system.modes.right
    d0, d1, d2, bound = system.static[X1] * push if order == 0 else 0.0, 0.0, 0.0, work.jerk[order]
    for k in range(rate.shape[0]):
        decay = math.exp(rate[k].real * since)
        angle = rate[k].imag * since
        e0 = right[k, X1] * work.modal[k] * complex(decay * math.cos(angle), decay * math.sin(angle))
        for _ in range(order):
            e0 = rate[k] * e0
        e1 = rate[k] * e0
        e2 = rate[k] * e1
        d0 += e0.real
        d1 += e1.real
        d2 += e2.real
        e3 = rate[k] * e2
        bound += math.sqrt(e3.real * e3.real + e3.imag * e3.imag)
    angle = f.omega * t
    turn = complex(math.cos(angle), math.sin(angle))
    z, growth = (work.steady[X1] + work.growing[X1] * t) * turn, work.growing[X1] * turn
    for _ in range(order):
        z, growth = 1j * f.omega * z + growth, 1j * f.omega * growth
    dz = 1j * f.omega * z + growth
    d0 += z.imag
    d1 += dz.imag
    d2 += (1j * f.omega * (dz + growth)).imag
    return d0, d1, d2, bound


@njit(cache=True, nogil=True, error_model="numpy")
def rounding(p, system, work, t):  # type: ignore[no-untyped-def]
    """Return the rounding error [m] of the distance to a wall: that of the largest terms of x_1, with a margin."""
    largest = p.half_gap + abs(work.steady[X1]) + abs(work.growing[X1]) * t
    for k in range(system.modes.rate.shape[0]):
        largest += abs(system.modes.right[k, X1] * work.modal[k])
    return _POSITION_RESOLUTION * largest


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def aim(f, work, t_end):  # type: ignore[no-untyped-def]
    """Prepare a segment's particular solution, and bounds on its part in the derivatives 3, 4 and 5 of x_1."""
    particular(f, work.answer, work.drift, work.steady, work.growing)
    level = abs(work.steady[X1]) + abs(work.growing[X1]) * t_end
    growing = abs(work.growing[X1])
    for order in range(3):
        n = order + 3
        work.jerk[order] = f.omega**n * level + n * f.omega ** (n - 1) * growing


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def state_at(system, f, work, push, since, t, y):  # type: ignore[no-untyped-def]
    """Fill y with the linear system's state at t."""
    rate, right = system.modes.rate, system.modes.right
    turn = np.exp(1j * f.omega * t)
    n = system.b0.shape[0]
    for i in range(n):
        y[i] = ((work.steady[i] + work.growing[i] * t) * turn).imag + system.static[i] * push
    for k in range(rate.shape[0]):
        e = work.modal[k] * np.exp(rate[k] * since)
        for i in range(n):
            y[i] += (right[k, i] * e).real


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def stride(distance, speed, acceleration, jerk, horizon):  # type: ignore[no-untyped-def]
    """Return a time, at most `horizon`, in which a point cannot cover `distance`.

    It has `speed` and `acceleration` towards the target and |jerk| is bounded, so within any h it covers at most
    speed τ + (acceleration + jerk h / 3) τ² / 2. The first time r(h) at which that reaches the distance is safe if it
    comes before h, and h itself is safe otherwise; the best h is where both agree, and is found to a few per cent.
    """
    if jerk <= 0.0:
        h = horizon
    else:
        h = min(
            horizon,
            3.0 * abs(acceleration) / jerk + math.sqrt(6.0 * abs(speed) / jerk) + (6.0 * distance / jerk) ** (1 / 3),
        )
    safe = 0.0
    for _ in range(_ROUNDS):
        half = 0.5 * (acceleration + jerk * h / 3.0)
        under = speed * speed + 4.0 * half * distance
        if speed > 0.0:
            reach = 2.0 * distance / (speed + math.sqrt(under)) if under >= 0.0 else math.inf
        else:
            reach = (math.sqrt(under) - speed) / (2.0 * half) if half > 0.0 else math.inf
        if reach >= h:
            if h >= horizon:
                return horizon
            safe = h
            h = min(2.0 * h, reach, horizon)
        else:
            safe = max(safe, reach)
            if reach > 0.8 * h or reach <= 0.0:
                break
            h = math.sqrt(h * reach)
    return safe


STOPPED = 2
"""Returned by `fly` when friction brings the sphere to rest on its guide."""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def fly(p, system, f, work, s, t_end):  # type: ignore[no-untyped-def]
    """Advance a flight from s to the first touch or to t_end; return the wall reached, -1 or 1, 0 for none, or STOPPED.

    On a touch the state is the one at the touch, with the distance to that wall exactly zero.
    """
    start = s[T]
    slide = s[SIDE]  # guide friction: constant while the sphere slides one way
    push = slide * p.m * p.friction
    braking = -slide * p.friction
    prepare(system, f, work, s[Y:], push, start)
    x, v, a, jerk = wall(system, f, work, push, 0.0, start, 0)
    sphere_x, sphere_v = x + s[GAP], v + s[RATE]
    touched = 0
    t = start
    while p.sphere_present:
        since = t - start
        d = sphere_x + since * (sphere_v + 0.5 * since * braking) - x
        rate = sphere_v + since * braking - v
        bend = braking - a
        rest = t_end - t
        right = stride(max(0.0, p.half_gap - d), rate, bend, jerk, rest)
        left = stride(max(0.0, p.half_gap + d), -rate, -bend, jerk, rest)
        step = min(left, right)
        if slide != 0.0:
            _, _, a_rate, snap = wall(system, f, work, push, since, t, 1)
            stop = stride(max(0.0, slide * rate), -slide * bend, slide * a_rate, snap, rest)
        else:
            stop = math.inf
        if min(step, stop) >= rest:
            break
        if stop < step:
            if stop <= _TIME_RESOLUTION * max(t, _SHORTEST):
                touched = STOPPED
                break
            step = stop
        elif step <= _TIME_RESOLUTION * max(t, _SHORTEST):
            touched = 1 if right < left else -1
            break
        t += step
        x, v, a, jerk = wall(system, f, work, push, t - start, t, 0)
    if touched == 0:
        t = t_end
    since = t - start
    state_at(system, f, work, push, since, t, work.y)
    for i in range(system.b0.shape[0]):
        s[Y + i] = work.y[i]
    s[T] = t
    s[RATE] = 0.0 if touched == STOPPED else sphere_v + since * braking - work.y[V1]
    s[GAP] = sphere_x + since * (sphere_v + 0.5 * since * braking) - work.y[X1]
    if abs(touched) == 1:
        s[GAP] = touched * p.half_gap
    return touched


@njit(cache=True, nogil=True, error_model="numpy")
def carry(p, system, f, work, s, t_end):  # type: ignore[no-untyped-def]
    """Advance sphere and base as one body until they part or to t_end; return which way the sphere then goes.

    SIDE is the wall that presses the sphere, or 0 when guide friction holds it.
    """
    start, side = s[T], s[SIDE]
    prepare(system, f, work, s[Y:], 0.0, start)
    t, parted = start, 0.0
    while True:
        a, jerk, snap, bound = wall(system, f, work, 0.0, t - start, t, 2)
        rest = t_end - t
        # the base may pull away to the right (the sphere lags: -1) or to the left (+1), but not through a wall
        lag = stride(max(0.0, p.friction - a), jerk, snap, bound, rest) if side >= 0.0 else math.inf
        lead = stride(max(0.0, p.friction + a), -jerk, -snap, bound, rest) if side <= 0.0 else math.inf
        step = min(lag, lead)
        if step >= rest:
            t = t_end
            break
        if step <= _TIME_RESOLUTION * max(t, _SHORTEST):
            parted = -1.0 if lag < lead else 1.0
            break
        t += step
    state_at(system, f, work, 0.0, t - start, t, work.y)
    for i in range(system.b0.shape[0]):
        s[Y + i] = work.y[i]
    s[T] = t
    return parted


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_PANEL = 1.0  # radians (or e-foldings) of the fastest motion per quadrature panel: 8 Gauss points leave 1e-14
_FORGOTTEN = 50.0  # e-foldings after which a mode no longer needs panels of its own


@njit(cache=True, nogil=True, error_model="numpy")
def flight_energy(p, system, f, work, push, begin, end, s, ledger):  # type: ignore[no-untyped-def]
    """Add the work and the losses of the flight just flown, by Gauss–Legendre quadrature of its closed form."""
    c, y = p.c, work.y
    duration, since_panel = end - begin, 0.0
    while since_panel < duration:
        fastest = max(f.omega, _PANEL / duration)
        for k in range(system.modes.rate.shape[0]):
            if -system.modes.rate[k].real * since_panel < _FORGOTTEN:
                fastest = max(fastest, abs(system.modes.rate[k]))
        rest = duration - since_panel
        width = rest / math.ceil(rest * fastest / _PANEL)
        for point in range(_NODES.shape[0]):
            since = since_panel + 0.5 * width * (1.0 + _NODES[point])
            weight = 0.5 * width * _WEIGHTS[point]
            state_at(system, f, work, push, since, begin + since, y)
            u, du = drive(f, begin + since)
            x_b, v_b = (u, du) if p.drive == PRESCRIBED else (y[XB], y[VB])
            stretch = y[V1] - v_b
            ledger[LEDGER_COLUMNS] += weight * c.c_1 * stretch * stretch
            if p.drive == PRESCRIBED:
                ledger[LEDGER_WORK] += weight * (c.k_1 * (x_b - y[X1]) - c.c_1 * stretch) * v_b
            else:
                current = y[COIL] if p.drive == VOLTAGE else u
                ledger[LEDGER_SHAKER] += weight * c.c_f * v_b * v_b
                if p.drive == VOLTAGE:
                    ledger[LEDGER_WORK] += weight * u * current
                    ledger[LEDGER_SHAKER] += weight * c.resistance * current * current
                else:
                    ledger[LEDGER_WORK] += weight * c.force_factor * current * v_b
        since_panel += width
    if push != 0.0:  # force times the distance slid: the sphere's ballistic path less the base's
        ledger[LEDGER_FRICTION] += abs(push) * abs(s[GAP] - s[SLID])
