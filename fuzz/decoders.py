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
"""Fuzz targets for bytes: tables from the network, MCAP files (intact or damaged), journals, input of the analysis."""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from fuzz.mutation import mutated
from fuzz.target import Target
from impact_rig import blocks, codec, topics
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import Table
from impact_rig.errors import CodecError
from impact_rig.recording import Attachment, Provenance, RunWriter, TopicDescription, open_run
from impact_rig.recording.writer import tail_of
from impact_rig.rig import Rig, resimulate
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.journal import InputKind, JournalEntry, JournalView
from impact_rig.runs import recover

TABLES = {name: value for name, value in vars(blocks).items() if isinstance(value, np.dtype)}
WRITTEN = 8
"""Number of messages in each small run."""
LARGEST_S = 0.05
"""Rig time for which a hostile journal is re-simulated."""


PROVENANCE = Provenance(version="1", seed=3, wall_start_ns=4)
STORED_PROVENANCE = {key: value for key, value in PROVENANCE.to_record().items() if key != "crc32"}


def _rig() -> Rig:
    rig = Rig(from_flat(RigConfig(), {"drive.amplitude": 0.3, "barriers.gap_m": 0.002, "daq.seed": 5}))
    rig.advance(20_000_000)
    rig.accept(8.0, 0.4)
    rig.configure({"barriers.gap_m": 0.003, "sphere.start": "right"})
    return rig


TABLE_TOPICS = [topic for topic in topics.COMMON if topic.columns is not None]
MESSAGES = [codec.encode(Table(10**9, np.zeros(2, dtype), "daq")) for dtype in TABLES.values()]
MESSAGES += [codec.encode(Table(0, np.zeros(1, [("a", "u1"), ("b", "<f4"), ("t", "S32")])))]


# --- tables ----------------------------------------------------------------------------------------------------------


def point_cloud(raw: bytes) -> None:
    """Check that a decoded table lies within the message and can be encoded again."""
    table = codec.decode(raw)
    assert table.rows.nbytes <= len(raw)
    again = codec.decode(codec.encode(table))
    assert again.rows.tobytes() == table.rows.tobytes()
    assert (again.stamp_ns, again.frame_id) == (table.stamp_ns, table.frame_id)
    for topic in TABLE_TOPICS:
        with contextlib.suppress(CodecError):
            assert set(topic.columns.names or ()) <= set(codec.checked(table, topic).rows.dtype.names or ())
    codec.joint_state(raw)


# --- files -----------------------------------------------------------------------------------------------------------


def _small_run(directory: Path, compression: str) -> tuple[bytes, tuple[bytes, bytes], set[tuple[str, bytes]]]:
    """Write a run of some 3 kB with two topics, an attachment and several chunks.

    Returns:
        The file, the pair of file and tail before the last chunk was closed, and the messages.
    """
    topics = [
        TopicDescription(name=f"/{name}", type_name="std_msgs/msg/String", schema="string data\n") for name in "ab"
    ]
    sent = set()
    with RunWriter(
        directory,
        provenance=PROVENANCE,
        attachments=[Attachment("config.yaml", b"a: 1\n")],
        clock=lambda: 0.0,
        compression=compression,
        chunk_bytes=200,
        tail=True,
    ) as writer:
        for topic in topics:
            writer.add_topic(topic)
        for number in range(WRITTEN):
            data = b"\0\1\0\0\x09\0\0\0message" + bytes([48 + number, 0])
            writer.write_at(topics[number % 2].name, data, 10 + number, 20, number)
            writer.secure()
            sent.add((topics[number % 2].name, data))
        recording = writer.files[0]
        unfinished = recording.read_bytes(), tail_of(recording).read_bytes()
    return recording.read_bytes(), unfinished, sent


_SCRATCH = Path(tempfile.mkdtemp(prefix="impact_rig_fuzz_"))
RUNS = [_small_run(_SCRATCH / name, name) for name in ("none", "lz4", "zstd")]
FILES = [content for content, _, _ in RUNS]
UNFINISHED = [recording for _, (recording, _), _ in RUNS]
TAILS = [tail for _, (_, tail), _ in RUNS]
SENT = {message for _, _, messages in RUNS for message in messages}
shutil.rmtree(_SCRATCH)


def mcap_read(raw: bytes) -> None:
    """Check that a reader returns messages that were written, or rejects the file."""
    with tempfile.TemporaryDirectory(prefix="impact_rig_fuzz_") as folder:
        path = Path(folder, "run.mcap")
        path.write_bytes(raw)
        with open_run(path) as run:
            for message in run.messages(recorded_order=True):
                assert (message.topic, bytes(message.data)) in SENT
            assert set(run.attachments().values()) <= {b"a: 1\n"}
            assert run.provenance in ({}, STORED_PROVENANCE)


def mcap_recover(raw: tuple[bytes, bytes | None]) -> None:
    """Check that a recovery returns messages that were written, as an intact run, despite any damage."""
    recording, tail = raw
    with tempfile.TemporaryDirectory(prefix="impact_rig_fuzz_") as folder:
        path = Path(folder, "run.mcap")
        path.write_bytes(recording)
        if tail is not None:
            tail_of(path).write_bytes(tail)
        report = recover(path, Path(folder, "out"))
        if recording in UNFINISHED and tail == TAILS[UNFINISHED.index(recording)]:
            assert report.messages == WRITTEN
        with open_run(Path(folder, "out")) as run:
            for message in run.messages():
                assert (message.topic, bytes(message.data)) in SENT
            assert set(run.attachments().values()) <= {b"a: 1\n"}


# --- journals --------------------------------------------------------------------------------------------------------

JOURNAL = _rig().take_journal()
MEMBERS = ("sequence", "kind", "sample", "stamp_ns", "name", "value", "text", "values", "fault", "more")
CELLS = st.recursive(
    st.sampled_from([*(kind.value for kind in InputKind), "frequency", "daq.seed", "sphere.start", "dropout", "laser"])
    | st.floats() | st.integers(-2, 30) | st.sampled_from((2**62, 10**400)) | st.booleans() | st.none() | st.text(),
    lambda cells: st.lists(cells, max_size=3) | st.dictionaries(st.sampled_from([*MEMBERS, "daq.seed"]), cells),
    max_leaves=5,
)  # fmt: skip


@st.composite
def journals(draw: st.DrawFn) -> list[str]:
    """Draw the lines of a journal with some members changed, and entries dropped or doubled."""
    contents = [json.loads(entry.line()) for entry in JOURNAL]
    for _ in range(draw(st.integers(1, 4))):
        content = draw(st.sampled_from(contents))
        content[draw(st.sampled_from(MEMBERS))] = draw(CELLS)
    if draw(st.booleans()):
        del contents[draw(st.integers(0, len(contents) - 1))]
    return [json.dumps(content) for content in contents]


def journal(lines: list[str]) -> None:
    """Check that a re-simulation starts from the journal or reports why it cannot, and that its scans are numbers."""
    deadline = time.perf_counter() + LARGEST_S
    entries, view = [JournalEntry.from_line(line) for line in lines], JournalView()
    for entry in entries:
        view.follow(entry)
    for block in resimulate(entries):
        _all_finite(block.scan)
        if block.number >= 3 or time.perf_counter() > deadline:
            return


# --- analysis --------------------------------------------------------------------------------------------------------


def _stream() -> tuple[Table, Table, list[Table]]:
    rig = Rig(from_flat(RigConfig(), {"drive.amplitude": 0.3, "daq.rate_hz": 1000, "daq.block_scans": 100}))
    found = rig.advance(800_000_000)
    return rig.info(), rig.take_applied()[0], [block.scan for block in found]


INFO, APPLIED, SCANS = _stream()


@st.composite
def streams(draw: st.DrawFn) -> list[tuple[str, Table]]:
    """Draw calibration, command and scans of a rig, with some hostile cells, columns, stamps and lengths."""
    stream = [("info", INFO), ("applied", APPLIED), *(("scan", scan) for scan in SCANS[:4])]
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(stream) - 1))
        kind, table = stream[at]
        rows = table.rows.copy()
        name = draw(st.sampled_from(rows.dtype.names))
        match draw(st.integers(0, 5)):
            case 0 if rows.dtype[name].kind == "f" and len(rows):
                rows[name][draw(st.integers(0, len(rows) - 1))] = draw(st.floats())
            case 1:
                rows = rows[[other for other in rows.dtype.names if other != name] or [name]]
            case 2:
                rows = rows[: draw(st.integers(0, 3))]
            case 3:
                rows = rows.astype(
                    [(n, "<f4" if rows.dtype[n].kind == "f" else rows.dtype[n]) for n in rows.dtype.names]
                )
            case 4 if rows.dtype[name].kind == "S" and len(rows):
                rows[name][0] = draw(st.binary(max_size=32))
        step = st.sampled_from((0, 1, -1, 10**8, -(10**8), 10**15, -(10**15)))
        stream[at] = (kind, Table(table.stamp_ns + draw(step), rows))
        if draw(st.booleans()):
            stream.insert(draw(st.integers(0, len(stream))), stream[at])
    return stream


def analysis(stream: list[tuple[str, Table]]) -> None:
    """Check that every table is accepted or rejected by name, and that rows of measurements contain numbers."""
    tracker = Tracker()
    takers = {"info": tracker.configure, "applied": tracker.on_applied, "scan": tracker.feed}
    for kind, table in stream:
        found = takers[kind](codec.decode(codec.encode(Table(table.stamp_ns, np.array(table.rows)))))
        for measured in getattr(found, "measurements", ()):
            row = measured.rows[0]
            assert row["settled"] == 0 or np.isfinite(row["transmissibility"])


def _all_finite(table: Table) -> None:
    for name in table.rows.dtype.names or ():
        assert np.isfinite(table.rows[name]).all(), f"{name} is not finite"


TARGETS = (
    Target("point_cloud", mutated(MESSAGES) | st.binary(max_size=200), point_cloud, ("impact_rig/codec.py",)),
    Target(
        "mcap_read",
        mutated(FILES),
        mcap_read,
        ("impact_rig/recording/reader.py", "impact_rig/recording/records.py", "impact_rig/recording/description.py"),
    ),
    Target(
        "mcap_recover",
        st.tuples(mutated(FILES), st.none())
        | st.tuples(st.sampled_from(UNFINISHED), mutated(TAILS))
        | st.tuples(mutated(UNFINISHED), st.sampled_from(TAILS))
        | st.sampled_from(list(zip(UNFINISHED, TAILS, strict=True))),
        mcap_recover,
        ("impact_rig/runs/recovery.py", "impact_rig/recording/writer.py"),
    ),
    Target("journal", journals(), journal, ("impact_rig/rig/journal.py", "impact_rig/rig/resimulation.py")),
    Target(
        "analysis",
        streams(),
        analysis,
        ("impact_rig/analysis/calibration.py", "impact_rig/analysis/scans.py", "impact_rig/analysis/tracker.py"),
    ),
)
