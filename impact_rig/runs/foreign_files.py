# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Files of other programs as named signals: CSV, Parquet, npz, WAV, universal files, Rattlesnake's netCDF4, MATLAB 5.

One reader a format, each around the library of that format; what a signal means is for `runs.measurement` to say. Files
come from anybody: their size is bounded, and while a library reads one, so is the memory of this process.
"""

from __future__ import annotations

import contextlib
import csv
import faulthandler
import importlib
import io
import json
import math
import os
import re
import resource
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import RecordingError
from impact_rig.simtime import NS_PER_S
from impact_rig.system import budget, files

Real = NDArray[np.float64]

FILE_BYTES = 512 * budget.MIB  # of one file
VALUES = 120_000_000  # of all signals of a file together: what 20 minutes of five channels at 20 kS/s have
READING_BYTES = 4096 * budget.MIB  # what a library may take beyond what the process has, while it reads a file
HEADER_LINES = 100  # of a CSV file, before the first row of numbers
STAMP = "stamp_ns"  # the column of our own exports that is an exact integer; `time` counts from it
TIMES = re.compile(r"(time|t|zeit|abscissa|time_domain)(\s*[\[(].*[\])])?", re.IGNORECASE)
RATES = re.compile(r"(time_)?(fs|f_s|rate|sample_?rate|sampling_?rate|rate_hz|samplerate|frequency_s)", re.IGNORECASE)
PERIODS = re.compile(r"(dt|d_t|delta_?t|period|step)(_s)?", re.IGNORECASE)
UNIT_IN_NAME = re.compile(r"^(.*?)\s*[\[(]([^\[\]()]*(?:\([^()]*\))?[^\[\]()]*)[\])]\s*$")


@attrs.frozen(eq=False)
class Signal:
    """A column of numbers."""

    values: Real  # shape (n,)
    unit: str = ""  # as the file has it; empty: it says none
    rate_hz: float | None = None  # of its samples; None: the file does not say


@attrs.frozen(eq=False)
class Foreign:
    """What a file holds."""

    path: Path  # the file
    kind: str  # of its format, for people
    signals: Mapping[str, Signal]  # by name, in the order of the file; lengths may differ
    time_s: Real | None = None
    """Since the first sample, shape (n,), not necessarily uniform; None: the file has no times."""
    start_ns: int | None = None  # stamp of the first sample; None: the file has none
    begins_s: float = 0.0  # the first sample's time as the file has it; 0 where it has none, or has stamps
    texts: Mapping[str, list[str]] = attrs.field(factory=dict)
    """Columns of words, such as the names in an exported `daq/info`."""
    left_out: Mapping[str, str] = attrs.field(factory=dict)
    """Why it is none of these, by the name of a column."""


def read(path: Path) -> Foreign:
    """Return the signals in a file; its suffix says the format.

    Raises:
        RecordingError: unknown suffix, a library is missing, or the file is damaged, empty or not of that format.
        BudgetError: it is larger than the budget.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise RecordingError(f"{path}: its suffix must be one of {', '.join(READERS)}")
    try:
        content = files.read_bytes(path, math.ceil(FILE_BYTES * budget.factor()))
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    try:
        with _bounded_memory(), warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of libraries, about files they then refuse or read
            found = _apart(reader, path, content) if reader in CRASHING else reader(path, content)
    except RecordingError:
        raise
    except MemoryError as error:
        raise RecordingError(f"{path} asks for more memory than a file of {len(content)} bytes may") from error
    except Exception as error:  # whatever a library raises of a file that is none of its format
        why = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path} is no {_named(path)} that can be read: {why[:300]}") from error
    if not any(len(one.values) for one in found.signals.values()) and not found.texts:
        raise RecordingError(f"{path} holds no column of numbers")
    return found


def _named(path: Path) -> str:
    return {".wav": "WAV file", ".mat": "MATLAB 5 file"}.get(path.suffix.lower(), f"{path.suffix[1:]} file")


@contextlib.contextmanager
def _bounded_memory() -> Iterator[None]:
    """Let this process take only `READING_BYTES` more for a while: a header that lies then costs an error."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + round(READING_BYTES * budget.factor())
    ends = [one for one in (soft, hard) if one != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([limit, *ends]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _apart(reader: Callable[[Path, bytes], Foreign], path: Path, content: bytes) -> Foreign:
    """Read a file in a child process: a damaged one can crash the library, which then is only an error."""
    source, sink = os.pipe()
    child = os.fork()
    if not child:
        faulthandler.disable()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what a library says while it fails
        with os.fdopen(sink, "wb") as out:
            try:
                _send(reader(path, content), out)
            except MemoryError:
                out.write(json.dumps({"error": "it asks for more memory than a file of its size may"}).encode())
            except BaseException as error:  # whatever the library raises, the parent says it
                out.write(json.dumps({"error": " ".join(str(error).split()) or type(error).__name__}).encode())
            out.flush()
            os._exit(0)
    os.close(sink)
    with os.fdopen(source, "rb") as received:
        head, _, data = received.read().partition(b"\n")
    os.waitpid(child, 0)
    if not head:
        raise RecordingError(f"{path} is damaged: the library that reads it crashed")
    told = json.loads(head)
    if "error" in told:
        message = str(told["error"])
        raise RecordingError(
            message if message.startswith(str(path)) else f"{path} is no {_named(path)}: {message[:300]}"
        )
    values = np.frombuffer(data)
    ends = np.cumsum([told["times"], *(one[1] for one in told["signals"])]).tolist()
    parts = [values[begin:end] for begin, end in zip([0, *ends], ends, strict=False)]
    signals = {
        name: Signal(part, unit, rate) for (name, _, unit, rate), part in zip(told["signals"], parts[1:], strict=True)
    }
    times = parts[0] if told["times"] else None
    return Foreign(
        path, told["kind"], signals, times, told["start_ns"], told["begins_s"], told["texts"], told["left_out"]
    )


def _send(found: Foreign, out: BinaryIO) -> None:
    """Write what was read: a line of JSON, then all numbers."""
    times = np.zeros(0) if found.time_s is None else found.time_s
    signals = [(name, len(one.values), one.unit, one.rate_hz) for name, one in found.signals.items()]
    texts = {name: list(words) for name, words in found.texts.items()}
    told = {"kind": found.kind, "times": len(times), "signals": signals, "start_ns": found.start_ns, "texts": texts}
    told["begins_s"], told["left_out"] = found.begins_s, dict(found.left_out)
    out.write(json.dumps(told).encode() + b"\n")
    for values in (times, *(one.values for one in found.signals.values())):
        out.write(np.ascontiguousarray(values, np.float64).tobytes())


def _library(name: str, what: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise RecordingError(f"{what} needs {name.partition('.')[0]}: pip install 'impact_rig[import]'") from error


def _allow(rows: int, columns: int) -> None:
    budget.allow("values in a file", float(rows) * columns, VALUES)


def _foreign(path: Path, kind: str, columns: Mapping[str, NDArray[np.generic]], units: Mapping[str, str]) -> Foreign:
    """Return columns of a table as signals: times taken out, scalars understood as rate or period where their name is.

    A column of two dimensions is as many signals as its shorter side has; what is no number is left out, and told.
    """
    stamps: NDArray[np.generic] | None = None
    times: Real | None = None
    rate: float | None = None
    signals: dict[str, Signal] = {}
    texts: dict[str, list[str]] = {}
    left_out: dict[str, str] = {}
    for name, column in columns.items():
        values = np.asarray(column)
        if values.dtype.kind in "SUO" and values.ndim == 1:
            texts[name] = [one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in values]
            continue
        if values.dtype.kind not in "fiub":
            left_out[name] = "complex numbers" if values.dtype.kind == "c" else "no numbers"
            continue
        if values.size == 1 and (RATES.fullmatch(name) or PERIODS.fullmatch(name)):
            one = float(values.reshape(-1)[0])
            if math.isfinite(one) and one > 0.0:
                rate = one if RATES.fullmatch(name) else 1.0 / one
            else:
                left_out[name] = f"no rate or period: {one:g}"
        elif name == STAMP and values.ndim == 1:
            stamps = values
        elif TIMES.fullmatch(name) and values.size == max(values.shape, default=0):
            times = _seconds(np.asarray(values, np.float64).reshape(-1), units.get(name, "") or _split(name)[1])
        else:
            squeezed = np.atleast_1d(np.squeeze(values))
            if squeezed.ndim > 2:
                left_out[name] = "a table of tables"
                continue
            rows = squeezed[None] if squeezed.ndim == 1 else squeezed if len(squeezed) < len(squeezed.T) else squeezed.T
            for number, row in enumerate(rows):
                plain, unit = _split(name)
                own, full = (plain, name) if len(rows) == 1 else (f"{plain}_{number}", f"{name}_{number}")
                if own in signals:  # two headings that differ in what is in their brackets
                    own = _free(full, signals)
                signals[own] = Signal(np.ascontiguousarray(row, np.float64), units.get(name, "") or unit)
    start, begins_s = None, 0.0 if times is None or not len(times) else float(times[0])
    if stamps is not None and len(stamps):
        # a table that was cut begins amid a block: its first sample is then later than its first stamp
        start = int(stamps[0]) + (round(begins_s * NS_PER_S) if math.isfinite(begins_s) else 0)
        begins_s = 0.0
        since = (stamps - stamps[0]).astype(np.float64) / NS_PER_S
        times = since if times is None else since + times
    signals = {name: attrs.evolve(one, rate_hz=rate) for name, one in signals.items()}
    times = None if times is None or not len(times) else times - times[0]
    return Foreign(path, kind, signals, times, start, begins_s, texts, left_out)


def _seconds(times: Real, unit: str) -> Real:
    """Return times in seconds; a file that names no unit, or one that is not known, has seconds."""
    return times * {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}.get(unit.strip(), 1.0)


def _split(name: str) -> tuple[str, str]:
    """Return a heading's name and the unit in its brackets."""
    match = UNIT_IN_NAME.match(name)
    return (match[1].strip(), match[2].strip()) if match and match[1].strip() else (name.strip(), "")


def _free(name: str, taken: Container[str]) -> str:
    """Return a name that is not taken, like this one."""
    while name in taken:
        name += "_"
    return name


# --- one reader a format


def _csv(path: Path, content: bytes) -> Foreign:
    """Read values separated by `,` `;` tab or blanks; where `;` separates, with a decimal comma if need be."""
    text = content.decode("utf-8-sig", errors="replace")
    lines = text.splitlines()
    delimiter, first = _first_row(lines[:HEADER_LINES])
    if first is None:
        return _worded(path, lines)
    comma = delimiter == ";" and any("," in line for line in lines[first:])  # whole numbers have none
    width = len(_cells(lines[first], delimiter))
    names, units = _headings(lines[:first], delimiter, width)
    _allow(len(lines) - first, width)
    rows = (line.replace(",", ".") for line in lines[first:]) if comma else iter(lines[first:])
    if any(
        not _is_number(cell) for cell in _cells(lines[first].replace(",", ".") if comma else lines[first], delimiter)
    ):
        return _worded(path, lines)
    kinds = np.dtype([(f"c{j}", np.int64 if name == STAMP else np.float64) for j, name in enumerate(names)])
    try:
        table = np.loadtxt(rows, kinds, delimiter=delimiter, comments="#", ndmin=1, quotechar='"')
    except ValueError as error:
        raise RecordingError(
            f"{path}: {' '.join(str(error).split())}; the first row of numbers is line {first + 1}"
        ) from error
    return _foreign(path, "CSV", {name: table[f"c{j}"] for j, name in enumerate(names)}, units)


def _worded(path: Path, lines: Sequence[str]) -> Foreign:
    """Read a table with words in it, such as an exported `daq/info`: small, by the standard library."""
    rows = [row for row in csv.reader(line for line in lines if not line.startswith("#")) if row]
    if len(rows) < 2:  # names and a row
        raise RecordingError(f"{path} has no row of numbers within its first {HEADER_LINES} lines")
    _allow(len(rows), len(rows[0]))
    if any(len(row) != len(rows[0]) for row in rows):
        line = next(number for number, row in enumerate(rows) if len(row) != len(rows[0]))
        raise RecordingError(f"{path}: row {line + 1} has {len(rows[line])} cells, those before it {len(rows[0])}")
    columns: dict[str, NDArray[np.generic]] = {}
    for name, cells in zip(rows[0], zip(*rows[1:], strict=True), strict=True):
        numeric = all(_is_number(cell) or not cell for cell in cells)
        if name == STAMP and numeric:
            columns[name] = np.array([int(cell) for cell in cells])
        else:
            columns[name] = np.array([float(cell or "nan") for cell in cells]) if numeric else np.array(cells)
    return _foreign(path, "CSV", columns, {})


def _first_row(lines: Sequence[str]) -> tuple[str | None, int | None]:
    """Return the delimiter (None: blanks) and the number of the first line that is all numbers."""
    for number, line in enumerate(lines):
        if not line.strip() or line.startswith("#"):
            continue
        for delimiter in (";", "\t", ",", None):
            cells = _cells(line, delimiter)
            if delimiter is not None and len(cells) == 1:
                continue
            if all(_is_number(cell.replace(",", ".") if delimiter == ";" else cell) for cell in cells):
                return delimiter, number
    return None, None


def _cells(line: str, delimiter: str | None) -> list[str]:
    return [cell.strip().strip('"') for cell in line.split(delimiter)]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _headings(lines: Sequence[str], delimiter: str | None, width: int) -> tuple[list[str], dict[str, str]]:
    """Return a name for each column, and units where a second line of headings holds them."""
    usable = [_cells(line.lstrip("#"), delimiter) for line in lines if line.strip()]
    usable = [cells for cells in usable if len(cells) == width]
    if not usable:
        return [f"column_{j}" for j in range(width)], {}
    rows = usable[-2:]
    names, units = rows[0], list[str]()
    if len(rows) == 2:  # names above units, or something else above the names
        if all(len(cell.strip("[]()")) <= 12 for cell in rows[1]) and not any(
            TIMES.fullmatch(cell) for cell in rows[1]
        ):
            units = [cell.strip("[]() ") for cell in rows[1]]
        else:
            names = rows[1]
    unique: list[str] = []
    for j, name in enumerate(names):
        is_first = name and name not in unique
        unique.append(name if is_first else _free(f"{name or 'column'}_{j}", {*names, *unique}))
    return unique, dict(zip(unique, units, strict=False))


def _npz(path: Path, content: bytes) -> Foreign:
    columns: dict[str, NDArray[np.generic]] = {}
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        budget.allow("values in a file", sum(one.file_size for one in archive.infolist()) / 8.0, VALUES)
        for member in archive.infolist():
            with archive.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                header = (
                    np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                )
                shape, _, dtype = header(stream)
            if math.prod(shape) * dtype.itemsize > member.file_size:
                raise RecordingError(
                    f"{path}: {member.filename} has {member.file_size} bytes and claims {shape} of {dtype}"
                )
            with archive.open(member) as stream:
                columns[member.filename.removesuffix(".npy")] = np.lib.format.read_array(stream, allow_pickle=False)
    return _foreign(path, "npz", columns, {})


def _parquet(path: Path, content: bytes) -> Foreign:
    parquet = _library("pyarrow.parquet", "Parquet")
    file = parquet.ParquetFile(io.BytesIO(content))
    _allow(file.metadata.num_rows, file.metadata.num_columns)
    table = file.read()
    units = {
        field.name: (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace") for field in file.schema_arrow
    }
    return _foreign(path, "Parquet", {n: table.column(n).to_numpy() for n in table.column_names}, units)


def _wav(path: Path, content: bytes) -> Foreign:
    wavfile = _library("scipy.io.wavfile", "WAV")
    rate, samples = wavfile.read(io.BytesIO(content))
    samples = np.atleast_2d(samples.T)
    full, zero = {"u1": (128.0, 128.0), "i2": (2.0**15, 0.0), "i4": (2.0**31, 0.0)}.get(
        samples.dtype.str[1:], (1.0, 0.0)
    )
    signals = {
        f"channel_{j}": Signal((np.asarray(row, np.float64) - zero) / full, "full scale", float(rate))
        for j, row in enumerate(samples)
    }
    return Foreign(path, "WAV", signals)


def _uff(path: Path, content: bytes) -> Foreign:
    """Read the time responses (dataset 58, function type 1 or 0) of a universal file."""
    pyuff = _library("pyuff", "UFF")
    time_response = (0, 1)
    signals: dict[str, Signal] = {}
    left_out: dict[str, str] = {}
    times, begins_s = None, 0.0
    with tempfile.TemporaryDirectory(prefix="impact_rig_uff_") as folder:  # pyuff opens files by name only
        named = Path(folder) / "all.uff"
        named.write_bytes(content)
        file = pyuff.UFF(str(named))
        for number, kind in enumerate(file.get_set_types()):
            if int(kind) != 58:
                continue
            one = file.read_sets(number)
            data, x = np.asarray(one["data"]), np.asarray(one["x"], np.float64)
            if one.get("func_type") not in time_response or np.iscomplexobj(data):
                left_out[f"dataset {number + 1}"] = "no time response"
                continue
            words = [str(one.get(key, "")).strip() for key in ("id1", "rsp_ent_name")]
            name = next((word for word in words if word and word.upper() != "NONE"), f"dataset_{number}")
            node = f"{one.get('rsp_node', 0)}:{one.get('rsp_dir', 0)}"
            name = (
                name
                if name not in signals
                else f"{name} {node}"
                if f"{name} {node}" not in signals
                else f"{name}_{number}"
            )
            if times is not None and len(x) == len(times) > 1 and not np.all(np.abs(x - x[0] - times) < times[1] / 2.0):
                left_out[name] = "its abscissa is another one than that of the signals before"
                continue
            unit = str(one.get("ordinate_axis_units_lab") or "").strip()
            signals[name] = Signal(np.asarray(data, np.float64), "" if unit.upper() == "NONE" else unit)
            if times is None and len(x) == len(data) and len(x):
                times, begins_s = x - x[0], float(x[0])
    if not signals:
        raise RecordingError(f"{path} holds no time response (dataset 58, function type 1)")
    return Foreign(path, "universal file", signals, times, begins_s=begins_s, left_out=left_out)


def _netcdf(path: Path, content: bytes) -> Foreign:
    """Read what Rattlesnake streams: `time_data` (channels, samples), `sample_rate`, group `channels`."""
    h5netcdf = _library("h5netcdf", "netCDF4")
    with h5netcdf.File(io.BytesIO(content), "r", decode_vlen_strings=True) as file:
        if "time_data" not in file.variables or "sample_rate" not in file.attrs:
            raise RecordingError(
                f"{path} has no variable time_data or no attribute sample_rate: Rattlesnake writes both"
            )
        data = file.variables["time_data"]
        _allow(math.prod(data.shape), 1)
        rows = np.atleast_2d(np.asarray(data[...], np.float64))
        rate = float(np.asarray(file.attrs["sample_rate"]).reshape(-1)[0])
        table = file.groups["channels"].variables if "channels" in file.groups else {}

        def words(key: str) -> list[str]:
            found = [str(one) for one in np.asarray(table[key][...]).reshape(-1)] if key in table else []
            return found if len(found) == len(rows) else [""] * len(rows)

        labels = zip(words("comment"), words("node_number"), words("node_direction"), words("unit"), rows, strict=True)
        signals: dict[str, Signal] = {}
        for number, (comment, node, direction, unit, row) in enumerate(labels):
            name = comment.strip() or f"{node}{direction}".strip() or f"channel_{number}"
            signals[name if name not in signals else f"{name}_{number}"] = Signal(row, unit, rate)
    return Foreign(path, "Rattlesnake netCDF4", signals)


def _matlab(path: Path, content: bytes) -> Foreign:
    if content[:128].startswith(b"MATLAB 7.3"):
        raise RecordingError(f"{path} is of MATLAB 7.3: save it with -v7, as vectors")
    found = _library("scipy.io", "MATLAB").loadmat(io.BytesIO(content), struct_as_record=True)
    columns = {name: value for name, value in found.items() if not name.startswith("__")}
    return _foreign(path, "MATLAB 5", columns, {})


READERS: Mapping[str, Callable[[Path, bytes], Foreign]] = {
    ".csv": _csv, ".txt": _csv, ".tsv": _csv, ".npz": _npz, ".parquet": _parquet, ".wav": _wav, ".uff": _uff,
    ".unv": _uff, ".nc": _netcdf, ".nc4": _netcdf, ".mat": _matlab,
}  # fmt: skip
CRASHING = (_matlab, _netcdf)
"""Readers around libraries in C that a damaged file can crash: SciPy's of MATLAB files does."""
