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
"""Exporters of the points of a campaign and of a map, for `impact-rig export`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import RecordingError
from impact_rig_studies.campaign.results import Point, table
from impact_rig_studies.campaign.run import CAMPAIGN_FILE, open_finished
from impact_rig_studies.maps import run as maps

Columns = dict[str, NDArray[np.generic]]


def map_points(directory: Path) -> Callable[[str], Columns] | None:
    """Return what gives the points of a map by columns; None: the directory is of something else."""
    if not maps.store(directory).file.exists():
        return None
    return lambda _suffix: _columns(*maps.table(maps.open_map(directory)))


def campaign_points(directory: Path) -> Callable[[str], Columns] | None:
    """Return what gives the points of a campaign by columns; None: the directory is of something else."""
    if not (directory / CAMPAIGN_FILE).exists():
        return None

    def columns(suffix: str) -> Columns:
        points = open_finished(directory).points
        by_name = _columns(*table(points))
        return _response(points) if suffix == ".uff" else by_name

    return columns


def _columns(names: Sequence[str], rows: Sequence[Sequence[object]]) -> dict[str, NDArray[np.generic]]:
    """Return a table by columns: numbers, or texts where a column has any."""
    if not rows:
        raise RecordingError("nothing was measured yet: there is no point to export")
    found: dict[str, NDArray[np.generic]] = {}
    for name, cells in zip(names, zip(*rows, strict=True), strict=True):
        texts = any(isinstance(cell, str) for cell in cells)
        found[name] = np.array([str(cell) for cell in cells] if texts else cells)
    return found


def _response(points: Sequence[Point]) -> dict[str, NDArray[np.generic]]:
    """Return settled points as a universal file has them: X_1/X_b over the frequency, a function per curve."""
    settled = [point for point in points if point.settled]
    if not settled:
        raise RecordingError("no point of this campaign is settled: there is no curve to export")
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
