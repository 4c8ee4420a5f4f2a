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
"""The C header of the library: every record as a struct, every entry as a function, made from their declarations.

What a field means, and its unit, is the comment beside it in the Python source, on the same line; of a topic's rows it
is what their columns say.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from impact_rig import kernels
from impact_rig.kernels import Array, Fields, Function

NAME = "impact_rig.h"
CONSTANTS = {
    "result[0] of ir_physics_event_loop_run": ("DONE", "NEED_ROOM", "STUCK", "UNSOLVED"),
    "phase of ir_state": ("FREE", "CONTACT", "ATTACHED"),
    "drive_kind of ir_parameters": ("PRESCRIBED", "CURRENT", "VOLTAGE"),
}
"""Words of `event_loop` and `state`, by what they are values of; a test compares them."""
_FIELD = re.compile(r'^\s*\("(\w+)", [^#\n]*?\),?\s*#\s*(.*)$', re.MULTILINE)
_TAKEN = re.compile("static|register|default")
_C = {
    "f8": "double",
    "i8": "int64_t",
    "u8": "uint64_t",
    "i1": "int8_t",
    "u1": "uint8_t",
    "b1": "uint8_t",
    "c16": "double",
}


def header(entries: Mapping[str, kernels.Entry]) -> str:
    """Return the declarations of some entries, and of the records they take."""
    structs: dict[np.dtype[Any], str] = {}
    functions = [_function(name, one, structs) for name, one in sorted(entries.items())]
    declared = "\n".join(_struct(dtype, name) for dtype, name in structs.items())
    return "\n".join([declared, *functions])


def whole(parts: Iterable[str]) -> str:
    """Return the header of the library from the declarations of its parts, which may have records in common."""
    declarations = "\n\n".join(dict.fromkeys(block.strip("\n") for part in parts for block in part.split("\n\n")))
    return f"""\
/* The compiled kernels of impact_rig, for C: made by impact_rig/kernels/header.py. SI units.
 *
 * An array is an address and its rows (columns, layers), in C order. A function returns 0, or the status of a kernel
 * that failed; what the kernel returns is in `result`. What it does stands in its Python: ir_physics_event_loop_run
 * (advance) is `run` of physics.event_loop, ir_physics_sampling_sample and ir_instruments_... likewise.
 * Link with impact_rig.o and -lm.
 */
#ifndef IMPACT_RIG_H
#define IMPACT_RIG_H
#include <stdint.h>

const char *impact_rig_version(void); /* of the package that the kernels are of */
void *impact_rig_address(const char *name); /* of a kernel, 0 where there is none: the two functions of a contact law */

{constants()}

{declarations}
#endif
"""


def constants() -> str:
    """Return the words that kernels use for phases and endings, as enumerations."""
    return "\n".join(
        f"enum {{ {', '.join(f'IR_{word} = {value}' for value, word in enumerate(words))} }}; /* {what} */"
        for what, words in CONSTANTS.items()
    )


def _names() -> Iterator[tuple[np.dtype[Any], str, dict[str, str]]]:
    """Yield every record type with the name it has in its module, and what its fields mean."""
    for module in [found for name, found in sys.modules.items() if name.startswith("impact_rig.")]:
        for name, value in vars(module).items():
            if isinstance(value, np.dtype) and value.names:
                declared = inspect.getsource(module).partition(f"\n{name} = np.dtype(")[2].partition("\n)")[0]
                columns = {one.name: f"{one.doc} [{one.unit}]" for one in vars(module).get(f"{name}_COLUMNS", ())}
                yield value, name.strip("_").lower(), dict(_FIELD.findall(declared)) or columns


def _struct(dtype: np.dtype[Any], name: str) -> str:
    meanings: dict[str, str] = next(found for kind, _, found in _names() if kind is dtype)
    lines = []
    for field in dtype.names or ():
        assert dtype.fields is not None
        kind = dtype.fields[field][0]
        base, shape = kind.base, (*kind.shape, 2) if kind.base.kind == "c" else kind.shape
        size = "".join(f"[{count}]" for count in shape)
        comment = f" /* {meanings[field]} */" if field in meanings else ""
        lines.append(f"    {_C[base.str[1:]]} {_word(field)}{size};{comment}")
    packed = "" if dtype.isalignedstruct else " __attribute__((packed))"
    body = "\n".join(lines)
    return f"""\
typedef struct {{
{body}
}}{packed} ir_{name};
_Static_assert(sizeof(ir_{name}) == {dtype.itemsize}, "layout");
"""


def _function(name: str, one: kernels.Entry, structs: dict[np.dtype[Any], str]) -> str:
    symbol = f"ir_{name.replace('.', '_')}"  # see `build.symbol`
    parameters: list[str] = []
    slots: list[str] = []
    names = one.function.__code__.co_varnames[: one.function.__code__.co_argcount]
    for argument, kind in zip(names, one.arguments, strict=True):
        for part, of in _pieces(argument, kind):
            _append(part, of, parameters, slots, structs)
    results = kernels.codes(one.returns)
    if results:
        parameters.append(f"int64_t result[{len(results)}]")
    out = "(uint64_t *)result" if results else "nothing"
    scratch = "" if results else " nothing[1],"
    return f"""\
extern int32_t {symbol}_slots(uint64_t *in, uint64_t *out);
static inline int32_t {symbol}({", ".join(parameters)})
{{
    union {{ double real; uint64_t word; }} number;
    uint64_t{scratch} in[] = {{{", ".join(slots)}}};
    (void)number;
    return {symbol}_slots(in, {out});
}}
"""


def _word(name: str) -> str:
    """Return a name that C has not taken."""
    return f"{name}_" if _TAKEN.fullmatch(name) else name


def _pieces(name: str, kind: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(kind, Fields):
        for field, inner in zip(kind.of._fields, kind.types, strict=True):  # type: ignore[attr-defined]  # a NamedTuple
            yield from _pieces(f"{name}_{field}", inner)
    else:
        yield name, kind


def _append(name: str, kind: Any, parameters: list[str], slots: list[str], structs: dict[np.dtype[Any], str]) -> None:
    """Append how C passes one piece, and how it goes into slots."""
    if isinstance(kind, Function):
        parameters.append(f"void *{name}")
        slots += [f"(uintptr_t){name}", "0", "0"]
    elif isinstance(kind, Array | np.dtype):
        array = kind if isinstance(kind, Array) else Array(kind)
        dtype = array.dtype
        if dtype.names:
            structs.setdefault(dtype, next(found for of, found, _ in _names() if of is dtype))
        of = f"ir_{structs[dtype]}" if dtype.names else _C[dtype.str[1:]]
        counts = [f"{name}_{what}" for what in ("rows", "columns", "layers")[: array.dimensions]]
        parameters += [f"{of} *{name}", *(f"int64_t {count}" for count in counts)]
        strides = [" * ".join([f"{dtype.itemsize}", *counts[i + 1 :]]) for i in range(len(counts))]
        slots += ["0", "0", " * ".join(counts), f"{dtype.itemsize}", f"(uintptr_t){name}", *counts, *strides]
    elif kind is float:
        parameters.append(f"double {name}")
        slots.append(f"(number.real = {name}, number.word)")
    else:
        parameters.append(f"int64_t {name}")
        slots.append(f"(uint64_t){name}")
