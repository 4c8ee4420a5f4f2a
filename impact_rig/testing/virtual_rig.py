# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The rig in the test's own process, without ROS: the pipeline under test is a function of blocks."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import impact_rig
from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.errors import RecordingError
from impact_rig.instruments.fault import Fault
from impact_rig.recording import CONFIGURATION, Attachment, Provenance, RunWriter, TopicDescription, schema_text
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig, dump
from impact_rig.testing.stepped_rig import SCANS, TOPICS, SteppedRig, configured, first_sample

BATCH_BLOCKS = 50
KEPT_BYTES = 256_000_000
"""Scans beyond this are forgotten, oldest first: 10 minutes at 10 kS/s."""

ESSENTIAL = (topics.INFO.name, topics.APPLIED.name, topics.JOURNAL.name)
"""Never forgotten: what they say holds until the next of them."""

Listener = Callable[[Table], object]


class VirtualRig(SteppedRig):
    """A rig in this process.

    Args:
        parameters: configuration values, `section.key` -> value, as in docs/interface.md.
        faults: faults of the instruments.
        name: what reports call it.

    Raises:
        ConfigError: unknown key, bad value or fault.
    """

    def __init__(
        self, parameters: Mapping[str, object] | None = None, faults: Iterable[Fault] = (), name: str = "rig"
    ) -> None:
        super().__init__(name, configured(parameters or {}, faults))
        self.core = Rig(self.config)
        """The rig itself, for what is not offered here (pluck, stop, clear_trip, ...)."""
        self._injected: list[Fault] = []
        self._listeners: list[Listener] = []
        self._kept: dict[str, deque[Table]] = {topic: deque() for topic in TOPICS}
        self._order: deque[tuple[str, Table]] = deque()
        self._early: list[tuple[str, Table]] = []
        self._bytes = 0
        self._keep(topics.INFO.name, self.core.info())
        self._changes()

    def connect(self, listener: Listener) -> None:
        """Give every published block of scans to a function, in order; what it commands acts at the next instant."""
        self._listeners.append(listener)

    def step(self, blocks: int = 1) -> None:
        """Advance by whole blocks, one at a time where a pipeline listens."""
        while blocks > 0:
            chunk = 1 if self._listeners else min(blocks, BATCH_BLOCKS)
            blocks -= chunk
            found = self.core.advance(self.core.block_end_ns(chunk))
            self._changes()
            for block in found:
                self._deliver(block)

    def tables(self, topic: str = SCANS) -> list[Table]:
        """Return what was published on a table topic, see `TOPICS`, oldest first."""
        return list(self._kept[topic])

    def configure(self, changes: Mapping[str, object]) -> RigConfig:
        """Change configuration values at the next instant; return the configuration.

        Raises:
            ConfigError: refused; nothing is changed.
        """
        before = codec.encode(self.core.info())
        self.config = self.core.configure(changes)
        self._changes()
        info = self.core.info()
        if codec.encode(info) != before:
            self._keep(topics.INFO.name, info)
        return self.config

    def inject(self, fault: Fault) -> int:
        """Start a fault at its exact sample, which must not have been measured yet, and return its number.

        Raises:
            CommandError: unknown kind or channel, or too late.
        """
        number = self.core.inject(fault)
        self._injected.append(fault)
        self._changes()
        return number

    @property
    def faults(self) -> list[Fault]:
        """The faults that were planned or injected."""
        return [*super().faults, *self._injected]

    def save(self, directory: Path) -> Path:
        """Write everything kept as an MCAP run.

        Raises:
            RecordingError: it cannot be written; the message interfaces (`sensor_msgs`) are needed for its schemas.
        """
        schema = schema_text(topics.TABLE)
        provenance = Provenance(
            version=impact_rig.__version__,
            seed=self.config.daq.seed,
            wall_start_ns=time.time_ns(),
            extra={"mode": "stepped", "namespace": "/"},
        )
        configuration = Attachment(CONFIGURATION, dump(self.config).encode(), "application/yaml")
        if directory.exists():
            raise RecordingError(f"{directory} exists: nothing is overwritten")
        with RunWriter(
            directory, provenance=provenance, attachments=(configuration,), clock=time.monotonic, rig_start_ns=0
        ) as writer:
            for topic in TOPICS:
                writer.add_topic(TopicDescription(name=f"/{topic}", type_name=topics.TABLE, schema=schema))
            for topic, table in (*self._early, *self._order):
                writer.write(f"/{topic}", codec.encode(table), provenance.wall_start_ns)
        return directory

    def close(self) -> None:
        """Forget everything."""
        self._listeners.clear()

    def _command(self, frequency_hz: float | None, current_a: float | None) -> int:
        table = self.core.accept(frequency_hz, current_a)
        self._changes()
        return int(table.rows["sample"][-1])

    def _deliver(self, block: Block) -> None:
        self.sample = block.first_sample + len(block.scan.rows)
        for topic, table in (
            (SCANS, None if block.lost else block.scan),
            (topics.IMPACTS_TRUTH.name, block.impacts),
            (topics.FAULTS.name, block.faults),
        ):
            if table is not None:
                table.rows.flags.writeable = False  # as a subscriber gets it
                self._keep(topic, table)
        if not block.lost:
            for listener in self._listeners:
                listener(block.scan)

    def _changes(self) -> None:
        for topic, tables in (
            (topics.JOURNAL.name, self.core.take_journal()),
            (topics.APPLIED.name, self.core.take_applied()),
        ):
            for table in tables:
                self._keep(topic, table)

    def _keep(self, topic: str, table: Table) -> None:
        self._kept[topic].append(table)
        self._order.append((topic, table))
        self._bytes += table.rows.nbytes
        while self._bytes > KEPT_BYTES and len(self._order) > 1:
            self._forget()

    def _forget(self) -> None:
        """Drop the oldest table, unless it is of those few that a run is worth nothing without."""
        topic, table = self._order.popleft()
        if topic in ESSENTIAL:
            self._early.append((topic, table))
            return
        self._kept[topic].popleft()
        self._bytes -= table.rows.nbytes
        if topic == SCANS:
            self._kept_from = first_sample(self._kept[SCANS][0], self._start_ns(), self.rate_hz)
