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
"""Generator of every page and file that is made from the code: `make generate` rewrites them, a test compares them.

In the pages of docs/ the parts between `<!-- generated: NAME -->` and `<!-- end -->` are generated, each by the
function in `TABLES`. Some files are generated completely: `config/nominal.yaml`, `interface.json`, the texts of the
messages, the SROS2 policy, the URDF, and the pictures of layers and nodes.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from impact_rig.cli.interface import DOCUMENT
from impact_rig.physics.contact import LAWS
from impact_rig.recording.description import DEFINITIONS
from impact_rig.rig.config import RigConfig
from impact_rig.rig.description import robot_description
from tools import sros2_policy
from tools.generate import commands, graph, interface, layers
from tools.generate.markdown import table
from tools.generate.nominal import nominal

COMMAND = "make generate"
ROOT = Path(__file__).parents[2]


def _laws() -> str:
    rows = ((f"`{law.name}`", law.formula, f"{law.returns:.3f}", law.source) for law in LAWS.values())
    return table(("law", "a(e), or its shape", "returned e", "source"), rows)


TABLES: dict[str, Callable[[], str]] = {
    **layers.TABLES,
    **interface.TABLES,
    "contact laws": _laws,
    "commands": commands.reference,
}
"""Name in a page's markers -> function that returns the text."""

_SECTION = re.compile(r"(<!-- generated: (?P<name>[\w ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def rewritten(text: str) -> str:
    """Return a page with its generated parts renewed from the code.

    Raises:
        KeyError: a marker names an unknown table.
    """
    return _SECTION.sub(lambda found: f"{found[1]}\n{TABLES[found['name']]()}\n{found[3]}", text)


def generated() -> dict[Path, str]:
    """Return every file that is generated, completely or in part, with its text according to the code."""
    texts = {page: page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs").rglob("*.md"))}
    pages = {page: rewritten(text) for page, text in texts.items() if _SECTION.search(text)}
    description = robot_description(RigConfig())
    return {
        ROOT / "config" / "nominal.yaml": nominal(),
        DOCUMENT: interface.document(),
        DEFINITIONS: interface.definitions(),
        ROOT / "urdf" / "impact_rig.urdf": description,
        layers.PICTURE: layers.picture(),
        graph.PICTURE: graph.picture(),
        sros2_policy.FILE: sros2_policy.policy(),
        **pages,
    }
