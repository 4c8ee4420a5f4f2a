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
"""Reader of MATLAB files of versions 5 to 7.3: vectors, matrices and structs."""

from __future__ import annotations

import io
from pathlib import Path
from types import ModuleType
from typing import Any  # nested arrays of SciPy and objects of h5py

import numpy as np

from impact_rig.errors import RecordingError
from impact_rig_studies.importing.columns import signals_of
from impact_rig_studies.importing.headings import is_time_name, rate_hz
from impact_rig_studies.importing.limits import COLUMNS, check_column_count
from impact_rig_studies.importing.readers import hdf5
from impact_rig_studies.importing.signals import ImportedSignals, Signal, UniqueNames, reasons

CONVERSIONS = {
    "timetable": "S = table2struct(timetable2table(X), 'ToScalar', true); S.time = seconds(X.Properties.RowTimes); "
    "save('plain.mat', '-struct', 'S', '-v7')",
    "table": "S = table2struct(X, 'ToScalar', true); save('plain.mat', '-struct', 'S', '-v7')",
    "timeseries": "S.time = X.Time; S.data = X.Data; save('plain.mat', '-struct', 'S', '-v7')",
}
"""Line of MATLAB code that saves an object X as a file without objects, by class of the object, for messages."""
OTHER_CONVERSION = "S = struct(X); save('plain.mat', '-struct', 'S', '-v7')"
DEEPEST = 6

Tables = dict[str, dict[str, Any]]  # columns by name, by the path of their struct


def read_5(path: Path, content: bytes, library: ModuleType) -> ImportedSignals:
    """Read the arrays in a MATLAB file of version 5 to 7 as signals; `library` is `scipy.io`.

    The result has no signals if the file has no variables, or only empty variables.

    Raises:
        RecordingError: the file has variables that are not empty, but no vector or matrix of numbers.
        BudgetError: there are too many columns.
    """
    found = library.loadmat(io.BytesIO(content), struct_as_record=True)
    left_out: dict[str, str] = {}
    tables: Tables = {}
    for name, value in found.items():
        if not name.startswith("__"):
            _collect(tables, left_out, "", name, value, 0)
    return _signals(path, "MATLAB 5", tables, left_out)


def read_7_3(path: Path, content: bytes, library: ModuleType) -> ImportedSignals:
    """Read the arrays in a MATLAB file of version 7.3, which is HDF5, as signals; `library` is h5py.

    Raises:
        RecordingError: as `read_5`, or an array is kept outside the file.
        BudgetError: the arrays have more values than a file of this size may contain, or there are too many columns.
    """
    tree = hdf5.Hdf5Tree(library, len(content))
    tables: Tables = {}
    with tree.open(content) as file:
        _collect_hdf5(tree, tables, "", file, 0)
    return _signals(path, "MATLAB 7.3", tables, tree.left_out)


def _object_reason(name: str, kind: str) -> str:
    line = CONVERSIONS.get(kind, OTHER_CONVERSION).replace("X", name if name.isidentifier() else "X")
    return f"an object of class {kind or 'unknown'}, which only MATLAB opens: {line}"


def _collect(tables: Tables, left_out: dict[str, str], where: str, name: str, value: Any, depth: int) -> None:
    """Add a variable to `tables` as a column of the struct `where`, or to `left_out` with the reason.

    The fields of a struct are added recursively. Empty variables are ignored. `depth` is the number of structs and
    cells around the variable. Structs at the depth `DEEPEST` are left out.
    """
    shown = f"{where}.{name}" if where else name
    if hasattr(value, "toarray"):
        left_out[shown] = "a sparse matrix"
        return
    array = np.asarray(value)
    names = array.dtype.names
    if type(value).__name__ in ("MatlabOpaque", "MatlabObject", "MatlabFunction"):
        kind = str(getattr(value, "classname", ""))
        if names and "s2" in names and array.size:
            kind = str(array.reshape(-1)[0]["s2"]).strip("b'\"")
            variable = str(array.reshape(-1)[0]["s0"]).strip("b'\"")
            name = variable or name
        left_out[name if name != "None" else "object"] = _object_reason(name, kind)
    elif names:
        if depth >= DEEPEST:
            left_out[shown] = "a struct nested too deeply"
            return
        elements = array.reshape(-1)
        check_column_count(len(elements) * len(names))
        for number, element in enumerate(elements):
            place = shown if len(elements) == 1 else f"{shown}({number + 1})"
            for field in names:
                _collect(tables, left_out, place, field, element[field], depth + 1)
    elif array.dtype.kind == "O":
        if array.size == 1 and depth < DEEPEST and isinstance(array.reshape(-1)[0], np.ndarray):
            _collect(tables, left_out, where, name, array.reshape(-1)[0], depth + 1)
        elif array.size:
            left_out[shown] = "a cell array: save its columns as vectors"
    elif array.size:
        tables.setdefault(where, {})[name] = array


def _collect_hdf5(tree: hdf5.Hdf5Tree, tables: Tables, where: str, group: Any, depth: int) -> None:
    """Add the numbers and texts in an HDF5 group to `tables`, as columns of the struct `where`.

    Groups within the group are added recursively. `depth` is the number of groups around it. Objects, cell arrays,
    complex numbers and structs at the depth `DEEPEST` are noted in `tree.left_out`. Texts of more than `COLUMNS`
    characters are dropped without a note.
    """
    for name, one in tree.members(group):
        if name.startswith("#"):  # internal data of MATLAB
            continue
        shown = f"{where}.{name}" if where else name
        kind = str(hdf5.attribute(one, "MATLAB_class") or "")
        if hdf5.attribute(one, "MATLAB_object_decode") is not None:
            tree.left_out[shown] = _object_reason(name, kind)
        elif not hasattr(one, "shape"):
            if depth >= DEEPEST:
                tree.left_out[shown] = "a struct nested too deeply"
            else:
                _collect_hdf5(tree, tables, shown, one, depth + 1)
        elif kind == "cell" or one.dtype.kind == "O":
            tree.left_out[shown] = "a cell array: save its columns as vectors"
        elif hdf5.attribute(one, "MATLAB_empty"):
            continue
        elif kind == "char":
            values = tree.array(shown, one)
            if values is not None and values.size <= COLUMNS:
                text = "".join(map(chr, values.reshape(-1).tolist()))
                tables.setdefault(where, {})[name] = np.array([text])
        else:
            values = tree.array(shown, one)
            if values is not None and values.dtype.names == ("real", "imag"):
                tree.left_out[shown] = "complex numbers: a spectrum or frequency response"
            elif values is not None and values.size:
                tables.setdefault(where, {})[name] = values.T


def _signals(path: Path, file_format: str, tables: Tables, left_out: dict[str, str]) -> ImportedSignals:
    """Return the columns of all structs as signals.

    A struct without times and rate uses the times or the rate of the structs around it.

    Raises:
        RecordingError: there are no signals, but variables were left out; the message names these variables.
    """
    parts: dict[str, ImportedSignals] = {}
    for where, columns in tables.items():
        inherited = {
            name: value
            for outer in _outer(where)
            for name, value in tables.get(outer, {}).items()
            if _is_axis(name, value) and not any(_is_axis(own, one) for own, one in columns.items())
        }
        parts[where] = signals_of(path, file_format, {**inherited, **columns})
    with_signals = [where for where, part in parts.items() if part.signals]
    signals: dict[str, Signal] = {}
    texts: dict[str, list[str]] = {}
    names = UniqueNames()
    for where, part in parts.items():
        prefix = f"{where}." if where and len(with_signals) > 1 else ""
        for name, one in part.signals.items():
            signals[names.unique(prefix + name)] = one
        for name, why in part.left_out.items():
            left_out[f"{where}.{name}" if where else name] = why
        texts |= part.texts
    if not signals and left_out:
        raise RecordingError(
            f"{path}: no variable of this MATLAB file can be read: {reasons(left_out)}; save the signals as vectors"
        )
    start_ns = next((part.start_ns for part in parts.values() if part.start_ns is not None), None)
    remarks = tuple(dict.fromkeys(one for part in parts.values() for one in part.remarks))
    return ImportedSignals(path, file_format, signals, start_ns, texts, left_out, remarks)


def _outer(where: str) -> list[str]:
    """Return the dotted paths of the structs around the struct `where`, outermost first.

    The first path is empty and means the file itself. The list is empty if `where` is the file itself.
    """
    parts = where.split(".") if where else []
    return ["", *(".".join(parts[:number]) for number in range(1, len(parts)))] if parts else []


def _is_axis(name: str, value: Any) -> bool:
    return is_time_name(name) if np.size(value) > 1 else rate_hz(name, 1.0) is not None
