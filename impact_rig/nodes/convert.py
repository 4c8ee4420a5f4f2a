"""Blocks as standard messages for plotters: REP-103 units and axes, REP-117 out-of-range, REP-145 covariances."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any  # message classes

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState, Range

from impact_rig import topics
from impact_rig.blocks import CHANNELS
from impact_rig.config import RigConfig
from impact_rig.nodes.template import Template
from impact_rig.rig import Block
from impact_rig.simtime import stamp_ns

LASER_BIT = 1 << CHANNELS.index("laser")
UNKNOWN_VARIANCE = 1e9
"""Variance of the axes the one-axis accelerometer does not measure: REP-145 has no other word for a single axis."""
NOT_MEASURED = -1.0
"""REP-145: first element of the covariance of a quantity the device does not measure at all."""
LASER_CONE_RAD = 1e-3
JOINTS = ("base", "structure", "sphere")

CLOCK = Template(Clock())
"""`/clock`: nothing but a stamp."""


class Monitors:
    """Turns blocks into the messages of the monitor topics, as bytes.

    Args:
        config: configuration in force, for ranges and variances.
        noise: rms noise by channel name, in its unit, as in daq/info.
    """

    def __init__(self, config: RigConfig, noise: dict[str, float]) -> None:
        self._rate_hz = config.daq.rate_hz
        laser = config.instruments.laser
        self._distance = laser.distance_m
        self._nearest, self._farthest = laser.distance_m - laser.half_range_m, laser.distance_m + laser.half_range_m
        self._render: dict[topics.Topic, Callable[[int, np.void, np.void], bytes]] = {
            topics.ACCELEROMETER: self._accelerometer(noise["accelerometer"]),
            topics.LASER: self._laser(noise["laser"]),
            topics.BASE_DISPLACEMENT: _base(),
            topics.JOINT_STATES: _joints(),
        }

    def messages(self, block: Block, wanted: Callable[[topics.Topic], bool]) -> Iterator[tuple[topics.Topic, bytes]]:
        """Yield the wanted monitor messages of a block, in time order."""
        render = [(topic, render) for topic, render in self._render.items() if wanted(topic)]
        if not render:
            return
        start_ns = block.scan.stamp_ns - stamp_ns(block.first_sample, self._rate_hz)
        for scan, truth in zip(block.monitor_scans.tolist(), block.monitor, strict=True):
            row = block.scan.rows[scan]
            stamp = stamp_ns(block.first_sample + scan, self._rate_hz, start_ns)
            for topic, one in render:
                yield topic, one(stamp, row, truth)

    def _accelerometer(self, noise: float) -> Callable[[int, np.void, np.void], bytes]:
        message = _framed(Imu(), topics.ACCELEROMETER)
        message.orientation_covariance[0] = message.angular_velocity_covariance[0] = NOT_MEASURED
        unknown = UNKNOWN_VARIANCE
        message.linear_acceleration_covariance = [noise**2, 0.0, 0.0, 0.0, unknown, 0.0, 0.0, 0.0, unknown]
        template = Template(message, lambda m, x: setattr(m.linear_acceleration, "x", x))
        return lambda stamp, row, _: template.render(stamp, row["accelerometer"])

    def _laser(self, noise: float) -> Callable[[int, np.void, np.void], bytes]:
        message = Range(
            radiation_type=Range.INFRARED,
            field_of_view=LASER_CONE_RAD,
            min_range=self._nearest,
            max_range=self._farthest,
            variance=noise**2,
        )
        template = Template(_framed(message, topics.LASER), lambda m, x: setattr(m, "range", x))
        return lambda stamp, row, _: template.render(stamp, self._distance_of(row))

    def _distance_of(self, row: np.void) -> float:
        distance = self._distance - float(row["laser"])
        if int(row["status"]) & LASER_BIT or not self._nearest <= distance <= self._farthest:
            return math.inf if distance > self._distance else -math.inf  # REP-117
        return distance


def _base() -> Callable[[int, np.void, np.void], bytes]:
    message = _framed(Vector3Stamped(), topics.BASE_DISPLACEMENT)
    template = Template(message, lambda m, x: setattr(m.vector, "x", x))
    return lambda stamp, row, _: template.render(stamp, row["base"])


def _joints() -> Callable[[int, np.void, np.void], bytes]:
    """Render the true state; effort is the contact force on each body, the sphere's pushed by both walls."""
    zeros = [0.0, 0.0, 0.0]
    message = _framed(JointState(name=JOINTS, position=zeros, velocity=zeros, effort=zeros), topics.JOINT_STATES)
    places = [(name, i) for name in ("position", "velocity") for i in range(3)] + [("effort", 1), ("effort", 2)]
    template = Template(message, *(_element(name, i) for name, i in places))

    def render(stamp: int, _row: np.void, truth: np.void) -> bytes:
        push = truth["force_left"] - truth["force_right"]
        return template.render(
            stamp, truth["x_b"], truth["x_1"], truth["x_2"], truth["v_b"], truth["v_1"], truth["v_2"], -push, push
        )

    return render


def _element(name: str, index: int) -> Callable[[Any, float], None]:
    def put(message: Any, value: float) -> None:
        getattr(message, name)[index] = value

    return put


def _framed(message: Any, topic: topics.Topic) -> Any:
    message.header.frame_id = topic.frame_id
    return message
