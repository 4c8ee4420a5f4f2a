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
"""The rig as URDF, read by independent parsers: bodies, masses and positions."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_rig.blocks import FRAME_DAQ
from impact_rig.instruments.registry import INSTRUMENTS
from impact_rig.rig import Rig, config
from impact_rig.rig.config import RigConfig
from impact_rig.rig.description import JOINTS, ROOT, robot_description
from impact_rig.system.files import share_dir

LINKS = {"base": "inferior_base", "structure": "superior_base", "sphere": "sphere"}
RIGS = {
    "nominal": RigConfig(),
    "another": config.from_flat(
        RigConfig(),
        {"barriers.gap_m": 0.3, "structure.mass_kg": 0.5, "shaker.base_mass_kg": 3.0, "sphere.diameter_m": 0.02},
    ),
    "without the sphere": config.from_flat(RigConfig(), {"sphere.present": False}),
}
Masses = dict[str, float]
Places = Callable[[Mapping[str, float]], dict[str, NDArray[np.float64]]]
"""Function from joint positions [m] to the poses of the links in the frame `rig`, shape (4, 4) by link."""


def by_pytransform3d(text: str, _path: Path) -> tuple[Masses, Places]:
    urdf = pytest.importorskip("pytransform3d.urdf")
    manager = urdf.UrdfTransformManager()
    manager.load_urdf(text)
    _, links, _ = urdf.parse_urdf(text)

    def places(positions: Mapping[str, float]) -> dict[str, NDArray[np.float64]]:
        for joint, position in positions.items():
            manager.set_joint(joint, position)
        return {link.name: manager.get_transform(link.name, ROOT) for link in links}

    return {link.name: link.mass for link in links if link.mass}, places


def by_kinpy(text: str, _path: Path) -> tuple[Masses, Places]:
    kinpy = pytest.importorskip("kinpy")
    parser = pytest.importorskip("kinpy.urdf_parser_py.urdf")
    chain = kinpy.build_chain_from_urdf(text.encode())
    robot = parser.URDF.from_xml_string(text.encode())

    def places(positions: Mapping[str, float]) -> dict[str, NDArray[np.float64]]:
        found = chain.forward_kinematics(dict(positions))
        return {name: np.asarray(transform.matrix()) for name, transform in found.items()}

    return {link.name: link.inertial.mass for link in robot.links if link.inertial is not None}, places


def by_yourdfpy(_text: str, path: Path) -> tuple[Masses, Places]:
    robot = pytest.importorskip("yourdfpy").URDF.load(str(path))

    def places(positions: Mapping[str, float]) -> dict[str, NDArray[np.float64]]:
        robot.update_cfg(dict(positions))
        return {name: robot.get_transform(name, ROOT) for name in robot.link_map}

    return {name: link.inertial.mass for name, link in robot.link_map.items() if link.inertial is not None}, places


def by_urchin(_text: str, path: Path) -> tuple[Masses, Places]:
    robot = pytest.importorskip("urchin").URDF.load(str(path))

    def places(positions: Mapping[str, float]) -> dict[str, NDArray[np.float64]]:
        return {link.name: place for link, place in robot.link_fk(cfg=dict(positions)).items()}

    return {link.name: link.inertial.mass for link in robot.links if link.inertial.mass != 1.0}, places


PARSERS: dict[str, Callable[[str, Path], tuple[Masses, Places]]] = {
    "pytransform3d": by_pytransform3d,
    "kinpy": by_kinpy,
    "yourdfpy": by_yourdfpy,
    "urchin": by_urchin,
}


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("parser", PARSERS)
def test_masses_are_those_of_the_configuration_and_links_follow_the_joint_states(
    parser: str, rig: str, tmp_path: Path
) -> None:
    configuration = RIGS[rig]
    path = tmp_path / "rig.urdf"
    path.write_text(robot_description(configuration), encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of other programs about Python and one another
        masses, places = PARSERS[parser](path.read_text(encoding="utf-8"), path)
        shaker, sphere = configuration.shaker, configuration.sphere
        expected = {
            "inferior_base": shaker.armature_mass_kg + shaker.base_mass_kg,
            "superior_base": configuration.structure.mass_kg,
        }
        joints = JOINTS[: 2 + sphere.present]
        if sphere.present:
            expected["sphere"] = sphere.density_kg_m3 * math.pi / 6.0 * sphere.diameter_m**3
        assert masses == pytest.approx(expected, rel=1e-9)
        rest = places(dict.fromkeys(joints, 0.0))
        blocks = Rig(config.from_flat(configuration, {"drive.amplitude": 0.52})).advance(10**9)
        truth = [row for block in blocks for row in block.monitor_states][-1]
        positions = dict(zip(joints, (float(truth[name]) for name in ("x_b", "x_1", "x_2")), strict=False))
        now = places(positions)
    for joint, position in positions.items():
        moved = now[LINKS[joint]][:3, 3] - rest[LINKS[joint]][:3, 3]
        assert moved == pytest.approx([position, 0.0, 0.0], abs=1e-12), "absolute, and along x"
        assert rest[LINKS[joint]][0, 3] == 0.0
    for link in set(now) - set(LINKS.values()):
        assert np.array_equal(now[link], rest[link]), f"{link} is fixed"


def tree(**values: Any) -> ET.Element:
    changes = {name.replace("__", "."): value for name, value in values.items()}
    return ET.fromstring(robot_description(config.from_flat(RigConfig(), changes)))  # our own text


def test_the_barriers_depend_on_the_gap_but_no_joint_does() -> None:
    small, large = tree(barriers__gap_m=0.002), tree(barriers__gap_m=0.02)
    joints = [[ET.tostring(joint) for joint in robot.iter("joint")] for robot in (small, large)]
    assert joints[0] == joints[1]
    assert ET.tostring(small) != ET.tostring(large)


@pytest.mark.parametrize("gap", [0.002, 0.006, 0.5])
def test_the_sphere_touches_the_drawn_walls(gap: float) -> None:
    robot = tree(barriers__gap_m=gap)
    boxes = robot.findall("link[@name='superior_base']/visual")[1:]
    radius = float(next(robot.iter("sphere")).get("radius", ""))
    for side, box in zip((-1, 1), boxes, strict=True):
        middle = float(box.find("origin").get("xyz", "").split()[0])  # type: ignore[union-attr]  # every box has one
        width = float(next(box.iter("box")).get("size", "").split()[0])
        assert side * middle - 0.5 * width == pytest.approx(0.5 * gap + radius, abs=1e-12)


def test_the_tree_contains_every_frame_of_a_header() -> None:
    links = {link.get("name") for link in tree().iter("link")}
    frames = {about.monitor.frame_id for about in INSTRUMENTS.values() if about.monitor is not None}
    assert {FRAME_DAQ, ROOT, *frames} <= links


def test_inertias_are_physically_possible() -> None:
    """Each moment is at most the sum of the others, and that of the sphere is 2/5 m r²."""
    for inertia in tree().iter("inertia"):
        moments = sorted(float(inertia.get(key, "")) for key in ("ixx", "iyy", "izz"))
        assert 0.0 < moments[2] <= moments[0] + moments[1]
    found = tree().find("link[@name='sphere']/inertial")
    assert found is not None
    mass, moment = (float(e.get(k, "")) for e, k in ((found.find("mass"), "value"), (found.find("inertia"), "ixx")))  # type: ignore[union-attr]
    assert moment == pytest.approx(0.4 * mass * (0.5 * RigConfig().sphere.diameter_m) ** 2, rel=1e-9)


def test_the_inertia_of_the_plate_follows_its_length() -> None:
    """A wide gap makes the plate longer, so its inertia must be computed from its own length."""
    link = tree(barriers__gap_m=0.2).find("link[@name='superior_base']")
    assert link is not None

    def attribute(where: str, key: str) -> str:
        found = link.find(where)
        assert found is not None
        return found.get(key, "")

    length, width, _ = map(float, attribute("visual/geometry/box", "size").split())
    assert length > 0.2
    expected = float(attribute("inertial/mass", "value")) * (length * length + width * width) / 12.0
    assert float(attribute("inertial/inertia", "izz")) == pytest.approx(expected, rel=1e-9)


def test_the_file_describes_the_nominal_rig() -> None:
    assert (share_dir() / "urdf" / "impact_rig.urdf").read_text(encoding="utf-8") == robot_description(RigConfig())
