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
"""Small real run: every kind of message of the rig, as CDR bytes, without a ROS graph."""

from __future__ import annotations

import json
import struct
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import attrs
import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from impact_rig import codec
from impact_rig.blocks import APPLIED, Table
from impact_rig.instruments.section import SCAN
from impact_rig.recording import Attachment, OfferedQos, Provenance, RunWriter, TopicDescription

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
RATE_HZ = 10_000
BLOCK_SCANS = 100
START_NS = 1_700_000_000_123_456_789
PROVENANCE = Provenance(version="1.2.3", seed=7, wall_start_ns=START_NS, extra={"mode": "realtime"})
CONFIG = b"rig:\n  ros__parameters:\n    daq:\n      rate_hz: 10000\n"


class HandClock:
    """Wall time that advances only on request."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def record(tmp_path: Path, clock: HandClock) -> Callable[..., RunWriter]:
    """Start a recording in a directory below `tmp_path`."""

    def start(name: str = "run", **options: object) -> RunWriter:
        defaults: dict[str, object] = {
            "provenance": PROVENANCE,
            "clock": clock,
            "attachments": (Attachment("config.yaml", CONFIG, "application/yaml"),),
        }
        return RunWriter(tmp_path / name, **(defaults | options))  # type: ignore[arg-type]  # options of any test

    return start


def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash that the installed interface states about itself."""
    package, _, kind = type_name.split("/")
    description = json.loads((Path(sys.prefix) / "share" / package / "msg" / f"{kind}.json").read_text())
    return next(entry["hash_string"] for entry in description["type_hashes"] if entry["type_name"] == type_name)


def topic(name: str, type_name: str, *qos: OfferedQos) -> TopicDescription:
    return TopicDescription(
        name=name, type_name=type_name, type_hash=type_hash(type_name), offered_qos=qos or (OfferedQos(),)
    )


SCAN_TOPIC = topic("/rig/daq/scan", POINT_CLOUD, OfferedQos(history="keep_last", depth=100))
APPLIED_TOPIC = topic("/rig/shaker/applied", POINT_CLOUD)
NOTES_TOPIC = topic("/rig/notes", "std_msgs/msg/String")
FREQUENCY_TOPIC = topic("/rig/shaker/frequency", "std_msgs/msg/Float64")
ACK_TOPIC = topic("/rig/daq/ack", "std_msgs/msg/Header", OfferedQos(durability="transient_local", depth=1))
ALL_TOPICS = (SCAN_TOPIC, APPLIED_TOPIC, NOTES_TOPIC, FREQUENCY_TOPIC, ACK_TOPIC)


def scan_block(number: int, *, scans: int = BLOCK_SCANS, start_ns: int = START_NS, seed: int = 0) -> bytes:
    """Return the CDR bytes of block `number`: quantised noise, like that of a converter."""
    rng = np.random.default_rng((seed, number))
    rows = np.zeros(scans, SCAN)
    rows["time"] = np.arange(scans) / RATE_HZ
    for channel in ("accelerometer", "laser", "base", "current"):
        rows[channel] = np.round(rng.normal(0, 5, scans)) * 2.0**-15
    return codec.encode(Table(start_ns + number * scans * 10**9 // RATE_HZ, rows))


def applied_row(stamp_ns: int, frequency: float) -> bytes:
    rows = np.zeros(1, APPLIED)
    rows["frequency"] = frequency
    return codec.encode(Table(stamp_ns, rows))


def string(text: str) -> bytes:
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(data)) + data


def float64(value: float) -> bytes:
    return b"\0\1\0\0" + struct.pack("<d", value)


def header(stamp_ns: int, frame_id: str) -> bytes:
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    data = frame_id.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<iII", seconds, nanoseconds, len(data)) + data


@attrs.frozen
class Sent:
    """Message as passed to the writer, and the log time that it must get."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int
    sequence: int


def fill(
    writer: RunWriter, blocks: int, *, first: int = 0, topics: tuple[TopicDescription, ...] = ALL_TOPICS
) -> list[Sent]:
    """Record `blocks` blocks and the messages between them; return what was sent, in order."""
    for known in topics:
        writer.add_topic(known)
    sent: list[Sent] = []
    counts = Counter[str]()

    def send(where: TopicDescription, data: bytes, log_time: int) -> None:
        publish_time = START_NS + len(sent) * 1000 + first
        counts[where.name] += 1
        writer.write(where.name, data, publish_time, counts[where.name])
        sent.append(Sent(where.name, data, log_time, publish_time, counts[where.name]))

    for number in range(first, first + blocks):
        stamp = START_NS + number * 10_000_000
        last = stamp + 9_900_000
        send(SCAN_TOPIC, scan_block(number), stamp)
        if APPLIED_TOPIC in topics and number % 5 == 0:
            send(APPLIED_TOPIC, applied_row(stamp + 5_000_000, 9.1), last)
            send(FREQUENCY_TOPIC, float64(9.1), last)
            send(NOTES_TOPIC, string(f"gap {number} mm"), last)
            send(ACK_TOPIC, header(last, "analysis"), last)
    return sent


def foreign_file(path, *, chunked=True, crc=True):
    """Write a file as another writer would."""
    writer = Writer(str(path), compression=CompressionType.NONE, use_chunking=chunked, enable_crcs=crc)
    writer.start("ros2")
    schema = writer.register_schema(POINT_CLOUD, "ros2msg", SCAN_TOPIC.schema.encode())
    channel = writer.register_channel("/daq/scan", "cdr", schema)
    for number in range(3):
        writer.add_message(channel, number, scan_block(number), number)
    writer.finish()
