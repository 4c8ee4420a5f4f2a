# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Analyse a recorded run: the live node's `Tracker` on the live node's messages, so the results are the same bits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from impact_rig import codec, topics
from impact_rig.analysis.findings import Findings
from impact_rig.analysis.labels import GapLabel, parse_label
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.tables import read_settings
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import TRANSMISSIBILITY, Table
from impact_rig.recording import Run

_NEEDED = (topics.INFO.name, topics.APPLIED.name, topics.SCAN.name)
_NOTES = "notes"
_SETTINGS = topics.ANALYSIS_SETTINGS.name


def analyze(run: Run, settings: TrackerSettings | None = None) -> Iterator[Findings]:
    """Yield what the analysis finds in a run, message by message as the recorder received them.

    Raises:
        RecordingError: a topic that the analysis needs was not recorded, or a message is damaged.
    """
    live, labels = _as_set_live(run)
    tracker = Tracker(settings or live)
    for label in labels:
        tracker.label(label.gap_m, label.stamp_ns)
    names = {run.resolve(topic): topic for topic in _NEEDED}
    for message in run.messages(names, recorded_order=True):
        topic = names[message.topic]
        table = codec.decode(message.data)
        if topic == topics.INFO.name:
            tracker.configure(table)
        elif topic == topics.APPLIED.name:
            tracker.on_applied(table)
        else:
            yield tracker.feed(table)
    yield tracker.flush()


def _as_set_live(run: Run) -> tuple[TrackerSettings, list[GapLabel]]:
    """Return the settings and labels of the live analysis; the operator's remarks and defaults where there was none.

    They are read first: a label names the scan it acts on, and may have been recorded after it.
    """
    if _has(run, _SETTINGS):
        found = [(table.stamp_ns, *read_settings(table)) for table in run.tables(_SETTINGS, recorded_order=True)]
        return found[-1][1], [GapLabel(gap_m, stamp_ns) for stamp_ns, _, gap_m in found]
    return TrackerSettings(), [label for label in map(parse_label, remarks(run)) if label is not None]


def remarks(run: Run) -> list[str]:
    """Return what the operator noted, in order."""
    return [_text(message.data) for message in run.messages([run.resolve(_NOTES)])] if _has(run, _NOTES) else []


def _has(run: Run, topic: str) -> bool:
    return any(name == topic or name.endswith(f"/{topic}") for name in run.topics)


def measurements(findings: Iterator[Findings]) -> list[Table]:
    """Return the measurements in findings, one table each."""
    return [table for found in findings for table in found.measurements]


def rows(tables: list[Table]) -> NDArray[np.void]:
    """Return the rows of measurement tables, shape (n,)."""
    return np.concatenate([table.rows for table in tables]) if tables else np.empty(0, TRANSMISSIBILITY)


def _text(cdr: bytes | memoryview) -> str:
    """Return the text of a serialized std_msgs/String: 4 bytes of encapsulation, length with terminator, UTF-8."""
    length = int.from_bytes(cdr[4:8], "little")
    return bytes(cdr[8 : 8 + max(0, length - 1)]).decode(errors="replace")
