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
"""Text for the user: lines of the log, and names in diagnostics."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from rcl_interfaces.msg import Log
from rclpy.logging import LoggingSeverity
from rclpy.qos import QoSDurabilityPolicy, QoSProfile

from impact_rig.client import Client, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.errors import ConfigError
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.nodes.rig_state import summary
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_studies.stepped_sine_node import SteppedSineNode

pytestmark = pytest.mark.ros
FAULT = "saturation channel=laser start_s=0.1 duration_s=0.2 value=1e-5"


class Console:
    """Lines of the nodes of a domain on /rosout: (level, node, text)."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.lines: list[tuple[int, str, str]] = []
        qos = QoSProfile(depth=1000, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        client.node.create_subscription(Log, "/rosout", self._on_log, qos)

    def _on_log(self, message: Log) -> None:
        self.lines.append((message.level, message.name, message.msg))

    def wait(self, level: LoggingSeverity, text: str) -> None:
        """Wait until a line of this level contains the text."""
        found = lambda: any(line[0] == level.value and text in line[2] for line in self.lines)  # noqa: E731  # asked again
        self.client.wait_until(found, f"{text!r} in the log, which has {self.lines}")

    def count(self, text: str) -> int:
        """Return the number of lines that contain the text."""
        return sum(text in line[2] for line in self.lines)


def test_a_rig_logs_its_start_its_trips_and_peers_that_left(client: Client) -> None:
    console = Console(client)
    node = host_rig(client, drive__frequency_hz=8.0, instruments__faults__planned=[FAULT], daq__seed=7)
    console.wait(LoggingSeverity.INFO, "configured")
    console.wait(LoggingSeverity.INFO, "running: lockstep, 10000 scans/s, gap 6 mm, contact law flores, seed 7")
    node.get_logger().set_level(LoggingSeverity.DEBUG)
    client.command(current_a=8.0)
    console.wait(LoggingSeverity.DEBUG, "accepted: amplitude = 8")
    client.step(20)
    console.wait(LoggingSeverity.WARN, "instrument fault 1 has started: saturation/laser")
    client.step(20)
    console.wait(LoggingSeverity.INFO, "instrument fault 1 has ended: saturation/laser")
    client.step(200)
    console.wait(LoggingSeverity.WARN, "tripped: shaker latched by over_travel")
    client.trigger("rig/clear_trip")
    console.wait(LoggingSeverity.INFO, "latch released")
    client.trigger("rig/reset")
    console.wait(LoggingSeverity.INFO, "reset: the rig starts again at scan 0")
    assert client.change_state("rig", "deactivate")
    console.wait(LoggingSeverity.INFO, "deactivated")
    node.close()
    console.wait(LoggingSeverity.INFO, "ended")
    assert console.count("tripped") == 1, "once, however long it lasts"


def test_of_many_faults_the_first_are_named_and_the_others_counted(client: Client) -> None:
    console = Console(client)
    host_rig(client, instruments__faults__planned=[FAULT] * 7)
    client.wait_active("rig")
    for verb, level in (("started", LoggingSeverity.WARN), ("ended", LoggingSeverity.INFO)):
        client.step(20)
        console.wait(level, f"2 further instrument faults have {verb}")
        assert [console.count(f"instrument fault {number} has {verb}") for number in range(1, 8)] == [1] * 5 + [0] * 2


def test_a_silent_peer_is_logged_once_and_its_return_too(client: Client) -> None:
    console = Console(client)
    host_rig(client, "free_running", time__peers=["client"], time__peer_timeout_s=0.3)
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    console.wait(LoggingSeverity.WARN, "peer client is silent: it does not acknowledge blocks of daq/scan")
    client.acknowledge_for("client", scans.tables()[-1].stamp_ns)
    console.wait(LoggingSeverity.INFO, "peer client acknowledges daq/scan again")


def test_diagnostics_are_named_by_node_and_component_with_a_device_per_rig() -> None:
    with isolated_domain() as domain_id, Client(domain_id, "/cell/two") as client:
        for kind in (AnalysisNode, RecorderNode, SteppedSineNode):
            client.host(kind, parameter_overrides=ros_parameters({"autostart": False}))
        host_rig(client, output__autostart=False)
        components = {"rig": "simulation", "analysis": "measurement", "recorder": "recording", "stepped_sine": "sweep"}
        for node, component in components.items():
            client.wait_until(lambda node=node: node in client.diagnostics, f"diagnostics of {node}")
            status = client.status(node)
            assert (status.name, status.hardware_id) == (f"cell/two/{node}: {component}", "impact_rig/cell/two")


def test_the_publisher_of_the_clock_rejects_use_sim_time(client: Client) -> None:
    host_rig(client)
    client.wait_active("rig")
    with pytest.raises(ConfigError, match="use_sim_time must be false for this node, which publishes the clock"):
        client.set_parameters("rig", {"use_sim_time": True})
    client.set_parameters("rig", {"use_sim_time": False})
    assert client.get_parameters("rig", ["use_sim_time"]) == {"use_sim_time": False}


def test_a_rig_started_with_use_sim_time_is_not_configured(client: Client) -> None:
    console = Console(client)
    client.host(RigNode, parameter_overrides=ros_parameters({"use_sim_time": True}))
    console.wait(LoggingSeverity.ERROR, "cannot configure: use_sim_time must be false for this node")
    assert client.state("rig") == "unconfigured"


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({}, "realtime x 1, 10000 scans/s, gap 6 mm, contact law flores, seed 1"),
        (
            {"time.factor": 0.5, "contact.law": "hertz"},
            "realtime x 0.5, 10000 scans/s, gap 6 mm, contact law hertz, seed 1",
        ),
        (
            {"time.mode": "free_running", "time.peers": ["a"], "sphere.present": False},
            "free_running, 10000 scans/s, no sphere, seed 1",
        ),
    ],
)
def test_one_line_summarises_the_settings_of_a_run(values: dict[str, object], line: str) -> None:
    assert summary(from_flat(RigConfig(), values)) == line
