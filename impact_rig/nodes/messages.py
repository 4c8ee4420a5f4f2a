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
"""Topics of the ROS graph in terms of rclpy: message classes, quality of service, stamps, and messages as bytes.

`TOPICS` lists all topics: the base table (`impact_rig.topics`), and the topics of instruments, analyses and plots.

A `Template` writes numbers directly into the bytes of a serialised message, which is much faster than serialising a
message object. The sequences and texts of the message must have constant lengths, so that every number has a constant
offset (OMG DDSI-RTPS 2.2, section 10: CDR is a fixed layout of fixed parts).
"""

from __future__ import annotations

import importlib
import struct
from typing import Any  # message classes have no common base

from builtin_interfaces.msg import Time
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

from impact_rig import codec, topics
from impact_rig.analysis.blockwise import ANALYSES
from impact_rig.instruments.registry import INSTRUMENTS
from impact_rig.simtime import NS_PER_S
from impact_rig.topics import Qos, Topic

_STAMP_FORM = "<4siI"  # encapsulation, seconds, nanoseconds
# a number that float32 and float64 represent exactly, and that no message here contains
_MARK = struct.unpack("<f", b"\x13\x57\x9b\x71")[0]

MONITORS = {name: instrument.monitor for name, instrument in INSTRUMENTS.items() if instrument.monitor is not None}
"""Monitor topics (readings of one instrument at a low rate), by channel name, for the instruments that have one."""

ENVELOPES = {name: topics.envelope(name, kind.unit) for name, kind in INSTRUMENTS.items()}
"""Topic of each channel's envelope for plotters (minimum, maximum and rms of 20 ms), by channel name."""
SPECTRA = {name: topics.spectrum(name, INSTRUMENTS[name].unit) for name in ("laser", "accelerometer")}
"""Topic of the amplitude spectrum for plotters, by channel name; only these two channels have one."""

_FOLLOWING = {
    topics.INFO: tuple(MONITORS.values()),
    topics.IMPACTS: tuple(analysis.topic for analysis in ANALYSES),
    topics.PLOT_PULSES: (*SPECTRA.values(), *ENVELOPES.values()),
}
"""Topics that `topics.COMMON` lacks, by the topic in `topics.COMMON` after which they are inserted into `TOPICS`."""

TOPICS: tuple[Topic, ...] = tuple(found for topic in topics.COMMON for found in (topic, *_FOLLOWING.get(topic, ())))
"""All topics that nodes of this package publish or read, in the order of docs/reference/interface.md."""


def by_name(name: str) -> Topic:
    """Return the topic of `TOPICS` with exactly this name, such as `daq/scan` or `/clock`.

    Raises:
        KeyError: no topic has this name.
    """
    return _BY_NAME[name]


_BY_NAME = {topic.name: topic for topic in TOPICS}


def class_of(topic: Topic) -> Any:
    """Return the Python class of a topic's messages.

    Raises:
        ImportError, AttributeError: the package of the message type is not installed, or lacks this type.
    """
    return message_class(topic.type_name)


def message_class(type_name: str) -> Any:
    """Import and return the class of a message type, `package/msg/Type`.

    Raises:
        ImportError, AttributeError: the package is not installed, or lacks this type.
        ValueError: `type_name` does not have three parts, or its package is not a name.
    """
    package, _, name = type_name.split("/")
    if not package.isidentifier():
        raise ValueError(
            f"{package!r} cannot be a package of message types: use letters, digits and _, and begin with no digit"
        )
    return getattr(importlib.import_module(f"{package}.msg"), name)


def profile(qos: Qos, depth: int | None = None) -> QoSProfile:
    """Return a new rclpy quality-of-service profile for `qos`.

    A `depth` that is not None or 0 replaces the queue length of `qos`. Each call returns a new object, because rclpy
    writes overrides into the profile.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth or qos.depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE,
    )


def time_message(ns: int) -> Time:
    """Return a time in nanoseconds as a `builtin_interfaces/Time` message."""
    seconds, nanoseconds = divmod(ns, NS_PER_S)
    return Time(sec=seconds, nanosec=nanoseconds)


def nanoseconds(stamp: Time) -> int:
    """Return the time of a `builtin_interfaces/Time` message in nanoseconds."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def header_stamp_ns(message: Any) -> int | None:
    """Return the stamp [ns] in the header of a message, or None for a message without a header.

    `message` may be a message object or its CDR bytes. Bytes must begin with a header.

    Raises:
        CodecError: the bytes are too short or not little-endian CDR, or the nanoseconds of their stamp are not below
            10⁹.
    """
    if isinstance(message, bytes):
        return codec.header_stamp_ns(message)
    header = getattr(message, "header", None)
    return None if header is None else nanoseconds(header.stamp)


class Template:
    """Serialised message whose stamp and some floating-point numbers can be replaced quickly before each publication.

    Args:
        message: complete message, apart from its stamp and the changing numbers; it must begin with the stamp.
        paths: field of each changing number, in the notation of `put`.
    """

    def __init__(self, message: Any, *paths: str) -> None:
        numbers = [_find(message, path) for path in paths]
        data = bytes(serialize_message(message))
        form, end = _STAMP_FORM, struct.calcsize(_STAMP_FORM)
        self._parts: list[Any] = [data[:4], 0, 0]  # constant parts, and between them the stamp and the numbers
        self._places = [0] * len(numbers)
        for index, (kind, offset) in sorted(enumerate(numbers), key=lambda number: number[1][1]):
            form += f"{offset - end}s{kind}"
            self._places[index] = len(self._parts) + 1
            self._parts += [data[end:offset], 0.0]
            end = offset + struct.calcsize(f"<{kind}")
        self._parts.append(data[end:])
        self._form = struct.Struct(f"{form}{len(data) - end}s")

    def render(self, stamp_ns: int, *values: object) -> bytes:
        """Return the CDR bytes of the message with this stamp [ns] and these numbers, in the order of `paths`."""
        parts = self._parts.copy()
        parts[1:3] = divmod(stamp_ns, NS_PER_S)
        for place, value in zip(self._places, values, strict=True):
            parts[place] = value
        return self._form.pack(*parts)


def put(message: Any, path: str, value: object) -> None:
    """Set the field `path` of a message: `linear_acceleration.x`, or `position.2` for index 2 of a sequence."""
    *parts, last = path.split(".")
    for name in parts:
        message = getattr(message, name)
    if last.isdigit():
        message[int(last)] = value
    else:
        setattr(message, last, value)


def _find(message: Any, path: str) -> tuple[str, int]:
    """Return the format (`d` or `f`) and the byte offset of the number in the field `path` of a serialised message.

    The field is 0 afterwards. The function writes a special number into the field and searches for its bytes.
    """
    put(message, path, _MARK)
    marked = bytes(serialize_message(message))
    put(message, path, 0.0)
    offsets = {kind: marked.find(struct.pack(f"<{kind}", _MARK)) for kind in "df"}
    kind = next(kind for kind, offset in offsets.items() if offset >= 0)
    return kind, offsets[kind]


CLOCK = Template(Clock())  # `/clock`: only a stamp
