"""A message rendered from a template is, byte for byte, the message filled and serialised."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="no ROS 2 here")

from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, Range

from impact_rig.nodes.stamps import time_message
from impact_rig.nodes.template import Template

pytestmark = pytest.mark.ros
STAMPS = st.integers(0, 2**31 * 10**9 - 1)


@given(STAMPS, st.floats(), st.floats())
def test_doubles_and_the_stamp_are_written_where_they_stand(stamp_ns: int, x: float, z: float) -> None:
    def put_x(message: Imu, value: float) -> None:
        message.linear_acceleration.x = value

    def put_z(message: Imu, value: float) -> None:
        message.angular_velocity.z = value

    filled = Imu()
    filled.header.frame_id = "superior_base"
    template = Template(filled, put_x, put_z)
    filled.header.stamp = time_message(stamp_ns)
    put_x(filled, x)
    put_z(filled, z)
    assert template.render(stamp_ns, x, z) == bytes(serialize_message(filled))


@given(STAMPS, st.floats(width=32))
def test_single_precision_is_found_as_well(stamp_ns: int, distance: float) -> None:
    filled = Range(radiation_type=Range.INFRARED)
    template = Template(filled, lambda message, value: setattr(message, "range", value))
    filled.header.stamp = time_message(stamp_ns)
    filled.range = distance
    assert template.render(stamp_ns, distance) == bytes(serialize_message(filled))
