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
"""`LocalRig`: a rig that is simulated in this process, with optional analysis and recording."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any  # value of a parameter

import attrs
import numpy as np
from numpy.typing import NDArray

import impact_rig
from impact_rig import codec, topics
from impact_rig.analysis.settings import TrackerSettings, settings_table
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import Table
from impact_rig.driver.driver import (
    ESSENTIAL,
    SCANS,
    STEP_TIMEOUT_S,
    TOPICS,
    NoSamplesError,
    RigDriver,
    StreamLevel,
    check_topics,
    configured,
)
from impact_rig.errors import ConfigError, RecordingError, did_you_mean
from impact_rig.instruments.fault import Fault
from impact_rig.recording import CONFIGURATION, Attachment, Provenance, RunWriter, TopicDescription
from impact_rig.rig import Block, Rig, journal
from impact_rig.rig.config import RigConfig, dump
from impact_rig.rig.description import joints
from impact_rig.rig.journal import JournalEntry
from impact_rig.simtime import stamp_ns

BATCH_BLOCKS = 50
TYPES = {topic.name: topic.type_name for topic in topics.COMMON}
KEPT_BYTES = 256_000_000  # limit of the kept tables; the oldest are dropped first: 10 minutes at 10 kS/s
KEPT_FAULTS = 100  # number of injected faults kept for reports
OBJECT_BYTES = 700  # memory of a table or entry, in addition to its rows
ANALYSED = (topics.IMPACTS.name, topics.TRANSMISSIBILITY_TABLE.name, topics.ANALYSIS_SETTINGS.name)
"""Topics whose tables the analysis of a `LocalRig` adds."""
NAMESPACE = "/rig"  # namespace of the topics in a recording made while the rig moves
JOINT_STATES = f"{NAMESPACE}/{topics.JOINT_STATES.name}"


class LocalRig(RigDriver):
    """Rig in this process, with optional analysis and recording.

    Rig time advances only in `step`, `run`, `run_to_sample`, `wait_until`, and `command` with `at_sample`. Inputs
    (`command`, `configure`, `inject` and `feed`) act at exact scans. `rows`, `tables` and `newest` return what the rig
    has published, and `save` writes it as a run. The same calls, except `reset`, operate a `RosRig`. Used as a context
    manager, it calls `close` at the end.

    Args:
        config: the configuration, or the values that differ from the paper's rig, `section.key` -> value, as in
            docs/reference/configuration.md. None means the paper's rig.
        faults: instrument faults to plan, in addition to those of the configuration.
        name: name of the rig in reports and error messages.
        analysis: fields of `TrackerSettings` that differ from their defaults, and `gap_m`, the gap [m] that the rows of
            the analysis state (0: no sphere; negative: unknown). An empty mapping means the defaults, None no analysis.
        record: new directory of a run to write while the rig moves; None means no recording.
        also: further topics whose tables are kept, such as `truth/scan`. docs/reference/interface.md lists all topics.
        kept_bytes: limit of the memory for kept tables [bytes], by default 256 MB: 10 minutes at 10,000 scans per
            second. The oldest are dropped first. None means no limit.

    Attributes:
        config (RigConfig): present configuration.
        sample (int): number of the first scan of the next block.
        core: the rig itself, for calls that this class does not offer: `pluck`, `stop`, `clear_trip`.
        tracker: the analysis, or None.

    Raises:
        ConfigError: a key or topic is unknown, or a value or fault is invalid.
        RecordingError: the run cannot be written.

    Examples:
        >>> import impact_rig
        >>> rig = impact_rig.LocalRig({"barriers.gap_m": 0.006}, analysis={"gap_m": 0.006})
        >>> first_scan = rig.command(frequency_hz=9.1, current_a=0.52)
        >>> rig.run(seconds=20)
        >>> print(f"DT {rig.rows('transmissibility/table')['transmissibility'][-1]:.2f}")
        DT 63.57

        Change the frequency, wait for the next measurement, and save what was published:

        >>> rig.clear()
        >>> first_scan = rig.command(frequency_hz=8.5)
        >>> at_s = rig.wait_until(lambda: b"ok" in rig.rows("transmissibility/table")["status"], "DT at 8.5 Hz")
        >>> row = rig.rows("transmissibility/table")[-1]
        >>> print(f"DT {row['transmissibility']:.2f} at {row['frequency']:g} Hz")
        DT 8.25 at 8.5 Hz
        >>> path = rig.save("gap_6mm")

    See Also:
        - `RosRig`: the same calls over ROS topics.
        - `simulate`: one run in one call.
        - `Rig`: the rig alone, at a lower level.
    """

    def __init__(
        self,
        config: RigConfig | Mapping[str, Any] | None = None,
        faults: Iterable[Fault] = (),
        name: str = "rig",
        *,
        analysis: Mapping[str, Any] | None = None,
        record: str | Path | None = None,
        also: Collection[str] = (),
        kept_bytes: int | None = KEPT_BYTES,
    ) -> None:
        super().__init__(name, configured(config, faults))
        settings, gap_m = _settings(analysis or {})
        self.core: Rig = Rig(self.config)
        self.tracker: Tracker | None = None if analysis is None else Tracker(settings)
        self._injected: deque[Fault] = deque(maxlen=KEPT_FAULTS)
        check_topics(also)
        names = dict.fromkeys((*TOPICS, *also, *(ANALYSED if analysis is not None else ())))
        self._kept: dict[str, deque[Any]] = {topic: deque() for topic in names}
        self._order: deque[tuple[str, Table | JournalEntry]] = deque()
        self._early: deque[tuple[str, Table | JournalEntry]] = deque()  # of `ESSENTIAL`, before what is kept
        self._early_counts: Counter[str] = Counter()
        self._bytes, self._early_bytes, self._kept_bytes = 0, 0, kept_bytes
        stream = (topics.WAVEFORM.name, topics.STREAM.name) if self.core.takes_samples else ()
        self._recording = None if record is None else self._new_recording(record, (*names, *stream), NAMESPACE)
        if self._recording is not None:
            self._recording.add_topic(TopicDescription(name=JOINT_STATES, type_name=topics.JOINT_STATES.type_name))
        if self.tracker is not None:
            self.tracker.configure(self.core.info())
            if gap_m is not None:
                self.tracker.label(gap_m, 0)
            label_m = math.nan if gap_m is None else gap_m
            self._publish(topics.ANALYSIS_SETTINGS.name, settings_table(settings, label_m, 0))
        self._info = b""
        self._publish_changes()

    def step(self, blocks: int = 1, timeout_s: float = STEP_TIMEOUT_S) -> None:  # noqa: ARG002  # never waits
        """Advance by whole blocks of scans.

        Args:
            blocks: number of blocks.
            timeout_s: ignored, because this rig never waits; for a `RosRig` the limit of wall time [s].

        Raises:
            TimeoutError: the stream that drives the rig lacks samples for a block; the blocks before it are done.
        """
        one_by_one = self._listeners or self._recording or self.core.takes_samples
        while blocks > 0:
            chunk = self.core.blocks_with_samples(1 if one_by_one else min(blocks, BATCH_BLOCKS))
            if chunk == 0:
                raise NoSamplesError(
                    f"the drive stream lacks samples for the next block: {self.stream_level()}; the blocks before it "
                    "are done: feed more, then step the others"
                )
            blocks -= chunk
            found = self.core.advance(self.core.block_end_ns(chunk))
            self._publish_changes()
            for block in found:
                self._deliver(block)

    def tables(self, topic: str = SCANS) -> list[Table]:
        """Return the tables of a topic that are kept, oldest first.

        Args:
            topic: name of the topic; by default `daq/scan`, with one table per block.

        Raises:
            ConfigError: the rig keeps no tables of this topic; the argument `also` of the rig adds topics.
        """
        return list(self._kept_of(topic, self._kept))

    def journal(self) -> list[JournalEntry]:
        """Return the journal entries since the start, oldest first; a reset drops none of them.

        An entry is an input that changed the rig's state. Once old entries, commands and calibrations fill half of
        `kept_bytes`, the oldest are dropped.
        """
        return list(self._kept[topics.JOURNAL.name])

    def configure(self, changes: Mapping[str, Any]) -> RigConfig:
        """Change configuration values from the first scan that is not measured yet.

        Values of `drive` and the seed apply only from the next reset. A change of the mechanics puts the sphere back to
        `sphere.start`.

        Args:
            changes: new values, `section.key` -> value, as in docs/reference/configuration.md.

        Returns:
            The new configuration.

        Raises:
            ConfigError: a key is unknown, or a value is invalid or fixed at the start; nothing is changed.
        """
        self.config = self.core.configure(changes)
        self._publish_changes()
        return self.config

    def reset(self) -> None:
        """Start again at scan 0 with everything at rest, as the service `rig/reset` does.

        The drive starts with the frequency and amplitude of the present configuration, not with those last commanded.
        Injected faults end. Kept tables stay. Stamps of rig time continue, so no stamp is used twice.

        Raises:
            CommandError: the shaker is stopped, which a reset must not clear.
            ConfigError: the limits of the shaker are below `drive.amplitude`, after `configure`; nothing is changed.
        """
        self.core.reset()
        self._start_ns, self.sample = self.core.start_ns, 0
        self._kept_from = self._lost_before = 0
        self._publish_changes()

    def inject(self, fault: Fault) -> int:
        """Add an instrument fault, which starts at its `start_sample`.

        Args:
            fault: the fault; its `start_sample` must not be measured yet, so set it: the default is 0.

        Returns:
            Number of the fault, from 1, for `core.clear_fault`. Planned faults have the first numbers. A reset restarts
            the count after the planned ones.

        Raises:
            CommandError: the channel is not present, or the scan has been measured already.
        """
        number = self.core.inject(fault)
        self._injected.append(fault)
        self._publish_changes()
        return number

    def feed(self, first: int, samples: NDArray[np.float64]) -> None:
        """Send samples of the stream that drives the rig (`drive.waveform: stream`).

        Samples that arrive too late are dropped, and counted as `late` in `stream_level`. Other samples replace earlier
        samples of the same number. At a gap, `step` raises a TimeoutError. Without `drive.stream_wait`, the rig instead
        does what `drive.on_underrun` says.

        Args:
            first: number of the first of these samples, counted from scan 0 at `stream_rate_hz`.
            samples: samples [A, m or V by `drive.kind`], shape (n,); an empty array ends the stream there.

        Raises:
            CommandError: the drive is no stream, the shaker is stopped, a pluck has locked the base, or a sample is not
                finite or exceeds shaker or buffer; then none of the samples is used.
        """
        self.core.feed(first, samples)
        if self._recording is not None:
            self._record(topics.WAVEFORM.name, self._samples(first, samples))

    def stream_level(self) -> StreamLevel:
        """Return the state of the buffer that holds the samples of the drive.

        Returns:
            Numbers of samples: `sample` (the next to play), `buffered`, `capacity`, `late` and `missing`.

        Raises:
            CommandError: the drive is no stream.
        """
        stream = self.core.stream
        late = int(self.core.stream_state().rows["late"][0])
        return StreamLevel(stream.played, stream.buffered(), stream.capacity, late, stream.missing)

    @property
    def stream_rate_hz(self) -> int:
        """Samples per second of the stream that drives the rig; a new `drive.stream_rate_hz` counts from a reset on."""
        return self.core.stream.rate_hz if self.core.takes_samples else super().stream_rate_hz

    @property
    def stopped(self) -> str:
        """Reason why the shaker is stopped by a trip or an emergency stop; empty if it is not stopped.

        It stays stopped, and the rig cannot be reset, until `core.clear_trip`.
        """
        return "" if self.core.latched is None else f"the rig tripped: {self.core.latched}"

    @property
    def waiting(self) -> str:
        """Reason why the analysis delays a measurement: the sphere may still strike.

        It is empty if nothing delays a measurement, and without an analysis. Empty does not mean that the measurement
        is finished.
        """
        progress = None if self.tracker is None else self.tracker.progress
        return "" if progress is None else progress.reason

    @property
    def faults(self) -> list[Fault]:
        """Instrument faults that the configuration plans, and the last 100 injected ones.

        Faults are listed even if they have ended or a reset has removed them.
        """
        return [*super().faults, *self._injected]

    def save(self, directory: str | Path) -> Path:
        """Write everything that is kept as an MCAP run.

        Args:
            directory: directory of the run, which must not exist yet.

        Returns:
            The directory.

        Raises:
            RecordingError: the directory exists, or the run cannot be written.
        """
        directory = Path(directory)
        if directory.exists():
            raise RecordingError(f"{directory} exists and is not overwritten; choose another directory")
        self._publish_changes()
        with self._new_recording(directory, self._kept, "") as recording:
            for topic, one in (*self._early, *self._order):
                recording.write(f"/{topic}", _encoded(one), one.stamp_ns)
        return directory

    def close(self) -> None:
        """End the rig, and finish the recording made while it moves (`record`), if there is one."""
        super().close()
        self._publish_changes()
        if self._recording is not None:
            self._recording.finish()

    def _new_recording(self, directory: str | Path, names: Iterable[str], namespace: str) -> RunWriter:
        provenance = Provenance(
            version=impact_rig.__version__,
            seed=self.config.daq.seed,
            wall_start_ns=time.time_ns(),
            extra={"mode": "in process", "namespace": namespace or "/"},
        )
        configuration = Attachment(CONFIGURATION, dump(self.config).encode(), "application/yaml")
        writer = RunWriter(directory, provenance=provenance, attachments=(configuration,), clock=time.monotonic)
        for name in names:
            writer.add_topic(TopicDescription(name=f"{namespace}/{name}", type_name=TYPES[name]))
        return writer

    def _command(self, frequency_hz: float | None, current_a: float | None) -> int:
        table = self.core.accept(frequency_hz, current_a)
        self._publish_changes()
        return int(table.rows["sample"][-1])

    def _deliver(self, block: Block) -> None:
        self.sample = block.first_scan + len(block.scan.rows)
        for topic, table in block.tables():
            if topic.name in self._kept:
                table.rows.flags.writeable = False  # read-only, as for a subscriber
                self._publish(topic.name, table)
        if self._recording is not None:
            for scan, row in zip(block.monitor_scans, block.monitor_states, strict=True):
                stamp = stamp_ns(block.first_scan + int(scan), self.rate_hz, self.core.start_ns)
                self._recording.write(JOINT_STATES, codec.encode_joint_state(stamp, *joints(row)), stamp)
            if self.core.takes_samples:
                self._record(topics.STREAM.name, self.core.stream_state())
        if block.lost:
            return
        if self.tracker is not None:
            found = self.tracker.feed(block.scan)
            for name, tables in zip(ANALYSED, (found.impacts, found.measurements), strict=False):
                for table in tables:
                    self._publish(name, table)
        for listener in self._listeners:
            listener(block.scan)

    def _publish_changes(self) -> None:
        """Publish what has changed since the last call: journal entries, applied commands and the calibration.

        Here, to publish means to keep for `tables` and to record. The analysis also gets commands and calibration.
        """
        entries = self.core.take_journal()
        if entries and (encoded := codec.encode(self.core.info())) != self._info:
            self._info, info = encoded, self.core.info()
            self._publish(topics.INFO.name, info)
            if self.tracker is not None:
                self.tracker.configure(info)
        for entry in entries:
            self._publish(topics.JOURNAL.name, entry)
        for table in self.core.take_applied():
            self._publish(topics.APPLIED.name, table)
            if self.tracker is not None:
                self.tracker.on_applied(table)

    def _publish(self, topic: str, one: Table | JournalEntry) -> None:
        self._record(topic, one)
        self._kept[topic].append(one)
        self._order.append((topic, one))
        self._bytes += _size(one)
        while self._kept_bytes is not None and self._bytes > self._kept_bytes and len(self._order) > 1:
            self._forget_oldest()
            while self._early_bytes > self._kept_bytes // 2 and self._forget_early():
                pass

    def _record(self, topic: str, one: Table | JournalEntry) -> None:
        if self._recording is not None:
            self._recording.write(f"{NAMESPACE}/{topic}", _encoded(one), one.stamp_ns)

    def _forget(self) -> None:
        while self._order:
            self._forget_oldest()

    def _forget_oldest(self) -> None:
        """Drop the oldest table or journal entry.

        A table or entry of a topic in `ESSENTIAL` is not dropped. It moves to `_early`.
        """
        topic, one = self._order.popleft()
        if topic in ESSENTIAL:
            self._early.append((topic, one))
            self._early_counts[topic] += 1
            self._early_bytes += _size(one)
            return
        self._kept[topic].popleft()
        self._bytes -= _size(one)
        if topic == SCANS and isinstance(one, Table) and one.stamp_ns >= self._start_ns:  # since the last reset
            first = self.first_scan(one)
            self._lost_before += first - self._kept_from
            self._kept_from = first + len(one.rows)

    def _forget_early(self) -> bool:
        """Drop the oldest message in `_early` whose topic has a later message there; return whether there was one.

        `_early` has the messages of topics in `ESSENTIAL` that are older than all other kept messages.
        """
        for index, (topic, one) in enumerate(self._early):
            if self._early_counts[topic] > 1:
                del self._early[index]
                self._early_counts[topic] -= 1
                self._kept[topic].popleft()
                self._early_bytes -= _size(one)
                self._bytes -= _size(one)
                return True
        return False


def _size(one: Table | JournalEntry) -> int:
    """Return the approximate memory that a table or journal entry occupies [bytes]."""
    return OBJECT_BYTES + (one.rows.nbytes if isinstance(one, Table) else len(one.text))


def _encoded(one: Table | JournalEntry) -> bytes:
    return journal.encode(one) if isinstance(one, JournalEntry) else codec.encode(one)


def _settings(analysis: Mapping[str, Any]) -> tuple[TrackerSettings, float | None]:
    """Return the settings of the analysis, and the operator's gap [m]: NaN if unknown, None if not given.

    `analysis` may have both; a negative `gap_m` means unknown.

    Raises:
        ConfigError: a setting is unknown or invalid.
    """
    settings = {name: value for name, value in analysis.items() if name != "gap_m"}
    known = ["gap_m", *(field.name for field in attrs.fields(TrackerSettings))]
    if unknown := next((name for name in settings if name not in known), ""):
        hint = did_you_mean(unknown, known, ", did you mean {!r}?", f": the settings are {', '.join(known)}")
        raise ConfigError(f"unknown setting {unknown!r} of the analysis{hint}")
    gap_m = analysis.get("gap_m")
    return TrackerSettings(**settings), math.nan if gap_m is not None and gap_m < 0.0 else gap_m
