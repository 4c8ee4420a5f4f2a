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
"""Store of a campaign's results, with one file per job, so that a campaign can be resumed.

Each file is written completely or not at all, and its numbers are read back with the same bits. It contains the key of
its job and a digest of its content and trace. A file that was changed, or exchanged for that of another job, is
reported and not used.
"""

from __future__ import annotations

import enum
import functools
import hashlib
import io
import json
import math
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import impact_rig
from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.errors import RecordingError
from impact_rig.states import MEASURED, Method, Regime, Status
from impact_rig.system import files
from impact_rig_studies.campaign.job import TRUE_COLUMNS, Job, Outcome

FOLDER = "points"
MAX_RESULT_BYTES, MAX_TRACE_BYTES = 10 * 2**20, 64 * 2**20
"""Size limits of a result and of a trace, since a campaign's directory may come from elsewhere."""
MOST = 1e12  # larger than every number in a valid measurement
SHOWN = 60  # number of characters of a wrong value quoted in an error
_POSITIVE = frozenset({"frequency", "transmissibility", "base_amplitude", "laser_amplitude"})
"""Columns that must be > 0 in rows whose status is one of `states.MEASURED`."""
_WORDS: dict[str, type[enum.StrEnum]] = {"regime": Regime, "method": Method, "status": Status}
_RESULT = "a stored result, is damaged, changed or unreadable"
_TRACE = "a stored trace, is damaged, changed or unreadable"
_TEXTS = frozenset(name for name in TRANSMISSIBILITY.names or () if TRANSMISSIBILITY[name].kind == "S")


class DamagedPointError(RecordingError):
    """Error that a stored result is damaged or was changed; the message names the file and what is wrong."""


class Store:
    """Store of the outcomes of a campaign's jobs, in the campaign's directory.

    Each outcome is a JSON file. A trace is a further NPZ file.

    Args:
        directory: directory of the campaign; created if missing.

    Attributes:
        damaged: messages about damaged files found by `get`; their jobs must be measured again.

    Raises:
        RecordingError: the directory cannot be written.
    """

    def __init__(self, directory: Path) -> None:
        self._folder = directory / FOLDER
        self.damaged: list[str] = []
        with files.translate_errors(f"cannot write {self._folder}"):
            files.make_folder(self._folder)

    def get(self, job: Job, *, as_it_is: bool = False) -> Outcome | None:
        """Return the stored outcome of a job, or None if the job must be measured.

        A job must be measured if it has no stored outcome, if the file is damaged (noted in `damaged`), or if other
        code measured it. It must also be measured if it has not failed and lacks a requested trace.

        Args:
            job: the job.
            as_it_is: whether to return the outcome also if other code measured it, or measured it without the requested
                trace.

        Raises:
            DamagedPointError: the file is damaged, and `as_it_is` is true.
        """
        try:
            found, outcome = self._read(job)
        except FileNotFoundError:
            return None
        except DamagedPointError as error:
            if as_it_is:
                raise DamagedPointError(
                    f"{error}; measure the campaign again to replace it, or import it again into a new directory"
                ) from error
            self.damaged.append(str(error))
            return None
        incomplete = job.traces and not (outcome.trace or outcome.failure)
        if not as_it_is and (incomplete or found["code"] != code_fingerprint()):
            return None
        return outcome

    def put(self, job: Job, outcome: Outcome) -> None:
        """Write the outcome of a job into its file, and its trace into another; an earlier outcome is replaced.

        Raises:
            RecordingError: the result cannot be written.
        """
        packed = io.BytesIO()
        if outcome.trace:
            np.savez_compressed(packed, **dict(outcome.trace))  # type: ignore[arg-type]  # no such column
        content = {
            "job": job.describe(),
            "key": job.key,
            "code": code_fingerprint(),
            "changes": dict(job.changes),
            "current_a": job.current_a,
            "frequencies_hz": list(job.frequencies_hz),
            "failure": outcome.failure,
            "skipped_hz": list(outcome.skipped_hz),
            "simulated_s": outcome.simulated_s,
            "wall_s": outcome.wall_s,
            "lost_scans": outcome.lost_scans,
            "rows": [files.plain(row) for row in outcome.rows],
            "trace": hashlib.sha256(packed.getvalue()).hexdigest() if outcome.trace else "",
        }
        content["digest"] = _digest(content)
        with files.translate_errors(f"cannot write {self._folder}"):
            if not outcome.trace:  # a trace left by other code would pass for an exchanged one
                self._path(job, "npz").unlink(missing_ok=True)
            else:
                with files.atomic_write(self._path(job, "npz")) as file:
                    file.write(packed.getvalue())
            files.write_text(self._path(job, "json"), json.dumps(content, indent=1) + "\n")

    def _read(self, job: Job) -> tuple[Mapping[str, object], Outcome]:
        """Return the content of a job's file, and the outcome in it.

        DamagedPointError is raised if the file or a requested trace is damaged, FileNotFoundError if the job has no
        file.
        """
        path = self._path(job, "json")
        try:
            found = json.loads(files.read_bytes(path, MAX_RESULT_BYTES))
        except FileNotFoundError:
            raise
        except (OSError, ValueError, RecursionError) as error:
            why = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
            raise DamagedPointError(f"{path}, {_RESULT}: {why}") from error
        if not isinstance(found, dict):
            raise DamagedPointError(f"{path}, {_RESULT}: it is not a JSON object")
        part = _Checked(path, found)
        if part.text("key") != job.key:
            whose = part.text("job")[:SHOWN]
            raise DamagedPointError(
                f"{path} was renamed or exchanged: it holds the result of another job ({whose}), not {job.key}"
            )
        rows = part.each("rows", job.repetitions * len(job.plan().points()))
        names = TRANSMISSIBILITY.names or ()
        outcome = Outcome(
            rows=np.array([tuple(_cell(name, row[name]) for name in names) for row in rows], dtype=TRANSMISSIBILITY),
            failure=part.text("failure"),
            skipped_hz=tuple(
                _Checked(path, {"skipped_hz": one}).number("skipped_hz") for one in part.several("skipped_hz")
            ),
            simulated_s=part.number("simulated_s"),
            wall_s=part.number("wall_s"),
            lost_scans=round(part.number("lost_scans")),
            trace=self._trace(job, part.text("trace")) if job.traces else {},
        )
        part.text("code")
        if part.text("digest") != _digest(found):
            raise DamagedPointError(f"{path} was changed after it was stored: its digest does not match its content")
        return found, outcome

    def _trace(self, job: Job, digest: str) -> dict[str, NDArray[np.generic]]:
        path = self._path(job, "npz")
        if not digest and not path.exists():
            return {}
        try:
            packed = files.read_bytes(path, MAX_TRACE_BYTES)
            with zipfile.ZipFile(io.BytesIO(packed)) as archive:
                size = sum(member.file_size for member in archive.infolist())
                names = archive.namelist() if size <= MAX_TRACE_BYTES else []
                arrays = {name.removesuffix(".npy"): _column(archive.read(name)) for name in names}
        except (OSError, ValueError, RuntimeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            why = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
            raise DamagedPointError(f"{path}, {_TRACE}: {why}") from error
        if size > MAX_TRACE_BYTES:
            raise DamagedPointError(
                f"{path}, {_TRACE}: it must hold at most {MAX_TRACE_BYTES} unpacked bytes, got {size}"
            )
        for name in ("time", "laser", "accelerometer", *TRUE_COLUMNS):
            column = arrays.get(name)
            if column is None:
                raise DamagedPointError(f"{path}, {_TRACE}: column {name} is missing")
            if not len(column):
                raise DamagedPointError(f"{path}, {_TRACE}: column {name} must have at least one value, got 0")
            if len(column) != len(arrays["time"]):
                rule = f"as many values as column time, {len(arrays['time'])}"
                raise DamagedPointError(f"{path}, {_TRACE}: column {name} must have {rule}, got {len(column)}")
            if not np.all(np.abs(column) <= MOST):
                wrong = column[~(np.abs(column) <= MOST)][0]
                raise DamagedPointError(
                    f"{path}, {_TRACE}: column {name} must be finite and within ±{MOST:g}, got {wrong:g}"
                )
        if hashlib.sha256(packed).hexdigest() != digest:
            raise DamagedPointError(
                f"{path} was changed after it was stored, or belongs to another result: its digest is not the one in "
                f"{path.with_suffix('.json').name}"
            )
        return dict(arrays)

    def _path(self, job: Job, suffix: str) -> Path:
        return self._folder / f"{job.key}.{suffix}"


class _Checked:
    """Validator of a JSON object from an untrusted file.

    Its methods raise DamagedPointError for missing and invalid values. Unknown fields are ignored. `place` is the
    position of the object in the file, for messages, such as `rows[0].`.
    """

    def __init__(self, path: Path, content: Mapping[str, object], place: str = "") -> None:
        self._path, self._content, self._place = path, content, place

    def number(self, key: str, low: float = 0.0, *, above: bool = False) -> float:
        """Return the number in the field `key` of the object.

        Raises:
            DamagedPointError: the value is not a number >= `low` (> `low` if `above` is true) and <= `MOST`.
        """
        value = self._value(key)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= MOST:
            raise self._wrong(key, value, f"a number >= {low:g} and <= {MOST:g}")
        if above and value == low:
            raise self._wrong(key, value, f"> {low:g}")
        return float(value)

    def text(self, key: str) -> str:
        """Return the value of the field `key` of the object; raise DamagedPointError unless it is a text."""
        value = self._value(key)
        if not isinstance(value, str):
            raise self._wrong(key, value, "a text")
        return value

    def several(self, key: str) -> list[object]:
        """Return the value of the field `key` of the object; raise DamagedPointError unless it is a list."""
        value = self._value(key)
        if not isinstance(value, list):
            raise self._wrong(key, value, "a list")
        return value

    def each(self, key: str, most: int) -> list[Mapping[str, object]]:
        """Return the rows in the field `key` of the object.

        DamagedPointError is raised if a row is invalid or there are more than `most` rows.
        """
        rows = self.several(key)
        if len(rows) > most:
            raise self._wrong(key, f"{len(rows)} rows", f"at most {most} rows")
        for i, row in enumerate(rows):
            if not isinstance(row, dict):
                raise self._wrong(f"{key}[{i}]", row, "a mapping of columns to values")
            _Checked(self._path, row, f"{key}[{i}].").row()
        return [row for row in rows if isinstance(row, dict)]

    def row(self) -> None:
        """Check that this object is a row of `transmissibility/table`.

        Raises:
            DamagedPointError: a column is missing, a word is unknown, or a value is neither a number in range nor null.
                Columns of `_POSITIVE` must not be null in a measured row.
        """
        for name, words in _WORDS.items():
            if self.text(name) not in [word.value for word in words]:
                raise self._wrong(name, self.text(name), f"one of {', '.join(word.value for word in words)}")
        measured = self.text("status") in [status.value for status in MEASURED]
        for name in TRANSMISSIBILITY.names or ():
            if name in _TEXTS:
                continue
            positive = measured and name in _POSITIVE
            if self._value(name) is not None or positive:
                signed = name in {"phase", "frequency_deviation", "time"}
                self.number(name, -MOST if signed else 0.0, above=positive)

    def _value(self, key: str) -> object:
        if key not in self._content:
            raise DamagedPointError(f"{self._path}, {_RESULT}: {self._place}{key} is missing")
        return self._content[key]

    def _wrong(self, key: str, value: object, rule: str) -> DamagedPointError:
        return DamagedPointError(f"{self._path}, {_RESULT}: {self._place}{key} must be {rule}, got {shortened(value)}")


def shortened(value: object) -> str:
    """Return a value of a JSON file as JSON text for an error message, cut after `SHOWN` characters."""
    text = json.dumps(value, default=str)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}... ({len(text)} characters)"


def _column(member: bytes) -> NDArray[np.generic]:
    """Read one member of an NPZ file, which must be a one-dimensional array of floating-point numbers.

    Raises:
        ValueError: the member is another array, or damaged.
    """
    file = io.BytesIO(member)
    version = np.lib.format.read_magic(file)
    header: Callable[..., tuple[tuple[int, ...], bool, np.dtype[np.generic]]] | None = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if header is None:
        raise ValueError(f"version {version} of the NPY format is unknown; 1.0 and 2.0 can be read")
    shape, _, dtype = header(file)
    rest = len(member) - file.tell()
    if len(shape) != 1 or dtype.kind != "f" or shape[0] * dtype.itemsize != rest:
        raise ValueError(
            f"each column in the file must be a one-dimensional array of floating-point numbers filling {rest} bytes, "
            f"got {dtype} of shape {shape}"
        )
    return np.frombuffer(member, dtype, offset=file.tell())


def _digest(content: Mapping[str, object]) -> str:
    """Return the SHA-256 of a stored result, computed without its entry `digest`."""
    kept = {name: value for name, value in content.items() if name != "digest"}
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()


def _cell(name: str, value: object) -> object:
    return str(value).encode() if name in _TEXTS else math.nan if value is None else value


# --- Version of the code that measured a result: results of other code are shown, but never mixed with new ones

DECIDING = (
    "arithmetic", "physics", "instruments", "rig", "analysis", "config", "blocks.py", "simtime.py",
    "operate", "prediction.py", "decay.py", "reduction.py",
)  # fmt: skip
"""Packages and modules whose code determines measured numbers; the others only command, store and show."""


@functools.cache
def code_fingerprint(deciding: tuple[str, ...] = DECIDING) -> str:
    """Return the version of this package and, after a hyphen, a digest of the sources that determine results.

    `deciding` contains the names of these packages and modules within `impact_rig` and `impact_rig_studies`. The digest
    has 12 hexadecimal digits.
    """
    digest = hashlib.sha256()
    for package in (Path(impact_rig.__file__).parent, Path(__file__).parents[1]):
        for path in sorted(package.rglob("*.py")):
            name = path.relative_to(package)
            if name.parts[0] in deciding:
                digest.update(f"{package.name}/{name.as_posix()}\0".encode())
                digest.update(path.read_bytes())
    return f"{impact_rig.__version__}-{digest.hexdigest()[:12]}"
