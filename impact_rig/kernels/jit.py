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
"""Compilation of kernels by Numba at their first call, and Numba's types for the declared types."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import cfunc, from_dtype, njit
from numba.core import config
from numba.core import types as _types

from impact_rig.kernels import OPTIONS, PACKAGE, Array, Fields, Function, RecordType, digest

types: Any = _types  # typed in parts


def numba_type(kind: Any) -> Any:
    """Return Numba's type for a declared type: Array, Fields, a record type, int and so on."""
    if isinstance(kind, Fields):
        return types.NamedTuple(tuple(map(numba_type, kind.types)), kind.of)
    if isinstance(kind, Function):
        return types.FunctionType(signature(kind))
    if isinstance(kind, RecordType):
        return from_dtype(kind.dtype)
    if isinstance(kind, Array):
        return types.Array(from_dtype(kind.dtype), kind.dimensions, "C")
    if isinstance(kind, np.dtype):
        return types.Array(from_dtype(kind), 1, "C")
    if isinstance(kind, tuple):
        return types.BaseTuple.from_types(tuple(map(numba_type, kind)))
    return {float: types.float64, int: types.int64, bool: types.boolean, None: types.none}[kind]


def signature(kind: Function) -> Any:
    """Return Numba's signature for a declared function type."""
    return numba_type(kind.returns)(*map(numba_type, kind.arguments))


def compiled(function: Callable[..., Any]) -> Any:
    """Return a version of a function that Numba compiles at its first call.

    The compiled code is cached on disk until a source file of the package changes. A function that is not defined in a
    file is not cached.
    """
    kept = Path(function.__code__.co_filename).is_file()  # code that was typed in has no file for the cache
    return _kept(lambda: njit(cache=kept, **OPTIONS)(function))


def pointer(function: Callable[..., Any], kind: Function) -> Any:
    """Compile a function with the signature `kind` at once; return Numba's callback, whose `address` kernels call."""
    return _kept(lambda: cfunc(signature(kind), error_model="numpy")(function))


def _kept(compile_: Callable[[], Any]) -> Any:
    """Call `compile_` and return its result, with a cache folder of Numba that only the present sources use.

    In its usual folder, Numba would not notice changes in the functions that a cached function calls.
    """
    before, config.CACHE_DIR = config.CACHE_DIR, _directory()
    try:
        return compile_()
    finally:
        config.CACHE_DIR = before


@functools.cache
def _directory() -> str:
    state = "".join(digest(path) for path in sorted(PACKAGE.rglob("*.py")))
    return str(PACKAGE / "__pycache__" / f"jit-{hashlib.sha256(state.encode()).hexdigest()[:16]}")
