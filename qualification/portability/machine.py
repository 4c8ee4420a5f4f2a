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
"""CPU as seen by the four libraries that choose code by it: NumPy, LLVM, OpenBLAS and glibc.

python -m qualification.portability.machine     print it as JSON
"""

from __future__ import annotations

import argparse
import array
import ctypes
import functools
import importlib
import json
import math
import sys
import zlib
from pathlib import Path

import attrs

_CORE_NAMES = tuple(
    f"{prefix}openblas_get_corename{suffix}" for prefix in ("scipy_", "") for suffix in ("64_", "", "_64")
)
_VISIBLE = ("sin", "cos", "tan", "atan")
"""Functions chosen by the loader. exp, log and pow are wrappers, so only their values show which variant was chosen."""
_HIDDEN = {"exp": math.exp, "log": math.log, "pow": functools.partial(math.pow, math.pi)}


@attrs.frozen
class Machine:
    """Properties of the machine by which libraries choose code."""

    numpy: list[str]  # dispatched CPU features that NumPy uses
    llvm: list[str]  # the CPU and the features Numba compiles for
    vectors: bool  # whether compiled arithmetic uses AVX instructions: seen in the machine code itself
    openblas: dict[str, str]  # core that each loaded OpenBLAS chose, by file name
    glibc: dict[str, int]
    """Variants of its functions that libm chose: addresses within the library, or a checksum of values."""


def numpy_features() -> list[str]:
    """Return the dispatched features that NumPy found and uses."""
    import numpy as np  # noqa: PLC0415

    core = "_core" if int(np.__version__.split(".", 1)[0]) >= 2 else "core"
    module = importlib.import_module(f"numpy.{core}._multiarray_umath")
    features = module.__cpu_features__
    return [name for name in module.__cpu_dispatch__ if features[name]]


def this() -> Machine:
    """Inspect this process; this loads and compiles what is needed."""
    import numba  # noqa: PLC0415  # takes seconds, and callers of single functions do not need it
    import numpy as np  # noqa: PLC0415
    import scipy.linalg  # noqa: F401, PLC0415  # brings an OpenBLAS of its own
    from numba.core.registry import cpu_target  # noqa: PLC0415

    compiled = numba.njit("f8(f8, f8)")(lambda x, y: x * y)
    (assembly,) = compiled.inspect_asm().values()
    _, name, features = cpu_target.target_context.codegen().magic_tuple()
    np.linalg.inv(np.eye(2))
    return Machine(
        numpy=numpy_features(),
        llvm=[name, features],
        vectors="vmulsd" in assembly,
        openblas=_openblas_cores(),
        glibc=_libm_variants(),
    )


def _loaded() -> dict[str, int]:
    """Return the files mapped into this process, with the lowest address of each."""
    found: dict[str, int] = {}
    for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
        addresses, *_, path = line.split(maxsplit=5)
        if path.startswith("/"):
            start = int(addresses.split("-")[0], 16)
            found[path] = min(start, found.get(path, start))
    return found


def _openblas_cores() -> dict[str, str]:
    found = {}
    for path in _loaded():
        if "openblas" in Path(path).name:
            library = ctypes.CDLL(path)
            for name in _CORE_NAMES:
                if hasattr(library, name):
                    function = library[name]
                    function.restype = ctypes.c_char_p
                    found[Path(path).name] = function().decode()
                    break
    return found


def _libm_variants() -> dict[str, int]:
    """Return the addresses in libm of the functions that the loader chose for this CPU."""
    libm = ctypes.CDLL("libm.so.6")
    (base,) = (start for path, start in _loaded().items() if Path(path).name.startswith(("libm.so", "libm-2.")))
    variants = {name: (ctypes.cast(libm[name], ctypes.c_void_p).value or 0) - base for name in _VISIBLE}
    for name, function in _HIDDEN.items():
        values = array.array("d", (function(0.5 + 7.5e-6 * k) for k in range(200_000)))
        variants[name] = zlib.crc32(values)
    return variants


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    json.dump(attrs.asdict(this()), sys.stdout)
