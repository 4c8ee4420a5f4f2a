# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Acknowledgements of blocks: a single one at once, those of a burst together."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any  # settings of any node

from std_msgs.msg import Header

from impact_rig import topics
from impact_rig.nodes.guard import guarded
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.template import Template
from impact_rig.simtime import NS_PER_S

UNHURRIED_S = 0.05
"""Time between acknowledgements of a rig in real time, which waits for nobody and only wants to know who is late."""
PRESENT_NS = NS_PER_S
"""Stamps this near to the system's time are those of a rig in real time; in the other modes they begin at 0."""
ALONE_S = 0.004
"""A block that comes this long after the last acknowledgement is acknowledged at once."""
MOST = 16
"""Blocks acknowledged together, at most: as many as a rig runs ahead by default."""


class Acknowledgements:
    """Says on daq/ack up to which block a node has processed daq/scan.

    A block that comes alone is acknowledged at once. Of a burst the executor is asked to come back when it has handed
    over what is waiting, and one acknowledgement stands for all: a rig that runs ahead sends blocks in bursts, and each
    message costs its sender and its receiver more than the block it is about. Those of real time wait for a timer.

    Args:
        node: owner; its name is the peer's.
        may_send: called before each acknowledgement; keeps the promise it makes, or returns False if that cannot be.
    """

    def __init__(self, node: ManagedNode[Any], may_send: Callable[[], bool] = lambda: True) -> None:
        self._node = node
        self._may_send = may_send
        self._later = guarded(self._send, node.report_failure)
        self._publisher = node.publisher(topics.ACK)
        self._message = Template(Header(frame_id=node.get_name()))
        self._newest_ns = 0
        self._waiting = 0
        self._sent_at = 0.0
        self._timer: Any = None

    def processed(self, stamp_ns: int) -> None:
        """Note that the block with this stamp is processed."""
        self._newest_ns = stamp_ns
        self._waiting += 1
        if abs(time.time_ns() - stamp_ns) < PRESENT_NS:
            self._timer = self._timer or self._node.steady_timer(UNHURRIED_S, self._send)
            return
        executor = self._node.executor
        if self._waiting >= MOST or executor is None:
            self._send()
        elif self._waiting == 1:
            if time.monotonic() - self._sent_at > ALONE_S:
                self._send()
            else:
                executor.create_task(self._later)

    def destroy(self) -> None:
        """Say what has not been said, and destroy the publisher."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        if self._node.context.ok():
            self._send()
        self._node.destroy_publisher(self._publisher)

    def _send(self) -> None:
        waiting, self._waiting = self._waiting, 0  # what must not be acknowledged now never is by itself
        if waiting and self._may_send():
            self._sent_at = time.monotonic()
            self._publisher.publish(self._message.render(self._newest_ns))
