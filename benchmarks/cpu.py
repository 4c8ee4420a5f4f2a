# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a process takes of a core and of memory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path


def cpu_share(pid: int) -> Callable[[], float]:
    """Return a function that says how much of a core a process has taken since now, user and system [%]."""

    def used_s() -> float:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    before, began = used_s(), time.monotonic()
    return lambda: 100.0 * (used_s() - before) / (time.monotonic() - began)


def resident_mb(pid: int) -> float:
    """Return what a process holds in memory, shared libraries included [MB]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    (size_kb,) = (line.split()[1] for line in lines if line.startswith("VmRSS:"))
    return float(size_kb) / 1024.0
