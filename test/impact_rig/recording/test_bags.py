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
"""Bags of rosbag2 and other writers of MCAP: they are read, or refused with the reason and a command that helps."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
import zstandard
from kits.recording import NOTES_TOPIC, SCAN_TOPIC, TopicDescription, fill, string
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from impact_rig.errors import RecordingError
from impact_rig.recording import Message, RunWriter, open_run
from impact_rig.runs import info, recover
from impact_rig.system import budget

Change = Callable[[bytes], bytes]


def content(path: Path) -> list[tuple[str, bytes, int]]:
    """Topic, data and log time of every message."""
    with open_run(path) as run:
        return [(one.topic, bytes(one.data), one.log_time) for one in run.messages(recorded_order=True)]


@pytest.fixture
def native(record: Callable[..., RunWriter]) -> Path:
    """Run of our own recorder."""
    with record() as writer:
        fill(writer, 30)
    return writer.directory


def rewrite(source: Path, path: Path, change: Change = bytes, *, finish: bool = True, **options: object) -> Path:
    """Write the messages of a run with options of the MCAP library."""
    with open_run(source) as run, path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("ros2")
        ids: dict[str, int] = {}
        for name, one in run.topics.items():
            schema = writer.register_schema(one.topic.type_name, "ros2msg", one.topic.schema.encode())
            ids[name] = writer.register_channel(name, "cdr", schema)
        one: Message
        for one in run.messages(recorded_order=True):
            writer.add_message(ids[one.topic], one.log_time, change(bytes(one.data)), one.publish_time, one.sequence)
        if finish:
            writer.finish()
        else:
            writer.flush()
    return path


PRESETS = {
    "none": {"compression": CompressionType.NONE},
    "fastwrite": {"compression": CompressionType.NONE, "use_chunking": False, "enable_crcs": False},
    "zstd_fast": {"compression": CompressionType.ZSTD, "enable_crcs": False},
    "zstd_small": {"compression": CompressionType.ZSTD, "chunk_size": 4 * 2**20},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 10_000},
    "without message indexes": {"index_types": IndexType.ALL ^ IndexType.MESSAGE},
}


@pytest.mark.parametrize("preset", PRESETS)
def test_a_file_of_every_preset_is_read(native, tmp_path, preset):
    path = rewrite(native, tmp_path / "bag.mcap", **PRESETS[preset])
    assert content(path) == content(native)
    found = info(path)
    assert found.intact, found.verdict
    assert found.scans.whole
    with open_run(path) as run:  # also a part of the topics and of the time
        some = [(one.topic, one.log_time) for one in run.messages(["notes"], start_ns=run.start_ns + 50_000_000)]
    wanted = [(name, time) for name, _, time in content(native) if name.endswith("/notes")]
    assert some == [one for one in wanted if one[1] >= found.start_ns + 50_000_000]


def add_outside(writer: Writer, channel: int, log_time: int, data: bytes) -> None:
    """Close the chunk that is open, and write a message behind it, outside chunks."""
    private = "_Writer__"
    chunks = getattr(writer, f"{private}chunk_builder")
    getattr(writer, f"{private}finalize_chunk")()
    setattr(writer, f"{private}chunk_builder", None)
    writer.add_message(channel, log_time, data, log_time)
    setattr(writer, f"{private}chunk_builder", chunks)


def appended(
    path: Path, *, outside: tuple[int, ...] = (0, 1, 7, 8, 14), **options: object
) -> list[tuple[str, bytes, int]]:
    """Write 15 strings, some of them outside chunks, as a writer without chunks that appends to a file with chunks."""
    sent = [("/notes", string(f"note {number}"), 10**9 + number) for number in range(15)]
    with path.open("wb") as target:
        writer = Writer(target, **options)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        notes = writer.register_channel("/notes", "cdr", schema)
        for number, (_, data, log_time) in enumerate(sent):
            if number == 8:
                writer.add_attachment(0, 0, "a.yaml", "application/yaml", b"a: 1\n")
            if number in outside:
                add_outside(writer, notes, log_time, data)
            else:
                writer.add_message(notes, log_time, data, log_time)
        writer.finish()
    return sent


@pytest.mark.parametrize("indexes", [IndexType.ALL, IndexType.ALL ^ IndexType.MESSAGE])
def test_a_file_with_messages_in_chunks_and_outside_is_read(tmp_path, indexes):
    path = tmp_path / "bag.mcap"
    sent = appended(path, index_types=indexes, enable_data_crcs=True)
    assert content(path) == sent
    with open_run(path) as run:
        assert [one.log_time for one in run.messages(start_ns=10**9 + 6, end_ns=10**9 + 9)] == [
            10**9 + n for n in (6, 7, 8)
        ]
    found = info(path)
    assert found.intact, found.verdict
    assert found.verdict.startswith("every checksum fits")
    assert recover(path, tmp_path / "strict").damage_count == 5
    report = recover(path, tmp_path / "out", accept_unchecked=True)
    assert report.complete
    assert content(tmp_path / "out") == sent
    data = bytearray(path.read_bytes())
    data[data.index(sent[7][1]) + 12] ^= 1
    path.write_bytes(data)
    assert "the checksum of its data section does not match" in info(path).verdict


def test_a_chunk_that_is_missing_in_the_index_is_not_ignored(tmp_path):
    path = tmp_path / "bag.mcap"
    with path.open("wb") as target:
        writer = Writer(target, index_types=IndexType.ALL ^ IndexType.CHUNK, enable_crcs=False)
        writer.start("ros2")
        notes = writer.register_channel("/notes", "json", 0)
        writer.add_message(notes, 1, b"{}", 1)
        writer._Writer__statistics.chunk_count = -1  # which the writer counts when it closes the chunk
        writer.finish()
    with pytest.raises(RecordingError, match=r"bag.mcap: its index lacks the chunk at byte \d+; impact-rig recover"):
        open_run(path)


def test_info_reports_which_checksums_exist(native, tmp_path):
    """A checksum of 0 means that there is none."""
    without = rewrite(native, tmp_path / "without.mcap", enable_crcs=False)
    assert info(without).verdict.startswith("its messages carry no checksums, 30 blocks of daq/scan without a gap")
    outside = rewrite(native, tmp_path / "outside.mcap", use_chunking=False, enable_crcs=False)
    assert info(outside).verdict.startswith("its messages carry no checksums")
    guarded = rewrite(native, tmp_path / "guarded.mcap", use_chunking=False, enable_data_crcs=True)
    assert info(guarded).verdict.startswith("every checksum fits")
    data = bytearray(guarded.read_bytes())
    data[len(data) // 4] ^= 1
    guarded.write_bytes(data)
    verdict = info(guarded).verdict
    assert "the checksum of its data section does not match" in verdict
    assert "--accept-unchecked" in verdict
    assert info(native).checksums.complete


def test_an_attachment_without_a_checksum_is_read_and_named(native, tmp_path):
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file, enable_crcs=False)
        writer.start("ros2")
        writer.add_attachment(0, 0, "config.yaml", "application/yaml", b"a: 1\n")
        writer.finish()
    data = bytearray(path.read_bytes())
    place = data.index(b"a: 1\n") + 5
    data[place : place + 4] = bytes(4)
    path.write_bytes(data)
    with open_run(path) as run:
        assert run.attachments() == {"config.yaml": b"a: 1\n"}
    assert "1 of 1 attachments carry none" in info(path).verdict


NO_SUMMARY = {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False, "use_summary_offsets": False}
WITHOUT = {  # options of rosbag2's storage configuration that leave out parts of the index
    "noRepeatedChannels": ({"repeat_channels": False}, "its index lists 0 of the 5 topics that its statistics count"),
    "noRepeatedSchemas": (
        {"repeat_schemas": False},
        "its index lists 0 of the 5 message definitions that its statistics count",
    ),
    "noStatistics": ({"use_statistics": False}, r"its index has no statistics \(numbers of messages and topics\)"),
    "noChunkIndex": (
        {"index_types": IndexType.ALL ^ IndexType.CHUNK},
        "its index lists 0 chunks, but its statistics count 1",
    ),
    "noSummary": ({**NO_SUMMARY, "index_types": IndexType.NONE}, "it has no index"),
}


@pytest.mark.parametrize("option", WITHOUT)
def test_a_bag_with_an_incomplete_index_is_rejected_with_advice_that_works(native, tmp_path, option):
    options, reason = WITHOUT[option]
    path = rewrite(native, tmp_path / "bag.mcap", **options)
    with pytest.raises(RecordingError, match=rf"bag\.mcap: {reason}; impact-rig recover saves the intact chunks"):
        open_run(path)
    assert recover(path, tmp_path / "out").complete
    assert content(tmp_path / "out") == content(native)


@pytest.mark.parametrize("chunked", [True, False])
def test_the_advice_for_an_unfinished_bag_works(native, tmp_path, chunked):
    path = rewrite(native, tmp_path / "cut.mcap", finish=False, use_chunking=chunked, enable_crcs=False)
    with pytest.raises(RecordingError, match="impact-rig recover"):
        open_run(path)
    with pytest.raises(RecordingError, match=r"carries no checksum.*--accept-unchecked accepts it"):
        recover(path, tmp_path / "strict")
    report = recover(path, tmp_path / "out", accept_unchecked=True)
    assert report.complete
    assert content(tmp_path / "out") == content(native)


@pytest.mark.parametrize("crcs", [True, False])
@pytest.mark.parametrize(
    ("kind", "schema"), [("jsonschema", b"{}"), ("protobuf", b"\x0a\xff\x00\xc3"), ("ros2msg", b"int32 a")]
)
def test_recovery_keeps_the_schemas_and_metadata_of_other_programs(tmp_path, kind, schema, crcs):
    """Messages whose type has no ROS name are kept, and metadata without a checksum do not count as damage."""
    path = tmp_path / "bag.mcap"
    writer = Writer(str(path), chunk_size=200, use_statistics=False, enable_crcs=crcs)
    writer.start("", "other")
    writer.add_metadata("calibration", {"sensor": "7"})
    number = writer.register_schema("other.Log" if kind != "ros2msg" else "other/msg/Log", kind, schema)
    channel = writer.register_channel("/log", "json", number)
    for k in range(30):
        writer.add_message(channel, k, b"{}", k, k)
    writer.finish()
    with pytest.raises(RecordingError, match=r"its index has no statistics \(.*\); impact-rig recover saves"):
        open_run(path)
    report = recover(path, tmp_path / "out", accept_unchecked=True)
    assert report.complete
    (file,) = (tmp_path / "out").glob("*.mcap")
    with file.open("rb") as opened:
        found = make_reader(opened)
        schemas = [(one.encoding, one.data) for one, _, _ in found.iter_messages()]
        metadata = {one.name: one.metadata for one in found.iter_metadata()}
    assert schemas == [(kind, schema)] * 30
    assert metadata["calibration"]["sensor"] == "7"
    with open_run(tmp_path / "out") as run:
        assert run.topics["/log"].count == 30


def test_individually_compressed_messages_are_read(native, tmp_path):
    path = rewrite(native, tmp_path / "bag.mcap", zstandard.ZstdCompressor().compress)
    assert content(path) == content(native)
    assert info(path).intact
    recover(path, tmp_path / "out")
    assert content(tmp_path / "out") == content(native), (
        "the recovered file is uncompressed, as its metadata.yaml states"
    )


def test_compressed_messages_that_do_not_state_their_size_are_read_with_any_budget(native, tmp_path, monkeypatch):
    def compress(data: bytes) -> bytes:
        compressor = zstandard.ZstdCompressor().compressobj()
        return compressor.compress(data) + compressor.flush()

    path = rewrite(native, tmp_path / "bag.mcap", compress)
    for factor in ("1", "1e6", "inf"):
        monkeypatch.setenv(budget.VARIABLE, factor)
        assert content(path) == content(native)


def test_a_message_that_claims_an_excessive_size_is_rejected_unless_the_user_raises_the_limit(
    native, tmp_path, monkeypatch
):
    bombs = iter([zstandard.ZstdCompressor().compress(bytes(33 * 2**20))])
    path = rewrite(native, tmp_path / "bomb.mcap", lambda data: next(bombs, data))
    with pytest.raises(RecordingError, match=r"bomb\.mcap: a compressed message states .*_BUDGET=N .*; impact-rig rec"):
        content(path)
    monkeypatch.setenv(budget.VARIABLE, "2")
    assert len(content(path)[0][1]) == 33 * 2**20


def test_a_channel_without_a_schema_is_valid(native, tmp_path):
    path = tmp_path / "json.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        notes = writer.register_schema(NOTES_TOPIC.type_name, "ros2msg", NOTES_TOPIC.schema.encode())
        first = writer.register_channel("/notes", "cdr", notes)
        second = writer.register_channel("/operator", "json", 0)
        writer.add_message(first, 1, string("one"), 1)
        writer.add_message(second, 2, b'{"name": "A"}', 2)
        writer.finish()
    found = info(path)
    assert found.intact, found.verdict
    assert {one.name: (one.type_name, one.count) for one in found.topics}["/operator"] == ("", 1)
    recover(path, tmp_path / "out")
    with open_run(tmp_path / "out") as run:
        assert [(one.topic, bytes(one.data)) for one in run.messages()][1] == ("/operator", b'{"name": "A"}')
        known: TopicDescription = run.topics["/operator"].topic
        assert (known.type_name, known.encoding) == ("", "json")


WRITERS = {
    "with a JSON channel that has no schema": {},
    "without chunks": {"use_chunking": False},
    "without checksums": {"enable_crcs": False},
    "in a folder of old metadata": {},
}


@pytest.mark.parametrize("shape", WRITERS)
def test_messages_in_a_bag_of_another_driver_are_counted_correctly(tmp_path, shape):
    """A bag of 30 strings in 0.29 s without scans, in each valid shape: it must not be called damaged or incomplete."""
    (tmp_path / "bag").mkdir()
    file, topics = tmp_path / "bag" / "bag_0.mcap", {"/notes": 30}
    with file.open("wb") as target:
        writer = Writer(target, **WRITERS[shape])
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        notes = writer.register_channel("/notes", "cdr", schema)
        for number in range(30):
            writer.add_message(notes, 10**9 + number * 10**7, string(f"note {number}"), 10**9 + number * 10**7)
        if "JSON" in shape:
            writer.add_message(writer.register_channel("/operator", "json", 0), 10**9, b'{"name": "A"}', 10**9)
            topics["/operator"] = 1
        writer.finish()
    if "folder" in shape:
        listed = {"version": 3, "storage_identifier": "mcap", "relative_file_paths": ["bag/bag_0.mcap"]}
        (tmp_path / "bag" / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": listed}))
        file = tmp_path / "bag"
    found = info(file)
    assert {one.name: one.count for one in found.topics} == topics
    assert (found.end_ns - found.start_ns) / 1e9 == pytest.approx(0.29)
    checksums = "its messages carry no checksums" if "without" in shape else "every checksum fits"
    assert found.verdict.startswith(f"{checksums}, there is no daq/scan")


def convert(source: Path, target: Path, *options: str) -> Path:
    """Convert a bag with the `rosbags` library."""
    program = Path(sys.executable).with_name("rosbags-convert")
    subprocess.run([program, "--src", source, "--dst", target, *options], check=True, capture_output=True)
    return target


@pytest.mark.parametrize("options", [(), ("--compress", "zstd", "--compress-mode", "message")])
def test_bags_of_another_writer_have_the_same_content(native, tmp_path, options):
    bag = convert(native, tmp_path / "bag", "--dst-storage", "mcap", *options)
    assert sorted(content(bag)) == sorted(content(native))
    assert info(bag).scans.whole


def test_a_bag_in_sqlite_is_rejected_with_a_command_that_converts_it(native, tmp_path):
    bag = convert(native, tmp_path / "bag", "--dst-storage", "sqlite3")
    for read in (open_run, info, lambda path: recover(path, tmp_path / "out")):
        with pytest.raises(RecordingError, match=r"in SQLite, only MCAP is read; .*ros2 bag convert.*rosbags-convert"):
            read(bag)
    again = convert(bag, tmp_path / "again", "--dst-storage", "mcap")
    assert sorted(content(again)) == sorted(content(native))


def test_a_bag_compressed_as_a_file_is_rejected_with_a_command_that_converts_it(native, tmp_path):
    bag = convert(native, tmp_path / "bag", "--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "file")
    for read in (open_run, lambda path: recover(path, tmp_path / "out")):
        with pytest.raises(RecordingError, match=r"compressed as a whole .*; unpack it \(zstd -d\), or convert"):
            read(bag)
    (packed,) = bag.glob("*.zstd")
    with packed.open("rb") as source, packed.with_suffix("").open("wb") as target:
        zstandard.ZstdDecompressor().copy_stream(source, target)
    assert sorted(content(bag)) == sorted(content(native)), "metadata.yaml still lists the packed file"


@pytest.mark.heavy
def test_files_are_read_in_the_order_of_metadata_yaml(record, tmp_path):
    with record(max_file_bytes=30_000, chunk_bytes=10_000) as writer:
        fill(writer, 60)
    before = content(writer.directory)
    names = [file.name for file in writer.files]
    assert len(names) > 2
    bag = tmp_path / "bag"
    shutil.copytree(writer.directory, bag)
    shutil.copy(bag / names[0], bag / "aside.mcap")
    assert content(bag) == before, "a file that is not listed is not part of it"


def test_older_metadata_with_the_folder_in_paths_is_read(native, tmp_path):
    bag = tmp_path / "bag"
    shutil.copytree(native, bag)
    path = bag / "metadata.yaml"
    metadata = yaml.safe_load(path.read_text())
    listed = metadata["rosbag2_bagfile_information"]
    listed["version"] = 3
    listed["relative_file_paths"] = [f"somewhere/{name}" for name in listed["relative_file_paths"]]
    path.write_text(yaml.safe_dump(metadata))
    assert content(bag) == content(native)
    next(bag.glob("*.mcap")).unlink()
    with pytest.raises(RecordingError, match=r"lacks .*, listed in its metadata.yaml"):
        open_run(bag)


@pytest.mark.parametrize("listed", ["run.mcap", {"run.mcap": 1}, None])
def test_files_that_are_not_listed_as_a_list_are_rejected(tmp_path, listed):
    content = {"rosbag2_bagfile_information": {"relative_file_paths": listed}}
    (tmp_path / "metadata.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(RecordingError, match=r"it has no list rosbag2_bagfile_information: relative_file_paths; "):
        open_run(tmp_path)


@pytest.mark.parametrize("what", ["index", "statistics"])
def test_a_topic_that_is_in_no_index_is_reported_as_missing(native, tmp_path, what):
    """The messages are in the chunks, but no reader that uses the index can find them."""
    from impact_rig.recording.records import CHUNK_INDEX, STATISTICS

    opcode = {"index": CHUNK_INDEX, "statistics": STATISTICS}[what]
    path = rewrite(native, tmp_path / "bag.mcap", enable_crcs=False)
    with open_run(path) as run:
        number = next(i for i, one in run.sources[0].topics.items() if one.name == SCAN_TOPIC.name)
    data = bytearray(path.read_bytes())
    entry = number.to_bytes(2, "little")
    place = data.index(entry, _record(data, opcode) + (9 + 8 * 4 + 4 if opcode == CHUNK_INDEX else 9 + 46))
    data[place : place + 2] = (99).to_bytes(2, "little")
    path.write_bytes(data)
    assert not info(path).intact


def _record(data: bytearray, opcode: int) -> int:
    """Return the position of the first record of a kind in the summary of a file."""
    start = int.from_bytes(data[-28:-20], "little")
    while data[start] != opcode:
        start += 9 + int.from_bytes(data[start + 1 : start + 9], "little")
    return start
