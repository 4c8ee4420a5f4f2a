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
"""Reader of NumPy archives (npz)."""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import RecordingError
from impact_rig_studies.importing.columns import signals_of
from impact_rig_studies.importing.limits import check_column_count, check_expanded_bytes
from impact_rig_studies.importing.signals import ImportedSignals


def read(path: Path, content: bytes) -> ImportedSignals:
    """Read all arrays of a NumPy archive as signals.

    Each field of a structured array becomes a column. Arrays of Python objects are left out, with the reason for the
    user. Sizes are checked before decompression.

    Raises:
        RecordingError: an array is shorter than its header claims.
        BudgetError: the content is larger than a file of this size may contain, or has too many columns.
    """
    columns: dict[str, NDArray[np.generic]] = {}
    left_out: dict[str, str] = {}
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        check_column_count(len(members))
        check_expanded_bytes(sum(one.file_size for one in members), len(content))
        for member in members:
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                form = np.lib.format
                header = form.read_array_header_1_0 if version == (1, 0) else form.read_array_header_2_0
                shape, _, dtype = header(stream)
            if dtype.hasobject:
                left_out[name] = "Python objects, which are not loaded"
                continue
            if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > member.file_size:
                raise RecordingError(
                    f"{path}: {member.filename} has {member.file_size} bytes, too few for the shape {shape} of {dtype} "
                    "in its header; this array is damaged: save it again"
                )
            with archive.open(member) as stream:
                array = np.lib.format.read_array(stream, allow_pickle=False)
            for field in dtype.names or ("",):
                columns[(field if len(members) == 1 else f"{name}.{field}") if field else name] = (
                    array[field] if field else array
                )
    return signals_of(path, "npz", columns, left_out=left_out)
