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
"""Monitor messages fit for a plotter: REP-103, REP-117, REP-145, and stamps by the rule."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import attrs
import numpy as np
import pytest
from kits.recorded_rig import KINDS, record

pytest.importorskip("rclpy", reason="no ROS 2 here")

from rclpy.qos import QoSCompatibility, qos_check_compatible, qos_profile_sensor_data
from rclpy.serialization import deserialize_message

from impact_rig.nodes import messages
from impact_rig.nodes.messages import by_name, nanoseconds
from impact_rig.nodes.publishers import Monitors
from impact_rig.nodes.session import Counts
from impact_rig.recording import open_run
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.description import robot_description
from impact_rig.rig.monitors import HALF_PERIODS, AntiAlias, taps
from impact_rig.runs.verification import verify
from impact_rig.topics import Topic

pytestmark = pytest.mark.ros
START_NS = 1_700_000_000_000_000_001
NOISE = {"accelerometer": 0.5, "laser": 2e-6, "base": 1e-6, "current": 2e-3}


def monitored(**values: object) -> tuple[list[Block], dict[str, list]]:
    config = from_flat(RigConfig(), {"drive.amplitude": 0.52, **{k.replace("__", "."): v for k, v in values.items()}})
    blocks = Rig(config, START_NS).advance(START_NS + 500_000_000)
    found: dict[str, list] = {}
    monitors = Monitors(config, NOISE)
    for block in blocks:
        monitors = Monitors(config, NOISE, monitors)  # as after any change of a parameter
        for topic, data in monitors.messages(block, lambda _: True):
            found.setdefault(topic.name, []).append(deserialize_message(data, messages.class_of(topic)))
    return blocks, found


@pytest.fixture(scope="module")
def default() -> tuple[list[Block], dict[str, list]]:
    return monitored()


def test_every_monitor_has_its_rate_stamps_of_scans_and_a_frame(default) -> None:
    blocks, found = default
    stamps = [block.scan.stamp_ns for block in blocks][::2]
    assert set(found) == {"accelerometer", "laser", "base_displacement", "truth/joint_states"}
    for name, received in found.items():
        expected = stamps if name == "truth/joint_states" else stamps[:-HALF_PERIODS]
        assert [nanoseconds(message.header.stamp) for message in received] == expected, "50 Hz: every other block"
        assert received[0].header.frame_id == by_name(name).frame_id != ""


def test_frames_have_the_prefix_of_their_namespace() -> None:
    found = monitored(output__frame_prefix="two/")[1]
    assert {received[0].header.frame_id for received in found.values()} == {
        "two/superior_base", "two/laser", "two/base_sensor", "two/rig",
    }  # fmt: skip


def test_monitor_values_are_low_passed_scans_around_their_stamp(default) -> None:
    blocks, found = default
    rows = np.concatenate([block.scan.rows for block in blocks])
    weights, half = taps(200), HALF_PERIODS * 200
    for k, message in enumerate(found["accelerometer"][HALF_PERIODS:], HALF_PERIODS):
        part = rows[200 * k - half : 200 * k + half + 1]
        assert message.linear_acceleration.x == pytest.approx((part["accelerometer"] * weights).sum(), rel=1e-12)
        assert found["laser"][k].range == pytest.approx(0.050 - (part["laser"] * weights).sum(), rel=1e-6)
        assert found["base_displacement"][k].vector.x == pytest.approx((part["base"] * weights).sum(), rel=1e-12)


def test_a_monitor_passes_the_vibration_without_aliasing() -> None:
    """At 50 Hz, a vibration of 9.1 Hz keeps amplitude and phase; 41 Hz and chatter at 109 Hz must not alias to 9 Hz."""
    time = np.arange(20_000) / 10_000
    rows = np.zeros(20_000, dtype=[("laser", "<f8"), ("status", "u1")])

    def shown(signal: np.ndarray) -> np.ndarray:
        rows["laser"] = signal
        found = AntiAlias(["laser"], 200).feed(0, rows)
        return np.array([smoothed.values["laser"] for smoothed in found][HALF_PERIODS:])

    instants = np.arange(HALF_PERIODS, 100 - HALF_PERIODS) / 50
    assert shown(np.sin(2 * np.pi * 9.1 * time)) == pytest.approx(np.sin(2 * np.pi * 9.1 * instants), abs=0.005)
    for unwanted in (41.0, 109.0, 991.0):
        assert np.abs(shown(np.sin(2 * np.pi * unwanted * time + 0.3))).max() < 0.003


def test_a_filter_at_the_beginning_of_a_record_averages_the_scans_that_exist() -> None:
    rows = np.zeros(400, dtype=[("laser", "<f8"), ("status", "u1")])
    rows["laser"] = 3.0
    found = AntiAlias(["laser"], 20).feed(0, rows)
    assert [one.values["laser"] for one in found] == pytest.approx([3.0] * len(found), rel=1e-12)
    assert found[0].sample == 0


def test_the_filter_does_not_depend_on_the_blocks_and_restarts_after_a_reset() -> None:
    rng = np.random.default_rng(1)
    rows = np.zeros(900, dtype=[("laser", "<f8"), ("status", "u1")])
    rows["laser"] = rng.normal(size=900)
    rows["status"][500] = 4

    def run(stream: AntiAlias, size: int) -> list[tuple[int, float, int]]:
        parts = (stream.feed(k, rows[k : k + size]) for k in range(0, 900, size))
        return [(one.sample, one.values["laser"], one.status) for part in parts for one in part]

    found = AntiAlias(["laser"], 20).feed(13, rows)
    assert [one.sample for one in found] == list(range(20, 900 + 13 - 80, 20)), "none before the first scan"
    stream = AntiAlias(["laser"], 20)
    whole = run(stream, 900)
    assert [sample for sample, _, _ in whole] == list(range(0, 900 - 80, 20))
    assert [sample for sample, _, status in whole if status] == [500]
    assert run(AntiAlias(["laser"], 20), 30) == whole, "to the bit"
    assert run(stream, 900) == whole


def test_the_imu_message_marks_what_it_does_not_measure(default) -> None:
    message = default[1]["accelerometer"][0]
    assert message.orientation_covariance[0] == -1
    assert message.angular_velocity_covariance[0] == -1
    assert message.linear_acceleration_covariance[0] == NOISE["accelerometer"] ** 2
    assert min(message.linear_acceleration_covariance[4], message.linear_acceleration_covariance[8]) >= 1e6


def test_a_laser_out_of_range_reads_infinity_of_the_right_sign() -> None:
    """Without the sphere and at twice the current the superior base leaves this laser's +-4 mm."""
    blocks, found = monitored(
        drive__amplitude=1.2,
        sphere__present=False,
        output__monitor_rate_hz=200.0,
        instruments__laser__half_range_m=4e-3,
    )
    ranges = np.array([message.range for message in found["laser"]])
    assert (ranges == math.inf).any()
    assert (ranges == -math.inf).any()
    finite = ranges[np.isfinite(ranges)]
    message = found["laser"][0]
    assert message.min_range == pytest.approx(0.046)
    assert message.max_range == pytest.approx(0.054)
    assert ((finite >= message.min_range) & (finite <= message.max_range)).all()
    truth = np.concatenate([block.monitor_states for block in blocks])[: len(ranges)]
    assert np.all(truth["x_1"][ranges == math.inf] < 0), "far from the laser: to the left"


def test_joint_states_contain_the_contact_force_as_effort() -> None:
    blocks, found = monitored(barriers__gap_m=0.002, output__monitor_rate_hz=200.0)
    truth = np.concatenate([block.monitor_states for block in blocks])
    for row, message in zip(truth, found["truth/joint_states"], strict=True):
        assert list(message.name) == ["base", "structure", "sphere"]
        assert list(message.position) == [row["x_b"], row["x_1"], row["x_2"]]
        assert list(message.velocity) == [row["v_b"], row["v_1"], row["v_2"]]
        assert message.effort[2] == row["force_left"] - row["force_right"] == -message.effort[1]


def test_joint_states_serve_a_topic_based_hardware_interface_as_documented(default) -> None:
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "ros2_control.md").read_text(encoding="utf-8")
    (snippet,) = re.findall(r"```xml\n(.*?)```", page, flags=re.DOTALL)
    robot = ET.fromstring(snippet)
    xacro = "{http://www.ros.org/wiki/xacro}"
    message = default[1]["truth/joint_states"][0]
    assert [one.get("joint") for one in robot.iter(f"{xacro}state")] == list(message.name)
    for interface in robot.iter("state_interface"):
        assert len(getattr(message, interface.get("name"))) == len(message.name)
    topic = by_name("truth/joint_states")
    assert robot.findtext("ros2_control/hardware/param[@name='joint_states_topic']") == f"/rig/{topic.name}"
    assert topic.type_name == "sensor_msgs/msg/JointState"
    units = {column.name: column.unit for column in topic.fields}
    assert (units["position"], units["velocity"], units["effort"]) == ("m", "m/s", "N")
    joints = {one.get("name"): one for one in ET.fromstring(robot_description(RigConfig())).iter("joint")}
    assert all(joints[name].get("type") == "prismatic" for name in message.name)
    compatible, reason = qos_check_compatible(messages.profile(topic.qos), qos_profile_sensor_data)
    assert compatible != QoSCompatibility.ERROR, reason  # a warning: liveliness is left to the system


@attrs.frozen(eq=False)
class Raw:
    """Message as bytes, in place of a table."""

    data: bytes
    stamp_ns: int = 0

    def encoded(self) -> bytes:
        return self.data


def scans_and_monitors(
    monkeypatch: pytest.MonkeyPatch, since: int = 0, altered: Callable[[Topic, bytes], bytes] = lambda _, data: data
) -> list[tuple[str, Any]]:
    """Return the output of a rig in two seconds: journal, scans, and monitors from a given block on."""
    config = from_flat(RigConfig(), {"drive.amplitude": 0.52, "barriers.gap_m": 0.006})
    rig, found = Rig(config), []
    info = rig.info().rows
    monitors = Monitors(config, dict(zip(info["name"].astype(str), info["noise"].tolist(), strict=True)))
    for topic in messages.MONITORS.values():
        monkeypatch.setitem(KINDS, topic.name, topic.type_name)
    for block in rig.advance(2 * 10**9):
        found += [("rig/journal", table) for table in rig.take_journal()] + [("daq/scan", block.scan)]
        for topic, data in monitors.messages(block, lambda _, number=block.number: number >= since):
            if topic.name in KINDS and topic is not messages.by_name("truth/joint_states"):
                found.append((topic.name, Raw(altered(topic, data))))
    return found


@pytest.mark.parametrize("since", [0, 63], ids=["from the beginning", "since a subscription"])
@pytest.mark.parametrize(
    ("name", "form", "at", "what"),
    [
        ("", "", 0, ""),
        ("accelerometer", "<d", -96, "linear_acceleration.x"),
        ("laser", "<f", -8, "range"),
        ("base_displacement", "<d", -24, "vector.x"),
    ],
    ids=["untouched", "accelerometer", "laser", "base"],
)
def test_verify_finds_a_monitor_reading_that_contradicts_its_scans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, since: int, name: str, form: str, at: int, what: str
) -> None:
    seen = 0

    def altered(topic: Topic, data: bytes) -> bytes:
        nonlocal seen
        seen, changed = seen + (topic.name == name), bytearray(data)
        if seen == 30 and topic.name == name:
            (value,) = struct.unpack_from(form, data, len(data) + at)
            kind = np.dtype(form).type
            struct.pack_into(form, changed, len(data) + at, np.nextafter(kind(value), kind(np.inf)))  # the last bit
        return bytes(changed)

    found = scans_and_monitors(monkeypatch, since, altered)
    with open_run(record(tmp_path / "run", found)) as run:
        verdict = verify(run)
    compared = {one.topic: one.count for one in verdict.topics}
    assert verdict.identical is (not name), verdict
    assert what in verdict.reason
    if not name:
        assert {compared[topic.name] for topic in messages.MONITORS.values()} == {
            96 - (since + 1) // 2 + 4 * (since > 0)
        }


@pytest.mark.parametrize("cut", [1, 2 * HALF_PERIODS, 2 * HALF_PERIODS + 1, 30])
def test_verify_accepts_monitor_messages_that_depend_on_unrecorded_scans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: int
) -> None:
    """Topics end one after the other: the last monitor messages depend on scans that no recording contains."""
    found = scans_and_monitors(monkeypatch)
    last = [place for place, (name, _) in enumerate(found) if name == "daq/scan"][-cut:]
    with open_run(record(tmp_path / "run", [one for place, one in enumerate(found) if place not in last])) as run:
        verdict = verify(run)
    assert verdict.identical, verdict.reason
    assert {one.count for one in verdict.topics if one.topic in {t.name for t in messages.MONITORS.values()}} == {
        (193 - cut) // 2
    }


def test_counts_of_scans_over_range_are_complete_on_request() -> None:
    """Scans are searched many at a time, but the counts are complete whenever they are requested."""
    rig = Rig(from_flat(RigConfig(), {"drive.amplitude": 0.52, "instruments.laser.half_range_m": 1e-4}))
    blocks, counts = rig.advance(400_000_000), Counts()
    expected = 0
    for block in blocks:
        counts.take(block)
        expected += int(((block.scan.rows["status"] >> 1) & 1).sum())
        assert counts.over_range()["laser"] == expected
    assert expected > 0
