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
"""Export of table topics to CSV, NumPy's NPZ, Parquet, and universal files (dataset 58).

The columns are those of `impact_rig.recording.columns`: `time`, `timestamp` and `earlier`, then those of the table.
Numbers in CSV files read back to the same bits.

A universal file has one dataset 58b (binary, double precision) per numeric column: a time response over `time`. For a
table with frequency, transmissibility and phase, such as `transmissibility/table`, it also has complex frequency
response functions for modal analysis: one per gap, or one per text in a column `curve`.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.errors import RecordingError
from impact_rig.names import csv_cell, file_name, one_line
from impact_rig.recording.columns import EARLIER, TIME, Columns, batches, complete, first_scan_ns, is_earlier, leading
from impact_rig.recording.reader import Run
from impact_rig.runs import recorded_journal
from impact_rig.system import extras, files

CURVE = "curve"


def export(run: Run, topic: str, target: str | Path) -> Path:
    """Export a table topic, or the journal, of a run to a file.

    CSV and Parquet files are streamed; NPZ and UFF files are built in memory. Numbers in CSV files read back to the
    same bits. docs/reference/file_formats.md describes the columns.

    Args:
        run: an open run.
        topic: name of a topic that carries tables, such as `daq/scan`; or `rig/journal`, which gives a row per entry.
        target: new file; its suffix selects the format: .csv, .npz, .parquet or .uff.

    Returns:
        The path of the file.

    Raises:
        RecordingError: the suffix is unknown, or `target` exists or cannot be written. Or the topic was not recorded,
            has no messages (unless it is the journal), carries no tables, changes its columns, or has nothing that a
            UFF file can hold.
        ConfigError: an entry of the journal is invalid.
        ImpactRigError: a library is missing: pyarrow for Parquet, pyuff for UFF.

    Examples:
        >>> import impact_rig
        >>> rig = impact_rig.LocalRig()
        >>> rig.run(seconds=1)
        >>> with impact_rig.open_run(rig.save("exported")) as run:
        ...     file = impact_rig.export(run, "daq/scan", "scans.csv")
        >>> file.read_text().splitlines()[0]
        'time,timestamp,earlier,accelerometer,laser,base,current,status'

    See Also:
        - `Run` (`to_dataframe`, `to_xarray`): the same rows in memory.
    """
    return write_columns(lambda: _batches(run, topic), Path(target))


def write_columns(batches: Callable[[], Iterator[Columns]], target: Path) -> Path:
    """Write batches of columns to the new file `target`, in the format of its suffix, and return its path.

    `batches` is a function that returns the batches, all with the same columns. It is called once, after `target` has
    been checked.

    Raises:
        RecordingError: the suffix is unknown, or the file exists or cannot be written.
    """
    write = _WRITERS.get(target.suffix)
    if write is None:
        raise RecordingError(f"the name of the new file {target} must end in one of {', '.join(_WRITERS)}")
    kept = RecordingError(f"{target} exists already and is not overwritten; choose another name")
    if os.path.lexists(target):
        raise kept
    try:
        with files.atomic_write(target, replace=False) as file:
            write(file, batches())
    except RecordingError:
        raise
    except FileExistsError as error:
        raise kept from error
    except OSError as error:
        raise RecordingError(f"{target} cannot be written: {error.strerror}") from error
    return target


def _batches(run: Run, topic: str) -> Iterator[Columns]:
    """Yield the columns of a table topic, or of the journal, in batches of many messages."""
    if run.resolve(topic) == run.name(topics.JOURNAL):
        yield _journal_columns(run)
    else:
        yield from batches(run, topic)


def _journal_columns(run: Run) -> Columns:
    """Return the journal of a run as columns, one row per entry.

    `value` is a number, NaN without one. The columns `values` and `fault` hold JSON texts, which are empty if an entry
    has none.
    """
    found = [
        (is_earlier(run, message), entry)
        for message in run.messages([topics.JOURNAL.name], recorded_order=True)
        for entry in recorded_journal.entries(message)
    ]
    contents = [json.loads(entry.line()) for _, entry in found]
    texts = {
        name: [one if isinstance(one := content.get(name, ""), str) else json.dumps(one) for content in contents]
        for name in ("kind", "name", "text", "values", "fault")
    }
    stamps = np.array([entry.stamp_ns for _, entry in found], np.int64)
    origin_ns = first_scan_ns(run, topics.JOURNAL.name)
    return {
        **leading(stamps, np.zeros(len(found)), [one for one, _ in found], origin_ns),
        "sequence": np.array([entry.sequence for _, entry in found], np.int64),
        "sample": np.array([entry.sample for _, entry in found], np.int64),
        "value": np.array([math.nan if entry.value is None else entry.value for _, entry in found], np.float64),
        **{name: np.array(column, np.str_) for name, column in texts.items()},
    }


def _write_csv(file: BinaryIO, batches: Iterator[Columns]) -> None:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text)
    for number, columns in enumerate(batches):
        if number == 0:
            writer.writerow(map(csv_cell, columns))
        plain = [_plain(column) for column in columns.values()]
        cells = [column.tolist() for column in plain]
        texts = [column.dtype.kind == "U" for column in plain]
        shown = (map(csv_cell, column) if text else column for column, text in zip(cells, texts, strict=True))
        writer.writerows(zip(*shown, strict=True))
    text.detach()


def _plain(column: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a column as it is written to a CSV file: dates as ISO 8601 text to the nanosecond, others unchanged."""
    return np.datetime_as_string(column, unit="ns") if column.dtype.kind == "M" else column  # type: ignore[call-overload]


def _write_npz(file: BinaryIO, batches: Iterator[Columns]) -> None:
    columns = complete(batches)
    # np.savez would take columns named `file` or `allow_pickle` for its own arguments
    with zipfile.ZipFile(file, "w") as archive:
        for name, column in columns.items():
            with archive.open(f"{file_name(name)}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, column, allow_pickle=False)


def _write_parquet(file: BinaryIO, batches: Iterator[Columns]) -> None:
    arrow, parquet = (extras.load(module, "Parquet", "exchange") for module in ("pyarrow", "pyarrow.parquet"))
    writer = None
    try:
        for columns in batches:
            table = arrow.table({name: arrow.array(column) for name, column in columns.items()})
            writer = writer or parquet.ParquetWriter(file, table.schema)
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def _write_uff(file: BinaryIO, batches: Iterator[Columns]) -> None:
    pyuff = extras.load("pyuff", "UFF", "exchange")
    columns = complete(batches)
    with tempfile.TemporaryDirectory(prefix="impact_rig_uff_") as folder:  # pyuff opens files by name only
        path = Path(folder) / "all.uff"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)  # pyuff leaves files to the garbage collection
            pyuff.UFF(str(path)).write_sets([{"type": 58, **one} for one in _datasets(columns)], "add")
        file.write(path.read_bytes())


def _datasets(columns: Columns) -> list[dict[str, object]]:
    """Return the datasets of a universal file, as dictionaries for pyuff, from the numeric columns of a table.

    Columns of text are left out. The values get no unit.

    Raises:
        RecordingError: the columns give no function of time or frequency with at least two points.
    """
    found: list[dict[str, object]] = []
    numbers = {name: np.asarray(column, float) for name, column in columns.items() if column.dtype.kind in "fiu"}
    x = numbers.pop(TIME, None)
    if x is not None and len(x) > 0 and np.ptp(x) > 0.0:
        order = np.argsort(x, kind="stable")
        found += [
            _dataset(name, _TIME_RESPONSE, x[own], column[own], "s")
            for name, column in numbers.items()
            if name != EARLIER and len(own := order[np.isfinite(column[order])]) > 1
        ]
    if {"frequency", "transmissibility", "phase"} <= numbers.keys():
        found += _response_functions(numbers, columns.get(CURVE))
    if not found:
        raise RecordingError(
            "a UFF file holds functions of time or frequency, of at least two points; this table has none: use .csv, "
            ".npz or .parquet"
        )
    return found


def _response_functions(
    numbers: Mapping[str, NDArray[np.float64]], curve: NDArray[np.generic] | None
) -> Iterator[dict[str, object]]:
    """Yield the datasets of X_1/X_b over frequency: one per text in `curve`; without it, one per value of `gap`.

    Rows without finite transmissibility and phase are left out, and so are functions with fewer than two rows.
    """
    ratio = numbers["transmissibility"] * np.exp(1j * numbers["phase"])
    order = np.arange(len(ratio))
    if curve is None:
        gaps = np.nan_to_num(numbers.get("gap", np.full(len(ratio), np.nan)), nan=-1.0)
        order = np.argsort(gaps, kind="stable")
        curve = np.array(["" if gap < 0.0 else f"gap {gap * 1e3:g} mm" if gap else "no sphere" for gap in gaps])
    for name in dict.fromkeys(curve[order].tolist()):
        own = np.flatnonzero(np.isfinite(ratio) & (curve == name))
        own = own[np.argsort(numbers["frequency"][own], kind="stable")]
        if len(own) < 2:
            continue  # pyuff rejects a function without points
        title = f"X_1/X_b, {name}" if name else "X_1/X_b"
        yield _dataset(title, _RESPONSE_FUNCTION, numbers["frequency"][own], ratio[own], "Hz")


def _dataset(name: str, kind: int, x: NDArray[np.float64], y: NDArray[np.generic], unit: str) -> dict[str, object]:
    """Return y over x as a dataset 58 for pyuff, without a unit of y.

    `kind` is its function type: `_TIME_RESPONSE` or `_RESPONSE_FUNCTION`. `unit` is the unit of x: s or Hz. If x is an
    evenly spaced time, the file has only its first value and the step, with six digits each. Otherwise the file has all
    values of x.
    """
    begin, step = (float(f"{one:.5e}") for one in (x[0], x[1] - x[0]))
    line = one_line(name, 80)  # a line of its own in the file
    even = kind == _TIME_RESPONSE and bool(np.all(np.abs(begin + step * np.arange(len(x)) - x) <= _EVEN * abs(step)))
    return {
        "binary": 1, "func_type": kind, "data": y, "x": x, "abscissa_spacing": int(even),
        "id1": line[:80], "id2": "impact_rig", "rsp_ent_name": line[:10], "rsp_node": 1, "rsp_dir": 1,
        "ref_ent_name": "base", "ref_node": 1, "ref_dir": 1, "orddenom_spec_data_type": 0,
        "abscissa_spec_data_type": 17 if unit == "s" else 18, "abscissa_axis_units_lab": unit,
    }  # fmt: skip


_EVEN = 1e-6  # largest deviation of an evenly spaced abscissa from its first value and step, as a fraction of the step
_TIME_RESPONSE, _RESPONSE_FUNCTION = 1, 4  # function types of dataset 58

_WRITERS: Mapping[str, Callable[[BinaryIO, Iterator[Columns]], None]] = {
    ".csv": _write_csv,
    ".npz": _write_npz,
    ".parquet": _write_parquet,
    ".uff": _write_uff,
}
