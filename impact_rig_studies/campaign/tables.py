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
"""Tables of a study's results as columns, data frames and datasets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import RecordingError
from impact_rig.system import extras


def by_columns(names: Sequence[str], rows: Sequence[Sequence[object]]) -> dict[str, NDArray[np.generic]]:
    """Convert a table to one array per column, by name; a column with at least one text becomes an array of texts.

    Missing numbers must be NaN, not None.

    Raises:
        RecordingError: the table is empty.
    """
    if not rows:
        raise RecordingError("nothing was measured yet, so there is nothing to export: run the campaign or study first")
    found: dict[str, NDArray[np.generic]] = {}
    for name, cells in zip(names, zip(*rows, strict=True), strict=True):
        texts = any(isinstance(cell, str) for cell in cells)
        found[name] = np.array([str(cell) for cell in cells] if texts else cells)
    return found


def to_dataframe(names: Sequence[str], rows: Sequence[Sequence[object]]) -> Any:
    """Convert a table, given by its column names and rows, to a `pandas.DataFrame`.

    Raises:
        ImpactRigError: pandas is not installed, or the table is empty.
    """
    pandas = extras.load("pandas", "to_dataframe()", "tables")
    return pandas.DataFrame(by_columns(names, rows))


def to_xarray(
    names: Sequence[str], rows: Sequence[Sequence[object]], *, grid: Sequence[str] = (), coordinates: Sequence[str] = ()
) -> Any:
    """Convert a table to an `xarray.Dataset`.

    Grid points without a row are NaN, or empty in columns of texts.

    Args:
        names: names of the columns.
        rows: rows of the table.
        grid: columns that become the dimensions. If several rows have the same values in these columns, the last row is
            used. Empty means that the only dimension is `row`.
        coordinates: columns that become coordinates along `row`, if the table has them; ignored if there is a grid.

    Raises:
        ImpactRigError: xarray is not installed, or the table is empty.
    """
    xarray = extras.load("xarray", "to_xarray()", "tables")
    columns = by_columns(names, rows)
    if not grid:
        along = {name: ("row", columns.pop(name)) for name in coordinates if name in columns}
        return xarray.Dataset({name: ("row", column) for name, column in columns.items()}, along)
    axes, order = {}, []
    for name in grid:
        axes[name], places = np.unique(columns.pop(name), return_inverse=True)
        order.append(places)
    shape = tuple(map(len, axes.values()))
    variables = {name: (list(grid), _spread(column, tuple(order), shape)) for name, column in columns.items()}
    return xarray.Dataset(variables, axes)


def _spread(
    column: NDArray[np.generic], order: tuple[NDArray[np.intp], ...], shape: tuple[int, ...]
) -> NDArray[np.generic]:
    """Return a column as an array over a grid; grid points without a row are NaN, or empty in a column of texts.

    `order` has one array per dimension, with the index of each row's grid point.
    """
    filler: object = "" if column.dtype.kind == "U" else np.nan
    found = np.full(shape, filler, column.dtype if column.dtype.kind == "U" else float)
    found[order] = column
    return found
