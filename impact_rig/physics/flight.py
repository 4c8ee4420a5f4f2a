"""Flight: the sphere is loose, the structure is linear, and both are known in closed form until a wall is reached.

The next touch is found by conservative strides: with the third derivative of the gap bounded, a cubic tells how long no wall can be reached; repeated,
the strides close in on the first touch from before it and cannot step over it, however short or grazing the crossing.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from impact_rig.physics.forcing import drive
from impact_rig.physics.linear import COIL, V1, VB, X1, XB
from impact_rig.physics.model import PRESCRIBED, VOLTAGE
from impact_rig.physics.state import GAP, LEDGER_COLUMNS, LEDGER_SHAKER, LEDGER_WORK, RATE, SIDE, T, Y

_TIME_RESOLUTION = 2.0**-51
_ROUNDS = 12
_SHORTEST = 1e-3  # segments may be shorter than the time scale of rounding errors [s]


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def wall(system, f, work, push, since, t):  # type: ignore[no-untyped-def]
    """Return x_1, v_1, a_1 at t, `since` the last `prepare`, and a bound on |a_1'| from t on."""
    rate, right = system.modes.rate, system.modes.right
    x, v, a, bound = system.static[X1] * push, 0.0, 0.0, 0.0
    for k in range(rate.shape[0]):
        decay = math.exp(rate[k].real * since)
        angle = rate[k].imag * since
        e0 = right[k, X1] * work.modal[k] * complex(decay * math.cos(angle), decay * math.sin(angle))
        e1 = rate[k] * e0
        e2 = rate[k] * e1
        x += e0.real
        v += e1.real
        a += e2.real
        e3 = rate[k] * e2
        bound += math.sqrt(e3.real * e3.real + e3.imag * e3.imag)
    angle = f.omega * t
    turn = complex(math.cos(angle), math.sin(angle))
    z = (work.steady[X1] + work.growing[X1] * t) * turn
    dz = 1j * f.omega * z + work.growing[X1] * turn
    x += z.imag
    v += dz.imag
    a += (1j * f.omega * (dz + work.growing[X1] * turn)).imag
    return x, v, a, bound + work.jerk[0]


@njit(cache=True, nogil=True)
def bound_drive_jerk(f, work, t_end):  # type: ignore[no-untyped-def]
    """Bound the part of |a_1'| that the drive causes anywhere in its segment."""
    steady, growing, omega = abs(work.steady[X1]), abs(work.growing[X1]), f.omega
    work.jerk[0] = omega**3 * (steady + growing * t_end) + 3.0 * omega**2 * growing


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def stride(distance, speed, acceleration, jerk, horizon):  # type: ignore[no-untyped-def]
    """Return a time, at most `horizon`, in which a point cannot cover `distance`.

    It has `speed` and `acceleration` towards the target and |jerk| is bounded, so within any h it covers at most
    speed τ + (acceleration + jerk h / 3) τ² / 2. The first time r(h) at which that reaches the distance is safe if it comes before h, and
    h itself is safe otherwise; the best h is where both agree, and is found to within a few per cent.
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
            h = min(min(2.0 * h, reach), horizon)
        else:
            safe = max(safe, reach)
            if reach > 0.8 * h or reach <= 0.0:
                break
            h = math.sqrt(h * reach)
    return safe


@njit(cache=True, nogil=True)
def fly(model, f, work, s, t_end):  # type: ignore[no-untyped-def]
    """Advance a flight from s to the first touch or to t_end; return the wall reached, -1 or 1, or 0 for none.

    On a touch the state is the one at the touch, with the distance to that wall exactly zero.
    """
    p, system = model.p, model.loose
    start = s[T]
    slide = s[SIDE]  # guide friction: constant while the sphere slides one way
    push = slide * p.m * p.friction
    braking = -slide * p.friction
    prepare(system, f, work, s[Y:], push, start)
    x, v, a, jerk = wall(system, f, work, push, 0.0, start)
    sphere_x, sphere_v = x + s[GAP], v + s[RATE]
    touched = 0
    t = start
    while p.sphere_present:
        since = t - start
        d = sphere_x + since * (sphere_v + 0.5 * since * braking) - x
        rate = sphere_v + since * braking - v
        bend = braking - a
        right = stride(max(0.0, p.half_gap - d), rate, bend, jerk, t_end - t)
        left = stride(max(0.0, p.half_gap + d), -rate, -bend, jerk, t_end - t)
        step = min(left, right)
        if step >= t_end - t:
            break
        if step <= _TIME_RESOLUTION * max(t, _SHORTEST):
            touched = 1 if right < left else -1
            break
        t += step
        x, v, a, jerk = wall(system, f, work, push, t - start, t)
    if touched == 0:
        t = t_end
    since = t - start
    state_at(system, f, work, push, since, t, work.y)
    for i in range(system.b0.shape[0]):
        s[Y + i] = work.y[i]
    s[T] = t
    s[RATE] = sphere_v + since * braking - work.y[V1]
    s[GAP] = touched * p.half_gap if touched else sphere_x + since * (sphere_v + 0.5 * since * braking) - work.y[X1]
    return touched


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_PANEL = 1.0  # radians (or e-foldings) of the fastest motion per quadrature panel: 8 Gauss points leave 1e-14


@njit(cache=True, nogil=True)
def flight_energy(model, f, work, begin, end, ledger):  # type: ignore[no-untyped-def]
    """Add the work and the losses of the flight just flown, by Gauss–Legendre quadrature of its closed form."""
    p, system, y = model.p, model.loose, work.y
    c = p.c
    fastest = f.omega
    for k in range(system.modes.rate.shape[0]):
        fastest = max(fastest, abs(system.modes.rate[k]))
    panels = int(math.ceil((end - begin) * fastest / _PANEL)) + 0
    if panels == 0:
        return
    width = (end - begin) / panels
    for panel in range(panels):
        for point in range(_NODES.shape[0]):
            since = (panel + 0.5 * (1.0 + _NODES[point])) * width
            weight = 0.5 * width * _WEIGHTS[point]
            state_at(system, f, work, 0.0, since, begin + since, y)
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
