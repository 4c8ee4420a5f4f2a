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
"""The paper's published results, and the same quantities from measurements (`Reductions`).

Source: `TITLE` by `AUTHORS`. No DOI of it was found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.uncertainty_budget import combined
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig_studies.operate.plans import SweepPlan
from impact_rig_studies.reduction import reduction

TITLE = "Modeling of an impact damper submitted to forced vibration from a nonlinear contact force model"
AUTHORS = "Marcos Vieira de Albuquerque, Robson Pederiva"
AFFILIATION = "University of Campinas, School of Mechanical Engineering, Brazil"
DOI = ""  # none was found

FREQUENCY_HZ = 9.1  # frequency at which the paper compares the gaps: the natural frequency it prints

FREQUENCIES_HZ = SweepPlan().frequencies_hz  # the paper's excitation frequencies

CURRENT_A = SweepPlan().current_a
"""Constant coil current of the paper's runs, peak [A]. The paper does not print it; it was chosen to match its results.

The superior base then moves about 5.85 mm at 9.1 Hz without the sphere.
"""

REDUCTION_PERCENT: Mapping[float, float] = {2e-3: 29.4, 4e-3: 38.5, 6e-3: 43.0, 8e-3: 45.0, 10e-3: 49.0}
"""Published reduction of the transmissibility at 9.1 Hz compared with the run without the sphere, by gap [m]."""
POINTS_LIMIT, RMS_LIMIT = 2.0, 1.0
"""Largest allowed difference from the paper's reductions in percentage points: for each, and as rms of all five."""
DEMO_POINTS_LIMIT = 3.0  # as POINTS_LIMIT, for the demo, which measures each case only twice


@attrs.frozen
class Reductions:
    """Reductions of the transmissibility DT by gap [m], at one drive frequency, in percent of DT without the sphere.

    The paper compares at `FREQUENCY_HZ`.
    """

    dt_no_sphere: float  # transmissibility without the sphere
    dt: Mapping[float, float]  # DT by gap
    dt_uncertainty: Mapping[float, float]  # standard uncertainty of DT by gap; key `NO_SPHERE`: without the sphere
    percent_uncertainty: Mapping[float, float]
    """Standard uncertainty of the reduction (`percent`) in percentage points, by gap [m]."""

    @classmethod
    def of(cls, rows: Mapping[float, NDArray[np.void]], calibration: Calibration) -> Reductions:
        """Compute the reductions from measurements.

        If the measurement without the sphere is missing, there are no reductions, `dt_no_sphere` is NaN, and `dt` is
        empty.

        Args:
            rows: settled rows of `transmissibility/table` by gap, at least one for each; key `NO_SPHERE` means without
                the sphere.
            calibration: calibration of the instruments of all measurements.
        """
        without = rows.get(NO_SPHERE)
        if without is None:
            return cls(math.nan, {}, {NO_SPHERE: math.nan}, {})
        gaps = [gap for gap in rows if gap != NO_SPHERE]
        return cls(
            dt_no_sphere=float(np.mean(without["transmissibility"])),
            dt={gap: float(np.mean(rows[gap]["transmissibility"])) for gap in gaps},
            dt_uncertainty={gap: combined(found) for gap, found in rows.items()},
            percent_uncertainty={gap: reduction(without, rows[gap], calibration).u_points for gap in gaps},
        )

    def percent(self) -> dict[float, float]:
        """Return the measured reductions 100 (1 − DT / DT without sphere) [%], by gap [m]."""
        return {gap: 100.0 * (1.0 - value / self.dt_no_sphere) for gap, value in self.dt.items()}

    def errors(self) -> dict[float, float]:
        """Return the measured reductions minus the paper's, in percentage points, by gap [m].

        Only gaps that are both in the paper and measured are contained.
        """
        ours = self.percent()
        return {gap: ours[gap] - paper for gap, paper in REDUCTION_PERCENT.items() if gap in ours}

    def max_abs_error(self) -> float:
        """Return the largest absolute value of `errors` in percentage points; NaN if there are none."""
        return max((abs(error) for error in self.errors().values()), default=math.nan)

    def rms_error(self) -> float:
        """Return the root mean square of `errors` in percentage points; NaN if there are none."""
        errors = list(self.errors().values())
        return math.sqrt(sum(error**2 for error in errors) / len(errors)) if errors else math.nan

    def grows_with_gap(self) -> bool:
        """Return whether every gap has a larger reduction than the next smaller gap; also true for one gap or none."""
        ordered = [value for _, value in sorted(self.percent().items())]
        return all(a < b for a, b in itertools.pairwise(ordered))
