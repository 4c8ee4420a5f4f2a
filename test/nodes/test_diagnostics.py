"""What the rig says about itself while it runs: the figures are there, in range, and name what is the matter."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from nodes_support import host_rig

from impact_rig.config import RigConfig
from impact_rig.nodes import topics
from impact_rig.nodes.diagnostics import CpuMeter, Level, worst
from impact_rig.physics.contact import from_config
from impact_rig.testing import Client

pytestmark = pytest.mark.ros
CLOSED = 1e-6
"""Relative imbalance of a closed energy account; contacts are integrated to 1e-9."""


def test_a_running_rig_reports_rates_energy_faults_and_over_ranges(client: Client) -> None:
    fault = "saturation channel=laser start_s=0 value=1e-5"
    host_rig(
        client, "realtime", drive__amplitude=0.52, barriers__gap_m=0.002, instruments__faults__planned=[fault],
        time__factor=4.0,
    )  # fmt: skip
    client.wait_active("rig")
    client.wait_until(lambda: float(client.figures("rig").get("rig_time_s", 0.0)) > 4.0, "some rig time")
    found = client.figures("rig")
    assert float(found["block_rate_hz"]) == pytest.approx(400.0, rel=0.3)
    assert 0.0 < float(found["cpu_percent"]) <= 200.0
    assert 0.0 <= float(found["lateness_median_ms"]) <= float(found["lateness_p99_ms"])
    assert float(found["lateness_p99_ms"]) <= float(found["lateness_worst_ms"])
    assert int(found["impacts"]) > 10
    assert float(found["energy_work_j"]) > float(found["energy_lost_j"]) > 0.0
    assert float(found["energy_imbalance"]) < CLOSED
    assert float(found["restitution"]) == 0.35
    law = from_config(RigConfig().contact)
    assert float(found["realised_restitution"]) == pytest.approx(law.realised_restitution(), rel=1e-5)
    assert (found["active_faults"], found["faults"]) == ("1", "saturation/laser")
    assert int(found["over_range.laser"]) > 1000
    assert found["over_range.base"] == "0"
    assert "faults active: saturation/laser" in client.status("rig").message


def test_a_slow_reader_is_named_in_real_time_and_one_that_leaves_forgotten(client: Client) -> None:
    """Nobody waits for it, so the rig can only say so."""
    node = host_rig(client, "realtime", time__factor=4.0)
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.wait_until(lambda: "client" in node._audience.behind(), "an acknowledgement")
    scans._on_message = None  # reads on, but falls silent
    client.wait_until(lambda: "client is 1 s behind" in client.status("rig").message, "the warning")
    assert client.status("rig").level == b"\1"
    assert int(client.figures("rig")["behind.client"]) > 400
    (subscription,) = [s for s in client.node.subscriptions if s.topic_name == f"/{topics.SCAN.name}"]
    client.node.destroy_subscription(subscription)
    client.wait_until(lambda: client.status("rig").message == "running, realtime", "the warning to be gone")
    assert "behind.client" not in client.figures("rig")


def test_the_worst_message_wins_and_equals_are_joined() -> None:
    assert worst((Level.OK, "fine"), (Level.WARN, "one"), (Level.WARN, "two")) == (Level.WARN, "one; two")
    assert worst() == (Level.OK, "")


def test_the_share_of_a_core_is_that_since_the_last_look() -> None:
    wall, used = iter((10.0, 12.0, 12.0)), iter((1.0, 1.5, 1.5))
    meter = CpuMeter(clock=lambda: next(wall), used=lambda: next(used))
    assert [meter.percent() for _ in range(3)] == [0.0, 25.0, 0.0]
