"""Nanoseconds as ROS stamps and back."""

from __future__ import annotations

from builtin_interfaces.msg import Time

from impact_rig.simtime import NS_PER_S


def time_message(ns: int) -> Time:
    """Return a stamp."""
    seconds, nanoseconds = divmod(ns, NS_PER_S)
    return Time(sec=seconds, nanosec=nanoseconds)


def nanoseconds(stamp: Time) -> int:
    """Return a stamp as nanoseconds."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)
