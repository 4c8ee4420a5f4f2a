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
"""A full disk, a file size limit, an unusable directory: a clear message, and earlier data are intact."""

from __future__ import annotations

import errno
import itertools
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import yaml
from kits.recording import CONFIG, NOTES_TOPIC, SCAN_TOPIC, START_NS, fill, scan_block, string

pytest.importorskip("rosbags", reason="an independent reader, only on PyPI")

from rosbags.highlevel import AnyReader

from impact_rig.errors import RecordingError
from impact_rig.recording import open_run
from impact_rig.recording import writer as recording_writer
from impact_rig.recording.writer import CHUNK_OPEN_S
from impact_rig.runs import info, recover


def stamps(path):
    with open_run(path) as run:
        return [message.log_time for message in run.messages(["daq/scan"])]


def test_an_existing_recording_is_never_changed(record, tmp_path):
    with record() as writer:
        fill(writer, 3)
    before = {path.name: path.read_bytes() for path in writer.directory.iterdir()}
    with pytest.raises(RecordingError, match=r"holds a recording already \(metadata.yaml\); nothing is overwritten"):
        record()
    assert {path.name: path.read_bytes() for path in writer.directory.iterdir()} == before


def test_a_directory_with_other_files_can_be_used(record, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "summary.json").write_text("{}")
    with record() as writer:
        fill(writer, 3)
    assert len(stamps(writer.directory)) == 3


def test_two_writers_cannot_share_a_file(record, tmp_path):
    with record(), pytest.raises(RecordingError, match="holds a recording already"):
        record()


@pytest.mark.parametrize("where", ["file", "file/below"])
def test_a_file_in_place_of_the_directory_is_reported(record, tmp_path, where):
    """This fails for root as well, unlike a directory without write permission."""
    (tmp_path / "file").write_text("mine")
    with pytest.raises(
        RecordingError, match=r"is a file, not a directory|cannot use the run directory .*: Not a directory"
    ):
        record(where)
    assert (tmp_path / "file").read_text() == "mine"


def test_a_directory_that_cannot_be_created_is_reported(record):
    with pytest.raises(RecordingError, match="cannot use the run directory /proc/self/run"):
        record("/proc/self/run")


def test_an_unknown_compression_is_rejected_with_a_list_of_the_known_ones(record, tmp_path):
    with pytest.raises(RecordingError, match="compression must be one of none, lz4, zstd, got 'gzip'"):
        record(compression="gzip")
    assert list((tmp_path / "run").iterdir()) == []


def test_a_message_of_an_unknown_topic_does_not_stop_the_run(record):
    with record() as writer:
        fill(writer, 3)
        with pytest.raises(RecordingError, match="/rig/other has not been added"):
            writer.write("/rig/other", b"", 0)
        fill(writer, 3, first=3)
    assert len(stamps(writer.directory)) == 6


def test_a_finished_recording_can_be_finished_again_but_not_written(record):
    writer = record()
    fill(writer, 3)
    assert writer.finish() == writer.finish() == writer.directory
    assert writer.closed
    with pytest.raises(RecordingError, match="is finished"):
        writer.write(SCAN_TOPIC.name, scan_block(3), 0)
    writer.flush_due()


@pytest.mark.heavy
def test_a_file_is_split_by_size_and_each_part_is_readable_by_itself(record):
    with record(max_file_bytes=60_000, chunk_bytes=20_000) as writer:
        sent = fill(writer, 120)
    names = [path.name for path in writer.files]
    assert names == [f"run_{i}.mcap" for i in range(len(names))]
    assert len(names) >= 3
    info = yaml.safe_load((writer.directory / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert info["relative_file_paths"] == names
    assert [part["path"] for part in info["files"]] == names
    assert sum(part["message_count"] for part in info["files"]) == info["message_count"] == len(sent)
    with open_run(writer.directory) as run:
        assert [m.sequence for m in run.messages(recorded_order=True)] == [s.sequence for s in sent]
    for path, part in zip(writer.files, info["files"], strict=True):
        with open_run(path) as run:
            assert run.message_count == part["message_count"]
            assert run.start_ns == part["starting_time"]["nanoseconds_since_epoch"]
            assert run.end_ns - run.start_ns == part["duration"]["nanoseconds"]
            assert run.attachments() == {"config.yaml": CONFIG}
            assert run.provenance["seed"] == "7"
    with AnyReader([writer.directory]) as reader:
        assert sum(1 for _ in reader.messages()) == len(sent)


def test_no_message_is_added_to_a_full_file(record):
    """A file of exactly the maximum size is full as well; here the size of the complete files is known beforehand."""
    alone = record("run1", max_file_bytes=10**9, chunk_bytes=20_000)
    alone.add_topic(SCAN_TOPIC)
    for number in range(40):
        alone.write(SCAN_TOPIC.name, scan_block(number), 0, number + 1)
    full, _ = alone.bytes_written, alone.finish()
    writer = record("run2", max_file_bytes=full, chunk_bytes=20_000)
    writer.add_topic(SCAN_TOPIC)
    ended_at = []
    for number in range(100):
        before, size = len(writer.files), writer.files[-1].stat().st_size
        writer.write(SCAN_TOPIC.name, scan_block(number), 0, number + 1)
        assert len(writer.files) - before == (size >= full), f"block {number}"
        ended_at += [size] if size >= full else []
    assert ended_at[0] == full
    assert len(ended_at) > 1
    writer.finish()


def test_a_file_is_split_by_rig_time(record):
    with record(max_file_duration_ns=100_000_000) as writer:
        fill(writer, 50)
    per_file = [stamps(path) for path in writer.files]
    assert len(per_file) == 5
    assert all(times[-1] - times[0] <= 100_000_000 for times in per_file)
    assert list(itertools.chain(*per_file)) == stamps(writer.directory)


@pytest.mark.heavy
def test_many_parts_are_read_in_the_order_they_were_written(record):
    with record(max_file_duration_ns=1) as writer:
        sent = fill(writer, 12, topics=(SCAN_TOPIC,))
    assert len(writer.files) == 12
    with open_run(writer.directory) as run:
        assert [m.sequence for m in run.messages(recorded_order=True)] == [s.sequence for s in sent]


@pytest.mark.heavy
def test_a_missing_part_is_named(record):
    with record(max_file_duration_ns=100_000_000) as writer:
        fill(writer, 50)
    writer.files[1].unlink()
    with pytest.raises(RecordingError, match=r"lacks run_1.mcap, listed in its metadata.yaml"):
        open_run(writer.directory)


def test_a_chunk_is_on_disk_half_a_second_after_its_first_message(record, clock):
    writer = record()
    fill(writer, 1)
    before = writer.bytes_written
    clock.now_s += CHUNK_OPEN_S - 0.01
    writer.flush_due()
    assert writer.bytes_written == before
    clock.now_s += 0.01
    writer.flush_due()
    assert writer.files[0].stat().st_size == writer.bytes_written > before
    again = writer.bytes_written
    clock.now_s += 10
    writer.flush_due()  # nothing new: nothing written
    assert writer.bytes_written == again
    writer.finish()


def test_a_wall_clock_that_goes_back_does_not_keep_a_chunk_open(record, clock):
    writer = record()
    fill(writer, 1)
    before = writer.bytes_written
    clock.now_s -= 3600
    writer.flush_due()
    assert writer.bytes_written > before
    writer.finish()


LIMITED = """
    import resource, signal, sys
    from pathlib import Path
    sys.path.insert(0, {tests!r})
    from kits.recording import *
    from impact_rig.errors import RecordingError

    def writer(directory):
        return RunWriter(directory, provenance=PROVENANCE, clock=HandClock(), chunk_bytes=20_000, compression="none")

    earlier = Path({directory!r}) / "earlier"
    with writer(earlier) as first:
        fill(first, 10)
    run = writer(Path({directory!r}) / "run")
    fill(run, 5)
    {before}
    try:
        fill(run, 1000, first=5)
    except RecordingError as error:
        print(error)
    else:
        sys.exit("no error")
    assert run.closed
    try:
        run.write(SCAN_TOPIC.name, scan_block(0), 0)
    except RecordingError as error:
        print(error)
    run.finish()
"""


def run_limited(tmp_path, before):
    script = textwrap.dedent(LIMITED).format(
        tests=str(Path(__file__).parents[2]), directory=str(tmp_path), before=before
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    first, second = done.stdout.splitlines()
    assert first == second  # later calls repeat the reason
    assert len(stamps(tmp_path / "earlier")) == 10
    return first


def test_recording_stops_before_the_file_size_limit_and_is_finished(tmp_path):
    """RLIMIT_FSIZE is known beforehand: the run ends with its index, readable by every tool."""
    limit = "resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, resource.RLIM_INFINITY))"
    message = run_limited(tmp_path, limit)
    assert (
        "up to there: the next chunk does not fit into the file size limit of this process (RLIMIT_FSIZE, 300000 b"
        in message
    )
    kept = stamps(tmp_path / "run")
    assert 30 < len(kept) < 100
    assert (tmp_path / "run" / "run.mcap").stat().st_size <= 300_000
    with AnyReader([tmp_path / "run"]) as reader:
        assert [time for c, time, _ in reader.messages() if c.topic == "/rig/daq/scan"] == kept


def test_an_unexpected_write_error_leaves_complete_records(tmp_path):
    """The disk fills between two checks: the check finds room, and the system call fails."""
    limit = (
        "resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, resource.RLIM_INFINITY)); "
        "import impact_rig.recording.writer as m; m.McapFile.shortage = lambda self: ''"
    )
    message = run_limited(tmp_path, limit)
    assert "run.mcap: File too large; the file ends with its last complete record" in message
    with pytest.raises(RecordingError, match="or the copy is incomplete; impact-rig recover saves the intact chunks"):
        open_run(tmp_path / "run")
    report = recover(tmp_path / "run", tmp_path / "out")
    assert report.damage_count == 0
    assert len(stamps(tmp_path / "out")) > 30


def test_recording_stops_while_the_disk_still_has_room(record, monkeypatch):
    """The writer reads the free space after every chunk; the test raises the limit instead of filling a disk."""
    writer = record(chunk_bytes=20_000)
    fill(writer, 20)
    monkeypatch.setattr(recording_writer, "MIN_FREE_BYTES", 2**62)
    with pytest.raises(RecordingError, match=r"can be read up to there: only \d+ MB are free on its disk"):
        fill(writer, 100, first=20)
    assert writer.closed
    assert len(stamps(writer.directory)) > 20
    with pytest.raises(RecordingError, match=r"run2.mcap cannot be recorded: only"):
        record("run2")
    assert list((writer.directory.parent / "run2").iterdir()) == []


def test_messages_that_wait_for_the_first_scan_are_written_once_if_the_disk_fills(record, monkeypatch):
    """The end of the run writes them; if the disk fills meanwhile, the run ends a second time within that."""
    writer = record(chunk_bytes=20_000)
    writer.add_topic(NOTES_TOPIC)
    monkeypatch.setattr(recording_writer.McapFile, "shortage", lambda self: "the disk is full")
    for number in range(4):
        writer.write(NOTES_TOPIC.name, string("x" * 15_000), START_NS, number + 1)
    with pytest.raises(RecordingError, match="was ended and can be read up to there: the disk is full"):
        writer.finish()
    with open_run(writer.directory) as run:
        assert [message.sequence for message in run.messages()] == [1, 2]


def test_a_file_that_cannot_even_begin_is_removed_and_nothing_is_said_of_its_content(record, monkeypatch):
    def fails(fd: int, data: memoryview) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(recording_writer, "_write_all", fails)
    with pytest.raises(RecordingError, match=r"cannot write .*\.mcap: No space left on device$"):
        record()


def test_the_message_at_which_a_recording_stops_is_accounted_for(record, monkeypatch):
    """The account must contain the last message; otherwise, `info` says that a message is in the file twice."""
    writer = record(chunk_bytes=20_000)
    writer.add_topic(SCAN_TOPIC)
    monkeypatch.setattr(recording_writer, "MIN_FREE_BYTES", 2**62)
    with pytest.raises(RecordingError, match="was ended and can be read"):
        fill(writer, 100, topics=(SCAN_TOPIC,))
    assert info(writer.directory).verdict.startswith("whole: ")


def test_a_part_that_cannot_be_opened_leaves_the_earlier_ones_a_readable_run(record):
    writer = record(max_file_duration_ns=100_000_000)
    fill(writer, 5)
    (writer.directory / "run_1.mcap").write_bytes(b"mine")
    with pytest.raises(RecordingError, match=r"run_1.mcap exists already and is not overwritten"):
        fill(writer, 20, first=5)
    assert (writer.directory / "run_1.mcap").read_bytes() == b"mine"
    assert len(stamps(writer.directory / "run_0.mcap")) == 11
    info = yaml.safe_load((writer.directory / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert info["relative_file_paths"] == ["run_0.mcap"]
