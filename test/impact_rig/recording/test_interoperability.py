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
"""Files are those of rosbag2 of Jazzy: read by tools that do not know this package, and compared field by field."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import yaml
from kits.recording import (
    ALL_TOPICS,
    APPLIED_TOPIC,
    CONFIG,
    NOTES_TOPIC,
    PROVENANCE,
    RATE_HZ,
    SCAN_TOPIC,
    START_NS,
    fill,
    scan_block,
    type_hash,
)
from mcap.reader import make_reader

pytest.importorskip("rosbags", reason="an independent reader, only on PyPI")
pytest.importorskip("mcap_ros2", reason="an independent reader, only on PyPI")

from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from impact_rig import codec
from impact_rig.errors import RecordingError
from impact_rig.nodes.messages import TOPICS
from impact_rig.recording import OfferedQos, description, schema_text

INFINITE = {"sec": 9223372036, "nsec": 854775807}
RIG_TYPES = [
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/Range",
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/Vector3Stamped",
    "std_msgs/msg/Float64",
    "std_msgs/msg/String",
    "std_msgs/msg/Header",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rosgraph_msgs/msg/Clock",
]


@pytest.fixture
def run(record):
    with record(chunk_bytes=40_000) as writer:
        sent = fill(writer, 40)
    return writer, sent


def metadata(directory):
    content = yaml.safe_load((directory / "metadata.yaml").read_text())
    assert list(content) == ["rosbag2_bagfile_information"]
    return content["rosbag2_bagfile_information"]


@pytest.mark.heavy
@pytest.mark.parametrize("bare_file", [False, True], ids=["directory", "file"])
def test_rosbags_reads_every_topic(run, bare_file):
    writer, sent = run
    store = get_typestore(Stores.ROS2_JAZZY)
    path = writer.files[0] if bare_file else writer.directory
    # rosbags takes the hash from metadata.yaml, which a bare file has not
    hashes = {known.name: "" if bare_file else known.type_hash for known in ALL_TOPICS}
    with AnyReader([path], default_typestore=store) as reader:
        assert {c.topic: (c.msgtype, c.digest, c.msgcount) for c in reader.connections} == {
            known.name: (known.type_name, hashes[known.name], sum(s.topic == known.name for s in sent))
            for known in ALL_TOPICS
        }
        got = [(c.topic, time, raw, reader.deserialize(raw, c.msgtype)) for c, time, raw in reader.messages()]
    in_order = sorted(sent, key=lambda message: message.log_time)
    assert [(name, time) for name, time, _, _ in got] == [(s.topic, s.log_time) for s in in_order]
    for (name, _, raw, decoded), message in zip(got, in_order, strict=True):
        assert bytes(raw) == message.data
        if name in {SCAN_TOPIC.name, APPLIED_TOPIC.name}:
            table = codec.decode(message.data)
            assert decoded.data.tobytes() == table.rows.tobytes()
            assert decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec == table.stamp_ns
    assert next(d.data for name, _, _, d in got if name == NOTES_TOPIC.name) == "gap 0 mm"


def test_mcap_ros2_decodes_every_topic_with_the_schemas_in_the_file(run):
    writer, sent = run
    in_order = sorted(sent, key=lambda message: message.log_time)
    with writer.files[0].open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        got = list(reader.iter_decoded_messages())
    assert [(c.topic, m.log_time, m.publish_time, m.sequence, m.data) for _, c, m, _ in got] == [
        (s.topic, s.log_time, s.publish_time, s.sequence, s.data) for s in in_order
    ]
    for (_, channel, _, decoded), original in zip(got, in_order, strict=True):
        if channel.topic == SCAN_TOPIC.name:
            table = codec.decode(original.data)
            assert [field.name for field in decoded.fields] == list(table.rows.dtype.names)
            assert bytes(decoded.data) == table.rows.tobytes()


@pytest.fixture(scope="module")
def every_type():
    """Run that the JavaScript check also records: every message type of the rig, with a value in every field."""
    path = Path(__file__).parents[3] / "qualification" / "check_mcap_js" / "check.py"
    spec = importlib.util.spec_from_file_location("check_mcap_js", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def same_values(ours, theirs, store):
    """Return whether rosbags and mcap_ros2 decoded the same message, field by field, bit for bit."""
    if isinstance(ours, np.ndarray):
        return ours.tobytes() == np.asarray(list(theirs), ours.dtype).tobytes()
    if isinstance(ours, list):
        return len(ours) == len(theirs) and all(same_values(a, b, store) for a, b in zip(ours, theirs, strict=True))
    if hasattr(ours, "__msgtype__"):
        fields = [name for name, _ in store.fielddefs[ours.__msgtype__][1]]
        return all(same_values(getattr(ours, name), getattr(theirs, name), store) for name in fields)
    return ours == theirs


@pytest.mark.heavy
def test_rosbags_and_mcap_ros2_decode_every_message_type_identically(tmp_path, every_type):
    store = get_typestore(Stores.ROS2_JAZZY)
    every_type.record(tmp_path / "run", store)
    with AnyReader([tmp_path / "run"], default_typestore=store) as reader:
        by_rosbags = [
            (c.topic, time, bytes(raw), reader.deserialize(raw, c.msgtype)) for c, time, raw in reader.messages()
        ]
    by_mcap = []
    for path in sorted((tmp_path / "run").glob("*.mcap")):
        with path.open("rb") as file:
            decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
            by_mcap += [(c.topic, m.log_time, m.data, message) for _, c, m, message in decoded]
    assert {name for name, *_ in by_rosbags} == {"/rig/daq/scan", *every_type.TYPES}
    # equal times may be in either order
    by_rosbags.sort(key=lambda message: message[:3])
    by_mcap.sort(key=lambda message: message[:3])
    assert [m[:3] for m in by_rosbags] == [m[:3] for m in by_mcap]
    for ours, theirs in zip(by_rosbags, by_mcap, strict=True):
        assert same_values(ours[3], theirs[3], store), ours[0]


def test_metadata_yaml_has_the_fields_of_rosbag2(record):
    with record() as writer:
        sent = fill(writer, 10, topics=(SCAN_TOPIC, APPLIED_TOPIC, NOTES_TOPIC, *ALL_TOPICS[3:]))
    info = metadata(writer.directory)
    last = max(s.log_time for s in sent)
    assert list(info) == [
        "version",
        "storage_identifier",
        "duration",
        "starting_time",
        "message_count",
        "topics_with_message_count",
        "compression_format",
        "compression_mode",
        "relative_file_paths",
        "files",
        "custom_data",
        "ros_distro",
    ]
    topics = info.pop("topics_with_message_count")
    assert info == {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": last - START_NS},
        "starting_time": {"nanoseconds_since_epoch": START_NS},
        "message_count": len(sent),
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": ["run.mcap"],
        "files": [
            {
                "path": "run.mcap",
                "starting_time": {"nanoseconds_since_epoch": START_NS},
                "duration": {"nanoseconds": last - START_NS},
                "message_count": len(sent),
            }
        ],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    assert topics[0] == {
        "topic_metadata": {
            "name": "/rig/daq/scan",
            "type": "sensor_msgs/msg/PointCloud2",
            "serialization_format": "cdr",
            "offered_qos_profiles": [
                {
                    "history": "keep_last",
                    "depth": 100,
                    "reliability": "reliable",
                    "durability": "volatile",
                    "deadline": INFINITE,
                    "lifespan": INFINITE,
                    "liveliness": "automatic",
                    "liveliness_lease_duration": INFINITE,
                    "avoid_ros_namespace_conventions": False,
                }
            ],
            "type_description_hash": type_hash("sensor_msgs/msg/PointCloud2"),
        },
        "message_count": 10,
    }
    assert [t["topic_metadata"]["name"] for t in topics] == [known.name for known in ALL_TOPICS]
    assert topics[4]["topic_metadata"]["offered_qos_profiles"][0]["durability"] == "transient_local"


def test_an_empty_custom_data_is_written_as_yaml_cpp_does(run):
    assert "\n  custom_data: ~\n" in (run[0].directory / "metadata.yaml").read_text()


def test_the_file_has_the_summary_channels_and_records_of_rosbag2(run):
    writer, sent = run
    with writer.files[0].open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
        assert header.profile == "ros2"
        assert summary is not None
        channels = {channel.topic: channel for channel in summary.channels.values()}
        for known in ALL_TOPICS:
            channel = channels[known.name]
            schema = summary.schemas[channel.schema_id]
            assert channel.message_encoding == "cdr"
            assert (schema.name, schema.encoding) == (known.type_name, "ros2msg")
            assert schema.data.decode() == known.schema
            assert set(channel.metadata) == {"offered_qos_profiles", "topic_type_hash"}
            assert channel.metadata["topic_type_hash"] == known.type_hash
            profiles = yaml.safe_load(channel.metadata["offered_qos_profiles"])
            assert [p["durability"] for p in profiles] == [qos.durability for qos in known.offered_qos]
            assert channel.metadata["offered_qos_profiles"].startswith("- history: ")
        assert len(summary.schemas) == len({known.type_name for known in ALL_TOPICS})
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(sent)
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        assert all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
        assert [(a.name, a.data) for a in reader.iter_attachments()] == [("config.yaml", CONFIG)]
        found = [(record.name, record.metadata) for record in reader.iter_metadata()]
    bags = [content for name, content in found if name == "rosbag2"]
    assert len(bags) == 2  # on opening and on closing, as rosbag2 does
    assert all(list(content) == ["serialized_metadata"] for content in bags)
    assert yaml.safe_load(bags[1]["serialized_metadata"]) == metadata(writer.directory)
    opening = yaml.safe_load(bags[0]["serialized_metadata"])
    assert (opening["version"], opening["message_count"], opening["topics_with_message_count"]) == (9, 0, [])
    (ours,) = [content for name, content in found if name == "impact_rig"]
    assert ours.items() >= PROVENANCE.to_record().items()


def test_a_topic_without_offered_profiles_has_an_empty_list():
    assert type(SCAN_TOPIC)(name="/t", type_name="std_msgs/msg/String", schema="string data").offered_qos_text == "[]"
    assert OfferedQos().to_yaml()["deadline"] == INFINITE


@pytest.mark.parametrize("type_name", RIG_TYPES)
def test_an_independent_parser_understands_the_schema_text(type_name):
    """rosbags computes the type hash from the text: if a line or a dependency were missing, the hash would differ."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema_text(type_name), type_name))
    assert store.hash_rihs01(type_name) == type_hash(type_name)


def test_the_schema_text_separates_dependencies_like_rosbag2():
    parts = schema_text("geometry_msgs/msg/Vector3Stamped").split("\n" + "=" * 80 + "\n")
    assert [part.partition("\n")[0] for part in parts[1:]] == [
        "MSG: geometry_msgs/Vector3",
        "MSG: std_msgs/Header",
        "MSG: builtin_interfaces/Time",
    ]


@pytest.mark.parametrize("type_name", sorted({topic.type_name for topic in TOPICS}))
def test_schemas_without_ros_equal_those_of_an_installation(type_name, monkeypatch):
    installed = schema_text(type_name)
    monkeypatch.setattr(description, "interface_prefixes", tuple)
    assert schema_text(type_name) == installed


def test_a_comment_of_another_encoding_in_an_installed_definition_is_no_obstacle(tmp_path, monkeypatch):
    folder = tmp_path / "share" / "own_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Force.msg").write_bytes("float64 force  # Prüfstand\n".encode("latin-1"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert schema_text("own_msgs/msg/Force") == "float64 force  # Pr\ufffdfstand\n"


@pytest.mark.parametrize("name", ["sensor_msgs/msg/Nothing", "nowhere_msgs/msg/Thing"])
def test_the_error_of_an_absent_interface_names_the_searched_folders(name):
    with pytest.raises(RecordingError, match=rf"no definition of {name}: .*\.msg is not in .*share"):
        schema_text(name)


def test_an_invalid_type_name_is_rejected():
    with pytest.raises(RecordingError, match="is not the name of a message type"):
        schema_text("../../etc/passwd")


def test_log_times_are_scan_stamps_or_those_of_the_newest_scan_without_a_header(run):
    _, sent = run
    last_of_block = [s.log_time for s in sent if s.topic == "/rig/shaker/frequency"]
    stamps = [codec.decode(scan_block(i)).stamp_ns for i in range(0, 40, 5)]
    assert last_of_block == [stamp + 99 * 10**9 // RATE_HZ for stamp in stamps]
