# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""One tick through the kernels, and the layout of the tabulated outcome; names and sizes are those of the code."""

from __future__ import annotations

import importlib

from impact_rig.physics import outcome, state
from tools.figures.style import BASE, INK, MUTED, SPHERE, STRUCTURE, arrow, box, line, sheet, text

_FRAME, _TOP, _BOTTOM = 62, 112, 372  # of the event loop, and of the phases in it [px]
_LEFT, _RIGHT, _WIDE = 30, 394, 200  # columns of the phases, and the width of those on the left
_TABLE_TOP, _CELL = 92, 21


def known(module: str, name: str) -> str:
    """Return a kernel's name.

    Raises:
        AttributeError: the module has none of that name.
    """
    return str(getattr(importlib.import_module(f"impact_rig.physics.{module}"), name) and name)


def of(module: str, *names: str) -> str:
    """Return kernels of a module in one line."""
    return " · ".join(known(module, name) for name in names)


def event(names: str, *then: str, when: str = "") -> str:
    """Return some events, and the kernels of the event loop that follow them."""
    assert all(hasattr(state, name) for name in names.split(", ")), names
    return f"{names}{when}: {of('event_loop', *then)}"


def phase(name: str, what: str, x: float, y: float, width: float, height: float, colour: str) -> str:
    """Return the box of a phase."""
    assert hasattr(state, name), name
    return "\n".join([
        box(x, y, width, height, fill="var(--card)", stroke=colour, rx=8),
        text(x + 12, y + 20, name, colour=colour, bold=True, symbols=False),
        text(x + width - 12, y + 20, what, anchor="end", colour=MUTED, px=12, symbols=False),
    ])  # fmt: skip


def small(x: float, y: float, words: str, *, colour: str = INK, anchor: str = "start", px: int = 11) -> str:
    """Return words in small type."""
    return text(x, y, words, colour=colour, anchor=anchor, px=px, symbols=False)


def draw_tick() -> str:
    """Return the phases of the motion and what ends each: the path of one tick of 10 ms through the mechanics."""
    edge, middle, inner = _LEFT + _WIDE, (_LEFT + _WIDE + _RIGHT) / 2, _RIGHT + 10
    contact = (
        ("outcome", of("outcome", "look_up", "apply_outcome"), "a fast one: from the table"),
        ("contact_phase", of("contact_phase", "take_next_step", "conclude"), "any other: step by step"),
        ("contact_step", of("contact_step", "expand", "solve", "estimate_error"), "each step"),
    )
    parts = [
        text(20, 26, "One tick of 10 ms through the kernels", bold=True),
        text(20, 46, "input: drive and state; output: states at events, and impacts", colour=MUTED, px=12),
        box(14, _FRAME, 612, 340, stroke=BASE, rx=8),
        text(26, _FRAME + 19, "event_loop", colour=BASE, bold=True, symbols=False),
        text(614, _FRAME + 19, of("event_loop", "run", "_change_phase"), anchor="end", px=12, symbols=False),
        phase("FREE", "flight", _LEFT, _TOP, _WIDE, 92, STRUCTURE),
        small(_LEFT + 12, _TOP + 42, of("flight", "prepare_segment", "begin_flight")),
        small(_LEFT + 12, _TOP + 60, of("flight", "fly", "evaluate", "safe_time")),
        small(_LEFT + 12, _TOP + 78, of("flight", "structure_at")),
        phase("ATTACHED", "one body", _LEFT, 302, _WIDE, _BOTTOM - 302, STRUCTURE),
        small(_LEFT + 12, 344, of("flight", "prepare_segment", "begin_flight")),
        small(_LEFT + 12, 362, of("flight", "fly_attached", "evaluate", "safe_time"), px=10),
        phase("CONTACT", "the wall yields", _RIGHT, _TOP, 222, _BOTTOM - _TOP, SPHERE),
        arrow(edge, 142, _RIGHT - 1, 142),
        small(middle, 136, event("TOUCHED", "_touch"), anchor="middle"),
        arrow(_RIGHT, 186, edge + 1, 186),
        small(middle, 180, event("SEPARATED, RELEASED", "_leave"), anchor="middle", px=10),
        arrow(_RIGHT, 340, edge + 1, 340),
        small(middle, 334, event("SETTLED", "_leave", "_hold"), anchor="middle"),
        line(((70, _TOP), (70, 98), (110, 98))),
        arrow(110, 98, 110, _TOP - 1),
        small(118, 102, event("TOUCHED", "_bounce", when=", rigid wall")),
        small(330, 102, event("STOPPED", "_part", when=", slides back")),
        arrow(190, _TOP + 92, 190, 301),
        small(198, 240, event("STOPPED", "_hold", when=", held")),
        small(198, 260, event("TOUCHED", "_bounce", when=", rigid, slow")),
        arrow(50, 302, 50, _TOP + 93),
        small(58, 262, event("PARTED", "_part")),
        small(320, 392, "PAUSED at the end of a segment or after 500 steps of a contact: continues", anchor="middle"),
        arrow(50, _FRAME + 340, 50, 435),
        small(60, 424, "history: the state at each event, and at each step of a contact", colour=MUTED),
        box(14, 436, 612, 48, fill="var(--card)", stroke=STRUCTURE, rx=8),
        text(26, 455, "sampling", colour=STRUCTURE, bold=True, symbols=False),
        text(614, 455, "afterwards, for interlock, truth and instruments", anchor="end", colour=MUTED, px=12),
        text(26, 474, of("sampling", "sample"), px=12, symbols=False),
        text(78, 474, "at instants", colour=MUTED, px=12),
        text(340, 474, of("sampling", "refine", "fit"), px=12, symbols=False),
        text(614, 474, "polynomials between breakpoints", anchor="end", colour=MUTED, px=12),
    ]  # fmt: skip
    for row, (module, names, what) in enumerate(contact):
        y = _TOP + 32 + row * 76
        parts += [
            box(inner, y, 202, 62, stroke=SPHERE, rx=6),
            text(inner + 10, y + 18, module, colour=SPHERE, bold=True, px=12, symbols=False),
            small(inner + 10, y + 36, names),
            small(inner + 10, y + 53, what, colour=MUTED),
        ]
    return sheet(
        494,
        "Path of one tick: the phases FREE, CONTACT and ATTACHED, the events that end each, the phase that follows, "
        "and the kernels of each; the history of states goes to the sampler, which computes what instruments ask for.",
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
    assert sum(count for _, count, _, _ in groups) == outcome.SERIES_COUNT
    parts = [
        text(20, 26, f"Tabulated outcome: {outcome.COEFFICIENTS} rows, {outcome.SERIES_COUNT} columns", bold=True),
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
    first = "in each group: separation speed, duration, energy lost; then, in the first two,"
    parts += [
        text(20, _TABLE_TOP + 128, first, px=12),
        text(20, _TABLE_TOP + 146, "peak force, largest indentation, ∫Δ dθ, ∫(θ_end − θ) Δ dθ", px=12),
    ]
    return sheet(
        _TABLE_TOP + 164,
        "Layout of the table of contact outcomes: seven quantities, their derivatives by eta 1, and further ones of "
        "the first three; each column a Chebyshev series of 20 coefficients.",
        "\n".join(parts),
    )
