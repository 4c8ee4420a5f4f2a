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
"""Environments in which the libraries assume an older CPU, and the means to verify that they do."""

from __future__ import annotations

import os
from collections.abc import Callable

import attrs

from qualification.portability.machine import Machine, numpy_features

NUMPY = {"NPY_DISABLE_CPU_FEATURES": " ".join(numpy_features())}  # only those of the CPU: NumPy rejects others
GLIBC = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2_Usable,-FMA_Usable,-AVX2,-FMA,-AVX512F"}
LLVM = {"IMPACT_RIG_KERNELS": "jit", "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}


@attrs.frozen
class Mask:
    """An environment, and whether it shows in a machine (masked, unmasked); `recompiles` if Numba's code changes."""

    name: str
    environment: dict[str, str]
    held: Callable[[Machine, Machine], bool]
    recompiles: bool = False

    def verdict(self, masked: Machine, bare: Machine) -> str:
        """Return `yes`, `NO`, or that this CPU has no such feature."""
        if not self.held(masked, bare):
            return "NO"
        return "nothing to mask" if attrs.evolve(masked, llvm=bare.llvm) == bare and not self.recompiles else "yes"


def full_environment(mask: Mask) -> dict[str, str]:
    """Return the environment of a process under this mask and no other."""
    others = ALL.environment.keys()
    return {name: value for name, value in os.environ.items() if name not in others} | mask.environment


def _openblas(*names: str) -> Callable[[Machine, Machine], bool]:
    return lambda masked, bare: set(masked.openblas.values()) <= set(names)


def _glibc(masked: Machine, bare: Machine) -> bool:
    """Compare the functions in use; without FMA, AVX2 or FMA4 there is only one variant and no difference."""
    return masked.glibc != bare.glibc or not bare.vectors


BARE = Mask("none", {}, lambda masked, bare: masked == bare)
# one kernel, two names
PRESCOTT = Mask("openblas-prescott", {"OPENBLAS_CORETYPE": "Prescott"}, _openblas("Prescott", "Katmai"))
HASWELL = Mask("openblas-haswell", {"OPENBLAS_CORETYPE": "Haswell"}, _openblas("Haswell"))
LLVM_GENERIC = Mask(
    "llvm-generic", LLVM, lambda masked, bare: masked.llvm == ["generic", ""] and not masked.vectors, recompiles=True
)
NUMPY_BASELINE = Mask("numpy-baseline", NUMPY, lambda masked, bare: masked.numpy == [])
GLIBC_BASELINE = Mask("glibc-baseline", GLIBC, _glibc)
LIBRARIES = Mask(
    "libraries",
    PRESCOTT.environment | NUMPY | GLIBC,
    lambda masked, bare: all(one.held(masked, bare) for one in (PRESCOTT, NUMPY_BASELINE, GLIBC_BASELINE)),
)
"""All masks that need no other compiled code, quick enough for every test run."""
ALL = Mask(
    "all",
    LIBRARIES.environment | LLVM,
    lambda masked, bare: LIBRARIES.held(masked, bare) and LLVM_GENERIC.held(masked, bare),
    recompiles=True,
)

MASKS = (PRESCOTT, HASWELL, LLVM_GENERIC, NUMPY_BASELINE, GLIBC_BASELINE, LIBRARIES, ALL)
