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
"""Capacity of the middleware alone: three bare rclpy processes exchange the messages of a rig, without a rig.

A source publishes scans of 10 ms at 10 kS/s, monitors and clock as ready-made bytes. A reader acknowledges every scan,
and a keeper writes all bytes to a file and acknowledges, too. The source stays at most a window ahead of the slower of
the two.

Free-running, this measures the limit without simulation, analysis or MCAP; the ratio to it, measured in the same
minute, shows how close our graph comes. The source sends five messages per block, a rig 3.4. On the other hand, threads
of DDS interrupt it, as in every rclpy node; with threads as patient as those of our nodes it carries nearly twice as
much.

Alternatively, the source publishes a block every 10 ms. This measures the least load that a rig, its analysis and its
recorder put on a core in real time.

    python -m benchmarks.wire [SECONDS]
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any  # rclpy handles

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from benchmarks.cpu import cpu_share
from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.client import Client, Processes, isolated_domain
from impact_rig.instruments.section import row_type_of
from impact_rig.nodes import messages
from impact_rig.nodes.messages import MONITORS
from impact_rig.nodes.process import make_executor, patient_threads
from impact_rig.rig.config import RigConfig

BLOCKS_PER_S, SCANS = 100, 100
SPIN_S = 0.05
MONITORED_BLOCKS = 2
"""One of this many blocks has monitors in real time, at the default rates."""
WARM_UP_S = 2.0
READERS = ("reader", "keeper")
PATIENT = "PATIENT"  # environment variable: whether the threads of DDS wait their turn
_OTHERS = [*MONITORS.values(), topics.CLOCK]


def run(seconds: float, window: int, patient: bool = False) -> float:
    """Return the capacity as a multiple of real time; with `patient`, threads of DDS wait their turn."""
    with _wire("source", str(seconds), str(window), patient=patient) as (client, processes):
        log = processes.running["source"].log
        client.wait_until(lambda: b"wall" in log.read_bytes(), "the source to end", seconds + 60.0)
        found = json.loads(log.read_text().splitlines()[-1])
    return float(found["blocks"] / BLOCKS_PER_S / found["wall"])


def run_paced(seconds: float) -> dict[str, float]:
    """Measure the load of the three processes in real time [% of a core], with a client that also reads the scans."""
    with _wire("paced") as (client, processes):
        client.collect(topics.SCAN.name)
        client.spin_for(WARM_UP_S)
        shares = {name: cpu_share(process.pid) for name, process in processes.running.items()}
        client.spin_for(seconds)
        return {f"wire_live_{name}_cpu_percent": share() for name, share in shares.items()}


@contextlib.contextmanager
def _wire(role: str, *words: str, patient: bool = False) -> Iterator[tuple[Client, Processes]]:
    """Run readers and a source of that role as processes, with a client."""
    with (
        tempfile.TemporaryDirectory() as directory,
        isolated_domain() as domain_id,
        Processes(domain_id, Path(directory)) as processes,
        Client(domain_id, processes=processes) as client,
    ):
        environment = {PATIENT: "1" if patient else ""}
        for name, *arguments in (*((reader, reader) for reader in READERS), ("source", role, *words)):
            command = [sys.executable, "-m", "benchmarks.wire", *arguments]
            processes.start(name, command=command, environment=environment)
        yield client, processes


def _messages() -> dict[topics.Topic, bytes]:
    """Return the messages of one block."""
    scans = np.zeros(SCANS, row_type_of(RigConfig().instruments))
    return {
        topics.SCAN: codec.encode(Table(0, scans)),
        **{topic: serialize_message(messages.class_of(topic)()) for topic in _OTHERS},
    }


class Source:
    """Source that publishes blocks as far ahead of the readers as the window allows."""

    def __init__(self, node: Node, window: int) -> None:
        self.acknowledged = dict.fromkeys(READERS, 0)
        self._window, self._sent = window, 0
        self._outlets = [
            (node.create_publisher(messages.class_of(topic), topic.name, messages.profile(topic.qos)), data)
            for topic, data in _messages().items()
        ]
        node.create_subscription(Header, topics.ACK.name, self._on_ack, messages.profile(topics.ACK.qos))

    def matched(self) -> bool:
        """Matching of the readers: true if both have subscribed."""
        return all(publisher.get_subscription_count() >= 1 for publisher, _ in self._outlets) and (
            self._outlets[0][0].get_subscription_count() == len(READERS)
        )

    def run_ahead(self) -> None:
        """Publish as many blocks as fit into the window, if that is at least half of it."""
        room = self._window - (self._sent - min(self.acknowledged.values()))
        if room < self._window // 2:
            return
        for _ in range(room):
            for publisher, data in self._outlets:
                publisher.publish(data)
            self._sent += 1

    def publish(self) -> None:
        """Publish a block of real time; every other one has monitors."""
        monitored = self._sent % MONITORED_BLOCKS == 0
        for publisher, data in self._outlets if monitored else self._outlets[:1]:
            publisher.publish(data)
        self._sent += 1

    def _on_ack(self, message: Header) -> None:
        self.acknowledged[message.frame_id] += 1
        self.run_ahead()


def _paced() -> None:
    node = _node("source")
    source = Source(node, window=0)  # it never runs ahead
    node.create_timer(1.0 / BLOCKS_PER_S, source.publish)
    spin = _spinner(node)
    while rclpy.ok():
        spin()


def _source(seconds: float, window: int) -> None:
    node = _node("source")
    source = Source(node, window)
    spin = _spinner(node)
    while not source.matched():
        spin()
    began = time.monotonic()
    source.run_ahead()
    while (wall := time.monotonic() - began) < seconds:
        spin()
    print(json.dumps({"blocks": min(source.acknowledged.values()), "wall": wall}), flush=True)


def _reader(name: str) -> None:
    node = _node(name)
    acknowledge = node.create_publisher(Header, topics.ACK.name, messages.profile(topics.ACK.qos)).publish
    done = Header(frame_id=name)
    with tempfile.TemporaryFile() as file:
        keep: Callable[[bytes], Any] = file.write if name == "keeper" else lambda _data: None

        def on_scan(data: bytes) -> None:
            keep(data)
            acknowledge(done)

        for topic in [topics.SCAN, *(_OTHERS if name == "keeper" else ())]:
            callback = on_scan if topic is topics.SCAN else keep
            profile = messages.profile(topic.qos)
            node.create_subscription(messages.class_of(topic), topic.name, callback, profile, raw=True)
        spin = _spinner(node)
        while rclpy.ok():
            spin()


def _node(name: str) -> Node:
    with patient_threads() if os.environ.get(PATIENT) else contextlib.nullcontext():
        return Node(name)


def _spinner(node: Node) -> Callable[[], None]:
    executor = make_executor()
    executor.add_node(node)
    return functools.partial(executor.spin_once, timeout_sec=SPIN_S)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["-h" | "--help", *_]:
            print(f"usage: python -m benchmarks.wire [SECONDS]\n\n{__doc__}")
        case ["source", seconds, window, *_]:
            rclpy.init()
            _source(float(seconds), int(window))
        case ["paced", *_]:
            rclpy.init()
            _paced()
        case [("reader" | "keeper") as role, *_]:
            rclpy.init()
            _reader(role)
        case words:
            seconds_each = float((words or ["10"])[0])
            print([run(seconds_each, 64, patient) for patient in (False, True)], run_paced(seconds_each))
