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
"""A rig under test: advances in steps, takes inputs at exact samples, tells what it did; here in the test's process."""

from __future__ import annotations

import abc
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any  # what a parameter is

import numpy as np
from numpy.typing import NDArray

import impact_rig
from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.errors import CommandError, ConfigError, ImpactRigError, RecordingError
from impact_rig.instruments.fault import Fault
from impact_rig.instruments.section import SCAN
from impact_rig.recording import CONFIGURATION, Attachment, Provenance, RunWriter, TopicDescription
from impact_rig.rig import Block, Rig, journal
from impact_rig.rig.config import RigConfig, dump, from_flat, to_flat
from impact_rig.rig.journal import JournalEntry
from impact_rig.simtime import NS_PER_S, TICKS_PER_S

SCANS = topics.SCAN.name
ESSENTIAL = (topics.INFO.name, topics.APPLIED.name, topics.JOURNAL.name)
"""Never forgotten: what they say holds until the next of them."""
TOPICS = (SCANS, *ESSENTIAL, topics.IMPACTS_TRUTH.name, topics.FAULTS.name)
TYPES = {topic.name: topic.type_name for topic in topics.COMMON}
"""Tables that every rig under test keeps, and that are in the run of a failed test."""
_DEFAULTS = to_flat(RigConfig())
_UNSAID = ("time.", "instruments.faults")  # the same in every test; told in words
BATCH_BLOCKS = 50
KEPT_BYTES = 256_000_000  # scans beyond this are forgotten, oldest first: 10 minutes at 10 kS/s

Listener = Callable[[Table], object]


class NotReachedError(ImpactRigError, AssertionError):
    """What a test waited for did not happen in the simulated time it was given."""


class SteppedRig(abc.ABC):
    """A rig that only moves when told to.

    Args:
        name: what reports call it.
    """

    def __init__(self, name: str, config: RigConfig) -> None:
        self.name = name
        self.config = config
        self.sample = 0  # first scan of the next block: where the rig stands
        self.closed = False
        self._kept_from = 0

    # What a subclass fills in

    @abc.abstractmethod
    def step(self, blocks: int = 1) -> None:
        """Advance by whole blocks; when it returns the pipeline under test has processed all of them."""

    @abc.abstractmethod
    def tables(self, topic: str = SCANS) -> list[Table]:
        """Return what was published on a table topic, see `TOPICS`, oldest first."""

    @abc.abstractmethod
    def save(self, directory: Path) -> Path:
        """Write everything so far as an MCAP run into a directory that does not exist yet, and return it.

        Raises:
            RecordingError: it cannot be written.
        """

    @abc.abstractmethod
    def configure(self, changes: Mapping[str, Any]) -> RigConfig:
        """Change configuration values at the next instant; return the configuration.

        Raises:
            ConfigError: refused; nothing is changed.
        """

    @abc.abstractmethod
    def inject(self, fault: Fault) -> int:
        """Start a fault at its exact sample, which must not have been measured yet, and return its number.

        Raises:
            CommandError: unknown kind or channel, or too late.
        """

    def close(self) -> None:
        """End the rig."""
        self.closed = True

    @abc.abstractmethod
    def _command(self, frequency_hz: float | None, current_a: float | None) -> int:
        """Command and return the first scan it acts on."""

    # Time

    @property
    def rate_hz(self) -> int:
        """Scans per second."""
        return self.config.daq.rate_hz

    @property
    def block_scans(self) -> int:
        """Scans per block."""
        return self.config.daq.block_scans

    @property
    def frontier_sample(self) -> int:
        """First scan that is not measured yet, on which an input acts at the earliest."""
        return max(self.sample, first_scan_on_grid(self.sample, self.rate_hz))

    @property
    def time_s(self) -> float:
        """Rig time since the start or reset."""
        return self.sample / self.rate_hz

    def run(self, seconds: float) -> None:
        """Advance by this much rig time, rounded up to whole blocks."""
        self.step(math.ceil(seconds * self.rate_hz / self.block_scans - 1e-9))

    def run_to_sample(self, sample: int) -> None:
        """Advance until the next block begins with this scan.

        Raises:
            ConfigError: no block begins there, or the rig is past it.
        """
        blocks, rest = divmod(sample - self.sample, self.block_scans)
        if rest or blocks < 0:
            raise ConfigError(
                f"cannot run to sample {sample}: {self.name} is at {self.sample} and a block has {self.block_scans}"
            )
        if blocks:
            self.step(blocks)

    def wait_until(
        self, condition: Callable[[], object], what: str, limit_s: float = 30.0, every_s: float = 0.05
    ) -> float:
        """Advance until `condition()` is true, and return the rig time.

        Args:
            condition: asked before the first step, and after each.
            what: what is awaited, for the message.
            limit_s: rig time it may take.
            every_s: rig time between two looks, rounded up to whole blocks.

        Raises:
            NotReachedError: it did not become true in time.
        """
        begin, blocks = self.time_s, max(1, math.ceil(every_s * self.rate_hz / self.block_scans - 1e-9))
        while not condition():
            left = math.ceil((begin + limit_s - self.time_s) * self.rate_hz / self.block_scans - 1e-6)
            if left <= 0:
                raise NotReachedError(
                    f"waited {limit_s:g} s of rig time in vain for {what} "
                    f"({self.name} is at {self.time_s:g} s, {self._faults_so_far()})"
                )
            self.step(min(blocks, left))
        return self.time_s

    # Inputs

    def command(
        self, frequency_hz: float | None = None, current_a: float | None = None, *, at_sample: int | None = None
    ) -> int:
        """Command frequency [Hz] and current [A peak], and return the first scan they act on.

        Args:
            frequency_hz: None: as it is.
            current_a: None: as it is.
            at_sample: run up to this scan first; it must be a whole block and lie on the 10 ms grid of commands.

        Raises:
            CommandError: the scan is not a possible one, or the rig refused.
            ConfigError: the rig is past it.
        """
        if at_sample is None:
            return self._command(frequency_hz, current_a)
        if first_scan_on_grid(at_sample, self.rate_hz) != at_sample or at_sample % self.block_scans:
            raise CommandError(
                f"no command can act on sample {at_sample}: at {self.rate_hz} Hz commands act every "
                f"{self.rate_hz / TICKS_PER_S:g} samples, and a block has {self.block_scans}"
            )
        self.run_to_sample(at_sample)
        acts_on = self._command(frequency_hz, current_a)
        if acts_on != at_sample:
            raise CommandError(f"the command acts on sample {acts_on}, not on {at_sample}")
        return acts_on

    # What there is to compare with

    def rows(self, topic: str = SCANS) -> NDArray[np.void]:
        """Return the rows of all tables of a topic, one after the other; shape (n,)."""
        parts = [table.rows for table in self.tables(topic)]
        return np.concatenate(parts) if parts else np.empty(0, SCAN)

    def expected_transmissibility(self, frequency_hz: float) -> complex:
        """Return X_1 / X_b in closed form, which exists for a rig without its sphere.

        Raises:
            ConfigError: the sphere is there.
        """
        from impact_rig.physics.linear_response import transmissibility  # noqa: PLC0415  # loads compiled code

        if self.config.sphere.present:
            raise ConfigError("the closed form holds without the sphere: start the rig with sphere.present: false")
        return complex(transmissibility(self.config, frequency_hz))

    def lost_samples(self) -> list[tuple[int, int]]:
        """Return the scans that were not published, as (first, one after the last)."""
        lost, expected, start_ns = [], self._kept_from, self._start_ns()
        for table in self.tables():
            first = first_scan(table, start_ns, self.rate_hz)
            if first > expected:
                lost.append((expected, first))
            expected = first + len(table.rows)
        return lost if expected >= self.sample else [*lost, (expected, self.sample)]

    @property
    def faults(self) -> list[Fault]:
        """The faults that were planned."""
        return list(self.config.instruments.faults.faults(self.rate_hz))

    # Reports

    def report(self) -> str:
        """Return for people what this rig is and what happened to it."""
        values = to_flat(self.config)
        changed = [key for key, value in values.items() if value != _DEFAULTS[key] and not key.startswith(_UNSAID)]
        lines = [f"{self.name}: {self.time_s:g} s of rig time, {self.sample} scans at {self.rate_hz} Hz"]
        lines += [f"    {key} = {values[key]}" for key in changed]
        lines += [f"    fault: {fault}" for fault in self.faults]
        lines += [f"    scans {first} to {end - 1} were not published" for first, end in self.lost_samples()[:5]]
        applied = {int(row["sample"]): row for row in self.rows(topics.APPLIED.name)}
        for sample, row in list(applied.items())[-10:]:
            lines.append(f"    from scan {sample} on: {row['frequency']:g} Hz, {row['current']:g} A")
        return "\n".join(lines)

    def _start_ns(self) -> int:
        info = self.tables(topics.INFO.name)
        return info[0].stamp_ns if info else 0

    def _faults_so_far(self) -> str:
        begun = [str(fault) for fault in self.faults if fault.start_sample < self.sample]
        return f"faults: {'; '.join(begun)}" if begun else "no faults"


class VirtualRig(SteppedRig):
    """A rig in this process.

    Args:
        parameters: configuration values, `section.key` -> value, as in docs/interface.md.
        name: what reports call it.

    Raises:
        ConfigError: unknown key, bad value or fault.
    """

    def __init__(
        self, parameters: Mapping[str, object] | None = None, faults: Iterable[Fault] = (), name: str = "rig"
    ) -> None:
        super().__init__(name, configured(parameters or {}, faults))
        self.core = Rig(self.config)  # the rig itself, for what is not offered here (pluck, stop, clear_trip, ...)
        self._injected: list[Fault] = []
        self._listeners: list[Listener] = []
        self._kept: dict[str, deque[Any]] = {topic: deque() for topic in TOPICS}
        self._order: deque[tuple[str, Table | JournalEntry]] = deque()
        self._early: list[tuple[str, Table | JournalEntry]] = []
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

    def journal(self) -> list[JournalEntry]:
        """Return the entries of the journal, oldest first."""
        return list(self._kept[topics.JOURNAL.name])

    def configure(self, changes: Mapping[str, Any]) -> RigConfig:
        """Change configuration values; see `SteppedRig`."""
        before = codec.encode(self.core.info())
        self.config = self.core.configure(changes)
        self._changes()
        info = self.core.info()
        if codec.encode(info) != before:
            self._keep(topics.INFO.name, info)
        return self.config

    def inject(self, fault: Fault) -> int:
        """Start a fault; see `SteppedRig`."""
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
        provenance = Provenance(
            version=impact_rig.__version__,
            seed=self.config.daq.seed,
            wall_start_ns=time.time_ns(),
            extra={"mode": "stepped", "namespace": "/"},
        )
        configuration = Attachment(CONFIGURATION, dump(self.config).encode(), "application/yaml")
        if directory.exists():
            raise RecordingError(f"{directory} exists: nothing is overwritten")
        with RunWriter(directory, provenance=provenance, attachments=(configuration,), clock=time.monotonic) as writer:
            for topic in TOPICS:
                writer.add_topic(TopicDescription(name=f"/{topic}", type_name=TYPES[topic]))
            for topic, one in (*self._early, *self._order):
                data = journal.encode(one) if isinstance(one, JournalEntry) else codec.encode(one)
                writer.write(f"/{topic}", data, provenance.wall_start_ns)
        return directory

    def close(self) -> None:
        """Forget everything."""
        super().close()
        self._listeners.clear()

    def _command(self, frequency_hz: float | None, current_a: float | None) -> int:
        table = self.core.accept(frequency_hz, current_a)
        self._changes()
        return int(table.rows["sample"][-1])

    def _deliver(self, block: Block) -> None:
        self.sample = block.first_scan + len(block.scan.rows)
        for topic, table in block.tables():
            if topic.name in TOPICS:
                table.rows.flags.writeable = False  # as a subscriber gets it
                self._keep(topic.name, table)
        if not block.lost:
            for listener in self._listeners:
                listener(block.scan)

    def _changes(self) -> None:
        for entry in self.core.take_journal():
            self._keep(topics.JOURNAL.name, entry)
        for table in self.core.take_applied():
            self._keep(topics.APPLIED.name, table)

    def _keep(self, topic: str, one: Table | JournalEntry) -> None:
        self._kept[topic].append(one)
        self._order.append((topic, one))
        self._bytes += one.rows.nbytes if isinstance(one, Table) else 0  # entries are few
        while self._bytes > KEPT_BYTES and len(self._order) > 1:
            self._forget()

    def _forget(self) -> None:
        """Drop the oldest table, unless it is of those few that a run is worth nothing without."""
        topic, one = self._order.popleft()
        if isinstance(one, JournalEntry) or topic in ESSENTIAL:
            self._early.append((topic, one))
            return
        self._kept[topic].popleft()
        self._bytes -= one.rows.nbytes
        if topic == SCANS:
            self._kept_from = first_scan(self._kept[SCANS][0], self._start_ns(), self.rate_hz)


def first_scan_on_grid(sample: int, rate_hz: int) -> int:
    """Return the first scan on which a command can act that is not before `sample`."""
    tick = -(-sample * TICKS_PER_S // rate_hz)
    first = -(-tick * rate_hz // TICKS_PER_S)
    return first if first >= sample else -(-(tick + 1) * rate_hz // TICKS_PER_S)


def first_scan(table: Table, start_ns: int, rate_hz: int) -> int:
    """Return the index of the first scan of a block, from its stamp."""
    return -(-(table.stamp_ns - start_ns) * rate_hz // NS_PER_S)


def configured(parameters: Mapping[str, object], faults: Iterable[Fault]) -> RigConfig:
    """Return the configuration of a rig under test: defaults, `parameters` on top, and the faults.

    Raises:
        ConfigError: unknown key, bad value or fault.
    """
    config = from_flat(RigConfig(), {"time.mode": "stepped", **parameters})
    lines = [fault.line(config.daq.rate_hz) for fault in faults]
    return from_flat(config, {"instruments.faults.planned": lines}) if lines else config
