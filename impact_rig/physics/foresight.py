# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A solved step as a polynomial: what the next one will be like, and about where in it something happens.

The speeds at the start and at the stages define a polynomial of degree 5 in x = s / h, and through dw/ds = δ'/2 and
dt/ds = w also w and the time. It is a thousandth or a millionth off, not as good as the step itself: it starts
Newton's method, and decides nothing.
"""

from __future__ import annotations

from impact_rig.kernels import kernel
from impact_rig.physics.collocation import NODES, STAGES, TO_POLYNOMIAL

_FAR = 1.6  # times its length: further on the polynomial is worse than a straight line


@kernel
def remember(s, k, h):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Keep the polynomial of the step of length h that was solved from s."""
    for n in range(STAGES + 1):
        total = TO_POLYNOMIAL[n, 0] * s.speed
        for j in range(STAGES):
            total += TO_POLYNOMIAL[n, j + 1] * k.speed[j]
        k.known[n] = total
    k.known_length, k.known_since = h, 0.0


@kernel
def forget(k):  # type: ignore[no-untyped-def]
    """Let the next step begin without a polynomial: what follows must not depend on what was solved before."""
    k.known_length = 0.0


@kernel
def _speed(k, x):  # type: ignore[no-untyped-def]
    """Return δ' at x."""
    speed = k.known[STAGES]
    for n in range(STAGES - 1, -1, -1):
        speed = speed * x + k.known[n]
    return speed


@kernel
def slope_foreseen(k, x):  # type: ignore[no-untyped-def]
    """Return dδ'/ds at x of the step that was solved last."""
    slope = STAGES * k.known[STAGES]
    for n in range(STAGES - 1, 0, -1):
        slope = slope * x + n * k.known[n]
    return slope / k.known_length


@kernel
def guess(s, k, h):  # type: ignore[no-untyped-def]
    """Fill the stages of a step of length h from s with the speeds that are expected there."""
    if k.known_since + h <= _FAR * k.known_length:
        begin, stretch = k.known_since / k.known_length, h / k.known_length
        for i in range(STAGES):
            k.speed[i] = _speed(k, begin + NODES[i] * stretch)
    else:
        for i in range(STAGES):
            k.speed[i] = s.speed + NODES[i] * h * k.start_slope


@kernel
def foreseen(s, k, x):  # type: ignore[no-untyped-def]
    """Return (time since the start [s], w, δ') at x of the step from s, which is the one that was solved last."""
    since, w = 0.0, 0.0
    for n in range(STAGES, -1, -1):
        w = w * x + k.known[n] / (n + 1)
        since = since * x + k.known[n] / ((n + 1) * (n + 2))
    half = 0.5 * k.known_length * x
    return k.known_length * x * (s.w + half * since), s.w + half * w, _speed(k, x)
