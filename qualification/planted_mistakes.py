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
"""Find 20 planted mistakes in small ROS nodes by searching schedules of their callbacks.

Each node exists with its mistake and without it. The search must find the mistake, reduce it to at most three actions
and repeat the callbacks byte for byte; it must find nothing in the node without the mistake.

Run it with `python -m qualification.planted_mistakes [NAME...]`. Exit code 1 if fewer than 18 mistakes are found within
two minutes each, or a sound node fails.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import json
import runpy
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from typing import Any, ClassVar  # Any: messages have no common base

from hypothesis import strategies as st
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool, Empty, Float64, String
from std_srvs.srv import Trigger

from impact_rig import codec
from impact_rig.nodes.messages import nanoseconds
from impact_rig.testing.schedule import LocalRigWithNodes
from impact_rig.testing.strategies import schedules, search

QUICK = {"daq.rate_hz": 1000, "daq.block_scans": 10, "output.truth_scan": True}
BLOCK_NS = 10_000_000
LIMIT_S, MOST_ACTIONS, LEAST_FOUND, REPETITIONS = 120.0, 3, 18, 100
EXAMPLES = 200
DEEP = QoSProfile(depth=1000)
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LOSSY = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


class Planted(Node):
    """Node under test.

    Attributes:
        is_sound: whether the code without the mistake runs.
        inputs: arguments of `schedules` for this node.
    """

    is_sound = False
    inputs: ClassVar[dict[str, Any]] = {}

    def __init__(self) -> None:
        super().__init__("planted")
        self.out = self.create_publisher(Float64, "out", 10)
        self.blocks: dict[int, int] = {}  # stamp -> scans
        self.begin()

    def begin(self) -> None:
        """Create subscriptions, timers and parameters."""
        raise NotImplementedError

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        """Assert what the node has published, given the first block after it joined."""
        raise NotImplementedError

    def say(self, value: float) -> None:
        """Publish a number."""
        self.out.publish(Float64(data=float(value)))

    def on(self, topic: str, callback: Callable[[Any], None], kind: Any = PointCloud2, qos: QoSProfile = DEEP) -> None:
        """Subscribe to a topic."""
        self.create_subscription(kind, topic, callback, qos)

    def now_ns(self) -> int:
        """Return the time of the node's clock."""
        return int(self.get_clock().now().nanoseconds)


def scans_since(rig: LocalRigWithNodes, since: int) -> int:
    """Return the number of scans that the rig has published since a stamp."""
    return sum(len(table.rows) for table in rig.tables() if table.stamp_ns >= since)


class OrderOfTopics(Planted):
    """Node that expects the calibration before the first scans."""

    def begin(self) -> None:
        self.rate_hz: float | None = None
        self.on("daq/info", self.on_info, qos=LATCHED)
        self.on("daq/scan", self.on_scan)

    def on_info(self, _message: PointCloud2) -> None:
        self.rate_hz = 1000.0

    def on_scan(self, message: PointCloud2) -> None:
        self.blocks[nanoseconds(message.header.stamp)] = message.width
        if self.is_sound and self.rate_hz is None:
            return
        self.say(sum(self.blocks.values()) / self.rate_hz)  # type: ignore[operator]  # the mistake

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert found[-1] == scans_since(rig, since) / 1000.0


class StaleParameter(Planted):
    """Node that reads its parameter only once."""

    inputs: ClassVar = {"parameters": {"gain": st.sampled_from([1.0, 2.0, 3.0])}}

    def begin(self) -> None:
        self.gain = self.declare_parameter("gain", 1.0).value
        self.on("daq/scan", self.on_scan)

    def on_scan(self, _message: PointCloud2) -> None:
        self.say(self.get_parameter("gain").value if self.is_sound else self.gain)

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert found[-1] == self.get_parameter("gain").value


class TimerAgainstMessage(Planted):
    """Node whose timer publishes the newest block, also before there is one."""

    def begin(self) -> None:
        self.widths: list[int] = []
        self.on("daq/scan", lambda message: self.widths.append(message.width))
        self.create_timer(0.02, self.on_timer)

    def on_timer(self) -> None:
        if self.widths or not self.is_sound:
            self.say(self.widths[-1])

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert set(found) <= {10.0}


class DoubleStart(Planted):
    """Node that creates a further timer with each start."""

    inputs: ClassVar = {"messages": {"start": st.none()}}

    def begin(self) -> None:
        self.timer: Any = None
        self.on("start", self.on_start, Empty)

    def on_start(self, _message: Empty) -> None:
        if self.timer is None or not self.is_sound:
            self.timer = self.create_timer(0.02, lambda: self.say(self.now_ns()))

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert len(set(found)) == len(found), "two answers at one time"


class LostFirstMessage(Planted):
    """Node that numbers the blocks from the first that arrives."""

    def begin(self) -> None:
        self.number = 0
        self.on("daq/scan", self.on_scan, qos=LOSSY)

    def on_scan(self, message: PointCloud2) -> None:
        self.say(nanoseconds(message.header.stamp) // BLOCK_NS if self.is_sound else self.number)
        self.number += 1

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert found[-1] == rig.tables()[-1].stamp_ns // BLOCK_NS


class BlockingCallback(Planted):
    """Node that waits in a callback for a message that only another callback can receive."""

    def begin(self) -> None:
        self.known = threading.Event()
        self.on("daq/info", lambda _: self.known.set(), qos=LATCHED)
        self.on("daq/scan", self.on_scan)

    def on_scan(self, message: PointCloud2) -> None:
        if self.is_sound and not self.known.is_set():
            return
        self.known.wait()
        self.say(message.width)

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert set(found) == {10.0}


class CountedTwice(Planted):
    """Node that counts a message again when it is delivered again."""

    def begin(self) -> None:
        self.total = 0
        self.on("daq/scan", self.on_scan)

    def on_scan(self, message: PointCloud2) -> None:
        if nanoseconds(message.header.stamp) not in self.blocks or not self.is_sound:
            self.total += message.width
        self.blocks[nanoseconds(message.header.stamp)] = message.width
        self.say(self.total)

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert found[-1] == scans_since(rig, since)


class KeptAcrossReset(Planted):
    """Node that continues to count after a reset of the rig."""

    inputs: ClassVar = {"topics": ("daq/scan", "rig/journal")}

    def begin(self) -> None:
        self.begin_ns = 0
        self.on("rig/journal", self.on_journal, String, LATCHED)
        self.on("daq/scan", self.on_scan)

    def on_journal(self, message: String) -> None:
        entry = json.loads(message.data)
        if entry["kind"] == "reset" and self.is_sound:
            self.begin_ns = max(self.begin_ns, entry["stamp_ns"])

    def on_scan(self, message: PointCloud2) -> None:
        self.blocks[nanoseconds(message.header.stamp)] = message.width
        self.say(sum(width for stamp, width in self.blocks.items() if stamp >= self.begin_ns))

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert found[-1] == scans_since(rig, max(since, rig.core.start_ns))


class SumOverLateJoiner(Planted):
    """Node that divides by the scans since the rig's start, also if it joined later."""

    def begin(self) -> None:
        self.on("daq/scan", self.on_scan)

    def on_scan(self, message: PointCloud2) -> None:
        self.blocks[nanoseconds(message.header.stamp)] = message.width
        first = min(self.blocks) if self.is_sound else 0
        self.say(sum(self.blocks.values()) * 1e6 / (max(self.blocks) + BLOCK_NS - first))

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        stamps = [table.stamp_ns for table in rig.tables() if table.stamp_ns >= since]
        assert found[-1] == scans_since(rig, since) * 1e6 / (stamps[-1] + BLOCK_NS - stamps[0])


class QosMismatch(Planted):
    """Node that asks for latched scans, which no rig offers, and receives none."""

    def begin(self) -> None:
        self.on("daq/scan", lambda message: self.say(message.width), qos=DEEP if self.is_sound else LATCHED)

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert found


class OffByOne(Planted):
    """Node that counts one scan too many for each gap."""

    def begin(self) -> None:
        self.next_ns: int | None = None
        self.lost = 0
        self.on("daq/scan", self.on_scan)

    def on_scan(self, message: PointCloud2) -> None:
        if self.next_ns is not None and nanoseconds(message.header.stamp) > self.next_ns:
            self.lost += (nanoseconds(message.header.stamp) - self.next_ns) // 10**6 + (not self.is_sound)
        self.next_ns = nanoseconds(message.header.stamp) + BLOCK_NS
        self.say(self.lost)

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        stamps = [table.stamp_ns for table in rig.tables() if table.stamp_ns >= since]
        gaps = (later - one - BLOCK_NS for one, later in itertools.pairwise(stamps))
        assert found[-1] == sum(gaps) // 10**6


class ShortQueue(Planted):
    """Node that keeps one message only, and needs all."""

    def begin(self) -> None:
        self.on("daq/scan", self.on_scan, qos=DEEP if self.is_sound else QoSProfile(depth=1))

    def on_scan(self, message: PointCloud2) -> None:
        self.blocks[nanoseconds(message.header.stamp)] = message.width
        self.say(sum(self.blocks.values()))

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert found[-1] == scans_since(rig, since)


class ChangedBetween(Planted):
    """Node that reads a parameter in two callbacks that must agree."""

    inputs: ClassVar = {"parameters": {"window": st.integers(1, 5)}}

    def begin(self) -> None:
        self.declare_parameter("window", 2)
        self.slots: list[int] = []
        self.on("daq/scan", self.on_scan)
        self.create_timer(0.01, self.on_timer)

    def on_scan(self, _message: PointCloud2) -> None:
        self.slots = [1] * self.get_parameter("window").value

    def on_timer(self) -> None:
        if self.slots:
            last = len(self.slots) if self.is_sound else self.get_parameter("window").value
            self.say(self.slots[last - 1])

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert set(found) <= {1.0}


class TicksAsTime(Planted):
    """Node that counts the calls of a timer as time, although late timers skip calls."""

    def begin(self) -> None:
        self.first_ns: int | None = None
        self.ticks = -1
        self.create_timer(0.02, self.on_timer)

    def on_timer(self) -> None:
        self.first_ns = self.now_ns() if self.first_ns is None else self.first_ns
        self.ticks += 1
        self.say((self.now_ns() - self.first_ns) * 1e-9 if self.is_sound else self.ticks * 0.02)

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        if found and self.first_ns is not None:
            assert abs(found[-1] - (self.now_ns() - self.first_ns) * 1e-9) < 0.025


class CommandIsNoFact(Planted):
    """Node that takes its command for what the shaker does, although the rig may reject it."""

    inputs: ClassVar = {"messages": {"goal": st.sampled_from([8.5, 10.0, 500.0])}}

    def begin(self) -> None:
        self.frequency_hz = 0.0
        self.command = self.create_publisher(Float64, "shaker/frequency", 10)
        self.on("goal", self.on_goal, Float64)
        self.create_subscription(PointCloud2, "shaker/applied", self.on_applied, LATCHED, raw=True)
        self.on("daq/scan", lambda _: self.say(self.frequency_hz))

    def on_goal(self, message: Float64) -> None:
        self.command.publish(message)
        if not self.is_sound:
            self.frequency_hz = message.data

    def on_applied(self, message: bytes) -> None:
        self.frequency_hz = float(codec.decode(message).rows["frequency"][-1])

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert found[-1] == rig.rows("shaker/applied")["frequency"][-1]


class StopIgnored(Planted):
    """Node whose timer runs on after a stop."""

    inputs: ClassVar = {"messages": {"run": st.booleans()}}

    def begin(self) -> None:
        self.runs = False
        self.timer: Any = None
        self.on("run", self.on_run, Bool)

    def on_run(self, message: Bool) -> None:
        self.runs = message.data
        if message.data and self.timer is None:
            self.timer = self.create_timer(0.02, lambda: self.say(self.runs))
        elif not message.data and self.timer is not None and self.is_sound:
            self.destroy_timer(self.timer)
            self.timer = None

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert all(found), "answers after a stop"


class ReceiptTime(Planted):
    """Node that takes the time of receipt for the time of the measurement."""

    def begin(self) -> None:
        self.on("daq/scan", self.on_scan)

    def on_scan(self, message: PointCloud2) -> None:
        self.say(nanoseconds(message.header.stamp) if self.is_sound else self.now_ns() - BLOCK_NS)

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert sorted(set(found)) == [table.stamp_ns for table in rig.tables() if table.stamp_ns >= since]


class SleepingCallback(Planted):
    """Node that sleeps in a callback until there is a newer block, although no other callback runs meanwhile."""

    inputs: ClassVar = {"messages": {"goal": st.none()}}

    def begin(self) -> None:
        self.goal_ns: int | None = None
        self.last_ns: int | None = None
        self.on("goal", self.on_goal, Empty)
        self.on("daq/scan", self.on_scan)

    def on_goal(self, _message: Empty) -> None:
        self.goal_ns = self.now_ns()
        if not self.is_sound:
            time.sleep(0.03)
            self.answer()

    def on_scan(self, message: PointCloud2) -> None:
        self.last_ns = nanoseconds(message.header.stamp)
        if self.goal_ns is not None and self.last_ns >= self.goal_ns:
            self.answer()

    def answer(self) -> None:
        if self.last_ns is not None and self.goal_ns is not None:
            self.say(self.last_ns - self.goal_ns)
            self.goal_ns = None

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert all(value >= 0.0 for value in found), "a block from before the goal"


class PairedByArrival(Planted):
    """Node that pairs the blocks of two topics in the order of their arrival."""

    inputs: ClassVar = {"topics": ("daq/scan", "truth/scan")}

    def begin(self) -> None:
        self.waiting: dict[str, dict[int, int]] = {"daq/scan": {}, "truth/scan": {}}
        self.number = {"daq/scan": 0, "truth/scan": 0}
        for topic in self.waiting:
            self.on(topic, lambda message, topic=topic: self.on_block(topic, message))

    def on_block(self, topic: str, message: PointCloud2) -> None:
        self.number[topic] += 1
        key = nanoseconds(message.header.stamp) if self.is_sound else self.number[topic]
        self.waiting[topic][key] = nanoseconds(message.header.stamp)
        one, other = (waiting.get(key) for waiting in self.waiting.values())
        if one is not None and other is not None:
            self.say(one - other)

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert not any(found)


class ServiceBeforeData(Planted):
    """Node that answers a request from the last block, also before there is one."""

    inputs: ClassVar = {"services": ("zero",)}

    def begin(self) -> None:
        self.last: PointCloud2 | None = None
        self.create_service(Trigger, "zero", self.on_zero)
        self.on("daq/scan", self.on_scan)

    def on_scan(self, message: PointCloud2) -> None:
        self.last = message

    def on_zero(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self.last is not None or not self.is_sound:
            self.say(self.last.width)  # type: ignore[union-attr]  # the mistake
        return response

    def check(self, rig: LocalRigWithNodes, found: list[float], since: int) -> None:
        assert set(found) <= {10.0}


MISTAKES: dict[str, type[Planted]] = {one.__name__: one for one in Planted.__subclasses__()}


def checked(kind: type[Planted]) -> Callable[[LocalRigWithNodes], Callable[[], None]]:
    """Return the check of a node: host it, and compare what it has published with what the rig knows."""

    def check(rig: LocalRigWithNodes) -> Callable[[], None]:
        since, out = rig.core.start_ns + rig.now_ns, rig.listen("out")
        node = rig.host(kind)
        return lambda: node.check(rig, [message.data for message in out.messages], since)

    return check


def find(kind: type[Planted], examples: int = EXAMPLES) -> tuple[str, BaseException] | None:
    """Search for a failure of a node; return the scenario of three lines and its error, or None."""
    made: list[LocalRigWithNodes] = []

    def make_rig(values: dict[str, Any]) -> LocalRigWithNodes:
        made[:] = [LocalRigWithNodes(values)]
        return made[0]

    try:
        search(make_rig, checked(kind), QUICK, schedules(**kind.inputs), examples)
    except Exception as error:
        return made[0].scenario, error
    finally:
        made[0].close()
    return None


def count_actions(scenario: str) -> int:
    """Return the number of actions that the last line of a scenario lists."""
    call = ast.parse(scenario).body[-1].value  # type: ignore[attr-defined]  # an expression
    return len(call.args[-1].elts)


def replay(kind: type[Planted], scenario: str) -> bytes:
    """Run the three lines of a scenario; return the callbacks, publications and the error as bytes."""
    made: list[LocalRigWithNodes] = []

    def make_rig(values: dict[str, Any]) -> LocalRigWithNodes:
        made.append(LocalRigWithNodes(values))
        return made[-1]

    error = ""
    try:
        with tempfile.NamedTemporaryFile("w", suffix=".py", encoding="utf-8") as file:
            file.write(scenario)
            file.flush()
            runpy.run_path(file.name, {"make_rig": make_rig, "check": checked(kind)})
    except Exception as found:
        error = f"{type(found).__name__}: {found}"
    made[0].close()
    return "\n".join([*made[0].callbacks, error]).encode()


def main() -> int:
    """Search all nodes, print a line for each and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="nodes to search (default: all)")
    names = parser.parse_args().names or list(MISTAKES)
    found, sound = 0, 0
    for name in names:
        kind = MISTAKES[name]
        begin = time.monotonic()
        failure = find(kind)
        seconds = time.monotonic() - begin
        if failure is not None:
            scenario, error = failure
            traces = {replay(kind, scenario) for _ in range(REPETITIONS)}
            is_same = len(traces) == 1 and f"\n{type(error).__name__}: " in f"\n{traces.copy().pop().decode()}"
            is_found = seconds <= LIMIT_S and count_actions(scenario) <= MOST_ACTIONS and is_same
            found += is_found
            result = f"{'found' if is_found else 'NOT SHRUNK OR REPEATED'} in {seconds:.1f} s, {type(error).__name__}, "
            result += f"{len(traces)} different in {REPETITIONS} repetitions of {scenario.splitlines()[-1]}"
        else:
            result = f"NOT FOUND in {seconds:.1f} s"
        harmless = find(type(name, (kind,), {"is_sound": True}))
        sound += harmless is None
        print(
            f"{name}: {result}; {'sound node passes' if harmless is None else f'SOUND NODE FAILS: {harmless}'}",
            flush=True,
        )
    print(f"{found} of {len(names)} mistakes found, {sound} of {len(names)} sound nodes pass")
    return int(found < min(len(names), LEAST_FOUND) or sound < len(names))


if __name__ == "__main__":
    sys.exit(main())
