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
"""Hostile input from another process: nothing crashes or hangs, rejections are explained, signals stay finite.

The rig, the analysis and the recorder are separate processes; this process is the attacker.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from hypothesis import example, given, settings
from hypothesis import strategies as st
from kits.hostile import CASES, FIELDS, Attacked, cases, texts
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from std_msgs.msg import Float64, Header
from std_srvs.srv import SetBool, Trigger

from impact_rig import graph, topics
from impact_rig.client import isolated_domain
from impact_rig.errors import ConfigError
from impact_rig.nodes import messages
from impact_rig.nodes.messages import TOPICS
from impact_rig.recording import open_run
from impact_rig.rig.config import RigConfig, from_flat

pytestmark = [pytest.mark.ros, pytest.mark.pipeline, pytest.mark.timeout(120 + CASES)]
QUEUE = topics.Qos.EVENT.depth

batches = settings(cases, max_examples=max(1, CASES // QUEUE))

numbers = st.one_of(
    st.floats(),
    st.floats(-1.0, 250.0),
    st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0, 0.0, 5.0, 200.0, 15.0 * math.sqrt(2)]),
)


@pytest.fixture(scope="module")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Attacked]:
    directory = tmp_path_factory.mktemp("attacked")
    with isolated_domain() as domain_id:
        victim = Attacked(domain_id, directory)
        try:
            yield victim
            assert victim.processes.stop() == {"rig": 0, "analysis": 0, "recorder": 0}
            for run in victim.runs:
                with open_run(run) as opened:
                    assert opened.topics[opened.resolve("daq/scan")].count > 0
        finally:
            victim.client.close()
            victim.processes.stop()


# Commands


@pytest.mark.parametrize(
    ("topic", "low", "high"), [(topics.FREQUENCY, 5.0, 200.0), (topics.CURRENT, 0.0, 15.0 * math.sqrt(2.0))]
)
def test_commands_of_any_value_are_accepted_in_range_and_otherwise_counted(
    attacked: Attacked, topic: topics.Topic, low: float, high: float
) -> None:
    """Commands are accepted in order if they are finite and in range; every other command is rejected and counted."""
    client, column = attacked.client, topic.name.removeprefix("shaker/")
    client.set_parameters("rig", {"shaker.travel_limit_m": 1.0})  # the interlock has tests of its own
    expected: list[float] = []
    sent = 0
    before, applied = attacked.refused_before("rig", topic.name), len(client.applied)

    @batches
    @given(st.lists(numbers, min_size=QUEUE - 1, max_size=QUEUE - 1))
    def attack(values: list[float]) -> None:
        nonlocal sent
        for value in (*values, high):  # the last one is valid: its row shows that the others have been processed, too
            client.publish(topic, Float64(data=value))
        expected.extend(value for value in (*values, high) if math.isfinite(value) and low <= value <= high)
        sent += QUEUE
        client.wait_until(lambda: len(client.applied) - applied >= len(expected), "the rows of accepted commands")

    attack()
    rows = [float(table.rows[column][0]) for table in client.applied.tables(applied)]
    assert rows == expected
    attacked.await_refusals("rig", topic.name, before + sent - len(expected))
    client.command(frequency_hz=9.1, current_a=0.0)
    attacked.assert_sound()


def test_ten_thousand_commands_a_second_keep_their_order_and_lose_no_block(attacked: Attacked) -> None:
    """The newest value is active in the end, the order is kept, and no block of real time is lost."""
    client = attacked.client
    client.command(frequency_hz=10.0)
    attacked.scans.clear()
    applied, publisher, count = len(client.applied), client.publisher(topics.FREQUENCY), 10 * CASES
    begin = time.perf_counter()
    for k in range(count):
        publisher.publish(Float64(data=10.0 + k / count))
        while time.perf_counter() - begin < k * 1e-4:
            pass
    last = 10.0 + (count - 1) / count
    client.wait_until(lambda: client.applied.last().rows["frequency"][-1] == last, "the last command")
    rows = [float(table.rows["frequency"][0]) for table in client.applied.tables(applied)]
    assert rows == sorted(rows)
    assert attacked.scans.lost() == 0
    assert client.figures("rig")["slips"] == "0"
    attacked.assert_sound()


# Parameters

_VALUES = st.one_of(
    st.builds(ParameterValue, type=st.just(1), bool_value=st.booleans()),
    st.builds(ParameterValue, type=st.just(2), integer_value=st.integers(-(2**63), 2**63 - 1) | st.integers(-3, 20)),
    st.builds(ParameterValue, type=st.just(3), double_value=st.floats()),
    st.builds(ParameterValue, type=st.just(4), string_value=texts),
    st.builds(ParameterValue, type=st.just(9), string_array_value=st.lists(st.sampled_from(["", "a", "\u2028"]))),
    st.builds(ParameterValue, type=st.integers(0, 255)),
)
_NAMES = st.sampled_from(
    [*FIELDS, "", ".", "barriers.gap", "barriers", "config_file", "use_sim_time", "qos_overrides.x", "a" * 999]
)


def _given(value: ParameterValue) -> object:
    """Return what a value means; an object of unknown type is not accepted by any parameter."""
    names = {1: "bool_value", 2: "integer_value", 3: "double_value", 4: "string_value", 9: "string_array_value"}
    found = getattr(value, names[value.type]) if value.type in names else object()
    return tuple(found) if value.type == 9 else found


def test_parameters_of_any_name_type_and_value_are_validated(attacked: Attacked) -> None:
    """The rig accepts what the validator accepts, and rejects the rest with the validator's messages."""
    client, before = attacked.client, attacked.refused_before("rig", "parameter")
    refused = 0

    @cases
    @given(_NAMES, _VALUES, st.booleans())
    def attack(name: str, value: ParameterValue, atomically: bool) -> None:
        nonlocal refused
        kind, service = (
            (SetParametersAtomically, "set_parameters_atomically") if atomically else (SetParameters, "set_parameters")
        )
        answer = attacked.call(kind, f"rig/{service}", kind.Request(parameters=[Parameter(name=name, value=value)]))
        result = answer.result if atomically else answer.results[0]
        if not result.successful:
            refused += 1
            assert result.reason
        if name in FIELDS:
            try:
                legal = not FIELDS[name][0].read_only and bool(from_flat(RigConfig(), {name: _given(value)}))
            except ConfigError as error:
                assert not result.successful
                is_reported = FIELDS[name][0].read_only or value.type not in (1, 2, 3, 4) or str(error) == result.reason
                assert is_reported, result.reason  # either outcome is right, each with its condition
            else:
                assert legal or not result.successful
        if result.successful and name in FIELDS:  # one at a time: the next case meets the nominal rig
            default = FIELDS[name][1]
            client.set_parameters("rig", {name: list(default or ("",)) if isinstance(default, tuple) else default})

    attack()
    attacked.await_refusals("rig", "parameter", before + refused)
    assert refused > CASES // 4
    attacked.assert_sound()


# Services and transitions


def test_services_answer_in_any_order_and_state(attacked: Attacked) -> None:
    """Every answer has a message, and those without success are counted."""
    client = attacked.client
    names = [row.name[2:] for row in graph.SERVICES if row.node == "rig"]
    for name in names:  # DDS may lose the first answer to a client, which is asked for again
        kind = SetBool if name == "pause" else Trigger
        client.call(kind, f"rig/{name}", kind.Request(), repeatable=True)
    attacked.quiet()
    counted = {name: attacked.refused("rig", name) for name in names}

    @cases
    @given(st.sampled_from(names), st.booleans())
    def attack(name: str, data: bool) -> None:
        pausing = name == "pause"
        request = SetBool.Request(data=data) if pausing else Trigger.Request()
        answer = attacked.call(SetBool if pausing else Trigger, f"rig/{name}", request)
        assert answer.message
        if not answer.success:
            counted[name] += 1

    attack()
    client.pause(False)
    client.trigger("rig/clear_trip")
    client.trigger("rig/reset")
    for name, count in counted.items():
        attacked.await_refusals("rig", name, count)
    assert counted["step"] > 0, "stepping is refused in real time"
    attacked.assert_sound()


_AFTER = {
    ("unconfigured", Transition.TRANSITION_CONFIGURE): "inactive",
    ("inactive", Transition.TRANSITION_CLEANUP): "unconfigured",
    ("inactive", Transition.TRANSITION_ACTIVATE): "active",
    ("active", Transition.TRANSITION_DEACTIVATE): "inactive",
}
_SHUTDOWNS = (
    Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
    Transition.TRANSITION_INACTIVE_SHUTDOWN,
    Transition.TRANSITION_ACTIVE_SHUTDOWN,
)


@pytest.mark.parametrize("node", ["rig", "analysis", "recorder"])
def test_transitions_in_any_order_leave_a_working_node(attacked: Attacked, node: str) -> None:
    """Valid transitions happen, others are rejected and counted; after 2000 of them, the node still works."""
    client = attacked.client
    state, refused = client.state(node), attacked.refused_before(node, "transition")

    @settings(cases, max_examples=CASES if node == "rig" else max(1, CASES // 4))
    @given(st.integers(0, 255).filter(lambda number: number not in _SHUTDOWNS) | st.integers(0, 4))
    def attack(number: int) -> None:
        nonlocal state, refused
        if number == 0:  # "create" is answered by the label, which is empty
            return
        answer = attacked.call(
            ChangeState, f"{node}/change_state", ChangeState.Request(transition=Transition(id=number))
        )
        assert answer.success == ((state, number) in _AFTER), (state, number)
        refused += not answer.success
        state = _AFTER.get((state, number), state)

    attack()
    for transition in ("configure", "activate"):
        if client.state(node) != "active":
            refused += not client.change_state(node, transition)
    attacked.await_refusals(node, "transition", refused)
    attacked.assert_sound()


# Bytes and acknowledgements


@pytest.fixture
def recorded(attacked: Attacked) -> Attacked:
    """The same graph while a run is recorded; the file must be readable in the end."""
    if not attacked.client.node.get_subscriptions_info_by_topic("/target/truth/faults"):
        attacked.record()
    return attacked


@pytest.mark.parametrize(
    "topic", [t for t in TOPICS if t.recorded and not t.name.startswith("/")], ids=lambda topic: topic.name
)
def test_bytes_that_are_not_a_message_are_rejected_and_counted(recorded: Attacked, topic: topics.Topic) -> None:
    """The middleware forwards anything, and every subscriber must cope with it."""
    client = recorded.client
    publisher = client.node.create_publisher(messages.class_of(topic), topic.name, messages.profile(topic.qos))
    client.wait_until(publisher.get_subscription_count, f"a subscriber of {topic.name}")

    @settings(cases, max_examples=max(1, CASES // 8))
    @given(st.binary(max_size=12 if topic.type_name.endswith("Float64") else 300))  # no more leaves this process
    @example(b"")
    @example(b"\0\1\0\0")
    @example(b"\0\1\0\0" + b"\xff" * 8)
    def attack(data: bytes) -> None:
        publisher.publish(b"\0\1\0\0" + data[4:] if len(data) % 2 and len(data) > 4 else data)
        client.executor.spin_once(timeout_sec=0.0)

    attack()
    for node in ("rig", "analysis", "recorder"):
        assert client.state(node) == "active"
    client.node.destroy_publisher(publisher)


def test_the_nodes_work_after_invalid_bytes(recorded: Attacked) -> None:
    recorded.assert_sound()


def test_acknowledgements_of_any_stamp_and_name_do_not_move_the_rig(attacked: Attacked) -> None:
    """A future stamp is rejected and counted, an unknown name is counted separately; neither moves the rig."""
    client = attacked.client
    attacked.quiet()
    expected = attacked.refused("rig", "daq/ack") + int(client.figures("rig")["other_acks"])

    @cases
    @given(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1), texts)
    @example(2**31 - 1, 2**32 - 1, "analysis")
    @example(0, 0, "analysis")
    def attack(seconds: int, nanoseconds: int, name: str) -> None:
        nonlocal expected
        header = Header(frame_id=name)
        header.stamp.sec, header.stamp.nanosec = seconds, nanoseconds
        client.publish(topics.ACK, header)
        past = seconds + nanoseconds * 1e-9 < time.time() - 1.0
        expected += not (past and name in ("analysis", "recorder", "client"))
        if expected % (topics.ACK.qos.depth // 2) == 0:
            client.wait_until(lambda: counted() >= expected, "the count")  # more would fall out of the queue

    def counted() -> int:
        return attacked.refused("rig", "daq/ack") + int(client.figures("rig")["other_acks"])

    attack()
    client.wait_until(lambda: counted() >= expected, "the count")
    assert counted() == expected
    attacked.assert_sound()
