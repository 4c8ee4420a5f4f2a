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
"""`analyze` compares with the live results where both saw the same data, and reports what it could not compare."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest
from kits.recorded_rig import TICK, Messages, agreement, edited, messages, record

from impact_rig.analysis.settings import TrackerSettings, settings_table
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import Table
from impact_rig.cli import main
from impact_rig.recording import open_run
from impact_rig.runs import reanalysis
from impact_rig.runs.reanalysis import Agreement
from impact_rig.simtime import NS_PER_S
from impact_rig.system import machine

pytestmark = pytest.mark.heavy

TABLE = "transmissibility/table"
COARSE: dict[str, object] = {"daq.rate_hz": 2000, "daq.block_scans": 20}
"""Blocks of a tick, of few scans, because the tests are about rows and their order."""
AGAIN = (200, 400, 600, 800)
"""Blocks with a change that a recorder or an analysis that came late has seen, too."""


@pytest.fixture(scope="module")
def complete_run() -> Messages:
    return messages(**COARSE)


@pytest.fixture(scope="module")
def long() -> Messages:
    """Run with rows at 11.3 and 16 s, and one at 24.5 s, after a change at 16 s."""
    return messages(26, (1600,), **COARSE)


def compared(directory: Path, found: Messages) -> Agreement:
    return agreement(record(directory / "run", found))


def live_rows(found: Messages) -> int:
    return sum(name == TABLE for name, _ in found)


def measured_live(found: Messages, hears: Callable[[int], bool]) -> Messages:
    """Record the run again with a live analysis that knows the latched messages and receives some of the blocks."""
    others = [one for one in found if one[0] != TABLE]
    return fed(others, hears, lambda found: [(TABLE, row) for row in found.measurements])


def fed(found: Messages, hears: Callable[[int], bool], results: Callable[[Any], Messages]) -> Messages:
    """Return messages, each block of scans that the analysis receives followed by its results."""
    tracker, result = Tracker(), []
    tracker.label(0.0, 0)
    for name, table in found:
        result.append((name, table))
        if name == "daq/info":
            tracker.configure(table)
        elif name == "shaker/applied":
            tracker.on_applied(table)
        elif name == "daq/scan" and hears(table.stamp_ns):
            result += results(tracker.feed(table))
    return result


def early_rows(found: Messages) -> list[Table]:
    """Return the live results except those of the last two seconds, which a recorder that stops may have missed."""
    end_ns = max(table.stamp_ns for name, table in found if name == "daq/scan")
    return [table for name, table in found if name == TABLE and table.stamp_ns < end_ns - 2 * NS_PER_S]


def scaled(by: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(rows: np.ndarray) -> np.ndarray:
        rows["transmissibility"] *= by
        return rows

    return change


def test_the_same_data_on_the_same_machine_yield_the_same_bits(complete_run: Messages, tmp_path: Path) -> None:
    found = compared(tmp_path, complete_run)
    assert (found.same, found.identical, found.elsewhere) == (True, True, False)
    assert (found.compared, found.left_out[0]) == (live_rows(complete_run), 0)
    assert "bit for bit" in str(found)


def test_one_bit_on_the_same_machine_is_a_difference(complete_run: Messages, tmp_path: Path) -> None:
    found = compared(tmp_path, edited(complete_run, TABLE, scaled(1.0 + 1e-15)))
    assert found.same is False
    assert "transmissibility at" in found.reason


@pytest.mark.parametrize(("by", "same"), [(1.0 + 1e-12, True), (1.0 + 1e-8, False)])
@pytest.mark.parametrize("known", [True, False], ids=["other machine", "unknown machine"])
def test_results_of_another_machine_agree_to_a_billionth_and_are_marked(
    complete_run: Messages, tmp_path: Path, by: float, same: bool, known: bool
) -> None:
    def elsewhere(rows: np.ndarray) -> np.ndarray:
        if not known:
            return rows[rows["key"] != b"machine"]
        rows["value"][rows["key"] == b"machine"] += 1
        return rows

    found = compared(tmp_path, edited(edited(complete_run, "analysis/settings", elsewhere), TABLE, scaled(by)))
    assert (found.same, found.identical, found.elsewhere) == (same, False, True if known else None)
    if same:
        assert "equal to the live results to 1e-09, not bit for bit" in str(found)
        assert ("on another machine" if known else "on a machine that is not recorded") in str(found)


@pytest.mark.parametrize("late", [30, 160, 333], ids=lambda blocks: f"{blocks} blocks")
def test_a_run_of_a_late_recorder_is_compared_from_the_first_shared_change(
    complete_run: Messages, tmp_path: Path, late: int
) -> None:
    """The first change that both received is a command; before it, their waits started at 0.07 s and at 0 s."""
    data = messages(again=AGAIN, **COARSE)
    part = [(name, table) for name, table in data if name not in ("daq/scan", TABLE) or table.stamp_ns >= late * TICK]
    found = compared(tmp_path, part)
    assert found.same, found.reason
    assert found.identical
    assert 0 < found.compared < live_rows(data)
    assert found.left_out > (0, 0)
    assert "not compared" in str(found)


@pytest.mark.parametrize("joined", [30, 160, 333], ids=lambda blocks: f"{blocks} blocks")
def test_an_analysis_that_joined_late_is_compared_from_the_first_shared_change(tmp_path: Path, joined: int) -> None:
    found = compared(
        tmp_path, measured_live(messages(again=AGAIN, **COARSE), lambda stamp_ns: stamp_ns >= joined * TICK)
    )
    assert found.same, found.reason
    assert found.identical
    assert found.compared > 0


def test_a_live_analysis_that_ended_halfway_is_reported_as_different(tmp_path: Path) -> None:
    data = messages(again=AGAIN, **COARSE)
    middle = early_rows(data)[-1]
    died = [(name, table) for name, table in data if name != TABLE or table.stamp_ns < middle.stamp_ns]
    assert live_rows(died) > 0
    found = compared(tmp_path, died)
    assert found.same is False
    assert "the live analysis published nothing at" in found.reason


def test_a_missing_or_invented_row_is_a_difference(tmp_path: Path) -> None:
    data = messages(again=AGAIN, **COARSE)
    place = next(number for number, (_, table) in enumerate(data) if table is early_rows(data)[-1])
    assert compared(tmp_path / "missing", [*data[:place], *data[place + 1 :]]).same is False
    name, table = data[place]
    extra = attrs.evolve(table, stamp_ns=table.stamp_ns + TICK // 100)
    assert compared(tmp_path / "more", [*data[: place + 1], (name, extra), *data[place + 1 :]]).same is False


@pytest.mark.parametrize(("begin", "end"), [(200, 205), (900, 1200)], ids=["few", "a whole row"])
def test_a_recording_that_lacks_blocks_is_compared_where_it_has_them(
    long: Messages, tmp_path: Path, begin: int, end: int
) -> None:
    gap = [m for m in long if not (m[0] == "daq/scan" and begin * TICK <= m[1].stamp_ns < end * TICK)]
    found = compared(tmp_path, gap)
    assert found.same, found.reason
    assert found.compared > 0


@pytest.mark.parametrize(("begin", "end"), [(200, 205), (900, 1200)], ids=["few", "a whole row"])
def test_an_analysis_that_was_stopped_for_a_while_is_compared_where_it_had_scans(
    long: Messages, tmp_path: Path, begin: int, end: int
) -> None:
    """Rows measured from scans that the live analysis had lost must not count as missing."""
    found = compared(tmp_path, measured_live(long, lambda stamp_ns: not begin * TICK <= stamp_ns < end * TICK))
    assert found.same, found.reason
    assert found.identical
    assert found.compared > 0


def test_results_of_the_previous_run_are_not_compared(complete_run: Messages, tmp_path: Path) -> None:
    """A campaign's rig starts each run at 0 s again, and a latched topic gives a recorder the earlier results."""
    before = [
        (name, attrs.evolve(table, stamp_ns=table.stamp_ns + 1)) for name, table in complete_run if "table" in name
    ]
    assert before
    assert compared(tmp_path, before + complete_run).identical


def test_a_recording_without_a_live_measurement_is_not_called_identical(complete_run: Messages, tmp_path: Path) -> None:
    """The recorder started after the last measurement: only an earlier latched table is in the run."""
    (last,) = [table for name, table in complete_run if name == TABLE][-1:]
    early = (TABLE, attrs.evolve(last, stamp_ns=0))
    scans = [one for one in complete_run if one[0] != TABLE]
    found = compared(tmp_path, [early, *scans])
    assert found.same is None
    assert "nothing to compare with" in str(found)


def test_the_command_reports_the_result_and_returns_its_code(
    complete_run: Messages, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["analyze", str(record(tmp_path / "run", complete_run))]) == 0
    assert "identical to the live results: " in capsys.readouterr().out
    other = record(tmp_path / "other", edited(complete_run, TABLE, scaled(2.0)))
    assert main(["analyze", str(other)]) == 1
    assert "not identical to the live results: transmissibility at" in capsys.readouterr().out


def test_a_machine_that_computes_differently_has_another_fingerprint(monkeypatch: pytest.MonkeyPatch) -> None:
    machine.identity.cache_clear()
    number = machine.fingerprint()
    assert 0 < number < 2**48
    assert float(number) == number
    machine.identity.cache_clear()
    assert machine.fingerprint() == number
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Prescott")
    machine.identity.cache_clear()
    assert machine.fingerprint() != number
    monkeypatch.undo()
    machine.identity.cache_clear()


@pytest.mark.parametrize("late", [1, 8, 60], ids=lambda blocks: f"{blocks} blocks")
@pytest.mark.parametrize("first_tick", [0, 300], ids=["scan 0", "3 s"])
def test_late_calibration_and_drive_apply_from_the_first_block(tmp_path: Path, late: int, first_tick: int) -> None:
    """A recorder started in mid-run receives scans before latched messages; the live analysis knew these all along."""
    data = messages(again=AGAIN, **COARSE)
    part = [(name, one) for name, one in data if name not in ("daq/scan", TABLE) or one.stamp_ns >= first_tick * TICK]
    known = [one for one in part if one[0] in ("daq/info", "shaker/applied") and one[1].stamp_ns <= first_tick * TICK]
    known = known if first_tick else [one for one in known if one[0] == "daq/info"]
    scans = [place for place, one in enumerate(part) if one[0] == "daq/scan"]
    at = scans[late]
    delivered = [one for one in part[:at] if one not in known] + known + [one for one in part[at:] if one not in known]
    found = compared(tmp_path, delivered)
    assert found.same, found.reason
    assert found.identical
    assert found.compared >= 3


def with_impacts(**values: object) -> Messages:
    """Rig that hits its walls, with everything that its analysis publishes."""
    data = messages(6, (), **{"sphere.present": True, "barriers.gap_m": 0.002, **values})
    return fed(data, lambda _: True, lambda found: [("impacts", row) for row in found.impacts])


def test_impacts_found_live_are_compared_too(tmp_path: Path) -> None:
    data = with_impacts()
    found = compared(tmp_path / "same", data)
    by_topic = {one.topic: one for one in found.others}
    assert (found.same, by_topic["impacts"].difference) == (True, ""), str(found)
    assert by_topic["impacts"].count > 20
    assert by_topic["transmissibility"].left_out == "it is not in this run"
    places = [place for place, (name, _) in enumerate(data) if name == "impacts"]
    middle = places[len(places) // 2]

    def louder(rows: np.ndarray) -> np.ndarray:
        rows["peak"] *= 1.0 + 1e-8
        return rows

    silent = [one for place, one in enumerate(data) if place < middle or place not in places]
    altered = [*data[:middle], *edited(data[middle : middle + 1], "impacts", louder), *data[middle + 1 :]]
    for name, case, said in (
        ("louder", altered, "impacts: peak at "),
        ("missing", [*data[:middle], *data[middle + 1 :]], "only the later analysis found an impact at"),
        ("ended", silent, "only the later analysis found an impact at"),
        ("invented", [*data[:middle], *shifted(data[middle]), *data[middle:]], "only the live analysis found"),
    ):
        found = compared(tmp_path / name, case)
        assert found.same is False
        assert said in found.reason


def shifted(message: tuple[str, Table]) -> Messages:
    """Return the message with a stamp 3 ms earlier."""
    name, table = message
    return [(name, attrs.evolve(table, stamp_ns=table.stamp_ns - 3_000_000))]


HOSTILE = {
    "waited NaN": (TABLE, lambda rows: value(rows, "waited", np.nan), "waited must be a number"),
    "waited 1e308": (TABLE, lambda rows: value(rows, "waited", 1e308), "waited must be a number"),
    "no frequency": (TABLE, lambda rows: without(rows, "frequency"), "column 'frequency' is missing"),
    "status no text": (TABLE, lambda rows: value(rows, "status", b"\xff"), "status must be UTF-8"),
    "no key": ("analysis/settings", lambda rows: without(rows, "key"), "column 'key' is missing"),
    "no such setting": ("analysis/settings", lambda rows: value(rows, "key", b"unheard"), "unknown key: unheard"),
    "no calibration": ("daq/info", lambda rows: None, "daq/info"),
    "rate NaN": ("daq/info", lambda rows: value(rows, "rate", np.nan), "rate must be a number from 1"),
    "no rate": ("daq/info", lambda rows: without(rows, "rate"), "column 'rate' is missing"),
    "no rows": ("daq/info", lambda rows: rows[:0], "daq/info must list one or more of the channels"),
    "no laser": ("daq/scan", lambda rows: without(rows, "laser"), "daq/scan lacks the column laser"),
    "no drive": ("shaker/applied", lambda rows: without(rows, "frequency"), "column 'frequency' is missing"),
}


def value(rows: np.ndarray, name: str, what: object) -> np.ndarray:
    rows[name] = what
    return rows


def without(rows: np.ndarray, name: str) -> np.ndarray:
    kept = [column for column in rows.dtype.names if column != name]
    return np.array(rows[kept].tolist(), [(column, rows.dtype[column]) for column in kept])


@pytest.mark.parametrize("what", HOSTILE)
def test_a_table_of_another_version_or_with_invalid_numbers_is_rejected_in_one_line(
    complete_run: Messages,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    what: str,
) -> None:
    topic, change, said = HOSTILE[what]
    monkeypatch.setenv("COLUMNS", "300")
    assert main(["analyze", str(record(tmp_path / "run", edited(complete_run, topic, change)))]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_invalid_settings_of_another_publisher_are_ignored(complete_run: Messages, tmp_path: Path) -> None:
    """The settings have an unknown key, or lack a column: those of the analysis are still used."""
    own = next(message for message in complete_run if message[0] == "analysis/settings")
    foreign = [
        edited([own], "analysis/settings", change)[0]
        for change in (lambda rows: value(rows, "key", b"unheard"), lambda rows: without(rows, "key"))
    ]
    for place in (0, len(complete_run)):
        found = compared(tmp_path / f"{place}", [*complete_run[:place], *foreign, *complete_run[place:]])
        assert (found.same, found.identical) == (True, True)


def test_a_measurement_of_an_older_version_with_fewer_columns_is_compared(
    complete_run: Messages, tmp_path: Path
) -> None:
    for column in ("spread", "regime"):
        older = edited(complete_run, TABLE, lambda rows, column=column: without(rows, column))
        assert compared(tmp_path / column, older).same is False  # the live row lacks the column


def test_a_restarted_analysis_is_compared_until_its_first_end(complete_run: Messages, tmp_path: Path) -> None:
    """The restarted analysis labels what it will receive from stamp 0 on, which must not label the rows before it."""
    killed_ns, again_ns = 11_400_000_000, 11_500_000_000
    found: Messages = []
    for name, table in complete_run:
        if name == TABLE and table.stamp_ns > killed_ns:
            continue
        if name == "daq/scan" and table.stamp_ns == again_ns:
            found.append(("analysis/settings", settings_table(TrackerSettings(), 0.01, 0, started_s=again_ns * 1e-9)))
        found.append((name, table))
    result = compared(tmp_path, found)
    assert result.identical, str(result)
    assert result.compared == live_rows(found)


def test_two_analyses_that_label_one_run_in_turn_leave_its_gap_unknown(complete_run: Messages, tmp_path: Path) -> None:
    """Rows of two labs in one namespace have no gap; a restarted lab does not label the time before."""
    found: Messages = []
    for name, table in complete_run:
        for second, gap_m, started_s in ((3, 0.006, 2.0), (5, 0.010, 1.0), (7, 0.002, 2.0)):
            if name == "daq/scan" and table.stamp_ns == second * NS_PER_S:
                found.append(("analysis/settings", settings_table(TrackerSettings(), gap_m, table.stamp_ns, started_s)))
        found.append((name, table))
    with open_run(record(tmp_path / "run", found)) as run:
        rows = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(run)))
        comparison = reanalysis.compare(run, [])
    assert len(rows)
    assert np.isnan(rows["gap"]).all()
    assert comparison.same is None
    assert "two analyses labelled this run at once" in str(comparison)


def test_a_difference_in_any_column_of_a_row_is_found(complete_run: Messages) -> None:
    """Here to the last bit, and on another machine beyond 1e-9: a word, a number, or a number instead of none."""
    (row,) = next(table for name, table in complete_run if name == TABLE and table.rows["settled"][0] == 1).rows
    for name in row.dtype.names:
        other = row.copy()
        is_text, is_none = row.dtype[name].kind == "S", row[name] != row[name]
        other[name] = b"another" if is_text else 0.5 if is_none else np.nextafter(row[name], np.inf)
        assert reanalysis._different(row, other, exact=True) == name
        other[name] = b"another" if is_text else 0.5 if is_none else row[name] + 1e-6 * max(1.0, abs(row[name]))
        assert reanalysis._different(row, other, exact=False) == name


def test_a_label_before_the_first_scan_belongs_to_the_same_analysis(complete_run: Messages, tmp_path: Path) -> None:
    """The first job of the demo labels an analysis that has seen no scan: its stamp is 0, as at a start."""
    place = next(place for place, (name, _) in enumerate(complete_run) if name == "analysis/settings")
    result = compared(tmp_path, [*complete_run[: place + 1], complete_run[place], *complete_run[place + 1 :]])
    assert result.identical, str(result)
    assert result.left_out == (0, 0)
