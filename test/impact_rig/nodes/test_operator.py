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
"""Output of an operator's tools (`ros2 topic`, `param`, `lifecycle`, plotters), by the calls that they make."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from lifecycle_msgs.msg import TransitionEvent
from lifecycle_msgs.srv import GetAvailableStates, GetAvailableTransitions
from rcl_interfaces.msg import ParameterEvent, ParameterType
from rcl_interfaces.srv import GetParameterTypes, ListParameters
from rclpy.qos import qos_profile_parameter_events

from impact_rig.client import Client, Collector, isolated_domain
from impact_rig.nodes.messages import by_name, nanoseconds
from impact_rig.rig import config
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import NS_PER_S

pytestmark = pytest.mark.ros
MONITORS = ("accelerometer", "laser", "base_displacement", "truth/joint_states")
KINDS = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
    tuple: ParameterType.PARAMETER_STRING_ARRAY,
}
LATE_S = 0.5
"""A message is in a plotter this long after its stamp, even on a busy machine."""


@pytest.fixture(scope="module")
def plotted() -> Iterator[tuple[Client, dict[str, Collector]]]:
    """A rig in real time at resonance, seen by a plotter."""
    with isolated_domain() as domain_id, Client(domain_id) as client:
        host_rig(client, "realtime", drive__amplitude=0.52)
        client.wait_active("rig")
        heard = {name: client.collect(name) for name in MONITORS}
        client.wait_until(lambda: all(len(collector) >= 30 for collector in heard.values()), "the monitors")
        yield client, heard


@pytest.mark.parametrize("name", MONITORS)
def test_a_plotter_receives_a_frame_and_stamps_in_even_steps_up_to_now(plotted, name: str) -> None:
    _, heard = plotted
    received = list(heard[name].received)
    stamps = np.array([nanoseconds(one.data.header.stamp) for one in received])
    step = NS_PER_S / RigConfig().output.monitor_rate_hz
    assert set(np.diff(stamps)) == {step}
    delays = np.array([one.received_system_ns for one in received]) - stamps
    assert 0 < np.median(delays) < LATE_S * NS_PER_S
    assert {one.data.header.frame_id for one in received} == {by_name(name).frame_id}


def test_messages_mark_what_is_not_measured(plotted) -> None:
    """Unmeasured parts are marked by REP-145 (Imu), REP-117 (Range), and by a displacement along x only."""
    client, heard = plotted
    info = client.collect("daq/info")
    client.wait_until(lambda: len(info), "the calibration")
    noise = dict(zip(info.rows()["name"].tolist(), info.rows()["noise"].tolist(), strict=True))
    imu = heard["accelerometer"].messages[-1]
    assert imu.orientation_covariance[0] == imu.angular_velocity_covariance[0] == -1.0
    assert imu.linear_acceleration_covariance[0] == noise[b"accelerometer"] ** 2
    assert not any(imu.linear_acceleration_covariance[k] for k in (1, 2, 3, 5, 6, 7))
    assert (imu.linear_acceleration.y, imu.linear_acceleration.z) == (0.0, 0.0)
    distance = heard["laser"].messages[-1]
    laser = RigConfig().instruments.laser
    assert distance.min_range == pytest.approx(laser.distance_m - laser.half_range_m)
    assert distance.max_range == pytest.approx(laser.distance_m + laser.half_range_m)
    assert distance.min_range <= distance.range <= distance.max_range
    base = heard["base_displacement"].messages[-1]
    assert (base.vector.y, base.vector.z) == (0.0, 0.0)
    assert list(heard["truth/joint_states"].messages[-1].name) == ["base", "structure", "sphere"]


def test_a_narrower_laser_is_out_of_range_on_both_sides_and_the_rate_can_change(client: Client) -> None:
    host_rig(client, "realtime", drive__amplitude=0.52, time__factor=2.0)
    client.wait_active("rig")
    laser = client.collect("laser")
    client.set_parameters("rig", {"instruments.laser.half_range_m": 5e-4, "output.monitor_rate_hz": 50.0})
    shown = lambda: {message.range for message in laser.messages}  # noqa: E731  # asked again and again
    laser.clear()
    within = lambda: any(0.0495 <= distance <= 0.0505 for distance in shown())  # noqa: E731  # few are, at resonance
    client.wait_until(
        lambda: {math.inf, -math.inf} <= shown() and within() and len(laser) > 30, "readings beyond the ends and within"
    )
    last = laser.messages[-1]
    assert (last.min_range, last.max_range) == pytest.approx((0.0495, 0.0505))
    assert not any(math.isnan(distance) for distance in shown())
    stamps = [nanoseconds(message.header.stamp) for message in laser.messages[-5:]]
    assert set(np.diff(stamps)) == {NS_PER_S // 50}


def test_ros2_param_lists_types_and_reports_changes(plotted) -> None:
    client, _ = plotted
    request = ListParameters.Request(prefixes=["barriers", "time"])
    names = client.call(ListParameters, "rig/list_parameters", request).result.names
    fields = {name: default for name, _, default in config.fields()}
    assert sorted(names) == sorted(name for name in fields if name.startswith(("barriers.", "time.")))
    found = client.call(GetParameterTypes, "rig/get_parameter_types", GetParameterTypes.Request(names=list(fields)))
    assert list(found.types) == [KINDS[type(default)] for default in fields.values()]
    events: list[ParameterEvent] = []
    subscription = client.node.create_subscription(
        ParameterEvent, "/parameter_events", events.append, qos_profile_parameter_events
    )
    client.wait_until(subscription.get_publisher_count, "a publisher of events")
    client.set_parameters("rig", {"pluck.displacement_m": 1e-3})
    client.wait_until(lambda: events, "the event")
    (changed,) = events[-1].changed_parameters
    assert (changed.name, changed.value.double_value) == ("pluck.displacement_m", 1e-3)


def test_ros2_lifecycle_lists_states_and_transitions_and_reports_changes(client: Client) -> None:
    host_rig(client)
    client.wait_active("rig")
    states = client.call(GetAvailableStates, "rig/get_available_states", GetAvailableStates.Request())
    assert {"unconfigured", "inactive", "active", "finalized"} <= {s.label for s in states.available_states}
    request = GetAvailableTransitions.Request()
    possible = client.call(GetAvailableTransitions, "rig/get_available_transitions", request).available_transitions
    assert {one.transition.label for one in possible} == {"deactivate", "shutdown"}
    events: list[TransitionEvent] = []
    subscription = client.node.create_subscription(TransitionEvent, "rig/transition_event", events.append, 10)
    client.wait_until(subscription.get_publisher_count, "a publisher of transitions")
    assert client.change_state("rig", "deactivate")
    client.wait_until(lambda: any(e.goal_state.label == "inactive" for e in events), "the event")
