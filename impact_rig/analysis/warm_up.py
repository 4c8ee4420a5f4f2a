# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Compiles what a tracker runs before there is anything to measure.

The first block would do so as well, but on a machine that has never run it that takes longer than the three seconds
after which a rig gives up waiting for a peer's acknowledgement.
"""

from __future__ import annotations

import numpy as np

from impact_rig.analysis.channels import CHANNELS, SCAN
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import APPLIED, DAQ_INFO, Table
from impact_rig.system.compile_ahead import Task

TASK = Task(f"{__name__}:compile_tracker", ("analysis",))

RATE_HZ = 10_000
DRIVE_HZ = 50.0
SCANS = 5_000
"""Half a second: some cycles of the drive beyond what a tracker holds back."""


def compile_tracker() -> None:
    """Measure half a second of silence: every compiled function runs once, none has to be compiled after that."""
    info = np.zeros(len(CHANNELS), DAQ_INFO)
    info["name"], info["rate"], info["sensitivity"] = CHANNELS, RATE_HZ, 1.0
    info["range_low"], info["range_high"] = -1.0, 1.0
    scans = np.zeros(SCANS, SCAN)
    scans["time"] = np.arange(SCANS) / RATE_HZ
    applied = np.zeros(1, APPLIED)
    applied["frequency"] = DRIVE_HZ
    tracker = Tracker()
    tracker.configure(Table(0, info))
    tracker.on_applied(Table(0, applied))
    tracker.feed(Table(0, scans))
