# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`metadata.yaml` of a run directory and the `rosbag2` metadata record of its files, as rosbag2 of Jazzy writes them.

Version 9 has twelve keys under `rosbag2_bagfile_information`; QoS profiles are native YAML with policies as words; an
empty `custom_data` is null; compression fields are empty because MCAP compresses its own chunks. Source: rosbag2 0.26,
`rosbag2_storage/yaml.hpp`, `qos.cpp` and `rosbag2_cpp/writers/sequential_writer.cpp`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import attrs

from impact_rig.errors import RecordingError
from impact_rig.recording.description import INFINITE_NS, SERIALIZATION, TopicDescription, dump_yaml
from impact_rig.system import files

VERSION = 9
FILE_NAME = "metadata.yaml"
TOP_KEY = "rosbag2_bagfile_information"
RECORD_NAME = "rosbag2"
RECORD_KEY = "serialized_metadata"

Information = dict[str, object]


@attrs.define
class FileSpan:
    """The messages of one file (or of all): how many, and from when to when in log time [ns]."""

    path: str
    count: int = 0
    start_ns: int = INFINITE_NS
    end_ns: int = 0

    def add(self, log_time_ns: int) -> None:
        """Count one message."""
        self.count += 1
        self.start_ns = min(self.start_ns, log_time_ns)
        self.end_ns = max(self.end_ns, log_time_ns)

    @property
    def duration_ns(self) -> int:
        """Time from the earliest to the latest message; 0 when there is none."""
        return max(0, self.end_ns - self.start_ns)


def information(
    topics: Sequence[tuple[TopicDescription, int]],
    spans: Sequence[FileSpan],
    *,
    ros_distro: str,
    custom_data: Mapping[str, str] | None = None,
) -> Information:
    """Return the twelve keys under `rosbag2_bagfile_information`.

    Args:
        topics: each with its number of messages.
        spans: of the files, in the order they were written; at least one.
        ros_distro: such as `jazzy`.
        custom_data: free text for other tools.
    """
    start_ns, end_ns = min(span.start_ns for span in spans), max(span.end_ns for span in spans)
    total = FileSpan("", sum(span.count for span in spans), start_ns, end_ns)
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": total.duration_ns},
        "starting_time": {"nanoseconds_since_epoch": total.start_ns},
        "message_count": total.count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": SERIALIZATION,
                    "offered_qos_profiles": topic.offered_qos_yaml(),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": count,
            }
            for topic, count in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [span.path for span in spans],
        "files": [
            {
                "path": span.path,
                "starting_time": {"nanoseconds_since_epoch": span.start_ns},
                "duration": {"nanoseconds": span.duration_ns},
                "message_count": span.count,
            }
            for span in spans
        ],
        "custom_data": dict(custom_data) if custom_data else None,
        "ros_distro": ros_distro,
    }


def record(info: Information) -> dict[str, str]:
    """Return the content of the `rosbag2` metadata record: the information without its top key."""
    return {RECORD_KEY: dump_yaml(info)}


def write(directory: Path, info: Information) -> Path:
    """Write `metadata.yaml` whole or not at all.

    Raises:
        RecordingError: it cannot be written.
    """
    path = directory / FILE_NAME
    try:
        files.write_text(path, dump_yaml({TOP_KEY: info}) + "\n")
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror}") from error
    return path
