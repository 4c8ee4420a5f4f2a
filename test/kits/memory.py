# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a piece of work leaves behind in memory."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable


def growth(work: Callable[[], object]) -> int:
    """Return by how many bytes more is allocated after `work` than before; NumPy's arrays count."""
    tracemalloc.start()
    try:
        gc.collect()
        before = tracemalloc.get_traced_memory()[0]
        work()
        gc.collect()
        return tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
