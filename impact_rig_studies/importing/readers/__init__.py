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
"""Readers of imported files, one module per format, and the registry that selects one."""

from __future__ import annotations

import importlib
import stat
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType

import attrs
import numpy as np

from impact_rig.errors import RecordingError
from impact_rig.system import budget, files
from impact_rig_studies.importing import isolation
from impact_rig_studies.importing.limits import FILE_BYTES
from impact_rig_studies.importing.readers import (
    bag,
    delimited,
    hdf5,
    labview,
    matlab,
    npz,
    parquet,
    rattlesnake,
    tdms,
    universal,
    wav,
)
from impact_rig_studies.importing.signals import ImportedSignals, reasons


@attrs.frozen
class Format:
    """File format that can be imported: its reader, and the library that the reader needs."""

    name: str  # name for messages, such as `a WAV file`
    read: Callable[..., ImportedSignals]  # function of path, content (of a bag its size in bytes), and library
    library: str = ""  # module of the library to import; empty if the reader needs none
    package: str = ""  # package to install for it
    prepare: Callable[[], object] | None = None  # called after the library is imported

    def load(self) -> tuple[ModuleType, ...]:
        """Import the library, call `prepare`, and return the additional arguments of `read`.

        The result is (library,), or () if the format needs no library. In the latter case `prepare` is not called.

        Raises:
            RecordingError: the library is not installed.
        """
        if not self.library:
            return ()
        try:
            library = importlib.import_module(self.library)
        except ImportError as error:
            raise RecordingError(f"{self.name} needs {self.package}: pip install 'impact_rig[import]'") from error
        if self.prepare:
            self.prepare()
        return (library,)


TEXT = Format("a text table", delimited.read)
MATLAB_5 = Format("a MATLAB 5 file", matlab.read_5, "scipy.io", "scipy")
MATLAB_7_3 = Format("a MATLAB 7.3 file", matlab.read_7_3, "h5py", "h5py")
NETCDF = Format("a Rattlesnake netCDF4 file", rattlesnake.read, "h5py", "h5py")
BAG = Format("a ROS bag", bag.read, "rosbags.highlevel", "rosbags")
UNIVERSAL = Format("a universal file", universal.read, "pyuff", "pyuff")
FORMATS: Mapping[str, Format] = {
    ".csv": TEXT, ".txt": TEXT, ".tsv": TEXT, ".dat": TEXT, ".asc": TEXT,
    ".lvm": Format("a LabVIEW measurement file", labview.read),
    ".tdms": Format("a TDMS file", tdms.read, "nptdms", "npTDMS"),
    ".npz": Format("an npz file", npz.read),
    ".parquet": Format("a Parquet file", parquet.read, "pyarrow.parquet", "pyarrow", parquet.reserve),
    ".wav": Format("a WAV file", wav.read),
    ".uff": UNIVERSAL, ".unv": UNIVERSAL, ".uf": UNIVERSAL,
    ".nc": NETCDF, ".nc4": NETCDF,
    ".mat": MATLAB_5,
    **dict.fromkeys(bag.SUFFIXES, BAG),
}  # fmt: skip
"""Formats that can be imported, by suffix of the file; a ROS bag may also be a directory."""


def format_of(path: Path, content: bytes) -> Format:
    """Return the format of a file, determined by its suffix.

    Upper and lower case of the suffix are equal. For `.mat` the content distinguishes versions 5 and 7.3.

    Raises:
        RecordingError: the suffix is unknown.
    """
    found = FORMATS.get(path.suffix.lower())
    if found is None:
        raise RecordingError(
            f"{path}: its suffix must be one of {', '.join(FORMATS)}; export it in one of these formats"
        )
    return MATLAB_7_3 if found is MATLAB_5 and hdf5.is_hdf5(content) else found


def read(path: Path) -> ImportedSignals:
    """Return the signals in a file, or in the directory of a ROS bag; the suffix determines the format.

    The reader runs in a separate process with a limit on memory and time. A file that crashes or blocks a library
    therefore only causes an error.

    Raises:
        RecordingError: the suffix is unknown, a library is missing, or the file has neither numbers nor columns of
            texts. Or the file cannot be read, is damaged, of another format, or larger than `FILE_BYTES`.
        BudgetError: a bag is larger than `FILE_BYTES`, or the file claims more content than its size can hold.
    """
    try:
        bag_bytes, content = _content(path)
    except RecordingError:  # also an OSError, and complete
        raise
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    if not bag_bytes and not content:
        raise RecordingError(f"{path} is empty: export the measurement again")
    chosen = BAG if bag_bytes else format_of(path, content)
    given = bag_bytes or content  # the library of a bag reads it piece by piece
    found = isolation.run(path, chosen.name, bag_bytes or len(content), lambda: _read(chosen, path, given), chosen.load)
    if not any(len(one.values) for one in found.signals.values()) and not found.texts:
        raise RecordingError(
            f"{path} holds no signal of numbers{': ' if found.left_out else ''}{reasons(found.left_out)}; export the "
            "measured signals as numbers"
        )
    return found


def _content(path: Path) -> tuple[int | None, bytes]:
    """Return the size of a bag in bytes and nothing, or None and the content of another file.

    Raises:
        RecordingError: the suffix is unknown, or the path is neither a regular file nor a bag.
        BudgetError: the file or bag is larger than `FILE_BYTES`.
        OSError: the file cannot be read.
    """
    if bag.is_bag(path):
        return _bag_bytes(path), b""
    if path.suffix.lower() not in FORMATS:
        format_of(path, b"")
    if not stat.S_ISREG(path.stat().st_mode):
        what = "a directory" if path.is_dir() else "not a regular file"
        raise RecordingError(f"{path} is {what}: a file of measurements, or the directory of a ROS bag, is needed")
    return None, files.read_bytes(path, budget.raised(FILE_BYTES))


def _bag_bytes(path: Path) -> int:
    """Return the size of a ROS bag, a file or a directory of files, in bytes.

    Raises:
        RecordingError: the bag is missing or empty, or its directory contains something that is not a file.
        BudgetError: the bag is larger than `FILE_BYTES`.
    """
    members = sorted(path.iterdir()) if path.is_dir() else [path]
    wrong = next((one for one in members if not one.is_file()), None)
    if wrong is not None:
        raise RecordingError(f"{wrong} is not a regular file: a bag must be a file, or a directory of files")
    size = sum(one.stat().st_size for one in members)
    if not size:
        raise RecordingError(f"{path} is empty: record or copy the bag again")
    budget.allow("bytes of a bag", size, FILE_BYTES)
    return size


def _read(chosen: Format, path: Path, content: bytes | int) -> ImportedSignals:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of libraries, about files that they then reject or read
        return chosen.read(path, content, *chosen.load())
