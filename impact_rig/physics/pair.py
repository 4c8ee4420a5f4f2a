"""Structure and sphere as one body while they touch: its motion as a Taylor polynomial.

During a contact the structural state y is that of the pair, as if the sphere did not indent the wall:

    x_1* = x_1 + side σ δ,   v_1* = v_1 + side σ δ',   σ = m / (m_1 + m)
    (m_1 + m) x_1*'' = Q,    Q = −k_1 (x_1* − x_b) − c_1 (v_1* − v_b)
    (m_a + m_b) x_b'' = K_f i − c_f x_b' − k_f x_b − Q,    L i' = U − R i − K_f x_b'   (voltage drive)

The contact force is inner to the pair and does not appear. What the indentation adds to Q, side σ (k_1 δ + c_1 δ'),
is a millionth of Q: each step adds its effect at its end (`kicked`). Q presses sphere and wall
together with the relative acceleration −side Q / m_1, the `thrust`.
"""

from __future__ import annotations

from numba import njit

from impact_rig.arithmetic.elementary import sincos
from impact_rig.physics.parameters import PRESCRIBED, VOLTAGE
from impact_rig.physics.state import COIL, STRUCTURE, TERMS, V1, VB, X1, XB

FEW = 8
_FEW_REACH, _REACH = 0.03, 0.25  # radians of the fastest motion in one step: what FEW and TERMS leave out is 1e-16
_AMPLE = 4.0  # how much longer a step may turn out than it was foreseen


@njit(cache=True, nogil=True, error_model="numpy")
def expand(p, f, s, k):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Fill `k.path` and `k.thrust` with the pair's Taylor coefficients about the state s, drive included.

    As many terms as the step that is foreseen needs, and how long they hold: `k.terms`, `k.reach`.
    """
    path = k.path
    fastest = max(p.fastest, f.omega)
    foreseen = _AMPLE * s.next_step * max(s.w, 0.5 * s.next_step * abs(s.w_rate))
    k.terms, k.reach = FEW, _FEW_REACH / fastest
    if foreseen > k.reach:
        k.terms, k.reach = TERMS, _REACH / fastest
    k.fastest = fastest
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


@njit(cache=True, nogil=True, error_model="numpy")
def polynomial(coefficients, x, terms):  # type: ignore[no-untyped-def]
    """Return the Taylor polynomial at x, from its first terms."""
    total = coefficients[terms - 1]
    for n in range(terms - 2, -1, -1):
        total = total * x + coefficients[n]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def moved(k, since, y):  # type: ignore[no-untyped-def]
    """Fill y with the pair's state `since` seconds after the start of the step."""
    for q in range(STRUCTURE):
        y[q] = polynomial(k.path[q], since, k.terms)


@njit(cache=True, nogil=True, error_model="numpy")
def kicked(p, side, impulse, moment, y):  # type: ignore[no-untyped-def]
    """Add to y what the indentation did to the pair: ∫ (k_1 δ + c_1 δ') dt [N s], and its integral [N s²]."""
    y[V1] += side * p.share * impulse * p.per_m_pair
    y[X1] += side * p.share * moment * p.per_m_pair
    if p.drive != PRESCRIBED:
        y[VB] -= side * p.share * impulse * p.per_m_base
        moved_base = -side * p.share * moment * p.per_m_base
        y[XB] += moved_base
        if p.drive == VOLTAGE:
            y[COIL] -= p.force_factor * p.per_inductance * moved_base
