# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Recorder of a rig in this process, which writes what its node's recorder would, and the sample run of the lab."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterable
from pathlib import Path

import impact_rig
from impact_rig import codec, topics
from impact_rig.analysis.settings import TrackerSettings, settings_table
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import Table
from impact_rig.recording import CONFIGURATION, Attachment, Provenance, RunWriter, TopicDescription, open_run
from impact_rig.rig import Block, Rig, journal
from impact_rig.rig.config import RigConfig, dump
from impact_rig.rig.description import joints
from impact_rig.simtime import NS_PER_S, stamp_ns

PUBLISHED = (topics.INFO, topics.JOURNAL, topics.APPLIED, topics.SCAN, topics.IMPACTS_TRUTH, topics.FAULTS)


class RigRecorder:
    """Writes what a rig does; a context that ends the run.

    Args:
        more: topics of others that are written, too.
    """

    def __init__(self, directory: Path, rig: Rig, more: Iterable[topics.Topic] = ()) -> None:
        self._rig = rig
        self._writer = RunWriter(
            directory,
            provenance=Provenance(
                version=impact_rig.__version__, seed=rig.config.daq.seed, wall_start_ns=time.time_ns(),
                extra={"mode": "in process", "namespace": "/rig"},
            ),
            attachments=(Attachment(CONFIGURATION, dump(rig.config).encode(), "application/yaml"),),
            clock=time.monotonic,
        )  # fmt: skip
        for topic in (*PUBLISHED, topics.JOINT_STATES, *more):
            self._writer.add_topic(TopicDescription(name=f"/rig/{topic.name}", type_name=topic.type_name))
        self._info = b""

    def __enter__(self) -> RigRecorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.changes()
        self._writer.finish()

    def write(self, topic: topics.Topic, *tables: Table) -> None:
        """Write tables of a topic."""
        for table in tables:
            self._writer.write(f"/rig/{topic.name}", codec.encode(table), table.stamp_ns)

    def block(self, block: Block) -> None:
        """Write a block, after what has led to it."""
        self.changes()
        for topic, table in block.tables():
            if topic in PUBLISHED:
                self.write(topic, table)
        for scan, row in zip(block.monitor_scans, block.monitor_states, strict=True):
            stamp = stamp_ns(block.first_scan + int(scan), self._rig.rate_hz, self._rig.start_ns)
            self._writer.write(f"/rig/{topics.JOINT_STATES.name}", codec.encode_joint_state(stamp, *joints(row)), stamp)

    def changes(self) -> list[Table]:
        """Write what has changed since the last call; return what was applied."""
        applied = self._rig.take_applied()
        entries = self._rig.take_journal()
        for entry in entries:
            self._writer.write(f"/rig/{topics.JOURNAL.name}", journal.encode(entry), entry.stamp_ns)
        self.write(topics.APPLIED, *applied)
        if entries and codec.encode(self._rig.info()) != self._info:
            self._info = codec.encode(self._rig.info())
            self.write(topics.INFO, self._rig.info())
        return applied


ANALYSED = (topics.IMPACTS, topics.TRANSMISSIBILITY_TABLE, topics.ANALYSIS_SETTINGS)


class MeasuredRig:
    """A rig and its analysis in this process, recorded into a run; a context that ends the run.

    Args:
        directory: of the run.
        config: of the rig.
        gap_m: the operator's label: gap, or `NO_SPHERE`.

    Attributes:
        rig: takes commands between blocks.
    """

    def __init__(self, directory: Path, config: RigConfig, gap_m: float) -> None:
        settings = TrackerSettings()
        self.rig = Rig(config)
        self._tracker = Tracker(settings)
        self._tracker.configure(self.rig.info())
        self._tracker.label(gap_m, 0)
        self._recorder = RigRecorder(directory, self.rig, ANALYSED)
        self._recorder.write(topics.ANALYSIS_SETTINGS, settings_table(settings, gap_m, 0))

    @property
    def waiting(self) -> str:
        """What a row is held back for, for people: a sphere that may still strike; otherwise empty."""
        progress = self._tracker.progress
        return "" if progress is None else progress.reason

    def __enter__(self) -> MeasuredRig:
        return self

    def __exit__(self, *exception: object) -> None:
        self._recorder.__exit__(*exception)

    def advance(self) -> list[Table]:
        """Advance by one block, write it, and return the measurements that it completed."""
        for table in self._recorder.changes():
            self._tracker.on_applied(table)
        block = self.rig.advance(self.rig.block_end_ns(1))[0]
        self._recorder.block(block)
        found = self._tracker.feed(block.scan)
        self._recorder.write(topics.IMPACTS, *found.impacts)
        self._recorder.write(topics.TRANSMISSIBILITY_TABLE, *found.measurements)
        return list(found.measurements)


SAMPLE_S = 20
SAMPLE_TOPICS = tuple(topic.name for topic in (*PUBLISHED, *ANALYSED))
GAP_M = 6e-3


def make_sample(directory: Path) -> Path:
    """Return the directory of a short run to look at when there is no other, made if there is none."""
    if directory.is_dir():
        try:
            with open_run(directory) as found:
                whole = {f"/rig/{name}" for name in SAMPLE_TOPICS} <= set(found.topics)
        except OSError:
            whole = False
        if whole:
            return directory
        shutil.rmtree(directory)  # cut short, or of an earlier version
    half = directory.with_name(f"{directory.name}.part")
    shutil.rmtree(half, ignore_errors=True)
    with MeasuredRig(half, RigConfig(), GAP_M) as run:
        while run.rig.frontier_ns < SAMPLE_S * NS_PER_S:
            if run.rig.next_block_ns == NS_PER_S:
                run.rig.accept(frequency_hz=9.1, amplitude=0.52)
            run.advance()
    half.rename(directory)
    return directory
