# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a node says about itself on `/diagnostics`."""

from __future__ import annotations

import enum
import time
from collections.abc import Callable, Mapping

import attrs
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from impact_rig.nodes.messages import time_message


class Level(enum.IntEnum):
    """Levels of `diagnostic_msgs/DiagnosticStatus`, in order of gravity."""

    OK = 0
    WARN = 1
    ERROR = 2


@attrs.frozen
class State:
    """What a node does, in one word of `impact_rig.states`.

    Attributes:
        word: the gravest that is true.
        reason: why, for people; empty where the word says it all.
        since_ns: rig time at which it began; None: when the node came to say so.
    """

    word: enum.StrEnum
    reason: str = ""
    since_ns: int | None = None


@attrs.frozen
class Health:
    """How one node is, for people: level, one sentence, figures."""

    level: Level
    message: str
    values: Mapping[str, object]


@attrs.define
class CpuMeter:
    """Share of one core this process used since the last call [%]."""

    clock: Callable[[], float] = time.monotonic
    used: Callable[[], float] = time.process_time
    _last: tuple[float, float] | None = None

    def percent(self) -> float:
        """Return the share since the last call; 0 at the first."""
        now = (self.clock(), self.used())
        before, self._last = self._last, now
        if before is None or now[0] <= before[0]:
            return 0.0
        return 100.0 * (now[1] - before[1]) / (now[0] - before[0])


def worst(*statuses: tuple[Level, str]) -> tuple[Level, str]:
    """Return the gravest of several (level, message), messages of that level joined; ("OK", "") gives OK."""
    level = max((found for found, _ in statuses), default=Level.OK)
    messages = [message for found, message in statuses if found == level and message]
    return level, "; ".join(messages)


def to_message(name: str, hardware: str, status: Health, stamp_ns: int) -> DiagnosticArray:
    """Return the message for one status."""
    values = [KeyValue(key=key, value=_text(value)) for key, value in status.values.items()]
    message = DiagnosticArray()
    message.header.stamp = time_message(stamp_ns)
    message.status = [
        DiagnosticStatus(
            level=bytes([status.level]),
            name=name,
            message=status.message,
            hardware_id=hardware,
            values=values,
        )
    ]
    return message


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
