# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""A message rendered from a template equals the filled and serialised message, byte for byte."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="no ROS 2 here")

from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, JointState, Range

from impact_rig.nodes.messages import Template, put, time_message

pytestmark = pytest.mark.ros
STAMPS = st.integers(0, 2**31 * 10**9 - 1)


def assert_rendered(message, stamp_ns: int, values: dict[str, float]) -> None:
    rendered = Template(message, *values).render(stamp_ns, *values.values())
    message.header.stamp = time_message(stamp_ns)
    for path, value in values.items():
        put(message, path, value)
    assert rendered == bytes(serialize_message(message))


@given(STAMPS, st.floats(), st.floats())
def test_the_template_writes_doubles_and_the_stamp_at_their_positions(stamp_ns: int, x: float, z: float) -> None:
    message = Imu()
    message.header.frame_id = "superior_base"
    assert_rendered(message, stamp_ns, {"linear_acceleration.x": x, "angular_velocity.z": z})


SINGLE = st.floats(-(2.0**127), 2.0**127, width=32) | st.sampled_from([math.inf, -math.inf, math.nan])
"""The setters of messages take the largest number of single precision for too large: they know it by ten digits."""


@given(STAMPS, SINGLE)
def test_the_template_writes_fields_of_single_precision(stamp_ns: int, distance: float) -> None:
    assert_rendered(Range(radiation_type=Range.INFRARED), stamp_ns, {"range": distance})


@given(STAMPS, st.floats(), st.floats())
def test_the_template_writes_elements_of_sequences(stamp_ns: int, first: float, last: float) -> None:
    message = JointState(name=["base", "sphere"], position=[0.0, 0.0], effort=[0.0, 0.0])
    assert_rendered(message, stamp_ns, {"position.0": first, "effort.1": last})
