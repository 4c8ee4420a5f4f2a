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
"""The picture and the table of packages and rooms: layers from the import contracts, sentences from the sources."""

from __future__ import annotations

import ast
import re
import textwrap
import tomllib
from collections.abc import Callable
from html import escape
from pathlib import Path

from tools.generate.markdown import table

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "images" / "layers.svg"
ON_TOP = [["impact_rig_lab"], ["impact_rig_studies"]]
"""Packages above the rooms of the rig."""
WITH_ROS = ("impact_rig_lab", "impact_rig_studies", "testing", "driver", "client", "nodes")
"""Packages that may import rclpy, according to a separate contract."""

_WIDTH, _MARGIN, _GAP, _PAD, _LINE = 980, 20, 12, 10, 15
_CHARACTER = 6.3  # width of a character in a box, in the widest usual font
_HEAD = """\
<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}"
 font-family="system-ui, sans-serif" font-size="12" role="img"
 aria-label="The packages of impact_rig in layers; each imports only from packages below it">
<style>
.paper {{ fill: #ffffff }} .box {{ fill: #f4f6f8; stroke: #66707c }} .ros {{ fill: #e3f0e6; stroke: #00845f }}
.name {{ fill: #1b1f24; font-weight: 600; font-size: 14px }} .text {{ fill: #1b1f24 }}
@media (prefers-color-scheme: dark) {{
.paper {{ fill: #151a20 }} .box {{ fill: #1f262e; stroke: #9aa4b0 }} .ros {{ fill: #1b2f22; stroke: #35c99a }}
.name {{ fill: #e6e9ed }} .text {{ fill: #e6e9ed }} }}
</style>
<rect class="paper" width="{width}" height="{height}" rx="8"/>
"""


def layers(root: Path = ROOT) -> list[list[str]]:
    """Return packages and rooms of the rig from top to bottom, according to the import contract."""
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    lines = next(contract["layers"] for contract in contracts if contract["name"] == "Layers")
    return [*ON_TOP, *(re.findall(r"\w+", line) for line in lines)]


def sentence(package: str, root: Path = ROOT) -> str:
    """Return the first sentence of a package's or module's docstring."""
    path = root / package if package.startswith("impact_rig") else root / "impact_rig" / package
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    text = ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""
    return text.split("\n\n")[0].replace("\n", " ").replace("`", "")


def picture() -> str:
    """Return the layers as SVG: one row per layer, green where rclpy may be imported."""
    y, boxes = _MARGIN, []
    for packages in layers():
        width = (_WIDTH - 2 * _MARGIN - (len(packages) - 1) * _GAP) / len(packages)
        characters = max(10, int((width - 2 * _PAD) / _CHARACTER))
        texts = [textwrap.wrap(sentence(package), characters) for package in packages]
        height = 2 * _PAD + 18 + _LINE * max(map(len, texts))
        for number, (package, lines) in enumerate(zip(packages, texts, strict=True)):
            boxes.append(_box(package, lines, (_MARGIN + number * (width + _GAP), y, width, height)))
        y += height + _GAP
    boxes.append(
        f'<text class="text" x="{_MARGIN}" y="{y + 14}">A package imports only from packages below it; '
        "in the lowest layer they may see each other. Green ones may import rclpy.</text>"
    )
    return _HEAD.format(width=_WIDTH, height=y + 30) + "\n".join(boxes) + "\n</svg>\n"


def _box(package: str, lines: list[str], place: tuple[float, float, float, float]) -> str:
    x, y, width, height = place
    kind = "ros" if package in WITH_ROS else "box"
    parts = [f'<rect class="{kind}" x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" rx="6"/>']
    parts.append(f'<text class="name" x="{x + _PAD:.1f}" y="{y + _PAD + 12:.1f}">{package}</text>')
    for number, line in enumerate(lines):
        at = y + _PAD + 30 + number * _LINE
        parts.append(f'<text class="text" x="{x + _PAD:.1f}" y="{at:.1f}">{escape(line)}</text>')
    return "\n".join(parts)


def _packages() -> str:
    return table(
        ("package", "content"), ((f"`{package}`", sentence(package)) for packages in layers() for package in packages)
    )


TABLES: dict[str, Callable[[], str]] = {"packages": _packages}
