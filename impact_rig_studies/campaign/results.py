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
"""Points of a campaign, and the file `summary.json`.

A point has its measurements, or the reason why it has none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

import impact_rig
from impact_rig.analysis.transmissibility import note_on
from impact_rig.analysis.uncertainty_budget import combined
from impact_rig.config.tree import Value
from impact_rig.rig.gaps import NO_SPHERE, case_of
from impact_rig.system import files
from impact_rig_studies.campaign.job import Outcome
from impact_rig_studies.campaign.paper import REDUCTION_PERCENT, Reductions
from impact_rig_studies.campaign.plan import RESET, Planned
from impact_rig_studies.operate.plans import Direction

NAN = math.nan
SKIPPED = "over_range"  # failure of a point that was skipped because a sensor was over range
NOT_REACHED = "not reached"  # failure of a point after the end of its sweep
IMPACTING = 0.1
"""Smallest number of impacts per cycle of an impacting orbit; fewer may be stray impacts in the measurement."""


@attrs.frozen(eq=False, kw_only=True)
class Point:
    """Result at one drive frequency of a job; values that were not measured are NaN."""

    study: str
    axes: Mapping[str, Value]  # values of the study's axes other than frequency, gap and current, by dotted name
    reference: bool  # whether it has the reference rig and current, after a reset: the paper's statements use it
    gap_m: float  # gap, or `NO_SPHERE`
    current_a: float
    frequency_hz: float
    direction: str  # `reset`: the rig was reset before this frequency; `up` or `down`: part of a sweep without reset
    rows: NDArray[np.void]
    """Measurements at this point, settled or not: rows of `transmissibility/table`, shape (n,)."""
    failure: str  # why measurements are missing or did not settle; empty if all settled
    key: str  # key of the job that measured it

    def _mean(self, column: str) -> float:
        return float(np.mean(self.rows[column])) if len(self.rows) else NAN

    @property
    def settled(self) -> bool:
        """Return whether the point has all its planned measurements and all of them are settled."""
        return len(self.rows) > 0 and not self.failure

    @property
    def dt(self) -> float:
        """Transmissibility DT: mean of the point's measurements, settled or not; NaN without one."""
        return self._mean("transmissibility")

    @property
    def u_dt(self) -> float:
        """Standard uncertainty of `dt`: rms of the measurements' uncertainties (`combined`); NaN without one."""
        return combined(self.rows) if len(self.rows) else NAN

    @property
    def phase_rad(self) -> float:
        """Phase [rad] of x_1 relative to x_b in the first measurement, since a mean of angles may be meaningless."""
        return float(self.rows["phase"][0]) if len(self.rows) else NAN

    @property
    def base_m(self) -> float:
        """Peak amplitude of the inferior base at the drive frequency [m]: mean of the measurements, settled or not.

        NaN without a measurement, or if one of them is NaN.
        """
        return self._mean("base_amplitude")

    @property
    def laser_m(self) -> float:
        """Peak amplitude of the superior base at the drive frequency [m]: mean of the measurements, settled or not.

        NaN without a measurement, or if one of them is NaN.
        """
        return self._mean("laser_amplitude")

    @property
    def impacts_per_cycle(self) -> float:
        """Mean number of impacts per drive cycle in the accelerometer's signal, over the point's measurements.

        It is NaN without a measurement, or if impacts could not be counted. If the accelerometer was over range, the
        number may be wrong.
        """
        return self._mean("impacts_per_cycle")

    @property
    def impacts(self) -> bool:
        """Return whether the orbit counts as impacting: `IMPACTING` impacts per cycle or more; false for NaN."""
        return self.impacts_per_cycle >= IMPACTING

    @property
    def regime(self) -> str:
        """Regime of the response in the point's last measurement; empty without a measurement.

        It is periodic, modulated, chaotic, intermittent or unknown.
        """
        return str(self.rows["regime"][-1].decode()) if len(self.rows) else ""

    @property
    def status(self) -> str:
        """Reason why measurements are missing or did not settle (`failure`); if all settled, the last one's status."""
        return self.failure or str(self.rows["status"][-1].decode())

    @property
    def note(self) -> str:
        """Remark that a slow sphere could still strike, or an empty text.

        The remark exists only if the last measurement of the point has the status `no_impacts`.
        """
        return note_on(self.rows[-1]) if len(self.rows) else ""

    @property
    def label(self) -> str:
        """Gap as a text for the reader, such as `4 mm` or `no sphere`."""
        return case_of(self.gap_m).removeprefix("gap ")


def points_of(planned: Planned, outcome: Outcome) -> list[Point]:
    """Return one point for each frequency of a job, in the order of measurement.

    With the direction `up_down` each frequency has two points. Points without all their settled measurements state the
    reason as `failure`.
    """
    job = planned.job
    visits = job.plan().points()
    once = len(job.frequencies_hz)
    rows, taken = outcome.rows, 0
    skipped = list(outcome.skipped_hz)
    found = []
    for place, frequency in enumerate(visits):
        own = rows[taken : taken + job.repetitions]
        own = own[np.isclose(own["frequency"], frequency, rtol=1e-9, atol=0.0)]
        taken += len(own)
        unsettled = own["status"][own["settled"] != 1.0]
        failure = str(unsettled[0].decode()) if len(unsettled) else ""
        if len(own) < job.repetitions:  # some may have been measured before a sensor went over range
            failure = outcome.failure or NOT_REACHED
            if frequency in skipped:
                skipped.remove(frequency)
                failure = SKIPPED
        direction = RESET
        if once > 1 or place >= once:
            down = job.direction is Direction.DOWN or place >= once
            direction = Direction.DOWN.value if down else Direction.UP.value
        found.append(
            Point(
                study=planned.study,
                axes=planned.axes,
                reference=planned.reference and direction == RESET,
                gap_m=job.gap_m,
                current_a=job.current_a,
                frequency_hz=frequency,
                direction=direction,
                rows=own,
                failure=failure,
                key=job.key,
            )
        )
    return found


@attrs.frozen
class Curves:
    """Settled points of the reference rig at the reference current, one for each gap [m] and frequency [Hz].

    The reference rig and current are those of the first job in the campaign file (`Campaign.reference`). Points of
    sweeps without a reset are left out. If several studies have a settled point with the same gap and frequency, the
    point of the first study is kept.
    """

    by_gap: Mapping[float, Mapping[float, Point]]

    @classmethod
    def of(cls, points: Iterable[Point]) -> Curves:
        """Collect the settled points of the reference rig from all points of a campaign."""
        found: dict[float, dict[float, Point]] = {}
        for point in points:
            if point.reference and point.settled:
                found.setdefault(point.gap_m, {}).setdefault(point.frequency_hz, point)
        return cls(found)

    def at(self, gap_m: float, frequency_hz: float) -> Point | None:
        """Return the settled point with exactly this gap and frequency, or None if there is none."""
        return self.by_gap.get(gap_m, {}).get(frequency_hz)

    def frequencies(self, gap_m: float) -> list[float]:
        """Return the frequencies with a settled point for one gap, ascending."""
        return sorted(self.by_gap.get(gap_m, {}))

    def gaps(self) -> list[float]:
        """Return all gaps with a settled point, ascending; `NO_SPHERE` is left out."""
        return sorted(gap for gap in self.by_gap if gap != NO_SPHERE)


COLUMNS = (
    "study", "gap_m", "frequency_hz", "current_a", "direction", "transmissibility", "transmissibility_uncertainty",
    "phase_rad", "base_amplitude_m", "laser_amplitude_m", "impacts_per_cycle", "regime", "repetitions", "settled",
    "status", "reference", "key",
)  # fmt: skip


def table(points: Sequence[Point]) -> tuple[list[str], list[list[object]]]:
    """Return the points as a table: the names of the columns, and one row per point.

    The columns are `COLUMNS`, and then one for each further axis of the points' studies. Missing numbers are NaN, as is
    the gap of points without the sphere. An axis that a point's study does not have is an empty text.
    """
    axes = list(dict.fromkeys(name for point in points for name in point.axes))
    rows: list[list[object]] = [
        [
            p.study, NAN if p.gap_m == NO_SPHERE else p.gap_m, p.frequency_hz, p.current_a, p.direction,
            p.dt, p.u_dt, p.phase_rad, p.base_m, p.laser_m, p.impacts_per_cycle,
            p.regime, len(p.rows), int(p.settled), p.status, int(p.reference), p.key,
            *(p.axes.get(name, "") for name in axes),
        ]
        for p in points
    ]  # fmt: skip
    return [*COLUMNS, *axes], rows


# --- `summary.json` of a run or campaign directory: the figures that programs read

FILE_NAME = "summary.json"


@attrs.frozen
class Statement:
    """Result of judging a statement: whether it holds, the value that decides this, and the limit for that value."""

    passed: bool
    value: float
    limit: float


def write_summary(
    directory: Path,
    reductions: Reductions,
    statements: dict[str, Statement],
    *,
    lost_blocks: int,
    wall_s: float,
    simulated_s: float,
    seed: int,
    more: Mapping[str, object],
) -> dict[str, object]:
    """Write `summary.json`, the results of a campaign or demo for other programs, and return its content.

    `lost_blocks` is the number of blocks of scans that were lost. `wall_s` is the duration of this measurement by this
    machine's clock or, after an import, the length of the imported runs [s]. `simulated_s` is the simulated rig time of
    all results [s], also of results that were already stored. `seed` is the seed of the rig (`daq.seed`). `more` has
    further entries of the file, which replace entries of the same name.

    Raises:
        OSError: the file cannot be written.
    """
    content = {
        "version": impact_rig.__version__,
        "seed": seed,
        "dt_no_sphere": reductions.dt_no_sphere,
        "dt": _by_millimetre(reductions.dt),
        "reductions_percent": _by_millimetre(reductions.percent()),
        "reductions_uncertainty_points": _by_millimetre(reductions.percent_uncertainty),
        "paper_reductions_percent": _by_millimetre(REDUCTION_PERCENT),
        "max_abs_error_points": reductions.max_abs_error(),
        "rms_error_points": reductions.rms_error(),
        "statements": {
            name: {"pass": one.passed, "value": one.value, "limit": one.limit} for name, one in statements.items()
        },
        "lost_blocks": lost_blocks,
        "wall_s": wall_s,
        "simulated_s": simulated_s,
        **more,
    }
    files.write_json(directory / FILE_NAME, content)
    return content


def _by_millimetre(values: Mapping[float, float]) -> dict[str, float]:
    return {f"{gap * 1e3:g}": value for gap, value in values.items()}
