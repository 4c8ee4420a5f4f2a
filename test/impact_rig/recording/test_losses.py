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
"""The recorder's account: missing messages are found by topic and publisher, and nothing else counts as a loss."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kits.recording import APPLIED_TOPIC, NOTES_TOPIC, SCAN_TOPIC, fill, scan_block, string

from impact_rig.cli import main
from impact_rig.recording import Account, Attachment, open_run
from impact_rig.recording.losses import MAX_STREAMS, RECORD_NAME, read_record
from impact_rig.runs import info

TOPIC = "/rig/shaker/applied"


@given(
    lengths=st.lists(st.integers(1, 40), min_size=1, max_size=5),
    starts=st.lists(st.integers(1, 10**6), min_size=5, max_size=5),
    order=st.randoms(use_true_random=False),
)
def test_interleaved_messages_of_several_publishers_are_not_counted_as_lost(lengths, starts, order):
    """This holds for any publisher, any start of its counting, and any order of arrival."""
    waiting = [list(range(start, start + length)) for start, length in zip(starts, lengths, strict=False)]
    account = Account(lambda _: {str(number): f"/node{number}" for number in range(len(lengths))})
    while any(waiting):
        account.take(TOPIC, order.choice([numbers for numbers in waiting if numbers]).pop(0))
    assert account.lost() == {}
    assert sum(stream.received for stream in read_record(account.to_record())[TOPIC]) == sum(lengths)


@given(kept=st.sets(st.integers(1, 200), min_size=1))
def test_every_missing_message_of_a_publisher_is_counted(kept):
    account = Account(lambda _: {"a": "/rig/rig"})
    for sequence in sorted(kept):
        account.take(TOPIC, sequence)
    missing = max(kept) - min(kept) + 1 - len(kept)
    assert account.lost() == ({TOPIC: missing} if missing else {})
    (stream,) = read_record(account.to_record())[TOPIC]
    assert (stream.publisher, stream.first, stream.newest) == ("/rig/rig", min(kept), max(kept))
    assert (stream.received, stream.lost) == (len(kept), missing)


def test_a_restarted_publisher_is_not_taken_for_a_loss():
    """A node that was restarted counts from 1 again, with another identifier in the graph."""
    present = {"first": "/rig/rig"}
    account = Account(lambda _: present)
    for sequence in range(10, 30):
        account.take(TOPIC, sequence)
    present = {"second": "/rig/rig"}
    for sequence in (1, 2, 3, 5):
        account.take(TOPIC, sequence)
    assert account.lost() == {TOPIC: 1}


def test_a_loss_is_found_however_many_publishers_there_were_before():
    """After streams have been dropped, a gap must still count as a loss, not as an unknown publisher."""
    present = {}
    account = Account(lambda _: present)
    for number in range(MAX_STREAMS + 6):
        present = {str(number): "/rig/rig"}
        for sequence in (1, 2, 3, 5):
            account.take(TOPIC, sequence)
    assert account.lost() == {TOPIC: MAX_STREAMS + 6}


def test_a_publisher_that_stays_keeps_its_account_while_others_come_and_go():
    """The rig publishes /diagnostics throughout; other nodes may restart a hundred times in one recording."""
    present = {"rig": "/rig/rig"}
    account = Account(lambda _: present)
    lasting = 1000
    for number in range(MAX_STREAMS + 6):
        account.take(TOPIC, lasting + number)
        present = {"rig": "/rig/rig", str(number): "/rig/analysis"}
        for sequence in (1, 2, 3):
            account.take(TOPIC, sequence)
    assert account.lost() == {}


def test_memory_is_bounded_for_any_number_of_publishers():
    account = Account()
    for _ in range(10 * MAX_STREAMS):
        account.take(TOPIC, 7)
        account.take(TOPIC, 5)
    streams = read_record(account.to_record())[TOPIC]
    assert len(streams) == MAX_STREAMS + 1
    assert sum(stream.received for stream in streams) == 20 * MAX_STREAMS


def test_a_run_that_lacks_messages_of_any_topic_is_not_called_complete(record, capsys):
    with record() as writer:
        fill(writer, 10)
        for sequence in (5, 9):
            writer.write(APPLIED_TOPIC.name, b"", 0, sequence)
    found = info(writer.directory)
    assert found.scans.whole
    assert found.lost == {APPLIED_TOPIC.name: 2 + 3}  # 1 and 2 were written by fill
    assert not found.intact
    assert found.verdict == (
        f"every checksum fits, but messages were lost on the way to the recorder: 5 of {APPLIED_TOPIC.name}"
    )
    assert main(["info", str(writer.directory)]) == 1
    assert APPLIED_TOPIC.name in " ".join(capsys.readouterr().out.split())


def test_a_recording_without_an_account_is_not_called_complete(record, capsys):
    """Nothing is known to be missing in a recording of another recorder, but nothing is proved either."""
    with record() as writer:
        writer.add_topic(SCAN_TOPIC)
        for number in range(3):
            writer.write_at(SCAN_TOPIC.name, scan_block(number), number, number)
    found = info(writer.directory)
    assert (found.accounted, found.intact) == (False, True)
    assert found.verdict == (
        "every checksum fits, 3 blocks of daq/scan without a gap; its recorder kept no account of lost messages"
    )
    assert main(["info", str(writer.directory)]) == 0


def test_the_account_covers_all_files_of_a_split_run(record):
    with record(max_file_bytes=20_000, chunk_bytes=5_000) as writer:
        fill(writer, 20)
        writer.write(SCAN_TOPIC.name, scan_block(20), 0, 22)
    assert len(writer.files) > 2
    found = info(writer.directory)
    assert found.lost == {SCAN_TOPIC.name: 1}
    assert not found.intact


def test_received_messages_that_are_not_in_the_file_are_reported_as_missing(record):
    account = Account()
    with record(account=account) as writer:
        fill(writer, 5)
        account.take(NOTES_TOPIC.name, 2)
    assert info(writer.directory).verdict.endswith(
        f"messages that the recorder received are not in the files: 1 of {NOTES_TOPIC.name}"
    )


@pytest.mark.parametrize("text", ["[{}]", "7", "[" * 10**5, '[{"publisher": 1, "first": 1, "newest": 1}]', '[["a"]]'])
def test_an_invalid_account_counts_as_damage(record, text):
    with record(closing=lambda: {RECORD_NAME: {"/a": text}}) as writer:
        fill(writer, 3)
    found = info(writer.directory)
    assert not found.intact
    assert "account of received and lost messages, is damaged" in found.verdict


def test_a_further_file_repeats_only_the_latest_attachments(record):
    """If 700 calibrations were repeated in every file, each file of a megabyte would be full at once."""
    with record(max_file_bytes=40_000, chunk_bytes=10_000) as writer:
        writer.add_topic(NOTES_TOPIC)
        for number in range(700):
            name = f"calibration_{number}.yaml" if number else "calibration.yaml"
            writer.attach(Attachment(name, f"number: {number}\n".encode()), instead_of="calibration.yaml")
        writer.supersede(Attachment("config.yaml", b"changed: 1\n"))
        for sequence in range(1, 4):
            writer.write(NOTES_TOPIC.name, string(str(sequence)), 1, sequence)
            if sequence == 1:
                writer.write(NOTES_TOPIC.name, string("x" * 60_000), 1, 0)
    assert len(writer.files) >= 2
    with open_run(writer.files[-1]) as part:
        assert part.attachments() == {"calibration_699.yaml": b"number: 699\n", "config.yaml": b"changed: 1\n"}
    with open_run(writer.directory) as run:
        found = run.attachments()
    assert len(found) == 701
    assert found["config.yaml"] != b"changed: 1\n", "of the run: the configuration it began with"
