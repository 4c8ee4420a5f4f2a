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
"""`verify` and `analyze`: identical for an unchanged run, the first difference for a changed one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest
from kits.recorded_rig import (
    PROVENANCE,
    TICK,
    Messages,
    Remark,
    edited,
    everything,
    messages,
    published,
    record,
    spikes,
)  # fmt: skip

from impact_rig.arithmetic import ARITHMETIC
from impact_rig.cli import main
from impact_rig.recording import Provenance, arithmetic_of, open_run
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.journal import BEGINNINGS, InputKind, JournalEntry
from impact_rig.runs import reanalysis, recover
from impact_rig.runs.verification import Verification, verify

pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def complete_run() -> Messages:
    return messages()


def verdict(directory: Path, found: Messages) -> Verification:
    with open_run(record(directory / "run", found)) as run:
        return verify(run)


def test_a_run_agrees_with_its_journal_bit_for_bit(complete_run: Messages, tmp_path: Path) -> None:
    """With commands, changed mechanics, a fault and an emergency stop, every scan is re-simulated bit for bit."""
    found = verdict(tmp_path, complete_run)
    scans = sum(len(table.rows) for name, table in complete_run if name == "daq/scan")
    assert found == Verification(True, scans)


def test_a_run_of_a_late_recorder_can_be_verified(complete_run: Messages, tmp_path: Path) -> None:
    late = [(name, table) for name, table in complete_run if name != "daq/scan" or table.stamp_ns >= 300 * TICK]
    assert verdict(tmp_path, late).identical


def test_one_changed_bit_is_named(complete_run: Messages, tmp_path: Path) -> None:
    """The message names topic, stamp of the table, row and both values."""
    number = iter(range(10**6))

    def change(rows: np.ndarray) -> np.ndarray:
        if next(number) == 123:
            rows["laser"][45] = np.nextafter(rows["laser"][45], 1.0)
        return rows

    found = verdict(tmp_path, edited(complete_run, "daq/scan", change))
    assert (found.identical, found.scans) == (False, 12_300)
    true = next(table for name, table in complete_run if name == "daq/scan" and table.stamp_ns == 123 * TICK)
    assert found.reason == (
        "daq/scan in the table at 1.230000000 s, row 45 (from 0), laser: logged "
        f"{float(np.nextafter(true.rows['laser'][45], 1.0))!r}, re-simulated {float(true.rows['laser'][45])!r}"
    )


def test_a_changed_command_or_seed_is_found_where_it_takes_effect(complete_run: Messages, tmp_path: Path) -> None:
    def command(entry: JournalEntry) -> JournalEntry:
        return attrs.evolve(entry, value=entry.value * 1.001) if entry.name == "current" else entry

    found = verdict(tmp_path / "command", edited(complete_run, "rig/journal", command))
    assert found.identical is False
    assert found.scans < 2_000
    assert "daq/scan in the table at 0." in found.reason

    def seed(entry: JournalEntry) -> JournalEntry:
        return attrs.evolve(entry, values=entry.values | {"daq.seed": 6}) if "daq.seed" in entry.values else entry

    found = verdict(tmp_path / "seed", edited(complete_run, "rig/journal", seed))
    assert (found.identical, found.scans) == (False, 0)
    assert "daq/scan in the table at 0.000000000 s, row 0 (from 0)" in found.reason


def test_a_lost_block_is_a_difference(complete_run: Messages, tmp_path: Path) -> None:
    found = verdict(tmp_path, [m for m in complete_run if not (m[0] == "daq/scan" and m[1].stamp_ns == 50 * TICK)])
    assert (found.identical, found.scans) == (False, 5_000)
    assert "the block at 0.500000000 s is missing" in found.reason


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda entry: entry if entry.sequence else None, "entry 0, counted from 0, is missing"),
        (lambda entry: None if entry.name == "frequency" else entry, "is missing"),
        (lambda entry: None, "no topic 'rig/journal'"),
        (lambda entry: Remark(entry.line().replace('"sample": ', '"sample": -1'), entry.stamp_ns), "from 0 to 2^53"),
    ],
    ids=["beginning", "middle", "none", "negative"],
)
def test_a_run_with_an_incomplete_journal_cannot_be_verified(
    complete_run: Messages, tmp_path: Path, change: Callable[[JournalEntry], Any], reason: str
) -> None:
    found = verdict(tmp_path, edited(complete_run, "rig/journal", change))
    assert found.identical is None
    assert reason in found.reason


class _OldProvenance(Provenance):
    """Provenance from a recorder that wrote no version of the arithmetic."""

    def to_record(self) -> dict[str, str]:
        return {key: value for key, value in super().to_record().items() if key != "arithmetic"}


@pytest.mark.parametrize(
    "provenance",
    [attrs.evolve(PROVENANCE, arithmetic=1), _OldProvenance(version="0", seed=5, wall_start_ns=0)],
    ids=["named", "unwritten"],
)
def test_a_run_of_another_arithmetic_is_not_called_different(
    complete_run: Messages, tmp_path: Path, provenance: Provenance
) -> None:
    """This version cannot compute its bits: a changed scan is not found, and nothing is called different."""

    def change(rows: np.ndarray) -> np.ndarray:
        rows["laser"][0] += 1e-6
        return rows

    run = record(tmp_path / "run", edited(complete_run, "daq/scan", change), provenance)
    with open_run(run) as opened:
        found = verify(opened)
    remedy = "verify it with the version of impact_rig that recorded it"
    reason = f"recorded with arithmetic version 1, this program has {ARITHMETIC}: {remedy}"
    assert found == Verification(None, 0, reason)
    assert str(found).startswith("not verifiable: recorded with arithmetic version 1")


def test_a_run_of_another_recorder_is_verified_by_its_journal(complete_run: Messages, tmp_path: Path) -> None:
    with open_run(record(tmp_path / "run", complete_run, None)) as opened:
        assert opened.provenance == {}
        assert verify(opened).identical


def test_a_recovered_run_keeps_its_arithmetic(complete_run: Messages, tmp_path: Path) -> None:
    old = _OldProvenance(version="0", seed=5, wall_start_ns=0)
    rescued = tmp_path / "rescued"
    recover(record(tmp_path / "run", complete_run[:200], old), rescued)
    with open_run(rescued) as opened:
        assert arithmetic_of(opened.provenance) == "1"


@pytest.mark.parametrize("deed", ["drive", "gap", "reset"])
def test_data_that_a_killed_recorder_had_not_received_are_no_difference(tmp_path: Path, deed: str) -> None:
    """Topics overtake each other: scans and other topics were recorded, but not the entry about the cause."""
    rig = Rig(from_flat(RigConfig(), {"daq.seed": 5, "drive.amplitude": 0.52}))
    deeds: dict[str, Callable[[], object]] = {
        "drive": lambda: rig.accept(frequency_hz=9.3),
        "gap": lambda: rig.configure({"barriers.gap_m": 0.001}),
        "reset": rig.reset,
    }
    found = everything(rig, 260, {120: deeds[deed]})
    lost = next(n for n, (name, one) in enumerate(found) if name == "rig/journal" and one.stamp_ns >= 120 * TICK)
    lacking = [*found[:lost], *((name, one) for name, one in found[lost:] if name != "rig/journal")]
    blocks = np.cumsum([name == "daq/scan" for name, _ in lacking])

    def killed(count: int) -> Verification:
        path = record(tmp_path / f"killed_{count}", lacking[: int(np.searchsorted(blocks, count)) + 1])
        (file,) = path.glob("*.mcap")
        file.write_bytes(file.read_bytes()[:-20])  # as if the recorder had not finished
        recover(path, tmp_path / f"recovered_{count}")
        with open_run(tmp_path / f"recovered_{count}") as run:
            return verify(run)

    soon = killed(200)
    assert soon.identical, soon.reason
    assert soon.scans == 9_900
    assert soon.not_checked[0].startswith(
        "the last 101 blocks: inputs that act on them may not have reached the recorder"
    )
    assert not killed(240).identical, "an entry of 1.2 s before the end is there"
    assert not verdict(tmp_path, lacking[: int(np.searchsorted(blocks, 200)) + 1]).identical, "a finished recording"


@pytest.mark.parametrize("late", [0, 20])
def test_a_recorder_killed_within_a_second_is_not_called_identical_or_different(tmp_path: Path, late: int) -> None:
    """Inputs that act on all of its blocks may be missing, so that even the first one proves nothing."""
    rig = Rig(from_flat(RigConfig(), {"daq.seed": 5, "drive.amplitude": 0.52}))
    found = everything(rig, 50, {late: lambda: rig.accept(frequency_hz=9.3)})
    lacking = [
        (name, one) for name, one in found if name != "rig/journal" or one.sequence == 0 or one.stamp_ns < late * TICK
    ]
    assert verdict(tmp_path, lacking).identical is False, "a finished recording"
    path = record(tmp_path / "killed", lacking)
    (file,) = path.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-20])  # as if the recorder had not finished
    recover(path, tmp_path / "recovered")
    with open_run(tmp_path / "recovered") as run:
        assert str(verify(run)).startswith("not verifiable: its recorder ended so early that inputs")
    path = record(tmp_path / "silent", [one for one in lacking if one[0] != "rig/journal"])
    (file,) = path.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-20])
    recover(path, tmp_path / "silent_recovered")
    with open_run(tmp_path / "silent_recovered") as run:
        assert "rig/journal" in str(verify(run)), "the missing journal is the reason that helps"


def reset_rig() -> tuple[Messages, Messages, Messages]:
    """Rig that is reset twice, each time with another seed, and measures before, between and after the resets."""
    rig = Rig(from_flat(RigConfig(), {"daq.seed": 5, "drive.amplitude": 0.52}))
    parts = []
    for seed in (6, 7, 8):
        rig.accept(frequency_hz=float(seed))
        parts.append(published(rig, 30))
        rig.configure({"daq.seed": seed})
        rig.reset()
    return tuple(parts)


def test_a_run_with_resets_is_verified_throughout(tmp_path: Path) -> None:
    """The journal before the reset must be kept; without it, a valid run would differ from the first scan on."""
    first, second, third = reset_rig()
    found = verdict(tmp_path / "whole", [*first, *second, *third])
    assert found == Verification(True, 3 * 30 * 100)
    late = [(name, table) for name, table in first if name != "daq/scan"]
    assert verdict(tmp_path / "late", [*late, *second, *third]) == Verification(True, 2 * 30 * 100)


def test_a_difference_after_a_reset_is_found(tmp_path: Path) -> None:
    first, second, third = reset_rig()

    def change(rows: np.ndarray) -> np.ndarray:
        rows["base"][-1] += 1.0
        return rows

    found = verdict(tmp_path / "changed", [*first, *edited(second, "daq/scan", change), *third])
    assert (found.identical, found.scans) == (False, 30 * 100)
    assert "daq/scan in the table at 0.3" in found.reason


def test_a_block_lost_before_a_reset_is_reported_as_missing(tmp_path: Path) -> None:
    first, second, third = reset_rig()
    lost = max(table.stamp_ns for name, table in second if name == "daq/scan")
    for missing in (lost, lost - TICK):
        part = [(name, table) for name, table in second if name != "daq/scan" or table.stamp_ns != missing]
        found = verdict(tmp_path / str(missing), [*first, *part, *third])
        assert found.identical is False
        assert "is missing" in found.reason


@pytest.mark.parametrize("start_ns", [0, 10**10], ids=["lockstep", "realtime"])
def test_a_restarted_rig_begins_a_new_journal(tmp_path: Path, start_ns: int) -> None:
    """In simulated time its stamps start at zero again; in real time the end of the first run is unknown."""
    first, _, _ = reset_rig()
    again = published(Rig(from_flat(RigConfig(), {"daq.seed": 9}), start_ns), 20)
    assert verdict(tmp_path, [*first, *again]) == Verification(True, 50 * 100)


def test_a_block_withheld_by_a_fault_does_not_count_as_lost(tmp_path: Path) -> None:
    planned = ("lost_block start_s=0.1 duration_s=0.05",)
    rig = Rig(from_flat(RigConfig(), {"instruments.faults.planned": planned}))
    found = published(rig, 40)
    scans = [table for name, table in found if name == "daq/scan"]
    assert len(scans) < 40
    assert verdict(tmp_path, found) == Verification(True, sum(len(table.rows) for table in scans))


def test_verify_analyze_info_and_export_accept_a_complete_run(
    complete_run: Messages, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    run = str(record(tmp_path / "run", complete_run))
    assert main(["verify", run]) == 0
    assert "identical: 120000 scans re-simulated bit for bit" in " ".join(capsys.readouterr().out.split())
    assert main(["analyze", run]) == 0
    assert "identical to the live results" in capsys.readouterr().out
    assert main(["info", run]) == 0
    assert "1200 blocks of daq/scan without a gap" in " ".join(capsys.readouterr().out.split())
    assert main(["export", run, "shaker/applied", str(tmp_path / "applied.csv")]) == 0
    assert (tmp_path / "applied.csv").read_text().count("\n") > 3
    assert main(["verify", str(tmp_path)]) == 1
    assert "holds no *.mcap file, so it is not a recording; name one of the recordings in it: run" in " ".join(
        capsys.readouterr().err.split()
    )


def test_a_run_is_analysed_with_its_recorded_settings(complete_run: Messages, tmp_path: Path) -> None:
    """A run measured with other settings is analysed with them, and its label holds."""
    with open_run(record(tmp_path / "run", complete_run)) as run:
        default = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(run)))

    def change(rows: np.ndarray) -> np.ndarray:
        rows["value"][rows["key"] == b"harmonics"] = 1
        rows["value"][rows["key"] == b"gap_m"] = 0.0004
        return rows

    with open_run(record(tmp_path / "other", edited(complete_run, "analysis/settings", change))) as run:
        other = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(run)))
    assert default["gap"][0] == 0.0
    assert other["gap"][0] == 0.0004
    distortion = [rows[rows["settled"] == 1]["thd"][0] for rows in (default, other)]
    assert distortion[0] > distortion[1] == 0.0, "one harmonic knows no distortion"


def test_tables_of_another_kind_are_not_taken_for_settings(complete_run: Messages, tmp_path: Path) -> None:
    def change(rows: np.ndarray) -> np.ndarray:
        rows["key"][0] = b"unheard"
        return rows

    assert main(["analyze", str(record(tmp_path / "run", edited(complete_run, "analysis/settings", change)))]) == 1


@pytest.fixture(scope="module")
def recorded() -> list[tuple[str, object]]:
    """Everything that a rig publishes about itself: it has impacts, a fault, a trip and a reset, and continues."""
    rig = Rig(from_flat(RigConfig(), {"daq.seed": 5, "barriers.gap_m": 0.002, "output.truth_scan": True}))
    return everything(
        rig,
        300,
        {
            5: lambda: rig.accept(frequency_hz=9.1),
            6: lambda: rig.accept(amplitude=0.52),
            60: lambda: rig.inject(spikes(rig.frontier_sample + 50)),
            70: lambda: rig.configure({"instruments.laser.lag_s": 0.001}),
            75: lambda: rig.inject(spikes(rig.frontier_sample + 50)),
            80: lambda: rig.clear_fault(1),
            100: lambda: rig.configure({"shaker.travel_limit_m": 1e-4}),  # trips
            125: lambda: rig.configure({"shaker.travel_limit_m": 0.006}),
            130: rig.clear_trip,
            140: rig.reset,
            150: lambda: rig.configure({"sphere.present": False}),
            155: lambda: rig.configure({"sphere.present": True}),
            160: lambda: rig.accept(frequency_hz=8.9, amplitude=0.4),
        },
    )


def test_every_topic_of_the_rig_is_compared_and_reported(recorded, tmp_path: Path) -> None:
    found = verdict(tmp_path, recorded)
    assert found.identical, [str(one) for one in found.topics if one.difference]
    counts = {one.topic: one.count for one in found.topics}
    published = {name: sum(one == name for one, _ in recorded) for name, _ in recorded}
    for name in ("truth/scan", "truth/impacts", "truth/faults", "truth/joint_states", "daq/info", "rig/configuration"):
        assert counts[name] == published[name] > 0, name
    assert counts["shaker/applied"] == published["shaker/applied"]
    assert counts["rig/journal"] == published["rig/journal"]


@pytest.mark.parametrize("first_block", [3, 80, 200], ids=lambda block: f"block {block}")
def test_topics_that_a_late_recorder_missed_are_no_difference(recorded, tmp_path: Path, first_block: int) -> None:
    """Truth and scans begin one after the other; latched messages are there from before."""
    latched = ("rig/journal", "shaker/applied", "daq/info", "truth/faults", "rig/configuration")
    scans = [place for place, (name, _) in enumerate(recorded) if name == "daq/scan"]
    late = [
        one
        for place, one in enumerate(recorded)
        if one[0] in latched or place >= scans[first_block] + (400 if one[0] == "truth/joint_states" else 0)
    ]
    found = verdict(tmp_path, late)
    assert found.identical, found.reason


def altered(rows, name, value):
    rows[name][-1] = value(rows[name][-1])
    return rows


TAMPERED = {
    "truth/scan": lambda rows: altered(rows, "x_2", lambda x: np.nextafter(x, 1.0)),
    "truth/impacts": lambda rows: altered(rows, "energy_lost", lambda x: 1.01 * x),
    "truth/faults": lambda rows: altered(rows, "value", lambda x: x + 1e-9),
    "shaker/applied": lambda rows: altered(rows, "current", lambda x: x + 1e-12),
    "daq/info": lambda rows: altered(rows, "noise", lambda x: 1.001 * x),
}


@pytest.mark.parametrize("where", [0.3, 0.9])
@pytest.mark.parametrize("topic", TAMPERED)
def test_an_altered_value_of_any_other_topic_is_named(recorded, tmp_path: Path, topic: str, where: float) -> None:
    places = [place for place, (name, _) in enumerate(recorded) if name == topic]
    place = places[int(where * len(places))]
    found = verdict(
        tmp_path,
        [*recorded[:place], *edited(recorded[place : place + 1], topic, TAMPERED[topic]), *recorded[place + 1 :]],
    )
    assert found.identical is False
    assert found.reason.startswith(f"{topic}: ")
    assert "logged" in found.reason


@pytest.mark.parametrize("topic", [*TAMPERED, "truth/joint_states"])
def test_a_missing_or_invented_message_is_named(recorded, tmp_path: Path, topic: str) -> None:
    places = [place for place, (name, _) in enumerate(recorded) if name == topic]
    place = places[len(places) // 2]
    name, one = recorded[place]
    made_up = (name, attrs.evolve(one, stamp_ns=one.stamp_ns - 1_000_001))
    found = verdict(tmp_path / "more", [*recorded[:place], made_up, *recorded[place:]])
    assert found.identical is False
    assert found.reason.startswith(f"{topic}: at ")
    assert "a message is recorded that the re-simulation does not publish" in found.reason
    if topic not in ("truth/scan", "truth/joint_states"):  # the journal does not determine their number
        found = verdict(tmp_path / "less", [*recorded[:place], *recorded[place + 1 :]])
        assert found.identical is False
        assert "is missing" in found.reason


def test_an_altered_joint_state_and_configuration_are_named(recorded, tmp_path: Path) -> None:
    places = [place for place, (name, _) in enumerate(recorded) if name == "truth/joint_states"]
    name, one = recorded[places[40]]
    values = one.values.copy()
    values[4] = np.nextafter(values[4], 1.0)
    found = verdict(
        tmp_path / "joints",
        [*recorded[: places[40]], (name, attrs.evolve(one, values=values)), *recorded[places[40] + 1 :]],
    )
    assert found.identical is False
    assert found.reason.startswith("truth/joint_states: at ")
    assert "velocity: logged" in found.reason
    other = [
        (name, attrs.evolve(one, text=one.text.replace("gap_m: 0.002", "gap_m: 0.0021")) if "config" in name else one)
        for name, one in recorded
    ]
    found = verdict(tmp_path / "configuration", other)
    assert found.identical is False
    assert "barriers.gap_m is 0.0021, but 0.002 in the most similar configuration of the journal" in found.reason


def test_a_session_that_returned_to_its_first_configuration_is_no_difference(recorded, tmp_path: Path) -> None:
    """The first earlier latched text equals the run's own, the next one does not; this is no difference."""
    place = next(place for place, (name, _) in enumerate(recorded) if name == "rig/configuration")
    name, own = recorded[place]
    other = (name, attrs.evolve(own, text=own.text.replace("gap_m: 0.002", "gap_m: 0.0021")))
    found = verdict(tmp_path / "before", [*recorded[:place], (name, own), other, *recorded[place:]])
    assert found.identical, found.reason
    later = next(place for place, (what, one) in enumerate(recorded) if what == name and one.text != own.text)
    found = verdict(tmp_path / "after", [*recorded[: later + 1], other, *recorded[later + 1 :]])
    assert found.identical is False
    assert "barriers.gap_m is 0.0021, but 0.002 in the most similar configuration of the journal" in found.reason


def test_an_invented_or_removed_result_of_the_rig_in_the_journal_is_found(recorded, tmp_path: Path) -> None:
    """A trip is a result: a journal without it, or with another one, leads to other rows."""
    assert any(name == "rig/journal" and one.kind is InputKind.TRIP for name, one in recorded)

    def renumbered(change: Callable[[JournalEntry], list[JournalEntry]]) -> list[tuple[str, object]]:
        result, sequence = [], -1
        for name, one in recorded:
            for entry in change(one) if name == "rig/journal" else ():
                sequence = 0 if entry.kind in BEGINNINGS else sequence + 1
                result.append((name, attrs.evolve(entry, sequence=sequence)))
            result += [(name, one)] * (name != "rig/journal")
        return result

    def invented(entry: JournalEntry) -> list[JournalEntry]:
        trip = attrs.evolve(entry, kind=InputKind.TRIP, name="over_travel", value=0.007)
        return [entry, trip] if entry.name == "frequency" else [entry]

    found = verdict(tmp_path / "invented", renumbered(invented))
    assert found.identical is False
    assert found.reason.startswith("rig/journal: entry ")
    assert '"name": "over_travel"' in found.reason
    found = verdict(tmp_path / "removed", renumbered(lambda entry: [entry] * (entry.kind is not InputKind.TRIP)))
    assert found.identical is False
    assert '"name": "over_travel"' in found.reason


def test_a_command_altered_by_less_than_a_step_of_the_converter_is_found(recorded, tmp_path: Path) -> None:
    """The scans are the same to the last bit, but the applied command and the truth differ."""

    def command(entry: JournalEntry) -> JournalEntry:
        altered = entry.name == "current" and entry.value == 0.52
        return attrs.evolve(entry, value=0.520000000001) if altered else entry

    found = verdict(tmp_path, edited([one for one in recorded if one[0] != "truth/scan"], "rig/journal", command))
    assert found.identical is False
    assert any("0.520000000001" in one.difference for one in found.topics if one.topic == "shaker/applied")


def test_journal_entries_of_another_publisher_are_ignored_and_reported(recorded, tmp_path: Path) -> None:
    foreign = ("rig/journal", Remark('{"value": 1}', 0))
    found = verdict(tmp_path, [*recorded[:400], foreign, *recorded[400:]])
    assert found.identical, found.reason
    assert "rig/journal: " in str(found.topics[1])
    assert "1 messages are not journal entries" in str(found.topics[1])


@pytest.mark.parametrize(
    ("topic", "change", "said"),
    [
        ("daq/scan", lambda rows: without(rows, "laser"), "column 'laser' is missing"),
        ("daq/scan", lambda rows: without(rows, "time"), "column 'time' is missing"),
        ("shaker/applied", lambda rows: without(rows, "phase"), "column 'phase' is missing"),
    ],
)
def test_a_missing_column_is_reported_in_one_line(recorded, tmp_path: Path, topic, change, said, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert main(["verify", str(record(tmp_path / "run", edited(recorded[:300], topic, change)))]) == 1
    shown = capsys.readouterr()
    assert said in shown.out + shown.err
    assert "Traceback" not in shown.err


def without(rows: np.ndarray, name: str) -> np.ndarray:
    kept = [column for column in rows.dtype.names if column != name]
    return np.array(rows[kept].tolist(), [(column, rows.dtype[column]) for column in kept])
