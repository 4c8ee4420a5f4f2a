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
"""Drawing of docs/images/urdf.png from urdf/impact_rig.urdf: `python -m tools.urdf_picture`.

pytransform3d reads the file and computes the positions, so the picture shows how another program understands it. The
bases and the sphere are displaced by the values of a run at 6 mm, enlarged twelve times.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from xml.etree import ElementTree as ET

import matplotlib as mpl
import numpy as np
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray
from pytransform3d.urdf import UrdfTransformManager

mpl.use("agg")
import matplotlib.pyplot as plt  # after the choice of the backend

ROOT = Path(__file__).parents[1]
URDF = ROOT / "urdf" / "impact_rig.urdf"
PICTURE = ROOT / "docs" / "images" / "urdf.png"
SHOWN_M = {"base": -0.006, "structure": 0.02, "sphere": 0.017}
FRAMES = {"rig": (0, 0, -0.02), "laser": (0, 0, 0.03), "base_sensor": (0.02, 0, 0.025), "superior_base": (0, 0, 0.055)}
FRAMES |= {"inferior_base": (-0.03, -0.07, -0.02)}
AXIS_M = 0.03

Array = NDArray[np.float64]


def faces(size: Array) -> list[Array]:
    """Return the six faces of a box about its middle, each of shape (4, 3)."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
    quads = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
    return [corners[list(quad)] for quad in quads]


def ball(radius: float, count: int = 14) -> list[Array]:
    """Return the faces of a sphere."""
    u, v = np.linspace(0, 2 * np.pi, 2 * count), np.linspace(0, np.pi, count)
    points = radius * np.stack(
        [np.outer(np.cos(u), np.sin(v)), np.outer(np.sin(u), np.sin(v)), np.outer(np.ones_like(u), np.cos(v))], axis=-1
    )
    return [points[[i, i + 1, i + 1, i], [j, j, j + 1, j + 1]] for i in range(2 * count - 1) for j in range(count - 1)]


def draw(axes: Axes3D, frames: bool = True) -> None:
    """Draw every visual in its colour, and the frames."""
    manager = UrdfTransformManager()
    text = URDF.read_text(encoding="utf-8")
    manager.load_urdf(text)
    for joint, position in SHOWN_M.items():
        manager.set_joint(joint, position)
    robot = ET.fromstring(text)  # noqa: S314  # our own file
    colours = {m.get("name"): m.find("color").get("rgba") for m in robot.findall("material")}  # type: ignore[union-attr]
    for link in robot.iter("link"):
        for number, visual in enumerate(link.iter("visual")):
            place = manager.get_transform(f"visual:{link.get('name')}/{number}", "rig")
            shape = visual.find("geometry")[0]  # type: ignore[index]
            if shape.tag == "box":
                polygons = faces(np.array(shape.get("size", "").split(), float))
                edge, alpha = (0.2, 0.25, 0.3, 0.6), 0.75
            else:
                polygons, edge, alpha = ball(float(shape.get("radius", ""))), "none", 1.0
            moved = [polygon @ place[:3, :3].T + place[:3, 3] for polygon in polygons]
            colour = [float(part) for part in colours[visual.find("material").get("name")].split()]  # type: ignore[union-attr]
            look = {"facecolors": [(*colour[:3], alpha)], "edgecolors": edge, "linewidths": 0.5}
            axes.add_collection3d(Poly3DCollection(moved, axlim_clip=not frames, **look))
    for frame, offset in FRAMES.items() if frames else ():
        place = manager.get_transform(frame, "rig")
        for column, colour in enumerate(("#c03028", "#2c8a3c", "#2858b8")):
            end = place[:3, 3] + AXIS_M * place[:3, column]
            axes.plot(*np.stack([place[:3, 3], end]).T, color=colour, linewidth=2)
        axes.text(*(place[:3, 3] + offset), frame, fontsize=9, ha="center", color="#10212e")


def main() -> None:
    """Write the picture."""
    figure = plt.figure(figsize=(8, 5.4), dpi=110)
    axes = figure.add_axes((-0.12, -0.2, 1.24, 1.4), projection="3d", computed_zorder=True)
    near = figure.add_axes((-0.04, 0.56, 0.42, 0.5), projection="3d")
    near.patch.set_alpha(0.0)
    for one, x, y, z, view in (
        (axes, (-0.19, 0.17), (-0.09, 0.09), (0.0, 0.28), (18, -68)),
        (near, (0.0, 0.04), (-0.015, 0.015), (0.215, 0.235), (30, -75)),
    ):
        assert isinstance(one, Axes3D)
        draw(one, frames=one is axes)
        one.set(xlim=x, ylim=y, zlim=z, box_aspect=np.ptp((x, y, z), axis=1))
        one.view_init(*view)
        one.set_axis_off()
    figure.text(0.03, 0.66, "sphere and barriers", fontsize=9, color="#10212e")
    figure.savefig(PICTURE, facecolor="white")


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    main()
