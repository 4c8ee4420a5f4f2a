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
"""Readers acknowledge a single block at once and the blocks of a burst together, and never a block that is not safe."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from std_msgs.msg import Header

from impact_rig import topics
from impact_rig.client import Client
from impact_rig.nodes.acknowledgements import MOST, Acknowledgements
from impact_rig.nodes.messages import nanoseconds

pytestmark = pytest.mark.ros


def _acknowledgements(client: Client, blocks: int, may_send: bool = True) -> list[Header]:
    """Return the acknowledgements received for blocks processed in one go."""
    node = host_rig(client, time__peers=[])
    node.offer(topics.ACK)
    acknowledgements = Acknowledgements(node, lambda: may_send)
    heard = client.listen(topics.ACK.name)
    for number in range(blocks):
        acknowledgements.processed(number)
    if may_send:
        client.wait_until(lambda: [*heard.messages[-1:]] and heard.messages[-1].stamp.nanosec == blocks - 1, "the last")
    else:
        client.spin_for(0.2)
    acknowledgements.flush()
    return list(heard.messages)


def test_a_single_block_is_acknowledged_at_once(client: Client) -> None:
    acknowledged = _acknowledgements(client, 1)
    assert [(header.frame_id, nanoseconds(header.stamp)) for header in acknowledged] == [("rig", 0)]


def test_blocks_of_a_burst_are_acknowledged_together_and_soon(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("impact_rig.nodes.acknowledgements.ALONE_S", 1.0)  # one burst, however busy the machine is
    stamps = [nanoseconds(header.stamp) for header in _acknowledgements(client, 3 * MOST + 3)]
    assert stamps == [0, MOST, 2 * MOST, 3 * MOST, 3 * MOST + 2]


def test_blocks_in_real_time_are_acknowledged_together_even_without_a_further_block(client: Client) -> None:
    node = host_rig(client, time__peers=[])
    node.offer(topics.ACK)
    caught_up: list[bool] = []
    acknowledgements = Acknowledgements(node, catch_up=lambda: caught_up.append(True))
    heard = client.listen(topics.ACK.name)
    now = time.time_ns()
    for number in range(MOST + 1):
        acknowledgements.processed(now + number)
    assert not heard.messages
    client.wait_until(lambda: len(heard.messages) > 0, "an acknowledgement")
    assert caught_up
    assert acknowledgements.is_timed
    acknowledgements.processed(1)  # of a rig that has left real time: it may wait for us
    assert not acknowledgements.is_timed
    client.wait_until(lambda: len(heard.messages) > 1, "another one")
    acknowledgements.flush()
    assert [nanoseconds(header.stamp) for header in heard.messages] == [now + MOST, 1]


def test_blocks_that_are_not_yet_safe_are_not_acknowledged(client: Client) -> None:
    assert _acknowledgements(client, MOST + 1, may_send=False) == []
