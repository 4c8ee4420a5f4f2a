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
"""The rig in slow motion, drawn from a simulation: two cycles of the steady motion at 9.1 Hz and 6 mm, repeated.

Keyframes of style sheets move everything, so the picture needs no script. It does not move if the reader's system
requests reduced motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from impact_rig_studies.campaign.paper import FREQUENCY_HZ
from tools.figures import simulated
from tools.figures.style import BASE, GRID, INK, MUTED, SPHERE, STRUCTURE, WIDTH, box, line, sheet, text

Real = NDArray[np.float64]

HEIGHT = 400
GAP_M, DIAMETER_M = 6e-3, 6.35e-3
SLOWER = 30
"""Factor by which the picture is slower than the rig."""
FRAMES = 48
PX_PER_M, MAGNIFIED = 15e3, 20
"""Scale factor of the base's motion, which is too small to see."""
CENTRE, FLOOR, DECK, THICK = 320.0, 236.0, 146.0, 22.0
COLUMN_X, COLUMN = (-90.0, 90.0), 54.0
PLOT_TOP, PLOT_MIDDLE, PLOT_SCALE, PLOT_LEFT, PLOT_RIGHT = 290.0, 336.0, 4e3, 100.0, 620.0


def draw() -> str:
    """Return the drawing."""
    steady = simulated.steady(GAP_M, cycles=4)
    period = 1.0 / FREQUENCY_HZ
    hits = steady.impact_times() / period
    hits = hits[(hits > 0.0) & (hits < 1.0)]
    # an instant at every impact, where the straight lines between frames change direction
    places = np.unique(np.concatenate((np.linspace(0.0, 1.0, FRAMES + 1), hits)))
    x_b, x_1, x_2 = steady.at(("x_b", "x_1", "x_2"), places * period)
    moved = {"base": x_b * PX_PER_M * MAGNIFIED, "deck": x_1 * PX_PER_M, "ball": x_2 * PX_PER_M}
    seconds = period * SLOWER
    css = ["@keyframes now { to { transform: translate(%.1fpx, 0); } }" % (0.5 * (PLOT_RIGHT - PLOT_LEFT))]
    css += [_keyframes(name, places, [f"translate({x:.1f}px, 0)" for x in xs]) for name, xs in moved.items()]
    sheared = moved["deck"] - moved["base"]
    bends = zip(moved["base"], sheared, strict=True)
    css.append(_keyframes("bend", places, [f"translate({b:.1f}px, 0) scale({d / 100.0:.3f}, 1)" for b, d in bends]))
    css += [_flash(f"hit{number}", place) for number, place in enumerate(hits)]
    names = ("now", "base", "deck", "ball", "bend", *(f"hit{number}" for number in range(len(hits))))
    css += [f".{name} {{ animation: {name} {seconds:.3f}s linear infinite; }}" for name in names]
    css.append(".flash { opacity: 0; } .column { vector-effect: non-scaling-stroke; }")
    css.append("@media (prefers-reduced-motion: reduce) { * { animation: none !important; } }")
    walls = [1 if side > 0 else -1 for side in np.interp(hits, places, x_2 - x_1)]
    return sheet(
        HEIGHT,
        "The rig in slow motion: the shaker moves the inferior base, columns carry the superior base, and between its "
        "two barriers a steel sphere flies to and fro. Below, the places of barriers and sphere over two cycles.",
        "\n".join((*_scene(walls), *_traces(steady, hits))),
        "\n".join(css) + "\n",
    )


def _keyframes(name: str, places: Real, transforms: list[str]) -> str:
    frames = " ".join(f"{100 * at:.2f}% {{ transform: {how}; }}" for at, how in zip(places, transforms, strict=True))
    return f"@keyframes {name} {{ {frames} }}"


def _flash(name: str, place: float) -> str:
    before, after = 100 * place, 100 * place + 7.0
    dark, lit = "{ opacity: 0; }", "{ opacity: 1; }"
    rise = f"0%, {before - 0.01:.2f}% {dark} {before:.2f}% {lit}"
    return f"@keyframes {name} {{ {rise} {min(after, 100):.2f}%, 100% {dark} }}"


def _scene(walls: list[int]) -> list[str]:
    """Return the bodies; the groups move."""
    inner = 0.5e0 * (GAP_M + DIAMETER_M) * PX_PER_M
    radius = 0.5 * DIAMETER_M * PX_PER_M
    top, thick = DECK - 2.0 * radius - 8.0, 26.0
    deck = [box(CENTRE - 150, DECK, 300, THICK, fill=STRUCTURE, rx=2)]
    deck += [
        box(CENTRE + (inner if side > 0 else -inner - thick), top, thick, DECK - top, fill=MUTED, rx=2)
        for side in (-1, 1)
    ]
    for number, wall in enumerate(walls):
        x = CENTRE + (inner if wall > 0 else -inner - thick)
        deck.append(f'<g class="flash hit{number}">{box(x, top, thick, DECK - top, fill=SPHERE, rx=2)}</g>')
    deck.append(text(CENTRE, DECK + 15, "superior base x_1", anchor="middle", colour="var(--sheet)", bold=True))
    columns = [
        f'<g transform="translate({CENTRE + x:g} 0)"><path class="bend column" d="M0 {FLOOR:g} C0 {FLOOR - COLUMN:g} '
        f'100 {DECK + THICK + 0.35 * COLUMN:g} 100 {DECK + THICK:g}" fill="none" stroke="{INK}" stroke-width="3"/></g>'
        for x in COLUMN_X
    ]
    base = [
        box(CENTRE - 170, FLOOR, 340, 22, fill=BASE, rx=2),
        line(((46, FLOOR + 11), (CENTRE - 170, FLOOR + 11)), colour=BASE, width=6),
    ]
    shine = (f'cx="{CENTRE - 0.3 * radius:.2f}"', f'cy="{DECK - 1.35 * radius:.2f}"', f'r="{0.16 * radius:.2f}"')
    ball = [
        f'<circle cx="{CENTRE:g}" cy="{DECK - radius:.2f}" r="{radius:.2f}" fill="{SPHERE}"/>',
        f'<circle {" ".join(shine)} fill="var(--sheet)" opacity="0.6"/>',
    ]
    moving = {"base": base, "deck": deck, "ball": ball}
    return [
        *columns,
        *(f'<g class="{name}">{"".join(parts)}</g>' for name, parts in moving.items()),
        box(12, FLOOR - 22, 62, 64, fill=MUTED, rx=4),
        text(43, FLOOR + 58, "shaker", anchor="middle", colour=MUTED),
        text(CENTRE, FLOOR + 15, "inferior base x_b", anchor="middle", colour="var(--sheet)", bold=True),
        text(16, 24, f"{FREQUENCY_HZ:g} Hz, gap {GAP_M * 1e3:g} mm", bold=True),
        text(160, 24, f"{SLOWER} times slower; x_b enlarged {MAGNIFIED} times", colour=MUTED),
        line(((WIDTH - 20 - 10e-3 * PX_PER_M, 20), (WIDTH - 20, 20)), width=3),
        text(WIDTH - 20, 38, "10 mm", anchor="end", colour=MUTED),
    ]  # fmt: skip


def _traces(steady: simulated.Steady, hits: Real) -> list[str]:
    """Return the positions over two cycles, and a mark that moves along."""
    period = 1.0 / FREQUENCY_HZ
    cycles = np.unique(np.concatenate((np.linspace(0.0, 2.0, 97), hits, hits + 1.0)))
    x_1, x_2 = steady.at(("x_1", "x_2"), cycles * period)
    across = PLOT_LEFT + 0.5 * cycles * (PLOT_RIGHT - PLOT_LEFT)

    def curve(values: Real) -> list[tuple[float, float]]:
        return [
            (round(float(x), 1), round(float(PLOT_MIDDLE - y * PLOT_SCALE), 1))
            for x, y in zip(across, values, strict=True)
        ]

    upper, lower, sphere = curve(x_1 + 0.5 * GAP_M), curve(x_1 - 0.5 * GAP_M), curve(x_2)
    band = " ".join(f"{x:g},{y:g}" for x, y in (*upper, *reversed(lower)))
    dots = "".join(
        f'<circle cx="{PLOT_LEFT + 0.5 * (hit + turn) * (PLOT_RIGHT - PLOT_LEFT):.1f}"'
        f' cy="{PLOT_MIDDLE - PLOT_SCALE * float(np.interp(hit + turn, cycles, x_2)):.1f}" r="4" fill="{SPHERE}"/>'
        for hit in hits for turn in (0.0, 1.0)
    )  # fmt: skip
    return [
        f'<polygon points="{band}" fill="{GRID}" opacity="0.5"/>',
        line(upper, colour=STRUCTURE), line(lower, colour=STRUCTURE), line(sphere, colour=SPHERE, width=2.5), dots,
        f'<g class="now">{line(((PLOT_LEFT, PLOT_TOP), (PLOT_LEFT, PLOT_MIDDLE + 46)), width=1.2)}</g>',
        text(PLOT_RIGHT, HEIGHT - 8, "two cycles: barriers, sphere, four impacts in each", anchor="end", colour=MUTED),
    ]  # fmt: skip
