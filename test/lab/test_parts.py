# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What pages are told: states in words, deeds step by step, requests, joint states, the journal's lines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from kits.recorded_rig import messages

from impact_rig.errors import CodecError
from impact_rig.lab import deeds, parts
from impact_rig.lab.motion import Motion, decode_joint_state, encode_joint_state
from impact_rig.lab.parts import Curve, Ledger
from impact_rig.lab.protocol import REQUESTS, Kind, Request, RequestError, json_frame, parse
from impact_rig.lab.source import Snapshot
from impact_rig.lab.state import Heard, judge
from impact_rig.lab.tasks import Refused, Steps, Tasks, Waiting

RUNNING = {"rig_time_s": "3.5", "current_a": "0.52"}


@pytest.mark.parametrize(
    ("heard", "word", "words"),
    [
        (Heard(), "starting", "Waiting"),
        (Heard(age_s=0.1, message="compiling, 3 of 60 functions"), "compiling", "3 of 60"),
        (Heard(age_s=0.1, message="waiting for peer analysis"), "starting", "waiting for peer analysis"),
        (Heard(age_s=9.0, figures=RUNNING), "dead", "9 s"),
        (Heard(ended="its process ended with code -9"), "dead", "-9"),
        (Heard(age_s=0.1, figures=RUNNING, tripped="over-travel"), "tripped", "over-travel"),
        (Heard(age_s=0.1, figures={**RUNNING, "latched": "over_travel: 7 mm"}), "tripped", "7 mm"),
        (Heard(age_s=0.1, figures=RUNNING, level=2, message="paused: peer x silent for 3 s"), "silent", "peer x"),
        (Heard(age_s=0.1, figures=RUNNING, level=1, message="paused"), "paused", "stands still"),
        (Heard(age_s=0.1, figures=RUNNING, plucked=True), "plucked", "reset"),
        (Heard(age_s=0.1, figures={**RUNNING, "current_a": "0"}), "at rest", "press R"),
        (Heard(age_s=0.1, figures=RUNNING), "settling", "transient"),
        (Heard(age_s=0.1, figures=RUNNING, settled=True), "driving", "Settled"),
    ],
)
def test_the_gravest_state_comes_first(heard: Heard, word: str, words: str) -> None:
    found = judge(heard)
    assert found[0] == word
    assert words in found[1]


def answers() -> tuple[list[tuple[bool, str]], Callable[[bool, str], None]]:
    found: list[tuple[bool, str]] = []
    return found, lambda ok, text: found.append((ok, text))


def test_deeds_wait_without_holding_each_other_up() -> None:
    clock = [0.0]
    tasks, ready = Tasks(lambda: clock[0]), []

    def slow() -> Steps:
        yield Waiting(lambda: ready or None, "what is slow", 5.0)
        return "late"

    def quick() -> Steps:
        yield Waiting(lambda: True, "nothing", 1.0)
        return "soon"

    found, answer = answers()
    tasks.begin(slow(), answer)
    tasks.begin(quick(), answer)
    tasks.work()
    assert found == [(True, "soon")]
    ready.append(1)
    tasks.work()
    assert found == [(True, "soon"), (True, "late")]
    assert len(tasks) == 0


def test_what_does_not_come_is_named_and_what_is_refused_says_why() -> None:
    clock = [0.0]
    tasks, (found, answer) = Tasks(lambda: clock[0]), answers()
    withdrawn = []

    def never() -> Steps:
        yield Waiting(lambda: None, "an answer", 2.0, lambda: withdrawn.append(1))
        return ""

    def refused() -> Steps:
        raise Refused("no")
        yield

    tasks.begin(never(), answer)
    tasks.begin(refused(), answer)
    clock[0] = 3.0
    tasks.work()
    assert found == [(False, "no"), (False, "waited 2 s in vain for an answer")]
    assert withdrawn == [1]
    tasks.begin(never(), answer)
    tasks.end("over")
    assert found[-1] == (False, "over")


def test_every_request_that_a_live_rig_takes_has_a_deed() -> None:
    known = set(deeds._DEEDS) | set(deeds.SHAKER) | set(deeds.RIG_KEYS)
    assert set(REQUESTS) - known == {"ack", "view", "play", "speed", "seek", "next_impact"}
    _, answer = answers()
    found, answer = answers()
    Tasks().begin(deeds.begin(None, Request(1, "seek", {"value": 1.0})), answer)  # type: ignore[arg-type]
    assert found[0][0] is False


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        ("", "is JSON"), ("[" * 5000, "is JSON"), ("3", "JSON object"), ('{"do": 3}', "no request 3"),
        ('{"do":"frequency"}', "takes value"), ('{"do":"frequency","value":true}', "must be a number"),
        ('{"do":"frequency","value":NaN}', "finite"), ('{"do":"frequency","value":1e999}', "finite"),
        ('{"do":"frequency","value":1' + "0" * 400 + "}", "finite"), ('{"do":"note","value":"a\\u0000"}', "printable"),
        ('{"do":"note","value":"' + "a" * 501 + '"}', "at most 500"), ('{"do":"stop","id":1.5}', "whole"),
        ('{"do":"stop","id":-1}', "within"), ('{"do":"record","value":1}', "true or false"),
        ('{"do":"sweep","frequencies":[],"direction":"up","hold":"command","target":0}', "1 to 200"),
        ('{"do":"sweep","frequencies":[9],"direction":"left","hold":"command","target":0}', "one of"),
        ('{"do":"sweep","frequencies":[9],"direction":"up","hold":"breath","target":0}', "hold must be one of"),
        ("x" * 9000, "at most 8192"),
    ],
)  # fmt: skip
def test_requests_without_sense_are_refused(raw: str, words: str) -> None:
    with pytest.raises(RequestError, match=words):
        parse(raw)


def test_a_request_and_a_frame() -> None:
    held = '{"id":3,"do":"sweep","frequencies":[9,9.1],"direction":"up","hold":"base","target":6e-5}'
    assert parse(held).values["frequencies"] == (9.0, 9.1)
    frame = json_frame(Kind.STATE, 7, {"a": float("nan"), "b": [float("inf"), 1.0], "c": {"d": None}})
    assert frame[8:] == b'{"a":null,"b":[null,1.0],"c":{"d":null}}'
    assert frame[0] == Kind.STATE


def test_joint_states_are_read_from_their_bytes() -> None:
    data = encode_joint_state(3_500_000_001, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    assert decode_joint_state(data) == (3_500_000_001, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    motion = Motion()
    motion.add_state(data, 500_000_001)
    assert motion.states.since(0).tolist() == [[3.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]]
    for cut in range(len(data) - 4):
        with pytest.raises(CodecError):
            decode_joint_state(data[:cut])


@pytest.mark.ros
def test_joint_states_of_ros_are_read_from_their_bytes() -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import JointState

    message = JointState(name=["base", "structure", "sphere"], position=[1.0, 2.0, 3.0], velocity=[4.0, 5.0, 6.0])
    message.header.stamp.sec, message.header.frame_id = 3, "rig"
    assert decode_joint_state(serialize_message(message)) == (3 * 10**9, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    again = deserialize_message(encode_joint_state(5, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)), JointState)
    assert list(again.velocity) == [4.0, 5.0, 6.0]
    assert again.header.stamp.nanosec == 5


def test_readers_of_a_ring_get_what_is_new_to_them() -> None:
    motion = Motion()
    for number in range(5000):
        motion.states.add((float(number), *([0.0] * 6)))
    assert motion.states.since(4990)[:, 0].tolist() == [float(n) for n in range(4990, 5000)]
    assert len(motion.states.since(0, 10_000)) == 4096


def test_journal_curve_and_closed_form() -> None:
    ledger, curve = Ledger(), Curve()
    for topic, table in messages(12):
        if topic == "rig/journal":
            ledger.add(table)
        if topic == "transmissibility/table":
            curve.add(table)
    lines = ledger.part(0)
    assert [line[1] for line in lines if line[1] == "command"]
    assert lines == sorted(lines, key=lambda line: line[0])
    assert ledger.tripped == "the emergency stop"
    rows = curve.part(0)
    assert rows
    assert rows[0]["settled"]
    closed = parts.closed_form({"structure.natural_frequency_hz": 9.105, "structure.damping_ratio": 0.0045})
    assert max(value for _, value in closed) == pytest.approx(111.1, rel=0.01)
    at_drive = np.interp(9.1, *np.array(closed).T)
    assert rows[0]["dt"] == pytest.approx(at_drive, rel=0.05)
    assert parts.closed_form({}) == []


def test_a_snapshot_tells_each_reader_what_is_new() -> None:
    snapshot: Any = Snapshot()
    snapshot.put("a", 1)
    version, found = snapshot.since(0)
    assert found == {"a": 1}
    snapshot.put("a", 1)
    assert snapshot.since(version)[1] == {}
    snapshot.put("b", 2)
    assert snapshot.since(version)[1] == {"b": 2}
