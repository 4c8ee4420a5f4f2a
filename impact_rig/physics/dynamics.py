"""The equations of motion of a contact, in the pair's centre of mass and the indentation."""

from __future__ import annotations

from numba import njit

from impact_rig.physics.contact.base import ForceKind
from impact_rig.physics.model import PRESCRIBED, VOLTAGE

LINEAR = int(ForceKind.LINEAR)


@njit(cache=True, nogil=True, error_model="numpy")
def contact_force(force, w, speed, beta):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return the contact force [N] at indentation w², and its dissipative part."""
    if force.kind == LINEAR:
        elastic, viscous = force.stiffness * w * w, force.damping * speed
    else:
        elastic = force.stiffness * w * w * w
        viscous = elastic * beta * speed
    total = elastic + viscous
    if force.clipped and total < 0.0:
        return 0.0, -elastic
    return total, viscous


@njit(cache=True, nogil=True, error_model="numpy")
def rates(p, side, beta, u, du, w, speed, centre, v_centre, x_b, v_b, coil):  # type: ignore[no-untyped-def]
    """Return d/dt of (δ', V, v_b, i) under the drive u, u', and the powers (work, columns, shaker, contact) [W]."""
    c = p.c
    if p.drive == PRESCRIBED:
        x_b, v_b = u, du
    x_1 = centre - p.share * side * (p.half_gap + w * w)
    stretch = v_centre - p.share * side * speed - v_b
    column = -c.k_1 * (x_1 - x_b) - c.c_1 * stretch
    force, viscous = contact_force(p.force, w, speed, beta)
    relative = -force * p.per_m_eff - side * column * p.per_m_1
    lost_columns = c.c_1 * stretch * stretch
    lost_contact = viscous * speed
    if p.drive == PRESCRIBED:
        return relative, column * p.per_m_pair, 0.0, 0.0, column * v_b, lost_columns, 0.0, lost_contact
    current, dcoil, work = u, 0.0, 0.0
    lost_shaker = c.c_f * v_b * v_b
    if p.drive == VOLTAGE:
        current = coil
        dcoil = (u - c.resistance * coil - c.force_factor * v_b) / c.inductance
        lost_shaker += c.resistance * coil * coil
        work = u * coil
    else:
        work = c.force_factor * u * v_b
    table = (c.force_factor * current - c.c_f * v_b - c.k_f * x_b - column) * p.per_m_base
    return relative, column * p.per_m_pair, table, dcoil, work, lost_columns, lost_shaker, lost_contact
