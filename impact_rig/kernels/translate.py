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
"""Translation of one part of the kernels into linked LLVM code, as a separate process that `build` starts.

This is the only module that uses Numba's internals. Code is made for the oldest supported CPU, and not optimised before
all functions are linked. Each entry gets a wrapper, `int32_t name(uint64_t *in, uint64_t *out)`, that takes the
arguments from slots (see library.c).
"""

from __future__ import annotations

import importlib
import platform
import sys
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import njit
from numba.core import compiler, cpu
from numba.core.codegen import AOTCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target

import impact_rig.kernels as declared
from impact_rig.kernels import OPTIONS, Entry, Exported
from impact_rig.kernels.build import PARTS, symbol
from impact_rig.kernels.build import cpu as plain_cpu
from impact_rig.kernels.header import header
from impact_rig.kernels.jit import numba_type

INSIDE: dict[str, Any] = {**OPTIONS, "_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Numba's options for functions that only kernels call: no wrappers for Python and C, no counting of references.

No references need be counted, because kernels allocate nothing.
"""
NOTHING = -2
"""Status with which a function compiled by Numba reports that it returned None."""
WORD, STATUS = ir.IntType(64), ir.IntType(32)


class Library(AOTCodeLibrary):  # type: ignore[misc]  # Numba is untyped
    """Numba's container for the code of one function, which is not optimised until everything is linked."""

    def _optimize_functions(self, ll_module: Any) -> None:
        pass

    def finalize(self) -> None:
        """Mark the container as complete without linking the functions that it calls; `_linked` links them later."""
        self._finalized = True


class Context(cpu.CPUContext):  # type: ignore[misc]
    """Numba's compilation target, except that functions compiled for it are not loaded into this process."""

    def get_executable(self, _library: Any, _fndesc: Any, _environment: Any) -> Any:
        """Return a unique object instead of an executable function, because nothing is loaded into this process."""
        return [].append


def main() -> None:
    """Translate one part of the kernels.

    The command-line arguments are the name of the part and the folder for the results.
    """
    part, work = sys.argv[1], Path(sys.argv[2])
    for module in PARTS[part]:
        importlib.import_module(f"impact_rig.{module}")
    entries = {name: one for name, one in declared.entries.items() if part_of(name) == part}
    forces = declared.exported if part == "mechanics" else {}
    _let_numba_see_kernels()
    context = cpu_target.target_context.with_aot_codegen("impact_rig_kernels", cpu_name=plain_cpu(platform.machine()))
    context.__class__ = Context
    context.codegen()._library_class = Library
    vars(cpu_target)["_toplevel_target_context"] = context  # also for every function that is called
    libraries: dict[int, Any] = {}
    wanted: list[tuple[str, Entry | Exported]] = [*entries.items(), *forces.items()]
    with global_compiler_lock:
        for done, (name, one) in enumerate(wanted):
            new = work / f"{part}.new"
            new.write_text(f"{done} of {len(wanted)}")
            new.replace(work / f"{part}.progress")  # atomically: it is read meanwhile
            _collect(_translated(context, name, one), libraries)
        names = [name for name, _ in wanted]
        (work / f"{part}.bc").write_bytes(_linked(libraries.values(), {symbol(name) for name in names}).as_bitcode())
    (work / f"{part}.h").write_text(header(entries), encoding="utf-8")
    (work / f"{part}.names").write_text("\n".join(names))


def part_of(name: str) -> str:
    """Return the part of the kernels with this entry: `mechanics` in physics, arithmetic, rig; else `instruments`."""
    return "mechanics" if name.startswith(("physics.", "arithmetic.", "rig.")) else "instruments"


def _let_numba_see_kernels() -> None:
    """Replace every kernel, in all modules that have imported it, by a function that compiled code can call."""
    seen = {function: njit(**INSIDE)(function) for function in declared.kernels}
    for module in [found for name, found in sys.modules.items() if name.startswith("impact_rig.")]:
        for name, value in list(vars(module).items()):
            function = getattr(value, "__wrapped__", value)  # in plain Python, some are wrapped
            if callable(function) and function.__hash__ and function in seen:
                setattr(module, name, seen[function])


def _translated(context: Any, name: str, one: Entry | Exported) -> Any:
    """Translate an entry or exported function, and return Numba's container with its code.

    In the container, the function has its name in C (`symbol`). The container refers to the containers of all functions
    that the function calls.
    """
    flags = compiler.Flags()
    flags.no_cpython_wrapper, flags.no_cfunc_wrapper = True, isinstance(one, Entry)
    flags.nrt, flags.error_model, flags.release_gil = False, str(OPTIONS["error_model"]), True
    if isinstance(one, Entry):
        function, arguments, returns = one
    else:
        function, (arguments, returns) = one.around(njit(**INSIDE)(one.function)), one.type
    types = tuple(map(numba_type, arguments))
    found = compiler.compile_extra(cpu_target.typing_context, context, function, types, numba_type(returns), flags, {})
    if found.signature.return_type != numba_type(returns):
        raise TypeError(f"{name} returns {found.signature.return_type}, but is declared to return {returns}")
    library = context.codegen().create_library(name)
    module = library.create_ir_module(name)
    if isinstance(one, Entry):
        _from_slots(context, module, symbol(name), found.fndesc)
    else:
        _renamed(context, module, symbol(name), found.fndesc)
    library.add_linking_library(found.library)
    library.add_ir_module(module)
    return library


def _from_slots(context: Any, module: Any, name: str, described: Any) -> None:
    """Define in `module` a C function `name` that takes the arguments of a kernel from slots and calls the kernel.

    Slots are words of 64 bits (library.c). The C function gets the address of the slots with the arguments and the
    address of the slots for the results. It returns 0, or the status of a failure. `described` is Numba's description
    of the compiled kernel.
    """
    words = WORD.as_pointer()
    around = ir.Function(module, ir.FunctionType(STATUS, [words, words]), name)
    kind = context.call_conv.get_function_type(described.restype, described.argtypes)
    inner = ir.Function(module, kind, described.llvm_func_name)
    builder = ir.IRBuilder(around.append_basic_block())
    result, failure = (builder.alloca(one.pointee) for one in kind.args[:2])
    values = []
    for i, wanted in enumerate(kind.args[2:]):
        word = builder.load(builder.gep(around.args[0], [WORD(i)]))
        if isinstance(wanted, ir.PointerType):
            values.append(builder.inttoptr(word, wanted))
        elif isinstance(wanted, ir.IntType):
            values.append(builder.trunc(word, wanted) if wanted.width < WORD.width else word)
        else:
            values.append(builder.bitcast(word, wanted))
    status = builder.call(inner, [result, failure, *values])
    returned = builder.load(result)
    parts = [returned]
    if isinstance(returned.type, ir.ArrayType | ir.LiteralStructType):
        parts = [builder.extract_value(returned, i) for i in range(len(returned.type))]
    for i, part in enumerate(parts):
        if isinstance(part.type, ir.IntType):
            wide = builder.zext(part, WORD) if part.type.width < WORD.width else part
            builder.store(wide, builder.gep(around.args[1], [WORD(i)]))
    none = builder.icmp_signed("==", status, STATUS(NOTHING))
    builder.ret(builder.select(none, STATUS(0), status))


def _renamed(context: Any, module: Any, name: str, described: Any) -> None:
    """Define in `module` a C function `name` that calls the C wrapper made by Numba for a compiled function.

    `described` is Numba's description of that function. The new function has a predictable name; Numba's wrapper does
    not.
    """
    kinds = [context.get_value_type(one) for one in described.argtypes]
    kind = ir.FunctionType(context.get_value_type(described.restype), kinds)
    inner = ir.Function(module, kind, described.llvm_cfunc_wrapper_name)
    around = ir.Function(module, kind, name)
    builder = ir.IRBuilder(around.append_basic_block())
    returned = builder.call(inner, around.args)
    builder.ret(returned)


def _collect(library: Any, found: dict[int, Any]) -> None:
    """Add a container of code to `found` (by id), and all containers that it refers to, directly or indirectly."""
    if id(library) not in found:
        found[id(library)] = library
        for one in library._linking_libraries:
            _collect(one, found)


def _linked(libraries: Any, exported: set[str]) -> Any:
    """Link all code into one module of LLVM, in which only the exported names are visible from outside."""
    together = llvm.parse_assembly("")
    for library in libraries:
        for function in library._final_module.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.linkonce_odr:
                function.linkage = "weak_odr"  # otherwise a function without a caller yet would be dropped
        together.link_in(library._final_module)
    for function in together.functions:
        if not function.is_declaration:
            function.linkage = "external" if function.name in exported else "internal"
    for variable in together.global_variables:
        if variable.linkage == llvm.Linkage.common:
            # environments of Numba's callbacks: their long names are most of the library
            variable.linkage = "internal"
    together.verify()
    return together
