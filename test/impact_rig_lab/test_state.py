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
"""Messages for pages: states from keys, requests, joint states, the journal's lines, the speed of rig time."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from kits.recorded_rig import messages
from kits.recording import HandClock

from impact_rig import states, topics
from impact_rig.blocks import Table
from impact_rig.codec import encode, encode_joint_state, joint_state
from impact_rig.errors import CodecError, RecordingError
from impact_rig.instruments.fault import Fault
from impact_rig.instruments.instrument import FAULT_KINDS
from impact_rig.physics.contact import LAWS
from impact_rig.rig import Rig, journal
from impact_rig.rig.config import RigConfig
from impact_rig.rig.journal import InputKind, JournalEntry
from impact_rig.states import Regime, Status
from impact_rig_lab.protocol import FrameKind, RequestError, json_frame, parse
from impact_rig_lab.record import Curve, Faults, MotionBuffer, RigHistory, RigView, plain, scan_rate
from impact_rig_lab.server import STATIC
from impact_rig_lab.state import (
    FAST_FACTOR,
    FOLLOWED,
    GAP_S,
    STALE_S,
    Pace,
    Seen,
    Snapshot,
    choices,
    glossary,
    judge,
    present,
)
from impact_rig_lab.theory import closed_form


def seen(node: str, word: str = "", reason: str = "", age_s: float | None = 0.1, ended: str = "") -> Seen:
    return Seen.of(node, {"state": word, "reason": reason, "instance": "a1"}, age_s, ended)


COLUMNS = [name for name in topics.TRANSMISSIBILITY_TABLE.columns.names if name != "channel"]
MEASURING = seen("analysis", "measuring")


@pytest.mark.parametrize(
    ("rig", "analysis", "doubts", "word", "words"),
    [
        (seen("rig", age_s=None), Seen(), (), "starting", "Waiting"),
        (seen("rig", "driving", age_s=9.0), MEASURING, (), "dead", "9 s"),
        (seen("rig", "driving", ended="its process ended with code -9"), MEASURING, (), "dead", "-9"),
        (seen("rig", "dancing"), MEASURING, (), "unknown", "version"),
        (seen("rig", "inactive", "unconfigured"), Seen(), (), "inactive", "unconfigured"),
        (seen("rig", "rival", "/rig/other publishes daq/scan"), MEASURING, (), "rival", "/rig/other"),
        (seen("rig", "no_peer", "waiting for x"), MEASURING, (), "no peer", "waiting for x"),
        (seen("rig", "silent_peer", "peer x silent"), MEASURING, (), "silent peer", "peer x"),
        (seen("rig", "tripped", "over_travel: 7 mm"), MEASURING, (), "tripped", "over travel: 7 mm"),
        (seen("rig", "paused"), MEASURING, (), "paused", "stands still"),
        (seen("rig", "plucked"), MEASURING, (), "plucked", "reset"),
        (seen("rig", "at_rest"), MEASURING, (), "at rest", "Press R"),
        (seen("rig", "driving"), seen("analysis", "settling"), (), "settling", "transient"),
        (seen("rig", "driving"), seen("analysis", "unable", "over_range"), (), "driving", "now: over range."),
        (seen("rig", "driving"), seen("analysis", "no_scans"), (), "driving", "no scans"),
        (seen("rig", "driving"), seen("analysis", "measuring", age_s=9.0), (), "driving", "silent for 9 s"),
        (seen("rig", "driving"), Seen(), (), "driving", "there is no analysis"),
        (seen("rig", "driving"), MEASURING, ("dropout base is active (truth)",), "driving", "dropout base"),
        (seen("rig", "driving"), MEASURING, (), "measured", "applies"),
    ],
)
def test_the_state_follows_from_the_figures_and_the_gravest_is_shown_first(
    rig: Seen, analysis: Seen, doubts: tuple[str, ...], word: str, words: str
) -> None:
    found = judge(rig, analysis, doubts)
    assert found[0] == word
    assert words in found[1]
    assert present(rig, analysis, doubts)["holds"] is (word in ("measured", "paused")), "the value is grey otherwise"


def test_progress_is_shown_only_for_a_running_analysis() -> None:
    """An analysis that is killed while it settles must not be shown at window 15 of 15 forever."""
    figures = {"state": "settling", "settling_windows": "15", "settling_windows_needed": "15"}
    for age_s, ended, state in ((0.1, "", "settling"), (9.0, "", ""), (0.1, "its process ended with code -9", "")):
        analysis = Seen.of("analysis", figures, age_s, ended)
        found = present(seen("rig", "driving"), analysis)
        assert (found["state"], found["done"]) == (state, 15.0 if state else None)
        assert judge(seen("rig", "driving"), analysis)[0] == (state or "driving")


def test_a_wait_for_the_sphere_is_shown_as_the_reason() -> None:
    """The page must not show a transient of 0.0 % for two minutes instead."""
    why = "waiting up to 60 s for a sphere that may still strike"
    figures = {"state": "settling", "reason": why, "no_impact_s": "12.5", "no_impact_limit_s": "60.0"}
    analysis = Seen.of("analysis", figures, 0.1)
    assert judge(seen("rig", "driving"), analysis) == ("settling", f"{why.capitalize()}.")
    found = present(seen("rig", "driving"), analysis)
    assert (found["reason"], found["quiet"], found["quiet_of"]) == (why, 12.5, 60.0)


def test_the_form_of_a_fault_has_the_fields_of_its_kind() -> None:
    """Each kind needs its own default with a unit, and a rate only if it has one."""
    forms = choices()["faults"]
    assert set(forms) == set(FAULT_KINDS)
    assert [kind for kind, form in forms.items() if form["rate"]] == ["spike_train"]
    assert {kind for kind, form in forms.items() if not form["sizes"]} == {"dropout", "stuck", "lost_block"}
    assert forms["clock_drift"]["sizes"] == {"": {"name": "drift", "unit": "ppm", "scale": 1.0, "default": 100.0}}
    units = {name: size["unit"] for name, size in forms["offset_step"]["sizes"].items()}
    assert units.items() >= {"accelerometer": "m/s^2", "laser": "mm", "base": "mm", "current": "A"}.items()
    assert all(size["unit"] == "" for size in forms["gain_error"]["sizes"].values())
    for kind, form in forms.items():
        for channel, size in form["sizes"].items():
            Fault(kind=kind, channel=channel, value=size["default"] * size["scale"])  # as the form proposes it
    assert forms["saturation"]["sizes"]["laser"] == {"name": "limit ±", "unit": "mm", "scale": 1e-3, "default": 1.0}


def test_every_state_of_a_rig_and_an_analysis_has_a_text() -> None:
    for one in states.RigWord:
        assert judge(seen("rig", one), MEASURING)[1]
    for other in states.AnalysisWord:
        assert judge(seen("rig", "driving"), seen("analysis", other, "over_range"))[1].endswith(".")


def test_a_channel_is_shown_as_valid_only_if_a_row_confirms_it() -> None:
    """The status of a row and the channel it is about; of a sound row the channel only contributes most."""
    curve = Curve()
    assert curve.health() is None
    kind = np.dtype([*((name, topics.TRANSMISSIBILITY_TABLE.columns[name]) for name in COLUMNS), ("channel", "S32")])
    for second, status, channel, found in (
        (1, b"ok", b"laser", {}),
        (2, b"spikes", b"base", {"base": "spikes"}),
        (3, b"accelerometer_over_range", b"laser", {"accelerometer": "accelerometer over range"}),
        (4, b"accelerometer_unsound", b"base", {"accelerometer": "accelerometer unsound"}),
        (5, b"current_unsound", b"laser", {"current": "current unsound"}),
        (6, b"silence", b"", None),
    ):
        rows = np.zeros(1, kind)
        rows["status"], rows["channel"] = status, channel
        curve.add(Table(second * 10**9, rows))
        assert curve.health() == found
    assert curve.health(2 * 10**9) == {"base": "spikes"}
    assert [row["t"] for row in curve.part(0)] == [1.0, 3.0, 4.0, 5.0], "what was not measured is no point of the curve"


def test_channels_are_judged_only_while_the_measured_drive_is_active() -> None:
    """After a pluck of a rig at rest, or after a reset, the page must not show "laser: spikes"."""
    record, row = RigView(), np.zeros(1, topics.TRANSMISSIBILITY_TABLE.columns)
    applied = np.zeros(1, topics.APPLIED.columns)
    assert record.health() is None
    for second, current, status, found in (
        (1, 0.5, b"", None), (5, None, b"ok", {}), (9, None, b"spikes", {"laser": "spikes"}),
        (10, 0.0, b"", None),  # the pluck
        (11, None, b"no_signal", None), (12, 0.0, b"", None),  # its reset
        (13, 0.5, b"", None), (14, None, b"command_changed", None), (20, None, b"ok", {}),
    ):  # fmt: skip
        if current is None:
            row["status"], row["channel"] = status, b"laser" if status in (b"spikes", b"no_signal") else b""
            record.curve.add(Table(second * 10**9, row))
        else:
            applied["current"] = current
            record.take(topics.APPLIED, encode(Table(second * 10**9, applied)))
        assert record.health() == found, second
    assert record.health(9 * 10**9) == {"laser": "spikes"}
    assert record.health(11 * 10**9) is None


def test_a_command_of_the_previous_rig_is_not_current() -> None:
    """The page must not show the current of a rig that has ended for the rig that has replaced it."""
    record, applied, info = RigView(), np.zeros(1, topics.APPLIED.columns), np.zeros(4, topics.INFO.columns)
    applied["frequency"], applied["current"], info["rate"] = 9.1, 1.2, 10_000.0
    record.take(topics.INFO, encode(Table(10**9, info)))
    record.take(topics.APPLIED, encode(Table(2 * 10**9, applied)))
    fault = np.zeros(1, topics.FAULTS.columns)
    fault["kind"], fault["channel"], fault["active"] = b"dropout", b"base", 1
    record.take(topics.FAULTS, encode(Table(2 * 10**9, fault)))
    assert record.drive == {"frequency": 9.1, "current": 1.2}
    assert len(record.doubts()) == 1
    record.told_start_ns = 9 * 10**9  # its diagnostics arrive before its daq/info, or after it
    assert record.drive is None
    assert record.doubts() == []
    record.told_start_ns = 0
    record.take(topics.INFO, encode(Table(9 * 10**9, info)))
    assert record.refused == {}
    assert record.drive is None
    applied["current"] = 0.0
    record.take(topics.APPLIED, encode(Table(9 * 10**9, applied)))
    assert record.drive == {"frequency": 9.1, "current": 0.0}


def test_a_measurement_is_current_until_a_change_and_from_the_first_row_after_it() -> None:
    """A fault is shown as a fault, not as a change; a row with scans from before and after is not current."""
    record, row = RigView(), np.zeros(1, topics.TRANSMISSIBILITY_TABLE.columns)
    row["status"], row["frequency"], row["cycles"], row["gap"] = b"ok", 10.0, 40.0, 0.006

    def add_to_journal(second: int, kind: str, key: str) -> None:
        fault = Fault(kind=key, channel="laser") if kind == "fault" else None
        record.journal.add(JournalEntry(second, InputKind(kind), 0, second * 10**9, name=key, value=1.0, fault=fault))

    changed = "the rig was changed after the measurement began (contact.restitution)"
    for second, what, doubts in (
        (2, ("command", "frequency"), []), (6, None, []), (7, ("fault", "dropout"), []),
        (8, ("parameter", "contact.restitution"), [changed]),
        (10, None, [changed]), (12, None, []),
        (13, ("reset", ""), ["the rig was changed after the measurement began (reset)"]),
    ):  # fmt: skip
        if what is None:
            record.curve.add(Table(second * 10**9, row))
        else:
            add_to_journal(second, *what)
        assert record.doubts() == doubts, second
    assert record.doubts(9 * 10**9) == [changed]
    assert record.doubts(7 * 10**9) == []


def test_the_speed_is_computed_from_the_times_of_one_rig() -> None:
    """The times of two rigs in one namespace, or of one that was restarted, are unrelated."""
    now = [0.0]
    pace = Pace(lambda: now[0])
    for at_s, rig_s, instance, speed in (
        (1.0, 70.0, "a", 0.0), (2.0, 71.0, "a", 1.0), (2.1, 0.0, "b", 0.0), (3.0, 72.0, "a", 0.0),
        (4.0, 73.0, "a", 1.0),
    ):  # fmt: skip
        now[0] = at_s
        assert pace.read(rig_s, instance) == speed


def test_every_displayed_term_has_a_help_text() -> None:
    help_ = glossary()
    words = {plain(one) for table in (*states.BY_NODE.values(), Status, Regime) for one in table}
    words |= {plain(name) for name in (*LAWS, *FAULT_KINDS)}
    lamps = re.search(r"const LAMPS = \{(.*?)\};", (STATIC / "store.js").read_text(encoding="utf-8"), re.DOTALL)
    assert lamps is not None
    words |= {quoted or bare for quoted, bare in re.findall(r'(?:"([a-z ]+)"|(\b[a-z]+)): "', lamps[1])}
    assert len(words) > 70
    assert sorted(words - help_.keys()) == []
    assert all(text.endswith((".", ").")) for text in help_.values())


def test_a_measurement_taken_during_a_fault_is_not_current_after_it() -> None:
    """After a gain error is cleared, the page must not say that the measurement applies: its value is wrong."""
    record, row = RigView(), np.zeros(1, topics.TRANSMISSIBILITY_TABLE.columns)
    row["status"], row["frequency"], row["cycles"], row["gap"] = b"ok", 10.0, 40.0, 0.006
    fault = np.zeros(1, topics.FAULTS.columns)
    fault["id"], fault["kind"], fault["channel"], fault["value"] = 1, b"gain_error", b"base", 0.05
    for second, active in ((3, 1), (5, 0)):
        fault["active"] = active
        record.take(topics.FAULTS, encode(Table(second * 10**9, fault)))
    for end_s, doubts in ((6, 1), (8.9, 1), (9.1, 0)):  # each of four seconds
        record.curve.add(Table(round(end_s * 1e9), row))
        assert len(record.doubts()) == doubts, end_s
    assert record.doubts(6 * 10**9) == ["gain error base (0.05) was active during the measurement (truth)"]


def test_a_measurement_with_another_gap_than_the_rig_is_not_current() -> None:
    record, row = RigView(), np.zeros(1, topics.TRANSMISSIBILITY_TABLE.columns)
    row["status"], row["frequency"], row["cycles"] = b"ok", 10.0, 40.0
    for label_m, doubts in ((0.006, 0), (math.nan, 0), (0.003, 1), (0.0, 1)):
        row["gap"] = label_m
        record.curve.add(Table(6 * 10**9, row))
        assert len(record.doubts()) == len(record.doubts(7 * 10**9)) == doubts
    assert record.doubts() == ["its label states a gap of 0 mm, the rig has 6 mm"]


def test_a_fault_before_a_reset_is_not_active_in_playback() -> None:
    record, fault = RigView(None), np.zeros(1, topics.FAULTS.columns)
    fault["kind"], fault["channel"], fault["active"] = b"stuck", b"laser", 1
    record.take(topics.FAULTS, encode(Table(3 * 10**9, fault)))
    for second, kind in ((1, InputKind.START), (5, InputKind.RESET)):
        record.take(topics.JOURNAL, journal.encode(JournalEntry(0, kind, 0, second * 10**9)))
    assert record.refused == {}
    found = [record.faults.in_force(record.since_ns(at), at) for at in (2 * 10**9, 4 * 10**9, 6 * 10**9)]
    assert [len(one) for one in found] == [0, 1, 0]


def test_faults_are_active_from_begin_to_end_and_not_after_a_restart() -> None:
    faults, rows = Faults(), np.zeros(1, topics.FAULTS.columns)
    rows["id"], rows["kind"], rows["channel"], rows["active"], rows["value"] = 1, b"gain_error", b"laser", 1, 0.05
    faults.add(Table(2 * 10**9, rows))
    assert faults.in_force(0) == ["gain error laser (0.05)"]
    assert faults.in_force(0, 10**9) == []
    assert faults.in_force(3 * 10**9) == []
    rows = rows.copy()
    rows["active"] = 0
    faults.add(Table(4 * 10**9, rows))
    assert faults.in_force(0) == []
    assert faults.in_force(0, 3 * 10**9) != []


def test_the_line_of_a_fault_has_its_time_within_the_block() -> None:
    history, rows = RigHistory(), np.zeros(2, topics.FAULTS.columns)
    rows["time"], rows["kind"], rows["channel"], rows["active"] = (0.25, 0.5), b"dropout", b"base", (1, 0)
    history.fault(Table(3 * 10**9, rows))
    assert history.part(10**9) == [[2.25, "fault", "begins", "dropout base"], [2.5, "fault", "ends", "dropout base"]]


@pytest.mark.parametrize(
    ("kind", "channel", "value", "words"),
    [
        (b"saturation", b"laser", 3e-3, "saturation laser (3 mm)"),
        (b"added_noise", b"current", 0.01, "added noise current (0.01 A)"),
        (b"clock_drift", b"", 100.0, "clock drift (100 ppm)"),
        (b"dropout", b"base", 1e-4, "dropout base"),
    ],
)
def test_an_active_fault_has_the_unit_of_its_form(kind: bytes, channel: bytes, value: float, words: str) -> None:
    faults, rows = Faults(), np.zeros(1, topics.FAULTS.columns)
    rows["kind"], rows["channel"], rows["active"], rows["value"] = kind, channel, 1, value
    faults.add(Table(10**9, rows))
    assert faults.in_force(0) == [words]


@pytest.mark.parametrize("rate", [math.nan, 0.0, math.inf, 1e12, -1.0])
def test_an_impossible_rate_is_rejected_before_buffers_are_allocated(rate: float) -> None:
    info = np.zeros(1, topics.INFO.columns)
    info["rate"] = rate
    with pytest.raises(RecordingError, match="a rate of"):
        scan_rate(Table(0, info))
    with pytest.raises(RecordingError, match="daq/info has no rows, so that its rate is unknown"):
        scan_rate(Table(0, info[:0]))


def test_every_parameter_of_a_change_is_in_the_journal() -> None:
    """A gap that is set together with the sphere is the second value of one change."""
    rig = Rig(RigConfig())
    journal = RigHistory()
    rig.configure({"sphere.present": False})
    rig.configure({"sphere.present": True, "barriers.gap_m": 0.004})
    for table in rig.take_journal():
        journal.add(table)
    lines = [" ".join(line[1:]) for line in journal.part(0)]
    assert "parameter sphere.present 1" in lines
    assert "parameter barriers.gap_m 0.004" in lines


VIEW = '{"do":"view","span":1,"columns":100,"trigger":false,"spectrum":"laser","top":100}'


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        ("", "a JSON object"), ("[" * 5000, "a JSON object"), ("3", "a JSON object"), ('{"do": 3}', "no request 3"),
        ('{"do":"frequency"}', "takes value"), ('{"do":"frequency","value":true}', "must be a number"),
        ('{"do":"frequency","value":NaN}', "finite"), ('{"do":"frequency","value":1e999}', "finite"),
        ('{"do":"frequency","value":1' + "0" * 400 + "}", "1.8e308"), ('{"do":"note","value":"a\\u0000"}', "printable"),
        ('{"do":"note","value":"' + "a" * 501 + '"}', "at most 500"), ('{"do":"stop","id":1.5}', "whole"),
        ('{"do":"stop","id":-1}', "within"), ('{"do":"record","value":1}', "true or false"),
        ('{"do":"sweep","frequencies":[],"direction":"up","hold":"command","target":0}', "1 to 200"),
        ('{"do":"sweep","frequencies":[0],"direction":"up","hold":"command","target":0}', "each frequency in Hz"),
        ('{"do":"sweep","frequencies":[9],"direction":"left","hold":"command","target":0}', "one of"),
        ('{"do":"sweep","frequencies":[9],"direction":"up","hold":"breath","target":0}', "hold must be one of"),
        ("x" * 70000, "at most 65536"), ("é" * 40000, "at most 65536 bytes, got 80000"),
        (VIEW.replace("laser", "mood"), "spectrum must be one of an empty text, "),
    ],
)  # fmt: skip
def test_invalid_requests_are_rejected(raw: str, words: str) -> None:
    with pytest.raises(RequestError, match=words):
        parse(raw)


def test_requests_are_parsed_and_frames_are_valid_json() -> None:
    held = '{"id":3,"do":"sweep","frequencies":[9,9.1],"direction":"up","hold":"base","target":6e-5}'
    assert parse(held).values["frequencies"] == (9.0, 9.1)
    frame = json_frame(FrameKind.STATE, 7, {"a": float("nan"), "b": [float("inf"), 1.0], "c": {"d": None}})
    assert frame[8:] == b'{"a":null,"b":[null,1.0],"c":{"d":null}}'
    assert frame[0] == FrameKind.STATE


def as_numbers(data: bytes) -> tuple[object, ...]:
    stamp, values = joint_state(data)
    return stamp, *(one.tolist() for one in values)


def test_joint_states_are_read_from_their_bytes() -> None:
    data = encode_joint_state(3_500_000_001, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    assert as_numbers(data) == (3_500_000_001, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [])
    motion = MotionBuffer()
    motion.add_state(data, 500_000_001)
    assert motion.states.since(0).tolist() == [[3.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]]
    for cut in range(len(data) - 4):
        with pytest.raises(CodecError):
            joint_state(data[:cut])


@pytest.mark.ros
def test_joint_states_of_ros_are_read_from_their_bytes() -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import JointState

    message = JointState(name=["base", "structure", "sphere"], position=[1.0, 2.0, 3.0], velocity=[4.0, 5.0, 6.0])
    message.header.stamp.sec, message.header.frame_id = 3, "rig"
    assert as_numbers(serialize_message(message)) == (3 * 10**9, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [])
    again = deserialize_message(encode_joint_state(5, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)), JointState)
    assert list(again.velocity) == [4.0, 5.0, 6.0]
    assert again.header.stamp.nanosec == 5


def test_each_reader_of_a_ring_gets_the_rows_that_are_new_to_it() -> None:
    motion = MotionBuffer()
    for number in range(5000):
        motion.states.add((float(number), *([0.0] * 6)))
    assert motion.states.since(4990)[:, 0].tolist() == [float(n) for n in range(4990, 5000)]
    assert len(motion.states.since(0, 10_000)) == 4096


@pytest.mark.heavy
def test_journal_and_curve_follow_the_messages_and_the_closed_form() -> None:
    journal, curve = RigHistory(), Curve()
    for topic, table in messages(12):
        if topic == "rig/journal":
            journal.add(table)
        if topic == "transmissibility/table":
            curve.add(table)
    lines = journal.part(0)
    assert [line[1] for line in lines if line[1] == "command"]
    assert lines == sorted(lines, key=lambda line: line[0])
    assert any(line[1] == "stop" for line in lines)
    rows = curve.part(0)
    assert rows
    assert rows[0]["settled"]
    closed = closed_form({"structure.natural_frequency_hz": 9.105, "structure.damping_ratio": 0.0045})
    assert max(value for _, value in closed) == pytest.approx(111.1, rel=0.01)
    at_drive = np.interp(9.1, *np.array(closed).T)
    assert rows[0]["dt"] == pytest.approx(at_drive, rel=0.05)
    assert closed_form({}) == []


def test_a_snapshot_contains_what_is_new_to_its_reader() -> None:
    snapshot: Any = Snapshot()
    snapshot.put(a=1)
    version, found = snapshot.since(0)
    assert found == {"a": 1}
    snapshot.put(a=1)
    assert snapshot.since(version)[1] == {}
    snapshot.put(a=1, b=2, c=3)
    version, found = snapshot.since(version)
    assert found == {"b": 2, "c": 3}
    assert snapshot.since(version - 1)[1] == found, "parts that were set together are sent together"


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


def speed(clock: HandClock, pace: Pace, factor: float) -> float:
    """Return the speed after two readings, half a second apart."""
    pace.read(50.0)
    clock.now_s += 0.5
    return pace.read(50.0 + 0.5 * factor)


@pytest.mark.parametrize("factor", [0.5, 1.0, 4.0, 16.0])
def test_the_speed_is_that_between_two_readings(clock: HandClock, factor: float) -> None:
    pace = Pace(clock)
    assert speed(clock, pace, factor) == pytest.approx(factor)
    assert pace.is_hurried == (factor > FAST_FACTOR)
    assert pace.is_followed == (factor <= FOLLOWED)


def test_one_reading_yields_no_speed(clock: HandClock) -> None:
    pace = Pace(clock)
    assert pace.read(7.0) == 0.0
    assert pace.is_followed


def test_no_speed_is_shown_of_a_rig_that_reports_a_pause(clock: HandClock) -> None:
    pace = Pace(clock)
    pace.read(1.0)
    clock.now_s += 1.0
    assert pace.read(3.0) == 2.0
    clock.now_s += 1.0
    assert (pace.read(3.5, stands=True), pace.is_hurried) == (0.0, False)


def test_no_speed_is_shown_after_rig_time_has_stopped_for_a_while(clock: HandClock) -> None:
    pace = Pace(clock)
    speed(clock, pace, 2.0)
    clock.now_s += STALE_S
    assert pace.read(51.0) == pytest.approx(2.0), "there are at most two readings a second"
    clock.now_s += 0.1
    assert pace.read(51.0) == 0.0


def test_a_reset_or_a_long_silence_yields_no_speed(clock: HandClock) -> None:
    pace = Pace(clock)
    speed(clock, pace, 2.0)
    clock.now_s += 0.5
    assert pace.read(0.1) == pytest.approx(2.0)
    clock.now_s += GAP_S
    assert pace.read(1000.0) == pytest.approx(2.0)


def test_a_drive_received_before_a_rig_started_is_not_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rig at twice our speed stamps a minute ahead after a minute; the stamps of the next rig begin before that."""
    now_s = [100.0]
    monkeypatch.setattr("impact_rig_lab.record.time.monotonic", lambda: now_s[0])
    record = RigView()
    rows = np.zeros(1, topics.APPLIED.columns)
    rows["current"] = 1.2
    record.take(topics.APPLIED, encode(Table(60 * 10**9, rows)))
    record.told_start_ns = 30 * 10**9
    assert record.drive == {"frequency": 0.0, "current": 1.2}
    record.begun_at_s = 110.0
    assert record.drive is None
    now_s[0], rows["current"] = 111.0, 0.0
    record.take(topics.APPLIED, encode(Table(30 * 10**9, rows)))
    assert record.drive == {"frequency": 0.0, "current": 0.0}
