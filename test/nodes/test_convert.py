"""Monitor messages look right in a plotter: REP-103, REP-117, REP-145, stamps by the rule."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from rclpy.serialization import deserialize_message

from impact_rig.nodes import messages
from impact_rig.nodes.convert import Monitors
from impact_rig.nodes.stamps import nanoseconds
from impact_rig.nodes.topics import by_name
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig, from_flat

pytestmark = pytest.mark.ros
START_NS = 1_700_000_000_000_000_001
NOISE = {"accelerometer": 0.5, "laser": 2e-6, "base": 1e-6, "current": 2e-3}


def monitored(**values: object) -> tuple[list[Block], dict[str, list]]:
    config = from_flat(RigConfig(), {"drive.amplitude": 0.52, **{k.replace("__", "."): v for k, v in values.items()}})
    blocks = Rig(config, START_NS).advance(START_NS + 500_000_000)
    found: dict[str, list] = {}
    for block in blocks:
        for topic, data in Monitors(config, NOISE).messages(block, lambda _: True):
            found.setdefault(topic.name, []).append(deserialize_message(data, messages.class_of(topic)))
    return blocks, found


@pytest.fixture(scope="module")
def default() -> tuple[list[Block], dict[str, list]]:
    return monitored()


def test_every_monitor_comes_at_its_rate_with_stamps_of_scans_and_a_frame(default) -> None:
    blocks, found = default
    stamps = [block.scan.stamp_ns for block in blocks]
    assert set(found) == {"accelerometer", "laser", "base_displacement", "truth/joint_states"}
    for name, received in found.items():
        assert [nanoseconds(message.header.stamp) for message in received] == stamps, "100 Hz: one per block"
        assert received[0].header.frame_id == by_name(name).frame_id != ""


def test_monitor_values_are_those_of_the_scans(default) -> None:
    blocks, found = default
    for k, block in enumerate(blocks):
        row = block.scan.rows[0]
        assert found["accelerometer"][k].linear_acceleration.x == row["accelerometer"]
        assert found["laser"][k].range == np.float32(0.050 - row["laser"])
        assert found["base_displacement"][k].vector.x == row["base"]


def test_imu_says_what_it_does_not_measure(default) -> None:
    message = default[1]["accelerometer"][0]
    assert message.orientation_covariance[0] == -1
    assert message.angular_velocity_covariance[0] == -1
    assert message.linear_acceleration_covariance[0] == NOISE["accelerometer"] ** 2
    assert min(message.linear_acceleration_covariance[4], message.linear_acceleration_covariance[8]) >= 1e6


def test_laser_out_of_range_is_infinite_towards_its_side() -> None:
    """Without the sphere and at twice the current the superior base leaves this laser's +-4 mm."""
    blocks, found = monitored(
        drive__amplitude=1.2,
        sphere__present=False,
        output__monitor_rate_hz=200.0,
        instruments__laser__half_range_m=4e-3,
    )
    ranges = np.array([message.range for message in found["laser"]])
    assert (ranges == math.inf).any()
    assert (ranges == -math.inf).any()
    finite = ranges[np.isfinite(ranges)]
    message = found["laser"][0]
    assert message.min_range == pytest.approx(0.046)
    assert message.max_range == pytest.approx(0.054)
    assert ((finite >= message.min_range) & (finite <= message.max_range)).all()
    truth = np.concatenate([block.monitor for block in blocks])
    assert np.all(truth["x_1"][ranges == math.inf] < 0), "far from the laser: to the left"


def test_joint_states_carry_the_contact_force_as_effort() -> None:
    blocks, found = monitored(barriers__gap_m=0.002, output__monitor_rate_hz=200.0)
    truth = np.concatenate([block.monitor for block in blocks])
    for row, message in zip(truth, found["truth/joint_states"], strict=True):
        assert list(message.name) == ["base", "structure", "sphere"]
        assert list(message.position) == [row["x_b"], row["x_1"], row["x_2"]]
        assert list(message.velocity) == [row["v_b"], row["v_1"], row["v_2"]]
        assert message.effort[2] == row["force_left"] - row["force_right"] == -message.effort[1]
