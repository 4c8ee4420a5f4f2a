# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Which machine and libraries computed a result: on the same ones it can be asked for again bit for bit.

Floating point is not the same everywhere: BLAS, the C library and compiled code choose instructions by the processor.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np

_DECIDING = (
    "NUMBA_CPU_NAME",
    "NUMBA_CPU_FEATURES",
    "OPENBLAS_CORETYPE",
    "GLIBC_TUNABLES",
    "NPY_DISABLE_CPU_FEATURES",
)
"""Environment variables by which the same machine computes as another one."""
_FINGERPRINT_BYTES = 6
"""Of a hash: exact as a 64-bit float, the only number that travels in a table."""


_ASK_LLVM = """
from llvmlite import binding
print(binding.get_host_cpu_name())
print(",".join(sorted(name for name, there in binding.get_host_cpu_features().items() if there)))
"""


@functools.cache
def identity() -> dict[str, str]:
    """Return what decides the last bits of a result, by name."""
    kind, features = _processor_features()
    overrides = (f"{name}={os.environ[name]}" for name in _DECIDING if name in os.environ)
    return {
        "processor": _processor(),
        "processor_kind": kind,
        "processor_features": features,
        "overrides": " ".join(overrides),
        "c_library": " ".join(platform.libc_ver()),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": metadata.version("numba"),
    }


def fingerprint() -> int:
    """Return a number below 2**48 that is the same for the same identity."""
    text = "\n".join(f"{name}={value}" for name, value in sorted(identity().items()))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:_FINGERPRINT_BYTES], "big")


def _processor_features() -> tuple[str, str]:
    """Return what LLVM calls this processor and what it can do, as a process of its own says it: LLVM takes 40 MB."""
    found = subprocess.run([sys.executable, "-c", _ASK_LLVM], capture_output=True, check=True, text=True)  # noqa: S603  # our own
    kind, features = found.stdout.splitlines()
    return kind, features


def _processor() -> str:
    """Return the model of the processor; what Python knows where the system has no /proc/cpuinfo."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.processor()
    )
