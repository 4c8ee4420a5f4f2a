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
"""Exporters of the tables of campaigns, maps and dynamics studies, for `impact-rig export`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import RecordingError
from impact_rig_studies.campaign.results import Point, table
from impact_rig_studies.campaign.run import CAMPAIGN_FILE, open_finished
from impact_rig_studies.campaign.tables import by_columns
from impact_rig_studies.dynamics import plan as dynamics
from impact_rig_studies.maps import run as maps

POINTS = "points"
Columns = dict[str, NDArray[np.generic]]
Tables = Mapping[str, Callable[[str], Columns]]
"""Name of a table -> function that reads the table and returns its columns by name.

The function receives the suffix of the file to write, such as `.csv`.
"""


def map_points(directory: Path) -> Tables | None:
    """Return the map in a directory as the table `points`; None if the directory contains no map.

    The map is read only when the returned function is called (see `Tables`).
    """
    if not maps.store(directory).file.exists():
        return None
    return {POINTS: lambda _suffix: by_columns(*maps.table(maps.open_map(directory)))}


def study_rows(directory: Path) -> Tables | None:
    """Return the tables of the dynamics studies in a directory, by kind of study.

    Only kinds with results are contained. If there is only one kind, its table is also contained as `points`. The
    result is None if the directory contains no dynamics studies.
    """
    if not dynamics.store(directory).file.exists():
        return None

    def of(kind: str) -> Callable[[str], Columns]:
        return lambda _suffix: by_columns(*dynamics.open_study(directory, kind).table())

    found = {kind: of(kind) for kind in dynamics.kinds(directory)}
    return {**found, POINTS: next(iter(found.values()))} if len(found) == 1 else found


def campaign_points(directory: Path) -> Tables | None:
    """Return the campaign in a directory as the table `points`; None if the directory contains no campaign.

    The columns depend on the suffix of the file to write. A universal file (`.uff`) has the columns of curves of DT
    over frequency. All other files have the columns of `points.csv`.
    """
    if not (directory / CAMPAIGN_FILE).exists():
        return None

    def columns(suffix: str) -> Columns:
        points = open_finished(directory).points
        return _response(points) if suffix == ".uff" else by_columns(*table(points))

    return {POINTS: columns}


def _response(points: Sequence[Point]) -> dict[str, NDArray[np.generic]]:
    """Return the settled points as columns for a universal file: magnitude and phase [rad] of X_1/X_b over frequency.

    The column `curve` contains the name of the curve to which each point belongs. Each combination of study, gap,
    direction, current and further axes is a curve.

    Raises:
        RecordingError: no point is settled.
    """
    settled = [point for point in points if point.settled]
    if not settled:
        raise RecordingError(
            "no point of this campaign has a settled measurement, so a .uff file has no curve of DT over frequency; "
            "points.csv lists the status of each point"
        )
    one_current = len({point.current_a for point in points}) == 1
    return {
        "frequency": np.array([point.frequency_hz for point in settled]),
        "transmissibility": np.array([point.dt for point in settled]),
        "phase": np.array([point.phase_rad for point in settled]),
        "curve": np.array([
            ", ".join([
                point.study, point.label, point.direction, *([] if one_current else [f"{point.current_a:g} A"]),
                *(f"{name.rpartition('.')[2]} {value}" for name, value in point.axes.items()),
            ])
            for point in settled
        ]),
    }  # fmt: skip
