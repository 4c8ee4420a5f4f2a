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
"""Places of a map per second: gap × frequency around the default rig, settled, with regime, on all cores.

A line of a map also costs the time of sending it to a worker, a process or that of a Dask cluster, and its result back.
"""

from __future__ import annotations

import resource
import tempfile
import time
from pathlib import Path

import attrs

from impact_rig_studies.campaign.pool import in_parallel, on_cluster
from impact_rig_studies.maps.measure import NOTHING, Reading
from impact_rig_studies.maps.plan import MapPlan, load_map, measure_line

TEXT = """\
axes:
  gap_m: { from: 0.002, to: 0.040, step: 0.002 }
  frequency_hz: { from: 8.605, to: 9.595, step: 0.005 }
"""


JOBS, PROCESS_JOBS = 400, 4_000  # numbers of jobs without work, on Dask and in processes


@attrs.frozen
class NoWork:
    """Job that costs nothing itself, so that its time is that of sending it and its result."""

    key: str

    def describe(self) -> str:
        """Return its name."""
        return self.key


def readings_of(_: NoWork) -> list[Reading]:
    """Return as many readings as a line of the map has."""
    return [NOTHING] * 20


def run() -> dict[str, float]:
    """Measure with a warm cache; `map_points_per_core_s` is per CPU time, regardless of other loads on the machine.

    With only 680 places the start of the workers took a third of the time.
    """
    with tempfile.TemporaryDirectory(prefix="impact_rig_bench_") as scratch:
        path = Path(scratch) / "map.yaml"
        path.write_text(TEXT)
        plan = load_map(path)
    measure_line(plan.lines()[0])  # compiles
    before, began = _cpu_s(), time.monotonic()
    points = sum(len(readings) for _, readings in in_parallel(measure_line, plan.lines()))
    wall_s, cpu_s = time.monotonic() - began, _cpu_s() - before
    return {
        "map_points_per_s": points / wall_s,
        "map_points_per_core_s": points / cpu_s,
        "map_100x100_s": _whole(plan, points, wall_s),
        "process_line_ms": _process_line_ms(),
        **_dask_line_ms(),
    }


def _process_line_ms() -> float:
    """Return the time per line of a map in worker processes without that of measuring it, once they run."""
    results = in_parallel(readings_of, [NoWork(str(n)) for n in range(PROCESS_JOBS)], 2)
    for _ in range(10):
        next(results)
    began = time.monotonic()
    rest = sum(1 for _ in results)
    return 1e3 * (time.monotonic() - began) / rest


def _dask_line_ms() -> dict[str, float]:
    """Return the same for a Dask cluster of two workers on this machine, if Dask is installed."""
    try:
        from distributed import LocalCluster  # noqa: PLC0415  # an optional dependency
    except ImportError:
        return {}
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        measure = on_cluster(readings_of, cluster.scheduler_address)
        jobs = [NoWork(str(n)) for n in range(JOBS)]
        list(measure(jobs[:20]))  # the workers import the package
        began = time.monotonic()
        assert len(list(measure(jobs))) == JOBS
        return {"dask_line_ms": 1e3 * (time.monotonic() - began) / JOBS}


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _whole(plan: MapPlan, points: int, wall_s: float) -> float:
    """Return the time of 100 × 100 places at this rate [s]."""
    assert points == plan.points
    return 10_000 * wall_s / points
