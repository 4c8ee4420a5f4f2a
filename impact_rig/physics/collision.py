"""Collision: one sphere, one wall, 30–100 µs, integrated in a variable in which the equations have no kink.

The force K δ^1.5 has a kink where the contact starts and ends, which limits every classical method to order 2.5. With
w = sqrt(δ) and the regularised variable s, dt = w ds (a Sundman transformation), the equations are polynomial in the
state and analytic through w = 0:

    dw/ds = δ'/2,   dt/ds = w,   dδ'/ds = −w (F/m_eff + side·a_s),   F = K w³ (1 + β δ')

a_s is the superior base's acceleration by its columns alone; the pair's centre of mass (X, V) does not feel F.
Polynomial right-hand sides give the Taylor series of the solution by recurrence (Cauchy products), so a step is a
power series of order `ORDER`, its length follows from the last coefficients (Jorba & Zou 2005, Experimental
Mathematics 14, 99–117), no step is ever rejected, and the series *is* the dense output: the contact's end, its peaks
and any sample inside it are polynomial evaluations.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from impact_rig.physics.dynamics import LINEAR, rates
from impact_rig.physics.forcing import drive
from impact_rig.physics.series import (
    CENTRE,
    COIL,
    ORDER,
    SPEED,
    V_BASE,
    V_CENTRE,
    X_BASE,
    evaluate,
    expand,
    force_at,
    reached,
    root,
    value,
)
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

LEFT_WALL, OUT_OF_TIME, STIFF, NOT_STIFF, FAILED = range(5)
"""How a contact phase ends: sphere gone, segment over, perhaps better ridden, better not ridden, no progress."""

PATIENCE = 25
"""Steps after which riding is offered the contact: an impact takes about 15."""
_LONGEST = 1e3
_PEAK_ROUNDS = 12  # Newton needs two or three
_FLAT = 1e-6  # of a force, what a step at the slope left at its peak adds: the peak is as good as its square
_BOTTOM_ROUNDS = 30
_POINTS = 8  # a third of the way to a singularity six leave 1e-11; a fast drive over a long contact needs eight
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(_POINTS)
_PLACES = 0.5 * (1.0 + _NODES)


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


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _step_length(p, a, speed_scale, w_scale):  # type: ignore[no-untyped-def]
    """Return the step at which the last two coefficients stay below the tolerance."""
    last = 0.0
    for order in range(ORDER - 1, ORDER + 1):
        last = max(last, abs(a.w[order]) / w_scale)
        last = max(last, abs(a.y[order, SPEED]) / speed_scale)
        last = max(last, abs(a.y[order, V_CENTRE]) / speed_scale)
        last = max(last, abs(a.y[order, V_BASE]) / speed_scale)
    return (p.rtol / last) ** (1.0 / ORDER) if last > 0.0 else math.inf


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _contact_loss(p, a, beta, grip, unit, h):  # type: ignore[no-untyped-def]
    """Return ∫ viscous force · δ' dt over a step, by Gauss–Legendre quadrature of the series.

    Once the contact has let go, what the spring still holds is lost while it relaxes: viscous cancels elastic.
    """
    total = 0.0
    for point in range(_POINTS):
        x = h * _PLACES[point]
        w, speed = a.w[ORDER], a.y[ORDER, SPEED]
        for k in range(ORDER - 1, -1, -1):
            w = w * x + a.w[k]
            speed = speed * x + a.y[k, SPEED]
        elastic, per_speed = p.force.stiffness * w * w, p.force.damping
        if p.force.kind != LINEAR:
            elastic *= w
            per_speed = elastic * beta
        viscous = per_speed * speed if grip > 0.0 else -elastic
        total += _WEIGHTS[point] * viscous * speed * w
    return 0.5 * h * unit * total


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _note_peaks(a, h, w_end, speed_end, s):  # type: ignore[no-untyped-def]
    """Note the largest force and indentation of a step, between its ends too."""
    s[PEAK_INDENTATION] = max(s[PEAK_INDENTATION], w_end * w_end)
    if s[RATE] > 0.0 > speed_end:
        w, _ = value(a.w, root(a.y[:, SPEED], 0.0, False, h))
        s[PEAK_INDENTATION] = max(s[PEAK_INDENTATION], w * w)
    s[PEAK_FORCE] = max(s[PEAK_FORCE], a.force[0])
    if a.force[1] > 0.0:
        force, slope, bend = force_at(a, h)
        s[PEAK_FORCE] = max(s[PEAK_FORCE], force)
        if slope < 0.0:
            left, right = 0.0, h
            x = h
            for _ in range(_PEAK_ROUNDS):  # Newton inside a bracket
                if slope > 0.0:
                    left = x
                else:
                    right = x
                x -= slope / bend
                if not left < x < right:
                    x = 0.5 * (left + right)
                force, slope, bend = force_at(a, x)
                if abs(slope) * h <= _FLAT * abs(force):
                    break
            s[PEAK_FORCE] = max(s[PEAK_FORCE], force)


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


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _release(p, a, beta, grip, h, speed_end):  # type: ignore[no-untyped-def]
    """Return where in a step the force would begin to pull, and so lets go, or presses again; or h."""
    if p.force.kind == LINEAR:
        if grip > 0.0:
            force, _, _ = force_at(a, h)
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
        if speed_end - slope_end * h < limit:  # a curve that turns upwards stays above its tangent
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
            h, ending, grip = reached(a.t, t_end - s[T], h), OUT_OF_TIME, s[GRIP]
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
