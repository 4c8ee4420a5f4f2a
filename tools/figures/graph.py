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
"""The nodes of the rig and the topics between them; the names are checked against the table of topics."""

from __future__ import annotations

from impact_rig import topics
from tools.figures.style import BASE, INK, MUTED, SPHERE, STRUCTURE, arrow, box, sheet, text

HEIGHT = 430
LEFT, RIGHT = 160.0, 470.0
"""Edges of the box of the rig and of the others."""


def known(name: str) -> str:
    """Return a topic's name.

    Raises:
        LookupError: there is no such topic.
    """
    if name not in {topic.name for topic in topics.COMMON}:
        raise LookupError(f"no topic {name}")
    return name


def draw() -> str:
    """Return the drawing."""
    scan, info, applied, ack = (known(f"{name}") for name in ("daq/scan", "daq/info", "shaker/applied", "daq/ack"))
    frequency, current = known("shaker/frequency"), known("shaker/current")
    parts = [
        text(20, 26, "Nodes and the topics between them", bold=True),
        text(20, 44, "names are relative: a launch file puts all of them into one namespace", colour=MUTED, px=12),
        *_node(20, 64, LEFT - 20, 328, "rig", ("mechanics,", "instruments,", "converter"), BASE),
        *_node(RIGHT, 64, 150, 86, "analysis", ("DT, impacts",), STRUCTURE),
        *_node(RIGHT, 180, 150, 86, "recorder", ("one MCAP per run",), STRUCTURE),
        *_node(RIGHT, 296, 150, 96, "your node", ("or the lab's page,", "stepped_sine, a test"), SPHERE),
        *_told(92, f"{scan}  {info}  {applied}", INK), *_asked(124, ack, MUTED),
        *_told(208, f"the same, {known('rig/journal')}, truth/…", INK), *_asked(240, ack, MUTED),
        *_told(324, f"{scan}, {known('truth/joint_states')}, …", INK), *_asked(358, f"{frequency}  {current}", SPHERE),
        arrow(545, 150, 545, 179, colour=STRUCTURE),
        text(537, 169, f"{known('transmissibility')}, {known('impacts')}", anchor="end", colour=STRUCTURE, px=12),
        text(20, 416, "every node: /diagnostics; the analysis never subscribes to truth/…", colour=MUTED, px=12),
    ]  # fmt: skip
    return sheet(
        HEIGHT,
        "Graph of the nodes: the rig publishes scans, calibration and applied commands; analysis and recorder listen "
        "and acknowledge; your own node, the lab's page or the stepped sine node commands frequency and current.",
        "\n".join(parts),
    )


def _node(x: float, y: float, width: float, height: float, name: str, words: tuple[str, ...], colour: str) -> list[str]:
    """Return a node: its name and its purpose."""
    lines = [
        text(x + width / 2, y + 50 + 18 * row, what, anchor="middle", px=12, symbols=False)
        for row, what in enumerate(words)
    ]
    named = text(x + width / 2, y + 28, name, anchor="middle", colour=colour, bold=True, px=15)
    return [box(x, y, width, height, fill="var(--card)", stroke=colour, rx=10), named, *lines]


def _told(y: float, names: str, colour: str) -> list[str]:
    """Return an arrow from the rig, its topics above it."""
    return [arrow(LEFT, y, RIGHT - 1, y, colour=colour), _names(y - 7, names, colour)]


def _asked(y: float, names: str, colour: str) -> list[str]:
    """Return an arrow to the rig, its topics below it."""
    return [arrow(RIGHT, y, LEFT + 1, y, colour=colour), _names(y + 16, names, colour)]


def _names(y: float, names: str, colour: str) -> str:
    return text((LEFT + RIGHT) / 2, y, names, anchor="middle", colour=colour, px=12, symbols=False)
