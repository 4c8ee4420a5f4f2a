# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""A law's force, compiled: function pointers of one type whatever the law, so that one event loop calls them all."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, NamedTuple

from numba import cfunc, from_dtype, njit
from numba.core import config, types

from impact_rig.physics.collocation import STAGES
from impact_rig.physics.contact.law import ForceFunction
from impact_rig.physics.parameters import PARAMETERS
from impact_rig.physics.state import PRESS
from impact_rig.system.compiled import content_stamp  # finds what was compiled from these sources

_ONE = types.UniTuple(types.float64, 5)(*6 * (types.float64,))  # type: ignore[attr-defined]  # made on demand
_AT_STAGES = types.void(from_dtype(PARAMETERS), types.float64, from_dtype(PRESS))


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
    return CompiledForce(cfunc(_ONE, cache=True)(function), cfunc(_AT_STAGES, cache=True)(at_stages))
