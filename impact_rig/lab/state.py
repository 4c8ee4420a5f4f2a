# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What state a rig is in, in one word and one sentence, of what its nodes say about themselves."""

from __future__ import annotations

from collections.abc import Mapping

import attrs

DEAD_S = 4.0
"""A rig that has said nothing for so long is not there."""


@attrs.frozen
class Heard:
    """What was heard of a rig.

    Attributes:
        ended: how its process ended; empty: it runs, or is none of ours.
        age_s: since it last said something; None: it never did.
        message: what it says, in one sentence.
        level: of that, 0 fine, 1 warning, 2 error.
        figures: of its diagnostics.
        tripped: what latched the shaker, by the journal; it is faster than the diagnostics.
        plucked: whether the base is locked after a pluck.
        settled: whether something has settled since the last change.
    """

    ended: str = ""
    age_s: float | None = None
    message: str = ""
    level: int = 0
    figures: Mapping[str, str] = attrs.field(factory=dict)
    tripped: str = ""
    plucked: bool = False
    settled: bool = False


def judge(heard: Heard) -> tuple[str, str]:
    """Return word and sentence; the gravest comes first."""
    if heard.ended:
        return "dead", f"The rig is gone: {heard.ended}."
    if heard.age_s is None:
        return "starting", "Waiting for the rig."
    if heard.age_s > DEAD_S:
        return "dead", f"Nothing was heard of the rig for {heard.age_s:.0f} s."
    figures, message = heard.figures, heard.message
    if "rig_time_s" not in figures:
        if message.startswith("compiling"):
            return "compiling", f"{message[:1].upper()}{message[1:]}: the first start on a machine takes a while."
        return "starting", f"Not running yet: {message}."
    latched = figures.get("latched", "")
    if latched or heard.tripped:
        return (
            "tripped",
            f"The shaker is latched by {(latched or heard.tripped).replace('_', '-')}; its current is zero.",
        )
    if "silent for" in message or "waiting for peer" in message or "other publishers" in message:
        return "silent", message[:1].upper() + message[1:] + "."
    if "paused" in message:
        return "paused", "Rig time stands still."
    if heard.plucked:
        return "plucked", "Base locked, structure swings freely; reset unlocks it."
    if float(figures.get("current_a", "0") or 0) == 0.0:
        return "at rest", "The shaker is at rest: press R for 9.1 Hz, 0.52 A."
    aside = f" ({message})" if heard.level >= 1 else ""
    if heard.settled:
        return "driving", f"Settled: the measurement below holds.{aside}"
    return "settling", f"Waiting until the transient has died.{aside}"
