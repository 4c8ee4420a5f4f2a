"""Evaluate a trajectory at any instants, after the fact: instruments read the motion and never touch it.

In flight the closed form is expanded into short Taylor polynomials anchored at fixed places of the flight, so a
sample costs a dozen multiplications and does not depend on which other samples are asked for. Inside a contact the
collision's own series is evaluated; riding steps are interpolated.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from impact_rig.physics.dynamics import contact_force, rates
from impact_rig.physics.flight import prepare
from impact_rig.physics.forcing import Forcing, bound_omega, drive, particular, transfer
from impact_rig.physics.hermite import cubic, quintic
from impact_rig.physics.linear import COIL as COIL_STATE
from impact_rig.physics.linear import V1, VB, X1, XB
from impact_rig.physics.model import PRESCRIBED, VOLTAGE
from impact_rig.physics.series import CENTRE, COIL, SPEED, V_BASE, V_CENTRE, X_BASE, evaluate, expand, reached
from impact_rig.physics.state import ATTACHED, BETA, COLLISION, FREE, GAP, GRIP, PHASE, RATE, SIDE, STEP, T, Y

X_B, X_1, X_2, V_B, V_1, V_2, A_B, A_1, A_2, CURRENT, FORCE_LEFT, FORCE_RIGHT = range(12)
QUANTITIES = (
    "x_b", "x_1", "x_2", "v_b", "v_1", "v_2", "a_b", "a_1", "a_2", "current", "force_left", "force_right"
)  # fmt: skip

TERMS = 14
_REACH = 0.5  # radians of the fastest motion per polynomial: the first neglected term is 0.25^14 / 14! = 4e-20


@njit(cache=True, nogil=True, error_model="numpy")
def _add_oscillation(poly, value, growth, rate, order):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Add the Taylor coefficients of Re[(value + growth τ) exp(rate τ)], differentiated `order` times."""
    for _ in range(order):
        value, growth = rate * value + growth, rate * growth
    term, before = 1.0 + 0.0j, 0.0j
    for k in range(TERMS):
        poly[k] += (value * term + growth * before).real
        before = term
        term = term * rate / (k + 1)


@njit(cache=True, nogil=True, error_model="numpy")
def _flight_polynomial(p, system, f, work, push, since, t, quantity, poly):  # type: ignore[no-untyped-def]
    """Fill the Taylor polynomial around t of a quantity of the linear system (not of the sphere)."""
    poly[:] = 0.0
    row, order, of_drive = X1, 0, False
    if quantity == V_1:
        row = V1
    elif quantity == A_1:
        row, order = V1, 1
    elif quantity == X_B:
        row, of_drive = XB, p.drive == PRESCRIBED
    elif quantity == V_B:
        row, order, of_drive = VB, 1 if p.drive == PRESCRIBED else 0, p.drive == PRESCRIBED
    elif quantity == A_B:
        row, order, of_drive = VB, 2 if p.drive == PRESCRIBED else 1, p.drive == PRESCRIBED
    elif quantity == CURRENT:
        row, of_drive = COIL_STATE, p.drive != VOLTAGE
    turn = complex(math.cos(f.omega * t), math.sin(f.omega * t)) * (-1j)  # Im z = Re(−j z)
    if of_drive:
        start = complex(math.cos(f.phase), math.sin(f.phase)) * turn
        _add_oscillation(poly, (f.amplitude + f.slope * t) * start, f.slope * start, 1j * f.omega, order)
        return
    _add_oscillation(
        poly, (work.steady[row] + work.growing[row] * t) * turn, work.growing[row] * turn, 1j * f.omega, order
    )
    modes = system.modes
    for k in range(modes.rate.shape[0]):
        value = modes.right[k, row] * work.modal[k] * np.exp(modes.rate[k] * since)
        _add_oscillation(poly, value, 0.0j, modes.rate[k], order)
    if order == 0:
        poly[0] += system.static[row] * push


@njit(cache=True, nogil=True, error_model="numpy")
def _from_contact(p, f, knot, t, w, speed, centre, v_centre, x_base, v_base, coil, grip, out):  # type: ignore[no-untyped-def]
    """Fill all quantities from a contact's state."""
    side = knot[SIDE]
    u, du = drive(f, t)
    force, _ = contact_force(p.force, w, speed, knot[BETA])
    force *= grip
    _, centre_rate, table, _, _, _, _, _ = rates(
        p, side, knot[BETA], u, du, w, speed, centre, v_centre, x_base, v_base, coil
    )
    offset = side * (p.half_gap + w * w)
    out[X_1] = centre - p.share * offset
    out[X_2] = out[X_1] + offset
    out[V_1] = v_centre - p.share * side * speed
    out[V_2] = out[V_1] + side * speed
    out[A_2] = -side * force / p.m
    out[A_1] = centre_rate * (p.c.m_1 + p.m) * p.per_m_1 + side * force * p.per_m_1
    out[X_B], out[V_B], out[A_B], out[CURRENT] = x_base, v_base, table, u
    if p.drive == PRESCRIBED:
        out[X_B], out[V_B] = u, du
        out[A_B] = 2.0 * f.slope * f.omega * math.cos(f.omega * t + f.phase) - f.omega**2 * u
        out[CURRENT] = 0.0
    elif p.drive == VOLTAGE:
        out[CURRENT] = coil
    out[FORCE_LEFT] = force if side < 0.0 else 0.0
    out[FORCE_RIGHT] = force if side > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _in_collision(p, f, knot, work, fresh, t, out):  # type: ignore[no-untyped-def]
    if fresh:
        expand(p, f, knot, work.series)
    end = work.series.t[0]
    x = 0.0
    if t > end and knot[STEP] > 0.0:
        x = reached(work.series.t, t - end, knot[STEP])
    w, _ = evaluate(work.series, x, work.at)
    at = work.at
    _from_contact(
        p,
        f,
        knot,
        t,
        max(w, 0.0),
        at[SPEED],
        at[CENTRE],
        at[V_CENTRE],
        at[X_BASE],
        at[V_BASE],
        at[COIL],
        knot[GRIP],
        out,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _riding_rates(p, f, knot):  # type: ignore[no-untyped-def]
    u, du = drive(f, knot[T])
    w = math.sqrt(knot[GAP])
    relative, centre, table, coil, _, _, _, _ = rates(
        p, knot[SIDE], knot[BETA], u, du, w, knot[RATE], knot[Y], knot[Y + 1], knot[Y + 2], knot[Y + 3], knot[Y + 4]
    )
    return relative, centre, table, coil


@njit(cache=True, nogil=True, error_model="numpy")
def _in_riding(p, f, knot, after, t, out):  # type: ignore[no-untyped-def]
    h = knot[STEP]
    if h <= 0.0:
        w = math.sqrt(knot[GAP])
        _from_contact(
            p, f, knot, t, w, knot[RATE], knot[Y], knot[Y + 1], knot[Y + 2], knot[Y + 3], knot[Y + 4], 1.0, out
        )
        return
    at = t - knot[T]
    r0, c0, b0, i0 = _riding_rates(p, f, knot)
    r1, c1, b1, i1 = _riding_rates(p, f, after)
    depth, speed, _ = quintic(knot[GAP], knot[RATE], r0, after[GAP], after[RATE], r1, h, at)
    centre, v_centre, _ = quintic(knot[Y], knot[Y + 1], c0, after[Y], after[Y + 1], c1, h, at)
    x_base, v_base, _ = quintic(knot[Y + 2], knot[Y + 3], b0, after[Y + 2], after[Y + 3], b1, h, at)
    coil = cubic(knot[Y + 4], i0, after[Y + 4], i1, h, at)
    w = math.sqrt(max(depth, 0.0))
    _from_contact(p, f, knot, t, w, speed, centre, v_centre, x_base, v_base, coil, 1.0, out)


@njit(cache=True, nogil=True, error_model="numpy")
def sample(model, segments, base, knots, first, wanted, which, offsets, work, poly, out):  # type: ignore[no-untyped-def]
    """Fill out[q, i] with quantity wanted[q] at `offsets[i]` seconds into segment `which[i]`.

    `first[j]` is the row of the first knot of segment base + j; consecutive queries in the same piece reuse its
    coefficients.
    """
    p = model.p
    every = np.empty(13)
    n_wanted = wanted.shape[0]
    current_segment, current_knot, anchor = -1, -1, -1
    f = Forcing(0.0, 0.0, 0.0, 0.0)
    omega, reach, aimed = -1.0, 0.0, False
    system = model.loose
    for i in range(offsets.shape[0]):
        segment = which[i] - base
        t = offsets[i]
        if segment != current_segment:
            row = segments[segment]
            f = Forcing(row["omega"], row["phase"], row["amplitude"], row["slope"])
            current_segment, current_knot, anchor = segment, -1, -1
        low, high = first[segment], first[segment + 1]
        if (
            current_knot < low
            or knots[current_knot, T] > t
            or (current_knot + 1 < high and knots[current_knot + 1, T] <= t)
        ):
            while high - low > 1:
                middle = (low + high) // 2
                if knots[middle, T] <= t:
                    low = middle
                else:
                    high = middle
            fresh = low != current_knot
            current_knot = low
        else:
            fresh = False
        knot = knots[current_knot]
        phase = knot[PHASE]
        if phase in (FREE, ATTACHED):
            attached = phase == ATTACHED
            slide = 0.0 if attached else knot[SIDE]
            push = slide * p.m * p.friction
            if fresh:
                system = model.attached if attached else model.loose
                if f.omega != omega or attached != aimed:
                    omega, aimed = f.omega, attached
                    transfer(system, omega, work.answer, work.drift)
                    reach = _REACH / bound_omega(system, omega)
                particular(f, work.answer, work.drift, work.steady, work.growing)
                prepare(system, f, work, knot[Y:], push, knot[T])
                anchor = -1
            place = int((t - knot[T]) / reach)
            x = t - knot[T] - (place + 0.5) * reach
            if place != anchor:
                anchor = place
                since = (place + 0.5) * reach
                for q in range(n_wanted):
                    quantity = wanted[q]
                    if attached:  # one body: the sphere moves as the base, and a wall may push it
                        if quantity in (X_2, V_2, A_2):
                            quantity -= 1
                        elif quantity >= FORCE_LEFT:
                            quantity = A_1
                    _flight_polynomial(p, system, f, work, push, since, knot[T] + since, quantity, poly[q])
            since = t - knot[T]
            for q in range(n_wanted):
                quantity = wanted[q]
                if attached and quantity != CURRENT:
                    total = poly[q, TERMS - 1]
                    for k in range(TERMS - 2, -1, -1):
                        total = total * x + poly[q, k]
                    if quantity == X_2:
                        total += knot[GAP]
                    elif quantity == FORCE_LEFT:
                        total = max(0.0, p.m * total) if knot[SIDE] < 0.0 else 0.0
                    elif quantity == FORCE_RIGHT:
                        total = max(0.0, -p.m * total) if knot[SIDE] > 0.0 else 0.0
                    out[q, i] = total
                elif quantity == X_2:
                    out[q, i] = (
                        knot[Y + X1]
                        + knot[GAP]
                        + since * (knot[Y + V1] + knot[RATE] - 0.5 * since * slide * p.friction)
                    )
                elif quantity == V_2:
                    out[q, i] = knot[Y + V1] + knot[RATE] - since * slide * p.friction
                elif quantity == A_2:
                    out[q, i] = -slide * p.friction
                elif quantity >= FORCE_LEFT or (quantity == CURRENT and p.drive == PRESCRIBED):
                    out[q, i] = 0.0
                else:
                    total = poly[q, TERMS - 1]
                    for k in range(TERMS - 2, -1, -1):
                        total = total * x + poly[q, k]
                    out[q, i] = total
        else:
            if phase == COLLISION:
                _in_collision(p, f, knot, work, fresh, t, every)
            else:
                _in_riding(p, f, knot, knots[current_knot + 1], t, every)
            for q in range(n_wanted):
                out[q, i] = every[wanted[q]]
