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
"""First rows after a start, against the truth: `python -m qualification.first_rows FOLDER [--seeds N]`.

    linear        no sphere, prescribed base of 2, 5 and 10 µm at 9.1 Hz, from rest: never modulated or chaotic, mean
                  error of DT at most 0.2 u, 92 to 98.5 % within 2u
    intermittent  30 mm at 8.82 Hz: at least 92 % within 2u, none beyond 4.5u; rows without impacts and rows that have
                  not settled say so and are not judged

Every seed draws the errors and the noise of all instruments. Results are kept in FOLDER, so a run can be resumed.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

from impact_rig.physics.linear_response import transmissibility
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig.simtime import TICKS_PER_S
from qualification.coverage_of_uncertainties import Case, driven, irregular_cases, measured, motions, stretches
from qualification.results import Results

BASES_UM, FREQUENCY_HZ, SECONDS = (2.0, 5.0, 10.0), 9.1, 80.0
MEAN, LOW, HIGH, FAR = 0.2, 0.92, 0.985, 4.5
TRUTH_S = 7200.0  # duration over which an irregular motion is averaged


def row_of(case: Case, seed: int, motion: Any, truth: complex) -> dict[str, object]:
    """Return the first row of a seed, and its error in units of its uncertainty."""
    tables = measured(case, seed, motion)[0]
    if not tables:  # the record ends before the first row
        return {"seed": seed, "status": "none", "regime": ""}
    row = tables[0].rows[0]
    return {
        "seed": seed, "status": row["status"].decode(), "regime": row["regime"].decode(),
        "impacts_per_cycle": float(row["impacts_per_cycle"]),
        "dt": float((row["transmissibility"] - abs(truth)) / row["transmissibility_uncertainty"]),
        "phase": float((row["phase"] - np.angle(truth)) / row["phase_uncertainty"]),
    }  # fmt: skip


def averaged(case: Case) -> complex:
    """Return the transmissibility of an irregular motion, a mean over hours."""
    simulation, drive = driven(case)
    total, step_s = np.zeros(2, np.complex128), 100.0
    for _ in range(round(TRUTH_S / step_s)):
        cycles = simulation.advance(drive.segments(round(step_s * TICKS_PER_S)))
        number = np.repeat(np.arange(cycles.first_tick, cycles.last_tick + 1), 8)
        offset = np.tile(np.arange(8) / 8 / TICKS_PER_S, cycles.last_tick + 1 - cycles.first_tick)
        samples = cycles.quantities(("x_b", "x_1"), number, offset)
        time_s = number / TICKS_PER_S + offset
        total += samples @ np.exp(-2j * math.pi * case.frequency_hz * time_s)
    return complex(total[1] / total[0])


def report(name: str, done: list[dict[str, Any]], *, linear: bool) -> bool:
    """Print the errors of the rows of a case; return whether they are within the limits."""
    rows = [one for one in done if one["status"] == "ok"]
    dt, phase = (np.array([one[key] for one in rows]) for key in ("dt", "phase"))
    irregular = sum(one["regime"] in ("modulated", "chaotic") for one in done)
    inside = [float(np.mean(np.abs(z) <= 2.0)) for z in (dt, phase)]
    print(  # noqa: T201  # the result
        f"{name}: {len(rows)} of {len(done)} rows judged, {irregular} called modulated or chaotic, "
        f"mean {dt.mean():+.2f} and {phase.mean():+.2f} u, within 2u {100 * inside[0]:.1f} and "
        f"{100 * inside[1]:.1f} %, largest {np.abs(dt).max():.1f} and {np.abs(phase).max():.1f} u"
    )
    if linear:
        return irregular == 0 and abs(dt.mean()) <= MEAN and all(LOW <= share <= HIGH for share in inside)
    return min(inside) >= LOW and max(np.abs(dt).max(), np.abs(phase).max()) <= FAR


def main() -> int:
    """Measure the results that are missing; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder that keeps the results")
    parser.add_argument("--seeds", type=int, default=300, help="number of seeds of each case (default: 300)")
    arguments = parser.parse_args()
    sound = True
    linear = [
        Case(
            "small", (("drive.kind", "prescribed"),), FREQUENCY_HZ, 1e-6 * um, (NO_SPHERE,), 0.0, SECONDS, (f"{um:g}",)
        )
        for um in BASES_UM
    ]
    (intermittent,) = [case for case in irregular_cases() if case.label == ("30", "8.82")]
    for case in (*linear, intermittent):
        name = "_".join((case.table, *case.label))
        done = Results(arguments.folder / f"{name}.jsonl")
        first, is_linear = len(done), case.table == "small"
        if first < arguments.seeds:
            truth = complex(transmissibility(case.config(NO_SPHERE), FREQUENCY_HZ)) if is_linear else averaged(case)
            parts = (
                (motions(case) for _ in range(arguments.seeds))
                if is_linear
                else ((motion,) for motion in stretches(case, range(arguments.seeds)))
            )
            for seed, motion in enumerate(parts):
                if seed < first:
                    continue
                done.add(row_of(case, seed + 1, motion, truth))
        sound = report(name, done, linear=is_linear) and sound
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
