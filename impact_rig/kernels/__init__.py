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
"""Compiled functions: marked in the sources, built into one library by `python -m impact_rig.kernels.build`.

`kernel` marks a function that compiled code calls, `entry` one that Python calls, with the types it takes. What runs is
decided once, when this module is imported:

    library   the shared library, where it is there and was built from these sources; nothing of Numba is imported
    jit       Numba compiles each function at its first call: no C compiler was there, or a kernel is being edited
    plain     the functions themselves: the same bits, some thousand times slower

`IMPACT_RIG_KERNELS` names one of them; left alone, the first that can be had is taken. See docs/explanation/kernels.md.
`records` are arrays whose fields have names in all three.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

PACKAGE = Path(__file__).parents[1]
VARIABLE = "IMPACT_RIG_KERNELS"
MODES = ("library", "jit", "plain")
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
"""What Numba is told of every kernel."""


class Array(NamedTuple):
    """The type of an array in C order.

    Attributes:
        dtype: of its elements.
        dimensions: how many.
    """

    dtype: np.dtype[Any]
    dimensions: int = 1


class Fields(NamedTuple):
    """The type of a NamedTuple.

    Attributes:
        of: the class.
        types: of its fields.
    """

    of: type
    types: tuple[Any, ...]


class RecordType(NamedTuple):
    """The type of one record, handed over by its address: for functions that only kernels call.

    Attributes:
        dtype: of the record.
    """

    dtype: np.dtype[np.void]


class Function(NamedTuple):
    """The type of a compiled function that is handed over as a `Pointer`.

    Attributes:
        arguments: types of its arguments.
        returns: of its result.
    """

    arguments: tuple[Any, ...]
    returns: Any


class Pointer(NamedTuple):
    """A compiled function as kernels take it.

    Attributes:
        address: where it is.
        function: the same for Python.
        kept: what must stay as long as the address is used.
    """

    address: int
    function: Callable[..., Any]
    kept: Any = None

    def __call__(self, *arguments: Any) -> Any:
        """Call it as Python."""
        return self.function(*arguments)


class Entry(NamedTuple):
    """A function that Python calls.

    Attributes:
        function: as it is written.
        arguments: type of each: int, float, bool, an Array, a record type for an array of such records, Fields, or a
            Function.
        returns: int, bool, a tuple of these, or None.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    returns: Any


class Exported(NamedTuple):
    """A function that is handed to kernels as a `Pointer`.

    Attributes:
        function: as it is written.
        type: of what `around` makes of it.
        around: returns the function of that type, which calls the one it is given.
    """

    function: Callable[..., Any]
    type: Function
    around: Callable[[Callable[..., Any]], Callable[..., Any]]


REALS, REALS_2D, REALS_3D = (Array(np.dtype("f8"), dimensions) for dimensions in (1, 2, 3))
INTEGERS, WORDS, BYTES, FLAGS = (Array(np.dtype(kind)) for kind in ("i8", "u8", "u1", "?"))

entries: dict[str, Entry] = {}
"""All that have been imported, by `module.name`."""
exported: dict[str, Exported] = {}
"""All functions that have been declared to be handed over, by a name of their own."""
kernels: list[Callable[..., Any]] = []
"""All functions that are compiled, as they are written."""


def digest(path: Path) -> str:
    """Return what tells one content of a file from another."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def library() -> ModuleType | None:
    """Return the shared library if it can be loaded and was built from the sources as they are, else warn."""
    if importlib.util.find_spec(f"{__name__}._library") is None:
        return None
    try:
        from impact_rig.kernels import _library as found  # type: ignore[attr-defined]  # noqa: PLC0415  # where it is built
    except ImportError as error:  # of another machine, or cut short
        sys.stderr.write(f"impact_rig: the library of kernels cannot be loaded ({error}): `make kernels` builds it\n")
        return None

    sources: dict[str, str] = json.loads(found.sources())
    paths = ((PACKAGE / name, known) for name, known in sources.items())
    whole: ModuleType = found
    changed = next((path for path, known in paths if not path.exists() or digest(path) != known), None)
    if changed is None:
        return whole
    # without a word, who has edited a line would take minutes of compiling for a program that hangs
    sys.stderr.write(f"impact_rig: {changed} is not what the kernels were built from: `make kernels` builds them\n")
    return None


def _decide() -> tuple[str, ModuleType | None]:
    asked = os.environ.get(VARIABLE, "")
    if asked and asked not in MODES:
        raise ValueError(f"{VARIABLE} must be one of {', '.join(MODES)}, got {asked!r}")
    built = library() if asked in ("", "library") else None
    if built is not None:
        return "library", built
    if asked == "library":
        raise ImportError("the library of compiled kernels is not there, or not of these sources: make kernels")
    if asked == "jit" or (not asked and importlib.util.find_spec("numba")):
        return "jit", None
    return "plain", None


MODE, _LIBRARY = _decide()


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a function that compiled functions call."""
    kernels.append(function)
    return _compiled(function)


def entry(*arguments: Any, returns: Any = None) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Mark a function that Python calls with arguments of these types; see `Entry`."""

    def mark(function: Callable[..., Any]) -> Callable[..., Any]:
        name = f"{function.__module__.removeprefix('impact_rig.')}.{function.__name__}"
        kernels.append(function)
        entries[name] = Entry(function, arguments, returns)
        if MODE == "library":
            assert _LIBRARY is not None
            call: Callable[..., Any] = _LIBRARY.entry(name, *plan(arguments), codes(returns))
            return call
        return _compiled(function)

    return mark


def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    if MODE != "jit":
        return function
    from impact_rig.kernels import jit  # noqa: PLC0415  # Numba is imported where it compiles

    found: Callable[..., Any] = jit.compiled(function)
    return found


def address(name: str) -> int:
    """Return where an exported function of the library is; 0: there is none of that name."""
    return int(_LIBRARY.address(name)) if _LIBRARY is not None else 0


def plan(arguments: tuple[Any, ...]) -> tuple[str, tuple[np.dtype[Any], ...]]:
    """Return how arguments are unpacked: a letter a piece (see library.c), and the types of the arrays in them."""
    letters: list[str] = []
    dtypes: list[np.dtype[Any]] = []
    for one in arguments:
        if isinstance(one, Fields):
            inner, of = plan(one.types)
            letters.append(f"({len(one.types):c}{inner}")
            dtypes += of
        elif isinstance(one, Function):
            letters.append("p")
        elif isinstance(one, Array | np.dtype):
            array = one if isinstance(one, Array) else Array(one)
            letters.append(f"{array.dimensions}")
            dtypes.append(array.dtype)
        else:
            letters.append(codes(one))
    return "".join(letters), tuple(dtypes)


def codes(kind: Any) -> str:
    """Return the letters of numbers, see `plan`; none for None."""
    if kind is None:
        return ""
    return "".join(map(codes, kind)) if isinstance(kind, tuple) else {int: "i", bool: "b", float: "f"}[kind]


def records(count: int, kind: np.dtype[np.void]) -> Any:
    """Return `count` records of zeros; `records[i].field` reads and writes in place.

    Plain Python needs a recarray for that; to compiled code an ordinary array is the same and is handed over in a
    third of the time. A field must not be called like an attribute of NumPy's scalars (real, put, round, …).
    """
    assert not any(hasattr(np.record, name) for name in kind.names or ())
    return for_kernels(np.zeros(count, kind))


def room(count: int, kind: np.dtype[np.void]) -> Any:
    """Return room for `count` records that are written before they are read: nothing is cleared."""
    return for_kernels(np.empty(count, kind))


def for_kernels(rows: NDArray[np.void]) -> Any:
    """Return rows as kernels take them: as they are, with fields by name where kernels run as plain Python."""
    return with_fields(rows) if MODE == "plain" else rows


def with_fields(rows: NDArray[np.void]) -> Any:
    """Return a recarray of the same memory; in plain Python its elements find their fields by descriptors.

    NumPy's own record looks each name up twenty times as slowly, which is nearly all the time of an interpreted kernel.
    """
    found = rows.view(np.recarray)
    if MODE == "plain":
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
