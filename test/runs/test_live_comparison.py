# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`analyze` compares with the live results where both saw the same data, and says what it could not compare."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import attrs
import numpy as np
import pytest
from kits.recorded_rig import TICK, Messages, edited, messages, record

from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import Table
from impact_rig.cli import main
from impact_rig.recording import open_run
from impact_rig.runs import live_comparison, reanalysis
from impact_rig.runs.live_comparison import Comparison
from impact_rig.simtime import NS_PER_S
from impact_rig.system import machine

TABLE = "transmissibility/table"
AGAIN = (200, 400, 600, 800)
"""Blocks with a change that a recorder or an analysis that came late has seen, too."""


@pytest.fixture(scope="module")
def whole() -> Messages:
    return messages()


def compared(directory: Path, found: Messages) -> Comparison:
    with open_run(record(directory / "run", found)) as run:
        return live_comparison.compare(run, reanalysis.measurements(reanalysis.analyze(run)))


def live_rows(found: Messages) -> int:
    return sum(name == TABLE for name, _ in found)


def measured_live(found: Messages, from_ns: int) -> Messages:
    """The same run with a live analysis that joined at an instant: it knows what is latched, and sees what follows."""
    tracker, result = Tracker(), []
    tracker.label(0.0, 0)
    for name, table in found:
        if name == TABLE:
            continue
        result.append((name, table))
        if name == "daq/info":
            tracker.configure(table)
        elif name == "shaker/applied":
            tracker.on_applied(table)
        elif name == "daq/scan" and table.stamp_ns >= from_ns:
            result += [(TABLE, row) for row in tracker.feed(table).measurements]
    return result


def early_rows(found: Messages) -> list[Table]:
    """Return the live results of all but the last two seconds, which a recorder that stops cannot have missed."""
    end_ns = max(table.stamp_ns for name, table in found if name == "daq/scan")
    return [table for name, table in found if name == TABLE and table.stamp_ns < end_ns - 2 * NS_PER_S]


def scaled(by: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(rows: np.ndarray) -> np.ndarray:
        rows["transmissibility"] *= by
        return rows

    return change


def test_the_same_data_on_the_same_machine_give_the_same_bits(whole: Messages, tmp_path: Path) -> None:
    found = compared(tmp_path, whole)
    assert (found.same, found.identical, found.elsewhere) == (True, True, False)
    assert (found.compared, found.left_out[0]) == (live_rows(whole), 0)
    assert "bit for bit" in str(found)


def test_one_bit_on_the_same_machine_is_a_difference(whole: Messages, tmp_path: Path) -> None:
    found = compared(tmp_path, edited(whole, TABLE, scaled(1.0 + 1e-15)))
    assert found.same is False
    assert "transmissibility at" in found.reason


@pytest.mark.parametrize(("by", "same"), [(1.0 + 1e-12, True), (1.0 + 1e-8, False)])
@pytest.mark.parametrize("known", [True, False], ids=["other machine", "unknown machine"])
def test_elsewhere_results_agree_to_a_billionth_and_the_answer_says_so(
    whole: Messages, tmp_path: Path, by: float, same: bool, known: bool
) -> None:
    def elsewhere(rows: np.ndarray) -> np.ndarray:
        if not known:
            return rows[rows["key"] != b"machine"]
        rows["value"][rows["key"] == b"machine"] += 1
        return rows

    found = compared(tmp_path, edited(edited(whole, "analysis/settings", elsewhere), TABLE, scaled(by)))
    assert (found.same, found.identical, found.elsewhere) == (same, False, True if known else None)
    if same:
        assert "equal to the live results to 1e-09, not bit for bit" in str(found)
        assert ("on another machine" if known else "not recorded on which machine") in str(found)


@pytest.mark.parametrize("late", [30, 160, 333], ids=lambda blocks: f"{blocks} blocks")
def test_a_recorder_that_came_late_is_compared_from_the_first_shared_change(
    whole: Messages, tmp_path: Path, late: int
) -> None:
    """A command is the first change that both saw; before it, live had waited since 0.07 s, the file since it began."""
    data = messages(again=AGAIN)
    part = [(name, table) for name, table in data if name not in ("daq/scan", TABLE) or table.stamp_ns >= late * TICK]
    found = compared(tmp_path, part)
    assert found.same, found.reason
    assert found.identical
    assert 0 < found.compared < live_rows(data)
    assert found.left_out > (0, 0)
    assert "not compared" in str(found)


@pytest.mark.parametrize("joined", [30, 160, 333], ids=lambda blocks: f"{blocks} blocks")
def test_an_analysis_that_joined_late_is_compared_from_the_first_shared_change(tmp_path: Path, joined: int) -> None:
    found = compared(tmp_path, measured_live(messages(again=AGAIN), joined * TICK))
    assert found.same, found.reason
    assert found.identical
    assert found.compared > 0


def test_a_live_analysis_that_died_half_way_is_not_the_same(tmp_path: Path) -> None:
    data = messages(again=AGAIN)
    middle = early_rows(data)[-1]
    died = [(name, table) for name, table in data if name != TABLE or table.stamp_ns < middle.stamp_ns]
    assert live_rows(died) > 0
    found = compared(tmp_path, died)
    assert found.same is False
    assert "the live analysis said nothing at" in found.reason


def test_a_row_that_is_missing_or_made_up_is_a_difference(tmp_path: Path) -> None:
    data = messages(again=AGAIN)
    place = next(number for number, (_, table) in enumerate(data) if table is early_rows(data)[-1])
    assert compared(tmp_path / "missing", [*data[:place], *data[place + 1 :]]).same is False
    name, table = data[place]
    extra = attrs.evolve(table, stamp_ns=table.stamp_ns + TICK // 100)
    assert compared(tmp_path / "more", [*data[: place + 1], (name, extra), *data[place + 1 :]]).same is False


def test_a_recording_that_lacks_blocks_is_compared_where_it_has_them(tmp_path: Path) -> None:
    data = messages(again=AGAIN)
    gap = [m for m in data if not (m[0] == "daq/scan" and 200 * TICK <= m[1].stamp_ns < 205 * TICK)]
    found = compared(tmp_path, gap)
    assert found.same, found.reason
    assert found.compared > 0


def test_results_of_the_run_before_are_not_those_of_this_one(whole: Messages, tmp_path: Path) -> None:
    """A campaign's rig begins each run at 0 s again, and a latched topic hands a recorder what was measured before."""
    before = [(name, attrs.evolve(table, stamp_ns=table.stamp_ns + 1)) for name, table in whole if "table" in name]
    assert before
    assert compared(tmp_path, before + whole).identical


def test_a_recording_without_a_live_measurement_is_not_called_identical(whole: Messages, tmp_path: Path) -> None:
    """The recorder came after the last one: only the latched table of before is in the run."""
    (last,) = [table for name, table in whole if name == TABLE][-1:]
    early = (TABLE, attrs.evolve(last, stamp_ns=0))
    scans = [one for one in whole if one[0] != TABLE]
    found = compared(tmp_path, [early, *scans])
    assert found.same is None
    assert "nothing to compare with" in str(found)


def test_the_command_says_it_and_its_code_follows(
    whole: Messages, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["analyze", str(record(tmp_path / "run", whole))]) == 0
    assert "identical to the live results: " in capsys.readouterr().out
    other = record(tmp_path / "other", edited(whole, TABLE, scaled(2.0)))
    assert main(["analyze", str(other)]) == 1
    assert "not identical to the live results: transmissibility at" in capsys.readouterr().out


def test_a_machine_that_computes_as_another_has_another_number(monkeypatch: pytest.MonkeyPatch) -> None:
    machine.identity.cache_clear()
    number = machine.fingerprint()
    assert 0 < number < 2**48
    assert float(number) == number
    machine.identity.cache_clear()
    assert machine.fingerprint() == number
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    machine.identity.cache_clear()
    assert machine.fingerprint() != number
    monkeypatch.undo()
    machine.identity.cache_clear()
