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
"""What a contact law is: a name, its origin, a restitution, and a force that every phase of the motion can use.

A law says its force in a plain function of numbers, which is compiled when it is first used, and the numbers that
function is called with in a `Force`:

    force(stiffness, factor, per_v0, turned_at, w, speed) -> (elastic, lossy, stored, ∂F/∂w, ∂F/∂δ')
    F = elastic + lossy

    w          √δ [m^0.5], the variable in which contacts are integrated
    speed      δ' [m/s], positive while the indentation grows
    turned_at  the largest w so far [m^0.5] once the indentation has shrunk from there, 0 on the first way in and beyond
               that largest w: a law with a memory has one branch for each
    per_v0     1 / approach speed of this contact, floored [s/m]
    elastic    the part of F [N] that the stored energy gives back
    lossy      the rest: lossy · δ' [W] is what the contact loses at this instant
    stored     that energy [J], ∫ elastic dδ; what is left of it where the contact ends is lost

On either branch the force must be smooth in w and δ', also a little beyond w = 0, where a step may try it.
Nothing else of the package asks which law it is: kernels call a force by function pointers of one type, those of
`CompiledForce`. The forces of the package's own laws are in the library. That of a law from elsewhere is compiled by
Numba where it is installed, and its address handed over; without Numba the library calls back into plain Python.
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
from impact_rig.kernels import Exported, Fields, Function, Pointer, RecordType
from impact_rig.physics.collocation import STAGES
from impact_rig.physics.state import CONTACT_STEP, PARAMETERS, POINT

ForceFunction = Callable[[float, float, float, float, float, float], tuple[float, float, float, float, float]]


class Force(NamedTuple):
    """A law's force for one pair of bodies.

    Attributes:
        function: see above.
        stiffness: its first argument, K of F ~ K δ^exponent [N/m^exponent].
        factor: its second argument, by law: a [-], c [N s/m] or e² [-].
        exponent: of the indentation, for the scales of a contact.
        restitution: nominal; what a rigid law rebounds with.
        lets_go: whether the contact ends where the force would pull; otherwise it pulls, and the contact ends at δ = 0.
        scale_free: whether every contact is the same in units of its own: `factor` has no dimension.
        remembers: whether the force depends on `turned_at`; such a law may ring undamped, and is averaged once slow.
        rigid: whether a contact takes no time, and the force is never asked for.
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
    """The two bodies that meet: Hertz stiffness [N/m^1.5] and effective mass [kg]."""

    hertz_stiffness: float
    effective_mass: float


LEAST_RESTITUTION = 0.01
"""A sphere dropped from 1 m rebounds by e², 0.1 mm then: a drop test measures no less, and a smaller e says that the
bodies stick, which no law here models. The tests hold the laws from here on."""


def restitution() -> Any:
    """Return the attrs field of the nominal coefficient of restitution e."""
    about = "Coefficient of restitution e of the drop test."
    return quantity(0.35, "-", about, Origin.PAPER, at_least=LEAST_RESTITUTION, at_most=1)


@attrs.frozen
class ContactLaw:
    """A contact law; its fields are the values of the configuration's `contact` section that it reads.

    A field that the section has not got, made by `impact_rig.config.fields`, becomes a part of it.

    Attributes:
        name: by which it is chosen.
        formula: its row in the table of laws, without `|`.
        source: who published it, where.
        returns: the restitution it gives for a nominal 0.35, to three digits.
        adjustable: whether `calibration: exact` puts the law `exact` in its place.
    """

    name: ClassVar[str]
    formula: ClassVar[str]
    source: ClassVar[str]
    returns: ClassVar[float]
    adjustable: ClassVar[bool] = False
    restitution: float = restitution()

    def force(self, pair: ContactPair) -> Force:
        """Return the force between the bodies of `pair`."""
        raise NotImplementedError

    def realised_restitution(self) -> float:
        """Return the restitution this law really gives, from its closed form."""
        raise NotImplementedError


AT_POINT = Function((RecordType(PARAMETERS), *4 * (float,), RecordType(CONTACT_STEP)), None)
AT_STAGES = Function((RecordType(PARAMETERS), float, RecordType(CONTACT_STEP)), None)


class CompiledForce(NamedTuple):
    """A law's force as function pointers.

    Attributes:
        at_point: called with (parameters, per_v0, turned_at, w, speed, step), fills the step's `point` with what the
            law's function returns.
        at_stages: called with (parameters, per_v0, step), fills the step's force, lossy, force_by_w, force_by_speed.
    """

    at_point: Any
    at_stages: Any


FORCE = Fields(CompiledForce, (AT_POINT, AT_STAGES))


def at_point_of(force: Any) -> Any:
    """Return the function that evaluates a force at one point."""

    def at_point(p, per_v0, turned_at, w, speed, step):  # type: ignore[no-untyped-def]  # compiled: types are declared
        elastic, lossy, stored, by_w, by_speed = force(p.stiffness, p.factor, per_v0, turned_at, w, speed)
        point = step.point
        point[0], point[1], point[2], point[3], point[4] = elastic, lossy, stored, by_w, by_speed

    return at_point


def at_stages_of(force: Any) -> Any:
    """Return the function that evaluates a force at the stages of a step."""

    def at_stages(p, per_v0, step):  # type: ignore[no-untyped-def]  # compiled: types are declared
        for i in range(STAGES):
            elastic, lossy, _, by_w, by_speed = force(
                p.stiffness, p.factor, per_v0, step.turned_at, step.w[i], step.speed[i]
            )
            step.force[i], step.lossy[i] = elastic + lossy, lossy
            step.force_by_w[i], step.force_by_speed[i] = by_w, by_speed

    return at_stages


def declare(function: ForceFunction) -> None:
    """Let the library hold a law's force."""
    kernels.exported[f"{name_of(function)}.at_point"] = Exported(function, AT_POINT, at_point_of)
    kernels.exported[f"{name_of(function)}.at_stages"] = Exported(function, AT_STAGES, at_stages_of)


def name_of(function: ForceFunction) -> str:
    """Return the name under which the library holds a force, less `.at_point` or `.at_stages`."""
    return f"force.{function.__module__}.{function.__qualname__}"


@functools.cache
def compiled_force(function: ForceFunction) -> CompiledForce:
    """Return a law's force as the kernels of this process take it."""
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
        "the contact force %s runs as plain Python, some hundred times slower: pip install impact-rig[jit]", name
    )
    return CompiledForce(*(_callback(around(_reported(function, name)), kind) for around, kind in parts))


def _reported(force: ForceFunction, name: str) -> ForceFunction:
    """Return a force whose exceptions say that they are its own."""

    def reported(*numbers: float) -> tuple[float, float, float, float, float]:
        try:
            return force(*numbers)
        except Exception as error:
            raise SimulationError(f"the contact force {name} raised {type(error).__name__}: {error}") from error

    return reported


def _finite(force: Any) -> Any:
    """Return a compiled force that returns NaN where it raises, which ends the contact and the run."""

    def finite(stiffness, factor, per_v0, turned_at, w, speed):  # type: ignore[no-untyped-def]
        elastic = lossy = stored = by_w = by_speed = math.nan
        try:
            elastic, lossy, stored, by_w, by_speed = force(stiffness, factor, per_v0, turned_at, w, speed)
        except Exception:  # Numba knows no other
            elastic = math.nan
        return elastic, lossy, stored, by_w, by_speed

    return finite


_raised: list[BaseException] = []
"""What a callback raised: it cannot pass through compiled code, so `raise_failure` raises it afterwards."""


def raise_failure() -> None:
    """Raise what a contact force in plain Python has raised while compiled code called it."""
    if _raised:
        raise _raised.pop()


def _callback(function: Callable[..., None], kind: Function) -> Pointer:
    """Return a pointer to a Python function, its records handed over by address; the last of them is the step."""
    layout: Any = np.ctypeslib.as_ctypes_type
    types: list[Any] = [
        ctypes.POINTER(layout(one.dtype)) if isinstance(one, RecordType) else ctypes.c_double for one in kind.arguments
    ]

    def called(*arguments: Any) -> None:
        given = [getattr(one, "contents", one) for one in arguments]
        if not _raised:
            try:
                return function(*given)
            except BaseException as error:  # ctypes would print it and go on
                _raised.append(error)
        given[-1].point[:], given[-1].force[:] = POINT * [math.nan], STAGES * [math.nan]  # ends the contact
        return None

    callback = ctypes.CFUNCTYPE(None, *types)(called)
    address = ctypes.cast(callback, ctypes.c_void_p).value
    assert address is not None
    return Pointer(address, function, callback)
