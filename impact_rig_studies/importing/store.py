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
"""Storage of imported measurements as runs on disk, with the results of the analysis."""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

import impact_rig
from impact_rig import codec, topics
from impact_rig.analysis.settings import parse_label
from impact_rig.analysis.tracker import Findings, Tracker
from impact_rig.blocks import APPLIED, Table
from impact_rig.recording import Attachment, Provenance, RunWriter, TopicDescription
from impact_rig.recording.description import MEASURED, MODE_KEY
from impact_rig.runs.origin import SOURCE
from impact_rig.simtime import NS_PER_S, stamp_ns
from impact_rig_studies.importing.conversion import ImportedRun
from impact_rig_studies.importing.mapping import as_yaml

MAPPING_FILE = "mapping.yaml"  # attachment with the mapping that was used
BLOCK_S, BLOCK_SCANS = 0.1, 4000
WRITTEN = (topics.INFO, topics.APPLIED, topics.NOTES, topics.SCAN, topics.TRANSMISSIBILITY_TABLE, topics.IMPACTS)


def write(found: ImportedRun, directory: Path, clock_ns: int | None = None) -> Path:
    """Write an imported measurement as a run into a directory, and return the directory.

    The run also contains the results of the analysis of its scans. A missing directory is created. An existing
    directory may contain other files, but no recording.

    `clock_ns` is the time of writing that the run states [ns since 1970]; None means now.

    Raises:
        RecordingError: the run cannot be written, or the directory already contains a recording.
    """
    now = time.time_ns() if clock_ns is None else clock_ns
    about = {MODE_KEY: MEASURED, "source": found.source.path.name, "format": found.source.format}
    provenance = Provenance(version=impact_rig.__version__, seed=0, wall_start_ns=now, extra=about)
    kept = (
        Attachment(MAPPING_FILE, as_yaml(found.mapping).encode(), "application/yaml"),
        Attachment(SOURCE, json.dumps(origin_of(found), ensure_ascii=False, indent=1).encode(), "application/json"),
    )
    numbers: dict[str, int] = {}
    with RunWriter(directory, provenance=provenance, attachments=kept, clock=time.monotonic) as writer:
        for topic in WRITTEN:
            writer.add_topic(TopicDescription(name=f"/{topic.name}", type_name=topic.type_name))

        def put(topic: topics.Topic, data: bytes) -> None:
            numbers[topic.name] = numbers.get(topic.name, 0) + 1
            writer.write(f"/{topic.name}", data, now, numbers[topic.name])

        def put_findings(findings: Findings) -> None:
            for one in findings.impacts:
                put(topics.IMPACTS, codec.encode(one))
            for one in findings.measurements:
                put(topics.TRANSMISSIBILITY_TABLE, codec.encode(one))

        tracker = Tracker()
        for topic, one in _heads(found):
            put(topic, one if isinstance(one, bytes) else codec.encode(one))
            if isinstance(one, Table):
                (tracker.configure if topic is topics.INFO else tracker.on_applied)(one)
        for label in filter(None, map(parse_label, found.labels)):
            tracker.label(label.gap_m, label.stamp_ns)
        for block in _blocks(found):
            put(topics.SCAN, codec.encode(block))
            put_findings(tracker.feed(block))
        put_findings(tracker.flush(take_unsettled=True))
    return directory


def origin_of(found: ImportedRun) -> dict[str, object]:
    """Return a description of where an imported run comes from, as a dictionary for JSON.

    It states what was read from the file, which assumptions were made, and what was left out.
    """
    source = found.source
    used = {one.column: name for name, one in found.mapping.channels.items()}
    return {
        "file": str(source.path), "format": source.format, "rate_hz": found.rate_hz, "scans": len(found.rows),
        "channels": {name: one.column for name, one in found.mapping.channels.items()},
        "signals": [
            {
                "name": name, "unit": one.unit, "kind": one.kind.value, "values": len(one.values),
                "abscissa": str(one.abscissa), "origin": one.origin, "channel": used.get(name, ""),
            }
            for name, one in source.signals.items()
        ],
        "drive": [{"stamp_ns": t, "frequency_hz": f, "amplitude": a} for t, f, a in found.drive],
        "estimated": {name: list(columns) for name, columns in found.estimated.items()},
        "notes": list(found.labels), "assumptions": list(found.doubts), "left_out": dict(source.left_out),
    }  # fmt: skip


def estimated(attachments: Mapping[str, bytes]) -> dict[str, tuple[str, ...]]:
    """Return the columns of `daq/info` that the import estimated from the data of a run, by channel.

    `attachments` are the attachments of the run. The result is empty for a run that was not imported.
    """
    try:
        columns = json.loads(attachments[SOURCE])["estimated"]
        return {str(name): tuple(map(str, found)) for name, found in columns.items()}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):  # recorded, or imported before
        return {}


def _heads(found: ImportedRun) -> Iterator[tuple[topics.Topic, Table | bytes]]:
    """Yield the messages before the scans, with their topics: calibration, drive commands and remarks."""
    yield topics.INFO, Table(found.start_ns, found.info)
    for instant, frequency, current in found.drive:
        row = np.zeros(1, APPLIED)
        row["frequency"], row["current"] = frequency, current
        row["sample"] = max(0, round((instant - found.start_ns) * found.rate_hz / NS_PER_S))
        yield topics.APPLIED, Table(instant, row)
    for text in found.labels:
        yield topics.NOTES, codec.encode_text(text)


def _blocks(found: ImportedRun) -> Iterator[Table]:
    """Yield the scans in blocks of about `BLOCK_S` seconds; a new block begins after missing scans.

    A block has at least one scan, and at most `BLOCK_SCANS`.
    """
    length = max(1, min(BLOCK_SCANS, round(BLOCK_S * found.rate_hz)))
    cuts = [0, *(np.flatnonzero(np.diff(found.index) != 1) + 1).tolist(), len(found.index)]
    for first, end in itertools.pairwise(cuts):
        for begin in range(first, end, length):
            rows = found.rows[begin : min(begin + length, end)].copy()
            rows["time"] = np.arange(len(rows)) / found.rate_hz
            yield Table(stamp_ns(int(found.index[begin]), found.rate_hz, found.start_ns), rows)
