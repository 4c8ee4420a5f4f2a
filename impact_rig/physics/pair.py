# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Structure and sphere as one body while they touch: how it moves during a step of a contact.

x_1 and x_2 are superior base (mass m_1, with the walls) and sphere (mass m), x_b the inferior base that the columns
k_1, c_1 stand on (mass m_a + m_b, on k_f, c_f), i the current of its coil. While the sphere indents the wall on `side`
by δ, x_2 − x_1 = side (g/2 + δ). In a contact the structural state y holds the centre of mass of both, measured as the
position that x_1 has at δ = 0:

    x_1* = x_1 + side σ δ,   v_1* = v_1 + side σ δ',   σ = m / (m_1 + m)
    (m_1 + m) x_1*'' = Q,    Q = −k_1 (x_1* − x_b) − c_1 (v_1* − v_b)
    (m_a + m_b) x_b'' = K_f i − c_f x_b' − k_f x_b − Q,    voltage drive: L i' = U − R i − K_f x_b'

The contact force is inner to the pair and does not appear; a prescribed base moves as it is told. These equations give
y as Taylor polynomials in time (`expand`), and the thrust −side Q / m_1, the relative acceleration [m/s²] with which
the columns press sphere and wall together: m_1 x_1'' = Q + side F, m x_2'' = −side F.

That leaves out what the indentation adds to Q, side σ (k_1 δ + c_1 δ'), most often a millionth of it. It moves the pair
by side σ z, its `recoil`, from z = 0 at the start of each step on:

    z_x1' = z_v1,   (m_1 + m) z_v1' = q,    q = k_1 (δ − z_x1 + z_xb) + c_1 (δ' − z_v1 + z_vb)
    z_xb' = z_vb,   (m_a + m_b) z_vb' = K_f z_i − c_f z_vb − k_f z_xb − q,   L z_i' = −R z_i − K_f z_vb

It is known at the stages of the step, in whose variable s a derivative is w times that in time.
"""

from __future__ import annotations

from impact_rig.arithmetic.elementary import sincos
from impact_rig.kernels import kernel
from impact_rig.physics.collocation import MATRIX, STAGES
from impact_rig.physics.parameters import PRESCRIBED, VOLTAGE
from impact_rig.physics.state import COIL, STRUCTURE, TERMS, V1, VB, X1, XB

FEW = 8
_FEW_REACH, _REACH = 0.03, 0.25  # radians of the fastest motion in one step: what FEW and TERMS leave out is 1e-16
_AMPLE = 4.0  # the terms are chosen before the step is: it may end up shorter, or a bit longer than its start tells


@kernel
def expand(p, f, s, k):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Fill `k.path` and `k.thrust` with the pair's Taylor coefficients about the state s, drive included.

    As many terms as the step that is foreseen needs, and how long they hold: `k.terms`, `k.reach`.
    """
    path = k.path
    fastest = max(p.fastest, f.omega)
    foreseen = _AMPLE * s.next_step * max(s.w, 0.5 * s.next_step * abs(s.speed))  # ∫ w ds, with w + (δ'/2) s
    k.terms, k.reach = FEW, _FEW_REACH / fastest
    if foreseen > k.reach:
        k.terms, k.reach = TERMS, _REACH / fastest
    k.fastest_time = 1.0 / fastest
    for q in range(STRUCTURE):
        path[q, 0] = s.y[q]
    level = f.amplitude + f.slope * s.t
    sine, cosine = sincos(f.omega * s.t + f.phase)  # then their coefficients, order by order
    drive = level * sine
    for n in range(k.terms):
        per = 1.0 / (n + 1)
        sine_next, cosine_next = f.omega * cosine * per, -f.omega * sine * per
        drive_next = level * sine_next + f.slope * sine
        if p.drive == PRESCRIBED:
            path[XB, n], path[VB, n] = drive, (n + 1) * drive_next
        columns = -p.k_1 * (path[X1, n] - path[XB, n]) - p.c_1 * (path[V1, n] - path[VB, n])
        k.thrust[n] = -s.side * columns * p.per_m_1
        if n + 1 < k.terms:
            path[X1, n + 1] = path[V1, n] * per
            path[V1, n + 1] = columns * p.per_m_pair * per
            if p.drive != PRESCRIBED:
                current = drive
                if p.drive == VOLTAGE:
                    current = path[COIL, n]
                    path[COIL, n + 1] = (drive - p.resistance * current - p.force_factor * path[VB, n]) * (
                        p.per_inductance * per
                    )
                table = p.force_factor * current - p.c_f * path[VB, n] - p.k_f * path[XB, n] - columns
                path[XB, n + 1] = path[VB, n] * per
                path[VB, n + 1] = table * p.per_m_base * per
        sine, cosine, drive = sine_next, cosine_next, drive_next


@kernel
def polynomial(coefficients, x, terms):  # type: ignore[no-untyped-def]
    """Return the Taylor polynomial at x, from its first terms."""
    total = coefficients[terms - 1]
    for n in range(terms - 2, -1, -1):
        total = total * x + coefficients[n]
    return total


@kernel
def moved(k, since, y):  # type: ignore[no-untyped-def]
    """Fill y with the pair's state `since` seconds after the start of the step, without its recoil."""
    for q in range(STRUCTURE):
        y[q] = polynomial(k.path[q], since, k.terms)


@kernel
def _integrate(k, state, h):  # type: ignore[no-untyped-def]
    """Fill the recoil of one state at the stages from its slopes d/ds there."""
    slope, recoil = k.recoil_slope[state], k.recoil[state]
    for i in range(STAGES):
        total = 0.0
        for j in range(STAGES):
            total += MATRIX[i, j] * slope[j]
        recoil[i] = h * total


@kernel
def improve_recoil(p, k, h):  # type: ignore[no-untyped-def]
    """Improve the recoil z at the stages by one sweep of fixed-point iteration; each sweep adds an order in h."""
    z, slope = k.recoil, k.recoil_slope
    for j in range(STAGES):
        push = p.k_1 * (k.w[j] * k.w[j] - z[X1, j] + z[XB, j]) + p.c_1 * (k.speed[j] - z[V1, j] + z[VB, j])
        slope[V1, j] = k.w[j] * push * p.per_m_pair
        if p.drive != PRESCRIBED:
            table = p.force_factor * z[COIL, j] - p.c_f * z[VB, j] - p.k_f * z[XB, j] - push
            slope[VB, j] = k.w[j] * table * p.per_m_base
    _integrate(k, V1, h)
    for j in range(STAGES):
        slope[X1, j] = k.w[j] * z[V1, j]
    _integrate(k, X1, h)
    if p.drive != PRESCRIBED:
        _integrate(k, VB, h)
        for j in range(STAGES):
            slope[XB, j] = k.w[j] * z[VB, j]
        _integrate(k, XB, h)
    if p.drive == VOLTAGE:
        for j in range(STAGES):
            voltage = -p.resistance * z[COIL, j] - p.force_factor * z[VB, j]
            slope[COIL, j] = k.w[j] * voltage * p.per_inductance
        _integrate(k, COIL, h)


@kernel
def add_recoil(p, side, k, stage, y):  # type: ignore[no-untyped-def]
    """Add the recoil at a stage to y."""
    for q in range(STRUCTURE):
        y[q] += side * p.share * k.recoil[q, stage]
