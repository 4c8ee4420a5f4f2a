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
"""Generation of machine code for a target from the LLVM code that `translate` writes.

The results are the same on all targets, because no target combines a product and a sum into one rounding.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm

from impact_rig.kernels.build import cpu

WASM = "wasm32"
WASM_FEATURES = "+bulk-memory,+sign-ext,+mutable-globals,+nontrapping-fptoint"
OPTIMISATION = 3


class Target(NamedTuple):
    """Target for which LLVM emits code, in LLVM's terms: triple, CPU, features and relocation model."""

    triple: str
    cpu: str
    features: str = ""
    relocation: str = "pic"


def target(machine: str) -> Target:
    """Return the target for a machine, named as by `platform.machine`, or for `wasm32` (WebAssembly).

    Raises:
        SystemExit: kernels are not supported on such a machine.
    """
    if machine == WASM:
        return Target("wasm32-unknown-unknown", "mvp", WASM_FEATURES, "static")
    system = "apple-macosx11.0" if sys.platform == "darwin" or machine == "arm64" else "unknown-linux-gnu"
    return Target(f"{machine}-{system}", cpu(machine))


def emit(bitcode: Path, machine: str) -> tuple[bytes, str]:
    """Optimise the linked code of one part of the kernels for a machine; return its object file and its assembly.

    `bitcode` is the file that `translate` wrote for the part. `machine` is as in `target`.
    """
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    found = target(machine)
    made = llvm.Target.from_triple(found.triple).create_target_machine(
        cpu=found.cpu, features=found.features, opt=OPTIMISATION, reloc=found.relocation, codemodel="default"
    )
    module = llvm.parse_bitcode(bitcode.read_bytes())
    module.triple, module.data_layout = found.triple, str(made.target_data)
    module.verify()
    for cheap in (True, False):  # inlining first: the pass that removes reference counts works within one function
        manager, builder = _passes(made, cheap)
        manager.run(module, builder)
    return made.emit_object(module), made.emit_assembly(module)


def _passes(machine: Any, cheap: bool) -> tuple[Any, Any]:
    options = llvm.create_pipeline_tuning_options(speed_level=OPTIMISATION)
    options.loop_vectorization = options.slp_vectorization = True  # neither reorders a sum: nothing is marked as fast
    builder = llvm.create_pass_builder(machine, options)
    manager = builder.getModulePassManager()
    if cheap:
        manager.add_loop_rotate_pass()
        manager.add_instruction_combine_pass()
        manager.add_jump_threading_pass()
    manager.add_refprune_pass()
    return manager, builder
