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
"""Sound but unusual recordings, and edits of them: `python -m qualification.sound_recordings`.

Rigs with rates from 100 Hz to 50 kHz and blocks of 1 to 5,000 scans are recorded while someone drives, resets, stops
and reconfigures them. Recorders join late, record in pairs, split their files, lag, or are killed. Of each recording
`info` must find it complete, `verify` must find it identical, and `analyze` must give the live results.

Then single edits are made: a message is altered, removed, repeated, exchanged or moved in time; a definition, an
attachment or a metadata record is altered, removed or added. An edited file has correct checksums and indexes.
`verify` must find each edit.

Exit status 1 if a recording is refused or an edit is missed; both are printed and can be repeated with `--only`.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import attrs
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from mcap.records import Attachment as AttachmentRecord
from mcap.writer import Writer
from rclpy.serialization import serialize_message
from rich.console import Console
from std_msgs.msg import Float64, String

from impact_rig import codec, topics
from impact_rig.analysis.settings import TrackerSettings, settings_table
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import WAVEFORM, Table
from impact_rig.errors import RecordingError
from impact_rig.instruments.fault import Fault
from impact_rig.nodes.messages import TOPICS
from impact_rig.nodes.publishers import Monitors
from impact_rig.recording import (
    CONFIGURATION,
    Account,
    Attachment,
    Provenance,
    RunWriter,
    TopicDescription,
    digests,
    open_run,
    records,
)
from impact_rig.rig import Block, Rig, journal
from impact_rig.rig.config import RigConfig, Shaker, dump, from_flat
from impact_rig.rig.description import robot_description
from impact_rig.runs import info, reanalysis, recover
from impact_rig.runs.verification import Verification, verify
from impact_rig.simtime import NS_PER_S

BY_NAME = {topic.name: topic for topic in TOPICS}
SCAN = topics.SCAN.name
MOST_BLOCKS = 2_000  # largest number of blocks of a recording
START_NS = 1_780_000_000 * NS_PER_S  # system time of scan 0, as in real time


@attrs.frozen
class Sent:
    """A message as sent by its publisher."""

    topic: str
    data: bytes
    sent_ns: int
    sequence: int


@attrs.frozen(kw_only=True)
class Kind:
    """A kind of recording."""

    name: str
    rate_hz: int = 10_000
    block_scans: int = 100
    seconds: float = 4.0
    deeds: tuple[str, ...] = ()  # actions during the recording, evenly spaced
    values: tuple[tuple[str, object], ...] = ()  # differences from the default configuration
    in_real_time: bool = False  # whether stamps are system times; otherwise they begin at 0
    recorder: str = "plain"  # see `RECORDERS`


class Stage:
    """A rig, its analysis and a client, and every message that they publish."""

    def __init__(self, kind: Kind, seed: int) -> None:
        values = {
            "daq.rate_hz": kind.rate_hz,
            "daq.block_scans": kind.block_scans,
            "daq.seed": seed,
            "barriers.gap_m": 0.002,
            "time.mode": "realtime" if kind.in_real_time else "lockstep",
            **dict(kind.values),
        }
        self.random = np.random.default_rng(seed)
        self.rig = Rig(from_flat(RigConfig(), values), START_NS if kind.in_real_time else 0)
        self.sent: list[Sent] = []
        self._kind = kind
        self._counts: Counter[str] = Counter()
        self._now_ns = START_NS
        self._tracker = Tracker()
        self._monitors: Monitors | None = None
        self._config: RigConfig | None = None  # the one last published
        self._published: dict[str, bytes] = {}
        self._wave = 0  # number of samples of the stream sent so far
        self._streams = bool(dict(kind.values).get("drive.waveform") == "stream")
        self._is_fed = True
        self._tracker.label(0.002, 0)
        self._tracker.configure(self.rig.info())
        self.changes()
        self.send(topics.ANALYSIS_SETTINGS.name, codec.encode(settings_table(TrackerSettings(), 0.002, 0)))
        self.send(topics.NOTES.name, serialize_message(String(data="sound but unusual")))

    def send(self, topic: str, data: bytes) -> None:
        """Publish a message."""
        self._counts[topic] += 1
        self._now_ns += 20_000
        self.sent.append(Sent(topic, bytes(data), self._now_ns, self._counts[topic]))

    def send_once(self, topic: str, data: bytes) -> None:
        """Publish a message if it differs from the one before."""
        if self._published.get(topic) != data:
            self._published[topic] = data
            self.send(topic, data)

    def changes(self) -> None:
        """Publish what has changed, as the rig's node does."""
        for entry in self.rig.take_journal():
            self.send(topics.JOURNAL.name, journal.encode(entry))
        for table in self.rig.take_applied():
            self.send(topics.APPLIED.name, codec.encode(table))
            self._tracker.on_applied(table)
        calibration = self.rig.info()
        if self._published.get(topics.INFO.name) != codec.encode(calibration):
            self._tracker.configure(calibration)
        self.send_once(topics.INFO.name, codec.encode(calibration))
        noise = dict(zip(calibration.rows["name"].astype(str), calibration.rows["noise"].tolist(), strict=True))
        if self.rig.config is self._config:
            return
        self._config = self.rig.config
        text = serialize_message(String(data=dump(self.rig.config)))
        if self._published.get(topics.CONFIGURATION.name) != text:
            self._monitors = Monitors(self.rig.config, noise, self._monitors)
        self.send_once(topics.CONFIGURATION.name, text)
        urdf = serialize_message(String(data=robot_description(self.rig.config)))
        self.send_once(topics.ROBOT_DESCRIPTION.name, urdf)

    def run(self) -> list[Sent]:
        """Run the rig and return what was published."""
        kind = self._kind
        blocks = max(2, round(kind.seconds * kind.rate_hz / kind.block_scans))
        at = np.linspace(0, blocks - 1, len(kind.deeds) + 1).astype(int)[:-1] if kind.deeds else ()
        due: dict[int, list[str]] = {}
        for number, deed in zip(at, kind.deeds, strict=True):
            due.setdefault(int(number), []).append(deed)
        for number in range(blocks):
            for deed in due.get(number, ()):
                DEEDS[deed](self)
                self.changes()
            self._feed()
            for block in self.rig.advance(self.rig.block_end_ns(1)):
                self.changes()
                self._publish(block)
            if number % max(1, round(kind.rate_hz / kind.block_scans)) == 0:
                self._report(number)
        return self.sent

    def _publish(self, block: Block) -> None:
        assert self._monitors is not None
        self._now_ns += round(self._kind.block_scans / self._kind.rate_hz * NS_PER_S)
        tables = dict(block.tables())
        scan = tables.pop(topics.SCAN, None)
        for topic, table in tables.items():
            self.send(topic.name, codec.encode(table))
        for topic, data in self._monitors.messages(block, lambda _: True):
            self.send(topic.name, data)
        if scan is not None:
            self.send(SCAN, codec.encode(scan))
        if self._streams:
            self.send(topics.STREAM.name, codec.encode(self.rig.stream_state()))
        if self.rig.config.time.publishes_clock:
            seconds, nanoseconds = divmod(block.end_ns, NS_PER_S)
            self.send(
                topics.CLOCK.name, b"\0\1\0\0" + seconds.to_bytes(4, "little") + nanoseconds.to_bytes(4, "little")
            )
        if scan is None:
            return
        found = self._tracker.feed(scan)
        for table in found.impacts:
            self.send(topics.IMPACTS.name, codec.encode(table))
        for table in found.measurements:
            self.send(topics.TRANSMISSIBILITY_TABLE.name, codec.encode(table))
            for row in table.rows:
                if row["settled"] == 1.0:
                    value = Float64(data=float(row["transmissibility"]))
                    self.send(topics.TRANSMISSIBILITY.name, serialize_message(value))

    def _report(self, number: int) -> None:
        status = DiagnosticStatus(name="rig: simulation", message=f"running, block {number}", hardware_id="impact_rig")
        self.send(topics.DIAGNOSTICS.name, serialize_message(DiagnosticArray(status=[status])))

    # What happens

    def command(self, frequency_hz: float | None, amplitude: float | None) -> None:
        """Command the drive over its topics."""
        if frequency_hz is not None:
            self.send(topics.FREQUENCY.name, serialize_message(Float64(data=frequency_hz)))
            self.rig.accept(frequency_hz=frequency_hz)
            self.changes()
        if amplitude is not None:
            self.send(topics.CURRENT.name, serialize_message(Float64(data=amplitude)))
            self.rig.accept(amplitude=amplitude)

    def drive(self) -> None:
        """Command another drive, one that the analysis can measure."""
        self.command(round(float(self.random.uniform(8.8, 9.4)), 3), round(float(self.random.uniform(0.3, 0.6)), 3))

    def refused(self) -> None:
        """Send a command that the rig rejects: the topic contains it, the journal does not."""
        self.send(topics.CURRENT.name, serialize_message(Float64(data=1e6)))

    def reset(self) -> None:
        """Reset the rig."""
        self.rig.reset()

    def reset_off_grid(self) -> None:
        """Reset the rig after a part of a block."""
        part_ns = round(self._kind.block_scans / self._kind.rate_hz * NS_PER_S * self.random.uniform(0.1, 0.9))
        for block in self.rig.advance(self.rig.next_block_ns + part_ns):
            self._publish(block)
        self.rig.reset()

    def stop(self) -> None:
        """Stop the shaker, and release it."""
        self.rig.stop()

    def release(self) -> None:
        """Release the latch."""
        self.rig.clear_trip()
        self.rig.configure({"shaker.current_limit_a_rms": Shaker().current_limit_a_rms})  # as before a trip

    def trip(self) -> None:
        """Let the interlock trip."""
        self.rig.configure({"shaker.current_limit_a_rms": 0.05})

    def pluck(self) -> None:
        """Pluck the structure."""
        self.rig.pluck(1e-4)

    def parameters(self) -> None:
        """Change the gap."""
        self.rig.configure({"barriers.gap_m": round(float(self.random.uniform(0.001, 0.004)), 5)})

    def recalibrate(self) -> None:
        """Change an instrument."""
        self.rig.configure({"instruments.laser.lag_s": round(float(self.random.uniform(1e-3, 2e-3)), 6)})

    def fault(self) -> None:
        """Inject an instrument fault."""
        start = self.rig.frontier_sample + 20
        self.rig.inject(Fault(kind="spike_train", channel="laser", start_sample=start, value=1e-3, rate_hz=100.0 / 3.0))

    def lost_block(self) -> None:
        """Withhold blocks by a fault."""
        start, length = self.rig.frontier_sample + self._kind.block_scans, self._kind.block_scans
        self.rig.inject(Fault(kind="lost_block", start_sample=start, samples=length))

    def pause(self) -> None:
        """Hold rig time for a while."""
        self._now_ns += 7 * NS_PER_S

    def note(self) -> None:
        """Publish a remark."""
        self.send(topics.NOTES.name, serialize_message(String(data="äöü \u2603 " * int(self.random.integers(1, 40)))))

    def starve(self) -> None:
        """Send no more samples of the stream."""
        self._is_fed = False

    def feed_again(self) -> None:
        """Send samples again, from the next one needed on."""
        self._is_fed = True
        self._wave = max(self._wave, self.rig.stream.played)

    def _feed(self) -> None:
        if not self._streams or not self._is_fed:
            return
        stream = self.rig.stream
        wanted = round(2.5 * self._kind.block_scans / self._kind.rate_hz * stream.rate_hz) + 40
        missing = min(wanted, stream.capacity - 1) - (self._wave - stream.played)
        if missing > 0:
            number = np.arange(self._wave, self._wave + missing)
            values = 0.4 * np.sin(2 * np.pi * 9.1 * number / stream.rate_hz)
            stamp_ns = self.rig.start_ns + stream.time_ns(self._wave)
            rows = np.zeros(missing, WAVEFORM)
            rows["value"] = values
            table = Table(stamp_ns, rows)
            self.send(topics.WAVEFORM.name, codec.encode(table))
            self.rig.feed(self._wave, rows["value"].astype(float))
            self._wave += missing


DEEDS: dict[str, Callable[[Stage], None]] = {
    name: getattr(Stage, name)
    for name in (
        "drive", "refused", "reset", "reset_off_grid", "stop", "release", "trip", "pluck", "parameters", "recalibrate",
        "fault", "lost_block", "pause", "note", "starve", "feed_again",
    )
}  # fmt: skip


# Recorders


def joined_late(sent: Sequence[Sent], random: np.random.Generator, late: float) -> list[Sent]:
    """Return the messages of a recorder that joins after a part `late` of them, topic by topic, scans last."""
    begin = round(late * len(sent))
    joined = {name: begin + int(random.integers(0, 40)) for name in sorted({one.topic for one in sent})}
    joined[SCAN] = max(joined.values())
    history: dict[str, list[Sent]] = {}
    rest: list[Sent] = []
    for number, one in enumerate(sent):
        qos = BY_NAME[one.topic].qos
        if number >= joined[one.topic]:
            rest.append(one)
        elif qos.transient_local:
            history.setdefault(one.topic, []).append(one)
    kept = [one for name, found in history.items() for one in found[-BY_NAME[name].qos.depth :]]
    results = {topics.TRANSMISSIBILITY_TABLE.name}  # measured before: the recorder leaves it out
    return [*(one for one in kept if one.topic not in results), *rest]


def slow(sent: Sequence[Sent], random: np.random.Generator, lag_s: float) -> list[Sent]:
    """Return messages as they reach a slow machine: topics overtake each other, but a topic stays in order."""
    lags = {name: random.uniform(0.0, lag_s) for name in sorted({one.topic for one in sent})}
    lags[SCAN] = 0.0
    newest: dict[str, float] = {}
    arrivals = []
    first_scan = next(number for number, one in enumerate(sent) if one.topic == SCAN)
    for number, one in enumerate(sent):  # a recorder waits for what it needs before the first scan
        at = one.sent_ns + (NS_PER_S * lags[one.topic] * random.uniform(0.5, 1.0) if number >= first_scan else 0.0)
        newest[one.topic] = at = max(at, newest.get(one.topic, 0.0))
        arrivals.append((at, number, one))
    return [one for _, _, one in sorted(arrivals, key=lambda arrival: arrival[:2])]


def record(directory: Path, heard_of: dict[str, Sequence[Sent]], *, finish: bool = True, **options: int) -> Path:
    """Write the messages of rigs by namespace as the recorder's node does; without `finish` as if it were killed."""
    arriving = [(namespace, one) for namespace, sent in heard_of.items() for one in sent]
    if len(heard_of) > 1:
        arriving.sort(key=lambda pair: pair[1].sent_ns)
    before = itertools.takewhile(lambda pair: pair[1].topic != SCAN, arriving)
    texts = [one.data for _, one in before if one.topic == topics.CONFIGURATION.name]
    attachments = [Attachment("environment.json", b'{"machine": "qualification"}', "application/json")]
    if len(heard_of) == 1:  # a recorder of several rigs attaches no configuration
        attachments.append(Attachment(CONFIGURATION, texts[-1][8:].rstrip(b"\0"), "application/yaml"))
    writer = RunWriter(
        directory,
        provenance=Provenance(version="0", seed=1, wall_start_ns=START_NS, extra={"namespace": "/rig"}),
        attachments=attachments,
        account=Account(),
        clock=time.monotonic,
        chunk_bytes=64 * 1024,
        tail=True,
        **options,
    )
    known = set()
    for namespace, one in arriving:
        topic = BY_NAME[one.topic]
        name = topic.name if topic.name.startswith("/") else f"{namespace}/{topic.name}"
        if name not in known:
            known.add(name)
            writer.add_topic(TopicDescription(name=name, type_name=topic.type_name, type_hash="RIHS01_0"))
        writer.write(name, one.data, one.sent_ns, one.sequence)
    if finish:
        writer.finish()
    else:
        writer.secure()
        writer.stop(RecordingError("killed"))
    return directory


Recording = tuple[Path, str | None]  # a run, and the namespace of the rig to look at


def recordings(kind: Kind, seed: int, folder: Path) -> list[Recording]:
    """Make the recordings of a kind."""
    random = np.random.default_rng(seed + 1)
    sent = Stage(kind, seed).run()

    def made(name: str, heard_by: Sequence[Sent], **options: int) -> Recording:
        return record(folder / name, {"/rig": heard_by}, **options), None

    def recovered(name: str, heard_by: Sequence[Sent], part: float) -> Recording:
        """Kill a recorder after it has received a part of all messages, or truncate a finished file."""
        count = max(2, round(part * len(heard_by)))
        record(folder / name, {"/rig": heard_by[:count]}, finish=False)
        recover(folder / name, folder / f"{name}_recovered")
        return folder / f"{name}_recovered", None

    match kind.recorder:
        case "plain":
            return [made("run", sent)]
        case "root":
            return [(record(folder / "run", {"": sent}), None)]
        case "late":  # a stream must start later: without its first samples it cannot be simulated
            return [made("run", joined_late(sent, random, random.uniform(0.02, 0.6)))]
        case "two":
            return [made("one", sent), made("other", joined_late(sent, random, 0.3))]
        case "slow":
            return [made("run", slow(sent, random, 0.9))]
        case "slow and late":
            return [made("run", slow(joined_late(sent, random, 0.2), random, 0.6))]
        case "split":
            return [made("run", sent, max_file_bytes=100_000)]
        case "split in time":
            return [made("run", joined_late(sent, random, 0.1), max_file_duration_ns=NS_PER_S)]
        case "killed":
            return [recovered("run", sent, random.uniform(0.5, 1.0))]
        case "killed and slow":
            return [recovered("run", slow(sent, random, 0.9), random.uniform(0.7, 1.0))]
        case "cut":
            path, _ = made("run", sent)
            (file,) = path.glob("*.mcap")
            data = file.read_bytes()
            file.write_bytes(data[: round(len(data) * random.uniform(0.6, 0.95))])
            recover(path, folder / "recovered")
            return [(folder / "recovered", None)]
        case "two rigs":
            other = Stage(kind, seed + 1000).run()
            path = record(folder / "run", {"/left": sent, "/right": other})
            return [(path, "/left"), (path, "/right")]
    raise ValueError(kind.recorder)


def problems(recording: Recording, kind: Kind) -> list[str]:
    """Return the problems that the commands find in a sound recording; blocks withheld by a fault are missing."""
    path, rig = recording
    found = []
    summary = info(path)
    begins = "recovered: every checksum fits" if summary.recovered else "whole: "
    if "lost_block" in kind.deeds:
        is_whole = summary.scans is not None and summary.scans.whole
        recovered = "recovered: " if summary.recovered else ""
        begins = begins if is_whole else f"{recovered}every checksum fits, but 1 gaps in daq/scan"
    if not summary.verdict.startswith(begins):
        found.append(f"info: {summary.verdict}")
    with open_run(path, rig) as run:
        verdict = verify(run)
        if not verdict.identical:
            found.append(f"verify: {verdict}")
        findings = list(reanalysis.analyze(run))
        impacts = [table for one in findings for table in one.impacts]
        agreement = reanalysis.compare(run, reanalysis.measurements(iter(findings)), impacts)
        if agreement.same is False:
            found.append(f"analyze: {agreement}")
    return found


STREAM = (("drive.waveform", "stream"), ("drive.stream_rate_hz", 2_000))
ROWS: tuple[tuple[int, int, str, str], ...] = (
    # rate, block, recorder, what happens
    (100, 1, "plain", "drive"),
    (100, 7, "late", "drive reset"),
    (128, 128, "two", "drive parameters"),
    (200, 20, "slow", "drive drive note"),
    (250, 5_000, "plain", "drive"),
    (333, 3, "plain", "drive reset parameters"),
    (333, 3, "killed", "drive reset_off_grid drive"),
    (441, 49, "split", "drive drive pause"),
    (500, 5_000, "plain", "drive parameters"),
    (512, 1, "late", "drive stop release drive"),
    (777, 777, "two rigs", "drive"),
    (997, 7, "plain", "drive reset drive"),
    (997, 7, "cut", "drive reset parameters"),
    (1_000, 1, "slow", "drive drive"),
    (1_000, 500, "late", "drive drive drive"),
    (1_000, 150, "killed", "drive reset_off_grid reset_off_grid"),
    (1_024, 32, "split in time", "drive pluck reset drive"),
    (1_250, 3, "two", "drive trip release"),
    (1_999, 40, "plain", "drive reset_off_grid parameters recalibrate"),
    (2_000, 1, "plain", "drive"),
    (2_000, 2_000, "slow and late", "drive drive drive"),
    (2_048, 82, "root", "drive fault drive"),
    (2_500, 5_000, "killed and slow", "drive drive parameters drive"),
    (3_000, 1_000, "late", "drive reset drive"),
    (3_333, 10, "plain", "drive lost_block drive"),
    (4_096, 41, "cut", "drive fault recalibrate drive"),
    (4_410, 441, "two", "drive refused stop release drive"),
    (5_000, 5_000, "late", "drive drive drive drive"),
    (5_000, 50, "slow", "drive reset drive parameters"),
    (6_000, 13, "plain", "drive reset_off_grid drive lost_block"),
    (7_919, 101, "late", "drive parameters reset drive"),
    (8_000, 80, "split", "drive recalibrate drive"),
    (8_192, 82, "two rigs", "drive reset drive"),
    (9_999, 33, "plain", "drive reset pluck reset drive"),
    (10_000, 1, "plain", "drive"),
    (10_000, 100, "plain", "drive drive drive note"),
    (10_000, 100, "late", "drive reset drive pause drive"),
    (10_000, 100, "slow", "drive trip release parameters drive"),
    (10_000, 100, "killed", "drive drive reset drive"),
    (10_000, 100, "cut", "drive stop release drive reset drive"),
    (10_000, 100, "two", "drive lost_block fault drive"),
    (10_000, 150, "split in time", "drive reset_off_grid drive"),
    (10_000, 5_000, "slow and late", "drive parameters drive"),
    (10_000, 333, "root", "drive recalibrate reset drive"),
    (12_345, 67, "plain", "drive reset_off_grid parameters drive"),
    (16_000, 160, "late", "drive note drive"),
    (20_000, 4_096, "killed", "drive reset drive"),
    (22_050, 220, "two", "drive reset_off_grid drive"),
    (25_000, 25, "slow", "drive fault drive"),
    (44_100, 441, "split", "drive reset drive"),
    (48_000, 480, "cut", "drive parameters drive"),
    (50_000, 500, "plain", "drive pluck reset drive"),
    (50_000, 5_000, "late", "drive drive"),
    (50_000, 50, "killed and slow", "drive lost_block drive"),
    (10_000, 100, "plain", "starve feed_again starve"),
    (1_000, 10, "late", "starve note feed_again"),
    (997, 100, "plain", "starve"),
    (10_000, 1_000, "slow", "note starve feed_again reset starve"),
    (5_000, 50, "killed", "starve feed_again starve"),
    (2_000, 20, "split", "note reset starve feed_again"),
)


def kinds() -> list[Kind]:
    """Return the kinds, each with a name of its own."""
    found = []
    for number, (rate, block, recorder, deeds) in enumerate(ROWS):
        streams = "starve" in deeds
        seconds = max(2.0 if rate > 20_000 else 5.0, 3.2 * block / rate)
        seconds = min(seconds, MOST_BLOCKS * block / rate)
        found.append(
            Kind(
                name=f"{number:02d} {rate} Hz, blocks of {block}, {recorder}: {deeds}",
                rate_hz=rate,
                block_scans=block,
                seconds=seconds,
                deeds=tuple(deeds.split()),
                values=(
                    *(STREAM if streams else ()),
                    *((("output.truth_scan", True),) if number % 3 == 0 and block <= 2_000 else ()),
                    *((("output.monitor_rate_hz", 33.0),) if number % 4 == 1 else ()),
                    *((("sphere.present", False),) if number % 5 == 2 else ()),
                ),
                in_real_time=number % 2 == 1,
                recorder=recorder,
            )
        )
    return found


# Edits


@attrs.define
class Record:
    """A message of a file: topic, sequence number, log time, publish time, data."""

    topic: str
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


@attrs.define
class Contents:
    """Contents of a file, for editing."""

    topics: dict[str, TopicDescription]
    messages: list[Record]
    attachments: list[AttachmentRecord]
    metadata: list[tuple[str, dict[str, str]]]

    @classmethod
    def of(cls, path: Path) -> Contents:
        """Read the only file of a run."""
        with open_run(path) as run:
            (source,) = run.sources
            messages = []
            for segment in source.segments:
                for one in records.messages(source.content(segment), None):
                    name = source.topics[one.channel_id].name
                    messages.append(Record(name, one.sequence, one.log_time, one.publish_time, bytes(one.data)))
            found = {topic.name: topic for topic in source.topics.values()}
            return cls(found, messages, [one for one, _ in source.attachment_records()], source.metadata())

    def write(self, path: Path) -> Path:
        """Write a file with correct checksums, index and statistics."""
        writer = Writer(str(path))
        writer.start("ros2", "impact_rig")
        schemas: dict[tuple[str, str], int] = {}
        ids = {}
        for name, topic in self.topics.items():
            key = topic.type_name, topic.schema
            if key not in schemas:
                schemas[key] = writer.register_schema(topic.type_name, "ros2msg", topic.schema.encode())
            ids[name] = writer.register_channel(name, topic.encoding, schemas[key], topic.channel_metadata())
        for one in self.messages:
            writer.add_message(ids[one.topic], one.log_time, one.data, one.publish_time, one.sequence)
        for attachment in self.attachments:
            writer.add_attachment(
                attachment.create_time, attachment.log_time, attachment.name, attachment.media_type, attachment.data
            )
        for name, content in self.metadata:
            writer.add_metadata(name, content)
        writer.finish()
        return path

    def of_topic(self, topic: str) -> list[int]:
        """Return the indices of the messages of a topic."""
        return [number for number, one in enumerate(self.messages) if one.topic == topic]


Edit = Callable[[Contents, str, np.random.Generator], bool]
"""Edit of contents, at a topic if it needs one; returns False if there is nothing to edit."""


def _some(found: Contents, topic: str, random: np.random.Generator) -> Record:
    return found.messages[int(random.choice(found.of_topic(topic)))]


def alter_payload(found: Contents, topic: str, random: np.random.Generator) -> bool:
    """Flip a bit of a message after its encapsulation."""
    one = _some(found, topic, random)
    data = bytearray(one.data)
    if len(data) <= 4:
        return False
    data[int(random.integers(4, len(data)))] ^= 1 << int(random.integers(0, 8))
    one.data = bytes(data)
    return True


def alter_end(found: Contents, topic: str, random: np.random.Generator) -> bool:
    """Append a byte to a message."""
    _some(found, topic, random).data += b"\1"
    return True


def remove(found: Contents, topic: str, random: np.random.Generator) -> bool:
    """Remove a message."""
    del found.messages[int(random.choice(found.of_topic(topic)))]
    return True


def remove_last(found: Contents, topic: str, random: np.random.Generator) -> bool:  # noqa: ARG001
    """Remove the last message."""
    del found.messages[found.of_topic(topic)[-1]]
    return True


def remove_topic(found: Contents, topic: str, random: np.random.Generator) -> bool:  # noqa: ARG001
    """Remove a topic with all its messages."""
    found.messages = [one for one in found.messages if one.topic != topic]
    del found.topics[topic]
    return True


def repeat(found: Contents, topic: str, random: np.random.Generator) -> bool:
    """Repeat a message."""
    place = int(random.choice(found.of_topic(topic)))
    found.messages.insert(place, attrs.evolve(found.messages[place]))
    return True


def exchange(found: Contents, topic: str, random: np.random.Generator) -> bool:
    """Exchange the data of two messages."""
    places = found.of_topic(topic)
    if len(places) < 2:
        return False
    one, other = (found.messages[int(place)] for place in random.choice(places, 2, replace=False))
    if one.data == other.data:
        return False
    one.data, other.data = other.data, one.data
    return True


def move_log_time(found: Contents, topic: str, random: np.random.Generator) -> bool:
    """Move a log time."""
    _some(found, topic, random).log_time += 1
    return True


def move_publish_time(found: Contents, topic: str, random: np.random.Generator) -> bool:
    """Move a publish time."""
    _some(found, topic, random).publish_time += 1
    return True


def renumber(found: Contents, topic: str, random: np.random.Generator) -> bool:
    """Change a sequence number."""
    _some(found, topic, random).sequence += 100_000
    return True


def rename(found: Contents, topic: str, random: np.random.Generator) -> bool:  # noqa: ARG001
    """Rename a topic."""
    found.topics[f"{topic}x"] = attrs.evolve(found.topics.pop(topic), name=f"{topic}x")
    for one in found.messages:
        one.topic = f"{topic}x" if one.topic == topic else one.topic
    return True


def alter_schema(found: Contents, topic: str, random: np.random.Generator) -> bool:  # noqa: ARG001
    """Alter the schema of a topic."""
    found.topics[topic] = attrs.evolve(found.topics[topic], schema=found.topics[topic].schema + "\n# altered")
    return True


def alter_type_hash(found: Contents, topic: str, random: np.random.Generator) -> bool:  # noqa: ARG001
    """Alter the type hash of a topic."""
    found.topics[topic] = attrs.evolve(found.topics[topic], type_hash="RIHS01_1")
    return True


def alter_qos(found: Contents, topic: str, random: np.random.Generator) -> bool:  # noqa: ARG001
    """Alter the quality of service of a topic."""
    found.topics[topic] = attrs.evolve(found.topics[topic], offered_qos_text="- {reliability: best_effort}")
    return True


def alter_attachment(found: Contents, topic: str, random: np.random.Generator) -> bool:  # noqa: ARG001
    """Alter an attachment."""
    one = found.attachments[int(random.integers(len(found.attachments)))]
    one.data = bytes(one.data) + b" "
    return True


def remove_attachment(found: Contents, topic: str, random: np.random.Generator) -> bool:  # noqa: ARG001
    """Remove an attachment."""
    del found.attachments[int(random.integers(len(found.attachments)))]
    return True


def alter_metadata(found: Contents, topic: str, random: np.random.Generator) -> bool:  # noqa: ARG001
    """Alter a metadata record, with its checksum."""
    places = [place for place, (name, _) in enumerate(found.metadata) if name != digests.RECORD_NAME]
    place = int(random.choice(places))
    name, content = found.metadata[place]
    key = str(random.choice(sorted(content)))
    found.metadata[place] = name, {**content, key: content[key] + "0"}
    return True


def remove_metadata(found: Contents, topic: str, random: np.random.Generator) -> bool:  # noqa: ARG001
    """Remove a metadata record."""
    del found.metadata[int(random.integers(len(found.metadata)))]
    return True


def add_message(found: Contents, topic: str, random: np.random.Generator) -> bool:
    """Add a message of a topic of the graph that is in no recording."""
    found.topics["/rig/plot/new"] = attrs.evolve(found.topics[topic], name="/rig/plot/new")
    found.messages.append(attrs.evolve(_some(found, topic, random), topic="/rig/plot/new"))
    return True


OF_MESSAGES: tuple[Edit, ...] = (
    alter_payload, alter_end, remove, remove_last, repeat, exchange, move_log_time, move_publish_time, renumber,
    remove_topic, rename, alter_schema, alter_type_hash, alter_qos, add_message,
)  # fmt: skip
OF_FILES: tuple[Edit, ...] = (alter_attachment, remove_attachment, alter_metadata, remove_metadata)


def edits(found: Contents, count: int, seed: int) -> Iterator[tuple[str, Edit, str]]:
    """Yield edits by name: each kind of edit in turn, on each topic in turn."""
    random = np.random.default_rng(seed)
    names = sorted(found.topics)
    payloads = [(alter_payload, name) for name in names]
    others = [(edit, name) for edit in OF_MESSAGES[1:] for name in names]
    random.shuffle(others)
    chosen = [*payloads, *((edit, names[0]) for edit in OF_FILES * 3), *others][:count]
    for edit, name in chosen:
        yield f"{edit.__name__} {name if edit in OF_MESSAGES else ''}".strip(), edit, name


def verdict_of(path: Path) -> Verification | RecordingError:
    """Return the result of `verify` for a file."""
    try:
        with open_run(path) as run:
            return verify(run)
    except RecordingError as error:
        return error


def missed(path: Path, count: int, seed: int, folder: Path) -> Iterator[tuple[str, str]]:
    """Make edits of a recording one by one; yield each with how it was missed, or with an empty text."""
    original = Contents.of(path)
    assert getattr(verdict_of(original.write(folder / "same.mcap")), "identical", False), "a rewritten file is sound"
    random = np.random.default_rng(seed)
    for name, edit, topic in edits(original, count, seed):
        found = Contents.of(path)
        if not found.of_topic(topic) or not edit(found, topic, random):
            continue
        verdict = verdict_of(found.write(folder / "edited.mcap"))
        is_found = isinstance(verdict, RecordingError) or not verdict.identical
        yield name, "" if is_found else str(verdict)


def main() -> int:
    """Make recordings and edits, print which are rejected or missed, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0] if __doc__ else None)
    parser.add_argument("--seed", type=int, default=1, help="seed of everything random (default: 1)")
    parser.add_argument("--only", default="", help="make only recordings whose name contains this text")
    parser.add_argument("--edits", type=int, default=200, help="number of edits (default: 200)")
    arguments = parser.parse_args()
    console, wrong = Console(), 0
    chosen = [kind for kind in kinds() if arguments.only in kind.name]
    sources: list[Path] = []
    with tempfile.TemporaryDirectory() as name:
        for number, kind in enumerate(chosen):
            folder = Path(name) / str(number)
            folder.mkdir()
            made = recordings(kind, arguments.seed + number, folder)
            found = [problem for one in made for problem in problems(one, kind)]
            wrong += bool(found)
            console.print(f"{kind.name}: {'; '.join(found) or 'sound'}", style="red" if found else None, markup=False)
            if not found and len(list(made[0][0].glob("*.mcap"))) == 1 and kind.recorder in ("plain", "slow", "late"):
                sources.append(made[0][0])
        done: Counter[str] = Counter()
        share = -(-arguments.edits // max(1, len(sources)))
        for number, path in enumerate(sources):
            for edit, miss in missed(path, share, arguments.seed + number, Path(name)):
                done["missed" if miss else "found"] += 1
                if miss:
                    console.print(f"missed: {edit}: {miss}", style="red", markup=False)
    console.print(f"{len(chosen)} kinds, {wrong} refused; edits: {dict(done)}")
    return int(wrong > 0 or done["missed"] > 0)


if __name__ == "__main__":
    sys.exit(main())
