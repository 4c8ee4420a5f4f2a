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
"""Every figure of README and docs: drawn by one command, in one style, from the code and from real simulations.

`make figures` writes them to docs/images. Drawings are SVG with the colours of light and dark in one file: an image
takes those of the page that shows it. `test/test_figures.py` draws them again and compares, with coordinates within
1e-3 of the canvas. Drawings that `make generate` makes too, such as that of the layers, must be equal. Pictures of the
lab are taken from its page, in a browser.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from tools import map_picture
from tools.figures import animation, contacts, damping, graph, kernels, paper, rig, simulated, transmissibility

COMMAND = "make figures"
ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
BY_TOOLS: Mapping[str, tuple[str, ...]] = {
    "tools/lab_pictures.py": (
        "lab.gif", "lab.png", "lab_1920_dark.png", "lab_400.png", "lab_playback.png", "lab_rest.png", "lab_tripped.png",
    ),
    "qualification/closed_loop.py backbone --draw": ("backbone.png",),
    "tools/drive_pictures.py": ("drive_random.png", "drive_shock.png", "drive_frf.png"),
    "tools/gallery_pictures.py": (
        "gallery_fig7_all_gaps.png", "gallery_amplitudes.png", "gallery_study_gap.png", "gallery_regimes.png",
        "gallery_trace_gap_10mm.png", "gallery_phase_gap_10mm.png", "gallery_study_laws.png",
        "gallery_study_restitution.png", "gallery_study_mass.png", "gallery_study_amplitude.png",
        "gallery_study_hysteresis.png",
    ),
    "qualification/foreign_rig.py --draw build/foreign": ("comparison.png",),
    **{
        f"tools/map_picture.py {name}": (f"{name}.png",)
        for _, name in map_picture.PICTURES.values()
    },
    "qualification/prediction.py --draw": ("prediction.png",),
    "tools/urdf_picture.py": ("urdf.png",),
}  # fmt: skip
"""Command of a tool to its pictures, of pages or of minutes of measurement; tools that do not exist make none."""
DRAWN: Mapping[str, Callable[[], str]] = {
    "animation.svg": animation.draw,
    "contact_laws.svg": contacts.draw_laws,
    "contact_order.svg": contacts.draw_order,
    "first_look.svg": simulated.draw_first_look,
    "graph.svg": graph.draw,
    "kernels_outcome.svg": kernels.draw_table,
    "kernels_tick.svg": kernels.draw_tick,
    "impact_damping.svg": damping.draw,
    "paper.svg": paper.draw,
    "rig.svg": rig.draw,
    "transmissibility.svg": transmissibility.draw,
}
"""Name of a drawing to the function that draws it."""


def there() -> dict[str, tuple[str, ...]]:
    """Return the part of `BY_TOOLS` whose tools exist in this repository."""
    return {tool: pictures for tool, pictures in BY_TOOLS.items() if (ROOT / tool.split()[0]).exists()}
