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
"""The rig with its symbols and instruments, after the paper's sketch."""

from __future__ import annotations

from tools.figures.style import BASE, INK, MUTED, SERIES, SPHERE, STRUCTURE, arrow, box, line, sheet, text

HEIGHT = 430
CENTRE, DECK, FLOOR = 300.0, 150.0, 262.0
INSTRUMENT = SERIES[3]


def draw() -> str:
    """Return the drawing."""
    parts = [*_bodies(), *_symbols(), *_instruments(), *_daq()]
    return sheet(
        HEIGHT,
        "Sketch of the rig: the shaker's coil pushes the inferior base; two columns carry the superior base with two "
        "barriers and the loose sphere between them. Four instruments are marked: 1 accelerometer and 2 laser on the "
        "superior base, 3 displacement sensor on the inferior base, 4 current monitor of the amplifier. All go to one "
        "multiplexed converter.",
        "\n".join(parts),
    )


def _bodies() -> list[str]:
    columns = [line(((CENTRE + x, FLOOR), (CENTRE + x, DECK + 14)), width=4) for x in (-90, 90)]
    return [
        *columns,
        box(CENTRE - 150, DECK, 300, 16, fill=STRUCTURE, rx=2),
        box(CENTRE - 118, DECK - 84, 26, 84, fill=MUTED, rx=2),
        box(CENTRE + 92, DECK - 84, 26, 84, fill=MUTED, rx=2),
        f'<circle cx="{CENTRE - 30:g}" cy="{DECK - 40:g}" r="40" fill="{SPHERE}"/>',
        box(CENTRE - 170, FLOOR, 340, 24, fill=BASE, rx=2),
        line(((96, FLOOR + 12), (CENTRE - 170, FLOOR + 12)), colour=BASE, width=6),
        box(24, FLOOR - 26, 76, 76, fill=MUTED, rx=4),
        text(62, FLOOR + 16, "shaker", anchor="middle", colour="var(--sheet)", bold=True),
        line(((CENTRE - 170, FLOOR + 30), (CENTRE + 170, FLOOR + 30)), colour=MUTED, more='stroke-dasharray="2 5"'),
    ]


def _symbols() -> list[str]:
    gap = DECK - 100
    return [
        # the gap is what the sphere leaves free
        arrow(CENTRE + 50, gap + 60, CENTRE + 11, gap + 60, colour=INK),
        arrow(CENTRE + 52, gap + 60, CENTRE + 91, gap + 60, colour=INK),
        text(CENTRE + 51, gap + 52, "g", anchor="middle", bold=True),
        text(CENTRE - 30, DECK - 35, "m", anchor="middle", colour="var(--sheet)", bold=True, px=16),
        text(CENTRE, DECK + 32, "m_1", anchor="middle", colour=STRUCTURE, bold=True, px=15),
        text(CENTRE + 100, DECK + 66, "k_1, c_1", bold=True, px=15),
        text(CENTRE, FLOOR + 17, "m_b", anchor="middle", colour="var(--sheet)", bold=True, px=15),
        arrow(CENTRE - 30, DECK - 96, CENTRE + 20, DECK - 96, colour=SPHERE),
        text(CENTRE + 26, DECK - 92, "x_2", colour=SPHERE, bold=True, px=15),
        arrow(CENTRE - 150, DECK + 34, CENTRE - 104, DECK + 34, colour=STRUCTURE),
        text(CENTRE - 166, DECK + 54, "x_1", colour=STRUCTURE, bold=True, px=15),
        arrow(CENTRE - 60, FLOOR - 14, CENTRE - 14, FLOOR - 14, colour=BASE),
        text(CENTRE - 8, FLOOR - 10, "x_b", colour=BASE, bold=True, px=15),
        text(62, FLOOR - 36, "force K_f i", anchor="middle"),
        text(CENTRE - 105, DECK - 94, "barriers", anchor="middle", colour=MUTED),
    ]  # fmt: skip


def _mark(x: float, y: float, number: int) -> str:
    return (
        f'<circle cx="{x:g}" cy="{y:g}" r="11" fill="var(--sheet)" stroke="{INSTRUMENT}" stroke-width="2"/>'
        f"{text(x, y + 5, str(number), anchor='middle', colour=INSTRUMENT, bold=True)}"
    )


def _instruments() -> list[str]:
    beam = 'stroke-dasharray="6 4"'
    return [
        # 1: on the superior base's end
        box(CENTRE - 168, DECK + 1, 18, 14, fill=INSTRUMENT, rx=2), _mark(CENTRE - 186, DECK - 12, 1),
        # 2: a laser that looks at the other end
        box(560, DECK - 8, 46, 32, fill=INSTRUMENT, rx=3),
        line(((560, DECK + 8), (CENTRE + 152, DECK + 8)), colour=INSTRUMENT, more=beam), _mark(583, DECK - 28, 2),
        # 3: between the floor and the inferior base
        box(560, FLOOR - 2, 46, 28, fill=INSTRUMENT, rx=3),
        line(((560, FLOOR + 12), (CENTRE + 170, FLOOR + 12)), colour=INSTRUMENT, width=3), _mark(583, FLOOR - 20, 3),
        # 4: in the amplifier's lead
        _mark(62, FLOOR + 70, 4),
    ]  # fmt: skip


def _daq() -> list[str]:
    y = 356.0
    lead = [
        line(((62, FLOOR + 50), (62, FLOOR + 59)), colour=INSTRUMENT),
        line(((62, FLOOR + 81), (62, y + 24), (150, y + 24)), colour=INSTRUMENT),
    ]
    words = (
        ("1", "accelerometer", "a_1, piezoelectric"), ("2", "laser", "x_1, triangulation"),
        ("3", "base", "x_b, inductive"), ("4", "current", "i, phase reference"),
    )  # fmt: skip
    box_ = [box(150, y - 8, 470, 66, fill="var(--card)", stroke=MUTED, rx=6)]
    labels = []
    for place, (number, name, what) in enumerate(words):
        x, row = 162 + 240 * (place % 2), y + 14 + 24 * (place // 2)
        labels.append(text(x, row, f"{number}  {name}", colour=INSTRUMENT, bold=True))
        labels.append(text(x + (126, 90)[place % 2], row, what, colour=INK, px=12))
    labels.append(
        text(385, y - 16, "one 16-bit converter, four channels one after the other", anchor="middle", colour=MUTED)
    )
    return [*lead, *box_, *labels]
