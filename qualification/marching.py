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
"""Maps compared with longer motions: `python -m qualification.marching`, 680 places, 2 to 40 mm, 8.6 to 9.6 Hz.

At each place the map measures. From the same start the motion then continues for 1,200 cycles, and its last 200 are
evaluated from 64 samples per cycle. Differences are printed. The exit code is 1 if DT differs by more than
`settle_tolerance` although both motions repeat alike, or if more than one in a hundred of the places that repeat is
classified differently.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from rich.console import Console

from impact_rig.analysis.cycles import PHASE_BINS
from impact_rig.analysis.spread import classify
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_studies.campaign.pool import in_parallel
from impact_rig_studies.maps.measure import WEAK, MapRig, Settings
from impact_rig_studies.maps.plan import MapLine, load_map

CYCLES, JUDGED, PER_CYCLE = 1200, 200, 64
TEXT = """\
axes:
  gap_m: { from: 0.002, to: 0.040, step: 0.002 }
  frequency_hz: { from: 8.605, to: 9.595, step: 0.03 }
"""


def marched(rig: MapRig, frequency_hz: float, amplitude: float) -> tuple[str, float, float]:
    """Return regime, period and DT of the last cycles of a long motion, from samples and impacts."""
    rig.run_cycles(frequency_hz, amplitude, CYCLES - JUDGED)
    motion, angle = rig.run_cycles(frequency_hz, amplitude, JUDGED), 2.0 * np.pi * np.arange(PER_CYCLE) / PER_CYCLE
    number = np.repeat(np.arange(motion.first_tick, motion.last_tick + 1), PER_CYCLE)
    samples = motion.quantities(("x_b", "x_1"), number, np.tile(angle / (2.0 * np.pi * frequency_hz), JUDGED))
    x_b, x_1 = samples.reshape(2, JUDGED, PER_CYCLE) @ np.exp(-1j * angle)
    strikes = np.zeros((JUDGED, PHASE_BINS), np.uint8)
    hits = motion.impacts[motion.impacts["tick"] >= motion.first_tick]
    hits = hits[hits["approach_speed"] >= WEAK * hits["approach_speed"].max(initial=0.0)]
    strikes[hits["tick"] - motion.first_tick, (hits["offset"] * frequency_hz * PHASE_BINS).astype(int)] = 1
    found = classify(x_1 / x_1.mean() - 1.0, 0.0, Settings().periodic_tolerance, strikes)
    n = JUDGED - JUDGED % int(found.period) if math.isfinite(found.period) else JUDGED
    return found.regime.value, found.period, float(abs(x_1[-n:].mean() / x_b[-n:].mean()))


def compared(line: MapLine) -> list[tuple[str, str, float]]:
    """Return for each place the map's regime, that of the long motion, and the relative difference of DT."""
    rows, base = [], from_flat(RigConfig(), line.changes)
    for value in line.values:
        changes, frequency, current, sphere = line.place(value)
        rig = MapRig(from_flat(base, changes), line.settings)
        rig.reset(sphere)
        said = rig.measure(frequency, current)
        rig.reset(sphere)
        regime, period, dt = marched(rig, frequency, current)
        rows.append((f"{said.regime} {said.period:g}", f"{regime} {period:g}", abs(said.dt / dt - 1.0)))
    return rows


def main() -> int:
    """Compare and print."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    console = Console()
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "map.yaml"
        path.write_text(TEXT)
        lines = load_map(path).lines()
    rows = [row for _, found in in_parallel(compared, lines) for row in found]
    repeats = [row for row in rows if "nan" not in row[1]]
    alike = np.array([row[2] for row in repeats if row[0] == row[1]])
    other = Counter(row[:2] for row in rows if row[0] != row[1])
    console.print(
        f"{len(rows)} places: {len(repeats)} repeat, {len(alike)} of them alike in regime and period, DT within "
        f"{alike.max():.1e} (99 % within {np.quantile(alike, 0.99):.1e}, half within {np.median(alike):.1e})"
    )
    for (said, does), number in other.most_common():
        console.print(f"  {number}: map {said}, long motion {does}")
    return int(alike.max() > Settings().settle_tolerance or len(alike) < 0.99 * len(repeats))


if __name__ == "__main__":
    sys.exit(main())
