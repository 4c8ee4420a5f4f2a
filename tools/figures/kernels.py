# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""One tick through the kernels, and the layout of the tabulated outcome; names and sizes are those of the code."""

from __future__ import annotations

import importlib

from impact_rig.physics import outcome
from tools.figures.style import BASE, INK, MUTED, SPHERE, STRUCTURE, arrow, box, sheet, text

_TICK = (  # what leads there, module, colour, kernels, what they do
    ("", "event_loop", BASE, ("run", "_change_phase"), "segment by segment: fly, touch, leave"),
    ("until something happens", "flight", STRUCTURE,
     ("prepare_segment", "begin_flight", "fly", "evaluate", "safe_time", "structure_at"), "closed form, until a wall"),
    ("a touch", "outcome", SPHERE, ("look_up", "apply_outcome"), "a fast contact, from the table"),
    ("beyond the table", "contact_phase", SPHERE, ("take_next_step", "take_step", "conclude"),
     "any other, in steps ended at events"),
    ("each step", "contact_step", SPHERE, ("expand", "solve", "estimate_error"),
     "one step: collocation, Newton, error"),
    ("states at events", "sampling", STRUCTURE, ("sample",), "afterwards: what instruments ask for, at any instant"),
)  # fmt: skip
_ROW, _TOP = 64, 76
_TABLE_TOP, _CELL = 92, 21


def known(module: str, name: str) -> str:
    """Return a kernel's name.

    Raises:
        AttributeError: the module has none of that name.
    """
    return str(getattr(importlib.import_module(f"impact_rig.physics.{module}"), name) and name)


def draw_tick() -> str:
    """Return the path of one tick of 10 ms through the mechanics."""
    parts = [
        text(20, 26, "One tick of 10 ms through the kernels", bold=True),
        text(20, 46, "drive segment and state go in, states at events and impacts come out", colour=MUTED, px=12),
    ]  # fmt: skip
    for row, (why, module, colour, names, what) in enumerate(_TICK):
        y = _TOP + row * _ROW
        parts += [
            box(20, y, 600, _ROW - 20, fill="var(--card)", stroke=colour, rx=8),
            text(32, y + 18, module, colour=colour, bold=True, symbols=False),
            text(608, y + 18, what, anchor="end", colour=MUTED, px=12, symbols=False),
            text(32, y + 36, " · ".join(known(module, name) for name in names), px=12, symbols=False),
        ]
        if row:
            parts.append(arrow(60, y - 20, 60, y - 1, colour=INK))
            parts.append(text(70, y - 6, why, colour=MUTED, px=11))
    return sheet(
        _TOP + len(_TICK) * _ROW + 6,
        "Path of one tick: the event loop flies in closed form to the next touch, takes a contact from the table or "
        "step by step, and leaves states at events, from which the sampler computes what instruments ask for.",
        "\n".join(parts),
    )


def draw_table() -> str:
    """Return the columns of the tabulated outcome: each holds a Chebyshev series in η_0."""
    all_, few = outcome.OUTCOMES, outcome.DECISIVE
    groups = (
        ("outcome", all_, BASE, "at η_1 = η_2 = α = γ = 0"), ("∂/∂η_1", all_, STRUCTURE, "first derivative"),
        ("½ ∂²/∂η_1²", few, SPHERE, "of the first three"), ("∂/∂η_2", few, SPHERE, ""), ("∂/∂α", few, SPHERE, ""),
        ("∂/∂γ", few, SPHERE, ""),
    )  # fmt: skip
    assert sum(count for _, count, _, _ in groups) == outcome.COLUMNS
    parts = [
        text(20, 26, f"Tabulated outcome: {outcome.COEFFICIENTS} rows, {outcome.COLUMNS} columns", bold=True),
        text(20, 46, "row n holds the coefficients of T_n(x), Chebyshev, x = −1 … 1 over the range of η_0",
             colour=MUTED, px=12),
    ]  # fmt: skip
    column = 0
    for row, (name, count, colour, what) in enumerate(groups):
        x = 20 + column * _CELL
        parts += [
            box(x + 1 + i * _CELL, _TABLE_TOP, _CELL - 2, 70, fill="var(--card)", stroke=colour, rx=3)
            for i in range(count)
        ]
        parts.append(text(x + 2, _TABLE_TOP - 8 - 14 * (row % 2), name, colour=colour, px=12))
        parts.append(text(x + 2, _TABLE_TOP + 86 + 14 * (row % 2), what, colour=MUTED, px=11))
        column += count
    parts += [
        text(
            20,
            _TABLE_TOP + 128,
            "in each group: separation speed, duration, energy lost; then, in the first two,",
            px=12,
        ),
        text(20, _TABLE_TOP + 146, "peak force, largest indentation, ∫Δ dθ, ∫(duration − θ) Δ dθ", px=12),
    ]
    return sheet(
        _TABLE_TOP + 164,
        "Layout of the table of contact outcomes: seven quantities, their derivatives by eta 1, and further ones of "
        "the first three; each column a Chebyshev series of 20 coefficients.",
        "\n".join(parts),
    )
