# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a tracker hands out: what it found in a call, and what it has counted so far."""

from __future__ import annotations

import attrs

from impact_rig.blocks import Table


@attrs.define
class Counters:
    """What a tracker has seen so far; for diagnostics."""

    scans: int = 0
    lost_scans: int = 0
    duplicate_scans: int = 0
    unconfigured_scans: int = 0
    restarts: int = 0
    late_events: int = 0
    measurements: int = 0
    refusals: int = 0
    impacts: int = 0


@attrs.frozen
class State:
    """What a measurement does now, decided from scans and commands alone: the same live and from a recorded run.

    Attributes:
        word: of `states.Analysis`.
        reason: a status of `transmissibility/table`; empty where the word says it all.
        since_ns: rig time at which it began; None before the first scan.
    """

    word: str
    reason: str = ""
    since_ns: int | None = None


@attrs.frozen(eq=False)
class Findings:
    """What one call found: `transmissibility/table` tables of one row each, and tables of detected impacts."""

    measurements: tuple[Table, ...] = ()
    impacts: tuple[Table, ...] = ()
