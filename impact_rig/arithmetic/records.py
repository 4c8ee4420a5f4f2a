# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Arrays of records whose fields have names, in compiled code and in plain Python alike."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rig import kernels

DISABLED = kernels.MODE == "plain"
"""Whether compiled functions run as plain Python in this process."""


def records(count: int, kind: np.dtype[np.void]) -> Any:
    """Return `count` records of zeros; `records[i].field` reads and writes in place.

    Plain Python needs a recarray for that; to compiled code an ordinary array is the same and is handed over in a
    third of the time. A field must not be called like an attribute of NumPy's scalars (real, put, round, …).
    """
    assert not any(hasattr(np.record, name) for name in kind.names or ())
    return for_kernels(np.zeros(count, kind))


def for_kernels(rows: NDArray[np.void]) -> Any:
    """Return rows as kernels take them: as they are, with fields by name where kernels run as plain Python."""
    return with_fields(rows) if DISABLED else rows


def with_fields(rows: NDArray[np.void]) -> Any:
    """Return a recarray of the same memory; in plain Python its elements find their fields by descriptors.

    NumPy's own record looks each name up twenty times as slowly, which is nearly all the time of an interpreted kernel.
    """
    found = rows.view(np.recarray)
    if DISABLED:
        np.ndarray.__setattr__(found, "dtype", np.dtype((_record(rows.dtype), rows.dtype)))
    return found


@functools.cache
def _record(kind: np.dtype[np.void]) -> type[np.record]:
    """Return the class of a record type's elements."""

    def field(name: str) -> property:
        assert kind.fields is not None
        of, offset = kind.fields[name][:2]
        return property(lambda self: self.getfield(of, offset), lambda self, value: self.setfield(value, of, offset))

    looks = {"__getattribute__": np.void.__getattribute__, "__setattr__": np.void.__setattr__}
    return type("Record", (np.record,), {"__slots__": (), **looks, **{name: field(name) for name in kind.names or ()}})
