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
"""Identity of the machine and libraries that compute a result: equal identities reproduce it bit for bit.

Floating point differs between machines: BLAS, the C library and compiled code select instructions by the processor.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import numpy as np

from impact_rig import kernels

_DECIDING = ("OPENBLAS_CORETYPE", "GLIBC_TUNABLES", "NPY_DISABLE_CPU_FEATURES")
"""Environment variables that change the arithmetic of a machine."""
_FINGERPRINT_BYTES = 6  # length of a hash: exact as a 64-bit float, the only number type in a table


NOT_INSTALLED = "not installed"


def versions(distributions: Sequence[str]) -> dict[str, str]:
    """Return the installed version of each distribution, by name; `NOT_INSTALLED` if it is missing."""
    return {name: _version(name) for name in distributions}


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:  # optional, or importable without its metadata
        return NOT_INSTALLED


@functools.cache
def identity() -> dict[str, str]:
    """Return properties of this processor, its libraries and settings that determine the last bits of a result."""
    processor = _processor()
    overrides = (f"{name}={os.environ[name]}" for name in _DECIDING if name in os.environ)
    return {
        "processor": processor.get("model name", platform.processor()),
        "processor_features": " ".join(sorted(processor.get("flags", "").split())),
        "overrides": " ".join(overrides),
        "c_library": " ".join(platform.libc_ver()),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "kernels": _version("numba") if kernels.MODE == "jit" else kernels.MODE,
    }


def fingerprint() -> int:
    """Return a hash of `identity` as an integer below 2**48.

    Machines with equal hashes compute the same bits if they run the same code.
    """
    text = "\n".join(f"{name}={value}" for name, value in sorted(identity().items()))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:_FINGERPRINT_BYTES], "big")


def _processor() -> dict[str, str]:
    """Return the lines of /proc/cpuinfo about the first processor, by key such as `model name`; empty without it."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return {}
    parts = (line.partition(":") for line in text.partition("\n\n")[0].splitlines())
    return {name.strip(): value.strip() for name, _, value in parts}
