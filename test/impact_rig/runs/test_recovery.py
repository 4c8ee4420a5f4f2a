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
"""Recovery from a file with any damage: only recorded data, never wrong data, and never a hang."""

from __future__ import annotations

import contextlib
import os
import shutil
import struct
import subprocess
import sys
import textwrap
import time
from collections import Counter
from pathlib import Path

import attrs
import lz4.frame
import numpy as np
import pytest
import yaml
import zstandard
from kits.recording import CONFIG, PROVENANCE, HandClock, fill, foreign_file, scan_block, string

pytest.importorskip("rosbags", reason="an independent reader, only on PyPI")

from mcap.records import Chunk
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from impact_rig.errors import RecordingError
from impact_rig.recording import Attachment, Provenance, RunWriter, TopicDescription, losses, open_run, records
from impact_rig.runs import info, recover, recovery
from impact_rig.system import budget
from impact_rig.system.budget import BudgetError

SMALL_TOPICS = tuple(
    TopicDescription(name=f"/rig/{name}", type_name="std_msgs/msg/String", schema="string data\n")
    for name in ("notes", "log")
)


def key(message):
    return (message.topic, message.type_name, bytes(message.data), message.log_time, message.publish_time)


def small_run(directory, compression="zstd", topics=SMALL_TOPICS):
    """Run of about 4 kB: twelve messages in a few chunks, two topics, one attachment."""
    with RunWriter(
        directory,
        provenance=Provenance(version="1", seed=3, wall_start_ns=4),
        attachments=[Attachment("config.yaml", b"a: 1\n")],
        clock=HandClock(),
        compression=compression,
        chunk_bytes=220,
    ) as writer:
        for topic in topics:
            writer.add_topic(topic)
        for number in range(12):
            writer.write_at(
                topics[number % len(topics)].name, string(f"message {number:3}" * 4), 10 + number, 20, number
            )
    return writer.files[0]


def read_all(path):
    with open_run(path) as run:
        return [key(m) for m in run.messages(recorded_order=True)], run.attachments(), run.provenance


def chunk_ends(path):
    """Return the end of each chunk in the file, and the number of messages up to there."""
    ends, count = [], 0
    with open_run(path) as run:
        for segment in run.sources[0].segments:
            count += sum(1 for _ in records.messages(run.sources[0].content(segment), None))
            ends.append((segment.offset + segment.length, count))
    return ends


def record_starts(data):
    """Return the start of each record of a file, and the end of the last one."""
    starts = [len(records.MAGIC)]
    while starts[-1] < len(data) - len(records.MAGIC):
        starts.append(starts[-1] + records.RECORD_HEAD.size + records.RECORD_HEAD.unpack_from(data, starts[-1])[1])
    return starts


def near_records(data):
    """Return every edge of a record and of its content, a byte before and after each, and some offsets between."""
    edges = {start + inside for start in (0, *record_starts(data)) for inside in (0, 1, records.RECORD_HEAD.size)}
    between = np.random.default_rng(4).choice(len(data), 40, replace=False).tolist()
    return sorted({edge + side for edge in edges for side in (-1, 0, 1)} & set(range(len(data))) | set(between))


def every_byte(data):
    return range(len(data))


THOROUGH = pytest.mark.slow


@pytest.mark.parametrize(
    ("compression", "topics", "cuts"),
    [
        ("zstd", SMALL_TOPICS[:1], near_records),
        pytest.param("zstd", SMALL_TOPICS[:1], every_byte, marks=THOROUGH),
        pytest.param("none", SMALL_TOPICS, every_byte, marks=THOROUGH),
    ],
)
@pytest.mark.repeats
def test_a_run_truncated_at_any_byte_is_recovered(tmp_path, compression, topics, cuts):
    whole = small_run(tmp_path / "run", compression, topics)
    data = whole.read_bytes()
    sent, attachments, provenance = read_all(whole)
    ends = chunk_ends(whole)
    assert len(ends) >= 3
    cut_file = tmp_path / "cut.mcap"
    for cut in cuts(data):
        cut_file.write_bytes(data[:cut])
        with pytest.raises(RecordingError, match=r"cut.mcap: it"):
            open_run(cut_file)
        expected = max((count for end, count in ends if end <= cut), default=0)
        out = tmp_path / f"out{cut}"
        if not expected:
            with pytest.raises(RecordingError, match="no message can be recovered from"):
                recover(cut_file, out)
            assert not out.exists()
            continue
        report = recover(cut_file, out)
        assert report.messages == expected
        assert report.expected_messages is None
        assert all(damage.offset + damage.length <= cut for damage in report.damages)
        assert read_all(out / f"{out.name}.mcap") == (sent[:expected], attachments, provenance)
        shutil.rmtree(out)


def test_an_intact_run_is_recovered_completely(record, tmp_path):
    with record(chunk_bytes=40_000) as writer:
        sent = fill(writer, 40)
    report = recover(writer.directory, tmp_path / "out")
    assert (report.messages, report.expected_messages, report.damages) == (len(sent), len(sent), [])
    assert read_all(tmp_path / "out") == read_all(writer.directory)
    with open_run(writer.directory) as before, open_run(tmp_path / "out") as after:
        assert after.topics == before.topics
        assert [m.sequence for m in after.messages()] == [m.sequence for m in before.messages()]
    ours = yaml.safe_load((writer.directory / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    theirs = yaml.safe_load((tmp_path / "out" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert theirs | {"files": 0, "relative_file_paths": 0} == ours | {"files": 0, "relative_file_paths": 0}


def test_a_truncated_run_is_readable_by_other_tools_after_recovery(record, tmp_path):
    with record(chunk_bytes=20_000) as writer:
        fill(writer, 40)
    data = writer.files[0].read_bytes()
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    report = recover(tmp_path / "cut", tmp_path / "out")
    assert len(report.damages) == 1
    assert report.damages[0].reason.startswith("the file ends inside this record")
    with AnyReader([tmp_path / "out"]) as reader:
        assert sum(1 for _ in reader.messages()) == report.messages > 10


def check_never_wrong(path, out, sent, attachments, provenance):
    """Recover and read `path`; check that all recovered messages were sent, and return their number."""
    try:
        with open_run(path) as run:
            got = [key(m) for m in run.messages(recorded_order=True)]
            assert got == sent  # a reader returns all messages or reports the fault
            assert run.provenance in (provenance, {})
            assert run.attachments().items() <= attachments.items()
    except RecordingError:
        pass
    try:
        recover(path, out)
    except RecordingError as error:
        if "no message can be recovered" not in str(error):
            raise
        return 0
    got, found, record = read_all(out / f"{out.name}.mcap")
    assert not Counter(got) - Counter(sent)
    assert found.items() <= attachments.items()
    assert record in (provenance, {})
    return len(got)


def flip(data, bits):
    damaged = bytearray(data)
    for bit in bits:
        damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


@pytest.mark.parametrize("flips", [30, pytest.param(300, marks=THOROUGH)])
@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.repeats
def test_one_flipped_bit_costs_at_most_one_chunk(tmp_path, compression, flips):
    """One bit in the opcode and one in the length of every record, and a sample of all bits."""
    path = small_run(tmp_path / "run", compression)
    data = path.read_bytes()
    sent, attachments, provenance = read_all(path)
    most = max(np.diff([0, *(count for _, count in chunk_ends(path))]))
    rng = np.random.default_rng(1)
    heads = [8 * (start + inside) + rng.integers(8) for start in record_starts(data) for inside in (0, 1)]
    for case, bit in enumerate([*heads, *rng.choice(len(data) * 8, flips, replace=False)]):
        (tmp_path / "damaged.mcap").write_bytes(flip(data, [bit]))
        back = check_never_wrong(tmp_path / "damaged.mcap", tmp_path / f"out{case}", sent, attachments, provenance)
        assert back >= len(sent) - most, f"bit {bit} of byte {bit // 8}"


@pytest.mark.parametrize("cases", [60, pytest.param(300, marks=THOROUGH)])
@pytest.mark.repeats
def test_many_flipped_bits_and_overwritten_parts_yield_no_wrong_message(tmp_path, cases):
    path = small_run(tmp_path / "run")
    data = path.read_bytes()
    sent, attachments, provenance = read_all(path)
    rng = np.random.default_rng(2)
    back = []
    for case in range(cases):
        damaged = flip(data, rng.choice(len(data) * 8, rng.integers(2, 30), replace=False))
        if case % 3 == 0:
            start, length = rng.integers(len(data)), rng.integers(1, 200)
            damaged = damaged[:start] + rng.bytes(length) + damaged[start + length :]
        if case % 5 == 0:
            start, length = rng.integers(len(data)), rng.integers(1, 200)
            damaged = damaged[:start] + damaged[start + length :]
        (tmp_path / "damaged.mcap").write_bytes(damaged)
        args = (tmp_path / "damaged.mcap", tmp_path / f"out{case}", sent, attachments, provenance)
        back.append(check_never_wrong(*args))
    assert sum(back) > cases  # the test would prove nothing if every input were rejected


@pytest.mark.heavy
def test_a_chunk_after_damage_of_any_length_is_found(tmp_path, monkeypatch):
    """The chunk may lie across the edges of what is read at once."""
    monkeypatch.setattr(recovery, "_FIRST_WINDOW_BYTES", recovery._PATTERN_BYTES)
    path = tmp_path / "damaged.mcap"
    for name in (b"", b"lz4", b"zstd", b"x" * recovery._LONGEST_NAME):
        fixed = struct.pack("<QQQII", 1, 2, 3, 4, len(name)) + name + struct.pack("<Q", 1) + b"."
        chunk = records.RECORD_HEAD.pack(records.CHUNK, len(fixed)) + fixed
        for lost in range(150) if len(name) < recovery._LONGEST_NAME else (0,):  # no such chunk is searched for
            path.write_bytes(records.MAGIC + b"\xff" * lost + chunk)
            with recovery.DamagedFile(path) as file:
                *damages, found = file.walk()
            assert [(damage.offset, damage.length) for damage in damages] == [(len(records.MAGIC), lost)][: lost > 0]
            assert found == recovery.Found(records.CHUNK, len(records.MAGIC) + lost, len(chunk))


def test_records_truncated_anywhere_count_as_damage(tmp_path):
    path = small_run(tmp_path / "run", "none")
    with open_run(path) as run:
        content = bytes(run.sources[0].content(run.sources[0].segments[0]))
    edges = [0]
    while edges[-1] < len(content):
        edges.append(records.split(memoryview(content), edges[-1])[2])
    assert len(edges) > 3
    for cut in range(len(content) + 1):
        view = memoryview(content)[:cut]
        for read in (
            lambda v: [*records.messages(v, None)],
            lambda v: [*records.definitions(v)],
            lambda v: records.count(v, 99),
        ):
            with contextlib.nullcontext() if cut in edges else pytest.raises(records.DamageError):
                read(view)


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
@pytest.mark.parametrize(("size", "cut"), [(900, 0), (999, 0), (1001, 0), (1000, 4)])
def test_a_chunk_of_another_size_than_stated_is_damage_without_a_checksum_too(compression, size, cut):
    compress = {"lz4": lz4.frame.compress, "zstd": zstandard.ZstdCompressor(write_content_size=False).compress}
    data = compress[compression](b"x" * 1000)
    zeros = dict.fromkeys(("message_start_time", "message_end_time", "uncompressed_crc"), 0)
    chunk = Chunk(compression=compression, data=data, uncompressed_size=1000, **zeros)
    assert bytes(records.decompress(chunk)) == b"x" * 1000
    chunk.uncompressed_size, chunk.data = size, data[: len(data) - cut]
    with pytest.raises(records.DamageError):
        records.decompress(chunk)


@pytest.mark.parametrize("following", [0, 50])
def test_a_message_too_short_for_its_head_is_damage_wherever_it_is_in_a_chunk(following):
    short = records.RECORD_HEAD.pack(records.MESSAGE, 5) + bytes(5 + following)
    with pytest.raises(records.DamageError, match="a message record of 5 bytes is too short: it needs at least 22"):
        list(records.messages(memoryview(short), None))


def test_the_loss_of_the_chunk_with_the_definitions_costs_only_that_chunk(tmp_path):
    """The topics are repeated outside the chunks, so an unfinished file does not depend on its first chunk."""
    path = small_run(tmp_path / "run")
    sent, _, _ = read_all(path)
    ends = chunk_ends(path)
    data = bytearray(path.read_bytes()[: ends[-1][0]])
    data[ends[0][0] - 3] ^= 0xFF  # in the first chunk's compressed data
    path.write_bytes(data)
    report = recover(path, tmp_path / "out")
    assert read_all(tmp_path / "out")[0] == sent[ends[0][1] :]
    assert "chunk" in report.damages[0].reason


def test_the_losses_of_a_damaged_run_are_reported(tmp_path):
    path = small_run(tmp_path / "run")
    ends = chunk_ends(path)
    data = bytearray(path.read_bytes())
    data[ends[1][0] - 3] ^= 0xFF
    path.write_bytes(data)
    with open_run(path) as run, pytest.raises(RecordingError, match=r"run.mcap: the chunk at byte \d+ is damaged: "):
        list(run.messages())
    report = recover(path.parent, tmp_path / "out")
    assert (report.expected_messages, report.messages) == (12, 12 - (ends[1][1] - ends[0][1]))
    (damage,) = report.damages
    assert (damage.file, damage.offset + damage.length) == ("run.mcap", ends[1][0])
    assert report.lost_bytes == damage.length


def test_split_runs_are_recovered_file_by_file(record, tmp_path):
    with record(max_file_duration_ns=100_000_000, chunk_bytes=20_000) as writer:
        sent = fill(writer, 40)
    last = writer.files[-1]
    last.write_bytes(last.read_bytes()[:-200])
    (writer.directory / "metadata.yaml").unlink()
    with pytest.raises(RecordingError, match="its end is missing: its recorder was interrupted or still writes"):
        open_run(writer.directory)
    report = recover(writer.directory, tmp_path / "out")
    assert report.messages == len(sent)
    assert [m[2] for m in read_all(tmp_path / "out")[0]] == [s.data for s in sent]


def test_a_damaged_metadata_yaml_does_not_prevent_recovery(record, tmp_path):
    with record() as writer:
        sent = fill(writer, 5)
    (writer.directory / "metadata.yaml").write_bytes(b"\xff\x00[")
    with pytest.raises(RecordingError, match=r"cannot parse .*metadata.yaml: .*recover does not need it"):
        open_run(writer.directory)
    assert recover(writer.directory, tmp_path / "out").messages == len(sent)
    lost = "something other than the messages in its index could not be recovered (0 bytes, damaged parts: 1)"
    assert lost in info(tmp_path / "out").verdict


@pytest.mark.heavy
def test_files_of_a_split_run_are_recovered_in_order_without_metadata_yaml(record, tmp_path):
    """Without metadata.yaml, the eleventh file must not come before the third."""
    with record(max_file_duration_ns=20_000_000) as writer:
        sent = fill(writer, 40)
    assert len(writer.files) > 10
    (writer.directory / "metadata.yaml").write_text("damaged: [")
    recover(writer.directory, tmp_path / "out")
    with open_run(tmp_path / "out") as run:
        assert [message.log_time for message in run.messages(recorded_order=True)] == [one.log_time for one in sent]


def test_the_first_of_several_attachments_of_one_name_is_that_of_the_start(record, tmp_path):
    """A recovered run must not have the configuration of the last file."""
    with record(max_file_duration_ns=20_000_000) as writer:
        writer.attach(Attachment("config.yaml", b"later"))
        fill(writer, 10)
    recover(writer.directory, tmp_path / "out")
    for path in (writer.directory, writer.files[0], tmp_path / "out"):
        with open_run(path) as run:
            assert run.attachments()["config.yaml"] == CONFIG


def test_losses_of_an_earlier_recovery_are_still_reported(record, tmp_path):
    """The result of a recovery that is recovered again must still state what the first one left out."""
    with record(chunk_bytes=20_000) as writer:
        fill(writer, 30)
    (path,) = writer.files
    with open_run(path) as run:
        offset = run.sources[0].summary.chunk_indexes[1].chunk_start_offset + 200
    path.write_bytes(path.read_bytes()[:offset] + bytes(100) + path.read_bytes()[offset + 100 :])
    recover(writer.directory, tmp_path / "once")
    recover(tmp_path / "once", tmp_path / "twice")
    once, twice = (info(tmp_path / name) for name in ("once", "twice"))
    assert once.recovered.missing_messages > 0
    assert twice.recovered == attrs.evolve(once.recovered, source="once")
    assert not twice.intact


def test_an_invalid_account_of_losses_counts_as_damage_and_is_left_out(tmp_path):
    with RunWriter(
        tmp_path / "run",
        provenance=PROVENANCE,
        clock=HandClock(),
        closing=lambda: {losses.RECORD_NAME: {"/rig/a": "x"}},
    ) as writer:
        writer.add_topic(SMALL_TOPICS[0])
        writer.write_at(SMALL_TOPICS[0].name, string("message"), 10, 20, 1)
    report = recover(writer.directory, tmp_path / "out")
    assert "the metadata record 'impact_rig/losses', the recorder's account" in report.damages[0].reason
    assert info(tmp_path / "out").recovered.damages == report.damage_count == 1


def test_recovery_overwrites_no_file(record, tmp_path):
    with record() as writer:
        fill(writer, 5)
    before = writer.files[0].read_bytes()
    with pytest.raises(RecordingError, match="nothing is overwritten"):
        recover(writer.directory, writer.directory)
    assert writer.files[0].read_bytes() == before


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x89MCAP0\r\n",
        b"\x06" + b"\xff" * 100,
        bytes(100_000),
        np.random.default_rng(3).bytes(3_000_000),
        (b"\x06" + (48).to_bytes(8, "little") + bytes(28) + bytes(4) + (8).to_bytes(8, "little") + bytes(8)) * 3000,
    ],
    ids=["empty", "magic", "huge length", "zeros", "noise", "hollow chunks"],
)
def test_files_that_are_not_recordings_are_rejected(tmp_path, content):
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=r"x.mcap: it"):
        open_run(tmp_path / "x.mcap")
    with pytest.raises(RecordingError, match="no message can be recovered"):
        recover(tmp_path / "x.mcap", tmp_path / "out")


def test_an_error_lists_a_few_of_many_reasons(tmp_path):
    writer = Writer(str(tmp_path / "x.mcap"))
    writer.start("ros2")
    for number in range(8):
        writer.add_metadata(f"record {number}", {})
    writer.finish()
    with pytest.raises(RecordingError, match=r"'record 4' carries no checksum [^;]*; and 3 more reasons$"):
        recover(tmp_path / "x.mcap", tmp_path / "out")


def test_chunks_without_checksum_are_recovered_only_on_request(tmp_path):
    """rosbag2 writes no chunk checksums by default; such a file can be read, but recovery cannot vouch for it."""
    foreign_file(tmp_path / "bag.mcap", crc=False)
    with open_run(tmp_path / "bag.mcap") as run:
        assert [bytes(m.data) for m in run.messages()] == [scan_block(i) for i in range(3)]
        assert run.provenance == {}
    with pytest.raises(RecordingError, match="a chunk carries no checksum"):
        recover(tmp_path / "bag.mcap", tmp_path / "out")
    assert recover(tmp_path / "bag.mcap", tmp_path / "out", accept_unchecked=True).messages == 3


def test_messages_outside_chunks_are_recovered_only_on_request(tmp_path):
    foreign_file(tmp_path / "bag.mcap", chunked=False)
    with open_run(tmp_path / "bag.mcap") as run:
        assert [bytes(m.data) for m in run.messages()] == [scan_block(i) for i in range(3)]
    with pytest.raises(RecordingError, match=r"a message outside a chunk carries no checksum \(--accept-unchecked"):
        recover(tmp_path / "bag.mcap", tmp_path / "out")
    assert recover(tmp_path / "bag.mcap", tmp_path / "out", accept_unchecked=True).messages == 3


@pytest.mark.heavy
def test_a_message_outside_chunks_beyond_a_limit_is_one_damage(tmp_path):
    path, big = tmp_path / "bag.mcap", zstandard.ZstdCompressor().compress(bytes(30 * 2**20))
    broken = records.ZSTD_MAGIC + b"no frame"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        notes = writer.register_channel("/notes", "cdr", schema)
        for number, data in enumerate((string("a"), big, big, big, broken, string("b"))):
            writer.add_message(notes, number, data, number)
        writer.finish()
    report = recover(path, tmp_path / "out", accept_unchecked=True)
    reasons = [damage.reason for damage in report.damages]
    assert reasons[0].startswith(
        f"{3 * 30 * 2**20} bytes in the chunks of {path.stat().st_size} bytes of files, more than"
    )
    assert reasons[1].startswith("a compressed message cannot be decompressed")
    assert len(reasons) == 2
    assert (report.messages, report.missing_messages) == (4, 2)


def test_a_topic_outside_chunks_beyond_the_limit_is_one_damage(tmp_path, monkeypatch):
    monkeypatch.setattr(budget, "TOPICS", 2)
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start("ros2")
        for number in range(3):
            writer.add_message(writer.register_channel(f"/{number}", "json", 0), number, b"{}", number)
        writer.finish()
    report = recover(path, tmp_path / "out", accept_unchecked=True)
    assert (report.messages, report.damage_count) == (2, 2), "the topic, and its message"


def test_a_chunk_that_claims_gigabytes_is_not_decompressed(tmp_path):
    path = small_run(tmp_path / "run", "none")
    with open_run(path) as run:
        index = run.sources[0].summary.chunk_indexes[1]
    data = bytearray(path.read_bytes())
    at = index.chunk_start_offset + records.RECORD_HEAD.size + 16
    data[at : at + 8] = (2**40).to_bytes(8, "little")
    path.write_bytes(data)
    with (
        open_run(path) as run,
        pytest.raises(RecordingError, match=f"it states a decompressed size of {2**40} bytes, the index"),
    ):
        list(run.messages())
    assert recover(path, tmp_path / "out").damage_count == 1


KILLED = """
    import sys, threading, time
    from pathlib import Path
    sys.path.insert(0, {tests!r})
    from kits.recording import *

    writer = RunWriter(Path({directory!r}), provenance=PROVENANCE, clock=time.monotonic)
    writer.add_topic(SCAN_TOPIC)
    writer.add_topic(NOTES_TOPIC)
    pace = threading.Event()
    begin = time.monotonic()
    number = 0
    while True:
        pace.wait(max(0.0, begin + number * 0.01 - time.monotonic()))
        writer.write(SCAN_TOPIC.name, scan_block(number, scans=500), number, number)
        print(number, time.monotonic(), flush=True)
        if number % 10 == 0:
            writer.write(NOTES_TOPIC.name, string(str(number)), number)
        writer.flush_due()
        number += 1
"""


def kill_a_writer(tmp_path: Path, after_s: float) -> None:
    """Kill -9 a process that records 50 kS/s; at most the last second may be missing, the rest must be identical."""
    directory = tmp_path / "run"
    script = textwrap.dedent(KILLED).format(tests=str(Path(__file__).parents[2]), directory=str(directory))
    log = tmp_path / "sent.txt"
    with log.open("wb") as file, subprocess.Popen([sys.executable, "-c", script], stdout=file) as process:
        deadline = time.monotonic() + 30
        while not log.stat().st_size and time.monotonic() < deadline:
            os.sched_yield()
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(timeout=after_s)
        process.kill()
        killed_s = time.monotonic()
    sent = [line.split() for line in log.read_text().splitlines()]
    written = len(sent)
    assert written > 20
    assert not (directory / "metadata.yaml").exists()
    with pytest.raises(RecordingError, match="impact-rig recover"):
        open_run(directory)
    report = recover(directory, tmp_path / "out")
    with open_run(tmp_path / "out") as run:
        kept = [bytes(m.data) for m in run.messages(["daq/scan"])]
        assert run.provenance == PROVENANCE.to_record()
    assert kept == [scan_block(number, scans=500) for number in range(len(kept))]
    if len(kept) < written:
        first_lost_s = float(sent[len(kept)][1])
        assert killed_s - first_lost_s <= 1.0
    assert report.damage_count <= 1


@pytest.mark.parametrize("after_s", [1.3])
def test_a_killed_writer_loses_less_than_a_second(tmp_path, after_s):
    kill_a_writer(tmp_path, after_s)


@pytest.mark.slow
@pytest.mark.parametrize("after_s", np.random.default_rng(5).uniform(0.6, 4.0, 20).round(3).tolist())
def test_a_killed_writer_loses_less_than_a_second_at_any_instant(tmp_path, after_s):
    kill_a_writer(tmp_path, after_s)


@pytest.mark.heavy
def test_the_number_of_recovered_topics_is_bounded(tmp_path, monkeypatch):
    """A small file can define very many topics; the limit is that for reading a run."""
    path = tmp_path / "many.mcap"
    writer = Writer(str(path), compression=CompressionType.NONE)
    writer.start("ros2")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    channels = [writer.register_channel(f"/{number}", "cdr", schema) for number in range(budget.TOPICS + 2)]
    writer.add_message(channels[0], 1, string("a"), 1)
    writer.finish()
    with pytest.raises(BudgetError, match=f"{budget.TOPICS + 2} topics, more than {budget.TOPICS}"):
        open_run(path)
    taken = []
    monkeypatch.setattr(TopicDescription, "from_channel", lambda *found: taken.append(found[0]))
    with pytest.raises(RecordingError, match=f"{budget.TOPICS + 1} topics, more than {budget.TOPICS}"):
        recover(path, tmp_path / "out")
    assert len(taken) == budget.TOPICS + 1


def test_metadata_and_attachments_after_a_damaged_length_are_found(tmp_path):
    """One damaged length must not lose what is between it and the next chunk."""
    path = small_run(tmp_path / "run")
    whole = path.read_bytes()
    _, _, first = records.split(memoryview(whole), len(records.MAGIC))
    damaged = bytearray(whole)
    damaged[first + 4] ^= 0x80  # the length of the first metadata record
    path.write_bytes(bytes(damaged))
    report = recover(tmp_path / "run", tmp_path / "out")
    assert report.damage_count == 1
    _, attachments, provenance = read_all(tmp_path / "out")
    assert (attachments, provenance["seed"]) == ({"config.yaml": b"a: 1\n"}, "3")
