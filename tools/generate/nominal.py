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
"""The complete default configuration as a commented ROS 2 parameter file: the content of `config/nominal.yaml`."""

from __future__ import annotations

import yaml

from impact_rig.config.tree import Value
from impact_rig.rig.config import fields

HEADER = """\
# The paper's rig, complete: every parameter at its default. Written by
#   make generate
#
# Each line is `name: value  # unit; origin: meaning (range)`, where origin is one of
#   paper       printed in the paper
#   identified  chosen so that the paper's published statements hold
#   assumed     plausible catalogue value, or a choice of this project
/**:
  ros__parameters:
"""


def nominal() -> str:
    """Return the text of `config/nominal.yaml`."""
    lines: list[str] = []
    above: list[str] = []
    for name, about, default in fields():
        *sections, key = name.split(".")
        for depth, section in enumerate(sections):
            if sections[: depth + 1] != above[: depth + 1]:
                lines.append(f"{_indent(depth)}{section}:\n")
        above = sections
        limits = f" ({about.range_text()})" if about.choices or about.low is not None or about.high is not None else ""
        comment = f"{about.unit}; {about.origin.value}: {about.doc}{limits}"
        lines.append(f"{_indent(len(sections))}{key}: {scalar(default)}  # {comment}\n")
    return HEADER + "".join(lines)


def _indent(depth: int) -> str:
    return "  " * (depth + 2)


def scalar(value: Value | tuple[float, ...]) -> str:
    """Return a value in the form that YAML and ROS both read: floats with a dot, `on` quoted, no empty list."""
    plain = list(value or ("",)) if isinstance(value, tuple) else value
    text: str = yaml.safe_dump(plain, default_flow_style=True, width=float("inf"))
    return text.removesuffix("...\n").strip()
