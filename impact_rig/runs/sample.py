# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A short run to look at when there is no other: simulated without a graph, recorded as the recorder would."""

from __future__ import annotations

import shutil
from pathlib import Path

from impact_rig import topics
from impact_rig.analysis.settings import TrackerSettings, settings_table
from impact_rig.analysis.tracker import Tracker
from impact_rig.recording import open_run
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig
from impact_rig.runs.in_process import PUBLISHED, RigRecorder
from impact_rig.simtime import NS_PER_S

SECONDS = 20
ANALYSED = (topics.IMPACTS, topics.TRANSMISSIBILITY_TABLE, topics.ANALYSIS_SETTINGS)
TOPICS = tuple(topic.name for topic in (*PUBLISHED, *ANALYSED))
GAP_M = 6e-3


def make(directory: Path) -> Path:
    """Return the sample's directory, made if there is none."""
    if directory.is_dir():
        try:
            with open_run(directory) as run:
                whole = {f"/rig/{name}" for name in TOPICS} <= set(run.topics)
        except OSError:
            whole = False
        if whole:
            return directory
        shutil.rmtree(directory)  # cut short, or of an earlier version
    rig, settings = Rig(RigConfig()), TrackerSettings()
    tracker = Tracker(settings)
    tracker.configure(rig.info())
    tracker.label(GAP_M, 0)
    half = directory.with_name(f"{directory.name}.part")
    shutil.rmtree(half, ignore_errors=True)
    with RigRecorder(half, rig, ANALYSED) as recorder:
        recorder.write(topics.ANALYSIS_SETTINGS, settings_table(settings, GAP_M, 0))
        while rig.frontier_ns < SECONDS * NS_PER_S:
            if rig.next_block_ns == NS_PER_S:
                rig.accept(frequency_hz=9.1, current_a=0.52)
            for table in recorder.changes():
                tracker.on_applied(table)
            block = rig.advance(rig.block_end_ns(1))[0]
            recorder.block(block)
            found = tracker.feed(block.scan)
            recorder.write(topics.IMPACTS, *found.impacts)
            recorder.write(topics.TRANSMISSIBILITY_TABLE, *found.measurements)
    half.rename(directory)
    return directory
