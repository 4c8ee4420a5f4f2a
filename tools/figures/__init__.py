"""Every figure of README and docs: drawn by one command, in one style, from the code and from real simulations.

`make figures` writes them to docs/images. Drawings are SVG with the colours of light and dark in one file: an image
takes those of the page that shows it. `test/test_figures.py` draws them anew and compares, coordinates within 1e-3 of
the canvas. The pictures of the lab are taken from the page itself (`tools/lab_pictures.py`), in a browser.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from tools.figures import animation, contacts, damping, graph, paper, rig, transmissibility
from tools.generate import graph as whole_graph
from tools.generate import house

COMMAND = "make figures"
ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
TAKEN = (
    "lab.gif", "lab.png", "lab_1920_dark.png", "lab_400.png", "lab_playback.png", "lab_rest.png", "lab_tripped.png",
)  # fmt: skip
"""Pictures of the lab's page, by `tools/lab_pictures.py`."""
DRAWN: Mapping[str, Callable[[], str]] = {
    "animation.svg": animation.draw,
    "contact_laws.svg": contacts.draw_laws,
    "contact_order.svg": contacts.draw_order,
    "graph.svg": whole_graph.picture,
    "house.svg": house.picture,
    "impact_damping.svg": damping.draw,
    "nodes.svg": graph.draw,
    "paper.svg": paper.draw,
    "rig.svg": rig.draw,
    "transmissibility.svg": transmissibility.draw,
}
"""Name of a drawing to what draws it."""
