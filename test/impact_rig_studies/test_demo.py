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
"""`impact-rig demo` as a user runs it: five reductions from three real processes, and a clear error if one dies."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from impact_rig.analysis.calibration import Calibration
from impact_rig.recording import open_run
from impact_rig.runs import check_contiguity, reanalysis
from impact_rig_studies.campaign.paper import REDUCTION_PERCENT
from impact_rig_studies.cli.demo import MEASUREMENTS, RUNS
from impact_rig_studies.reduction import Reduction, reduction

pytestmark = [pytest.mark.ros, pytest.mark.pipeline, pytest.mark.timeout(300)]

START_S, DEATH_S = 240.0, 10.0
SOME_BLOCKS = 100_000
"""Bytes: a run that has begun."""
FEWER_SCANS = ("--scan-rate", "2000")
"""Options of a demo that is not to finish."""


def start_demo(directory: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", "import sys; from impact_rig.cli import main; sys.exit(main())", "demo"]
    return subprocess.Popen(
        [*command, "--output", str(directory), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        env={**os.environ, "COLUMNS": "80"},
    )


def node_pid(demo: subprocess.Popen[str], node: str) -> int | None:
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue
        if parent == demo.pid and words[2:4] == [b"impact_rig.nodes", node.encode()]:
            return int(entry.name)
    return None


def wait_for(demo: subprocess.Popen[str], path: Path, size: int = 0) -> None:
    """Wait until the demo has made `path` with this size; each check waits a limited time for the demo's own end."""
    deadline = time.monotonic() + START_S
    while not path.exists() or path.stat().st_size < size:
        try:
            demo.wait(0.05)
        except subprocess.TimeoutExpired:
            assert time.monotonic() < deadline, f"waited {START_S:g} s in vain for {path.name}"
        else:
            pytest.fail(f"the demo ended before it made {path.name}:\n{demo.communicate()[0]}")


def recorded_reductions(directory: Path) -> dict[str, Reduction]:
    """Return the reductions by gap in mm, from the recorded certificate and measurements."""
    rows = {}
    for gap_m, name in RUNS.items():
        with open_run(directory / name) as run:
            calibration = Calibration.from_info(next(run.tables("daq/info")).rows)
            found = np.concatenate([table.rows for table in run.tables("transmissibility/table")])
        rows[gap_m] = found[(found["settled"] == 1.0) & (found["gap"] == gap_m)][:MEASUREMENTS]
    without = rows.pop(0.0)
    return {f"{gap * 1e3:g}": reduction(without, own, calibration) for gap, own in rows.items()}


def end(demo: subprocess.Popen[str]) -> None:
    if demo.poll() is None:
        os.killpg(demo.pid, signal.SIGKILL)
    demo.communicate()


@pytest.mark.usefixtures("measured_programs")
def test_the_demo_reproduces_the_paper_without_losses(tmp_path: Path) -> None:
    demo = start_demo(tmp_path / "demo")
    try:
        output, _ = demo.communicate(timeout=280)
    finally:
        end(demo)
    assert demo.returncode == 0, output
    assert output.splitlines()[-1] == str(tmp_path / "demo"), "the last line is the directory, for programs"
    summary = json.loads((tmp_path / "demo" / "summary.json").read_text())
    ours = [summary["reductions_percent"][f"{gap * 1e3:g}"] for gap in REDUCTION_PERCENT]
    assert ours == pytest.approx(list(REDUCTION_PERCENT.values()), abs=3.0), output
    assert ours == sorted(ours), "the reduction grows with the gap"
    assert summary["dt_no_sphere"] == pytest.approx(summary["dt_no_sphere_closed_form"], rel=0.02)
    assert summary["lost_blocks"] == 0
    assert (tmp_path / "demo" / "reductions.png").stat().st_size > 10_000
    found = recorded_reductions(tmp_path / "demo")
    assert summary["reductions_percent"] == {gap: one.percent for gap, one in found.items()}
    assert summary["reductions_uncertainty_points"] == {gap: one.u_points for gap, one in found.items()}
    for run in sorted((tmp_path / "demo").glob("*/metadata.yaml")):
        with open_run(run.parent) as opened:
            blocks = [(table.stamp_ns, len(table.rows)) for table in opened.tables("daq/scan", recorded_order=True)]
            again = reanalysis.measurements(reanalysis.analyze(opened))
            comparison = reanalysis.compare(opened, again)
            assert comparison.identical, f"{run.parent.name}: {comparison}"
            assert len(again) >= MEASUREMENTS
        assert check_contiguity(blocks, 10_000).whole, f"{run.parent.name}: blocks are missing or come twice"
        assert sum(rows for _, rows in blocks) > 100_000


@pytest.mark.parametrize("node", ["analysis", *(pytest.param(n, marks=pytest.mark.slow) for n in ("rig", "recorder"))])
def test_a_killed_process_ends_the_demo_with_a_clear_message(tmp_path: Path, node: str) -> None:
    directory = tmp_path / "demo"
    demo = start_demo(directory, *FEWER_SCANS)
    try:
        wait_for(demo, directory / "no_sphere")
        others = {name: node_pid(demo, name) for name in ("rig", "analysis", "recorder")}
        victim = others.pop(node)
        assert victim is not None, f"the demo has no {node} process: {others}"
        os.kill(victim, signal.SIGKILL)
        killed = time.monotonic()
        output, _ = demo.communicate(timeout=60)
        assert time.monotonic() - killed < DEATH_S, "it took too long to notice"
        assert demo.returncode != 0
        assert f"the {node} process was ended by SIGKILL" in output
        for name, pid in others.items():
            assert not Path(f"/proc/{pid}").exists(), f"{name} still runs"
    finally:
        end(demo)


def test_ctrl_c_leaves_a_readable_run_and_no_process(tmp_path: Path) -> None:
    directory = tmp_path / "demo"
    demo = start_demo(directory, *FEWER_SCANS)
    try:
        wait_for(demo, directory / "gap_2mm" / "gap_2mm.mcap", SOME_BLOCKS)
        pids = [node_pid(demo, name) for name in ("rig", "analysis", "recorder")]
        os.killpg(demo.pid, signal.SIGINT)
        output, _ = demo.communicate(timeout=60)
        assert demo.returncode == 130, output
        assert "Traceback" not in output
        assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]
        with open_run(directory / "no_sphere") as run:
            assert run.resolve("daq/scan")
        with open_run(directory / "gap_2mm") as run:  # cut short, but finished
            assert list(run.tables("daq/info"))
    finally:
        end(demo)
