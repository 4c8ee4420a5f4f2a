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
"""Drop test of a recorded run: the coefficient of restitution from the heights noted by the operator."""

from __future__ import annotations

import math

import numpy as np

from impact_rig.errors import ConfigError, RecordingError
from impact_rig.recording import Run
from impact_rig.runs.reanalysis import remarks
from impact_rig.states import Status
from impact_rig_studies.decay import DropHeights, DropTest, parse_drop, restitution_of_drops


def drops_of(run: Run, u_m: float) -> tuple[list[DropHeights], DropTest]:
    """Return the drops noted in the remarks of a run, and the mean coefficient of restitution from their heights.

    `decay.parse_drop` states the form of such a remark.

    Args:
        run: an open run.
        u_m: standard uncertainty of each height [m].

    Raises:
        RecordingError: no remark states a drop (the message shows an example), or the heights give no restitution.
        ConfigError: `u_m` is negative or not finite.
    """
    if not 0.0 <= u_m < math.inf:
        raise ConfigError(f"u_m, the standard uncertainty of a height, must be >= 0 m and finite, got {u_m:g}")
    drops = [drop for drop in map(parse_drop, remarks(run)) if drop is not None]
    if not drops:
        raise RecordingError(
            f"{run.path}: no remark on the topic `notes` states the heights of a drop and its rebound in metres, like "
            f"{DropHeights(0.2, 0.0245).text()!r}; publish one for each drop while recording"
        )
    found = restitution_of_drops(np.array([one.h0_m for one in drops]), np.array([one.h1_m for one in drops]), u_m, u_m)
    if found.status is not Status.OK:
        rule = "every height must be finite and > 0 m"
        wrong = next((one for one in drops if not (0.0 < one.h0_m < math.inf and 0.0 < one.h1_m < math.inf)), None)
        if wrong is None:
            rule = "no rebound may be higher than its drop by over three standard uncertainties of their difference"
            wrong = max(drops, key=lambda one: one.h1_m - one.h0_m)
        raise RecordingError(
            f"{run.path}: the drops noted in it ({len(drops)}) give no coefficient of restitution: {rule}, got "
            f"{wrong.text()!r}; record the drops again"
        )
    return drops, found
