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
"""The rig that a topic belongs to: full names relative to a namespace decide, never the end of a name."""

from __future__ import annotations

from pathlib import Path

import pytest
from kits.recording import POINT_CLOUD, float64, scan_block, string, topic
from kits.records import info_rows
from mcap.writer import Writer

from impact_rig import codec
from impact_rig.blocks import Table
from impact_rig.errors import RecordingError
from impact_rig.recording import open_run
from impact_rig.recording.rigs import prefixes

STRING = "std_msgs/msg/String"
VECTOR = "geometry_msgs/msg/Vector3Stamped"


def bag(path: Path, *topics: tuple[str, str, bytes]) -> Path:
    """Write messages as another recorder would: topic, type and data of each."""
    writer = Writer(str(path))
    writer.start("ros2")
    channels: dict[str, int] = {}
    for number, (name, type_name, data) in enumerate(topics):
        if name not in channels:
            schema = writer.register_schema(type_name, "ros2msg", topic(name, type_name).schema.encode())
            channels[name] = writer.register_channel(name, "cdr", schema)
        writer.add_message(channels[name], number, data, number)
    writer.finish()
    return path


def test_the_namespace_of_a_rig_is_that_of_its_scans():
    types = dict.fromkeys(("/rig/daq/scan", "/rig/truth/scan", "/other/notes"), POINT_CLOUD)
    assert prefixes(types) == ("/rig/",)
    assert prefixes({"daq/scan": POINT_CLOUD}) == ("",)
    assert prefixes({"/daq/scan": POINT_CLOUD, "/left/daq/scan": POINT_CLOUD}) == ("/", "/left/")
    assert prefixes({"/rig/daq/scan": POINT_CLOUD, "/text/daq/scan": STRING}) == ("/rig/",), "not of that type"


def test_the_namespace_follows_from_the_longest_names_if_there_are_no_scans():
    assert prefixes({"/rig/truth/impacts": POINT_CLOUD, "/rig/impacts": POINT_CLOUD}) == ("/rig/",)
    assert prefixes({"/rig/plot/transmissibility": VECTOR}) == ("/rig/",)
    assert prefixes({"/camera/image": STRING}) == ()


def test_a_topic_is_found_only_by_its_full_name(tmp_path):
    path = bag(
        tmp_path / "a.mcap",
        ("/rig/truth/impacts", STRING, string("true")),
        ("/rig/plot/envelope/laser", STRING, string("plotted")),
        ("/rig/daq/scan", POINT_CLOUD, scan_block(0)),
        ("/else/where/notes", STRING, string("foreign")),
        ("/rig/notes", STRING, string("ours")),
    )
    with open_run(path) as run:
        assert (run.rigs, run.prefix) == (("/rig",), "/rig/")
        assert not run.holds("impacts"), "the true ones are others"
        assert not run.holds("laser"), "the plotted topic is not a monitor topic"
        assert run.holds("truth/impacts")
        assert run.resolve("notes") == "/rig/notes"
        assert run.resolve("/else/where/notes") == "/else/where/notes"
        assert (run.relative("/rig/notes"), run.relative("/else/where/notes")) == ("notes", None)
        with pytest.raises(RecordingError, match="no topic 'laser' in this recording"):
            run.messages(["laser"])


def test_the_user_must_choose_one_of_several_rigs(tmp_path):
    path = bag(
        tmp_path / "two.mcap",
        *((f"/{side}/{name}", kind, data) for side in ("left", "right") for name, kind, data in (
            ("daq/scan", POINT_CLOUD, scan_block(0)),
            ("transmissibility", "std_msgs/msg/Float64", float64(1.0 if side == "left" else 2.0)),
        )),
    )  # fmt: skip
    with open_run(path) as run:
        assert run.rigs == ("/left", "/right")
        assert len(list(run.messages())) == 4, "everything needs no choice"
        with pytest.raises(RecordingError, match=r"several rigs: /left, /right; choose one with --rig NAMESPACE"):
            run.resolve("daq/scan")
    for wanted in ("right", "/right", "/right/"):
        with open_run(path, wanted) as run:
            (message,) = run.messages(["transmissibility"])
            assert bytes(message.data) == float64(2.0)
            assert run.relative("/left/daq/scan") is None
    with pytest.raises(RecordingError, match=r"no rig '/middle' in .*two.mcap; there are: /left, /right"):
        open_run(path, "/middle")


def test_an_absolute_name_selects_the_rig_of_a_dataset(tmp_path):
    pytest.importorskip("xarray")
    messages = []
    for side, unit in (("left", b"m"), ("right", b"m/s")):
        info = info_rows()
        info["unit"][info["name"] == b"laser"] = unit
        messages.append((f"/{side}/daq/scan", POINT_CLOUD, scan_block(0)))
        messages.append((f"/{side}/daq/info", POINT_CLOUD, codec.encode(Table(0, info))))
    path = bag(tmp_path / "two.mcap", *messages)
    for rig in (None, "left"):
        with open_run(path, rig) as run:
            assert [run.to_xarray(f"/{side}/daq/scan").laser.units for side in ("left", "right")] == ["m", "m/s"]
            assert run.to_xarray("/right/daq/info")["lag"].units == "s"
            assert len(run.to_dataframe("/right/daq/scan")) == 100
