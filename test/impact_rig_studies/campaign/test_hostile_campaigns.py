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
"""Campaign files made to fill the memory: rejected before they are read, or before their points are made."""

from __future__ import annotations

import io
import os
import re
import runpy
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.cli import main
from impact_rig.errors import ConfigError
from impact_rig.rig.config import load_config
from impact_rig.system import budget
from impact_rig.system.budget import BudgetError
from impact_rig_studies.campaign import run
from impact_rig_studies.campaign.job import Job, Outcome
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.campaign.store import FOLDER, MAX_TRACE_BYTES, DamagedPointError, Store

TOOL: dict[str, Any] = runpy.run_path(str(Path(__file__).parents[3] / "qualification" / "hostile.py"))
TINY = "studies:\n  s:\n    frequencies_hz: 9.1\n    gaps_m: 0.002\n    traces: true\n"


def test_a_plan_of_millions_of_points_is_rejected_before_any_is_created(tmp_path: Path) -> None:
    with pytest.raises(BudgetError, match=r"points in a campaign, more than 20000; .* IMPACT_RIG_BUDGET=N"):
        load_campaign(TOOL["huge_plan"](tmp_path))


def test_the_limit_counts_the_points_that_are_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "POINTS", 11)
    path = tmp_path / "plan.yaml"
    path.write_text("studies:\n  s: {frequencies_hz: [9.0, 9.1], gaps_m: [0.002, 0.004], repetitions: 3}\n")
    with pytest.raises(BudgetError, match="12 points"):
        load_campaign(path)
    monkeypatch.setattr(budget, "POINTS", 12)
    assert len(load_campaign(path).planned()) == 4


def test_a_path_that_is_not_a_regular_file_is_rejected_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo.yaml")
    for path in (Path("/dev/zero"), tmp_path / "fifo.yaml"):
        for read in (load_config, load_campaign):
            with pytest.raises(ConfigError, match="not a regular file"):
                read(path)


@pytest.fixture
def stored(tmp_path: Path) -> tuple[Store, Job, Path]:
    """Campaign of one measured job with a trace: its store, the job and its file."""
    (tmp_path / "plan.yaml").write_text(TINY)
    campaign = load_campaign(tmp_path / "plan.yaml")
    store = run.prepare(campaign, tmp_path / "campaign", "process")
    (job,) = run.unique_jobs(campaign.planned())
    row = np.zeros(1, TRANSMISSIBILITY)
    for name in ("frequency", "transmissibility", "laser_amplitude", "base_amplitude", "settled", "cycles"):
        row[name] = 1.0
    row["frequency"], row["regime"], row["method"], row["status"] = 9.1, b"periodic", b"gum", b"ok"
    names = ("time", "accelerometer", "laser", "base", "current", "x_b", "x_1", "x_2", "v_1", "v_2")
    store.put(job, Outcome(rows=row, trace={name: np.linspace(0.0, 1.0, 9) for name in names}))
    assert store.get(job) is not None
    return store, job, tmp_path / "campaign" / FOLDER / f"{job.key}.json"


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("transmissibility", "0", "rows[0].transmissibility must be > 0"),
        ("transmissibility", "-3.5", "rows[0].transmissibility must be a number >= 0 and <= 1e+12, got -3.5"),
        ("transmissibility", "null", "rows[0].transmissibility must be a number"),
        ("transmissibility", "NaN", "got NaN"),
        ("transmissibility", "1e999", "got Infinity"),
        ("transmissibility", "1" + 400 * "0", "(401 characters)"),
        ("laser_amplitude", '"large"', 'rows[0].laser_amplitude must be a number >= 0 and <= 1e+12, got "large"'),
        ("status", '"splendid"', "rows[0].status must be one of ok"),
        ("simulated_s", "1e999", "simulated_s must be a number"),
        ("lost_scans", "1" + 400 * "0", "lost_scans must be a number"),
        ("lost_scans", "1" + 5000 * "0", "a stored result, is damaged, changed or unreadable: Exceeds the limit"),
        ("rows", "{}", "rows must be a list, got {}"),
        ("rows", "[3]", "rows[0] must be a mapping of columns to values, got 3"),
        ("skipped_hz", "[null]", "skipped_hz must be a number"),
        ("wall_s", "3.25", "was changed after it was stored"),
    ],
)
def test_an_invalid_stored_result_is_reported_in_one_line(
    stored: tuple[Store, Job, Path], key: str, value: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    store, job, file = stored
    text = file.read_text()
    pattern = rf'"{key}": (\[\]|\[.*?\n \]|[^,\n]*)(,?\n)'
    changed = re.sub(pattern, lambda found: f'"{key}": {value}{found[2]}', text, count=1, flags=re.DOTALL)
    assert changed != text
    file.write_text(changed)
    assert store.get(job) is None, "a campaign measures it again"
    assert words in store.damaged[0]
    assert main(["report", str(file.parents[1])]) == 1
    printed = capsys.readouterr().err.replace("\n", " ")
    assert "Traceback" not in printed
    assert file.name in printed.replace(" ", "")


def test_half_a_surrogate_pair_is_reported_in_one_line(stored: tuple[Store, Job, Path]) -> None:
    store, job, file = stored
    file.write_bytes(file.read_bytes().replace(b"2 mm", "2 µm".encode()[:3]))
    with pytest.raises(DamagedPointError, match=r"a stored result, is damaged, changed or unreadable: .*utf-8"):
        store.get(job, as_it_is=True)


def test_results_with_exchanged_files_are_named(tmp_path: Path, stored: tuple[Store, Job, Path]) -> None:
    _, _, file = stored
    (tmp_path / "other.yaml").write_text(TINY.replace("0.002", "0.004"))
    (other,) = run.unique_jobs(load_campaign(tmp_path / "other.yaml").planned())
    store = Store(tmp_path / "campaign")
    file.replace(file.with_name(f"{other.key}.json"))
    with pytest.raises(DamagedPointError, match=rf"the result of another job \(gap 2 mm, 9.1 Hz\), not {other.key}"):
        store.get(other, as_it_is=True)


def _npy(column: object) -> bytes:
    packed = io.BytesIO()
    np.save(packed, np.asarray(column), allow_pickle=False)
    return packed.getvalue()


@pytest.mark.parametrize(
    ("member", "words"),
    [
        (_npy(np.ones(9)).replace(b"(9,)", b"(9999999999999,)")[:300], "must be a one-dimensional array of floating"),
        (_npy(np.ones((3, 3))), "must be a one-dimensional array of floating"),
        (_npy(np.ones(0)), "column laser must have at least one value, got 0"),
        (_npy(np.ones(8)), "got 8"),
        (_npy(np.full(9, np.nan)), "column laser must be finite and within ±1e+12, got nan"),
        (_npy(np.full(9, 2.0)), "was changed after it was stored"),
        (_npy(np.array(["a"] * 9)), "must be a one-dimensional array of floating"),
        (b"", "a stored trace, is damaged, changed or unreadable"),
    ],
    ids=["1e13 elements", "reshaped", "empty", "shorter", "nan", "changed", "texts", "nothing"],
)
def test_an_invalid_stored_trace_is_reported_in_one_line(
    stored: tuple[Store, Job, Path], member: bytes, words: str
) -> None:
    store, job, file = stored
    path = file.with_suffix(".npz")
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in {**members, "laser.npy": member}.items():
            archive.writestr(name, content)
    with pytest.raises(DamagedPointError, match=re.escape(words)):
        store.get(job, as_it_is=True)


def test_a_stored_trace_with_damaged_compression_is_measured_again(stored: tuple[Store, Job, Path]) -> None:
    store, job, file = stored
    path = file.with_suffix(".npz")
    with zipfile.ZipFile(path) as archive:
        first = archive.infolist()[0]
        at = first.header_offset + 30 + len(first.filename)
    content = bytearray(path.read_bytes())
    at += content[first.header_offset + 28]  # extra field
    content[at] |= 0x06  # a reserved type of block
    path.write_bytes(content)
    assert store.get(job) is None
    assert "a stored trace, is damaged, changed or unreadable: Error -3 while decompressing" in store.damaged[0]


@pytest.mark.heavy
def test_a_stored_trace_that_would_fill_the_memory_is_not_unpacked(stored: tuple[Store, Job, Path]) -> None:
    store, job, file = stored
    np.savez_compressed(file.with_suffix(".npz"), time=np.zeros(MAX_TRACE_BYTES // 8 + 1))
    with pytest.raises(DamagedPointError, match="must hold at most"):
        store.get(job, as_it_is=True)


@pytest.mark.parametrize(
    "value", ["1" + 400 * "0", "1" + 4000 * "0", "{from: -1.0e+308, to: 1.0e+308, step: 1.0e-300}", "1.0e+999"]
)
@pytest.mark.parametrize("command", ["campaign", "map"])
def test_numbers_too_large_to_represent_are_reported_in_one_short_line(
    tmp_path: Path, command: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "plan.yaml"
    if command == "campaign":
        file.write_text(f"studies:\n  s: {{frequencies_hz: 9.1, gaps_m: {value}}}\n")
    else:
        file.write_text(f"axes: {{frequency_hz: [9.0, 9.1], gap_m: [0.002, {value}]}}\n")
        if value.startswith("{"):
            file.write_text(f"axes: {{frequency_hz: [9.0, 9.1], gap_m: {value}}}\n")
    assert main([command, str(file), "--output", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr().err
    assert "gap" in printed
    assert len(printed) < 600
    assert not (tmp_path / "out").exists()


@pytest.mark.heavy
def test_a_report_does_not_write_through_a_link(
    stored: tuple[Store, Job, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    directory = stored[2].parents[1]
    (directory / "figures").symlink_to(elsewhere)
    assert main(["report", str(directory)]) == 1
    assert "it is a link; links are not followed for writing" in capsys.readouterr().err.replace("\n", " ")
    assert not list(elsewhere.iterdir())


def test_points_are_exported_from_the_results_and_not_from_the_csv(
    stored: tuple[Store, Job, Path], tmp_path: Path
) -> None:
    directory = stored[2].parents[1]
    (directory / run.CSV_FILE).write_text("gap_m,frequency_hz\n1\n\x00,,,\n")
    assert main(["export", str(directory), "points", str(tmp_path / "points.npz")]) == 0
    with np.load(tmp_path / "points.npz") as found:
        assert found["frequency_hz"].tolist() == [9.1]
        assert found["gap_m"].tolist() == [0.002]


def test_a_results_directory_with_links_overwrites_nothing(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(TOOL["VICTIM"])
    directory = tmp_path / "campaign"
    directory.mkdir()
    (tmp_path / "plan.yaml").write_text(TINY)
    for name in (run.CAMPAIGN_FILE, run.CONFIGURATION_FILE, run.PROVENANCE_FILE):
        (directory / name).symlink_to(victim)
    run.prepare(load_campaign(tmp_path / "plan.yaml"), directory, "process")
    assert victim.read_bytes() == TOOL["VICTIM"]
    assert (directory / run.CAMPAIGN_FILE).read_text() == TINY
