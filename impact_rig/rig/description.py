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
"""URDF of the rig, the content of `robot_description`, for RViz and robot_state_publisher.

All three prismatic joints are attached to the fixed frame `rig`, because positions on `truth/joint_states` are relative
to it. The barriers are drawn as parts of the superior base, so the gap changes no transform. Masses are those of the
configuration; inertias are those of the drawn bodies. The paper gives no shapes or heights, so these are chosen for a
clear picture.
"""

from __future__ import annotations

import functools
import operator
from xml.etree import ElementTree as ET

import numpy as np

from impact_rig.blocks import TRUTH_SCAN
from impact_rig.config.sections import Barriers, Shaker, Sphere, Structure
from impact_rig.instruments.laser import Laser
from impact_rig.physics.linear import sphere_mass_kg
from impact_rig.rig.config import RigConfig

JOINTS = ("base", "structure", "sphere")  # the joints, in the order of `truth/joint_states`
ROOT = "rig"
"""The fixed frame: x along the rig, positive to the right; its origin is the middle position of bases and sphere."""
BASE, STRUCTURE, SPHERE = "inferior_base", "superior_base", "sphere"
"""Names of the bodies that move, in the order of `JOINTS`; the accelerometer shares the superior base's frame."""

Size = tuple[float, float, float]

TABLE: Size = (0.20, 0.12, 0.02)
TOP: Size = (0.14, 0.08, 0.01)
COLUMN: Size = (0.002, 0.06, 0.12)
WALL: Size = (0.008, 0.016, 0.012)
SENSOR: Size = (0.03, 0.02, 0.02)
SHAKER: Size = (0.06, 0.12, 0.10)
Z_TABLE = 0.08
Z_TOP = Z_TABLE + 0.5 * TABLE[2] + COLUMN[2] + 0.5 * TOP[2]
X_COLUMN = 0.055  # positions of the two columns, either side of the middle [m]
FREE_M = 1.0  # travel of the joints without limits [m]
MATERIALS = {
    "steel": "0.72 0.74 0.78 1",
    "aluminium": "0.86 0.88 0.90 1",
    "shaker": "0.20 0.26 0.33 1",
    "sphere": "0.85 0.33 0.10 1",
    "sensor": "0.10 0.45 0.70 1",
}


_SHOWN = operator.itemgetter(
    *map((TRUTH_SCAN.names or ()).index, ("x_b", "x_1", "x_2", "v_b", "v_1", "v_2", "force_left", "force_right"))
)


def joints(truth: np.void) -> tuple[list[float], list[float], list[float]]:
    """Return positions, velocities and efforts of the joints for a true state, as on `truth/joint_states`.

    `truth` is a row of `blocks.TRUTH_SCAN`. The lists are absolute displacements [m], absolute velocities [m/s] and
    contact forces on the bodies [N], positive to the right, in the order of `JOINTS`.
    """
    *moving, left, right = _SHOWN(truth.item())
    push = left - right  # both walls push the sphere
    return moving[:3], moving[3:], [0.0, -push, push]


def robot_description(config: RigConfig) -> str:
    """Return the URDF of a rig as XML text: its bodies, joints and frames.

    Masses, gap, sphere, distance of the laser and travel limit of the base are those of the configuration. Plate and
    barriers are sized to fit gap and sphere; other dimensions are fixed. Without a sphere, its body and joint are left
    out.
    """
    return _urdf(config.structure, config.shaker, config.sphere, config.barriers, config.instruments.laser)


@functools.lru_cache(maxsize=4)  # most configuration changes do not affect the appearance of the rig
def _urdf(structure: Structure, shaker: Shaker, sphere: Sphere, barriers: Barriers, laser: Laser) -> str:
    robot = ET.Element("robot", name="impact_rig")
    for name, colour in MATERIALS.items():
        ET.SubElement(ET.SubElement(robot, "material", name=name), "color", rgba=colour)
    _box(_link(robot, ROOT), SHAKER, (-0.5 * TABLE[0] - 0.5 * SHAKER[0] - 0.03, 0.0, Z_TABLE), "shaker")
    _moving_base(robot, shaker)
    _superior_base(robot, structure, sphere, barriers)
    if sphere.present:
        _sphere(robot, sphere)
    _instruments(robot, laser)
    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def _moving_base(robot: ET.Element, shaker: Shaker) -> None:
    """Add the inferior base to the URDF: table, armature and the two columns as one body, with its joint."""
    link = _link(robot, BASE)
    _inertial(link, shaker.armature_mass_kg + shaker.base_mass_kg, _of_box(TABLE))
    _box(link, TABLE, (0.0, 0.0, 0.0), "steel")
    for side in (-X_COLUMN, X_COLUMN):
        _box(link, COLUMN, (side, 0.0, 0.5 * (TABLE[2] + COLUMN[2])), "steel")
    _prismatic(robot, JOINTS[0], BASE, Z_TABLE, shaker.travel_limit_m)


def _superior_base(robot: ET.Element, structure: Structure, sphere: Sphere, barriers: Barriers) -> None:
    """Add the superior base to the URDF: plate and barriers, which the sphere touches where x_2 - x_1 = ± gap / 2."""
    radius = 0.5 * sphere.diameter_m
    face = 0.5 * barriers.gap_m + radius
    plate = (max(TOP[0], 2.0 * (face + 2.0 * WALL[0])), TOP[1], TOP[2])
    height = max(WALL[2], 2.0 * radius)
    link = _link(robot, STRUCTURE)
    _inertial(link, structure.mass_kg, _of_box(plate))
    _box(link, plate, (0.0, 0.0, 0.0), "aluminium")
    for side in (-1.0, 1.0):
        place = (side * (face + 0.5 * WALL[0]), 0.0, 0.5 * (TOP[2] + height))
        _box(link, (WALL[0], WALL[1], height), place, "aluminium")
    _prismatic(robot, JOINTS[1], STRUCTURE, Z_TOP, FREE_M)


def _sphere(robot: ET.Element, sphere: Sphere) -> None:
    radius = 0.5 * sphere.diameter_m
    mass = sphere_mass_kg(sphere)
    link = _link(robot, SPHERE)
    _inertial(link, mass, (0.4 * radius * radius,) * 3)
    ET.SubElement(_visual(link, (0.0, 0.0, 0.0), "sphere"), "sphere", radius=_text(radius))
    _prismatic(robot, JOINTS[2], SPHERE, Z_TOP + 0.5 * TOP[2] + radius, FREE_M)


def _instruments(robot: ET.Element, setup: Laser) -> None:
    """Add the frames `daq`, `laser` and `base_sensor`, to which readings refer, and draw the two sensors.

    Readings of the accelerometer refer to the frame of the superior base.
    """
    _fixed(robot, "daq", (0.0, 0.0, 0.0), 0.0)
    side = 0.5 * TOP[0]
    # sensor_msgs/Range: x along the beam, from the right towards the superior base
    laser = _fixed(robot, "laser", (side + setup.distance_m, 0.0, Z_TOP), 3.141592653589793)
    _box(laser, SENSOR, (-0.5 * SENSOR[0], 0.0, 0.0), "sensor")
    sensor = _fixed(robot, "base_sensor", (0.5 * TABLE[0] + 0.03, 0.0, Z_TABLE), 0.0)
    _box(sensor, SENSOR, (0.5 * SENSOR[0], 0.0, 0.0), "sensor")


def _link(robot: ET.Element, name: str) -> ET.Element:
    return ET.SubElement(robot, "link", name=name)


def _prismatic(robot: ET.Element, name: str, child: str, height: float, travel: float) -> None:
    joint = _joint(robot, name, "prismatic", child, (0.0, 0.0, height), 0.0)
    ET.SubElement(joint, "axis", xyz="1 0 0")
    ET.SubElement(joint, "limit", lower=_text(-travel), upper=_text(travel), effort="10000", velocity="100")


def _fixed(robot: ET.Element, name: str, place: Size, yaw: float) -> ET.Element:
    link = _link(robot, name)
    _joint(robot, f"{name}_mount", "fixed", name, place, yaw)
    return link


def _joint(robot: ET.Element, name: str, kind: str, child: str, place: Size, yaw: float) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=ROOT)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_texts(place), rpy=f"0 0 {_text(yaw)}")
    return joint


def _box(link: ET.Element, size: Size, place: Size, material: str) -> None:
    ET.SubElement(_visual(link, place, material), "box", size=_texts(size))


def _visual(link: ET.Element, place: Size, material: str) -> ET.Element:
    visual = ET.SubElement(link, "visual")
    ET.SubElement(visual, "origin", xyz=_texts(place), rpy="0 0 0")
    geometry = ET.SubElement(visual, "geometry")
    ET.SubElement(visual, "material", name=material)
    return geometry


def _of_box(size: Size) -> Size:
    """Return the three moments of inertia of a homogeneous box about its middle, divided by its mass [m²]."""
    x, y, z = (side * side / 12.0 for side in size)
    return y + z, x + z, x + y


def _inertial(link: ET.Element, mass: float, moments: Size) -> None:
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz="0 0 0", rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=_text(mass))
    xx, yy, zz = (_text(mass * moment) for moment in moments)
    ET.SubElement(inertial, "inertia", ixx=xx, ixy="0", ixz="0", iyy=yy, iyz="0", izz=zz)


def _texts(values: Size) -> str:
    return " ".join(map(_text, values))


def _text(value: float) -> str:
    return f"{value:.12g}"
