# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A law's force, compiled: function pointers of one type whatever the law, so that one event loop calls them all.

Numba asks a function for its address by a dozen calls of Python each time it is handed over: a third of what a block of
10 ms costs. A `Pointer` holds the address, and is taken by reading that.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, NamedTuple

from numba import cfunc, from_dtype, njit
from numba.core import cgutils, config, types
from numba.experimental.function_type import FunctionModel
from numba.extending import NativeValue, register_model, typeof_impl, unbox

from impact_rig.physics.collocation import STAGES
from impact_rig.physics.contact.law import ForceFunction
from impact_rig.physics.parameters import PARAMETERS
from impact_rig.physics.state import PRESS
from impact_rig.system.compiled import content_stamp  # finds what was compiled from these sources

_ONE = types.UniTuple(types.float64, 5)(*6 * (types.float64,))  # type: ignore[attr-defined]  # made on demand
_AT_STAGES = types.void(from_dtype(PARAMETERS), types.float64, from_dtype(PRESS))


class PointerType(types.FunctionType):
    """What compiled code takes a `Pointer` for: a function of its signature."""


register_model(PointerType)(FunctionModel)


class Pointer:
    """A compiled function, and where it is.

    Args:
        function: what `cfunc` made.
    """

    def __init__(self, function: Any) -> None:
        self.address: int = function.address
        self.type = PointerType(function._sig)
        self._function = function

    def __call__(self, *arguments: Any) -> Any:
        """Call it from Python, uncompiled."""
        return self._function(*arguments)


@typeof_impl.register(Pointer)
def _type_of(pointer: Pointer, _context: Any) -> PointerType:
    return pointer.type


@unbox(PointerType)
def _take(kind: PointerType, pointer: Any, c: Any) -> NativeValue:
    function = cgutils.create_struct_proxy(kind)(c.context, c.builder)
    address = c.pyapi.object_getattr_string(pointer, "address")
    function.c_addr = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    return NativeValue(function._getvalue())


class CompiledForce(NamedTuple):
    """A law's force as function pointers.

    Attributes:
        one: the law's function itself.
        at_stages: called with (parameters, per_v0, press), fills the step's force, lossy, force_by_w, force_by_speed.
    """

    one: Any
    at_stages: Any


@functools.cache
def compiled_force(function: ForceFunction) -> CompiledForce:
    """Compile a law's force."""
    inner: Any = njit(cache=True, error_model="numpy")(function)

    def at_stages(p, per_v0, k):  # type: ignore[no-untyped-def]  # compiled: types are declared
        for i in range(STAGES):
            elastic, lossy, _, by_w, by_speed = inner(p.stiffness, p.factor, per_v0, k.turned_at, k.w[i], k.speed[i])
            k.force[i], k.lossy[i] = elastic + lossy, lossy
            k.force_by_w[i], k.force_by_speed[i] = by_w, by_speed

    if config.DISABLE_JIT:
        return CompiledForce(function, at_stages)
    # by default it is random, and code that calls the function would never be found in the cache again
    stamp = content_stamp(Path(function.__code__.co_filename))
    inner._set_uuid(f"{function.__module__}.{function.__qualname__}.{stamp}")
    return CompiledForce(Pointer(cfunc(_ONE, cache=True)(function)), Pointer(cfunc(_AT_STAGES, cache=True)(at_stages)))
