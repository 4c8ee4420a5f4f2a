# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Where a campaign keeps what is done: one file per job, written whole or not at all, so a campaign can be resumed.

Numbers are JSON: Python writes every double so that it reads back as the same bits, and a person can look at them.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import TRANSMISSIBILITY, TRANSMISSIBILITY_COLUMNS
from impact_rig.campaign.code import fingerprint
from impact_rig.campaign.job import Job, Outcome
from impact_rig.errors import RecordingError
from impact_rig.system import files

FOLDER = "points"
MAX_RESULT_BYTES, MAX_TRACE_BYTES = 10 * 2**20, 64 * 2**20
"""A file in a directory that somebody else made is not believed to be small."""
_LATER: dict[str, object] = {
    column.name: column.default for column in TRANSMISSIBILITY_COLUMNS if column.default is not None
}
_TEXTS = frozenset(name for name in TRANSMISSIBILITY.names or () if TRANSMISSIBILITY[name].kind == "S")


class Store:
    """The results in a campaign's directory.

    Args:
        directory: of the campaign; made if missing.

    Raises:
        RecordingError: it cannot be written.
    """

    def __init__(self, directory: Path) -> None:
        self._folder = directory / FOLDER
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(f"cannot write {self._folder}: {error.strerror}") from error

    def get(self, job: Job, *, as_it_is: bool = False) -> Outcome | None:
        """Return what is stored of a job, or None if it is to be measured: never was, or its file is damaged.

        It is to be measured again, too, if it was with other code, or without the trace that it wants; not if it is to
        be taken `as_it_is`.
        """
        try:
            found = json.loads(files.read_bytes(self._path(job, "json"), MAX_RESULT_BYTES))
            failure = str(found["failure"])
            trace = self._trace(job) if job.traces else {}
            incomplete = job.traces and not (trace or failure)
            if not as_it_is and (incomplete or found["code"] != fingerprint()):
                return None
            return Outcome(
                rows=np.array([_row(row) for row in found["rows"]], dtype=TRANSMISSIBILITY),
                failure=failure,
                skipped_hz=tuple(found["skipped_hz"]),
                simulated_s=float(found["simulated_s"]),
                wall_s=float(found["wall_s"]),
                lost_scans=int(found["lost_scans"]),
                trace=trace,
            )
        except (OSError, ValueError, KeyError, TypeError, RecursionError, zipfile.BadZipFile):
            return None

    def put(self, job: Job, outcome: Outcome) -> None:
        """Keep what a job gave.

        Raises:
            RecordingError: it cannot be written.
        """
        content = {
            "job": job.describe(),
            "code": fingerprint(),
            "changes": dict(job.changes),
            "current_a": job.current_a,
            "frequencies_hz": list(job.frequencies_hz),
            "failure": outcome.failure,
            "skipped_hz": list(outcome.skipped_hz),
            "simulated_s": outcome.simulated_s,
            "wall_s": outcome.wall_s,
            "lost_scans": outcome.lost_scans,
            "rows": [_plain(row) for row in outcome.rows],
        }
        try:
            if outcome.trace:
                with files.written_whole(self._path(job, "npz")) as file:
                    np.savez_compressed(file, **dict(outcome.trace))  # type: ignore[arg-type]  # none is called allow_pickle
            files.write_text(self._path(job, "json"), json.dumps(content, indent=1) + "\n")
        except OSError as error:
            raise RecordingError(f"cannot write {self._folder}: {error.strerror}") from error

    def _trace(self, job: Job) -> dict[str, NDArray[np.generic]]:
        path = self._path(job, "npz")
        if not path.exists():
            return {}
        packed = io.BytesIO(files.read_bytes(path, MAX_TRACE_BYTES))
        with zipfile.ZipFile(packed) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_TRACE_BYTES:
                raise ValueError(f"{path} holds more than {MAX_TRACE_BYTES} bytes")
        with np.load(packed, allow_pickle=False) as arrays:
            return dict(arrays)

    def _path(self, job: Job, suffix: str) -> Path:
        return self._folder / f"{job.key}.{suffix}"


def _plain(row: np.void) -> dict[str, object]:
    """Return a row as JSON knows it; null stands for NaN."""
    plain: dict[str, object] = {}
    for name in TRANSMISSIBILITY.names or ():
        if name in _TEXTS:
            plain[name] = row[name].decode()
        else:
            number = float(row[name])
            plain[name] = number if math.isfinite(number) else None
    return plain


def _row(plain: dict[str, object]) -> tuple[object, ...]:
    """Return a stored row; a column that an earlier version did not have gets its default."""
    plain = _LATER | plain
    return tuple(
        str(plain[name]).encode() if name in _TEXTS else math.nan if plain[name] is None else plain[name]
        for name in TRANSMISSIBILITY.names or ()
    )
