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
"""A campaign gives equal bits however it is run, can be stopped and resumed, and survives points that fail."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time

import attrs
import numpy as np
import pytest
from kits.campaign import TINY, assert_same
from kits.measured import measured as watched

from impact_rig.cli import main
from impact_rig.errors import RecordingError
from impact_rig_studies.campaign import run
from impact_rig_studies.campaign.job import Outcome
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.campaign.store import Store
from impact_rig_studies.campaign.tasks import measure
from impact_rig_studies.operate.plans import Direction

pytestmark = pytest.mark.heavy

SHOWN_CURVES = ("pair, 6 mm, reset, 0.52 A", "sweep, 3 mm, up, 0.52 A", "sweep, 3 mm, down, 0.52 A")


def test_a_stored_outcome_reads_back_bit_for_bit(measured, tmp_path):
    store = Store(tmp_path)
    for job, outcome in measured.values():
        assert store.get(job) is None
        store.put(job, outcome)
        found = store.get(job)
        assert found is not None
        assert_same(found, outcome)


def test_a_stopped_campaign_resumes_without_repeating_a_job(tiny, measured, tmp_path):
    asked = []

    def stored(jobs):
        asked.append([job.key for job in jobs])
        return ((job, measured[job.key][1]) for job in jobs)

    jobs, store = run.unique_jobs(tiny.planned()), run.prepare(tiny, tmp_path, "process")
    first = measure(jobs, store.get, store.put, stored)
    done = [job.key for job, _ in itertools.islice(first, 2)]
    first.close()  # Ctrl-C
    rest = [job.key for job, _ in measure(jobs, Store(tmp_path).get, Store(tmp_path).put, stored)]
    assert asked[1] == [job.key for job in jobs if job.key not in done]
    assert rest == [job.key for job in jobs]
    for job, outcome in measure(jobs, Store(tmp_path).get, Store(tmp_path).put, stored):
        assert_same(outcome, measured[job.key][1])
    assert len(asked) == 2, "a complete campaign asks for nothing"


def test_a_damaged_result_is_measured_again(measured, tmp_path):
    job, outcome = next(iter(measured.values()))
    store = Store(tmp_path)
    store.put(job, outcome)
    (file,) = tmp_path.glob("points/*.json")
    file.write_text(file.read_text()[:100])
    assert store.get(job) is None


def test_a_result_without_its_trace_is_valid_until_the_trace_is_requested(measured, tmp_path):
    job, outcome = next(iter(measured.values()))
    store = Store(tmp_path)
    store.put(job, attrs.evolve(outcome, trace={}))
    assert store.get(job) is None
    found = store.get(job, as_it_is=True)
    assert found is not None
    assert_same(found, attrs.evolve(outcome, trace={}))


def test_a_failed_run_removes_the_trace_of_an_earlier_one(measured, tmp_path):
    """If the trace of the earlier run stayed, the point, and with it the campaign, would count as damaged forever."""
    job, outcome = next((job, outcome) for job, outcome in measured.values() if outcome.trace)
    store = Store(tmp_path)
    store.put(job, outcome)
    store.put(job, Outcome(failure="the rig tripped"))
    found = store.get(job, as_it_is=True)
    assert found is not None
    assert found.failure == "the rig tripped"
    assert not found.trace
    assert store.get(job) is not None
    assert store.damaged == []


def test_a_result_of_other_code_is_shown_but_not_mixed_with_new_ones(tiny, measured, tmp_path, monkeypatch):
    store = run.prepare(tiny, tmp_path, "process")
    with monkeypatch.context() as before:
        before.setattr("impact_rig_studies.campaign.store.code_fingerprint", lambda: "0.0.9-of-old")
        for job, outcome in measured.values():
            store.put(job, outcome)
            assert store.get(job) is not None
    assert [store.get(job) for job, _ in measured.values()] == [None] * len(measured)
    assert len(run.open_finished(tmp_path).points) == 10, "a report needs no measuring"


def test_curves_are_exported_as_a_universal_file(tiny, measured, tmp_path):
    """The example of `impact-rig export --help`: one function per curve, separate for studies and directions."""
    pyuff = pytest.importorskip("pyuff")
    store = run.prepare(tiny, tmp_path / "campaign", "process")
    for job, outcome in measured.values():
        store.put(job, outcome)
    assert main(["export", str(tmp_path / "campaign"), "points", str(tmp_path / "curves.uff")]) == 0
    curves = {one["id1"]: one for one in pyuff.UFF(str(tmp_path / "curves.uff")).read_sets()}
    assert set(curves) == {f"X_1/X_b, {curve}" for curve in SHOWN_CURVES}
    up = curves["X_1/X_b, sweep, 3 mm, up, 0.52 A"]
    assert up["x"].tolist() == [9.0, 9.2]
    points = [point for point in run.finished(tiny, tmp_path / "campaign").points if point.direction == "up"]
    assert np.abs(up["data"]) == pytest.approx([point.dt for point in points])


def test_failed_points_are_reported_and_do_not_stop_the_others(tiny, measured, tmp_path):
    store = run.prepare(tiny, tmp_path, "process")
    for job, outcome in measured.values():
        store.put(job, outcome)
    done = run.finished(tiny, tmp_path)
    failures = {point.study: point.failure for point in done.failed()}
    assert set(failures) == {"trip", "refused"}
    assert "over_travel" in failures["trip"]
    assert "limit 6.35 mm" in failures["trip"]
    assert "current must be >= 0 and <= 21.21 A" in failures["refused"]
    run.write_results(done, 1.0)
    assert json.loads((tmp_path / "summary.json").read_text())["failed_points"] == 2
    lines = (tmp_path / "points.csv").read_text().splitlines()
    assert len(lines) == 1 + len(done.points) == 1 + 2 + 4 + 2 + 2
    assert any("over_travel" in line for line in lines)


def test_a_sweep_visits_up_and_down_and_keeps_the_state(tiny, measured):
    done = {one.study: one for one in tiny.planned()}
    points = run.points_of(done["sweep"], measured[done["sweep"].job.key][1])
    visits = [(p.frequency_hz, p.direction) for p in points]
    assert visits == [(9.0, "up"), (9.2, "up"), (9.2, "down"), (9.0, "down")]
    assert all(point.settled and not point.reference for point in points)
    assert points[0].dt == pytest.approx(points[3].dt, rel=0.05)


def test_the_way_back_of_a_sweep_with_one_frequency_is_not_after_a_reset(tiny, measured):
    one = next(one for one in tiny.planned() if one.reference and len(one.job.frequencies_hz) == 1)
    planned = attrs.evolve(one, job=attrs.evolve(one.job, direction=Direction.UP_DOWN))
    outcome = attrs.evolve(measured[one.job.key][1], rows=np.tile(measured[one.job.key][1].rows[:1], 2))
    points = run.points_of(planned, outcome)
    assert [(p.direction, p.reference, p.settled) for p in points] == [("reset", True, True), ("down", False, True)]


def test_a_point_skipped_after_its_first_row_has_the_right_reason(tiny, measured):
    """The reason must not be `not reached`, nor that of the way down, which the rig's trip had ended."""
    sweep = next(one for one in tiny.planned() if one.study == "sweep")
    job = attrs.evolve(sweep.job, repetitions=2)
    rows = measured[sweep.job.key][1].rows[[0, 1, 1]]  # one at the first frequency, two at the second, going up
    outcome = Outcome(rows=rows, skipped_hz=(9.0,), failure="the rig tripped")
    points = run.points_of(attrs.evolve(sweep, job=job), outcome)
    assert [len(point.rows) for point in points] == [1, 2, 0, 0]
    assert [point.failure for point in points] == ["over_range", "", "the rig tripped", "the rig tripped"]


def test_studies_share_runs_with_equal_settings(tiny):
    planned = tiny.planned()
    assert len(planned) == 7
    jobs = run.unique_jobs(planned)
    assert len(jobs) == 6
    assert [job.traces for job in jobs][:2] == [True, True]


def test_a_trace_contains_scans_and_truth_of_the_same_instants(measured):
    job, outcome = next(iter(measured.values()))
    trace = outcome.trace
    assert len(trace["time"]) == 5000
    error = np.abs(trace["laser"] - trace["x_1"])
    assert np.percentile(error, 50) < 0.05 * np.ptp(trace["x_1"]), "the laser lags by 0.7 ms"
    assert np.abs(trace["x_2"] - trace["x_1"]).max() <= job.gap_m / 2 + 1e-4, "the sphere is between the barriers"


def test_a_directory_with_other_files_is_never_taken_for_a_campaign(tiny, tmp_path):
    (tmp_path / "thesis.tex").write_text("dear")
    with pytest.raises(RecordingError, match=r"is not empty and has no campaign\.yaml"):
        run.prepare(tiny, tmp_path, "process")


def test_results_of_another_rig_are_not_replaced(tmp_path, capsys):
    """With another seed the certificate differs, so no point of the two rigs belongs in one table."""
    plan, out = tmp_path / "one.yaml", tmp_path / "out"
    plan.write_text("studies: {one: {frequencies_hz: 9.5, gaps_m: none}}\n")
    words = ["campaign", str(plan), "--output", str(out)]
    assert main(words) == 0
    kept = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert main([*words, "--seed", "7"]) == 1
    assert "has results of a rig with daq.seed 1, not 7" in capsys.readouterr().err
    plan.write_text("set: {structure.mass_kg: 0.2}\n" + plan.read_text())
    assert main(words) == 1
    assert "has results of a rig with structure.mass_kg 0.13, not 0.2" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == kept


RUN_TIER = """
import importlib.metadata as metadata, sys
known = metadata.version
def version(name):
    if name in ("numba", "llvmlite", "matplotlib", "distributed"):
        raise metadata.PackageNotFoundError(name)
    return known(name)
metadata.version = version
from impact_rig.cli import main
sys.exit(main())
"""
"""The command where optional packages are not installed, as far as the metadata of the environment say."""


def test_a_campaign_runs_where_optional_packages_are_not_installed(tmp_path):
    (tmp_path / "one.yaml").write_text("studies: {one: {frequencies_hz: 9.1, gaps_m: none}}")
    command = [sys.executable, "-c", RUN_TIER, "campaign", "one.yaml", "--output", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=watched(), check=False)
    assert done.returncode == 0, done.stderr
    provenance = json.loads((tmp_path / "out" / run.PROVENANCE_FILE).read_text())
    assert (provenance["numba"], provenance["numpy"]) == ("not installed", np.__version__)


def test_a_command_that_fails_before_its_first_result_creates_no_directory(tmp_path):
    """An incomplete directory would look like a result, and the next attempt would be rejected or resume nothing."""
    plans = {
        "campaign": "studies: {one: {frequencies_hz: 9.1, gaps_m: none}}",
        "map": "axes: {gap_m: [0.006, 0.008], frequency_hz: [9.0, 9.1]}",
        "dynamics orbit": "orbit: {starts: [centre]}",
    }
    program = (  # ended at once: a client of Dask that cannot connect leaves a thread that would be waited for
        "import os, sys; from impact_rig.cli import main; os._exit(sum(main(one.split()) for one in sys.argv[1:]))"
    )
    lines = []
    for words, plan in plans.items():
        file = tmp_path / f"{words.split()[0]}.yaml"
        file.write_text(plan)
        lines.append(f"{words} {file.name} --output {file.stem} --through dask nowhere://x")
    command = [sys.executable, "-c", program, *lines]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=watched(), check=False)
    assert done.returncode == done.stderr.count("cannot reach a Dask scheduler") == len(plans), done.stderr
    assert not [path for path in tmp_path.iterdir() if path.is_dir()]


def test_a_point_without_impacts_is_measured_and_passes_the_check(tmp_path, capsys):
    """At 12 mm, a wait of two minutes would exceed the time limit of one minute and make the point a failure."""
    file = tmp_path / "quiet.yaml"
    file.write_text("studies: {quiet: {frequencies_hz: 9.1, gaps_m: [none, 0.012], starts: [centre]}}")
    assert main(["campaign", str(file), "--output", str(tmp_path / "out"), "--check", "--workers", "1"]) == 0
    assert "1 of 2 points: the sphere did not strike (no impacts for 6" in " ".join(capsys.readouterr().out.split())
    rows = (tmp_path / "out" / run.CSV_FILE).read_text().splitlines()
    columns = dict(zip(rows[0].split(","), rows[2].split(","), strict=True))
    assert (columns["status"], columns["settled"], columns["regime"]) == ("no_impacts", "1", "periodic")
    assert float(columns["transmissibility_uncertainty"]) > 0.0


def start(file, directory, *more, environment=None):
    """Start the command with two workers in a separate process; they and what watches them end with it."""
    command = [sys.executable, "-c", "import sys; from impact_rig.cli import main; sys.exit(main())", "campaign"]
    arguments = [str(file), "--output", str(directory), "--workers", "2", *more]
    return subprocess.Popen(
        [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
    )


def test_an_interrupted_parallel_campaign_resumes_with_the_same_bits(tmp_path, measured):
    file, directory = tmp_path / "tiny.yaml", tmp_path / "out"
    kept_studies = [line for line in TINY.splitlines(keepends=True) if not line.startswith(("  sweep:", "  again:"))]
    more = "  more: {frequencies_hz: {from: 8, to: 10, step: 0.1}, gaps_m: none}\n"  # so that it is surely not done yet
    file.write_text("".join(kept_studies) + more)
    process = start(file, directory)
    deadline = time.monotonic() + 100
    while not list(directory.glob("points/*.json")) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGINT)
    output, _ = process.communicate(timeout=100)
    assert process.returncode == 130, output
    assert "Traceback" not in output
    kept = {path: path.stat().st_mtime_ns for path in directory.glob("points/*.json")}
    campaign, store = load_campaign(file), Store(directory)
    jobs = run.unique_jobs(campaign.planned())
    assert 1 <= len(kept) < len(jobs)
    process = start(file, directory, "--check", environment=watched())  # no signal reaches its tracer
    output, _ = process.communicate(timeout=100)
    assert process.returncode == 1, "two points failed, and that was to be checked"
    assert output.splitlines()[-1] == str(directory), "the last line is the directory, for programs"
    assert "over_travel" in output
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    for job in jobs:
        found = store.get(job)
        assert found is not None
        if job.key in measured:
            assert_same(found, measured[job.key][1])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--through", "telepathy"], "the way of measuring, --through, must be one of process, ros, dask"),
        (["--through", "dask"], "needs the address of a scheduler"),
        (["--workers", "0"], "--workers must be >= 1"),
        (["--only", "nothing"], "study must be one of pair, sweep"),
    ],
)
def test_an_invalid_argument_is_reported_in_one_line(tmp_path, capsys, arguments, words):
    file = tmp_path / "tiny.yaml"
    file.write_text(TINY)
    assert main(["campaign", str(file), "--output", str(tmp_path / "out"), *arguments]) == 1
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("first", [[], ["--only", "one"], ["--only", "two", "three"]])
def test_running_a_part_of_a_campaign_keeps_all_earlier_results(tmp_path, capsys, monkeypatch, first):
    """`--only` must not remove the points of other studies from points.csv, because the report contains them."""
    studies = {"one": "{frequencies_hz: 9.1, gaps_m: none}", "two": "{frequencies_hz: [8.5, 9.8], gaps_m: none}"}
    studies["three"] = "{frequencies_hz: 9.1, gaps_m: none, seeds: [5]}"
    file, out = tmp_path / "three.yaml", tmp_path / "out"
    file.write_text("studies:\n" + "".join(f"  {name}: {text}\n" for name, text in studies.items()))
    command = ["campaign", str(file), "--output", str(out), "--workers", "1"]
    assert main([*command, *first]) == 0
    assert len((out / run.CSV_FILE).read_text().splitlines()) - 1 == {0: 4, 2: 1, 3: 3}[len(first)]
    whole = main([*command]) == 0 and [(out / name).read_text() for name in (run.CSV_FILE, run.CAMPAIGN_FILE)]
    capsys.readouterr()
    for name in studies:
        assert main([*command, "--only", name]) == 0
        assert [(out / name).read_text() for name in (run.CSV_FILE, run.CAMPAIGN_FILE)] == whole
        summary = json.loads((out / "summary.json").read_text())
        assert (summary["points"], len(run.open_finished(out).points)) == (4, 4)
        assert "4 points; results for programs" in (printed := " ".join(capsys.readouterr().out.split()))
        assert "other code" not in printed
    monkeypatch.setattr("impact_rig_studies.campaign.store.code_fingerprint", lambda: "0.0.9-of-new")
    assert main([*command, "--only", "two"]) == 0
    assert "2 runs of other studies were measured with other code, or lack the time trace" in " ".join(
        capsys.readouterr().out.split()
    )
