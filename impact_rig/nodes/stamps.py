# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Nanoseconds as ROS stamps and back."""

from __future__ import annotations

from typing import Any  # message classes have no common base

from builtin_interfaces.msg import Time

from impact_rig import codec
from impact_rig.simtime import NS_PER_S


def time_message(ns: int) -> Time:
    """Return a stamp."""
    seconds, nanoseconds = divmod(ns, NS_PER_S)
    return Time(sec=seconds, nanosec=nanoseconds)


def nanoseconds(stamp: Time) -> int:
    """Return a stamp as nanoseconds."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def header_stamp_ns(message: Any) -> int | None:
    """Return the stamp in the header of a message, or of its CDR bytes; None for a message that has no header."""
    if isinstance(message, bytes):
        return codec.header_stamp_ns(message)
    header = getattr(message, "header", None)
    return None if header is None else nanoseconds(header.stamp)
