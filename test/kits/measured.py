# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Which programs that tests start are measured for coverage: those that ask to be.

The tracer takes half of a program's time, and most of them pass through what the tests' own process passes through line
by line. Measured are those that alone reach something: kernels as plain Python, the nodes' and workers' beginnings.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

_HELD: dict[str, str] = {}


def hold_back() -> None:
    """Take out of this process's environment what makes a child of it measure its coverage."""
    for name in [name for name in os.environ if name.startswith("COVERAGE_PROCESS_")]:
        _HELD[name] = os.environ.pop(name)


def measured(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return an environment (this process's) whose children are measured, if this process is."""
    return {**environment, **_HELD}
