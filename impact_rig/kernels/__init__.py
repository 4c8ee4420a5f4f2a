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
"""Compiled functions: marked in the sources, and built into one library by `python -m impact_rig.kernels.build`.

The decorator `kernel` marks a function that only compiled code calls. The decorator `entry` marks a function that
Python calls, and declares the types of its arguments. One of three modes is chosen when this module is imported:

    library   the shared library, if it exists and was built from these sources; Numba is not imported
    jit       Numba compiles each function at its first call
    plain     the Python functions themselves: the same results, about a thousand times slower

The environment variable `IMPACT_RIG_KERNELS` selects a mode. By default, the first mode that is available is chosen.
`records` makes arrays whose elements have named fields, in all three modes. See docs/explanation/kernels.md.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import json
import os
import struct
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

PACKAGE = Path(__file__).parents[1]
IS_CHECKOUT = (PACKAGE.parent / "Makefile").exists()
BUILD = "run `make kernels`" if IS_CHECKOUT else "run `python -m impact_rig.kernels.build`"
"""Remedy for a missing or outdated library, as part of a message."""
VARIABLE = "IMPACT_RIG_KERNELS"
MODES = ("library", "jit", "plain")
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
"""Numba's options for compiling every kernel: no interpreter lock while it runs, and no error from a division by zero.
"""


class Array(NamedTuple):
    """Declared type of an argument of an `entry`: an array in C order.

    Attributes:
        dtype: type of its elements.
        dimensions: number of dimensions.
    """

    dtype: np.dtype[Any]
    dimensions: int = 1


class Fields(NamedTuple):
    """Declared type of an argument of an `entry`: a NamedTuple.

    Attributes:
        of: class of the tuple.
        types: types of its fields.
    """

    of: type
    types: tuple[Any, ...]


class RecordType(NamedTuple):
    """Declared type of an argument of a `Function`: one record, passed by its address.

    Attributes:
        dtype: type of the record.
    """

    dtype: np.dtype[np.void]


class Function(NamedTuple):
    """Declared type of an argument of an `entry`: a function.

    It is passed as a `Pointer`, or as Numba's callback in mode `jit`.

    Attributes:
        arguments: types of its arguments.
        returns: type of its result.
    """

    arguments: tuple[Any, ...]
    returns: Any


class Pointer(NamedTuple):
    """Compiled function in the form in which kernels accept it as an argument.

    Attributes:
        address: address of the compiled code.
        function: the same function in Python.
        kept: object that must live as long as the address is used, such as the one that owns the code.
    """

    address: int
    function: Callable[..., Any]
    kept: Any = None

    def __call__(self, *arguments: Any) -> Any:
        """Call the function in Python instead of the compiled code, with the same result."""
        return self.function(*arguments)


class Entry(NamedTuple):
    """Declaration, made by `entry`, of a compiled function that Python calls.

    Attributes:
        function: the function in Python.
        arguments: type of each argument: int, float, bool, an Array, a structured NumPy dtype for an array of such
            records, Fields, or a Function.
        returns: int, bool, a tuple of these, or None.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    returns: Any


class Exported(NamedTuple):
    """Declaration of a function that the library exports so that it can be passed to kernels as a `Pointer`.

    Attributes:
        function: the function in Python.
        type: type of the exported function.
        around: function, always given, that takes `function`, compiled, and returns the function to export, which
            calls it.
    """

    function: Callable[..., Any]
    type: Function
    around: Callable[[Callable[..., Any]], Callable[..., Any]]


REALS, REALS_2D, REALS_3D = (Array(np.dtype("f8"), dimensions) for dimensions in (1, 2, 3))
INTEGERS, WORDS, BYTES = (Array(np.dtype(kind)) for kind in ("i8", "u8", "u1"))
BYTES_2D = Array(np.dtype("u1"), 2)

Reals: TypeAlias = NDArray[np.float64]
Complexes: TypeAlias = NDArray[np.complex128]
Integers: TypeAlias = NDArray[np.int64]
Words: TypeAlias = NDArray[np.uint64]
Bytes: TypeAlias = NDArray[np.uint8]
Flags: TypeAlias = NDArray[np.bool_]
Record: TypeAlias = Any  # with its fields as attributes, which NumPy's own types do not have
Records: TypeAlias = Any  # an array of them


entries: dict[str, Entry] = {}
"""All functions marked with `entry` in the modules imported so far, by `module.name`."""
exported: dict[str, Exported] = {}
"""All functions that the library exports for passing to kernels, from the modules imported so far, by exported name."""
kernels: list[Callable[..., Any]] = []
"""All functions marked with `kernel` or `entry` in the modules imported so far, in Python."""


def digest(path: Path) -> str:
    """Return the SHA-256 digest of a file's content, by which a changed source is detected."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def code_digest(path: Path) -> str:
    """Return the digest of the code in a Python file, without layout, comments and docstrings.

    Other files give the same result as `digest`. Equal digests prove equal code. Different versions of Python may give
    different digests of the same code.
    """
    if path.suffix != ".py":
        return digest(path)
    try:
        tree = ast.parse(path.read_bytes())
    except SyntaxError:  # while it is edited
        return digest(path)
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value.value = None
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def has_code_of(path: Path, stamp: Sequence[str]) -> bool:
    """Return whether a file exists and still has the content or the code of `stamp`, its digests at a build."""
    return path.exists() and (digest(path) == stamp[0] or code_digest(path) == stamp[1])


def is_cut_off(path: Path) -> bool:
    """Return whether an ELF file (64 bit, little-endian) is incomplete: it ends before its section headers.

    The result is False for any other file, and for a file below 64 bytes. Loading an incomplete library could end the
    process by a signal.
    """
    with path.open("rb") as file:
        head = file.read(64)
    if len(head) < 64 or head[:6] != b"\x7fELF\x02\x01":
        return False
    (begin,) = struct.unpack_from("<Q", head, 40)
    size, count = struct.unpack_from("<HH", head, 58)
    return bool(path.stat().st_size < begin + size * count)


def library() -> ModuleType | None:
    """Return the compiled library of kernels, or None if it cannot be used.

    A usable library exists, can be loaded and was built from the present sources. If a library exists but is not
    usable, a line on stderr gives the reason.
    """
    spec = importlib.util.find_spec(f"{__name__}._library")
    if spec is None:
        return None
    found: ModuleType | None = None
    why: object = "the file is incomplete"
    if spec.origin is None or not is_cut_off(Path(spec.origin)):
        try:
            from impact_rig.kernels import _library as found  # type: ignore[attr-defined,no-redef]  # noqa: PLC0415  # where it is built
        except ImportError as error:  # built for another machine, or damaged
            why = error
    if found is None:
        sys.stderr.write(f"impact_rig: the library of kernels cannot be loaded ({why}); {BUILD}\n")
        return None

    sources: dict[str, list[str]] = json.loads(found.sources())
    paths = ((PACKAGE / name, stamp) for name, stamp in sources.items())
    changed = next((path for path, stamp in paths if not has_code_of(path, stamp)), None)
    if changed is None:
        return found
    # without this message, a program would seem to hang for minutes of compiling after an edit
    sys.stderr.write(f"impact_rig: {changed} has changed since the kernels were built; {BUILD}\n")
    return None


def _decide() -> tuple[str, ModuleType | None]:
    asked = os.environ.get(VARIABLE, "")
    if asked and asked not in MODES:
        raise ValueError(f"{VARIABLE} must be one of {', '.join(MODES)}, got {asked!r}")
    built = library() if asked in ("", "library") else None
    if built is not None:
        return "library", built
    if asked == "library":
        why = "cannot be used, see the line above" if importlib.util.find_spec(f"{__name__}._library") else "is missing"
        raise ImportError(f"{VARIABLE}=library, but the library of compiled kernels {why}; {BUILD}")
    if asked == "jit" or (not asked and importlib.util.find_spec("numba")):
        return "jit", None
    return "plain", None


MODE, _LIBRARY = _decide()


FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


def kernel(function: FunctionT) -> FunctionT:
    """Mark a function that compiled functions call, and return it.

    In mode `jit`, the result is a version of the function that Numba compiles at its first call.
    """
    kernels.append(function)
    return _compiled(function)


def entry(*arguments: Any, returns: Any = None) -> Callable[[FunctionT], FunctionT]:
    """Return a decorator that marks a function which Python calls with arguments of these types; see `Entry`.

    The decorator returns the compiled function of the library in mode `library`, a version that is compiled at its
    first call in mode `jit`, and the function itself in mode `plain`.
    """

    def mark(function: FunctionT) -> FunctionT:
        name = f"{function.__module__.removeprefix('impact_rig.')}.{function.__name__}"
        kernels.append(function)
        entries[name] = Entry(function, arguments, returns)
        if MODE == "library":
            assert _LIBRARY is not None
            call: FunctionT = _LIBRARY.entry(name, *plan(arguments), codes(returns))
            return call
        return _compiled(function)

    return mark


def _compiled(function: FunctionT) -> FunctionT:
    if MODE != "jit":
        return function
    from impact_rig.kernels import jit  # noqa: PLC0415  # Numba is imported where it compiles

    found: FunctionT = jit.compiled(function)
    return found


def address(name: str) -> int:
    """Return the address of the library's function `name`, such as `physics.event_loop.run`.

    The result is 0 if there is no such function, or if this process uses no library.
    """
    return int(_LIBRARY.address(name)) if _LIBRARY is not None else 0


def plan(arguments: tuple[Any, ...]) -> tuple[str, tuple[np.dtype[Any], ...]]:
    """Return how the library unpacks arguments of these types: codes (see library.c) and the arrays' dtypes."""
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
    """Return the letter of a type: `i` for int, `b` for bool, `f` for float.

    A tuple of types gives all their letters. None gives an empty text.
    """
    if kind is None:
        return ""
    return "".join(map(codes, kind)) if isinstance(kind, tuple) else {int: "i", bool: "b", float: "f"}[kind]


def records(count: int, kind: np.dtype[np.void]) -> Any:
    """Return `count` records of zeros, whose fields kernels read and write as `records[i].field`.

    Code outside kernels uses `records["field"][i]`, which works in every mode. An assertion rejects a field that has
    the name of an attribute of NumPy's records (real, put, round, …).
    """
    assert _has_free_names(kind)
    return for_kernels(np.zeros(count, kind))


@functools.cache
def _has_free_names(kind: np.dtype[np.void]) -> bool:
    return not any(hasattr(np.record, name) for name in kind.names or ())


def room(count: int, kind: np.dtype[np.void]) -> Any:
    """Return `count` records for kernels with arbitrary content, which must be written before it is read."""
    return for_kernels(np.empty(count, kind))


def for_kernels(rows: NDArray[np.void]) -> Any:
    """Return rows in the form that kernels accept: unchanged, or in mode `plain` with their fields as attributes."""
    return with_fields(rows) if MODE == "plain" else rows


def with_fields(rows: NDArray[np.void]) -> Any:
    """Return a recarray of the same memory, whose elements have their fields as attributes.

    In mode `plain`, the elements have a class of this package, which is much faster than NumPy's own record.
    """
    found = rows.view(np.recarray)
    if MODE == "plain":
        np.ndarray.__setattr__(found, "dtype", np.dtype((_record(rows.dtype), rows.dtype)))
    return found


@functools.cache
def _record(kind: np.dtype[np.void]) -> type[np.record]:
    """Return a class for the elements of a record array in mode `plain`, with a property for each field."""

    def field(name: str) -> property:
        assert kind.fields is not None
        of, offset = kind.fields[name][:2]
        return property(lambda self: self.getfield(of, offset), lambda self, value: self.setfield(value, of, offset))

    looks = {"__getattribute__": np.void.__getattribute__, "__setattr__": np.void.__setattr__}
    return type("Record", (np.record,), {"__slots__": (), **looks, **{name: field(name) for name in kind.names or ()}})
