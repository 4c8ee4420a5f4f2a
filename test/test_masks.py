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
"""A mask without effect proves nothing: each is detected in the process that has it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))  # the tool is no part of the package

from qualification.portability.machine import Machine  # noqa: E402
from qualification.portability.masks import (  # noqa: E402
    ALL,
    BARE,
    GLIBC_BASELINE,
    HASWELL,
    LLVM_GENERIC,
    MASKS,
    NUMPY_BASELINE,
    PRESCOTT,
    Mask,
    full_environment,
)


def machine(mask: Mask) -> Machine:
    command = [sys.executable, "-m", "qualification.portability.machine"]
    done = subprocess.run(command, cwd=ROOT, env=full_environment(mask), check=True, capture_output=True, text=True)
    return Machine(**json.loads(done.stdout))


@pytest.fixture(scope="module")
def bare() -> Machine:
    return machine(BARE)


@pytest.fixture(scope="module")
def masked() -> Machine:
    """With all masks at once, each library is queried."""
    return machine(ALL)


def test_numpy_uses_its_baseline_under_all_masks(masked: Machine) -> None:
    assert masked.numpy == []


def test_llvm_compiles_for_a_cpu_without_vectors(masked: Machine) -> None:
    """The target that Numba hands to LLVM, and the machine code that comes back."""
    assert masked.llvm == ["generic", ""]
    assert not masked.vectors


def test_every_openblas_uses_its_oldest_core(masked: Machine) -> None:
    assert PRESCOTT.held(masked, masked)
    assert masked.openblas, "neither NumPy nor SciPy has an OpenBLAS: this mask proves nothing here"


def test_glibc_uses_other_functions_under_the_masks(masked: Machine, bare: Machine) -> None:
    """On a CPU with FMA, sin has another address in libm, and exp, log and pow (wrappers) give other last bits."""
    if not bare.vectors:
        pytest.skip("this CPU has no AVX: glibc has nothing to choose from")
    assert masked.glibc.keys() == bare.glibc.keys()
    assert all(masked.glibc[name] != bare.glibc[name] for name in ("sin", "cos", "exp", "log", "pow"))


@pytest.mark.slow  # `make portability` verifies a mask before it trusts it
@pytest.mark.parametrize("mask", [HASWELL, LLVM_GENERIC, NUMPY_BASELINE, GLIBC_BASELINE], ids=lambda mask: mask.name)
def test_each_mask_takes_effect_by_itself(mask: Mask, bare: Machine) -> None:
    assert mask.verdict(machine(mask), bare) != "NO"


@pytest.mark.parametrize("mask", MASKS, ids=lambda mask: mask.name)
def test_a_mask_without_effect_is_detected(mask: Mask, bare: Machine) -> None:
    """An unmasked machine passes for a masked one only if its CPU has nothing to hide."""
    assert mask.verdict(bare, bare) in ("NO", "nothing to mask")
