# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""How a client waits: its executor spins in the caller's thread, and only the time spent waiting counts."""

from __future__ import annotations

import time
from typing import Any  # executors have no common type

from impact_rig.errors import ImpactRigError

SPIN_S = 0.1


class WaitTimeoutError(ImpactRigError, TimeoutError):
    """Something awaited did not happen in time."""


class Spinner:
    """Spins an executor and keeps the time.

    Args:
        executor: of the client and the nodes it hosts.
    """

    def __init__(self, executor: Any) -> None:
        self._executor = executor
        self._working_s = 0.0

    def waited_s(self) -> float:
        """Return a time [s] that stands still while a hosted node is at work in a callback: compiling takes minutes."""
        return time.monotonic() - self._working_s

    def spin(self, longest_s: float = SPIN_S) -> None:
        """Let one callback run, or wait for it at most so long [s]."""
        began = time.monotonic()
        self._executor.spin_once(timeout_sec=longest_s)
        self._working_s += max(0.0, time.monotonic() - began - longest_s)
