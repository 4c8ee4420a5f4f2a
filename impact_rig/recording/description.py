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
"""Description of the topics and files of a recording as rosbag2 stores it: types, schemas, QoS, `metadata.yaml`.

A `ros2msg` schema is the `.msg` text of the type, followed by each type it uses, directly or indirectly, once, after a
line of 80 `=` and `MSG: package/Type`. The texts are those of the installed interfaces. Without ROS 2 they are the
generated `definitions.json` of this package, so that a run can be written and imported without ROS.

A `metadata.yaml` of version 9 has twelve keys under `rosbag2_bagfile_information`. QoS profiles are native YAML with
policies as words, an empty `custom_data` is null, and compression fields are empty because MCAP compresses its own
chunks. Source: rosbag2 0.26, `rosbag2_storage/yaml.hpp`, `qos.cpp` and `rosbag2_cpp/writers/sequential_writer.cpp`.

The metadata record `impact_rig` holds the provenance of a run. MCAP protects chunks and attachments with a CRC, but not
metadata records. Those of this package therefore carry a CRC of their own under the key `crc32`, so that a flipped bit,
for example in the seed, is detected.
"""

from __future__ import annotations

import functools
import json
import os
import re
import struct
import sys
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import attrs
import yaml
from mcap.records import Channel, Schema

from impact_rig.arithmetic import ARITHMETIC
from impact_rig.errors import RecordingError
from impact_rig.simtime import NS_PER_S
from impact_rig.system import budget, files

INFINITE_NS = 2**63 - 1  # an infinite duration in ROS (RMW_DURATION_INFINITE: 9223372036 s 854775807 ns)

SERIALIZATION = "cdr"
_SCHEMA_CODEC = {True: ("utf-8", "replace"), False: ("latin-1",)}  # text encoding of a schema; True: it is `ros2msg`
ENCODING = "ros2msg"

MAX_QOS_CHARACTERS = 65_536
"""Limit of a YAML text with the QoS profiles of a topic's publishers; half of it suffices for a hundred publishers."""

QosYaml = dict[str, str | int | bool | dict[str, int]]


@attrs.frozen(kw_only=True)
class OfferedQos:
    """Quality of service offered by one publisher.

    Policies are spelled as in rosbag2: `policy.name.lower()` of rclpy. Fast DDS does not provide history and depth of a
    remote publisher. In that case they have their default values, `unknown` and 0, as in files of rosbag2.
    """

    history: str = "unknown"
    depth: int = 0
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: str = "automatic"
    liveliness_lease_ns: int = INFINITE_NS
    avoid_ros_namespace_conventions: bool = False

    def to_yaml(self) -> QosYaml:
        """Return this profile as the mapping that rosbag2 writes to YAML (metadata version 9: policies as words)."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": _time(self.deadline_ns),
            "lifespan": _time(self.lifespan_ns),
            "liveliness": self.liveliness,
            "liveliness_lease_duration": _time(self.liveliness_lease_ns),
            "avoid_ros_namespace_conventions": self.avoid_ros_namespace_conventions,
        }


@functools.lru_cache(maxsize=64)  # topics have few different profiles
def _qos_text(offered: tuple[OfferedQos, ...]) -> str:
    return dump_yaml([qos.to_yaml() for qos in offered])


@attrs.frozen(kw_only=True)
class TopicDescription:
    """Description of a recorded topic: its name, message type, schema, and the QoS that its publishers offer."""

    name: str  # fully qualified
    type_name: str  # `package/msg/Type`
    schema: str = attrs.field(default=attrs.Factory(lambda self: schema_text(self.type_name), takes_self=True))
    """`.msg` text with dependencies; by default that of the installed type (`schema_text`)."""
    type_hash: str = ""  # RIHS01 hash of the type description; empty if unknown
    offered_qos: tuple[OfferedQos, ...] = ()  # one entry per publisher; may be empty
    offered_qos_text: str = attrs.field(
        default=attrs.Factory(lambda self: _qos_text(self.offered_qos), takes_self=True)
    )
    """YAML list of the offered profiles: as in the file for a topic that was read, else made from `offered_qos`."""
    encoding: str = SERIALIZATION  # encoding of its messages
    schema_encoding: str = ENCODING  # encoding of `schema`; if it is not that of ROS, `schema` holds bytes as Latin-1

    def offered_qos_yaml(self) -> list[QosYaml]:
        """Return the QoS profiles in `offered_qos_text`, with the policies of `OfferedQos` only.

        The result is empty if the text is not a valid YAML list.
        """
        return [dict(profile) for profile in _profiles(self.offered_qos_text)]

    def channel_metadata(self) -> dict[str, str]:
        """Return the metadata of the MCAP channel of this topic: offered QoS profiles and type hash, as in rosbag2."""
        return {"offered_qos_profiles": self.offered_qos_text, "topic_type_hash": self.type_hash}

    @classmethod
    def from_channel(cls, channel: Channel, schema: Schema | None) -> TopicDescription:
        """Return the description of a topic from its MCAP channel and schema.

        Without a schema, `type_name` and `schema` are empty.
        """
        schema_encoding = ENCODING if schema is None else schema.encoding
        return cls(
            name=channel.topic,
            type_name="" if schema is None else schema.name,
            schema="" if schema is None else str(schema.data, *_SCHEMA_CODEC[schema_encoding == ENCODING]),
            type_hash=channel.metadata.get("topic_type_hash", ""),
            offered_qos_text=channel.metadata.get("offered_qos_profiles", ""),
            encoding=channel.message_encoding,
            schema_encoding=schema_encoding,
        )

    def schema_bytes(self) -> bytes:
        """Return the schema as bytes for a file.

        A `ros2msg` schema is encoded as UTF-8, and any other schema as Latin-1.
        """
        return self.schema.encode(_SCHEMA_CODEC[self.schema_encoding == ENCODING][0])


@functools.lru_cache(maxsize=1024)
def _profiles(text: str) -> tuple[QosYaml, ...]:
    """Return the QoS profiles in an untrusted YAML list, with the policies of `OfferedQos` only.

    Values of an unexpected type, and items that are no mappings, are left out. The result is empty if the text is not a
    YAML list, or is longer than `MAX_QOS_CHARACTERS`.
    """
    try:
        found = budget.load_yaml(text, MAX_QOS_CHARACTERS)
    except budget.PlainYamlError:
        return ()
    return tuple(_profile(one) for one in found if isinstance(one, dict)) if isinstance(found, list) else ()


def _profile(found: Mapping[object, object]) -> QosYaml:
    profile: QosYaml = {}
    for name in OfferedQos().to_yaml():
        value = found.get(name)
        if isinstance(value, (str, int)):
            profile[name] = value
        elif isinstance(value, dict):
            profile[name] = {unit: int(value[unit]) for unit in ("sec", "nsec") if isinstance(value.get(unit), int)}
    return profile


class _Dumper(yaml.SafeDumper):
    """YAML dumper that writes like yaml-cpp: repeated values in full, without anchors, and `~` for null."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002  (signature of yaml.SafeDumper)
        return True


_Dumper.add_representer(type(None), lambda dumper, _: dumper.represent_scalar("tag:yaml.org,2002:null", "~"))


def dump_yaml(value: object) -> str:
    """Return `value` as block-style YAML, with keys in their order and without a newline at the end."""
    text: str = yaml.dump(value, Dumper=_Dumper, sort_keys=False, default_flow_style=False, allow_unicode=True)
    return text.rstrip("\n")


def _time(nanoseconds: int) -> dict[str, int]:
    seconds, rest = divmod(nanoseconds, NS_PER_S)
    return {"sec": seconds, "nsec": rest}


DEFINITIONS = Path(__file__).with_name("definitions.json")
"""File with the `.msg` texts, by `package/Type`, of all types that the topics of this package need."""

_SEPARATOR = "=" * 80
_NAME = re.compile(r"([A-Za-z]\w*)/(?:msg/)?([A-Za-z]\w*)")
_FIELD = re.compile(r"^[ \t]*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]\n]*\])?[ \t]+[A-Za-z]\w*", re.MULTILINE)
_PRIMITIVE = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_MEMBER = re.compile(r"^[ \t]*([A-Za-z][\w/]*)(?:<=\d+)?(\[[^\]\n]*\])?[ \t]+([a-z]\w*)[ \t]*(?![ \t=])", re.MULTILINE)
_MAX_DEPTH = 8
_MAX_TYPES = 200  # far above every message of common_interfaces; stops circular or hostile definitions


def interface_prefixes() -> tuple[Path, ...]:
    """Return the prefixes under which `.msg` files may be installed: those of the sourced ROS, then of this Python."""
    sourced = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return tuple(Path(prefix) for prefix in [*sourced, sys.prefix] if prefix)


def schema_text(type_name: str) -> str:
    """Return the schema of a message type, followed by the schemas of the types that it uses.

    `type_name` has the form `package/msg/Type` or `package/Type`. The texts are those of `definitions`.

    Raises:
        RecordingError: the type or a type that it uses is missing, the name is not the name of a message type, or the
            type and those that it uses are more than 200.
    """
    (_, first), *others = definitions(type_name).items()
    return "\n".join([first, *(f"{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in others)])


def definitions(type_name: str) -> dict[str, str]:
    """Return the `.msg` texts of a message type and of the types that it uses, by `package/Type`.

    The first text is that of `type_name` itself. Types that are used indirectly are included. A text is the first file
    `share/<package>/msg/<Type>.msg` found in the `interface_prefixes`, or else the text stored in this package.

    Raises:
        RecordingError: the type or a type that it uses is missing, the name is not the name of a message type, or the
            type and those that it uses are more than 200.
    """
    where = interface_prefixes()
    root = _short_name(type_name)
    seen = {root}
    found: dict[str, str] = {}

    def append(name: str) -> None:
        package, kind = name.split("/")
        found[name] = text = _read(package, kind, where, type_name)
        for used in sorted(_used_types(text, package)):
            if used not in seen:
                seen.add(used)
                if len(seen) > _MAX_TYPES:
                    raise RecordingError(
                        f"the installed definition of {type_name} uses more than {_MAX_TYPES} types, so its messages "
                        f"cannot be recorded: check the .msg files of the package {root.split('/')[0]}"
                    )
                append(used)

    append(root)
    return found


@functools.cache
def _bundled() -> dict[str, str]:
    texts: dict[str, str] = json.loads(DEFINITIONS.read_text(encoding="utf-8"))
    return texts


def starts_with_header(type_name: str, schema: str) -> bool:
    """Return whether the messages of a type begin with a `std_msgs/Header`, or are headers themselves.

    `schema` is the `.msg` text of the type. The result is False if `type_name` is not the name of a ROS message type.
    """
    if _NAME.fullmatch(type_name) is None:  # not a type of ROS, or no schema
        return False
    if _short_name(type_name) == "std_msgs/Header":
        return True
    first = _FIELD.search(schema)
    return first is not None and first[1] in {"std_msgs/Header", "std_msgs/msg/Header", "Header"}


def members(schema: str) -> list[tuple[str, str, int]]:
    """Return the members of a message type in order: path (such as `header.stamp.sec`), primitive type and count.

    The count is 1 for a single value, n for an array of n values, and -1 for a sequence (variable length), with or
    without an upper bound.

    Args:
        schema: text as made by `schema_text`.

    Raises:
        RecordingError: a type is not defined in the text. Or a member that is itself a message is in an array or
            sequence, is nested more than 8 types deep, or follows more than 200 members of primitive types. The number
            of members of primitive types itself is not limited.
    """
    root, *others = (part.strip() for part in schema.split(_SEPARATOR))
    texts = {
        _short_name(head.removeprefix("MSG:").strip()): text for head, _, text in (o.partition("\n") for o in others)
    }
    found: list[tuple[str, str, int]] = []

    def walk(text: str, path: str, depth: int) -> None:
        for name, length, member in _MEMBER.findall(text):
            count = 1 if not length else int(length[1:-1]) if length[1:-1].isdigit() else -1
            if _PRIMITIVE.fullmatch(name):
                found.append((path + member, name, count))
            else:
                inner = next((t for key, t in texts.items() if key == name or key.endswith(f"/{name}")), None)
                why = "it is an array of messages" if count != 1 else "" if inner else "this type is not defined"
                if inner is None or why or depth > _MAX_DEPTH or len(found) > _MAX_TYPES:
                    deep = f"it is nested more than {_MAX_DEPTH} types deep"
                    why = why or (deep if depth > _MAX_DEPTH else f"it follows more than {_MAX_TYPES} members")
                    raise RecordingError(
                        f"the message member {path + member} of type {name}{length} cannot be read: {why}"
                    )
                walk(inner, f"{path}{member}.", depth + 1)

    walk(root, "", 0)
    return found


def _short_name(type_name: str) -> str:
    match = _NAME.fullmatch(type_name)
    if match is None:
        raise RecordingError(f"{type_name!r} is not the name of a message type, such as sensor_msgs/msg/PointCloud2")
    return f"{match[1]}/{match[2]}"


def _read(package: str, kind: str, prefixes: Sequence[Path], wanted_by: str) -> str:
    for prefix in prefixes:
        path = prefix / "share" / package / "msg" / f"{kind}.msg"
        try:
            return path.read_text(encoding="utf-8", errors="replace")  # a comment may be in another encoding
        except OSError:
            continue
    if (text := _bundled().get(f"{package}/{kind}")) is not None:
        return text
    looked = ", ".join(str(prefix / "share") for prefix in prefixes)
    raise RecordingError(
        f"no definition of {wanted_by}: {package}/msg/{kind}.msg is not in {looked}; source the ROS 2 workspace that "
        "has it"
    )


def _used_types(text: str, package: str) -> set[str]:
    used = (name for name in _FIELD.findall(text) if not _PRIMITIVE.fullmatch(name))
    return {_short_name(name) if "/" in name else f"{package}/{name}" for name in used}


METADATA_VERSION = 9
METADATA_FILE = "metadata.yaml"
METADATA_KEY = "rosbag2_bagfile_information"
BAG_RECORD_NAME = "rosbag2"
BAG_RECORD_KEY = "serialized_metadata"

Information = dict[str, object]


@attrs.define
class Extent:
    """Number of messages of a file or topic, and their earliest and latest log time [ns].

    Without messages, `start_ns` is `INFINITE_NS` and `end_ns` is 0.
    """

    name: str = ""  # name of the file
    count: int = 0
    start_ns: int = INFINITE_NS
    end_ns: int = 0

    def add(self, log_time_ns: int) -> None:
        """Count one message with this log time."""
        self.count += 1
        self.start_ns = min(self.start_ns, log_time_ns)
        self.end_ns = max(self.end_ns, log_time_ns)

    @property
    def duration_ns(self) -> int:
        """Time from the earliest to the latest log time [ns]; 0 without messages."""
        return max(0, self.end_ns - self.start_ns)


def bag_information(
    topics: Sequence[tuple[TopicDescription, int]], spans: Sequence[Extent], *, ros_distro: str
) -> Information:
    """Return the content of `metadata.yaml`: the twelve keys under `rosbag2_bagfile_information`.

    Args:
        topics: topics, each with its number of messages.
        spans: extents of the MCAP files, in the order of writing; at least one.
        ros_distro: name of the ROS distribution, such as `jazzy`.
    """
    start_ns, end_ns = min(span.start_ns for span in spans), max(span.end_ns for span in spans)
    total = Extent("", sum(span.count for span in spans), start_ns, end_ns)
    return {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": total.duration_ns},
        "starting_time": {"nanoseconds_since_epoch": total.start_ns},
        "message_count": total.count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": topic.encoding,
                    "offered_qos_profiles": topic.offered_qos_yaml(),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": count,
            }
            for topic, count in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [span.name for span in spans],
        "files": [
            {
                "path": span.name,
                "starting_time": {"nanoseconds_since_epoch": span.start_ns},
                "duration": {"nanoseconds": span.duration_ns},
                "message_count": span.count,
            }
            for span in spans
        ],
        "custom_data": None,
        "ros_distro": ros_distro,
    }


def bag_record(info: Information) -> dict[str, str]:
    """Return the content of the metadata record `rosbag2` of an MCAP file: `info` as YAML, under one key."""
    return {BAG_RECORD_KEY: dump_yaml(info)}


def write_metadata(directory: Path, info: Information) -> None:
    """Write the file `metadata.yaml` of a run directory, completely or not at all.

    Raises:
        RecordingError: the file cannot be written.
    """
    path = directory / METADATA_FILE
    with files.translate_errors(f"cannot write {path}"):
        files.write_text(path, dump_yaml({METADATA_KEY: info}) + "\n")


RECORD_NAME = "impact_rig"  # metadata record with the package version, the seed and the wall-clock start
TOPIC_RECORD_NAME = "impact_rig/topic"
"""Name of the metadata record that repeats a channel and its schema outside the chunks.

With it, the other chunks stay readable after the loss of the chunk that defines the channel.
"""
CONFIGURATION = "config.yaml"  # attachment with the resolved configuration

MODE_KEY = "mode"
MEASURED = "measured"  # mode of an imported run

ARITHMETIC_KEY = "arithmetic"
UNWRITTEN_ARITHMETIC = "1"  # version of recordings that do not state one

_CRC_KEY = "crc32"


@attrs.frozen(kw_only=True)
class Provenance:
    """Provenance of a run: version of the package, version of the arithmetic, seed, and start of the recording.

    It is stored in the metadata record `impact_rig`.
    """

    version: str
    seed: int  # seed of noise, calibration errors and random drive
    wall_start_ns: int  # system time at the start of the recording [ns since the epoch]
    extra: Mapping[str, str] = attrs.field(factory=dict)
    arithmetic: int = ARITHMETIC  # version of the arithmetic that computed the samples

    def to_record(self) -> dict[str, str]:
        """Return the provenance as the content of the metadata record `impact_rig`."""
        return {
            "version": self.version,
            "seed": str(self.seed),
            "wall_start_ns": str(self.wall_start_ns),
            ARITHMETIC_KEY: str(self.arithmetic),
            **dict(self.extra),
        }

    @classmethod
    def from_record(cls, record: Mapping[str, str]) -> Provenance | None:
        """Return the provenance from the content of a metadata record `impact_rig`.

        The result is None if version, seed or start time is missing, or if a number is not an integer.
        """
        extra = dict(record)
        try:
            version, seed, start = extra.pop("version"), int(extra.pop("seed")), int(extra.pop("wall_start_ns"))
            arithmetic = int(extra.pop(ARITHMETIC_KEY, UNWRITTEN_ARITHMETIC))
        except (KeyError, ValueError):
            return None
        return cls(version=version, seed=seed, wall_start_ns=start, extra=extra, arithmetic=arithmetic)


def arithmetic_of(record: Mapping[str, str]) -> str:
    """Return the version of the arithmetic that the provenance record of a run states.

    The result is `1` if the record does not state it. It is empty for an empty record, because files of other recorders
    have no provenance. Only a program with the same version of the arithmetic reproduces the samples bit for bit.
    """
    return record.get(ARITHMETIC_KEY, UNWRITTEN_ARITHMETIC) if record else ""


def is_measured(record: Mapping[str, str]) -> bool:
    """Return whether a run is an imported measurement instead of a simulation, from its provenance record."""
    return record.get(MODE_KEY) == MEASURED


@attrs.frozen
class Attachment:
    """File to store inside a recording, such as the configuration."""

    name: str
    data: bytes
    media_type: str = "application/octet-stream"


def protect(record: Mapping[str, str]) -> dict[str, str]:
    """Return the content of a metadata record with a checksum added under the key `crc32`.

    `verify` checks this checksum.
    """
    content = {key: value for key, value in record.items() if key != _CRC_KEY}
    return {**content, _CRC_KEY: f"{_checksum(content):08x}"}


def verify(record: Mapping[str, str]) -> dict[str, str] | None:
    """Return the content of a metadata record without its checksum; None if the checksum is missing or wrong."""
    content = {key: value for key, value in record.items() if key != _CRC_KEY}
    return content if record.get(_CRC_KEY) == f"{_checksum(content):08x}" else None


def _checksum(content: Mapping[str, str]) -> int:
    crc = 0
    for key, value in sorted(content.items()):
        for text in (key.encode(), value.encode()):
            crc = zlib.crc32(struct.pack("<Q", len(text)) + text, crc)
    return crc
