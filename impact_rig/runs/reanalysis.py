# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Analyse a recorded run: the live node's `Tracker` on the live node's messages, so the results are the same bits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.findings import Findings
from impact_rig.analysis.labels import GapLabel, parse_label
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.tables import read_settings
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import TRANSMISSIBILITY, Table
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.recording import Message, Run

_NEEDED = (topics.INFO, topics.APPLIED, topics.SCAN)


def analyze(run: Run, settings: TrackerSettings | None = None) -> Iterator[Findings]:
    """Yield what the analysis finds in a run, message by message as the recorder received them.

    Raises:
        RecordingError: a topic that the analysis needs was not recorded, or a message is damaged or of another kind.
    """
    live, labels = _as_set_live(run)
    tracker = Tracker(settings or live)
    for label in labels:
        tracker.label(label.gap_m, label.stamp_ns)
    found = {run.resolve(topic.name): topic for topic in _NEEDED}
    try:
        for message in _in_force_first(run, found):
            topic = found[message.topic]
            if topic is topics.INFO:
                tracker.configure(run.table(message, topic))
            elif topic is topics.APPLIED:
                tracker.on_applied(run.table(message, topic))
            else:
                yield tracker.feed(run.table(message, topic))
    except ConfigError as error:
        raise RecordingError(f"{run.path}: {error}") from error
    yield tracker.flush()


def _in_force_first(run: Run, names: Mapping[str, topics.Topic]) -> Iterator[Message]:
    """Yield the messages as they were received, but in front of the first scan what had been published before it.

    A recorder that comes while the rig runs is handed calibration and drive, which are latched, some blocks late. The
    live analysis knew them. Without a calibration nothing can be measured, so the first one comes first in any case.
    """
    scans = [name for name, topic in names.items() if topic is topics.SCAN]
    first = next(run.messages(scans, recorded_order=True), None)
    if first is None:
        raise RecordingError(f"{run.path} holds no block of {topics.SCAN.name}")
    latched = list(run.messages([name for name in names if name not in scans], recorded_order=True))
    calibrations = [message for message in latched if names[message.topic] is topics.INFO]
    if not calibrations:
        raise RecordingError(f"{run.path} holds no {topics.INFO.name}: what its scans mean is not known")
    before = [message for message in latched if message.publish_time < first.publish_time]
    if not any(names[message.topic] is topics.INFO for message in before):
        before.insert(0, calibrations[0])
    yield from before
    known = Counter((message.topic, message.sequence, message.publish_time) for message in before)
    for message in run.messages(names, recorded_order=True):
        key = message.topic, message.sequence, message.publish_time
        if known[key]:
            known[key] -= 1
        else:
            yield message


def _as_set_live(run: Run) -> tuple[TrackerSettings, list[GapLabel]]:
    """Return the settings and labels of the live analysis; the operator's remarks and defaults where there was none.

    They are read first: a label names the scan it acts on, and may have been recorded after it.
    """
    if not run.holds(topics.ANALYSIS_SETTINGS):
        return TrackerSettings(), [label for label in map(parse_label, remarks(run)) if label is not None]
    try:
        found = [
            (table.stamp_ns, *read_settings(table))
            for table in run.tables(topics.ANALYSIS_SETTINGS, recorded_order=True)
        ]
    except ConfigError as error:
        raise RecordingError(f"{run.path}: {error}") from error
    if not found:
        return TrackerSettings(), []
    return found[-1][1], [GapLabel(gap_m, stamp_ns) for stamp_ns, _, gap_m in found]


def remarks(run: Run) -> list[str]:
    """Return what the operator noted, in order."""
    return [text_of(message.data) for message in run.messages([topics.NOTES.name])] if run.holds(topics.NOTES) else []


def measurements(findings: Iterator[Findings]) -> list[Table]:
    """Return the measurements in findings, one table each."""
    return [table for found in findings for table in found.measurements]


def rows(tables: list[Table]) -> NDArray[np.void]:
    """Return the rows of measurement tables, shape (n,)."""
    return np.concatenate([table.rows for table in tables]) if tables else np.empty(0, TRANSMISSIBILITY)


def text_of(cdr: bytes | memoryview) -> str:
    """Return the text of a serialized std_msgs/String: 4 bytes of encapsulation, length with terminator, UTF-8."""
    length = int.from_bytes(cdr[4:8], "little")
    return bytes(cdr[8 : 8 + max(0, length - 1)]).decode(errors="replace")
