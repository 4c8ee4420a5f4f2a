# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The free decay with the base locked: measured on a rig in this process, or taken from a recorded run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.channels import samples_of
from impact_rig.analysis.decay import Decay, DecayMethod, fit_decay, measure_decay
from impact_rig.blocks import joined
from impact_rig.errors import RecordingError
from impact_rig.recording import Run
from impact_rig.rig import Kind, Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.runs.measurement import is_measured
from impact_rig.runs.wholes import Excerpt, calibration_rows, last_record
from impact_rig.simtime import NS_PER_S

DISPLACEMENT_M = 5e-3
RECORD_S = 20.0
"""Five time constants of the structure."""
SETTLE_S = 0.05
"""Left out at the beginning: the laser's lag dies away."""


def measured_decay(config: RigConfig, method: DecayMethod = fit_decay) -> Decay:
    """Pluck the rig without its sphere and measure f_n and ζ by a fit, or by `method`."""
    config = from_flat(config, {"sphere.present": False, "daq.block_scans": min(config.daq.rate_hz, 10_000)})
    rig = Rig(config)
    rig.pluck(DISPLACEMENT_M)
    blocks = rig.advance(round(RECORD_S * NS_PER_S))
    rows = joined([block.scan.rows for block in blocks])
    return measure_decay(rows[round(SETTLE_S * config.daq.rate_hz) :], rig.info().rows, method)


def recorded_decay(run: Run, method: DecayMethod = fit_decay) -> Decay:
    """Measure the decay after the last pluck of a recorded run by a fit, or by `method`.

    A measurement of somebody's own rig has no journal: its decay begins where the structure is farthest from where it
    comes to rest.

    Raises:
        RecordingError: nothing was plucked, or the run holds no scans after it.
    """
    if not run.holds(topics.JOURNAL) and is_measured(run):
        return _decay_of(last_record(run), calibration_rows(run), method)
    plucks = [
        table.stamp_ns + round(float(row["time"]) * NS_PER_S)
        for table in run.tables(topics.JOURNAL.name, recorded_order=True)
        for row in table.rows
        if row["kind"] == Kind.PLUCK.value.encode()
    ]
    if not plucks:
        raise RecordingError(f"{run.path}: nothing was plucked in this run (rig/pluck)")
    info = list(run.tables(topics.INFO.name, recorded_order=True))[-1]
    first = plucks[-1] + round(SETTLE_S * NS_PER_S)
    parts = [table.rows for table in run.tables(topics.SCAN.name, recorded_order=True) if table.stamp_ns >= first]
    if not parts:
        raise RecordingError(f"{run.path}: no scans after the pluck")
    return measure_decay(np.concatenate(parts), info.rows, method)


def _decay_of(record: Excerpt, info: NDArray[np.void], method: DecayMethod) -> Decay:
    x_1 = samples_of(record.rows, "laser")
    quarter = max(1, len(x_1) // 4)
    begin = int(np.argmax(np.abs(x_1 - x_1[-quarter:].mean()))) + round(SETTLE_S * record.rate_hz)
    return measure_decay(record.rows[begin:], info, method)
