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
"""Share of a core and memory used by a process."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path


def cpu_share(pid: int) -> Callable[[], float]:
    """Return a function that returns the share of a core that a process has used since now, user and system [%]."""

    def used_s() -> float:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    before, began = used_s(), time.monotonic()
    return lambda: 100.0 * (used_s() - before) / (time.monotonic() - began)


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process, shared libraries included [MB]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    (size_kb,) = (line.split()[1] for line in lines if line.startswith("VmRSS:"))
    return float(size_kb) / 1024.0
