# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Callbacks of every node: guarded, so that an exception is reported and never fatal.

A callback exception ends a plain rclpy process. Here it becomes an error in the log and in diagnostics, and the node
goes on.
"""

from __future__ import annotations

import functools
import traceback
from collections import Counter
from collections.abc import Callable
from typing import Any  # callbacks and service responses have no common type

import attrs
from rcl_interfaces.msg import SetParametersResult

from impact_rig.errors import ImpactRigError

Report = Callable[[str, str], None]
"""What to do with a failure: (where, message)."""


@attrs.define
class Refusals:
    """Inputs that were refused: how often, by reason, and the last message of each reason."""

    counts: Counter[str] = attrs.field(factory=Counter)
    last: dict[str, str] = attrs.field(factory=dict)

    def add(self, reason: str, message: str) -> None:
        """Count one refusal."""
        self.counts[reason] += 1
        self.last[reason] = message

    def total(self) -> int:
        """Return the number of all refusals."""
        return sum(self.counts.values())


def guarded(callback: Callable[..., Any], report: Report) -> Callable[..., Any]:
    """Return `callback` with its exceptions reported instead of raised, and its arguments as `with_info` has them."""

    @functools.wraps(callback)
    def safe(*args: Any) -> Any:
        try:
            return callback(*_each(args))
        except Exception as error:  # the whole point: nothing a callback raises may end the process
            report(_name(callback), describe(error))
            return None

    return safe


def with_info(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Return a subscription callback that gets (message, info) from every executor.

    Jazzy's events executor passes both as one tuple, the others as two arguments. rclpy looks at the signature to
    decide whether info is wanted: `wraps` keeps it.
    """

    @functools.wraps(callback)
    def call(*args: Any) -> Any:
        return callback(*_each(args))

    return call


def _each(args: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the arguments one by one, also where an executor passed them as one tuple."""
    return args[0] if len(args) == 1 and type(args[0]) is tuple else args


def guarded_answer(callback: Callable[[Any, Any], Any], refuse: Callable[[str], None]) -> Callable[[Any, Any], Any]:
    """Return a callback of any service, rclpy's own included, that answers a request it cannot digest with a refusal.

    A parameter of a type that does not exist, for one, raises in rclpy's parameter services.
    """

    @functools.wraps(callback)
    def safe(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:  # see `guarded`
            message = describe(error)
            refuse(message)
            no = SetParametersResult(successful=False, reason=message)
            if hasattr(response, "results"):
                response.results += [no] * (len(request.parameters) - len(response.results))
            elif hasattr(response, "result") and isinstance(response.result, SetParametersResult):
                response.result = no
            return response

    return safe


def describe(error: BaseException) -> str:
    """Return one line for people: type, message and where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename.rsplit('/', 1)[-1]}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"


def in_words(error: BaseException) -> str:
    """Return why something was refused: our own errors say it in their words, what is unexpected is described."""
    return str(error) if isinstance(error, ImpactRigError) else describe(error)


def _name(callback: Callable[..., Any]) -> str:
    while isinstance(callback, functools.partial):
        callback = callback.func
    return getattr(callback, "__name__", type(callback).__name__).lstrip("_")
