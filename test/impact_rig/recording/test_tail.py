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
"""Secured messages survive a kill at any instant: none is missing, none is duplicated, and there are no others."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path

import numpy as np
import pytest
from kits.recording import NOTES_TOPIC, SCAN_TOPIC, scan_block, string

from impact_rig.errors import RecordingError
from impact_rig.recording import Attachment, open_run, records
from impact_rig.recording.writer import Tail, tail_of
from impact_rig.runs import recover

BLOCKS = 12


def given_back(directory, out):
    """Recover a run and return the data of its messages, in order."""
    try:
        recover(directory, out)
    except RecordingError as error:
        if "no message can be recovered" not in str(error):
            raise
        return []
    with open_run(out) as run:
        found = [bytes(message.data) for message in run.messages(recorded_order=True)]
    shutil.rmtree(out)
    return found


def write(writer, number):
    """Write a block and, with every third, a remark; return their data."""
    data = [scan_block(number, scans=20)]
    writer.write(SCAN_TOPIC.name, data[0], 0, number)
    if number % 3 == 0:
        if number == 3:
            writer.add_topic(NOTES_TOPIC)  # while a chunk is open
        if number:
            data.append(string(f"note {number}"))
            writer.write(NOTES_TOPIC.name, data[1], 0, number)
    return data


@pytest.mark.parametrize("options", [{"chunk_bytes": 2500}, {"max_file_bytes": 3000, "chunk_bytes": 1500}])
@pytest.mark.repeats
def test_all_secured_messages_are_recovered_after_a_kill_at_any_call(record, tmp_path, options):
    """A copy of the files between two calls is what a killed process would leave."""
    writer = record(tail=True, **options)
    writer.add_topic(SCAN_TOPIC)
    sent, secured, copies = [], 0, 0
    for number in range(BLOCKS):
        for call in (lambda n=number: sent.extend(write(writer, n)), writer.secure):
            call()
            if call == writer.secure:
                secured = len(sent)
            if secured:
                shutil.copytree(writer.directory, tmp_path / "killed")
                found = given_back(tmp_path / "killed", tmp_path / "out")
                assert len(found) >= secured
                assert found == sent[: len(found)]
                shutil.rmtree(tmp_path / "killed")
                copies += 1
    assert copies > BLOCKS
    writer.finish()
    assert not list(writer.directory.glob("*.tail"))
    with open_run(writer.directory) as run:
        assert [bytes(message.data) for message in run.messages(recorded_order=True)] == sent


@pytest.mark.parametrize("chunk_bytes", range(1500, 5000, 100))
@pytest.mark.repeats
def test_a_new_topic_in_a_nearly_full_chunk_costs_no_message(record, tmp_path, chunk_bytes):
    """The definition may fill the chunk: messages secured afterwards belong to the next chunk."""
    writer = record(tail=True, chunk_bytes=chunk_bytes)
    writer.add_topic(SCAN_TOPIC)
    sent = []
    for number in range(4):
        if number == 3:
            writer.add_topic(NOTES_TOPIC)
        sent.append(scan_block(number, scans=16))
        writer.write(SCAN_TOPIC.name, sent[-1], 0, number)
        writer.secure()
    shutil.copytree(writer.directory, tmp_path / "killed")
    assert given_back(tmp_path / "killed", tmp_path / "out") == sent
    writer.finish()


def test_a_tail_defines_a_topic_that_the_tail_before_lacked(record):
    """Its definitions are those of the tail before, unless there is a further topic."""
    writer = record(tail=True)
    writer.add_topic(SCAN_TOPIC)
    tails = []
    for number in (1, 3):  # the second begins with a new topic
        write(writer, number)
        writer.secure()
        (path,) = writer.directory.glob("*.tail")
        tails.append(path.read_bytes())
    writer.finish()
    assert [NOTES_TOPIC.name.encode() in data for data in tails] == [False, True]
    assert all(SCAN_TOPIC.name.encode() in data for data in tails)


@pytest.mark.parametrize("left", [1, 9, 500, -1])
def test_a_chunk_cut_after_an_attachment_is_recovered_from_the_tail(record, tmp_path, left):
    """The tail has all messages of the chunk, so an attachment before the damaged chunk must not cause a loss."""
    writer = record(tail=True)
    writer.add_topic(SCAN_TOPIC)
    for number in range(10):
        if number == 5:
            writer.attach(Attachment("calibration.yaml", b"gain: 1"))
        writer.write(SCAN_TOPIC.name, scan_block(number), 0, number)
        writer.secure()
    shutil.copytree(writer.directory, tmp_path / "killed")
    begin = writer.bytes_written
    writer.finish()
    with open_run(writer.directory) as run:
        (index,) = run.sources[0].summary.chunk_indexes
    assert index.chunk_start_offset == begin
    length = left if left > 0 else index.chunk_length - 1
    (tmp_path / "killed" / "run.mcap").write_bytes(writer.files[0].read_bytes()[: begin + length])
    report = recover(tmp_path / "killed", tmp_path / "out")
    assert (report.messages, report.damages, report.lost_bytes) == (10, [], 0)


def test_no_message_is_recovered_twice_after_a_kill_before_the_tail_is_removed(record, tmp_path, monkeypatch):
    """This is the only instant at which both files contain the same messages."""
    instants = []

    def remove(tail):
        shutil.copytree(tail.path.parent, tmp_path / f"killed{len(instants)}")
        instants.append(len(sent))
        really_remove(tail)

    really_remove = Tail.remove
    monkeypatch.setattr(Tail, "remove", remove)
    writer = record(tail=True, chunk_bytes=2500)
    writer.add_topic(SCAN_TOPIC)
    sent = []
    for number in range(BLOCKS):
        sent.append(scan_block(number, scans=20))
        writer.write(SCAN_TOPIC.name, sent[-1], 0, number)
        writer.secure()
    writer.finish()
    assert len(instants) > 3
    for case, count in enumerate(instants):
        assert tail_of(tmp_path / f"killed{case}" / writer.files[0].name).exists()
        assert given_back(tmp_path / f"killed{case}", tmp_path / "out") == sent[:count]


def killed(record, tmp_path, scans, chunk_bytes):
    """Record four blocks; return the finished writer, a copy of the run before its end, and the messages."""
    writer = record(tail=True, chunk_bytes=chunk_bytes)
    writer.add_topic(SCAN_TOPIC)
    sent = [scan_block(number, scans=scans) for number in range(4)]
    for number, block in enumerate(sent):
        writer.write(SCAN_TOPIC.name, block, 0, number)
        writer.secure()
    kept = tmp_path / "kept"
    shutil.copytree(writer.directory, kept)
    writer.finish()
    return writer, kept, sent


@pytest.mark.heavy
def test_a_chunk_cut_short_while_it_was_written_is_replaced_by_the_tail(record, tmp_path):
    """The process was killed while it wrote a chunk, or while it wrote the tail."""
    writer, kept, sent = killed(record, tmp_path, scans=20, chunk_bytes=10_000)
    assert not tail_of(Path(writer.files[0])).exists()
    recording, tail = kept / "run.mcap", tail_of(kept / "run.mcap")
    main_bytes, whole, secured = recording.stat().st_size, writer.files[0].read_bytes(), tail.read_bytes()
    for size in range(main_bytes, main_bytes + 200, 29):
        recording.write_bytes(whole[:size])
        assert given_back(kept, tmp_path / "out") == sent
    recording.write_bytes(whole[:main_bytes])
    counts = []
    for size in [*range(0, len(secured), 97), len(secured)]:
        tail.write_bytes(secured[:size])
        found = given_back(kept, tmp_path / "out")
        assert found == sent[: len(found)]
        counts.append(len(found))
    assert counts == sorted(counts)
    assert set(counts) == {0, 1, 2, 3, 4}


def test_a_run_without_a_tail_has_no_second_file(record):
    writer = record()
    writer.add_topic(SCAN_TOPIC)
    writer.write(SCAN_TOPIC.name, scan_block(0), 0, 0)
    writer.secure()
    assert [path.name for path in writer.directory.iterdir()] == ["run.mcap"]
    writer.finish()


def test_a_tail_of_another_user_is_not_overwritten(record):
    writer = record(tail=True)
    writer.add_topic(SCAN_TOPIC)
    other = tail_of(Path(writer.files[0]))
    other.write_text("mine")
    with pytest.raises(RecordingError, match=r"run.mcap.tail exists already and is not overwritten"):
        writer.write(SCAN_TOPIC.name, scan_block(0), 0, 0)
    assert other.read_text() == "mine"
    (writer.directory / "run.mcap").unlink()
    with pytest.raises(RecordingError, match=r"holds a recording already \(run.mcap.tail\)"):
        record(tail=True)


def flipped_tails(kept, whole):
    """Yield the tail with one bit flipped at each structural position and at some within each chunk, and truncated."""
    rng = np.random.default_rng(5)
    ends, offset = [], len(records.MAGIC)
    while offset < len(whole):
        _, _, end = records.split(memoryview(whole), offset)
        ends.append((offset, end))
        offset = end
    for begin, end in [(0, len(records.MAGIC)), *ends]:
        inside = rng.integers(begin, end, 3).tolist()
        for place in sorted({begin, *range(begin, min(end, begin + 140), 13), *inside, end - 1}):
            damaged = bytearray(whole)
            damaged[place] ^= 1 << int(rng.integers(8))
            yield place, bytes(damaged)


@pytest.mark.heavy
def test_one_flipped_bit_in_the_tail_costs_at_most_one_of_its_chunks(record, tmp_path):
    """The other chunks can be read without the metadata of the tail, and without the definitions in its first chunk."""
    _, kept, sent = killed(record, tmp_path, scans=4, chunk_bytes=10**6)
    tail = tail_of(kept / "run.mcap")
    whole = tail.read_bytes()
    for place, damaged in flipped_tails(kept, whole):
        tail.write_bytes(damaged)
        report = recover(kept, tmp_path / "out")
        shutil.rmtree(tmp_path / "out")
        assert report.messages >= len(sent) - 1, place
        assert report.complete == (report.messages == len(sent) and not report.damages), place
        if report.messages < len(sent):
            assert report.damages[0].file == "run.mcap.tail", place
    for size in (len(whole) - 1, 100, 40, 9, 3):  # truncated: the rest is recovered, the loss is reported
        tail.write_bytes(whole[:size])
        with contextlib.suppress(RecordingError):
            assert not recover(kept, tmp_path / "out").complete
            shutil.rmtree(tmp_path / "out")


@pytest.mark.parametrize("follows_readable", [True, False])
def test_a_superfluous_tail_is_recognised_without_its_first_record(record, tmp_path, monkeypatch, follows_readable):
    monkeypatch.setattr(Tail, "remove", lambda tail: shutil.copytree(tail.path.parent, tmp_path / "kept"))
    writer = record(tail=True, chunk_bytes=10**6)
    writer.add_topic(SCAN_TOPIC)
    sent = [scan_block(number) for number in range(3)]
    for number, data in enumerate(sent):
        writer.write(SCAN_TOPIC.name, data, 0, number)
        writer.secure()
    writer.finish()
    tail = tail_of(tmp_path / "kept" / "run.mcap")
    if not follows_readable:
        damaged = bytearray(tail.read_bytes())
        damaged[len(records.MAGIC) + 60] ^= 4
        tail.write_bytes(bytes(damaged))
    assert given_back(tmp_path / "kept", tmp_path / "out") == sent
