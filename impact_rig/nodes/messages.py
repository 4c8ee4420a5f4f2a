# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The rows of the topic table as rclpy takes them: message classes and QoS profiles."""

from __future__ import annotations

import importlib
from typing import Any  # message classes have no common base

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from impact_rig.topics import Qos, Topic


def class_of(topic: Topic) -> Any:
    """Return the class of a topic's messages; raises as `message_class` does."""
    return message_class(topic.type_name)


def message_class(type_name: str) -> Any:
    """Import and return the class of a message type, `package/msg/Type`.

    Raises:
        ImportError, AttributeError: it is not installed.
    """
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def profile(qos: Qos) -> QoSProfile:
    """Return a fresh rclpy profile (rclpy writes overrides into it)."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE,
    )
