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
"""Output of `info` about a run, and the rule by which blocks are contiguous."""

from __future__ import annotations

import json
import shutil

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kits.recording import (
    APPLIED_TOPIC,
    CONFIG,
    NOTES_TOPIC,
    POINT_CLOUD,
    PROVENANCE,
    RATE_HZ,
    SCAN_TOPIC,
    START_NS,
    applied_row,
    fill,
    scan_block,
    string,
    topic,
)
from kits.records import info_rows

from impact_rig import codec
from impact_rig.blocks import Table
from impact_rig.errors import RecordingError
from impact_rig.instruments.section import SCAN
from impact_rig.recording import Account, RunWriter, losses, open_run
from impact_rig.runs import check_contiguity, info, recover
from impact_rig.simtime import stamp_ns


def test_the_figures_of_a_complete_run_are_reported(record):
    with record(chunk_bytes=20_000) as writer:
        sent = fill(writer, 50)
    found = info(writer.directory)
    assert found.intact
    assert found.verdict == (
        "whole: every checksum fits, 50 blocks of daq/scan without a gap, no message lost on any topic"
    )
    assert found.messages == len(sent)
    assert found.rate_hz == RATE_HZ
    assert found.duration_s == pytest.approx(0.5)
    assert found.files == (("run.mcap", writer.files[0].stat().st_size),)
    assert found.bytes == writer.bytes_written
    assert found.provenance == PROVENANCE.to_record()
    assert found.configuration == CONFIG.decode()
    assert found.attachments == {"config.yaml": len(CONFIG)}
    scans, applied = found.topics[:2]
    assert (scans.name, scans.type_name, scans.count) == (SCAN_TOPIC.name, SCAN_TOPIC.type_name, 50)
    assert scans.rate_hz == pytest.approx(100.0)
    assert (scans.first_ns, scans.last_ns) == (START_NS, START_NS + 490_000_000)
    assert scans.bytes == sum(len(s.data) for s in sent if s.topic == SCAN_TOPIC.name)
    assert (applied.name, applied.rate_hz) == (APPLIED_TOPIC.name, pytest.approx(20.0))


def test_missing_blocks_are_counted(record):
    with record() as writer:
        fill(writer, 10)
        fill(writer, 10, first=13)
        fill(writer, 10, first=24)
    found = info(writer.directory)
    assert not found.intact
    assert found.verdict == ("every checksum fits, but 2 gaps in daq/scan; 4 blocks (400 scans) are missing")
    assert [(gap.block, gap.missing_scans) for gap in found.scans.gaps] == [(10, 300), (20, 100)]


def test_a_reset_is_distinguished_from_lost_blocks(record):
    with record() as writer:
        fill(writer, 10)
        fill(writer, 10)
    found = info(writer.directory)
    assert (found.scans.lost_blocks, found.scans.restarts) == (0, 1)
    assert "the stamps go back 1 times" in found.verdict


@pytest.mark.parametrize("recorded_late", [0, 3])
def test_the_durations_before_and_after_a_restart_are_added(record, recorded_late):
    """The stamps of a rig that does not run in real time begin at 0 after each start."""
    with record() as writer:
        fill(writer, 10, first=recorded_late)
        fill(writer, 4, topics=(SCAN_TOPIC,))
        writer.write(SCAN_TOPIC.name, scan_block(4, scans=50), 0)
    found = info(writer.directory)
    assert (found.rig_s, found.last_block_s) == pytest.approx((0.145, 0.005))


def test_a_run_without_scans_is_reported(record):
    with record() as writer:
        writer.add_topic(NOTES_TOPIC)
        writer.write(NOTES_TOPIC.name, string("alone"), 17)
    found = info(writer.directory)
    assert found.intact
    assert found.verdict == "whole: every checksum fits, there is no daq/scan, no message lost on any topic"
    assert (found.rate_hz, found.scans, found.topics[0].rate_hz) == (None, None, None)
    assert found.start_ns == 17  # nothing else is known: the publish time


def test_a_run_with_a_calibration_but_without_scans_is_reported(record):
    info_topic = topic("/rig/daq/info", POINT_CLOUD)
    with record() as writer:
        writer.add_topic(info_topic)
        writer.write(info_topic.name, codec.encode(Table(17, info_rows(RATE_HZ))), 17)
    found = info(writer.directory)
    assert (found.rate_hz, found.duration_s, found.last_block_s) == (RATE_HZ, 0.0, 0.0)


def test_messages_before_the_first_scan_have_its_log_time(record):
    with record() as writer:
        writer.add_topic(APPLIED_TOPIC)
        writer.write(APPLIED_TOPIC.name, applied_row(5, 9.1), 5)  # latched, of long before
        writer.add_topic(NOTES_TOPIC)
        writer.write(NOTES_TOPIC.name, string("before the first scan"), START_NS)
        fill(writer, 3)
    with open_run(writer.directory) as run:
        times = [m.log_time for m in run.messages()]
        assert times[:3] == [START_NS] * 3
        assert [m.log_time for m in run.messages(["notes"])] == [START_NS, START_NS + 9_900_000]
        assert run.start_ns == START_NS
        assert next(run.tables("shaker/applied")).stamp_ns == 5, "its stamp is its own"


def test_messages_too_short_for_a_header_are_kept(record):
    with record() as writer:
        fill(writer, 3)
        writer.write(SCAN_TOPIC.name, b"\0\1", 5)
        writer.write(APPLIED_TOPIC.name, b"", -5)
    with open_run(writer.directory) as run:
        last = list(run.messages(["shaker/applied"]))[-1]
    assert (bytes(last.data), last.log_time, last.publish_time) == (b"", START_NS + 29_900_000, 0)
    assert "is not a valid table" in info(writer.directory).verdict


def test_a_damaged_chunk_decides_the_verdict(record, tmp_path):
    with record(chunk_bytes=20_000) as writer:
        fill(writer, 50)
    with open_run(writer.directory) as run:
        index = run.sources[0].summary.chunk_indexes[3]
    data = bytearray(writer.files[0].read_bytes())
    data[index.chunk_start_offset + 100] ^= 1
    writer.files[0].write_bytes(data)
    found = info(writer.directory)
    assert not found.intact
    assert f"the chunk at byte {index.chunk_start_offset} is damaged" in found.verdict
    assert 0 < found.messages < 50
    assert recover(writer.directory, tmp_path / "out").messages > found.messages


def test_an_unfinished_run_is_reported_with_advice(record):
    writer = record()
    fill(writer, 5)
    with pytest.raises(RecordingError, match="impact-rig recover"):
        info(writer.directory)
    writer.finish()


@pytest.mark.parametrize("last_s", [np.nan, np.inf, 1e300])
def test_a_scan_with_an_impossible_time_is_kept(record, last_s):
    rows = np.zeros(2, SCAN)
    rows["time"][-1] = last_s
    with record() as writer:
        fill(writer, 1)
        writer.write(SCAN_TOPIC.name, codec.encode(Table(START_NS + 10_000_000, rows)), 2**70)
        writer.write(NOTES_TOPIC.name, string("after"), 1)
    with open_run(writer.directory) as run:
        assert run.message_count == 7
        assert all(0 <= m.log_time < 2**63 for m in run.messages())


RATES = st.sampled_from([10_000, 50_000, 25_600, 44_100, 100_003])


@given(rate=RATES, start=st.integers(0, 2**61), first=st.integers(0, 10**9), lengths=st.lists(st.integers(1, 999)))
def test_blocks_with_computed_stamps_are_contiguous(rate, start, first, lengths):
    """Stamps are `start_ns + i * 10**9 // rate_hz`, from any index on, whether or not the start is known."""
    blocks, index = [], first
    for length in lengths:
        blocks.append((stamp_ns(index, rate, start), length))
        index += length
    for known in (start, None):
        result = check_contiguity(blocks, rate, known)
        assert result.whole
        assert (result.blocks, result.scans, result.lost_blocks) == (len(lengths), sum(lengths), 0)


@given(
    rate=RATES,
    start=st.integers(0, 2**61),
    lengths=st.lists(st.integers(2, 999), min_size=3, max_size=20),
    data=st.data(),
)
def test_every_missing_scan_is_found(rate, start, lengths, data):
    at = data.draw(st.integers(1, len(lengths) - 1))
    missing = data.draw(st.integers(1, 5000))
    blocks, index = [], 0
    for number, length in enumerate(lengths):
        index += missing if number == at else 0
        blocks.append((stamp_ns(index, rate, start), length))
        index += length
    for known in (start, None):
        result = check_contiguity(blocks, rate, known)
        (gap,) = result.gaps
        assert (gap.block, gap.missing_scans, result.lost_scans) == (at, missing, missing)
        assert result.lost_blocks == -(-missing // lengths[at - 1])


@pytest.mark.parametrize("known", [START_NS, None], ids=["start known", "start unknown"])
def test_a_stamp_off_the_grid_is_a_gap(known):
    blocks = [(START_NS, 100), (START_NS + 10_000_000, 100), (START_NS + 20_000_001, 100)]
    (gap,) = check_contiguity(blocks, RATE_HZ, known).gaps
    assert (gap.expected_ns, gap.stamp_ns, gap.missing_scans) == (START_NS + 20_000_000, START_NS + 20_000_001, 0)


@pytest.mark.parametrize("missed", [0, 1, 7])
def test_the_time_between_two_rigs_does_not_count_as_missing(missed):
    """The time between the death of a rig and scan 0 of the next must not count as missing blocks."""
    again = START_NS + 7_740_000_123
    blocks = [(START_NS, 100), (START_NS + 10_000_000, 100), (again + missed * 10_000_000, 100)]
    for known in (START_NS, None):
        result = check_contiguity(blocks, RATE_HZ, known, starts=[START_NS, again])
        assert (result.lost_blocks, len(result.gaps)) == (missed, bool(missed))


def test_a_repeated_block_does_not_count_as_lost():
    blocks = [(START_NS, 100), (START_NS + 10_000_000, 100), (START_NS + 10_000_000, 100), (START_NS + 20_000_000, 100)]
    result = check_contiguity(blocks, RATE_HZ, START_NS)
    assert (result.lost_blocks, result.restarts) == (0, 1)
    assert not result.whole


def test_a_record_without_any_block_is_complete():
    assert check_contiguity([], RATE_HZ).whole


def test_a_block_with_a_single_scan_has_no_rate(record):
    with record() as writer:
        writer.add_topic(SCAN_TOPIC)
        writer.write(SCAN_TOPIC.name, scan_block(0, scans=1), 0, 1)
    found = info(writer.directory)
    assert found.rate_hz is None
    assert "1 blocks of daq/scan of an unknown rate" in found.verdict


def rewritten(run, out, change):
    """Return a copy of a run whose messages have passed through `change`, with its own metadata unchanged."""
    with open_run(run) as opened:
        account = losses.read_record(opened.record(losses.RECORD_NAME))
        record = {name: json.dumps([attrs.asdict(one) for one in found]) for name, found in account.items()}
        with RunWriter(
            out, provenance=PROVENANCE, clock=lambda: 0.0, closing=lambda: {losses.RECORD_NAME: record}
        ) as writer:
            for recorded in opened.topics.values():
                writer.add_topic(recorded.topic)
            for one in change(list(opened.messages(recorded_order=True))):
                writer.write_at(one.topic, bytes(one.data), one.log_time, one.publish_time, one.sequence)
    return info(out)


@pytest.mark.parametrize("topic", ["/rig/notes", "/rig/daq/scan"])
def test_a_removed_message_with_a_doubled_neighbour_is_found_by_sequence_numbers(record, tmp_path, topic):
    """The number of messages is that of the received ones, but they are not the same messages."""
    with record() as writer:
        fill(writer, 30)

    def double(messages):
        places = [place for place, one in enumerate(messages) if one.topic == topic]
        messages[places[2]] = messages[places[1]]
        return messages

    assert rewritten(writer.directory, tmp_path / "same", lambda messages: messages).verdict.startswith("whole: ")
    found = rewritten(writer.directory, tmp_path / "out", double)
    assert not found.intact
    assert f"messages that the recorder received are not in the files: 1 of {topic}" in found.verdict
    assert f"messages are in the files twice: 1 of {topic}" in found.verdict


def test_overlapping_numbers_of_several_publishers_are_not_repeated_messages(record):
    publishers = {"a": "one", "b": "other"}
    with record(account=Account(lambda _: publishers)) as writer:
        writer.add_topic(NOTES_TOPIC)
        for number in range(1, 9):
            writer.write(NOTES_TOPIC.name, string("x"), number, number)
            if number > 3:
                writer.write(NOTES_TOPIC.name, string("y"), number, number - 3 + 100)
    assert info(writer.directory).verdict.startswith("whole: ")


def test_a_run_whose_account_omits_a_topic_is_not_called_complete(record, tmp_path):
    with record() as writer:
        fill(writer, 5)
    with open_run(writer.directory) as run:
        account = losses.read_record(run.record(losses.RECORD_NAME))
    one = {SCAN_TOPIC.name: json.dumps([attrs.asdict(stream) for stream in account[SCAN_TOPIC.name]])}
    with (
        open_run(writer.directory) as run,
        RunWriter(
            tmp_path / "out", provenance=PROVENANCE, clock=lambda: 0.0, closing=lambda: {losses.RECORD_NAME: one}
        ) as other,
    ):
        for recorded in run.topics.values():
            other.add_topic(recorded.topic)
        for message in run.messages(recorded_order=True):
            other.write_at(message.topic, bytes(message.data), message.log_time, message.publish_time, message.sequence)
    found = info(tmp_path / "out")
    assert not found.intact
    assert "without an account by the recorder: " in found.verdict
    assert NOTES_TOPIC.name in found.verdict


@pytest.mark.parametrize("times", [np.array([b"a", b"b"], "S32"), np.array([0.0, 5e-324])])
def test_invalid_times_yield_no_rate(record, times):
    """Texts for times, or times that are too close for numbers, must not raise a ValueError in recording or reading."""
    rows = np.zeros(2, [("time", times.dtype), ("laser", "f4")])
    rows["time"] = times
    with record() as writer:
        writer.add_topic(SCAN_TOPIC)
        writer.write(SCAN_TOPIC.name, codec.encode(Table(START_NS, rows)), 1, 1)
    found = info(writer.directory)
    assert (found.rate_hz, found.messages) == (None, 1)
    assert recover(writer.directory, writer.directory.with_name("out")).messages == 1


def test_blocks_of_two_rigs_in_one_recording_are_checked_separately(record):
    """The blocks of the rigs alternate: every second one would be a gap at which the stamps go back."""

    def judged(name, missing):
        with record(name) as writer:
            for namespace in ("a", "b"):
                writer.add_topic(attrs.evolve(SCAN_TOPIC, name=f"/{namespace}/daq/scan"))
            for number in range(20):
                writer.write("/a/daq/scan", scan_block(number), number, number + 1)
                if number not in missing:
                    writer.write("/b/daq/scan", scan_block(number, start_ns=START_NS - 5 * 10**9), number, 0)
        return info(writer.directory)

    assert judged("whole", []).verdict.startswith("whole: every checksum fits, 40 blocks of daq/scan without a gap")
    found = judged("short", [7, 8])
    assert (found.scans.lost_blocks, found.scans.lost_scans, found.scans.restarts) == (2, 200, 0)
    assert "1 gaps in daq/scan; 2 blocks (200 scans) are missing" in found.verdict


def test_blocks_with_a_single_scan_are_checked_too(record):
    """Their times give no rate; the calibration or the stamps do."""

    def blocks(directory, numbers, calibration):
        with record(directory) as writer:
            writer.add_topic(SCAN_TOPIC)
            if calibration:
                writer.add_topic(attrs.evolve(SCAN_TOPIC, name="/rig/daq/info"))
                writer.write("/rig/daq/info", codec.encode(Table(START_NS, info_rows(RATE_HZ))), 1, 1)
            for number in numbers:
                writer.write(SCAN_TOPIC.name, scan_block(number, scans=1), number, number + 1)
        return info(writer.directory)

    withheld = [*range(40), *range(60, 100)]
    for calibration in (True, False):
        assert blocks(f"whole{calibration}", range(100), calibration).verdict.startswith("whole: ")
        found = blocks(f"short{calibration}", withheld, calibration)
        assert (found.rate_hz, found.scans.lost_scans, found.intact) == (RATE_HZ, 20, False)
        assert "20 blocks (20 scans) are missing" in found.verdict


def test_a_split_run_without_its_last_file_is_not_complete(record):
    with record(max_file_bytes=40_000, chunk_bytes=20_000) as writer:
        fill(writer, 60)
    assert len(writer.files) > 2
    assert info(writer.directory).verdict.startswith("whole: ")
    writer.files[-1].unlink()
    (writer.directory / "metadata.yaml").unlink()
    found = info(writer.directory)
    assert not found.intact
    last = writer.files[-2].name
    assert f"{last} is not the last file of its run: {writer.files[-1].name} is missing" in found.verdict
    assert "metadata.yaml, which a finished run has, is missing" in found.verdict


def test_a_run_being_written_is_distinguished_from_a_truncated_one(record, tmp_path):
    """The writer of a run holds a lock while it is alive; the advice for each case works."""
    writer = record(tail=True)
    sent = fill(writer, 5)
    writer.secure()
    with pytest.raises(RecordingError, match="it is still being recorded: read it when the recording has ended"):
        info(writer.directory)
    assert recover(writer.directory, tmp_path / "copy").messages == len(sent)
    shutil.copytree(writer.directory, tmp_path / "cut")
    with pytest.raises(RecordingError, match="or the copy is incomplete; impact-rig recover saves"):
        info(tmp_path / "cut")
    writer.finish()
    assert info(writer.directory).intact
