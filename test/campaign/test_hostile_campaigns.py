# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Campaign files made to fill the memory: refused before they are read, or before their points are made."""

from __future__ import annotations

import io
import os
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from impact_rig.campaign import run
from impact_rig.campaign.plan import load_campaign
from impact_rig.campaign.store import FOLDER, MAX_TRACE_BYTES, Store
from impact_rig.errors import ConfigError
from impact_rig.rig.config import load
from impact_rig.system import budget
from impact_rig.system.budget import BudgetError

TOOL: dict[str, Any] = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "hostile.py"))
TINY = "studies:\n  s:\n    frequencies_hz: 9.1\n    gaps_m: 0.002\n    traces: true\n"


def test_a_plan_of_millions_of_points_is_refused_before_any_is_made(tmp_path: Path) -> None:
    with pytest.raises(BudgetError, match=r"points in a campaign, more than 20000; .* IMPACT_RIG_BUDGET=N"):
        load_campaign(TOOL["huge_plan"](tmp_path))


def test_the_budget_counts_what_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "POINTS", 11)
    path = tmp_path / "plan.yaml"
    path.write_text("studies:\n  s: {frequencies_hz: [9.0, 9.1], gaps_m: [0.002, 0.004], repetitions: 3}\n")
    with pytest.raises(BudgetError, match="12 points"):
        load_campaign(path)
    monkeypatch.setattr(budget, "POINTS", 12)
    assert len(load_campaign(path).planned()) == 4


def test_what_is_no_regular_file_is_neither_read_nor_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo.yaml")
    for path in (Path("/dev/zero"), tmp_path / "fifo.yaml"):
        for read in (load, load_campaign):
            with pytest.raises(ConfigError, match="not a regular file"):
                read(path)


def test_a_stored_trace_that_would_fill_the_memory_counts_as_none(tmp_path: Path) -> None:
    (tmp_path / "plan.yaml").write_text(TINY)
    job = run.unique_jobs(load_campaign(tmp_path / "plan.yaml").planned())[0]
    store = Store(tmp_path)
    packed = io.BytesIO()
    np.savez_compressed(packed, time=np.zeros(MAX_TRACE_BYTES // 8 + 1))
    (tmp_path / FOLDER / f"{job.key}.json").write_text(
        '{"failure": "", "code": "", "rows": [], "skipped_hz": [], "simulated_s": 0, "wall_s": 0, "lost_scans": 0}'
    )
    assert store.get(job, as_it_is=True) is not None
    (tmp_path / FOLDER / f"{job.key}.npz").write_bytes(packed.getvalue())
    assert store.get(job, as_it_is=True) is None


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
