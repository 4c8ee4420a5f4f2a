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
"""Picture of the nodes and the topics between them, from the description of the graph."""

from __future__ import annotations

import itertools
from html import escape
from pathlib import Path

from impact_rig import graph
from impact_rig.nodes.messages import TOPICS

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "images" / "nodes.svg"
NODES = {"stepped_sine": (20, 24), "rig": (20, 300), "analysis": (600, 150), "recorder": (600, 460)}
"""Positions of the boxes, upper left corner."""
SIZE = (240, 64)
SAYS = {
    "stepped_sine": "sweeps, as an operator would",
    "rig": "simulates and measures",
    "analysis": "transmissibility, impacts",
    "recorder": "MCAP",
}
LABELS = {
    ("rig", "analysis"): (290, 205),
    ("analysis", "rig"): (460, 292),
    ("rig", "recorder"): (455, 330),
    ("recorder", "rig"): (350, 450),
    ("analysis", "recorder"): (742, 300),
    ("stepped_sine", "rig"): (20, 160),
    ("analysis", "stepped_sine"): (420, 95),
    ("rig", "stepped_sine"): (162, 190),
}
"""Positions of the texts at the arrows; the sweep's topics to the recorder are left out."""
MOST = 5
_HEAD = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 900 560" font-family="system-ui, sans-serif" font-size="12"
 role="img" aria-label="The nodes of impact_rig and the topics between them">
<style>
.paper {{ fill: #ffffff }} .box {{ fill: #e3f0e6; stroke: #4b7d57 }} .line {{ stroke: #5b7083; fill: none }}
.name {{ fill: #10212e; font-weight: 600; font-size: 14px }} .text {{ fill: #33424f }} .tip {{ fill: #5b7083 }}
@media (prefers-color-scheme: dark) {{
.paper {{ fill: #11181f }} .box {{ fill: #1b2f22; stroke: #6fae80 }} .line {{ stroke: #7f95a8 }}
.name {{ fill: #f0f5f9 }} .text {{ fill: #c3d0db }} .tip {{ fill: #7f95a8 }} }}
</style>
<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto-start-reverse">
<path class="tip" d="M0 0 8 4 0 8z"/></marker></defs>
<rect class="paper" width="900" height="560"/>
"""


def edges() -> dict[tuple[str, str], list[str]]:
    """Return the topics from one node to another, by the names of both, without `/clock` and `/diagnostics`."""
    nodes = {node.name: node for node in graph.NODES}
    found: dict[tuple[str, str], list[str]] = {}
    for source, sink in itertools.permutations(NODES, 2):
        common = {*nodes[source].published(TOPICS)} & {*nodes[sink].subscribed(TOPICS)}
        names = sorted(name for name in common if not name.startswith("/"))
        if names:
            found[source, sink] = names
    return found


def picture() -> str:
    """Return the graph as SVG."""
    parts = []
    for (source, sink), names in edges().items():
        if (source, sink) not in LABELS:
            continue
        x, y = LABELS[source, sink]
        parts.append(_arrow(source, sink))
        shown = names if len(names) <= MOST else [*names[: MOST - 1], f"and {len(names) - MOST + 1} more"]
        parts += [
            f'<text class="text" x="{x}" y="{y + 15 * number}">{escape(name)}</text>'
            for number, name in enumerate(shown)
        ]
    for name, (x, y) in NODES.items():
        width, height = SIZE
        parts.append(f'<rect class="box" x="{x}" y="{y}" width="{width}" height="{height}" rx="8"/>')
        parts.append(f'<text class="name" x="{x + 12}" y="{y + 26}">{name}</text>')
        parts.append(f'<text class="text" x="{x + 12}" y="{y + 46}">{SAYS[name]}</text>')
    return _HEAD.format() + "\n".join(parts) + "\n</svg>\n"


def _arrow(source: str, sink: str) -> str:
    """Return a line between two boxes; the two directions of a pair are next to each other."""
    (x0, y0), (x1, y1) = NODES[source], NODES[sink]
    width, height = SIZE
    side = 14 if source < sink else -14
    if abs(x1 - x0) > width:
        start = (x0 + width if x1 > x0 else x0, y0 + height / 2 + side)
        end = (x1 if x1 > x0 else x1 + width, y1 + height / 2 + side)
    else:
        start = (x0 + width / 2 + side, y0 + height if y1 > y0 else y0)
        end = (x1 + width / 2 + side, y1 if y1 > y0 else y1 + height)
    return f'<line class="line" x1="{start[0]}" y1="{start[1]}" x2="{end[0]}" y2="{end[1]}" marker-end="url(#tip)"/>'
