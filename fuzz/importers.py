# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Targets that read measurements of somebody else's: a small file of each format, damaged, and mappings of channels."""

from __future__ import annotations

import io
import tempfile
import wave
from collections.abc import Callable
from pathlib import Path

import h5netcdf
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet
from hypothesis import strategies as st
from scipy.io import savemat

from fuzz.mutation import mutated, mutated_lines
from fuzz.target import Target
from impact_rig.runs.exports import write_columns
from impact_rig.runs.foreign_files import Foreign, Signal, read
from impact_rig.runs.measurement import guess, measurement, refined

SCANS = 24
COLUMNS = {name: np.arange(SCANS) / (100.0 * (k + 1)) for k, name in enumerate(("time", "laser", "base", "current"))}
MAPPING = """\
rate_hz: 100
resample_hz: 200
frequency: 9.1
gap_mm: 6
notes: [a, b]
channels:
  laser:
    column: laser
    unit: mm
    sign: -1
    noise: 1.0e-6
  base: {column: base, unit: V, sensitivity: 500 mV/mm}
"""


def _csv() -> bytes:
    lines = [",".join(f"{name} [mm]" if name == "laser" else name for name in COLUMNS)]
    return "\n".join([*lines, *(",".join(map(str, row)) for row in zip(*COLUMNS.values(), strict=True))]).encode()


def _npz() -> bytes:
    file = io.BytesIO()
    np.savez(file, **COLUMNS)
    return file.getvalue()


def _parquet() -> bytes:
    file = io.BytesIO()
    pa.parquet.write_table(pa.table(COLUMNS), file)
    return file.getvalue()


def _wav() -> bytes:
    file = io.BytesIO()
    with wave.open(file, "wb") as sound:
        sound.setparams((2, 2, 1000, 0, "NONE", ""))
        sound.writeframes(np.arange(2 * SCANS, dtype="<i2").tobytes())
    return file.getvalue()


def _matlab() -> bytes:
    file = io.BytesIO()
    savemat(file, {**COLUMNS, "fs": 100.0})
    return file.getvalue()


def _netcdf() -> bytes:
    file = io.BytesIO()
    with h5netcdf.File(file, "w") as content:
        content.attrs["sample_rate"] = 100.0
        content.dimensions = {"response_channels": 3, "time_samples": SCANS}
        data = content.create_variable("time_data", ("response_channels", "time_samples"), "f8")
        data[...] = np.stack([COLUMNS[name] for name in ("laser", "base", "current")])
        names = content.create_group("channels").create_variable("comment", ("response_channels",), h5py.string_dtype())
        names[...] = np.array(["laser", "base", "current"], object)
    return file.getvalue()


def _uff() -> bytes:
    """Write it as `impact-rig export` does: its own columns, one dataset each."""
    columns = {"stamp_ns": np.zeros(SCANS, np.int64), **COLUMNS}
    with tempfile.TemporaryDirectory() as folder:
        return write_columns(lambda: iter([columns]), Path(folder) / "all.uff").read_bytes()


def _reads(suffix: str) -> Callable[[bytes], None]:
    """Return what reads a file; signals of a WAV file have no names that say what they are."""
    said = "channels: {laser: {column: channel_0, unit: mm}, base: {column: channel_1, unit: mm}}"

    def check(content: bytes) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"own{suffix}"
            path.write_bytes(content)
            source = read(path)
        found = measurement(source, refined(guess(source), said if suffix == ".wav" else "{}"))
        assert len(found.rows) == len(found.index)
        assert found.rate_hz >= 1
        assert (np.diff(found.index) > 0).all()

    return check


def mapping(text: str) -> None:
    """Take a mapping for a sound file."""
    signals = {name: Signal(values) for name, values in COLUMNS.items() if name != "time"}
    source = Foreign(Path("own.csv"), "CSV", signals, COLUMNS["time"])
    found = measurement(source, refined(guess(source), text))
    assert len(found.rows)
    assert np.isfinite(found.drive[0][1])


_SEEDS = {
    ".csv": _csv(), ".npz": _npz(), ".parquet": _parquet(), ".wav": _wav(), ".mat": _matlab(), ".nc": _netcdf(),
    ".uff": _uff(),
}  # fmt: skip
TARGETS = (
    *(
        Target(
            f"import{suffix.replace('.', '_')}",
            mutated([seed]) | st.binary(max_size=200),
            _reads(suffix),
            ("runs/foreign_files.py", "runs/measurement.py"),
        )
        for suffix, seed in _SEEDS.items()
    ),
    Target("import_mapping", mutated_lines(MAPPING), mapping, ("runs/measurement.py",)),
)
