"""Blocks as standard messages for plotters: REP-103 units and axes, REP-117 out-of-range, REP-145 covariances."""

from __future__ import annotations

import math
from typing import Any  # message classes

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3Stamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState, Range

from impact_rig import topics
from impact_rig.blocks import CHANNELS
from impact_rig.nodes.stamps import time_message
from impact_rig.rig import Block
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import stamp_ns

LASER_BIT = 1 << CHANNELS.index("laser")
UNKNOWN_VARIANCE = 1e9
"""Variance of the axes the one-axis accelerometer does not measure: REP-145 has no other word for a single axis."""
NOT_MEASURED = -1.0
"""REP-145: first element of the covariance of a quantity the device does not measure at all."""
LASER_CONE_RAD = 1e-3
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
        laser = config.instruments.laser
        self._distance = laser.distance_m
        self._nearest, self._farthest = laser.distance_m - laser.half_range_m, laser.distance_m + laser.half_range_m
        self._laser_variance = noise["laser"] ** 2
        self._acceleration_covariance = [0.0] * 9
        self._acceleration_covariance[0] = noise["accelerometer"] ** 2
        self._acceleration_covariance[4] = self._acceleration_covariance[8] = UNKNOWN_VARIANCE

    def messages(self, block: Block) -> list[tuple[topics.Topic, Any]]:
        """Return the monitor messages of a block, in time order."""
        found: list[tuple[topics.Topic, Any]] = []
        start_ns = block.scan.stamp_ns - stamp_ns(block.first_sample, self._rate_hz)
        for scan, truth in zip(block.monitor_scans.tolist(), block.monitor, strict=True):
            row = block.scan.rows[scan]
            stamp = time_message(stamp_ns(block.first_sample + scan, self._rate_hz, start_ns))
            found += (
                (topics.ACCELEROMETER, self._imu(row, stamp)),
                (topics.LASER, self._range(row, stamp)),
                (topics.BASE_DISPLACEMENT, _displacement(row, stamp)),
                (topics.JOINT_STATES, _joint_state(truth, stamp)),
            )
        return found

    def _imu(self, row: np.void, stamp: Time) -> Imu:
        message = Imu()
        message.header.stamp = stamp
        message.header.frame_id = topics.ACCELEROMETER.frame_id
        message.orientation_covariance[0] = NOT_MEASURED
        message.angular_velocity_covariance[0] = NOT_MEASURED
        message.linear_acceleration.x = float(row["accelerometer"])
        message.linear_acceleration_covariance = self._acceleration_covariance
        return message

    def _range(self, row: np.void, stamp: Time) -> Range:
        distance = self._distance - float(row["laser"])
        if int(row["status"]) & LASER_BIT or not self._nearest <= distance <= self._farthest:
            distance = math.inf if distance > self._distance else -math.inf  # REP-117
        message = Range(
            radiation_type=Range.INFRARED,
            field_of_view=LASER_CONE_RAD,
            min_range=self._nearest,
            max_range=self._farthest,
            range=distance,
            variance=self._laser_variance,
        )
        message.header.stamp = stamp
        message.header.frame_id = topics.LASER.frame_id
        return message


def _displacement(row: np.void, stamp: Time) -> Vector3Stamped:
    message = Vector3Stamped()
    message.header.stamp = stamp
    message.header.frame_id = topics.BASE_DISPLACEMENT.frame_id
    message.vector.x = float(row["base"])
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
