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
"""Output directory of a map: read its stored lines as arrays, and write its results.

In addition to the files of `impact_rig_studies.campaign.tasks.TaskStore` (plan, rig and measured lines) it contains:

| file | content |
|---|---|
| `map.csv` | one row per measured point and direction |
| `map.json` | summary for programs: number of points, counts of regimes, the optimum if it was searched for |
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.system import files
from impact_rig_studies.campaign import tables
from impact_rig_studies.campaign.plan import STARTS
from impact_rig_studies.campaign.tasks import TaskStore
from impact_rig_studies.maps.measure import Reading
from impact_rig_studies.maps.plan import DOWN, POSITION, RESET, SPEED, UP, MapLine, MapPlan, load_map

CSV_FILE, JSON_FILE = "map.csv", "map.json"


@attrs.frozen(eq=False, kw_only=True)
class FinishedMap:
    """Map with the results that are stored in its output directory; points may be missing."""

    plan: MapPlan  # definition of the map
    directory: Path  # output directory
    values: dict[str, dict[str, NDArray[np.generic]]]
    """Arrays of the results, first by layer (direction or start, see `MapPlan.layers`), then by field of `Reading`.

    The dimensions of an array are the axes of the plan in their order. Points that are not measured are NaN, or "" for
    the regime.
    """

    def to_dataframe(self) -> Any:
        """Return the stored results as a `pandas.DataFrame` with the rows and columns of `map.csv`.

        Failed points are included.

        Raises:
            ImpactRigError: pandas is not installed, or no point is measured yet.
        """
        return tables.to_dataframe(*table(self))

    def to_xarray(self) -> Any:
        """Return the map as an `xarray.Dataset` whose dimensions are its axes and `direction`.

        If the plan lists starts of the sphere, the last dimension is `start` instead of `direction`. Points that are
        not measured are NaN, or empty for texts. Values of an axis without any measured point are left out.

        Raises:
            ImpactRigError: xarray is not installed, or no point is measured yet.
        """
        names, rows = table(self)
        layers = "start" if self.plan.starts else "direction"
        return tables.to_xarray(names, rows, grid=(*self.plan.axes, layers))


def store(directory: str | Path) -> TaskStore[MapLine]:
    """Return the store of a map's measured lines in its output directory, without creating files."""
    return TaskStore(Path(directory), "map", "lines", ("maps",))


def finished(plan: MapPlan, directory: str | Path) -> FinishedMap:
    """Return a map with the results that are already stored in its output directory.

    Points without valid results are NaN ("" for the regime). Damaged results, and results of other versions of the
    code, are not valid.
    """
    kept = store(directory)
    shape, names = tuple(map(len, plan.axes.values())), list(plan.axes)
    values: dict[str, dict[str, NDArray[np.generic]]] = {}
    for line in plan.lines():
        if line.direction not in values:
            values[line.direction] = {
                name: np.full(shape, "", "U12") if name == "regime" else np.full(shape, math.nan)
                for name in Reading._fields
            }
        readings = kept.get(line)
        if readings is None:
            continue
        place = tuple(slice(None) if name == line.along else plan.axes[name].index(line.held[name]) for name in names)
        ordered = readings[::-1] if line.direction == DOWN else readings
        for i, name in enumerate(Reading._fields):
            values[line.direction][name][place] = [reading[i] for reading in ordered]
    return FinishedMap(plan=plan, directory=kept.directory, values=values)


def open_map(directory: str | Path) -> FinishedMap:
    """Read a map with its stored results from the output directory of `impact-rig map`, without simulating anything.

    Points without valid results are NaN ("" for the regime). Damaged results, and results of other versions of the
    code, are not valid.

    Raises:
        ConfigError: the directory contains no map, or the plan or configuration of the map is invalid.
    """
    kept = store(directory)
    return finished(load_map(kept.file, resolved=kept.configuration()), directory)


def write_results(done: FinishedMap, more: dict[str, object]) -> None:
    """Write `map.csv` and `map.json` to the output directory of a map, replacing existing files of these names.

    Args:
        done: the map with its results.
        more: further entries of `map.json`, such as the optimum; they replace standard entries of the same name.
    """
    files.write_csv(done.directory / CSV_FILE, *table(done))
    regimes = {
        layer: dict(sorted(Counter(str(word) for word in values["regime"].ravel() if word).items()))
        for layer, values in done.values.items()
    }
    content = {"title": done.plan.title, "points": done.plan.points, "measured_on": "mechanics", "regimes": regimes}
    files.write_text(done.directory / JSON_FILE, json.dumps({**content, **more}, indent=2) + "\n")


def table(done: FinishedMap) -> tuple[list[str], list[list[object]]]:
    """Return a map as a table: the names of its columns, and one row for each simulated point of each layer.

    A layer is a direction or a start of the sphere. Points whose motion could not be simulated have a row with the
    regime `failed`. The columns are the axes, `direction` (up, down or reset), `start` (start of the sphere, unless an
    axis sets it), and the fields of `Reading`.
    """
    first = next(iter(done.values))
    return [*done.plan.axes, *_layer(done.plan, first), *done.values[first]], list(_rows(done))


def _layer(plan: MapPlan, layer: str) -> dict[str, str]:
    """Return the values of the columns `direction` and `start` for a layer of a map.

    A layer is a direction or a start of the sphere, see `MapPlan.layers`. A direction has the `start` of the plan's
    rig, and a start has the `direction` reset. The column `start` is left out if an axis sets the start of the sphere.
    """
    found = {"direction": layer if layer in (UP, DOWN) else RESET}
    if not {POSITION, SPEED} & set(plan.axes):
        found["start"] = layer if layer in STARTS else plan.base.sphere.start
    return found


def _rows(done: FinishedMap) -> Iterable[list[object]]:
    axes = list(done.plan.axes.values())
    for layer, values in done.values.items():
        front = _layer(done.plan, layer).values()
        for place in np.ndindex(*map(len, axes)):
            if not values["regime"][place]:
                continue
            cells = [array[place].item() for array in values.values()]
            yield [*(axis[i] for axis, i in zip(axes, place, strict=True)), *front, *cells]
