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
"""Rig recorded without a ROS graph: the messages of its node, in the order of publication."""

from __future__ import annotations

import functools
import struct
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from impact_rig import codec
from impact_rig.analysis.settings import TrackerSettings, settings_table
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import Table
from impact_rig.instruments.fault import Fault
from impact_rig.recording import Provenance, RunWriter, TopicDescription, open_run
from impact_rig.rig import Rig, journal
from impact_rig.rig.config import RigConfig, dump, from_flat
from impact_rig.rig.journal import JournalEntry
from impact_rig.runs import reanalysis
from impact_rig.simtime import stamp_ns
from impact_rig.testing import LocalRig

TICK = 10_000_000
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
STRING = "std_msgs/msg/String"
KINDS = {
    "notes": STRING,
    "rig/configuration": STRING,
    "rig/journal": STRING,
    "truth/joint_states": "sensor_msgs/msg/JointState",
}
Messages = list[tuple[str, Any]]
PROVENANCE = Provenance(version="0", seed=5, wall_start_ns=0)
SLOW_RIG = {"sphere.present": False, "daq.rate_hz": 1000, "daq.block_scans": 100}


def scanned(rig: LocalRig) -> Messages:
    """Return calibration, drive and scans that a rig has published."""
    topics = ("daq/info", "shaker/applied", "daq/scan")
    return sorted(((topic, table) for topic in topics for table in rig.tables(topic)), key=lambda one: one[1].stamp_ns)


def published(rig: Rig, blocks: int) -> Messages:
    """Advance by this number of blocks, and return the messages that the node would publish."""
    found: Messages = []
    for _ in range(blocks):
        measured = rig.advance(rig.block_end_ns(1))
        for topic, tables in (("rig/journal", rig.take_journal()), ("shaker/applied", rig.take_applied())):
            found += [(topic, table) for table in tables]
        found += [("daq/scan", block.scan) for block in measured if not block.lost]
    return found


def edited(found: Messages, topic: str, change: Callable[[Any], Any]) -> Messages:
    """Return messages in which a topic's entries, or rows of its tables, have passed `change` (None removes one)."""
    result: Messages = []
    for name, table in found:
        if name != topic:
            result.append((name, table))
        elif isinstance(table, JournalEntry):
            changed = change(table)
            result += [(name, changed)] * (changed is not None)
        elif (rows := change(table.rows.copy())) is not None:
            result.append((name, attrs.evolve(table, rows=rows)))
    return result


def messages(seconds: int = 12, again: tuple[int, ...] = (), **values: object) -> Messages:
    """Rig whose operator does a little of everything, with its analysis; `again`: blocks with a new command."""
    rig = Rig(from_flat(RigConfig(), {"daq.seed": 5, "sphere.present": False, **values}))
    tracker = Tracker()
    found: Messages = [("daq/info", rig.info())]
    found.append(("analysis/settings", settings_table(TrackerSettings(), 0.0, 0)))
    tracker.configure(rig.info())
    tracker.label(0.0, 0)
    deeds: dict[int, Callable[[], object]] = {
        7: lambda: rig.accept(frequency_hz=9.1, amplitude=0.52),
        seconds * 100 - 40: lambda: rig.configure({"barriers.gap_m": 0.004, "sphere.present": True}),
        seconds * 100 - 30: lambda: rig.inject(spikes(rig.frontier_sample + 50)),
        seconds * 100 - 20: rig.stop,
    }
    for number, block in enumerate(again):
        deeds[block] = functools.partial(rig.accept, frequency_hz=9.2 + 0.1 * number)
    for block in range(seconds * 100):
        if block in deeds:
            deeds[block]()
        blocks = rig.advance(rig.block_end_ns(1))
        for topic, tables in (("rig/journal", rig.take_journal()), ("shaker/applied", rig.take_applied())):
            found += [(topic, table) for table in tables]
            if topic == "shaker/applied":
                for table in tables:
                    tracker.on_applied(table)
        for one in blocks:
            found.append(("daq/scan", one.scan))
            found += [("transmissibility/table", table) for table in tracker.feed(one.scan).measurements]
    return found


def spikes(start: int) -> Fault:
    """Fault with a rate that has more digits than a journal row."""
    return Fault(kind="spike_train", channel="laser", start_sample=start, value=1e-3, rate_hz=100.0 / 3.0)


@attrs.frozen(eq=False)
class Joints:
    """Message of truth/joint_states, in place of a table."""

    stamp_ns: int
    values: np.ndarray

    def encoded(self) -> bytes:
        """Return a serialized sensor_msgs/JointState: header, no names, position, velocity, effort of three bodies."""
        seconds, nanoseconds = divmod(self.stamp_ns, 10**9)
        data = struct.pack("<iIII", seconds, nanoseconds, 1, 0) + struct.pack("<I", 0)
        for part in self.values.reshape(3, 3):
            data += struct.pack("<I", 3)
            data += bytes(-len(data) % 8) + part.tobytes()
        return b"\0\1\0\0" + data


def everything(rig: Rig, blocks: int, deeds: dict[int, Callable[[], object]] | None = None) -> list[tuple[str, Any]]:
    """Advance by this number of blocks, and return everything that the node would publish, with the truth."""
    found: list[tuple[str, Any]] = []
    described: list[bytes] = []

    def changes() -> None:
        for topic, tables in (("rig/journal", rig.take_journal()), ("shaker/applied", rig.take_applied())):
            found.extend((topic, table) for table in tables)
        info = codec.encode(rig.info())
        if not described or info != described[-1]:
            found.append(("daq/info", rig.info()))
            described.append(info)
        found.append(("rig/configuration", Remark(dump(rig.config), rig.frontier_ns)))

    changes()
    for number in range(blocks):
        if deeds and number in deeds:
            deeds[number]()
            changes()
        for block in rig.advance(rig.block_end_ns(1)):
            if not block.lost:
                found.append(("daq/scan", block.scan))
            beside = ("truth/impacts", block.impacts), ("truth/faults", block.faults), ("truth/scan", block.truth)
            found += [(name, table) for name, table in beside if table is not None]
            for scan, state in zip(block.monitor_scans, block.monitor_states, strict=True):
                push = state["force_left"] - state["force_right"]
                values = [state[name] for name in ("x_b", "x_1", "x_2", "v_b", "v_1", "v_2")] + [0.0, -push, push]
                instant = stamp_ns(block.first_scan + int(scan), rig.rate_hz, rig.start_ns)
                found.append(("truth/joint_states", Joints(instant, np.array(values))))
        changes_of_time = [("rig/journal", one) for one in rig.take_journal()]
        found += [*changes_of_time, *(("shaker/applied", one) for one in rig.take_applied())]
    return found


@attrs.frozen(eq=False)
class Remark:
    """Text in place of a table: an operator's remark, or the rig's configuration."""

    text: str
    stamp_ns: int

    def encoded(self) -> bytes:
        """Return a serialized std_msgs/String."""
        content = self.text.encode() + b"\0"
        return b"\0\1\0\0" + len(content).to_bytes(4, "little") + content


def note(text: str, stamp_ns: int) -> tuple[str, Remark]:
    """Return a remark on the topic `notes`, for `record`."""
    return "notes", Remark(text, stamp_ns)


def agreement(path: Path) -> reanalysis.Agreement:
    """Analyse a run again, and compare the results with those that were published live."""
    with open_run(path) as run:
        findings = list(reanalysis.analyze(run))
        impacts = [table for one in findings for table in one.impacts]
        return reanalysis.compare(run, reanalysis.measurements(iter(findings)), impacts)


def record(directory: Path, found: Iterable[tuple[str, Any]], provenance: Provenance | None = PROVENANCE) -> Path:
    """Write messages to a run and return its directory."""
    writer = RunWriter(directory, provenance=provenance, clock=time.monotonic)
    with writer:
        for name in sorted({name for name, _ in found}):
            kind = KINDS.get(name, POINT_CLOUD)
            writer.add_topic(TopicDescription(name=f"/rig/{name}", type_name=kind))
        newest_ns = 0
        for name, one in found:
            if isinstance(one, JournalEntry):
                data = journal.encode(one)
            else:
                data = codec.encode(one) if isinstance(one, Table) else one.encoded()
            newest_ns = max(newest_ns, one.stamp_ns)
            # the stamp of a label is the time from which it is valid, not that of its publication
            writer.write(f"/rig/{name}", data, newest_ns if name == "analysis/settings" else one.stamp_ns)
    return writer.directory
