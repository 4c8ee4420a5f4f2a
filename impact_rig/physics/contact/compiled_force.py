# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A law's force as kernels call it: function pointers of one type whatever the law, for one event loop.

The forces of the package's own laws are in the library. That of a law from elsewhere is compiled by Numba where it is
installed, and its address handed over; without Numba the library calls back into plain Python.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import logging
import math
from typing import Any, NamedTuple

import numpy as np

from impact_rig import kernels
from impact_rig.kernels import Exported, Fields, Function, Pointer, Record
from impact_rig.physics.collocation import STAGES
from impact_rig.physics.contact.law import ForceFunction
from impact_rig.physics.parameters import PARAMETERS
from impact_rig.physics.state import PRESS

ONE = Function(6 * (float,), 5 * (float,))
AT_STAGES = Function((Record(PARAMETERS), float, Record(PRESS)), None)


class CompiledForce(NamedTuple):
    """A law's force as function pointers.

    Attributes:
        one: the law's function itself.
        at_stages: called with (parameters, per_v0, press), fills the step's force, lossy, force_by_w, force_by_speed.
    """

    one: Any
    at_stages: Any


FORCE = Fields(CompiledForce, (ONE, AT_STAGES))


def at_stages_of(one: Any) -> Any:
    """Return the function that asks a force at the stages of a step."""

    def at_stages(p, per_v0, k):  # type: ignore[no-untyped-def]  # compiled: types are declared
        for i in range(STAGES):
            elastic, lossy, _, by_w, by_speed = one(p.stiffness, p.factor, per_v0, k.turned_at, k.w[i], k.speed[i])
            k.force[i], k.lossy[i] = elastic + lossy, lossy
            k.force_by_w[i], k.force_by_speed[i] = by_w, by_speed

    return at_stages


def declare(function: ForceFunction) -> None:
    """Let the library hold a law's force."""
    kernels.exported[f"{name_of(function)}.one"] = Exported(function, ONE)
    kernels.exported[f"{name_of(function)}.at_stages"] = Exported(function, AT_STAGES, at_stages_of)


def name_of(function: ForceFunction) -> str:
    """Return the name under which the library holds a force, less `.one` or `.at_stages`."""
    return f"force.{function.__module__}.{function.__qualname__}"


@functools.cache
def compiled_force(function: ForceFunction) -> CompiledForce:
    """Return a law's force as the kernels of this process take it."""
    if kernels.MODE == "plain":
        return CompiledForce(function, at_stages_of(function))
    name = name_of(function)
    if kernels.address(f"{name}.one"):
        return CompiledForce(
            Pointer(kernels.address(f"{name}.one"), function),
            Pointer(kernels.address(f"{name}.at_stages"), at_stages_of(function)),
        )
    if importlib.util.find_spec("numba"):
        from impact_rig.kernels import jit  # noqa: PLC0415  # Numba is imported where it compiles

        inner = at_stages_of(jit.compiled(function))
        found = jit.pointer(function, ONE), jit.pointer(inner, AT_STAGES)
        return CompiledForce(*(one if kernels.MODE == "jit" else Pointer(one.address, one) for one in found))
    logging.getLogger(__name__).warning(
        "the contact force %s runs as plain Python, some hundred times slower: pip install impact-rig[jit]", name
    )
    return CompiledForce(_callback_one(function), _callback_at_stages(function))


def _callback_one(function: ForceFunction) -> Pointer:
    """Return a callback with the convention of compiled code: what does not fit registers is written where told."""
    results = 5 * ctypes.c_double

    def one(out: Any, *numbers: float) -> int:
        out.contents[:] = 5 * [math.nan]  # where the function raises: the contact then fails instead of going on
        out.contents[:] = function(*numbers)
        return ctypes.addressof(out.contents)

    return _pointer(ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(results), *6 * (ctypes.c_double,))(one))


def _callback_at_stages(function: ForceFunction) -> Pointer:
    inner = at_stages_of(function)

    def at_stages(parameters: Any, per_v0: float, step: Any) -> None:
        step.contents.force[:] = STAGES * [math.nan]
        inner(parameters.contents, per_v0, step.contents)

    layout: Any = np.ctypeslib.as_ctypes_type
    parameters, step = ctypes.POINTER(layout(PARAMETERS)), ctypes.POINTER(layout(PRESS))
    return _pointer(ctypes.CFUNCTYPE(None, parameters, ctypes.c_double, step)(at_stages))


def _pointer(callback: Any) -> Pointer:
    address = ctypes.cast(callback, ctypes.c_void_p).value
    assert address is not None
    return Pointer(address, callback)
