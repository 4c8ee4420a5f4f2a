"""Blocks as standard messages for plotters: REP-103 units and axes, REP-117 out-of-range, REP-145 covariances."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any  # message classes

import numpy as np
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from impact_rig import topics
from impact_rig.nodes import messages
from impact_rig.nodes.stamps import time_message
from impact_rig.nodes.topics import MONITORS
from impact_rig.rig import Block
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import stamp_ns

JOINTS = ("base", "structure", "sphere")


def clock_message(ns: int) -> Clock:
    """Return `/clock` at this rig time."""
    return Clock(clock=time_message(ns))


class Monitors:
    """Turns blocks into the monitor topics.

    Args:
        config: configuration in force, for ranges and variances.
        noise: rms noise by channel name, in its unit, as in daq/info.
    """

    def __init__(self, config: RigConfig, noise: dict[str, float]) -> None:
        self._rate_hz = config.daq.rate_hz
        self._noise = noise
        self._channels = [
            (1 << bit, instrument, MONITORS[instrument.name], messages.class_of(MONITORS[instrument.name]))
            for bit, instrument in enumerate(config.instruments.fitted())
            if instrument.name in MONITORS
        ]

    def messages(self, block: Block) -> list[tuple[topics.Topic, Any]]:
        """Return the monitor messages of a block, in time order."""
        found: list[tuple[topics.Topic, Any]] = []
        start_ns = block.scan.stamp_ns - stamp_ns(block.first_sample, self._rate_hz)
        for scan, truth in zip(block.monitor_scans.tolist(), block.monitor, strict=True):
            row = block.scan.rows[scan]
            stamp = time_message(stamp_ns(block.first_sample + scan, self._rate_hz, start_ns))
            for bit, instrument, topic, kind in self._channels:
                clipped = bool(int(row["status"]) & bit)
                values = instrument.message(float(row[instrument.name]), clipped, self._noise[instrument.name])
                found.append((topic, _filled(kind(), topic, stamp, values)))
            found.append((topics.JOINT_STATES, _joint_state(truth, stamp)))
        return found


def _filled(message: Any, topic: topics.Topic, stamp: Time, values: Mapping[str, object]) -> Any:
    """Return the message with its header and these fields; a dot leads into a part."""
    message.header.stamp = stamp
    message.header.frame_id = topic.frame_id
    for path, value in values.items():
        *parts, name = path.split(".")
        part = message
        for step in parts:
            part = getattr(part, step)
        setattr(part, name, value)
    return message


def _joint_state(row: np.void, stamp: Time) -> JointState:
    """Return the true state; effort is the contact force on each body, the sphere's pushed by both walls."""
    push = float(row["force_left"]) - float(row["force_right"])
    message = JointState(
        name=JOINTS,
        position=[float(row["x_b"]), float(row["x_1"]), float(row["x_2"])],
        velocity=[float(row["v_b"]), float(row["v_1"]), float(row["v_2"])],
        effort=[0.0, -push, push],
    )
    message.header.stamp = stamp
    message.header.frame_id = topics.JOINT_STATES.frame_id
    return message
