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
"""The analysis node gives the results of `Tracker`, and acknowledges every block."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from rclpy.serialization import deserialize_message

from impact_rig import codec, topics
from impact_rig.analysis.settings import GapLabel, parse_label
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import Table
from impact_rig.client import Client
from impact_rig.client.client import ros_parameters
from impact_rig.errors import ConfigError
from impact_rig.instruments.section import SCAN
from impact_rig.nodes import messages
from impact_rig.nodes.analysis_node import AnalysisNode

pytestmark = pytest.mark.ros


def test_the_rows_of_the_node_equal_those_of_the_tracker_bit_for_bit(client: Client) -> None:
    client.host(AnalysisNode, parameter_overrides=ros_parameters({"gap_m": 0.006}))
    host_rig(client, time__peers=["analysis", "client"])
    client.wait_active("rig", "analysis")
    names = ("daq/info", "shaker/applied", "transmissibility", "transmissibility/table", "impacts")
    heard = {name: client.collect(name) for name in names}
    scans = client.collect("daq/scan", acknowledge=True)
    client.command(current_a=0.52)
    client.step(2000)
    client.wait_until(lambda: len(heard["transmissibility"]) >= 2, "settled values")

    tracker = Tracker()
    (info,) = heard["daq/info"].tables()
    tracker.configure(info)
    tracker.label(0.006, info.stamp_ns)
    for table in heard["shaker/applied"].tables():
        tracker.on_applied(table)
    found = [tracker.feed(table) for table in scans.tables()]
    expected = [table for one in found for table in one.measurements]
    assert [t.stamp_ns for t in heard["transmissibility/table"].tables()] == [t.stamp_ns for t in expected]
    assert heard["transmissibility/table"].rows().tobytes() == np.concatenate([t.rows for t in expected]).tobytes()
    impacts = np.concatenate([table.rows for one in found for table in one.impacts])
    assert heard["impacts"].rows().tobytes() == impacts.tobytes()
    settled = [row["transmissibility"] for t in expected for row in t.rows if row["settled"] == 1]
    assert [message.data for message in heard["transmissibility"].messages] == settled
    assert heard["transmissibility/table"].rows()["gap"].tolist() == [0.006] * len(expected)


@pytest.mark.parametrize("last_s", [math.nan, math.inf, 1e300])
def test_an_invalid_time_yields_a_status_and_the_block_is_acknowledged(client: Client, last_s: float) -> None:
    """A rig that waits for the analysis must not stop because of invalid scans."""
    node = client.host(AnalysisNode)
    client.wait_active("analysis")
    acknowledged = client.collect("daq/ack")
    rows = np.zeros(10, SCAN)
    rows["time"][-1] = last_s
    rows["time"][:-1] = np.arange(9) / 1e4
    client.publish(topics.SCAN, deserialize_message(codec.encode(Table(7, rows)), messages.class_of(topics.SCAN)))
    client.wait_until(lambda: acknowledged.messages, "the acknowledgement")
    assert acknowledged.messages[0].stamp.nanosec == 7
    assert "exception" not in node.refusals.counts
    assert node.refusals.counts["daq/scan"] == 1
    assert "time must be" in node.refusals.last["daq/scan"]


def test_blocks_are_acknowledged_after_a_failed_deactivation(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks in real time are acknowledged again, although the timer ended with the failed deactivation."""
    client.host(AnalysisNode)
    host_rig(client, "realtime")
    client.wait_active("rig", "analysis")
    acknowledged = client.collect("daq/ack")
    client.wait_until(lambda: len(acknowledged), "an acknowledgement")
    with monkeypatch.context() as patch:
        patch.setattr(Tracker, "flush", lambda _self: 1 / 0)
        client.change_state("analysis", "deactivate")
    acknowledged.clear()
    assert client.change_state("analysis", "activate")
    client.wait_until(lambda: len(acknowledged) > 2, "acknowledgements")


def test_labels_are_set_by_remarks_or_by_a_parameter(client: Client) -> None:
    client.host(AnalysisNode)
    host_rig(client, time__peers=["analysis"])
    client.wait_active("rig", "analysis")
    client.step(3)
    client.set_parameters("analysis", {"gap_m": 0.004})
    client.note(GapLabel(0.008, 50_000_000).text())
    client.note("the operator sneezed")

    measured = client.collect("transmissibility/table")

    def labelled() -> bool:
        client.step(100)  # a label acts when scans are measured, and remarks may arrive after them
        return bool(np.any(measured.rows()["gap"] == 0.008))

    client.wait_until(labelled, "the label to take effect")
    with pytest.raises(ConfigError, match="deactivate"):
        client.set_parameters("analysis", {"windows": 16})
    with pytest.raises(ConfigError, match="-1 for unknown"):
        client.set_parameters("analysis", {"gap_m": -0.5})


@pytest.mark.parametrize("label", [GapLabel(0.1 + 0.2, 0), GapLabel(0.0, 5), GapLabel(1e-3, 2**60)])
def test_the_parameter_of_a_label_reads_back_exactly(label: GapLabel) -> None:
    assert parse_label(label.text()) == label


@pytest.mark.parametrize(
    "remark",
    ["", "gap_m=6 at 0", "gap_m=-1 at 0", "gap_m=0.006", "gap_m=e at 1", "gap_m=0.1 at -5", "gap_m=0.1 at " + "9" * 30],
)
def test_other_remarks_are_not_labels(remark: str) -> None:
    assert parse_label(remark) is None


def test_a_label_can_state_an_unknown_gap() -> None:
    label = parse_label(GapLabel(math.nan, 7).text())
    assert label is not None
    assert math.isnan(label.gap_m)
