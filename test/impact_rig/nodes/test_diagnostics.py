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
"""Diagnostics of a running rig: the figures are present, in range, and name the problem."""

from __future__ import annotations

import re
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig

from impact_rig import codec, topics
from impact_rig.client import Client, isolated_domain
from impact_rig.client.client import Received
from impact_rig.nodes.managed import CpuMeter, Level, worst
from impact_rig.physics.contact import from_config
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S

pytestmark = pytest.mark.ros
CLOSED = 1e-6
"""Relative imbalance of a closed energy account; contacts are integrated to 1e-9."""


def test_a_running_rig_reports_rates_energy_faults_and_over_ranges(client: Client) -> None:
    fault = "saturation channel=laser start_s=0 value=1e-5"
    rig = {"drive__amplitude": 0.52, "barriers__gap_m": 0.002, "instruments__faults__planned": [fault]}
    host_rig(client, "realtime", **rig)  # no faster: a rig that is late on a busy machine reports only that
    client.wait_active("rig")
    client.wait_until(lambda: float(client.figures("rig").get("rig_time_s", 0.0)) > 4.0, "some rig time")
    found = client.figures("rig")
    assert 0 < time.time_ns() - int(found["start_ns"]) < 600 * 10**9
    assert 0.0 < float(found["block_rate_hz"]) < 600.0  # 400, less on a busy machine, more while it catches up
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
    client.wait_until(  # a rig that is late reports that first
        lambda: "faults active: saturation/laser" in client.status("rig").message, "the fault's name", 60.0
    )


def test_a_slow_reader_is_named_in_real_time_until_it_leaves(client: Client) -> None:
    """No node waits for it, so the rig can only report it."""
    host_rig(client, "realtime", time__factor=4.0)
    client.wait_active("rig")
    silent = False

    def acknowledge(message: Received) -> None:
        if not silent:  # it reads on all the same
            client.acknowledge_for("client", codec.header_stamp_ns(message.data))

    client.collect("daq/scan").then(acknowledge)
    client.wait_until(lambda: "behind.client" in client.figures("rig"), "an acknowledgement")
    silent = True
    client.wait_until(lambda: re.search(r"client is \d+ s behind", client.status("rig").message), "the warning")
    assert client.status("rig").level == b"\1"
    assert int(client.figures("rig")["behind.client"]) > 400
    (subscription,) = [s for s in client.node.subscriptions if s.topic_name == f"/{topics.SCAN.name}"]
    client.node.destroy_subscription(subscription)
    client.wait_until(lambda: "behind" not in client.status("rig").message, "the warning to be gone")
    assert "behind.client" not in client.figures("rig")


def test_a_reader_too_slow_to_receive_all_scans_is_named_and_counted(client: Client) -> None:
    """The rig keeps 250 blocks of 0.1 s; a slower reader loses the older ones."""
    host_rig(client, "realtime", time__factor=20.0, daq__block_scans=1000)
    client.wait_active("rig")
    silent = False
    client.collect("daq/scan").then(
        lambda message: client.acknowledge_for("client", codec.header_stamp_ns(message.data)) if not silent else None
    )
    client.wait_until(lambda: "behind.client" in client.figures("rig"), "an acknowledgement")
    silent = True
    client.wait_until(lambda: int(client.figures("rig").get("lost.client", 0)) > 0, "the count", 30.0)
    assert re.search(r"client is \d+ s behind in reading daq/scan and loses scans", client.status("rig").message)


def test_the_worst_message_is_shown_and_equally_bad_ones_are_joined() -> None:
    assert worst((Level.OK, "fine"), (Level.WARN, "one"), (Level.WARN, "two")) == (Level.WARN, "one; two")
    assert worst() == (Level.OK, "")


def test_the_share_of_a_core_is_that_since_the_last_report() -> None:
    wall, used = iter((10.0, 12.0, 12.0)), iter((1.0, 1.5, 1.5))
    meter = CpuMeter(clock=lambda: next(wall), used=lambda: next(used))
    assert [meter.percent() for _ in range(3)] == [0.0, 25.0, 0.0]


def test_a_step_of_the_system_clock_is_reported_and_moves_no_stamp(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock goes back by an hour: the monotonic clock paces the rig, so no block is late, duplicated or missing."""
    host_rig(client, "realtime")
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    client.wait_until(lambda: len(scans) >= 5, "blocks")
    system_ns = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: system_ns() - 3600 * NS_PER_S)
    client.wait_until(lambda: "set by -3600.000 s" in client.status("rig").message, "the warning")
    count = len(scans)
    client.wait_until(lambda: len(scans) >= count + 20, "more blocks")
    stamps = [table.stamp_ns for table in scans.tables()]
    assert set(np.diff(stamps)) == {COMMAND_GRID_NS}
    assert client.figures("rig")["slips"] == "0"


def test_two_rigs_in_two_namespaces_do_not_affect_each_other() -> None:
    """Commands, services, parameters and diagnostics of one rig never reach the other."""
    with isolated_domain() as domain, Client(domain, "/one") as one, Client(domain, "/two") as two:
        for user, gap in ((one, 0.002), (two, 0.008)):
            host_rig(user, time__peers=["client"], time__publish_clock="never", barriers__gap_m=gap)
            user.wait_active("rig")
        scans = {user: user.collect("daq/scan", acknowledge=True) for user in (one, two)}
        one.command(current_a=0.5)
        one.step(7)
        one.trigger("rig/stop")
        two.step(3)
        row = two.command(current_a=0.25)
        assert row["sample"] == 300
        assert (len(scans[one]), len(scans[two])) == (7, 3)
        assert one.get_parameters("rig", ["barriers.gap_m"]) == {"barriers.gap_m": 0.002}
        assert two.get_parameters("rig", ["barriers.gap_m"]) == {"barriers.gap_m": 0.008}
        one.wait_until(lambda: "latched" in one.status("rig").message, "the diagnostics of the one")
        two.wait_until(lambda: two.figures("rig").get("current_a") == "0.25", "the diagnostics of the other")
        assert (one.status("rig").name, one.status("rig").hardware_id) == ("one/rig: simulation", "impact_rig/one")
        assert (two.status("rig").name, two.status("rig").hardware_id) == ("two/rig: simulation", "impact_rig/two")
        assert two.status("rig").level == b"\0"
