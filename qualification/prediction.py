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
"""Two symmetric impacts per cycle, predicted and measured, as a table: `python -m qualification.prediction`.

The places are every 2 mm at 8.8, 9.1 and 9.4 Hz, measured through instruments and analysis (a minute of two cores). The
exit code is 1 if a stable symmetric motion is predicted and the measured motion is another, or more than 1 % in DT or
2° in phase away.
`--draw` draws docs/images/prediction.png.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.drawing import INK, SERIES, legend_below, new_axes, style
from impact_rig.rig.config import RigConfig
from impact_rig_studies import prediction
from impact_rig_studies.campaign.job import Job, Outcome, execute
from impact_rig_studies.campaign.paper import CURRENT_A
from impact_rig_studies.campaign.pool import in_parallel
from impact_rig_studies.dynamics import figures
from impact_rig_studies.dynamics.plan import CONTINUE, Plan, StudyTask, run
from impact_rig_studies.maps.measure import Settings
from impact_rig_studies.maps.plan import GAP

FREQUENCIES_HZ = (8.8, 9.1, 9.4)
GAPS_MM = (6, 8, 10, 11, 12, *range(14, 41, 2), 27, 29, 31)
FROM_MM, TO_MM = 5.0, 41.0
CONTINUED_MM = (6, 8, 10, 11)
"""Starting points for the continuation of motions with other numbers of impacts."""
WITHIN, WITHIN_DEGREES = 0.01, 2.0
PICTURE = Path(__file__).parents[1] / "docs" / "images" / "prediction.png"


@attrs.frozen(kw_only=True)
class Compared:
    """One place, measured and predicted; NaN without a measurement, or without such a motion."""

    frequency_hz: float  # drive frequency
    gap_m: float  # gap
    dt: float  # measured
    phase_rad: float  # measured phase of the superior base relative to the base
    impacts_per_cycle: float  # measured
    regime: str  # measured regime; empty if nothing was measured
    period: float  # cycles after which the response repeats
    predicted_dt: float  # DT of the stable motion with two symmetric impacts per cycle
    predicted_phase_rad: float  # its phase

    @property
    def two_per_cycle(self) -> bool:
        """Return whether the measurement repeats every cycle with two impacts; the two half cycles may differ."""
        return self.regime == "periodic" and self.period == 1.0 and abs(self.impacts_per_cycle - 2.0) < 0.05

    @property
    def predicted(self) -> bool:
        """Return whether a stable symmetric motion is predicted."""
        return not math.isnan(self.predicted_dt)


def job(frequency_hz: float, gap_m: float, current_a: float = CURRENT_A) -> Job:
    """Return the measurement of one place of the default rig."""
    changes = {"barriers.gap_m": gap_m}
    return Job(changes=changes, gap_m=gap_m, frequencies_hz=(frequency_hz,), current_a=current_a)


def compared(one: Job, outcome: Outcome) -> Compared:
    """Return a job's measurement together with its prediction."""
    frequency, rows = one.frequencies_hz[0], outcome.rows
    predicted = prediction.at(one.config(), frequency, one.gap_m, current_a=one.current_a)
    stable = np.flatnonzero(predicted.stable)
    measured = len(rows) > 0
    return Compared(
        frequency_hz=frequency,
        gap_m=one.gap_m,
        dt=float(rows["transmissibility"][0]) if measured else math.nan,
        phase_rad=float(rows["phase"][0]) if measured else math.nan,
        impacts_per_cycle=float(rows["impacts_per_cycle"][0]) if measured else math.nan,
        regime=rows["regime"][0].decode() if measured else "",
        period=float(rows["period"][0]) if measured else math.nan,
        predicted_dt=float(predicted.dt[stable[0]]) if len(stable) else math.nan,
        predicted_phase_rad=float(predicted.phase_rad[stable[0]]) if len(stable) else math.nan,
    )


def main() -> int:
    """Measure, print and, if requested, draw; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draw", action="store_true", help="draw docs/images/prediction.png")
    arguments = parser.parse_args()
    jobs = [job(frequency, gap * 1e-3) for frequency in FREQUENCIES_HZ for gap in sorted(GAPS_MM)]
    by_key = {one.key: compared(one, outcome) for one, outcome in in_parallel(execute, jobs)}
    found = [by_key[one.key] for one in jobs]
    bad = sum(_tell(one) for one in found)
    for frequency in FREQUENCIES_HZ:
        branch = prediction.branch(RigConfig(), frequency, current_a=CURRENT_A)
        best = prediction.best_gap(branch)
        tell(
            f"{frequency:g} Hz: ends at {prediction.widest_gap_m(branch) * 1e3:.2f} mm, "
            f"smallest DT {best.dt[0]:.2f} at {best.gap_m[0] * 1e3:.2f} mm"
        )
    if arguments.draw:
        draw(found)
    tell(f"{bad} points differ from their prediction by more than {WITHIN:.0%} or {WITHIN_DEGREES:g}°")
    return 1 if bad else 0


def tell(text: str) -> None:
    """Print a line."""
    print(text, flush=True)  # noqa: T201  # a command line tool talks


def _tell(one: Compared) -> bool:
    """Print a line; return whether a measurement contradicts its prediction."""
    deviation = one.predicted_dt / one.dt - 1.0
    turn = math.degrees(one.predicted_phase_rad - one.phase_rad)
    bad = one.predicted and not (one.two_per_cycle and abs(deviation) <= WITHIN and abs(turn) <= WITHIN_DEGREES)
    word = "  TOO FAR" if bad else "  not symmetric" if one.two_per_cycle and not one.predicted else ""
    found = f"predicted {one.predicted_dt:7.3f}  {100.0 * deviation:+6.2f} % {turn:+6.2f}°"
    tell(
        f"{one.frequency_hz:4.1f} Hz {one.gap_m * 1e3:5.1f} mm  measured {one.dt:7.3f} {one.impacts_per_cycle:5.2f} "
        f"{one.regime:9}  {found if one.predicted else 'no stable symmetric motion predicted'}{word}"
    )
    return bad


def draw(found: Sequence[Compared]) -> None:
    """Draw DT and phase over the gap: lines are predicted or continued (dotted: unstable), points measured."""
    with style():
        figure, (upper, lower) = new_axes(5.2, (1.4, 1.0))
        for gap, dt, degrees, stable in continued():
            for line, which in (("-", stable), (":", ~stable)):
                for axis, height in ((upper, dt), (lower, degrees)):
                    axis.plot(gap, np.where(which, height, np.nan), line, color=INK, linewidth=0.8)
        for frequency, colour in zip(FREQUENCIES_HZ, SERIES, strict=False):
            branch = prediction.branch(RigConfig(), frequency, current_a=CURRENT_A)
            gap, degrees = branch.gap_m * 1e3, np.degrees(branch.phase_rad)
            for mask, line in ((branch.stable, "-"), (~branch.stable, ":")):
                label = f"{frequency:g} Hz" if line == "-" else None
                upper.plot(gap, np.where(mask, branch.dt, np.nan), line, color=colour, label=label)
                lower.plot(gap, np.where(mask, degrees, np.nan), line, color=colour)
            own = [one for one in found if one.frequency_hz == frequency]
            for symmetric, marker in ((True, "o"), (False, "x")):
                at = [one for one in own if (one.two_per_cycle and one.predicted) == symmetric]
                x = [one.gap_m * 1e3 for one in at]
                for axis, y in ((upper, [a.dt for a in at]), (lower, [math.degrees(a.phase_rad) for a in at])):
                    axis.plot(x, y, marker, color=colour, fillstyle="none", markersize=4)
        upper.set(ylabel="DT", ylim=(0, None), xlim=(FROM_MM, TO_MM))
        lower.set(xlabel="gap (mm)", ylabel="phase (°)")
        upper.set_title("Two symmetric impacts per cycle", loc="left")
        for marker, label in MARKS:
            upper.plot([], [], marker, color="0.3", fillstyle="none", label=label)
        upper.plot([], [], "-", color=INK, linewidth=0.8, label="continued from the model")
        legend_below(lower, 3, upper)
        figure.savefig(PICTURE, dpi=130, facecolor="white")


def continued(points: int = 200, workers: int | None = None) -> list[tuple[NDArray[np.generic], ...]]:
    """Return gap [mm], DT, phase [°] and stability along motions that do not strike twice per cycle."""
    what = {"over": GAP, "low": FROM_MM * 1e-3, "high": TO_MM * 1e-3, "start": "left", "points": points}
    tasks = [
        StudyTask(
            kind=CONTINUE, name="", changes={}, settings=Settings(), frequency_hz=frequency, current_a=CURRENT_A,
            what={**what, "value": gap * 1e-3},
        )
        for frequency in FREQUENCIES_HZ
        for gap in CONTINUED_MM
    ]  # fmt: skip
    plan = Plan(kind=CONTINUE, title="", base=RigConfig(), text="", over=GAP, tasks=tuple(tasks))
    found = []
    for _, rows in in_parallel(run, tasks, workers):
        (gap, dt, stable), (_, phase, _) = (figures.along(plan, rows, name) for name in ("dt", "phase_rad"))
        found.append((gap * 1e3, dt, np.degrees(phase), stable))
    return found


MARKS = ((":", "predicted, unstable"), ("o", "measured, symmetric"), ("x", "measured, other"))

if __name__ == "__main__":
    sys.exit(main())
