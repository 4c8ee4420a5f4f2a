# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""How a client waits: its executor spins in the caller's thread, and only the time spent waiting counts."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any  # executors have no common type

from impact_rig.errors import GoneError, ImpactRigError

SPIN_S = 0.1
GONE_S = 2.0
"""A rig that says nothing for so long is gone: it reports once a second, whatever it does."""
DIAGNOSTICS_PERIOD_S = 1.0
LOOK_S = 0.05
"""What has arrived while nobody spun is handed over in this time."""


class WaitTimeoutError(ImpactRigError, TimeoutError):
    """Something awaited did not happen in time."""


Check = Callable[[], None]
"""Raises when there is nothing to wait for any more."""


def patiently() -> None:
    """Wait as long as there is time."""


class RigGoneError(GoneError):
    """The rig that something was given to is gone, by itself or for another one: it was not done, and will not be."""


class Activation:
    """Which rig a client speaks to: the activation it heard of last, and when.

    A command belongs to the rig it was given to. Whoever waits for one to be carried out asks `given` first: what that
    returns raises as soon as the rig is gone.

    Args:
        clock: seconds, monotonic.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._instance = ""
        self._heard_at = -math.inf
        self._from_ns = 0
        self._is_there = self._is_gone = False

    @property
    def is_overdue(self) -> bool:
        """Whether a rig that was heard has not been heard for a while."""
        return self._is_there and self._clock() - self._heard_at > DIAGNOSTICS_PERIOD_S

    def heard(self, instance: str, sent_ns: int) -> None:
        """Take the instance in a rig's diagnostics, and when they were sent (system time)."""
        if sent_ns >= self._from_ns:
            self._instance, self._heard_at = instance, self._clock()
            self._is_there, self._is_gone = True, False

    def changed(self) -> None:
        """Take the next rig that is heard for the one that is meant: the user has just seen that it is there."""
        self._instance, self._from_ns = "", time.time_ns()
        self._is_there, self._is_gone = True, False

    def given(self, what: str, silence_s: float = GONE_S) -> Check:
        """Return what raises once the rig that is there now is gone.

        Args:
            what: was given to it, for the message.
            silence_s: how long it may say nothing.
        """
        instance, since = self._instance, self._clock()

        def check() -> None:
            nonlocal instance
            instance = instance or self._instance
            if instance != self._instance:
                raise RigGoneError(f"{what}: the rig it was given to is gone, and another one has begun")
            silent = self._is_there and self._clock() - max(self._heard_at, since) > silence_s
            self._is_gone |= silent
            if self._is_gone:
                raise RigGoneError(f"{what}: the rig it was given to is gone, nothing was heard of it for {GONE_S:g} s")

        return check


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
