# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What the recorder keeps of a run besides its messages: configuration, calibration, environment, QoS."""

from __future__ import annotations

import json
import os
import platform
from pathlib import Path
from typing import Any  # rclpy profiles, YAML documents

import yaml

import impact_rig
from impact_rig.blocks import Table
from impact_rig.errors import RecordingError
from impact_rig.recording import OfferedQos
from impact_rig.system.machine import identity


def run_directory(text: str) -> Path:
    """Return the directory a parameter names.

    Raises:
        RecordingError: its user is not known.
    """
    try:
        return Path(text).expanduser()
    except RuntimeError as error:  # ~nobody
        raise RecordingError(f"directory {text!r} cannot be used: {error}") from error


def calibration_yaml(info: Table) -> str:
    """Return daq/info as YAML: one mapping per channel, and the instant from which it holds."""
    channels: dict[str, dict[str, str | float]] = {}
    for row in info.rows:
        values = {name: row[name] for name in info.rows.dtype.names or ()}
        plain = {
            name: value.decode(errors="replace") if isinstance(value, bytes) else float(value)
            for name, value in values.items()
        }
        channels[str(plain.pop("name", len(channels)))] = plain
    text: str = yaml.safe_dump({"stamp_ns": info.stamp_ns, "channels": channels}, sort_keys=False)
    return text


def qos(profile: Any) -> OfferedQos:
    """Return a profile of rclpy in the words of rosbag2."""
    return OfferedQos(
        history=profile.history.name.lower(),
        depth=profile.depth,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        deadline_ns=profile.deadline.nanoseconds,
        lifespan_ns=profile.lifespan.nanoseconds,
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_ns=profile.liveliness_lease_duration.nanoseconds,
    )


def parameters(configuration: str | None) -> dict[str, Any]:
    """Return the nested values of a rig's configuration; empty if it is none (it comes from the network)."""
    try:
        document = yaml.safe_load(configuration or "")
        values = document["/**"]["ros__parameters"]
    except (yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError):  # a date that is none, nesting
        return {}
    sections = values if isinstance(values, dict) else {}
    return {name: section for name, section in sections.items() if isinstance(section, dict)}


def environment() -> bytes:
    """Return what the run depended on, as JSON."""
    return json.dumps(
        {
            "impact_rig": impact_rig.__version__,
            **identity(),
            "machine": platform.machine(),
            "system": platform.platform(),
            "ros_distro": os.environ.get("ROS_DISTRO", ""),
        },
        indent=1,
    ).encode()
