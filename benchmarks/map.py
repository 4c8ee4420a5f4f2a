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
"""Places of a map per second: gap × frequency around the default rig, settled, with regime, on all cores."""

from __future__ import annotations

import resource
import tempfile
import time
from pathlib import Path

from impact_rig_studies.campaign.pool import in_parallel
from impact_rig_studies.maps.plan import MapPlan, load_map, measure_line

TEXT = """\
axes:
  gap_m: { from: 0.002, to: 0.040, step: 0.002 }
  frequency_hz: { from: 8.605, to: 9.595, step: 0.005 }
"""


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
    }


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _whole(plan: MapPlan, points: int, wall_s: float) -> float:
    """Return the time of 100 × 100 places at this rate [s]."""
    assert points == plan.points
    return 10_000 * wall_s / points
