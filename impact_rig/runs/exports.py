"""Table topics as files other programs read: CSV, NumPy's NPZ and Parquet.

Every row becomes one row, with the stamp of its message in front: `stamp_ns` is an exact integer, `time` counts from it
in seconds. `earlier` is 1 where the message was published before the recording began: what a latched topic hands to a
recorder that comes, such as the journal since the rig's start or the commands of cases before this run. Numbers in CSV
are written so that reading them back gives the same bits.
"""

from __future__ import annotations

import csv
import importlib
import io
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import RecordingError
from impact_rig.recording.reader import Run
from impact_rig.system import files

STAMP, EARLIER = "stamp_ns", "earlier"
_BATCH_BYTES = 4 * 2**20  # a text takes four times as much when it is decoded, a number when it is written

Columns = dict[str, NDArray[np.generic]]


def export(run: Run, topic: str, target: Path) -> Path:
    """Write a table topic to `target` and return it; the suffix says the format: .csv, .npz or .parquet.

    NPZ is put together in memory, the others are written as they are read.

    Raises:
        RecordingError: unknown suffix, `target` exists or cannot be written, the topic carries no tables or changes
            its columns, or pyarrow is missing for Parquet.
    """
    write = _WRITERS.get(target.suffix)
    if write is None:
        raise RecordingError(f"{target} must end in one of {', '.join(_WRITERS)}")
    kept = RecordingError(f"{target} exists already and is not overwritten")
    if os.path.lexists(target):
        raise kept
    try:
        with files.written_whole(target, replace=False) as file:
            write(file, _batches(run, topic))
    except RecordingError:
        raise
    except FileExistsError as error:
        raise kept from error
    except OSError as error:
        raise RecordingError(f"{target} cannot be written: {error.strerror}") from error
    return target


def _batches(run: Run, topic: str) -> Iterator[Columns]:
    """Yield the columns of many messages at a time; text as str. At least one batch, empty if there are no rows."""
    dtype: np.dtype[np.void] | None = None
    rows: list[NDArray[np.void]] = []
    stamps: list[NDArray[np.int64]] = []
    earlier: list[NDArray[np.uint8]] = []
    waiting = 0
    began_ns = _wall_start_ns(run)
    for published_ns, table in run.published_tables(topic):
        if dtype is None:
            dtype = table.rows.dtype
        elif dtype != table.rows.dtype:
            raise RecordingError(f"topic {topic} changes its columns at {table.stamp_ns} ns")
        rows.append(table.rows)
        stamps.append(np.full(len(table.rows), table.stamp_ns, np.int64))
        earlier.append(np.full(len(table.rows), published_ns < began_ns, np.uint8))
        waiting += table.rows.nbytes
        if waiting >= _BATCH_BYTES:
            yield _columns(rows, stamps, earlier)
            rows, stamps, earlier, waiting = [], [], [], 0
    if dtype is None:
        raise RecordingError(f"topic {topic} holds no message, so its columns are not known")
    if rows:
        yield _columns(rows, stamps, earlier)


def _wall_start_ns(run: Run) -> int:
    """Return when the recording began; 0 where its recorder does not say."""
    text = run.provenance.get("wall_start_ns", "")
    return int(text) if text.isdecimal() else 0


def _columns(
    rows: list[NDArray[np.void]], stamps: list[NDArray[np.int64]], earlier: list[NDArray[np.uint8]]
) -> Columns:
    joined = np.concatenate(rows)
    columns: Columns = {STAMP: np.concatenate(stamps), EARLIER: np.concatenate(earlier)}
    for name in joined.dtype.names or ():
        column = joined[name]
        columns[name] = np.char.decode(column, "utf-8", "replace") if column.dtype.kind == "S" else column
    return columns


def _write_csv(file: BinaryIO, batches: Iterator[Columns]) -> None:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text)
    for number, columns in enumerate(batches):
        if number == 0:
            writer.writerow(columns)
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
    text.detach()


def _write_npz(file: BinaryIO, batches: Iterator[Columns]) -> None:
    parts = list(batches)
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    # np.savez would take columns called `file` or `allow_pickle` for its own arguments
    with zipfile.ZipFile(file, "w") as archive:
        for name, column in columns.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, column, allow_pickle=False)


def _write_parquet(file: BinaryIO, batches: Iterator[Columns]) -> None:
    try:
        arrow, parquet = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise RecordingError("Parquet needs pyarrow, which is not installed: pip install pyarrow") from error
    writer = None
    try:
        for columns in batches:
            table = arrow.table({name: arrow.array(column) for name, column in columns.items()})
            writer = writer or parquet.ParquetWriter(file, table.schema)
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


_WRITERS: Mapping[str, Callable[[BinaryIO, Iterator[Columns]], None]] = {
    ".csv": _write_csv,
    ".npz": _write_npz,
    ".parquet": _write_parquet,
}
