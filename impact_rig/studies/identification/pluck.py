# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The free decay with the base locked: measured on a rig in this process, or taken from a recorded run."""

from __future__ import annotations

import numpy as np

from impact_rig import topics
from impact_rig.analysis.decay import Decay, DecayMethod, fit_decay, measure_decay
from impact_rig.blocks import joined
from impact_rig.errors import RecordingError
from impact_rig.recording import Run
from impact_rig.rig import Kind, Rig
from impact_rig.rig.config import RigConfig, from_flat
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

    Raises:
        RecordingError: nothing was plucked, or the run holds no scans after it.
    """
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
