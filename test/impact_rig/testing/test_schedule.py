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
"""Schedules of callbacks: the modelled transport delivers the same messages as the middleware, in a chosen order."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

import rclpy.duration
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import Imu, JointState, PointCloud2, Range
from std_msgs.msg import Bool, Float64, Int64
from std_srvs.srv import Trigger

from impact_rig.client import Client
from impact_rig.client.processes import isolated_domain
from impact_rig.errors import ConfigError
from impact_rig.nodes.messages import MONITORS
from impact_rig.recording import open_run
from impact_rig.runs.verification import verify
from impact_rig.testing import Fault, LocalRig, LocalRigWithNodes
from impact_rig.testing.schedule import BlockedError
from impact_rig.testing.strategies import (
    Burst,
    Call,
    Command,
    Delay,
    Drop,
    Duplicate,
    First,
    LateJoin,
    Pause,
    Reset,
    Send,
    SetParameter,
    repeat,
)
from qualification.planted_mistakes import MISTAKES, MOST_ACTIONS, count_actions, find, replay

pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]

QUICK = {"daq.rate_hz": 1000, "daq.block_scans": 10}
LATCHED, LOSSY = DurabilityPolicy.TRANSIENT_LOCAL, ReliabilityPolicy.BEST_EFFORT


class Observer(Node):
    """Node that publishes the number of each block as it arrives, and 0 by a timer."""

    def __init__(self, depth: int = 10, reliability: Any = ReliabilityPolicy.RELIABLE) -> None:
        super().__init__("observer")
        self.gain = self.declare_parameter("gain", 1.0)
        self.out = self.create_publisher(Float64, "out", 10)
        self.create_subscription(
            PointCloud2, "daq/scan", self.on_scan, QoSProfile(depth=depth, reliability=reliability)
        )
        self.create_timer(0.02, lambda: self.out.publish(Float64(data=0.0)))
        self.create_service(Trigger, "~/say", self.on_say)
        self.create_subscription(Bool, "hurry", lambda message: self.out.publish(Float64(data=-2.0)), 10)

    def on_scan(self, message: PointCloud2) -> None:
        number = 1 + (message.header.stamp.sec * 10**9 + message.header.stamp.nanosec) // 10_000_000
        self.out.publish(Float64(data=self.get_parameter("gain").value * number))

    def on_say(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.out.publish(Float64(data=-1.0))
        return response


def played(actions: list[Any], make_node: Any = Observer, **kwargs: Any) -> list[float]:
    """Return the values that a node publishes in a scenario; a timer gives 0."""
    with LocalRigWithNodes(QUICK) as rig:
        out = rig.listen("out")
        repeat(rig, lambda rig: rig.host(make_node, **kwargs) and None, actions)
        return [message.data for message in out.messages]


def test_undisturbed_messages_are_delivered_before_the_timers_of_their_instant() -> None:
    assert played([]) == [1, 2, 0, 3]


@pytest.mark.parametrize(
    ("actions", "expected"),
    [
        ([First("timers", 5)], [1, 0, 2, 3, 0, 4, 5, 6, 0, 7, 8, 0]),
        ([Delay("daq/scan", 3)], [0, 1, 2, 3, 4, 0, 5, 6, 0]),
        ([Delay("timers", 4)], [1, 2, 3, 4, 0, 5, 6, 0, 7]),  # rclpy skips what is late
        ([Burst(4)], [1, 2, 3, 4, 0, 5, 6, 0, 7]),
        ([Duplicate("daq/scan", 2), Pause()], [1, 1, 2, 2, 0, 3, 4, 0, 5, 6, 0]),
        ([Drop("daq/scan", 2), Pause()], [1, 2, 0, 3, 4, 0, 5, 6, 0]),  # a reliable subscription loses nothing
        ([LateJoin(4)], [0, 5, 6, 0, 7]),  # its clock begins at 0, so the timer is due at once
        ([SetParameter("gain", 2.0, after=2), Pause()], [1, 2, 0, 6, 8, 0, 10, 12, 0]),
        ([SetParameter("gain", 2.0, after=3), Pause()], [1, 2, 0, 6, 8, 0, 10, 12, 0]),
        ([Call("~/say"), Send("hurry", True, after=1)], [-1, 1, 2, -2, 0, 3, 4, 0, 5]),
    ],
)  # fmt: skip
def test_each_action_changes_the_order_as_described(actions: list[Any], expected: list[float]) -> None:
    assert played(actions) == expected


def test_messages_that_the_quality_of_service_may_drop_are_dropped() -> None:
    assert played([Drop("daq/scan", 2), Pause()], reliability=LOSSY) == [0, 3, 4, 0, 5, 6, 0]
    assert played([Burst(5)], depth=2) == [4, 5, 0, 6, 0, 7, 8, 0]


OFFERS = [
    QoSProfile(depth=depth, durability=durability, reliability=reliability)
    for depth in (2, 20)
    for durability in (LATCHED, DurabilityPolicy.VOLATILE)
    for reliability in (ReliabilityPolicy.RELIABLE, LOSSY)
]
REQUESTS = [*OFFERS, QoSProfile(history=HistoryPolicy.KEEP_ALL, durability=LATCHED)]
PAIRS = [(offer, request) for offer in range(len(OFFERS)) for request in range(len(REQUESTS))]


class Receiver(Node):
    """Node that keeps what arrives on a topic, for each pair of offered and requested quality of service."""

    def __init__(self) -> None:
        super().__init__("receiver")
        self.found: dict[tuple[int, int], list[int]] = {pair: [] for pair in PAIRS}
        for pair in PAIRS:
            self.create_subscription(
                Int64, "topic{}_{}".format(*pair), lambda message, pair=pair: self.found[pair].append(message.data),
                REQUESTS[pair[1]],
            )  # fmt: skip


def test_the_transport_delivers_the_same_messages_as_the_middleware() -> None:
    """Queues, late joiners and incompatible requests: 3 messages before a node joins, 12 while it is busy."""
    with LocalRigWithNodes(QUICK) as rig:
        for messages in (range(3), range(3, 15)):
            for pair in PAIRS:
                for number in messages:
                    rig.send("topic{}_{}".format(*pair), Int64(data=number), OFFERS[pair[0]])
            if messages.start == 0:
                modelled = rig.host(Receiver)
            rig.step()
        expected = modelled.found
    joined = {pair for pair, found in expected.items() if found}
    with isolated_domain() as domain_id, Client(domain_id) as client:
        sender = client.host(lambda **kwargs: Node("sender", **kwargs))
        send = {pair: sender.create_publisher(Int64, "topic{}_{}".format(*pair), OFFERS[pair[0]]) for pair in PAIRS}
        for publisher in send.values():
            for number in range(3):
                publisher.publish(Int64(data=number))
        real = client.host(Receiver)
        latched = {pair: [number for number in found if number < 3] for pair, found in expected.items()}
        client.wait_until(
            lambda: {pair for pair, one in send.items() if one.get_subscription_count()} >= joined, "all subscriptions"
        )
        client.wait_until(lambda: real.found == latched, "what is latched")
        for publisher in send.values():
            for number in range(3, 15):
                publisher.publish(Int64(data=number))
        client.wait_until(lambda: real.found == expected, "the rest")
        client.spin_for(0.3)
        assert real.found == expected
    assert {len(found) for found in expected.values()} == {0, 2, 4, 12, 14, 15}


def test_a_node_answers_as_it_does_behind_the_middleware(ros_rig: Any) -> None:
    """Compare the answers to 50 blocks, to a command and to a change of a parameter, without those of the timer."""
    found = []
    with LocalRigWithNodes(QUICK) as local:
        for rig in (local, ros_rig(QUICK, hosted=True)):
            node = rig.host(Observer)
            out = rig.listen("out")
            rig.step(20)
            rig.command(9.1, 0.3)
            node.set_parameters([Parameter("gain", value=3.0)])
            rig.step(30)
            found.append([message.data for message in out.messages if message.data])
    assert found[0] == found[1]
    assert len(found[0]) == 50


def test_the_rig_publishes_all_its_topics_and_follows_commands() -> None:
    """Monitors, truth and the clock arrive; a published command acts."""

    class Reader(Node):
        def __init__(self) -> None:
            super().__init__("reader")
            self.counts = dict.fromkeys(("truth/joint_states", "accelerometer", "truth/impacts", "daq/scan"), 0)
            self.frequency = self.create_publisher(Float64, "shaker/frequency", 10)
            self.current = self.create_publisher(Float64, "shaker/current", 10)
            for topic, kind in zip(self.counts, (JointState, Imu, PointCloud2, PointCloud2), strict=True):
                self.create_subscription(kind, topic, lambda _, topic=topic: self.count(topic), 100)

        def count(self, topic: str) -> None:
            self.counts[topic] += 1
            if self.counts["daq/scan"] == 3 and topic == "daq/scan":
                self.frequency.publish(Float64(data=9.5))
                self.current.publish(Float64(data=0.5))
                self.frequency.publish(Float64(data=5000.0))  # rejected

    with LocalRigWithNodes({**QUICK, "barriers.gap_m": 0.002}) as rig:
        node = rig.host(Reader)
        rig.run(3.0)
        assert node.counts["daq/scan"] == 300
        assert node.counts["truth/joint_states"] == 3 * rig.config.output.monitor_rate_hz
        assert node.counts["accelerometer"] > 2.9 * rig.config.output.monitor_rate_hz
        assert node.counts["truth/impacts"] == len(rig.tables("truth/impacts")) > 0
        assert node.get_clock().now().nanoseconds == 3_000_000_000
        applied = rig.rows("shaker/applied")[-1]
        assert (applied["frequency"], applied["current"], applied["sample"]) == (9.5, 0.5, 30)


class Waiting(Node):
    """Node that waits in its callback for its timer, for a clock, or forever."""

    def __init__(self, how: str) -> None:
        super().__init__("waiting")
        self.arrived = threading.Event()
        self.count = 0
        self.create_timer(0.01, self.arrived.set)
        self.create_subscription(PointCloud2, "daq/scan", getattr(self, how), 4)

    def event(self, _message: PointCloud2) -> None:
        self.arrived.wait()

    def rate(self, _message: PointCloud2) -> None:
        self.create_rate(100).sleep()

    async def future(self, _message: PointCloud2) -> None:
        await Future()

    async def later(self, _message: PointCloud2) -> None:
        self.count += 1

    def sleep(self, _message: PointCloud2) -> None:
        self.count += 1
        time.sleep(0.035)

    def clock(self, _message: PointCloud2) -> None:
        self.count += 1
        self.get_clock().sleep_for(rclpy.duration.Duration(seconds=0.035))


@pytest.mark.parametrize("how", ["event", "rate", "future"])
def test_a_callback_that_waits_for_another_is_named(how: str) -> None:
    with LocalRigWithNodes(QUICK) as rig:
        rig.host(Waiting, how=how)
        with pytest.raises(BlockedError, match=r"waiting blocks: its callback for daq/scan a?waits"):
            rig.step(3)


def test_a_coroutine_that_awaits_nothing_runs_like_any_callback() -> None:
    with LocalRigWithNodes(QUICK) as rig:
        node = rig.host(Waiting, how="later")
        rig.step(3)
        assert node.count == 3


@pytest.mark.parametrize("how", ["sleep", "clock"])
def test_the_sleep_of_a_callback_takes_rig_time(how: str) -> None:
    """Each callback sleeps for 35 ms, so that one of four blocks is processed and the queue of 4 overflows."""
    begin = time.monotonic()
    with LocalRigWithNodes(QUICK) as rig:
        node = rig.host(Waiting, how=how)
        rig.step(400)
        assert node.count == 100
        assert sum("lost, the queue is full" in line for line in rig.callbacks) > 290
    assert time.monotonic() - begin < 3.0  # 3.5 s by wall time


def test_timers_on_wall_time_are_rejected() -> None:
    class Steady(Node):
        def __init__(self) -> None:
            super().__init__("steady")
            self.create_timer(0.1, print, clock=Clock(clock_type=ClockType.STEADY_TIME))

    with LocalRigWithNodes(QUICK) as rig:
        with pytest.raises(ConfigError, match="steady has a timer by STEADY_TIME"):
            rig.host(Steady)
        rig.step()  # the node is not hosted


def test_an_action_on_the_transport_needs_a_rig_with_nodes() -> None:
    with LocalRig(QUICK) as rig, pytest.raises(TypeError, match="virtual_rig_with_nodes, not LocalRig"):
        repeat(rig, lambda _: None, [Burst(2)])


@pytest.mark.parametrize("after", [0, 1, 1000])
def test_a_reset_that_the_rig_rejects_has_no_effect(after: int) -> None:
    """The shaker is stopped, which a reset must not clear; the last reset is due only at the end of the scenario."""

    def stopped(rig: Any) -> None:
        rig.host(Observer)
        rig.core.stop()

    with LocalRigWithNodes(QUICK) as rig:
        repeat(rig, stopped, [Reset(after), Pause(5)])
        assert "reset" not in {entry.kind.value for entry in rig.journal()}


def test_a_node_that_cannot_be_created_is_not_hosted() -> None:
    with LocalRigWithNodes(QUICK) as rig:
        out = rig.listen("out")
        with pytest.raises(TypeError, match="unexpected keyword"):
            rig.host(Observer, width=3)
        rig.step()
        rig.host(Observer)
        rig.step()
        assert [message.data for message in out.messages] == [2, 0]


def test_the_recorded_run_of_a_reset_rig_is_valid(tmp_path: Path) -> None:
    with LocalRigWithNodes(QUICK) as rig:
        node = rig.host(Observer)
        repeat(rig, lambda _: None, [Command(9.1, 0.5), Pause(20), Reset(after=1), Pause(5), Command(9.3, 0.4)])
        assert rig.lost_samples() == []
        newest = rig.tables()[-1]
        assert node.get_clock().now().nanoseconds == newest.stamp_ns + 10_000_000
        assert rig.first_scan(newest) == rig.sample - 10
        rig.save(tmp_path / "run")
        lines = (tmp_path / "run/callbacks.txt").read_text().splitlines()
        assert lines == list(rig.callbacks)
    with open_run(tmp_path / "run") as run:
        assert str(verify(run)).startswith("identical")


def test_the_monitor_topics_follow_the_configuration() -> None:
    ranges: list[float] = []

    class Ranges(Node):
        def __init__(self) -> None:
            super().__init__("ranges")
            topic = MONITORS["laser"].name
            self.create_subscription(Range, topic, lambda message: ranges.append(message.max_range), 10)

    with LocalRigWithNodes(QUICK) as rig:
        laser = rig.config.instruments.laser
        rig.host(Ranges)
        rig.run(0.5)
        rig.configure({"instruments.laser.half_range_m": 0.02})
        rig.run(0.5)
    expected = [np.float32(laser.distance_m + half_range_m) for half_range_m in (laser.half_range_m, 0.02)]
    assert list(dict.fromkeys(ranges)) == expected
    assert len(ranges) == 46, "50 Hz, four periods late: the filter does not start again"


def test_scans_lost_after_a_reset_are_counted_from_the_reset() -> None:
    with LocalRigWithNodes(QUICK) as rig:
        rig.step(20)
        rig.clear()
        rig.reset()
        assert (rig.sample, rig.time_s) == (0, 0.0)
        rig.inject(Fault(kind="lost_block", start_sample=0, samples=10))
        rig.step(3)
        assert rig.lost_samples() == [(0, 10)]


@pytest.mark.parametrize("name", ["BlockingCallback", "KeptAcrossReset", "TimerAgainstMessage"])
def test_a_planted_mistake_is_found_shrunk_and_repeated(name: str) -> None:
    """Three of the 20 mistakes in `qualification/planted_mistakes.py`."""
    kind = MISTAKES[name]
    failure = find(kind)
    assert failure is not None
    scenario, error = failure
    assert count_actions(scenario) <= MOST_ACTIONS
    first = replay(kind, scenario)
    assert {replay(kind, scenario) for _ in range(4)} == {first}
    assert type(error).__name__ in first.decode().splitlines()[-1]
    assert find(type(name, (kind,), {"is_sound": True}), examples=25) is None
