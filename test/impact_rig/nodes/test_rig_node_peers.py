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
"""The rig waits for its configured peers, names a silent one, and is held up by no other node."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import TICK, host_rig
from rclpy.qos import DurabilityPolicy
from std_msgs.msg import Header

from impact_rig import topics
from impact_rig.client import Client, ServiceFailedError, WaitTimeoutError
from impact_rig.errors import ConfigError
from impact_rig.nodes import messages

pytestmark = pytest.mark.ros


def test_a_silent_peer_pauses_the_rig_and_is_named_until_the_rig_is_resumed(client: Client) -> None:
    host_rig(client, "free_running", time__peers=["client"], time__peer_timeout_s=0.5, time__ack_window=4)
    client.wait_active("rig")
    scans = client.collect("daq/scan")  # listens, but never acknowledges
    silent = "peer client silent, no block of daq/scan acknowledged for 0.5 s"
    client.wait_until(lambda: silent in client.status("rig").message, "the diagnostic")
    assert client.status("rig").level == b"\2"
    assert len(scans) == 4, "no further than the window"
    client.pause(False)
    client.wait_until(lambda: len(scans) == 8, "the next window")
    with pytest.raises(ConfigError, match="peers must name the nodes whose acknowledgements pace the rig"):
        client.set_parameters("rig", {"time.peers": [""]})


def test_a_free_running_rig_waits_for_peers_that_have_not_started(client: Client) -> None:
    host_rig(client, "free_running", time__peers=["client", "absent"])
    client.wait_active("rig")
    client.wait_until(lambda: "waiting for peer" in client.status("rig").message, "the diagnostic")
    assert "absent" in client.status("rig").message
    client.set_parameters("rig", {"time.peers": ["client"]})
    scans = client.collect("daq/scan", acknowledge=True)
    client.wait_until(lambda: len(scans) > 20, "blocks")
    assert scans.tables()[0].stamp_ns == 0, "the first block was not lost to the late peer"


def test_invalid_acknowledgements_are_counted_and_have_no_effect(client: Client) -> None:
    node = host_rig(client, time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.step(2)
    for stamp in (10**15, 2 * TICK):
        header = Header(frame_id="client")
        header.stamp.sec, header.stamp.nanosec = divmod(stamp, 10**9)
        client.publish(topics.ACK, header)
    client.publish(topics.ACK, Header(frame_id="absent"))
    client.wait_until(lambda: node.refusals.counts["daq/ack"] == 2, "the refusals")
    client.step(2)
    assert len(scans) == 4


def test_a_step_waits_for_the_slowest_peer(client: Client) -> None:
    host_rig(client, time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    with pytest.raises(WaitTimeoutError, match="rig/step"):
        client.trigger("rig/step", timeout_s=0.5)
    assert len(scans) == 1


def test_a_subscriber_with_incompatible_qos_does_not_hold_up_the_rig(client: Client) -> None:
    """The subscriber requests history that daq/scan does not offer, so it never matches; the peer counts as present."""
    profile = messages.profile(topics.SCAN.qos)
    profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    client.node.create_subscription(messages.class_of(topics.SCAN), topics.SCAN.name, lambda _: None, profile)
    host_rig(client, time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.step(3)
    assert len(scans) == 3


def test_a_step_without_its_peer_is_rejected_with_the_name_of_the_peer(client: Client) -> None:
    host_rig(client, time__peers=["absent"], time__peer_timeout_s=0.3)
    client.wait_active("rig")
    with pytest.raises(ServiceFailedError, match="peer absent does not subscribe"):
        client.step(1)
    client.wait_until(lambda: client.status("rig").level == b"\x02", "an error in the diagnostics")
    assert "waiting for peer absent" in client.status("rig").message


def test_free_running_without_peers_is_rejected(client: Client) -> None:
    rig = host_rig(client, mode="free_running")
    assert "peers must name the nodes whose acknowledgements pace the rig" in str(rig.parameters.refused)


def test_the_rig_does_not_wait_for_a_restarted_peer_to_acknowledge_old_blocks(client: Client) -> None:
    """A restarted recorder received none of the earlier blocks, so the rig must not wait for it to acknowledge them."""
    host_rig(client, "free_running", time__peers=["client"], time__peer_timeout_s=0.5, time__ack_window=4)
    client.wait_active("rig")
    dead = client.subscribe(topics.SCAN, lambda *_: None, raw=True)
    client.wait_until(lambda: "client silent" in client.status("rig").message, "the diagnostic")
    client.node.destroy_subscription(dead)
    scans = client.collect("daq/scan", acknowledge=True)
    client.wait_until(lambda: len(scans) > 20, "blocks")
    client.wait_until(lambda: "silent" not in client.status("rig").message, "the diagnostic to go")


def test_a_resumed_rig_continues_without_the_silent_peer(client: Client) -> None:
    host_rig(client, "free_running", time__peers=["client", "other"], time__peer_timeout_s=0.5, time__ack_window=4)
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    with Client(client.context.get_domain_id(), namespace=client.node.get_namespace(), name="other") as other:
        other.collect("daq/scan")  # listens, but never acknowledges
        client.wait_until(lambda: "other silent" in client.status("rig").message, "the diagnostic")
        client.pause(False)
        client.wait_until(lambda: len(scans) > 40, "many more than a window")
        client.wait_until(lambda: "running without peer other" in client.status("rig").message, "the diagnostic")


def test_the_rig_does_not_wait_for_peers_of_a_rejected_change(client: Client) -> None:
    """The rig must not wait for a peer whose addition was rejected together with another parameter."""
    host_rig(client, "free_running", time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.wait_until(lambda: len(scans) > 5, "blocks")
    with pytest.raises(ConfigError, match="must not outweigh"):
        client.set_parameters("rig", {"time.peers": ["client", "ghost"], "sphere.diameter_m": 0.2})
    assert client.get_parameters("rig", ["time.peers"])["time.peers"] == ["client"]
    before = len(scans)
    client.wait_until(lambda: len(scans) > before + 50, "that it goes on")
