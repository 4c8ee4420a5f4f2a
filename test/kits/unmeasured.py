# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The environment of programs that coverage need not follow: it takes half of their time, and they are slow as it is.

For whole runs of what other tests pass through line by line: examples, the guide, the notebook, compiled code.
"""

from __future__ import annotations

import os
from collections.abc import Mapping


def unmeasured(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return an environment (this process's) without what makes a child of it measure its coverage."""
    return {key: value for key, value in environment.items() if not key.startswith("COVERAGE_")}
