"""Hermite interpolation between the ends of a step."""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def quintic(start, end, h, s):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return value and two derivatives at s in [0, h] from (value, slope, curvature) at both ends.

    The value's error is below max|y⁽⁶⁾| h⁶ / 46080.
    """
    y0, d0, e0 = start
    y1, d1, e1 = end
    q = s / h
    rise = y1 - y0 - h * (d0 + 0.5 * h * e0)
    turn = h * (d1 - d0 - h * e0)
    bend = h * h * (e1 - e0)
    c3 = 10.0 * rise - 4.0 * turn + 0.5 * bend
    c4 = -15.0 * rise + 7.0 * turn - bend
    c5 = 6.0 * rise - 3.0 * turn + 0.5 * bend
    value = y0 + s * (d0 + 0.5 * s * e0) + q * q * q * (c3 + q * (c4 + q * c5))
    slope = d0 + s * e0 + q * q * (3.0 * c3 + q * (4.0 * c4 + q * 5.0 * c5)) / h
    curvature = e0 + q * (6.0 * c3 + q * (12.0 * c4 + q * 20.0 * c5)) / (h * h)
    return value, slope, curvature
