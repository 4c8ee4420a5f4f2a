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
"""Comparison of two drawings: texts and elements exactly, coordinates within a part of the canvas.

The last digits of a plot depend on the CPU and the libraries that drew it.
"""

from __future__ import annotations

import re

TOLERANCE = 1e-3
"""Part of the canvas' width."""

_TEXTS = re.compile(r"<text.*?</text>|<title>.*?</title>", re.DOTALL)
_TAGS = re.compile(r"<[^>]*>")
_COLOURS = re.compile(r"#[0-9a-f]{6}")
_NUMBER = re.compile(r"(?<![\w#.])-?\d+(?:\.\d+)?(?:e-?\d+)?")
_WIDTH = re.compile(r'viewBox="0 0 ([\d.]+) ')


def difference(one: str, other: str, tolerance: float = TOLERANCE) -> str | None:
    """Return a description of the first difference, or None."""
    if written(one) != written(other):
        return "the texts differ"
    if _COLOURS.findall(one) != _COLOURS.findall(other):
        return "the colours differ"
    if shape(one) != shape(other):
        return "the elements differ"
    width = _WIDTH.search(one)
    if width is None:
        return "it has no viewBox"
    allowed = tolerance * float(width[1])
    pairs = zip(_NUMBER.findall(one), _NUMBER.findall(other), strict=True)
    worst = max((abs(float(a) - float(b)) for a, b in pairs), default=0.0)
    return f"a coordinate differs by {worst:.3g} of {width[1]}" if worst > allowed else None


def written(svg: str) -> list[str]:
    """Return the texts of a drawing."""
    return [_TAGS.sub("", found) for found in _TEXTS.findall(svg)]


def shape(svg: str) -> str:
    """Return a drawing with every number replaced."""
    return _NUMBER.sub("0", svg)
