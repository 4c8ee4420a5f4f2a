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
"""Safe access to HDF5 files: links to other files are not followed, and sizes are checked before reading."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from types import ModuleType
from typing import Any  # objects of h5py, which is of an extra

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import RecordingError
from impact_rig_studies.importing.limits import COLUMNS, check_column_count, check_value_count

SIGNATURE = b"\x89HDF\r\n\x1a\n"
CHUNKS_AT_ONCE = 4096  # of a dataset; the library takes about 2 kB for each chunk of one request
PLACES = (0, 512, 1024, 2048)  # offsets at which the content of a file may begin


def is_hdf5(content: bytes) -> bool:
    """Return whether the content of a file is HDF5, which its signature shows."""
    return any(content[place : place + len(SIGNATURE)] == SIGNATURE for place in PLACES)


@attrs.define
class Hdf5Tree:
    """Reader of the groups and datasets of an HDF5 file, which also records parts that it leaves out, such as links."""

    library: ModuleType  # h5py
    file_bytes: int  # size of the file, which limits how many values may be read
    left_out: dict[str, str] = attrs.field(factory=dict)  # parts that were left out: name to the reason, for the user
    _values: int = 0  # number of values read so far

    def open(self, content: bytes) -> Any:
        """Open the content of an HDF5 file as an h5py file.

        The h5py file is also its root group. The caller must close it.
        """
        return self.library.File(io.BytesIO(content), "r")

    def members(self, group: Any) -> Iterator[tuple[str, Any]]:
        """Yield names and objects of the first `COLUMNS` members of a group.

        Soft and external links are not followed. Members that are not yielded are noted in `left_out`.
        """
        for number, name in enumerate(group):
            if number >= COLUMNS:
                self.left_out[f"{group.name}"] = f"members after the first {COLUMNS}"
                return
            link = group.get(name, getlink=True)
            if isinstance(link, self.library.ExternalLink):
                self.left_out[name] = "a link to another file, which is not followed"
            elif isinstance(link, self.library.SoftLink):
                self.left_out[name] = "a soft link, which is not followed"
            else:
                yield name, group[name]

    def array(self, name: str, dataset: Any) -> NDArray[Any] | None:
        """Return the content of a dataset; None for an empty dataset, which is noted in `left_out`.

        A dataset is empty if it has a null data space.

        Raises:
            RecordingError: the data are in another file or in other datasets.
            BudgetError: this and all earlier datasets have more values together than a file of this size may contain.
        """
        if dataset.external:
            raise RecordingError(
                f"{name} keeps its data in another file, which is not opened; save the data in the file itself"
            )
        if dataset.is_virtual:
            raise RecordingError(
                f"{name} is a view of other datasets (virtual), which are not opened; save it as an ordinary dataset"
            )
        self._values += int(dataset.size or 0)
        check_value_count(self._values, self.file_bytes)
        if dataset.shape is None:
            self.left_out[name] = "empty"
            return None
        return _whole(dataset)

    def texts(self, name: str, dataset: Any) -> list[str]:
        """Return the texts in a dataset as a list, which is empty for an empty dataset.

        Raises:
            RecordingError: as `array`.
            BudgetError: as `array`, or the dataset has more texts than a file may have columns.
        """
        values = self.array(name, dataset)
        words = [] if values is None else values.reshape(-1).tolist()
        check_column_count(len(words))
        return [one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in words]


def _whole(dataset: Any) -> NDArray[Any]:
    """Return the complete content of a dataset.

    It is read in parts of at most `CHUNKS_AT_ONCE` chunks, because the library needs memory for each chunk of a
    request.
    """
    counts = [-(-length // size) for length, size in zip(dataset.shape, dataset.chunks or dataset.shape, strict=True)]
    if math.prod(counts) <= CHUNKS_AT_ONCE:
        return np.asarray(dataset[...])
    axis = int(np.argmax(counts))
    step = max(1, CHUNKS_AT_ONCE * counts[axis] // math.prod(counts)) * dataset.chunks[axis]
    found = np.empty(dataset.shape, dataset.dtype)
    for begin in range(0, dataset.shape[axis], step):
        slab = (*[slice(None)] * axis, slice(begin, begin + step))
        found[slab] = dataset[slab]
    return found


def attribute(holder: Any, name: str) -> Any:
    """Return an attribute of an HDF5 object as a number or text, or None if it is missing or has no value.

    For an array, the first element is returned.
    """
    if name not in holder.attrs:
        return None
    value = holder.attrs[name]
    if isinstance(value, np.ndarray):
        value = value.reshape(-1)[0] if value.size else None
    if getattr(value, "shape", ()) is None:  # an attribute without a value, `h5py.Empty`
        return None
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value
