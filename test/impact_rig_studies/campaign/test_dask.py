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
"""Campaign on a Dask cluster of separate worker processes, one of which is killed: all points, with equal bits."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from kits.campaign import TINY, assert_same

pytest.importorskip("distributed", reason="needs the extra [cluster]")

import impact_rig
import impact_rig_studies
from impact_rig_studies.campaign import run
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.campaign.pool import AHEAD_ON_CLUSTER, cluster_threads, on_cluster
from impact_rig_studies.campaign.store import Store
from impact_rig_studies.maps.plan import load_map, measure_line
from impact_rig_studies.maps.run import store

WAIT_S = 60.0
MORE = "  more: {frequencies_hz: {from: 8, to: 10, step: 0.2}, gaps_m: [none, 0.006]}\n"
TEN_PERCENT_OFF = """

_right = MapRig.measure
MapRig.measure = lambda *arguments: (right := _right(*arguments))._replace(dt=1.1 * right.dt)
"""

SCHEDULER_GONE = """
import distributed


def fail(_client):
    raise OSError("Timed out")


distributed.Client.nthreads = fail
"""


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Yield a scheduler's address and its two workers; no dashboard, and no nanny that restarts a killed worker."""
    folder, port = tmp_path_factory.mktemp("dask"), free_port()
    address = f"tcp://127.0.0.1:{port}"
    quiet = {"cwd": folder, "stdout": subprocess.DEVNULL, "stderr": (folder / "log").open("w")}
    dask = [sys.executable, "-m", "dask"]
    local = ["--host", "127.0.0.1"]
    processes = [subprocess.Popen([*dask, "scheduler", *local, "--port", str(port), "--no-dashboard"], **quiet)]
    worker = [*dask, "worker", address, *local, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    processes += [subprocess.Popen(worker, **quiet) for _ in range(2)]
    try:
        yield address, processes[1:]
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(20)
        quiet["stderr"].close()


def start(file, directory, address, name="campaign", before=""):
    """Start the command in a separate process, because Dask leaves threads behind."""
    command = [sys.executable, "-c", f"import sys; {before}from impact_rig.cli import main; sys.exit(main())", name]
    arguments = [str(file), "--output", str(directory), "--through", "dask", address]
    return subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def test_a_worker_killed_halfway_loses_no_result(cluster, tmp_path, measured):
    from distributed import Client

    address, workers = cluster
    file, directory = tmp_path / "tiny.yaml", tmp_path / "out"
    file.write_text(TINY + MORE)
    with Client(address, timeout=WAIT_S, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=WAIT_S)
    process = start(file, directory, address)
    deadline = time.monotonic() + WAIT_S
    while len(list(directory.glob("points/*.json"))) < 5 and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.01)
    assert process.poll() is None, process.communicate()[0]
    workers[0].send_signal(signal.SIGKILL)
    output, _ = process.communicate(timeout=WAIT_S)
    assert process.returncode == 0, output
    store, jobs = Store(directory), run.unique_jobs(load_campaign(file).planned())
    assert len(jobs) > 20
    for job in jobs:
        found = store.get(job)
        assert found is not None, job.describe()
        if job.key in measured:
            assert_same(found, measured[job.key][1])


def test_jobs_are_submitted_in_small_numbers_and_their_results_released(cluster, tmp_path):
    """Otherwise, all jobs and all results would be in memory at once."""
    from distributed import Client

    address, workers = cluster
    file, taken = tmp_path / "map.yaml", []
    file.write_text("""set: {sphere.present: false}
axes: {current_a: {from: 0.101, to: 0.2, step: 0.001}, frequency_hz: [9.0, 9.1]}
""")

    class Jobs(list):
        def __iter__(self):
            for job in super().__iter__():
                taken.append(job)
                yield job

    lines, most, held = load_map(file).lines(), 2 * AHEAD_ON_CLUSTER * len(workers), []
    assert len(lines) == 100
    with Client(address, timeout=WAIT_S, set_as_default=False) as client:
        for n, (line, readings) in enumerate(on_cluster(measure_line, address)(Jobs(lines))):
            assert len(readings) == len(line.values) == 2
            assert len(taken) <= n + most
            if n % 20 == 19:
                held.append(client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))
    assert len(taken) == 100
    assert max(held) <= most


def test_a_time_limit_counts_the_threads_of_the_cluster(cluster):
    from distributed import Client

    address, workers = cluster
    present = sum(worker.poll() is None for worker in workers)
    with Client(address, timeout=WAIT_S, set_as_default=False) as client:
        client.wait_for_workers(present, timeout=WAIT_S)
    assert cluster_threads(address) == present


@pytest.mark.slow  # the next test does the same, with other workers among those of the cluster
def test_a_map_measured_on_a_cluster_has_the_same_bits(cluster, tmp_path):
    address, _ = cluster
    file, directory = tmp_path / "map.yaml", tmp_path / "out"
    file.write_text("axes: {gap_m: [0.012, 0.02], frequency_hz: [9.0, 9.1]}\n")
    process = start(file, directory, address, "map")
    output, _ = process.communicate(timeout=2 * WAIT_S)
    assert process.returncode == 0, output
    for line in load_map(file).lines():
        assert store(directory).get(line) == measure_line(line)


def test_workers_with_other_code_are_named_and_their_results_not_stored(cluster, tmp_path):
    """One such worker is there from the start, one joins late; their results must not be stored."""
    from distributed import Client

    address, workers = cluster
    sound = [worker for worker in workers if worker.poll() is None]
    for package in (impact_rig, impact_rig_studies):
        root = Path(package.__file__).parent
        shutil.copytree(root, tmp_path / "other" / root.name)  # with bytecode, which both workers would compile
    changed = tmp_path / "other/impact_rig_studies/maps/measure.py"
    changed.write_text(changed.read_text(encoding="utf-8") + TEN_PERCENT_OFF, encoding="utf-8")
    file, directory = tmp_path / "map.yaml", tmp_path / "out"
    file.write_text("axes: {gap_m: {from: 0.01, to: 0.02, step: 0.00025}, frequency_hz: [9.0, 9.05, 9.1, 9.15, 9.2]}\n")
    worker = [sys.executable, "-m", "dask", "worker", address, "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "other")}
    quiet = {"cwd": tmp_path, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    others, named = [], set()
    try:
        with Client(address, timeout=WAIT_S, set_as_default=False) as client:

            def join():
                before = set(client.nthreads())
                others.append(subprocess.Popen([*worker, "--no-dashboard"], **quiet))
                client.wait_for_workers(len(before) + 1, timeout=WAIT_S)
                (joined,) = set(client.nthreads()) - before
                named.add(joined)

            client.wait_for_workers(len(sound), timeout=WAIT_S)
            join()
            process = start(file, directory, address, "map")
            deadline = time.monotonic() + WAIT_S
            while not list(directory.glob("lines/*.json")) and time.monotonic() < deadline and process.poll() is None:
                time.sleep(0.01)
            for one in sound:
                one.send_signal(signal.SIGSTOP)  # nothing ends before the late one is there
            try:
                assert process.poll() is None, process.communicate()[0]
                join()
            finally:
                for one in sound:
                    one.send_signal(signal.SIGCONT)
            output, _ = process.communicate(timeout=2 * WAIT_S)
    finally:
        for one in others:
            one.terminate()
            one.wait(20)
    assert process.returncode == 0, output
    warned = re.findall(r"worker (\S+) has impact_rig \S+, but this process has \S+: the worker is not used;", output)
    assert len(warned) == len(named) == 2, output
    assert set(warned) == named
    for line in load_map(file).lines():
        assert store(directory).get(line) == measure_line(line)


def test_an_unreachable_cluster_is_reported_in_one_line(tmp_path):
    file, address = tmp_path / "tiny.yaml", f"tcp://127.0.0.1:{free_port()}"
    file.write_text(TINY)
    impatient = "from impact_rig_studies.campaign import pool; pool.CONNECT_S = 1.0; "
    process = start(file, tmp_path / "out", address, before=impatient)
    output, _ = process.communicate(timeout=WAIT_S)
    assert process.returncode == 1
    assert f"cannot reach a Dask scheduler at {address}" in output
    assert "Traceback" not in output


def test_a_lost_scheduler_is_named_with_what_to_do(cluster, tmp_path):
    file, address = tmp_path / "tiny.yaml", cluster[0]
    file.write_text(TINY)
    process = start(file, tmp_path / "out", address, before=SCHEDULER_GONE)
    output, _ = process.communicate(timeout=WAIT_S)
    assert process.returncode == 1
    assert f"lost the connection to the Dask scheduler at {address}: Timed out; run the command again" in output
    assert "Traceback" not in output
