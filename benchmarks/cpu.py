# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""How much of a core a process takes."""

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
