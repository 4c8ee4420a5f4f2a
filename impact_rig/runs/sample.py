# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A short run to look at when there is no other: simulated without a graph, recorded as the recorder would."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import impact_rig
from impact_rig import codec, topics
from impact_rig.analysis.settings import TrackerSettings, settings_table
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import Table
from impact_rig.recording import Provenance, RunWriter, TopicDescription, open_run, schema_text
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import NS_PER_S

SECONDS = 20
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
TOPICS = (
    topics.INFO.name,
    topics.JOURNAL.name,
    topics.APPLIED.name,
    topics.SCAN.name,
    topics.IMPACTS_TRUTH.name,
    "impacts",
    topics.TRANSMISSIBILITY_TABLE.name,
    topics.ANALYSIS_SETTINGS.name,
)
JOINTS, JOINT_STATE = topics.JOINT_STATES.name, "sensor_msgs/msg/JointState"
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
    provenance = Provenance(version=impact_rig.__version__, seed=RigConfig().daq.seed, wall_start_ns=time.time_ns())
    half = directory.with_name(f"{directory.name}.part")
    shutil.rmtree(half, ignore_errors=True)
    with RunWriter(half, provenance=provenance, clock=time.monotonic, rig_start_ns=0) as writer:
        for name in TOPICS:
            writer.add_topic(
                TopicDescription(name=f"/rig/{name}", type_name=POINT_CLOUD, schema=schema_text(POINT_CLOUD))
            )
        writer.add_topic(
            TopicDescription(name=f"/rig/{JOINTS}", type_name=JOINT_STATE, schema=schema_text(JOINT_STATE))
        )
        for name, table in (
            (topics.INFO.name, rig.info()),
            (topics.ANALYSIS_SETTINGS.name, settings_table(settings, GAP_M, 0)),
        ):
            writer.write(f"/rig/{name}", codec.encode(table), 0)
        for second in range(SECONDS):
            if second == 1:
                rig.accept(frequency_hz=9.1, current_a=0.52)
            _advance(rig, tracker, writer, (second + 1) * NS_PER_S)
    half.rename(directory)
    return directory


def _advance(rig: Rig, tracker: Tracker, writer: RunWriter, until_ns: int) -> None:
    def write(name: str, tables: list[Table] | tuple[Table, ...]) -> None:
        for table in tables:
            writer.write(f"/rig/{name}", codec.encode(table), table.stamp_ns)

    blocks = rig.advance(until_ns)
    write(topics.JOURNAL.name, rig.take_journal())
    applied = rig.take_applied()
    write(topics.APPLIED.name, applied)
    for table in applied:
        tracker.on_applied(table)
    for block in blocks:
        write(topics.SCAN.name, [block.scan])
        for row in block.monitor:
            stamp = block.scan.stamp_ns + round(float(row["time"]) * NS_PER_S)
            positions, velocities = ([float(row[f"{what}_{body}"]) for body in "b12"] for what in "xv")
            writer.write(f"/rig/{JOINTS}", codec.encode_joint_state(stamp, positions, velocities), stamp)
        if block.impacts is not None:
            write(topics.IMPACTS_TRUTH.name, [block.impacts])
        found = tracker.feed(block.scan)
        write("impacts", found.impacts)
        write(topics.TRANSMISSIBILITY_TABLE.name, found.measurements)
