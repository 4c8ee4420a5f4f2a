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
"""Base class of contact laws: a name, a source, a restitution, and a force that every phase of the motion can use.

A law defines its force F [N], which pushes sphere and wall apart, as a plain function of numbers. The function is
compiled, in the library or at its first use. Its `Force` holds the constants that are passed to that function:

    force(stiffness, factor, per_v0, turned_at, w, speed) -> (elastic, lossy, stored, ∂F/∂w, ∂F/∂δ')
    F = elastic + lossy

- `w`: √δ [m^0.5] with δ the indentation [m]; contacts are integrated in this variable.
- `speed`: δ' [m/s], positive while the indentation grows.
- `turned_at`: 0 while the contact loads, which means that the indentation grows and is the largest so far. Otherwise
  the largest w so far in this contact [m^0.5]. A law with a memory has one branch for each of the two cases.
- `per_v0`: 1 / approach speed of this contact, with a lower limit of the speed [s/m].
- `elastic`: the part of F that the stored energy gives back [N].
- `lossy`: the rest of F [N]. The contact loses the power lossy · δ' [W].
- `stored`: stored energy ∫ elastic dδ [J]. What is left of it at the end of the contact is lost.

On either branch the force must be smooth in w and δ', also slightly below w = 0. The library contains the forces of the
package's own laws. The force of any other law is compiled by Numba or, without Numba, runs as plain Python.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import logging
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import attrs
import numpy as np

from impact_rig import kernels
from impact_rig.config.fields import Origin, quantity
from impact_rig.errors import SimulationError
from impact_rig.kernels import Exported, Fields, Function, Pointer, Record, RecordType
from impact_rig.physics.collocation import STAGES
from impact_rig.physics.state import CONTACT_STEP, PARAMETERS, POINT

ForceFunction = Callable[[float, float, float, float, float, float], tuple[float, float, float, float, float]]


class Force(NamedTuple):
    """Force function of a contact law, with its constants for one pair of bodies and the properties of its contacts.

    Attributes:
        function: the force function; the docstring of this module lists its arguments and results.
        stiffness: its first argument, K of F ~ K δ^exponent [N/m^exponent].
        factor: its second argument: hysteresis factor a [-], damping c [N s/m] or e² [-], depending on the law.
        exponent: exponent of the indentation δ in F, from which the time scale of a contact follows.
        restitution: nominal restitution; a rigid law rebounds with it.
        lets_go: whether the contact ends as soon as the force would pull. Otherwise the force may pull, and the contact
            ends at δ = 0.
        scale_free: whether contacts of all approach speeds are the same motion in units of approach speed and time
            scale, so that they can be tabulated. This needs a `factor` without dimension.
        remembers: whether the force depends on its argument `turned_at`, the largest w so far unless the contact loads.
            Under such a law, a pressed sphere may oscillate without damping. An oscillation slower than
            `contact.speed_floor_m_s` is replaced by the position of rest.
        rigid: whether a contact takes no time; its force is never evaluated.
    """

    function: ForceFunction
    stiffness: float
    factor: float
    exponent: float
    restitution: float
    lets_go: bool = True
    scale_free: bool = False
    remembers: bool = False
    rigid: bool = False


class ContactPair(NamedTuple):
    """Sphere and superior base as a pair of bodies: their Hertz stiffness [N/m^1.5] and effective mass [kg]."""

    hertz_stiffness: float
    effective_mass: float


LEAST_RESTITUTION = 0.01
"""Lower limit of the nominal restitution e. A sphere dropped from 1 m rebounds to e² m, which is 0.1 mm at this limit.
A drop test measures no less, and with a smaller e the bodies would stick, which no law here models. The tests cover the
laws from this value up.
"""


def restitution() -> Any:
    """Return a new attrs field for the setting `restitution`: the nominal restitution e of the drop test, 0.01 … 1."""
    about = "Coefficient of restitution e of the drop test."
    return quantity(0.35, "-", about, Origin.PAPER, at_least=LEAST_RESTITUTION, at_most=1)


@attrs.frozen
class ContactLaw:
    """Base class of a contact law; its fields are the settings that it reads from a configuration's section `contact`.

    A field that the section lacks is added to it; make such fields with `impact_rig.config.fields`. A subclass defines
    the class attributes and the two methods below. It is registered if its module is in the folder of this module.

    Attributes:
        name: name by which a configuration chooses the law.
        formula: formula of the law in the documentation's table of laws, without `|`.
        source: publication that defines the law.
        returns: restitution that the law really gives for a nominal 0.35, to three digits.
        adjustable: whether the law `exact` is used instead of this one if the setting `calibration` is `exact`.
    """

    name: ClassVar[str]
    formula: ClassVar[str]
    source: ClassVar[str]
    returns: ClassVar[float]
    adjustable: ClassVar[bool] = False
    restitution: float = restitution()

    def force(self, pair: ContactPair) -> Force:
        """Return the law's force function with its constants for one pair of bodies; every law defines this.

        Args:
            pair: Hertz stiffness and effective mass of the two bodies.
        """
        raise NotImplementedError

    def realised_restitution(self) -> float:
        """Return the restitution that this law really gives, without simulating a contact; every law defines this."""
        raise NotImplementedError


AT_POINT = Function((RecordType(PARAMETERS), *4 * (float,), RecordType(CONTACT_STEP)), None)
AT_STAGES = Function((RecordType(PARAMETERS), float, RecordType(CONTACT_STEP)), None)


class CompiledForce(NamedTuple):
    """Force of a contact law as two functions that kernels call: pointers to compiled code, or in mode `plain` Python.

    Attributes:
        at_point: function of (parameters, per_v0, turned_at, w, speed, step) that stores the results of the law's
            function in the step's `point`.
        at_stages: function of (parameters, per_v0, step) that evaluates the law at all stages of the step. It stores
            force, lossy, force_by_w and force_by_speed in the step.
    """

    at_point: Any
    at_stages: Any


FORCE = Fields(CompiledForce, (AT_POINT, AT_STAGES))


def at_point_of(force: Any) -> Any:
    """Return a function that evaluates `force` for one w = √δ and δ' and stores the results in the step's `point`.

    These are elastic and lossy part of F, stored energy, ∂F/∂w and ∂F/∂δ'.
    """

    def at_point(p: Record, per_v0: float, turned_at: float, w: float, speed: float, step: Record) -> None:
        elastic, lossy, stored, by_w, by_speed = force(p.stiffness, p.factor, per_v0, turned_at, w, speed)
        point = step.point
        point[0], point[1], point[2], point[3], point[4] = elastic, lossy, stored, by_w, by_speed

    return at_point


def at_stages_of(force: Any) -> Any:
    """Return a function that evaluates `force` at all stages of a step; it stores F, lossy part, ∂F/∂w, ∂F/∂δ'."""

    def at_stages(p: Record, per_v0: float, step: Record) -> None:
        for i in range(STAGES):
            elastic, lossy, _, by_w, by_speed = force(
                p.stiffness, p.factor, per_v0, step.turned_at, step.w[i], step.speed[i]
            )
            step.force[i], step.lossy[i] = elastic + lossy, lossy
            step.force_by_w[i], step.force_by_speed[i] = by_w, by_speed

    return at_stages


def declare(function: ForceFunction) -> None:
    """Register the force function of one of the package's own laws, so that the kernel library will contain it."""
    kernels.exported[f"{name_of(function)}.at_point"] = Exported(function, AT_POINT, at_point_of)
    kernels.exported[f"{name_of(function)}.at_stages"] = Exported(function, AT_STAGES, at_stages_of)


def name_of(function: ForceFunction) -> str:
    """Return the name under which the kernel library exports a force function, without `.at_point` or `.at_stages`."""
    return f"force.{function.__module__}.{function.__qualname__}"


@functools.cache
def compiled_force(function: ForceFunction) -> CompiledForce:
    """Return a law's force function in the form that the kernels of this process can call.

    The compiled function is taken from the kernel library, or else compiled by Numba. If neither is possible, compiled
    code calls back into plain Python, several hundred times slower, and a warning is logged. In mode `plain`, kernels
    call the Python function itself.
    """
    name, parts = name_of(function), ((at_point_of, AT_POINT), (at_stages_of, AT_STAGES))
    if kernels.MODE == "plain":
        return CompiledForce(*(around(_reported(function, name)) for around, _ in parts))
    if kernels.address(f"{name}.at_point"):
        return CompiledForce(
            *(Pointer(kernels.address(f"{name}.{around.__name__[:-3]}"), around(function)) for around, _ in parts)
        )
    if importlib.util.find_spec("numba"):
        from impact_rig.kernels import jit  # noqa: PLC0415  # Numba is imported where it compiles

        inner = jit.compiled(_finite(jit.compiled(function)))
        found = [jit.pointer(around(inner), kind) for around, kind in parts]
        return CompiledForce(*(one if kernels.MODE == "jit" else Pointer(one.address, one) for one in found))
    logging.getLogger(__name__).warning(
        "the contact force %s runs as plain Python, several hundred times slower than compiled: to compile it, run "
        "pip install impact-rig[jit]",
        name,
    )
    return CompiledForce(*(_callback(around(_reported(function, name)), kind) for around, kind in parts))


def _reported(force: ForceFunction, name: str) -> ForceFunction:
    """Return a function that calls `force` and turns its exceptions into SimulationErrors.

    They quote `name`, the name of the force function as `name_of` gives it.
    """

    def reported(*numbers: float) -> tuple[float, float, float, float, float]:
        try:
            return force(*numbers)
        except Exception as error:
            given = ", ".join(f"{number:.6g}" for number in numbers)
            raise SimulationError(
                f"the contact force {name} raised {type(error).__name__}: {error}, with the arguments {given}"
            ) from error

    return reported


def _finite(force: Any) -> Any:
    """Return a function that calls the compiled `force`; all results are NaN if the call raises an exception.

    The simulation then ends with a SimulationError.
    """

    def finite(
        stiffness: float, factor: float, per_v0: float, turned_at: float, w: float, speed: float
    ) -> tuple[float, float, float, float, float]:
        elastic = lossy = stored = by_w = by_speed = math.nan
        try:
            elastic, lossy, stored, by_w, by_speed = force(stiffness, factor, per_v0, turned_at, w, speed)
        except Exception:  # Numba supports no other kind of except clause
            elastic = math.nan
        return elastic, lossy, stored, by_w, by_speed

    return finite


_raised: list[BaseException] = []
"""Exceptions that plain Python forces raised while compiled code called them. They cannot pass through compiled code,
so `raise_failure` raises them afterwards.
"""


def raise_failure() -> None:
    """Raise a SimulationError if a plain Python contact force raised an exception while compiled code called it.

    A KeyboardInterrupt during such a call is raised as it is. Call this after every kernel that evaluates forces: the
    exception cannot pass through the compiled code.
    """
    if _raised:
        raise _raised.pop()


def _callback(function: Callable[..., None], kind: Function) -> Pointer:
    """Return a pointer of the type `kind` through which compiled code calls a Python function that evaluates a force.

    If the function raises an exception, the forces in its last argument (the record of the step) are set to NaN, which
    ends the contact. `raise_failure` raises the exception later.
    """
    layout: Any = np.ctypeslib.as_ctypes_type
    types: list[Any] = [
        ctypes.POINTER(layout(one.dtype)) if isinstance(one, RecordType) else ctypes.c_double for one in kind.arguments
    ]

    def called(*arguments: Any) -> None:
        given = [getattr(one, "contents", one) for one in arguments]
        if not _raised:
            try:
                return function(*given)
            except BaseException as error:  # ctypes would only print it and continue
                _raised.append(error)
        given[-1].point[:], given[-1].force[:] = POINT * [math.nan], STAGES * [math.nan]  # ends the contact
        return None

    callback = ctypes.CFUNCTYPE(None, *types)(called)
    address = ctypes.cast(callback, ctypes.c_void_p).value
    assert address is not None
    return Pointer(address, function, callback)
