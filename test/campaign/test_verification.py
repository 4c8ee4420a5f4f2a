"""`verify` and `analyze`: identical when nothing was touched, the first difference by name when something was."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import attrs
import numpy as np
import pytest
from recorded_rig import PROVENANCE, TICK, Messages, messages, record

from impact_rig.arithmetic import ARITHMETIC
from impact_rig.campaign import reanalysis
from impact_rig.campaign.verification import Verdict, verify
from impact_rig.cli import main
from impact_rig.recording import Provenance, arithmetic_of, open_run, recover


@pytest.fixture(scope="module")
def whole() -> Messages:
    return messages()


def verdict(directory: Path, found: Messages) -> Verdict:
    with open_run(record(directory / "run", found)) as run:
        return verify(run)


def edited(found: Messages, topic: str, change: Callable[[np.ndarray], np.ndarray | None]) -> Messages:
    """Messages with the rows of a topic's tables passed through `change` (None: the table is left out)."""
    result: Messages = []
    for name, table in found:
        rows = change(table.rows.copy()) if name == topic else table.rows
        if rows is not None:
            result.append((name, attrs.evolve(table, rows=rows)))
    return result


def test_a_run_is_what_its_journal_says(whole: Messages, tmp_path: Path) -> None:
    """Commands, changed mechanics, a fault and an emergency stop: every scan again, bit for bit."""
    found = verdict(tmp_path, whole)
    scans = sum(len(table.rows) for name, table in whole if name == "daq/scan")
    assert found == Verdict(True, scans)


def test_a_recorder_that_came_late_can_verify_too(whole: Messages, tmp_path: Path) -> None:
    late = [(name, table) for name, table in whole if name != "daq/scan" or table.stamp_ns >= 300 * TICK]
    assert verdict(tmp_path, late).identical


def test_one_changed_bit_is_named(whole: Messages, tmp_path: Path) -> None:
    """Topic, stamp, sample and both values."""
    number = iter(range(10**6))

    def change(rows: np.ndarray) -> np.ndarray:
        if next(number) == 123:
            rows["laser"][45] = np.nextafter(rows["laser"][45], 1.0)
        return rows

    found = verdict(tmp_path, edited(whole, "daq/scan", change))
    assert (found.identical, found.scans) == (False, 12_300)
    true = next(table for name, table in whole if name == "daq/scan" and table.stamp_ns == 123 * TICK)
    assert found.reason == (
        f"daq/scan at 1.230000000 s, sample 45, laser: logged {np.nextafter(true.rows['laser'][45], 1.0)!r}, "
        f"re-simulated {true.rows['laser'][45]!r}"
    )


def test_a_changed_command_or_seed_is_found_where_it_begins_to_matter(whole: Messages, tmp_path: Path) -> None:
    def command(rows: np.ndarray) -> np.ndarray:
        rows["value"][rows["key"] == b"current"] *= 1.001
        return rows

    found = verdict(tmp_path / "command", edited(whole, "rig/journal", command))
    assert found.identical is False
    assert found.scans < 2_000
    assert "daq/scan at 0." in found.reason

    def seed(rows: np.ndarray) -> np.ndarray:
        rows["value"][rows["key"] == b"daq.seed"] = 6
        return rows

    found = verdict(tmp_path / "seed", edited(whole, "rig/journal", seed))
    assert (found.identical, found.scans) == (False, 0)
    assert "daq/scan at 0.000000000 s, sample 0" in found.reason


def test_a_lost_block_is_a_difference(whole: Messages, tmp_path: Path) -> None:
    found = verdict(tmp_path, [m for m in whole if not (m[0] == "daq/scan" and m[1].stamp_ns == 50 * TICK)])
    assert (found.identical, found.scans) == (False, 5_000)
    assert "the block at 0.500000000 s is missing" in found.reason


def damaged(rows: np.ndarray) -> np.ndarray:
    rows["sequence"][-1] = np.nan
    return rows


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda rows: rows[rows["sequence"] != 0], "row 0 is missing"),
        (lambda rows: rows[rows["key"] != b"frequency"], "is missing"),
        (lambda rows: rows[:0], "the journal is empty"),
        (lambda rows: None, "no topic 'rig/journal'"),
        (damaged, "sample and sequence 0 to 2"),
    ],
    ids=["beginning", "middle", "empty", "none", "nan"],
)
def test_without_its_whole_journal_a_run_is_not_verifiable(
    whole: Messages, tmp_path: Path, change: Callable[[np.ndarray], np.ndarray | None], reason: str
) -> None:
    found = verdict(tmp_path, edited(whole, "rig/journal", change))
    assert found.identical is None
    assert reason in found.reason


class _OfBefore(Provenance):
    """What a recorder wrote before there was a version of the arithmetic."""

    def to_record(self) -> dict[str, str]:
        return {key: value for key, value in super().to_record().items() if key != "arithmetic"}


@pytest.mark.parametrize(
    "provenance",
    [attrs.evolve(PROVENANCE, arithmetic=1), _OfBefore(version="0", seed=5, wall_start_ns=0)],
    ids=["named", "unwritten"],
)
def test_a_run_of_another_arithmetic_is_not_accused(whole: Messages, tmp_path: Path, provenance: Provenance) -> None:
    """Its bits cannot be made here: one changed scan among them is not found, and nothing is called different."""

    def change(rows: np.ndarray) -> np.ndarray:
        rows["laser"][0] += 1e-6
        return rows

    run = record(tmp_path / "run", edited(whole, "daq/scan", change), provenance)
    with open_run(run) as opened:
        found = verify(opened)
    assert found == Verdict(None, 0, f"recorded with arithmetic 1, this is {ARITHMETIC}")
    assert str(found).startswith("not verifiable here: recorded with arithmetic 1")


def test_a_run_of_another_recorder_is_verified_by_its_journal(whole: Messages, tmp_path: Path) -> None:
    with open_run(record(tmp_path / "run", whole, None)) as opened:
        assert opened.provenance == {}
        assert verify(opened).identical


def test_a_rescued_run_keeps_its_arithmetic(whole: Messages, tmp_path: Path) -> None:
    old = _OfBefore(version="0", seed=5, wall_start_ns=0)
    rescued = tmp_path / "rescued"
    recover(record(tmp_path / "run", whole[:200], old), rescued)
    with open_run(rescued) as opened:
        assert arithmetic_of(opened.provenance) == "1"


def test_the_command_line_says_it_all(
    whole: Messages, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    run = str(record(tmp_path / "run", whole))
    assert main(["verify", run]) == 0
    assert "identical: 120000 scans re-simulated bit for bit" in " ".join(capsys.readouterr().out.split())
    assert main(["analyze", run]) == 0
    assert "identical to the live results" in capsys.readouterr().out
    assert main(["info", run]) == 0
    assert "1200 blocks of daq/scan without a gap" in " ".join(capsys.readouterr().out.split())
    assert main(["export", run, "shaker/applied", str(tmp_path / "applied.csv")]) == 0
    assert (tmp_path / "applied.csv").read_text().count("\n") > 3
    assert main(["verify", str(tmp_path)]) == 1
    assert "holds no *.mcap file" in " ".join(capsys.readouterr().err.split())


def test_another_result_than_the_live_one_is_said(whole: Messages, tmp_path: Path) -> None:
    def change(rows: np.ndarray) -> np.ndarray:
        rows["transmissibility"] *= 1.0 + 1e-15
        return rows

    tampered = edited(whole, "transmissibility/table", change)
    assert [table for name, table in tampered if name == "transmissibility/table" and table.rows["settled"][0]]
    with open_run(record(tmp_path / "run", tampered)) as run:
        assert not reanalysis.same_as_live(run, reanalysis.measurements(reanalysis.analyze(run)))


def test_results_of_the_run_before_are_not_those_of_this_one(whole: Messages, tmp_path: Path) -> None:
    """A campaign's rig begins each run at 0 s again, and the latched topic hands the recorder what was measured before.

    Every run of `campaign --through ros --record` was said to be not identical to its live results.
    """
    before = [(name, attrs.evolve(table, stamp_ns=table.stamp_ns + 1)) for name, table in whole if "table" in name]
    assert before
    with open_run(record(tmp_path / "run", before + whole)) as run:
        assert reanalysis.same_as_live(run, reanalysis.measurements(reanalysis.analyze(run))) is True


def test_a_recording_without_a_live_measurement_is_not_called_identical(whole: Messages, tmp_path: Path) -> None:
    """The recorder came after the last one: only the latched table of before is in the run."""
    (last,) = [table for name, table in whole if name == "transmissibility/table"][-1:]
    early = ("transmissibility/table", attrs.evolve(last, stamp_ns=0))
    scans = [one for one in whole if one[0] != "transmissibility/table"]
    with open_run(record(tmp_path / "run", [early, *scans])) as run:
        assert reanalysis.same_as_live(run, reanalysis.measurements(reanalysis.analyze(run))) is None


def test_live_analysis_settings_are_those_of_the_run(whole: Messages, tmp_path: Path) -> None:
    """A run measured with other settings is analysed with them, and its label holds."""
    with open_run(record(tmp_path / "run", whole)) as run:
        default = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(run)))

    def change(rows: np.ndarray) -> np.ndarray:
        rows["value"][rows["key"] == b"harmonics"] = 1
        rows["value"][rows["key"] == b"gap_m"] = 0.004
        return rows

    with open_run(record(tmp_path / "other", edited(whole, "analysis/settings", change))) as run:
        other = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(run)))
    assert default["gap"][0] == 0.0
    assert other["gap"][0] == 0.004
    distortion = [rows[rows["settled"] == 1]["thd"][0] for rows in (default, other)]
    assert distortion[0] > distortion[1] == 0.0, "one harmonic knows no distortion"


def test_tables_of_another_kind_are_no_settings(whole: Messages, tmp_path: Path) -> None:
    def change(rows: np.ndarray) -> np.ndarray:
        rows["key"][0] = b"unheard"
        return rows

    assert main(["analyze", str(record(tmp_path / "run", edited(whole, "analysis/settings", change)))]) == 1
