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
"""Round trip through a file: bytes, times, sequence numbers, order, attachments."""

from __future__ import annotations

import threading

import attrs
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kits.recording import (
    ALL_TOPICS,
    CONFIG,
    NOTES_TOPIC,
    PROVENANCE,
    SCAN_TOPIC,
    START_NS,
    HandClock,
    fill,
    scan_block,
    string,
    topic,
)
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from impact_rig import codec
from impact_rig.errors import RecordingError
from impact_rig.recording import Attachment, RunWriter, open_run
from impact_rig.recording.description import INFINITE_NS
from impact_rig.recording.records import MESSAGE_HEAD


def as_sent(message):
    return (message.topic, bytes(message.data), message.log_time, message.publish_time, message.sequence)


def as_tuple(sent):
    return (sent.topic, sent.data, sent.log_time, sent.publish_time, sent.sequence)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_every_message_is_read_back_as_sent(record, compression):
    with record(compression=compression, chunk_bytes=40_000) as writer:
        sent = fill(writer, 50)
    with open_run(writer.directory) as run:
        assert [as_sent(m) for m in run.messages(recorded_order=True)] == [as_tuple(s) for s in sent]
        assert run.message_count == len(sent)
        assert {name: found.count for name, found in run.topics.items()} == {
            known.name: sum(s.topic == known.name for s in sent) for known in ALL_TOPICS
        }
        assert [found.topic for found in run.topics.values()] == [
            attrs.evolve(known, offered_qos=(), offered_qos_text=known.offered_qos_text) for known in ALL_TOPICS
        ]


def test_a_chunk_ends_with_the_message_that_fills_it_including_definitions(record):
    most, data = 4000, string("a" * 80)
    with record(compression="none", chunk_bytes=most) as writer:
        for name in ("notes", "remarks"):
            writer.add_topic(topic(name, "std_msgs/msg/String"))
        for number in range(200):
            writer.write("notes", data, number)
    with writer.files[0].open("rb") as file:
        sizes = [
            one.uncompressed_size for one in StreamReader(file, emit_chunks=True).records if isinstance(one, Chunk)
        ]
    message = MESSAGE_HEAD.size + len(data)
    assert len(sizes) > 4
    assert all(most < size <= most + message for size in sizes[:-1])
    assert sizes[0] % message != sizes[1] % message == 0, "the first one defines the topics"


def test_times_are_clamped_to_the_range_of_rosbag2(record):
    """Times of rosbag2 are signed, those of MCAP are not."""
    with record() as writer:
        writer.add_topic(NOTES_TOPIC)
        for publish_time in (-1, 0, INFINITE_NS, INFINITE_NS + 1):
            writer.write(NOTES_TOPIC.name, string("a"), publish_time)
    with open_run(writer.directory) as run:
        times = [(m.log_time, m.publish_time) for m in run.messages(recorded_order=True)]
    assert times == [(time, time) for time in (0, 0, INFINITE_NS, INFINITE_NS)]


def test_messages_are_ordered_by_log_time_and_then_by_arrival(record):
    with record(chunk_bytes=20_000) as writer:
        sent = fill(writer, 50)
    in_order = sorted(range(len(sent)), key=lambda i: (sent[i].log_time, i))
    with open_run(writer.directory) as run:
        assert [as_sent(m) for m in run.messages()] == [as_tuple(sent[i]) for i in in_order]


@pytest.mark.parametrize("chunk_bytes", [2_000, 20_000])
def test_closing_a_run_ends_iterations_over_it(record, chunk_bytes):
    """An iteration that was interrupted by an exception may live on in its traceback."""
    with record(chunk_bytes=chunk_bytes) as writer:
        fill(writer, 50)
    with open_run(writer.directory) as run:
        messages = run.messages()
        next(messages)
    assert [thread.name for thread in threading.enumerate() if thread.name.startswith("read-ahead")] == []
    with pytest.raises(RecordingError, match=r"cannot read .* at byte \d+: the run has been closed"):
        list(messages)


def test_topics_and_times_can_be_selected(record):
    with record(chunk_bytes=20_000) as writer:
        sent = fill(writer, 50)
    begin, end = START_NS + 109_900_000, START_NS + 309_900_000  # two instants with a message
    with open_run(writer.directory) as run:
        got = [as_sent(m) for m in run.messages(["notes", "/rig/daq/ack"], start_ns=begin, end_ns=end)]
    wanted = [s for s in sent if s.topic in {"/rig/notes", "/rig/daq/ack"} and begin <= s.log_time < end]
    assert got == [as_tuple(s) for s in wanted]
    assert len(got) == 8


def test_tables_are_decoded(record):
    with record() as writer:
        fill(writer, 20)
    with open_run(writer.directory) as run:
        tables = list(run.tables("daq/scan"))
        with pytest.raises(RecordingError, match="carries std_msgs/msg/String, not tables"):
            run.tables("notes")
    assert [table.stamp_ns for table in tables] == [START_NS + i * 10_000_000 for i in range(20)]
    np.testing.assert_array_equal(tables[3].rows, codec.decode(scan_block(3)).rows)


def test_attachments_and_provenance_are_read_back(record):
    with record() as writer:
        fill(writer, 5)
        writer.attach(Attachment("calibration.yaml", b"laser: 1\n"))
        fill(writer, 5, first=5)
    with open_run(writer.directory) as run:
        assert run.attachments() == {"config.yaml": CONFIG, "calibration.yaml": b"laser: 1\n"}
        assert run.provenance == PROVENANCE.to_record()


def test_a_topic_appearing_late_is_recorded_from_then_on(record):
    late = topic("/rig/late", "std_msgs/msg/String")
    with record(chunk_bytes=20_000) as writer:
        fill(writer, 30)
        writer.add_topic(late)
        writer.write(late.name, string("here"), 5)
        fill(writer, 30, first=30)
    with open_run(writer.directory) as run:
        (message,) = run.messages(["late"])
        assert bytes(message.data) == string("here")
        assert message.log_time == START_NS + 29 * 10_000_000 + 9_900_000


def test_a_publisher_may_restart_but_not_change_the_type(record):
    with record() as writer:
        fill(writer, 3)
        writer.add_topic(SCAN_TOPIC)
        with pytest.raises(RecordingError, match="is recorded with the type sensor_msgs/msg/PointCloud2: messages"):
            writer.add_topic(topic(SCAN_TOPIC.name, "std_msgs/msg/String"))
        assert not writer.closed
        sent = fill(writer, 3, first=3)
    with open_run(writer.directory) as run:
        assert len(list(run.messages(["daq/scan"]))) == 6
        assert as_sent(list(run.messages(recorded_order=True))[-1]) == as_tuple(sent[-1])


def test_a_clock_that_jumps_back_loses_nothing(record, clock):
    with record(chunk_bytes=20_000) as writer:
        first = fill(writer, 20, first=1000)
        clock.now_s -= 50.0
        second = fill(writer, 20)  # stamps ten seconds earlier
    with open_run(writer.directory) as run:
        messages = list(run.messages())
        assert [as_sent(m)[:2] for m in messages] == [as_tuple(s)[:2] for s in first + second], "as they came"
        assert [m.log_time for m in messages[: len(first)]] == [s.log_time for s in first]
        later = [m.log_time - s.log_time for m, s in zip(messages[len(first) :], second, strict=True)]
        assert len(set(later)) == 1, "at the rate of its stamps"
        assert messages[len(first)].log_time == first[-1].log_time + 9_900_000, "where it was"


def test_an_empty_run_can_be_opened(record):
    with record() as writer:
        pass
    with open_run(writer.directory) as run:
        assert list(run.messages()) == []
        assert (run.message_count, run.start_ns, run.end_ns) == (0, 0, 0)


def test_an_unknown_topic_is_rejected_with_a_list_of_the_known_ones(record):
    with record() as writer:
        fill(writer, 2)
    with open_run(writer.directory) as run, pytest.raises(RecordingError, match=r"no topic 'scans'.*/rig/daq/scan"):
        run.messages(["scans"])


NAMES = st.text("abcdefghij_", min_size=1, max_size=12).map(lambda name: f"/{name}")
MESSAGES = st.lists(
    st.tuples(
        st.integers(0, 4),
        st.binary(max_size=300),
        st.integers(0, 2**63 - 1),
        st.integers(0, 2**63 - 1),
        st.integers(0, 2**32 - 1),
    ),
    max_size=60,
)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    names=st.lists(NAMES, min_size=5, max_size=5, unique=True),
    messages=MESSAGES,
    compression=st.sampled_from(["none", "lz4", "zstd"]),
    chunk_bytes=st.sampled_from([1, 200, 100_000]),
    max_file_bytes=st.sampled_from([0, 1, 20_000]),
)
@pytest.mark.repeats
def test_any_bytes_at_any_time_are_read_back(
    tmp_path_factory, names, messages, compression, chunk_bytes, max_file_bytes
):
    directory = tmp_path_factory.mktemp("any") / "run"
    with RunWriter(
        directory,
        provenance=None,
        clock=HandClock(),
        compression=compression,
        chunk_bytes=chunk_bytes,
        max_file_bytes=max_file_bytes,
    ) as writer:
        for name in names:
            writer.add_topic(topic(name, NOTES_TOPIC.type_name))
        for index, data, log_time, publish_time, sequence in messages:
            writer.write_at(names[index], data, log_time, publish_time, sequence)
    with open_run(directory) as run:
        sent = [(names[i], *rest) for i, *rest in messages]
        assert [as_sent(m) for m in run.messages(recorded_order=True)] == sent
        assert [as_sent(m) for m in run.messages()] == sorted(sent, key=lambda message: message[2])
