# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`verify` and `analyze`: identical when nothing was touched, the first difference by name when something was."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import attrs
import numpy as np
import pytest
from kits.recorded_rig import PROVENANCE, TICK, Messages, edited, messages, published, record

from impact_rig.arithmetic import ARITHMETIC
from impact_rig.cli import main
from impact_rig.recording import Provenance, arithmetic_of, open_run
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.runs import reanalysis, recover
from impact_rig.runs.verification import Verification, verify


@pytest.fixture(scope="module")
def whole() -> Messages:
    return messages()


def verdict(directory: Path, found: Messages) -> Verification:
    with open_run(record(directory / "run", found)) as run:
        return verify(run)


def test_a_run_is_what_its_journal_says(whole: Messages, tmp_path: Path) -> None:
    """Commands, changed mechanics, a fault and an emergency stop: every scan again, bit for bit."""
    found = verdict(tmp_path, whole)
    scans = sum(len(table.rows) for name, table in whole if name == "daq/scan")
    assert found == Verification(True, scans)


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
    assert found == Verification(None, 0, f"recorded with arithmetic 1, this is {ARITHMETIC}")
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


def reset_rig() -> tuple[Messages, Messages, Messages]:
    """A rig that is reset twice, each time with another seed, and measures before, between and after."""
    rig = Rig(from_flat(RigConfig(), {"daq.seed": 5, "drive.amplitude": 0.52}))
    parts = []
    for seed in (6, 7, 8):
        rig.accept(frequency_hz=float(seed))
        parts.append(published(rig, 30))
        rig.configure({"daq.seed": seed})
        rig.reset()
    return tuple(parts)


def test_a_run_goes_on_behind_a_reset(tmp_path: Path) -> None:
    """The journal of what came before was forgotten, and a sound run called different after no identical scan."""
    first, second, third = reset_rig()
    found = verdict(tmp_path / "whole", [*first, *second, *third])
    assert found == Verification(True, 3 * 30 * 100)
    late = [(name, table) for name, table in first if name != "daq/scan"]
    assert verdict(tmp_path / "late", [*late, *second, *third]) == Verification(True, 2 * 30 * 100)


def test_a_difference_behind_a_reset_is_found(tmp_path: Path) -> None:
    first, second, third = reset_rig()

    def change(rows: np.ndarray) -> np.ndarray:
        rows["base"][-1] += 1.0
        return rows

    found = verdict(tmp_path / "changed", [*first, *edited(second, "daq/scan", change), *third])
    assert (found.identical, found.scans) == (False, 30 * 100)
    assert "daq/scan at 0.3" in found.reason


def test_a_block_lost_before_a_reset_is_missing(tmp_path: Path) -> None:
    first, second, third = reset_rig()
    lost = max(table.stamp_ns for name, table in second if name == "daq/scan")
    for missing in (lost, lost - TICK):
        part = [(name, table) for name, table in second if name != "daq/scan" or table.stamp_ns != missing]
        found = verdict(tmp_path / str(missing), [*first, *part, *third])
        assert found.identical is False
        assert "is missing" in found.reason


def test_a_rig_that_was_started_again_begins_a_new_journal(tmp_path: Path) -> None:
    """In stepped and freewheel its stamps begin at zero again."""
    first, _, _ = reset_rig()
    again = published(Rig(from_flat(RigConfig(), {"daq.seed": 9})), 20)
    assert verdict(tmp_path, [*first, *again]) == Verification(True, 50 * 100)


def test_a_block_withheld_by_a_fault_is_no_loss(tmp_path: Path) -> None:
    planned = ("lost_block start_s=0.1 duration_s=0.05",)
    rig = Rig(from_flat(RigConfig(), {"instruments.faults.planned": planned}))
    found = published(rig, 40)
    scans = [table for name, table in found if name == "daq/scan"]
    assert len(scans) < 40
    assert verdict(tmp_path, found) == Verification(True, sum(len(table.rows) for table in scans))


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
