"""Collision: one sphere, one wall, 30–100 µs, integrated in a variable in which the equations have no kink.

The force K δ^1.5 has a kink where the contact starts and ends, which limits every classical method to order 2.5. With
w = sqrt(δ) and the
regularised variable s, dt = w ds (a Sundman transformation), the equations are polynomial in the state and analytic
through w = 0:

    dw/ds = δ'/2,   dt/ds = w,   dδ'/ds = −w (F/m_eff + side·a_s),   F = K w³ (1 + β δ')

a_s is the superior base's acceleration by its columns alone; the pair's centre of mass (X, V) does not feel F.
Polynomial right-hand sides give
the Taylor series of the solution by recurrence (Cauchy products), so a step is a power series of order `ORDER`, its
length follows from the
last coefficients (Jorba & Zou 2005, Experimental Mathematics 14, 99–117), no step is ever rejected, and the series
*is* the dense output: the
contact's end, its peaks and any sample inside it are polynomial evaluations.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from impact_rig.physics.dynamics import LINEAR, rates
from impact_rig.physics.forcing import drive
from impact_rig.physics.model import PRESCRIBED, VOLTAGE
from impact_rig.physics.state import (
    APPROACH,
    BETA,
    ELAPSED,
    GAP,
    GRIP,
    IMPULSE,
    LOST,
    NEXT_STEP,
    PEAK_FORCE,
    PEAK_INDENTATION,
    RATE,
    SIDE,
    STEP,
    UNIT,
    T,
    Y,
    add_knot,
)

ORDER = 20
SPEED, CENTRE, V_CENTRE, X_BASE, V_BASE, COIL, SINE, COSINE = range(8)
"""Columns of the series: δ', X, V, x_b, v_b, i and the drive's sine and cosine; eight doubles, one vector register."""
WIDTH = 8

LEFT_WALL, OUT_OF_TIME, STIFF, NOT_STIFF, FAILED = range(5)
"""How a contact phase ends: sphere gone, segment over, perhaps better ridden, better not ridden, no progress."""

PATIENCE = 25
"""Steps after which riding is offered the contact: an impact takes about 15."""
_LONGEST = 1e3
_ROOT_ROUNDS = 60
_PEAK_ROUNDS = 12
_BOTTOM_ROUNDS = 30
_POINTS = 10
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(_POINTS)
_PLACES = 0.5 * (1.0 + _NODES)


class Series(NamedTuple):
    """Taylor coefficients of one step, by order; s is measured in `UNIT`."""

    w: NDArray[np.float64]
    t: NDArray[np.float64]
    force: NDArray[np.float64]
    y: NDArray[np.float64]  # (order, WIDTH)
    rows: NDArray[np.float64]  # (order, 16): (w, w², w³) of the order, then dy/dt of the order before
    at_nodes: NDArray[np.float64]  # (2, quadrature points): scratch


def new_series() -> Series:
    """Return room for one step."""
    n = ORDER + 2
    return Series(
        np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, WIDTH)), np.zeros((n, 16)), np.zeros((2, _POINTS))
    )


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
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
    r0, r1, r2, r3, r4, r5, r6, r7 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(ORDER):
        speed = y[k, SPEED]
        scale = unit / (k + 1)
        w_next = 0.5 * scale * speed
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
        w2_next = s0 + 2.0 * w_0 * w_next
        w3_next = s1 + w_0 * w2_next + w2_0 * w_next
        w4_next = s2 + w_0 * w3_next + w3_0 * w_next
        # w³ δ' is half the derivative of w⁴
        hertzian = stiffness * (w3 + beta * w4_next * 0.5 * (k + 1) / unit)
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
        relative = -force * p.per_m_eff - side * column * p.per_m_1
        pair = column * p.per_m_pair
        d_sine, d_cosine = f.omega * y[k, COSINE], -f.omega * y[k, SINE]
        y[k + 1, SPEED] = scale * (s3 + w_0 * relative)
        y[k + 1, CENTRE] = scale * (s4 + w_0 * v_centre)
        y[k + 1, V_CENTRE] = scale * (s5 + w_0 * pair)
        y[k + 1, SINE] = scale * (s6 + w_0 * d_sine)
        y[k + 1, COSINE] = scale * (s7 + w_0 * d_cosine)
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
        y[k + 1, X_BASE] = scale * (s0 + w_0 * v_b)
        y[k + 1, V_BASE] = scale * (s1 + w_0 * table)
        y[k + 1, COIL] = scale * (s2 + w_0 * d_coil)
        rows[k + 1, 8], rows[k + 1, 9], rows[k + 1, 10] = v_b, table, d_coil


@njit(cache=True, nogil=True, error_model="numpy")
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
        step = miss / dv if dv != 0.0 else 0.0
        trial = x - step
        if not left < trial < right:
            trial = 0.5 * (left + right)
        if abs(trial - x) <= 1e-15 * h:
            break
        x = trial
    return x


@njit(cache=True, nogil=True, error_model="numpy")
def scales(p, approach):  # type: ignore[no-untyped-def]
    """Return the speed and sqrt(indentation) that a contact reaches: the measure of its tolerances."""
    speed = max(approach, p.touch_speed)
    if p.force.kind == LINEAR:
        indentation = speed * math.sqrt(p.m_eff / p.force.stiffness)
    else:
        indentation = (1.25 * p.m_eff * speed * speed / p.force.stiffness) ** 0.4
    return speed, math.sqrt(indentation)


@njit(cache=True, nogil=True, error_model="numpy")
def stiffness_rate(p, beta, w):  # type: ignore[no-untyped-def]
    """Return how fast [1/s] the contact's own motion is at indentation w²: its frequency or damping rate."""
    if p.force.kind == LINEAR:
        return max(math.sqrt(p.force.stiffness * p.per_m_eff), p.force.damping * p.per_m_eff)
    rate = p.force.stiffness * p.per_m_eff * w
    return max(math.sqrt(1.5 * rate), rate * w * w * beta)


@njit(cache=True, nogil=True, error_model="numpy")
def _step_length(p, a, speed_scale, w_scale):  # type: ignore[no-untyped-def]
    """Return the step at which the last two coefficients stay below the tolerance."""
    last = 0.0
    for order in range(ORDER - 1, ORDER + 1):
        last = max(last, abs(a.w[order]) / w_scale)
        last = max(last, abs(a.y[order, SPEED]) / speed_scale)
        last = max(last, abs(a.y[order, V_CENTRE]) / speed_scale)
        last = max(last, abs(a.y[order, V_BASE]) / speed_scale)
    return (p.rtol / last) ** (1.0 / ORDER) if last > 0.0 else math.inf


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _contact_loss(p, a, beta, grip, unit, h):  # type: ignore[no-untyped-def]
    """Return ∫ viscous force · δ' dt over a step, by Gauss–Legendre quadrature of the series.

    Once the contact has let go, what the spring still holds is lost while it relaxes: viscous cancels elastic.
    """
    w, speed = a.at_nodes[0], a.at_nodes[1]
    w[:] = a.w[ORDER]
    speed[:] = a.y[ORDER, SPEED]
    for k in range(ORDER - 1, -1, -1):  # Horner at all nodes together
        w_k, speed_k = a.w[k], a.y[k, SPEED]
        for point in range(_POINTS):
            x = h * _PLACES[point]
            w[point] = w[point] * x + w_k
            speed[point] = speed[point] * x + speed_k
    total = 0.0
    for point in range(_POINTS):
        elastic, per_speed = p.force.stiffness * w[point] * w[point], p.force.damping
        if p.force.kind != LINEAR:
            elastic *= w[point]
            per_speed = elastic * beta
        viscous = per_speed * speed[point] if grip > 0.0 else -elastic
        total += _WEIGHTS[point] * viscous * speed[point] * w[point]
    return 0.5 * h * unit * total


@njit(cache=True, nogil=True, error_model="numpy")
def _note_peaks(a, h, w_end, speed_end, s):  # type: ignore[no-untyped-def]
    """Note the largest force and indentation of a step, between its ends too."""
    s[PEAK_INDENTATION] = max(s[PEAK_INDENTATION], w_end * w_end)
    if s[RATE] > 0.0 > speed_end:
        w, _ = value(a.w, root(a.y[:, SPEED], 0.0, False, h))
        s[PEAK_INDENTATION] = max(s[PEAK_INDENTATION], w * w)
    s[PEAK_FORCE] = max(s[PEAK_FORCE], a.force[0])
    if a.force[1] > 0.0:
        force, slope_end = _force(a, h)
        s[PEAK_FORCE] = max(s[PEAK_FORCE], force)
        if slope_end < 0.0:
            left, right, slope_left = 0.0, h, a.force[1]
            for _ in range(_PEAK_ROUNDS):  # Illinois: the force is second order in the place of its peak
                middle = left + (right - left) * slope_left / (slope_left - slope_end)
                force, slope = _force(a, middle)
                if slope > 0.0:
                    left, slope_left, slope_end = middle, slope, 0.5 * slope_end
                else:
                    right, slope_end, slope_left = middle, slope, 0.5 * slope_left
                if abs(slope) * h <= 1e-6 * force:
                    break
            s[PEAK_FORCE] = max(s[PEAK_FORCE], force)


@njit(cache=True, nogil=True, error_model="numpy")
def _force(a, x):  # type: ignore[no-untyped-def]
    """Return the contact force and its derivative at x (known to one order less than the rest)."""
    total, slope = a.force[ORDER - 1], 0.0
    for k in range(ORDER - 2, -1, -1):
        slope = slope * x + total
        total = total * x + a.force[k]
    return total, slope


@njit(cache=True, nogil=True, error_model="numpy")
def _account(p, f, side, beta, unit, a, h, at, ledger):  # type: ignore[no-untyped-def]
    """Add a step's work and losses outside the contact, by Gauss–Legendre quadrature."""
    for point in range(_POINTS):
        x = h * _PLACES[point]
        w, t = evaluate(a, x, at)
        u, du = drive(f, t)
        _, _, _, _, work, columns, shaker, _ = rates(
            p, side, beta, u, du, w, at[SPEED], at[CENTRE], at[V_CENTRE], at[X_BASE], at[V_BASE], at[COIL]
        )
        weight = 0.5 * h * _WEIGHTS[point] * unit * w
        ledger[0] += weight * work
        ledger[1] += weight * columns
        ledger[2] += weight * shaker


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def _bottom(series, h):  # type: ignore[no-untyped-def]
    """Return where in (0, h) a series that falls at 0 and rises at h is lowest: bisection of its slope."""
    left, right = 0.0, h
    for _ in range(_BOTTOM_ROUNDS):
        middle = 0.5 * (left + right)
        _, slope = value(series, middle)
        if slope < 0.0:
            left = middle
        else:
            right = middle
    return left


@njit(cache=True, nogil=True, error_model="numpy")
def _release(p, a, beta, grip, h, speed_end):  # type: ignore[no-untyped-def]
    """Return where in a step the force would begin to pull, and so lets go, or presses again; or h."""
    if p.force.kind == LINEAR:
        if grip > 0.0:
            force, _ = _force(a, h)
            return root(a.force, 0.0, False, h) if force < 0.0 < a.force[0] else h
        return root(a.y[:, SPEED], 0.0, True, h) if a.y[0, SPEED] < 0.0 < speed_end else h
    if beta <= 0.0:
        return h
    # A step that follows a release, or a new grip, starts at the limit but for rounding: which side it is on does not
    # count, only where the step ends. One that dips below the limit in between starts and ends above it.
    limit = -1.0 / beta
    speed = a.y[:, SPEED]
    if grip <= 0.0:
        return root(speed, limit, True, h) if speed_end > limit else h
    if speed_end < limit:
        return root(speed, limit, False, h)
    if speed[1] < 0.0 and min(speed[0], speed_end) < 0.5 * limit:
        _, slope_end = value(speed, h)
        if slope_end > 0.0:
            lowest = _bottom(speed, h)
            least, _ = value(speed, lowest)
            if least < limit < speed[0]:
                return root(speed, limit, False, lowest)
    return h


@njit(cache=True, nogil=True, error_model="numpy")
def collide(p, f, a, at, s, t_end, log, ledger, account):  # type: ignore[no-untyped-def]
    """Integrate the contact in s until the sphere leaves, the segment ends or riding may be the better way."""
    side, beta, unit = s[SIDE], s[BETA], s[UNIT]
    speed_scale, w_scale = scales(p, s[APPROACH])
    ending = STIFF
    for _ in range(PATIENCE):
        expand(p, f, s, a)
        h = min(_step_length(p, a, speed_scale, w_scale), _LONGEST)
        if not h > 0.0:
            return FAILED
        ending, grip = STIFF, s[GRIP]
        w, t = evaluate(a, h, at)
        if w <= 0.0:
            h, ending = root(a.w, 0.0, False, h), LEFT_WALL
            w, t = evaluate(a, h, at)
            w = 0.0
        if p.force.clipped:  # beyond the wall's end the series means nothing: look only up to there
            released = _release(p, a, beta, grip, h, at[SPEED])
            if released < h:
                h, ending, grip = released, STIFF, 1.0 - grip
                w, t = evaluate(a, h, at)
        if t >= t_end:
            h, ending, grip = root(a.t, t_end, True, h), OUT_OF_TIME, s[GRIP]
            w, t = evaluate(a, h, at)
            t = t_end
        s[STEP] = h
        add_knot(log, s)
        lost = _contact_loss(p, a, beta, s[GRIP], unit, h)
        ledger[3] += lost
        s[LOST] += lost
        _note_peaks(a, h, w, at[SPEED], s)
        s[ELAPSED] += t - s[T]
        s[IMPULSE] -= side * p.m * (at[V_CENTRE] - s[Y + 1]) + (1.0 - p.share) * p.m * (at[SPEED] - s[RATE])
        end_speed = at[SPEED]
        for q in range(5):
            s[Y + q] = at[CENTRE + q]
        if account:
            _account(p, f, side, beta, unit, a, h, at, ledger)
        s[NEXT_STEP] = t - s[T]
        s[GAP], s[RATE], s[T], s[GRIP] = w, end_speed, t, grip
        if ending != STIFF:
            break
    s[STEP] = 0.0
    add_knot(log, s)
    return ending


@njit(cache=True, nogil=True, error_model="numpy")
def grip(p, s):  # type: ignore[no-untyped-def]
    """Return 1 where the contact presses, 0 where its force would pull and is cut to zero."""
    if not p.force.clipped:
        return 1.0
    if p.force.kind == LINEAR:
        return 1.0 if p.force.stiffness * s[GAP] * s[GAP] + p.force.damping * s[RATE] >= 0.0 else 0.0
    return 1.0 if 1.0 + s[BETA] * s[RATE] >= 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def begin(p, speed, s):  # type: ignore[no-untyped-def]
    """Set the unit of s in which a contact with this approach speed has a length of about one, and its grip."""
    scale, w = scales(p, speed)
    s[UNIT] = w / scale
    s[GRIP] = 1.0
