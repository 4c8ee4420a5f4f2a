# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`Job`: one run of a reset rig, the unit that is measured, stored and never repeated.

A job begins with a reset rig and a new analysis, so it depends on nothing but its own values: it gives the same bits in
this process, in another one, on another machine of the same kind, through ROS, and after an interruption. Single points
are jobs of one frequency; a sweep that keeps the rig's state from point to point is one job of many.

All jobs of one seed are the *same rig*: `daq.seed` draws the instruments' calibration errors, which in a laboratory
stay what they are from run to run. So a job takes the campaign's seed as it is. A seed of its own for every point would
give every point other instruments, and reductions would carry errors that are common, and cancel, in reality.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.settings import TrackerSettings
from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.campaign.axes import NO_SPHERE
from impact_rig.config.tree import Value
from impact_rig.operate.plan import Direction, Plan
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.journal import not_default
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S

LOOKS_PER_S = 4
"""The operator looks at the measurements this often, in rig time, and commands then: part of a job's definition,
because in a sweep it decides when the next frequency begins."""
MAX_BLOCK_SCANS = 4000  # so that a block of truth fits a message
DWELL_FACTOR = 2.5
"""A point may take this many times the analysis's own bound before it is given up."""
TRACE_BLOCKS = 2
"""Blocks that are kept as a trace after the last measurement."""


@attrs.frozen(kw_only=True)
class Job:
    """One run.

    Attributes:
        changes: configuration values that differ from the default rig, by dotted name.
        analysis: settings of the measurement that differ from `TrackerSettings`.
        gap_m: the operator's label: gap, or `NO_SPHERE`.
        frequencies_hz: points.
        direction: order in which a job of several points visits them.
        current_a: peak current.
        repetitions: settled measurements per point, one after the other.
        traces: keep scans and truth after the last measurement as well.
    """

    changes: Mapping[str, Value]
    analysis: Mapping[str, Value]
    gap_m: float
    frequencies_hz: tuple[float, ...]
    direction: Direction
    current_a: float
    repetitions: int
    traces: bool

    def config(self) -> RigConfig:
        """Return the rig's configuration; one block from one look to the next.

        Raises:
            ConfigError: a value is wrong.
        """
        config = from_flat(RigConfig(), self.changes)
        scans = max(1, min(config.daq.rate_hz // LOOKS_PER_S, MAX_BLOCK_SCANS))
        return from_flat(config, {"daq.block_scans": scans})

    def settings(self) -> TrackerSettings:
        """Return the settings of the measurement.

        Raises:
            ConfigError: a value is wrong.
        """
        return TrackerSettings(**dict(self.analysis))  # type: ignore[arg-type]  # its validators check

    def plan(self) -> Plan:
        """Return what to command.

        Raises:
            ConfigError: a value is wrong.
        """
        return Plan(
            frequencies_hz=self.frequencies_hz,  # type: ignore[arg-type]  # mypy cannot solve the generic converter
            current_a=self.current_a,
            direction=self.direction,
            measurements_per_point=self.repetitions,
            dwell_limit_s=DWELL_FACTOR * self.settings().wait_limit_s * self.repetitions,
        )

    @property
    def key(self) -> str:
        """Identify the job by all values that decide its numbers, not by traces or code: 16 hexadecimal digits."""
        content = {
            "config": not_default(self.config()),
            "analysis": attrs.asdict(self.settings()),
            "plan": attrs.asdict(self.plan()),
            "gap_m": self.gap_m,
            "turn": [LOOKS_PER_S, COMMAND_GRID_NS, NS_PER_S],
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    def describe(self) -> str:
        """Return a short name for people."""
        gap = "no sphere" if self.gap_m == NO_SPHERE else f"gap {self.gap_m * 1e3:g} mm"
        first, last = min(self.frequencies_hz), max(self.frequencies_hz)
        return f"{gap}, {first:g} Hz" if first == last else f"{gap}, {first:g} to {last:g} Hz {self.direction.value}"


@attrs.frozen(eq=False, kw_only=True)
class Outcome:
    """What a job gave.

    Attributes:
        rows: accepted rows of `transmissibility/table`, in the order of the visit.
        failure: why the run did not reach its end; empty otherwise.
        skipped_hz: points left out because a sensor was over range.
        simulated_s: rig time.
        wall_s: time it took.
        lost_scans: scans that never reached the analysis.
        trace: arrays of the end of the run by name, if asked for.
    """

    rows: NDArray[np.void] = attrs.field(factory=lambda: np.zeros(0, TRANSMISSIBILITY))
    failure: str = ""
    skipped_hz: tuple[float, ...] = ()
    simulated_s: float = 0.0
    wall_s: float = 0.0
    lost_scans: int = 0
    trace: Mapping[str, NDArray[np.generic]] = attrs.field(factory=dict)
