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
"""The guide and the layouts in `docs/` and `config/` fit the recorded data."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from kits.recording import APPLIED_TOPIC, CONFIG, NOTES_TOPIC, RATE_HZ, SCAN_TOPIC, START_NS, applied_row, string

pytest.importorskip("rosbags", reason="an independent reader, only on PyPI")

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from impact_rig import codec
from impact_rig.blocks import Table
from impact_rig.instruments.section import SCAN
from impact_rig.nodes.messages import TOPICS

ROOT = Path(__file__).parents[3]
GUIDE = ROOT / "docs" / "how-to" / "recording.md"
PLOTTED = {
    "/rig/base_displacement": "geometry_msgs/msg/Vector3Stamped",
    "/rig/laser": "sensor_msgs/msg/Range",
    "/rig/accelerometer": "sensor_msgs/msg/Imu",
    "/rig/transmissibility": "std_msgs/msg/Float64",
    "/rig/truth/joint_states": "sensor_msgs/msg/JointState",
    "/rig/shaker/frequency": "std_msgs/msg/Float64",
    "/rig/shaker/current": "std_msgs/msg/Float64",
    "/rig/plot/transmissibility": "geometry_msgs/msg/Vector3Stamped",
    "/rig/plot/drive": "geometry_msgs/msg/Vector3Stamped",
    "/rig/plot/envelope/pulses": "geometry_msgs/msg/Vector3Stamped",
}
SPECTRA = {f"/rig/plot/spectrum/{name}": "geometry_msgs/msg/PolygonStamped" for name in ("laser", "accelerometer")}
ENVELOPE = {"/rig/plot/envelope/laser": "geometry_msgs/msg/Vector3Stamped"}
ALL = {**PLOTTED, **SPECTRA, **ENVELOPE}
JOINTS = ("base", "structure", "sphere")


def blocks(info):
    return re.findall(rf"^```{info}\n(.*?)^```$", GUIDE.read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.heavy
@pytest.mark.parametrize("notes", [["gap 2 mm"], []], ids=["notes", "no notes"])
def test_the_notebook_guide_finds_the_transmissibility(notes, record, capsys):
    """With a base of 1 mm and a structure of 3.2 mm at 9.1 Hz, the guide must find 3.2."""
    with record("sweep_2mm") as writer:
        for topic in (SCAN_TOPIC, APPLIED_TOPIC, *([NOTES_TOPIC] if notes else [])):
            writer.add_topic(topic)
        writer.write(APPLIED_TOPIC.name, applied_row(START_NS, 9.1), 0)
        for number in range(200):
            times = (number * 100 + np.arange(100)) / RATE_HZ
            rows = np.zeros(100, SCAN)
            rows["time"] = np.arange(100) / RATE_HZ
            rows["base"] = 1e-3 * np.sin(2 * np.pi * 9.1 * times)
            rows["laser"] = 3.2e-3 * np.sin(2 * np.pi * 9.1 * times - 1.0) + 1e-3
            writer.write(SCAN_TOPIC.name, codec.encode(Table(START_NS + number * 10_000_000, rows)), 0)
        for note in notes:
            writer.write(NOTES_TOPIC.name, string(note), 0)
    notebook: dict[str, object] = {}
    cells = blocks("python notebook")
    assert len(cells) == 5
    for cell in cells:
        code = cell.replace('Path("runs/sweep_2mm")', f"Path({str(writer.directory)!r})")
        exec(compile(code, str(GUIDE), "exec"), notebook)
    assert notebook["transmissibility"] == pytest.approx(3.2, rel=1e-6)
    assert notebook["notes"] == notes
    assert notebook["attachments"] == {"config.yaml": CONFIG.decode()}
    assert "DT at 9.10 Hz: 3.20" in capsys.readouterr().out


@pytest.mark.heavy
def test_the_recording_and_reading_examples_run(record, tmp_path, monkeypatch, capsys):
    with record("runs/sweep_2mm") as writer:
        writer.add_topic(SCAN_TOPIC)
        writer.add_topic(APPLIED_TOPIC)
        writer.add_topic(NOTES_TOPIC)
        writer.write(SCAN_TOPIC.name, codec.encode(Table(START_NS, np.zeros(2, SCAN))), 0)
        writer.write(NOTES_TOPIC.name, string("hello"), 0)
    monkeypatch.chdir(tmp_path)
    for example in blocks("python"):
        exec(compile(example, str(GUIDE), "exec"), {})
    assert (tmp_path / "runs" / "mine" / "metadata.yaml").exists()
    assert f"/rig/notes {START_NS}" in capsys.readouterr().out


def field_exists(type_name, path):
    """Return whether `path`, a list of field names, leads to a number in a message of this type."""
    fields = dict(get_typestore(Stores.ROS2_JAZZY).fielddefs[type_name][1])
    name, _, part = path[0].partition("[")
    kind, detail = fields.get(name, (None, None))
    if part:  # all elements, or one
        kind, detail = detail[0]
    if kind == Nodetype.NAME:
        return len(path) > 1 and field_exists(detail, path[1:])
    return kind is not None and len(path) == 1


def split_topic(path, separator):
    topic = max((name for name in ALL if path.startswith(name + separator)), key=len)
    return topic, path[len(topic) + 1 :].split(separator)


def test_foxglove_layout_plots_fields_that_exist():
    layout = json.loads((ROOT / "config" / "foxglove" / "rig.json").read_text())
    plots = [panel for name, panel in layout["configById"].items() if name.startswith("Plot!")]
    paths = [path["value"] for plot in plots for path in plot["paths"]]
    paths += [plot["xAxisPath"]["value"] for plot in plots if plot["xAxisVal"] == "currentCustom"]
    for path in paths:
        topic, fields = split_topic(path, ".")
        assert field_exists(ALL[topic], fields), path
    assert {split_topic(path, ".")[0] for path in paths} == {*PLOTTED, *SPECTRA}

    def panels(node):
        return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])


def test_plotjuggler_layout_plots_fields_that_exist():
    root = ET.parse(ROOT / "config" / "plotjuggler" / "rig.xml").getroot()
    names = [curve.attrib["name"] for curve in root.iter("curve")]
    for name in names:
        topic, fields = split_topic(name, "/")
        if ALL[topic] == "sensor_msgs/msg/JointState":  # PlotJuggler files these by joint
            assert fields[0] in JOINTS
            assert fields[1:] == ["position"]
        else:
            assert field_exists(ALL[topic], fields), name
    assert {split_topic(name, "/")[0] for name in names} == {*PLOTTED, *ENVELOPE}
    for splitter in root.iter("DockSplitter"):
        assert len(splitter) == int(splitter.attrib["count"]) == len(splitter.attrib["sizes"].split(";"))


@pytest.mark.ros
def test_layouts_name_topics_and_types_of_the_topic_table():
    known = {f"/rig/{topic.name}": topic.type_name for topic in TOPICS}
    assert known.items() >= ALL.items()
