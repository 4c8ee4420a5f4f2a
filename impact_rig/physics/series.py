"""The Taylor series of one step of a contact, by recurrence; and where it reaches a value.

With w = sqrt(δ) and dt = w ds everything is polynomial (see `collision`), and every product has w as one factor: one
loop makes them all, order by order (Cauchy products).

Functions marked `forceinline` are called with tuples of a hundred numbers; handing those over took as long as the work.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from impact_rig.physics.dynamics import LINEAR
from impact_rig.physics.model import PRESCRIBED, VOLTAGE
from impact_rig.physics.state import BETA, GAP, GRIP, RATE, SIDE, UNIT, T, Y

ORDER = 20
SPEED, CENTRE, V_CENTRE, X_BASE, V_BASE, COIL, SINE, COSINE = range(8)
"""Columns of the series: δ', X, V, x_b, v_b, i and the drive's sine and cosine."""
WIDTH = 8

_ROOT_ROUNDS = 60  # Newton needs three to six
_LAST_STEP = 1e-9  # of Newton: what is left after it is its square


class Series(NamedTuple):
    """Taylor coefficients of one step, by order; s is measured in `UNIT`."""

    w: NDArray[np.float64]
    t: NDArray[np.float64]
    force: NDArray[np.float64]
    y: NDArray[np.float64]  # (order, WIDTH)
    rows: NDArray[np.float64]  # (order, 16): (w, w², w³) of the order, then dy/dt of the order before


def new_series() -> Series:
    """Return room for one step."""
    n = ORDER + 2
    return Series(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, WIDTH)), np.zeros((n, 16)))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def expand(p, f, s, a):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Fill the series `a` of the motion that goes on from the contact state s."""
    c = p.c
    side, beta, unit = s[SIDE], s[BETA], s[UNIT]
    stiffness, damping = s[GRIP] * p.force.stiffness, s[GRIP] * p.force.damping
    linear = p.force.kind == LINEAR
    w, y, rows = a.w, a.y, a.rows
    w[0], a.t[0] = s[GAP], s[T]
    y[0, SPEED] = s[RATE]
    for q in range(5):
        y[0, CENTRE + q] = s[Y + q]
    angle = f.omega * s[T] + f.phase
    y[0, SINE], y[0, COSINE] = math.sin(angle), math.cos(angle)
    w_0 = w[0]
    w2_0 = w_0 * w_0
    w3_0 = w2_0 * w_0
    w2, w3 = w2_0, w3_0
    viscous = 0.5 * stiffness * beta / unit
    r0, r1, r2, r3, r4, r5, r6, r7 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(ORDER):
        speed = y[k, SPEED]
        scale = unit / (k + 1)
        half, reach = 0.5 * scale, w_0 * scale
        w_next = half * speed
        w[k + 1] = w_next
        a.t[k + 1] = scale * w[k]
        s0, s1, s2, s3, s4, s5, s6, s7 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(1, k):  # every product is one with w: w², w³, w⁴ at order k + 1 and w · dy/dt at order k
            b = w[k + 1 - i]
            s0 += b * rows[i, 0]
            s1 += b * rows[i, 1]
            s2 += b * rows[i, 2]
            s3 += b * rows[i, 3]
            s4 += b * rows[i, 4]
            s5 += b * rows[i, 5]
            s6 += b * rows[i, 6]
            s7 += b * rows[i, 7]
        if k > 0:  # the newest row comes last and from registers: the loop need not wait for it
            b = w[1]
            s0 += b * r0
            s1 += b * r1
            s2 += b * r2
            s3 += b * r3
            s4 += b * r4
            s5 += b * r5
            s6 += b * r6
            s7 += b * r7
        # the terms with the newest w apart: they alone are waited for
        w2_next = s0 + 2.0 * w_0 * w_next
        s1 += w_0 * s0
        w3_next = s1 + 3.0 * w2_0 * w_next
        s2 += w_0 * s1
        w4_next = s2 + 4.0 * w3_0 * w_next
        # w³ δ' is half the derivative of w⁴
        hertzian = stiffness * w3 + viscous * (k + 1) * w4_next
        force = stiffness * w2 + damping * speed if linear else hertzian
        u, du = f.amplitude * y[k, SINE], f.amplitude * f.omega * y[k, COSINE]
        if f.slope != 0.0:
            grown_sine, grown_cosine = 0.0, 0.0
            for i in range(k + 1):
                grown_sine += a.t[i] * y[k - i, SINE]
                grown_cosine += a.t[i] * y[k - i, COSINE]
            u += f.slope * grown_sine
            du += f.slope * (f.omega * grown_cosine + y[k, SINE])
        x_b, v_b = y[k, X_BASE], y[k, V_BASE]
        if p.drive == PRESCRIBED:
            x_b, v_b = u, du
        v_centre = y[k, V_CENTRE]
        offset = w2 + (p.half_gap if k == 0 else 0.0)
        column = -c.k_1 * (y[k, CENTRE] - p.share * side * offset - x_b) - c.c_1 * (
            v_centre - p.share * side * speed - v_b
        )
        relative = -side * p.per_m_1 * column - p.per_m_eff * force
        pair = column * p.per_m_pair
        d_sine, d_cosine = f.omega * y[k, COSINE], -f.omega * y[k, SINE]
        y[k + 1, SPEED] = scale * s3 + reach * relative
        y[k + 1, CENTRE] = scale * s4 + reach * v_centre
        y[k + 1, V_CENTRE] = scale * s5 + reach * pair
        y[k + 1, SINE] = scale * s6 + reach * d_sine
        y[k + 1, COSINE] = scale * s7 + reach * d_cosine
        r0, r1, r2, r3, r4, r5, r6, r7 = w_next, w2_next, w3_next, relative, v_centre, pair, d_sine, d_cosine
        rows[k + 1, 0], rows[k + 1, 1], rows[k + 1, 2], rows[k + 1, 3] = r0, r1, r2, r3
        rows[k + 1, 4], rows[k + 1, 5], rows[k + 1, 6], rows[k + 1, 7] = r4, r5, r6, r7
        a.force[k] = force
        w2, w3 = w2_next, w3_next
        if p.drive == PRESCRIBED:
            continue
        current, d_coil = u, 0.0
        if p.drive == VOLTAGE:
            current = y[k, COIL]
            d_coil = (u - c.resistance * current - c.force_factor * v_b) / c.inductance
        table = (c.force_factor * current - c.c_f * v_b - c.k_f * x_b - column) * p.per_m_base
        s0, s1, s2 = 0.0, 0.0, 0.0
        for i in range(1, k + 1):
            b = w[k + 1 - i]
            s0 += b * rows[i, 8]
            s1 += b * rows[i, 9]
            s2 += b * rows[i, 10]
        y[k + 1, X_BASE] = scale * s0 + reach * v_b
        y[k + 1, V_BASE] = scale * s1 + reach * table
        y[k + 1, COIL] = scale * s2 + reach * d_coil
        rows[k + 1, 8], rows[k + 1, 9], rows[k + 1, 10] = v_b, table, d_coil


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def value(series, x):  # type: ignore[no-untyped-def]
    """Return a series and its derivative at x."""
    total, slope = series[ORDER], 0.0
    for k in range(ORDER - 1, -1, -1):
        slope = slope * x + total
        total = total * x + series[k]
    return total, slope


@njit(cache=True, nogil=True, error_model="numpy")
def root(series, goal, rising, h):  # type: ignore[no-untyped-def]
    """Return where in (0, h] the series passes `goal`, which its ends enclose: Newton inside a bracket."""
    left, right = 0.0, h
    x = h
    for _ in range(_ROOT_ROUNDS):
        v, dv = value(series, x)
        miss = v - goal
        if (miss > 0.0) == rising:
            right = x
        else:
            left = x
        step = miss / dv if dv != 0.0 else math.inf
        if abs(step) <= _LAST_STEP * h:
            return min(max(x - step, 0.0), h)
        x -= step
        if not left < x < right:
            x = 0.5 * (left + right)
    return x


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def reached(clock, elapsed, h):  # type: ignore[no-untyped-def]
    """Return where in (0, h] a rising series has grown by `elapsed`: Newton inside a bracket.

    The growth and not the series itself, whose rounding errors are those of the time since the segment's start.
    """
    left, right = 0.0, h
    x = h
    for _ in range(_ROOT_ROUNDS):
        growth, slope = clock[ORDER], 0.0
        for k in range(ORDER - 1, 0, -1):
            slope = slope * x + growth
            growth = growth * x + clock[k]
        slope = slope * x + growth
        miss = growth * x - elapsed
        if miss > 0.0:
            right = x
        else:
            left = x
        step = miss / slope if slope > 0.0 else math.inf
        if abs(step) <= _LAST_STEP * h:
            return x - step
        x -= step
        if not left < x < right:
            x = 0.5 * (left + right)
    return x


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def force_at(a, x):  # type: ignore[no-untyped-def]
    """Return the contact force and two derivatives at x (known to one order less than the rest)."""
    total, slope, half_bend = a.force[ORDER - 1], 0.0, 0.0
    for k in range(ORDER - 2, -1, -1):
        half_bend = half_bend * x + slope
        slope = slope * x + total
        total = total * x + a.force[k]
    return total, slope, 2.0 * half_bend


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def evaluate(a, x, at):  # type: ignore[no-untyped-def]
    """Fill `at` with (δ', X, V, x_b, v_b, i) at x and return w and t."""
    s0, s1, s2, s3, s4, s5 = a.y[ORDER, 0], a.y[ORDER, 1], a.y[ORDER, 2], a.y[ORDER, 3], a.y[ORDER, 4], a.y[ORDER, 5]
    w, t = a.w[ORDER], a.t[ORDER]
    for k in range(ORDER - 1, -1, -1):
        s0 = s0 * x + a.y[k, 0]
        s1 = s1 * x + a.y[k, 1]
        s2 = s2 * x + a.y[k, 2]
        s3 = s3 * x + a.y[k, 3]
        s4 = s4 * x + a.y[k, 4]
        s5 = s5 * x + a.y[k, 5]
        w = w * x + a.w[k]
        t = t * x + a.t[k]
    at[0], at[1], at[2], at[3], at[4], at[5] = s0, s1, s2, s3, s4, s5
    return w, t
