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
"""Re-simulation of a rig from its journal of inputs."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.blocks import Table
from impact_rig.errors import CommandError, ConfigError
from impact_rig.names import quoted
from impact_rig.physics.stream import ENDED, Buffer, Event
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.core import Block, Rig
from impact_rig.rig.interlock import check_stream
from impact_rig.rig.journal import InputKind, JournalEntry, last_journal
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S, TICKS_PER_S, first_scan_at

Samples = NDArray[np.float64]


class Sent(NamedTuple):
    """Block of samples on shaker/waveform, as it was recorded.

    Attributes:
        stamp_ns: rig time of the first sample [ns].
        samples: samples [A, m or V by `drive.kind`], shape (n,).
        received_ns: rig time at which the recorder received the block [ns], taken from the last scan recorded before.
        is_doubtful: whether a reset may have discarded the block. If so, the block is used only for samples that no
            other block contains.
    """

    stamp_ns: int
    samples: Samples
    received_ns: int = 0
    is_doubtful: bool = False


def resimulate(journal: Iterable[JournalEntry], waveform: Sequence[Sent] = ()) -> Iterator[Block]:
    """Simulate the rig that wrote this journal again, and yield its blocks, without end.

    The simulation begins at the last `start` or `reset`. After the last entry it continues without further inputs.
    Errors are raised only when blocks are requested.

    Args:
        journal: the entries of rig/journal, in order.
        waveform: messages of shaker/waveform if the drive is a stream, in the order that `RecordedSamples` needs.

    Raises:
        ConfigError: the journal is incomplete or does not fit this version, or `waveform` lacks a sample that took
            effect; the message says why.
        CommandError: the rig rejects an input of the journal.
        SimulationError: the motion cannot be simulated.
    """
    yield from Resimulation(journal, waveform=waveform).blocks


class RecordedSamples(Buffer):
    """Buffer of a stream that holds all samples of a recording.

    The buffer presents only those samples as buffered that took effect in the recorded rig. The stream events BEGIN and
    END in the rig's journal say which samples these are.

    Args:
        rig: re-simulated rig, driven by the stream.
        entries: entries of the recorded rig's journal after the first.
        waveform: blocks of samples in the order of their receipt, after the blocks that a reset may have discarded
            (`is_doubtful`). If several blocks contain a sample, the last block counts. A block that arrived after the
            time of the sample counts only if no earlier block, except doubtful ones, contains the sample. Blocks that
            the rig rejects are ignored.
    """

    def __init__(self, rig: Rig, entries: Iterable[JournalEntry], waveform: Sequence[Sent]) -> None:
        super().__init__(0)
        parts, last = [], 0
        rate, start_ns = rig.stream.rate_hz, rig.start_ns
        newest_ns = max((sent.received_ns for sent in waveform), default=0)
        most = rig.stream.capacity + 1 + first_scan_at(newest_ns, rate, start_ns)
        for stamp_ns, samples, received_ns, is_doubtful in waveform:
            with contextlib.suppress(CommandError):  # the rig had rejected it, too
                check_stream(samples, rig.config.drive, rig.config.shaker)
                first = rig.sample_at(stamp_ns)
                if 0 <= first + len(samples) <= most:
                    received = 0 if is_doubtful else first_scan_at(received_ns, rate, start_ns)
                    parts.append((np.arange(first, first + len(samples)), samples, received, is_doubtful))
                    last = max(last, first + len(samples))
        self._recorded, self._are_there, is_certain = np.zeros(last), np.zeros(last, np.bool_), np.zeros(last, np.bool_)
        for numbers, samples, received, is_doubtful in parts:
            taken = numbers >= 0
            taken[taken] = (numbers[taken] >= received) | ~is_certain[numbers[taken]]
            self._recorded[numbers[taken]] = samples[taken]
            self._are_there[numbers[taken]] = True
            is_certain[numbers[taken]] = not is_doubtful
        self._switches = [0]  # samples are active from each odd one of these to the next
        for entry in entries:
            if entry.kind is InputKind.STREAM and entry.name in (Event.BEGIN, Event.END):
                self._switches.append(int(entry.number))
            if entry.kind is InputKind.STREAM and entry.text == ENDED:
                self.ends.add(int(entry.number))
        self._sample_s = 1.0 / rig.stream.rate_hz

    def there(self, first: int, end: int) -> NDArray[np.bool_]:
        """Return, for each of the samples first … end − 1, whether it took effect in the recorded rig.

        The result is False after the end of both the recorded samples and the stream events in the journal.

        Raises:
            ConfigError: an earlier sample took effect but is not in the recording.
        """
        numbers = np.arange(first, end)
        wanted = np.searchsorted(self._switches, numbers, side="right") % 2 == 0
        held = np.zeros(end - first, np.bool_)
        known = self._are_there[first:end]
        held[: len(known)] = known
        lacking = numbers[wanted & ~held]
        if len(lacking) and (lacking[0] < len(self._recorded) or lacking[0] < self._switches[-1]):
            raise ConfigError(
                f"the recording lacks sample {lacking[0]} of {topics.WAVEFORM.name}, which drove the rig "
                f"{lacking[0] * self._sample_s:.6f} s after the start or reset according to the journal: "
                "record the run again, from before the stream begins"
            )
        held &= wanted
        return held

    def values(self, first: int, end: int) -> Samples:
        """Return the recorded values of samples first … end − 1; 0 for a sample that was not recorded.

        The result ends at the last recorded sample, so it may be shorter than end − first. Call `there` to
        learn which values to use.
        """
        found: Samples = self._recorded[first:end]
        return found

    def first_missing(self, first: int) -> int:
        """Return the number of the first sample from `first` on that did not take effect in the recorded rig.

        If the journal ends while samples take effect, the result is the number after the last recorded sample.
        """
        at = int(np.searchsorted(self._switches, first, side="right"))
        if at % 2:
            return first
        return self._switches[at] if at < len(self._switches) else max(first, len(self._recorded))

    def first_there(self, first: int) -> int | None:
        """Return the number of the first sample from `first` on that took effect in the recorded rig, or None.

        None means that according to the journal no more samples took effect.
        """
        at = int(np.searchsorted(self._switches, first, side="right"))
        if at % 2 == 0:
            return first
        return self._switches[at] if at < len(self._switches) else None

    def clear(self) -> None:
        """Do nothing: a stop of the stream discards no sample of the recording."""


class Resimulation:
    """Simulation of the rig that wrote a journal, from the last `start` or `reset` in it; see `resimulate`.

    Args:
        journal: the entries of rig/journal, in order.
        base: values that the first entry does not contain, by default those of `RigConfig()`.
        waveform: messages of shaker/waveform if the drive is a stream, in the order that `RecordedSamples` needs.

    Attributes:
        rig: the re-simulated rig, which may have been simulated further than the blocks taken from `blocks`.
        blocks: iterator of the rig's blocks, without end; taking blocks simulates the rig, and raises the errors of
            `resimulate`.
        calibrations: tables of `daq/info`, oldest first: at the start, and after each change simulated so far.
        configurations: the configuration at the start, and after each parameter change simulated so far.
    """

    def __init__(
        self, journal: Iterable[JournalEntry], base: RigConfig | None = None, waveform: Sequence[Sent] = ()
    ) -> None:
        first, *inputs = last_journal(journal)
        with _named(first):
            self.rig = Rig(from_flat(base or RigConfig(), first.values), first.stamp_ns)
        self.calibrations: list[Table] = [self.rig.info()]
        self.configurations: list[RigConfig] = [self.rig.config]
        self._coming = deque(inputs)
        self.blocks = self._run()
        if self.rig.config.drive.waveform == "stream":
            self.rig.stream.buffer = RecordedSamples(self.rig, inputs, waveform)

    def later_configurations(self) -> Iterator[RigConfig]:
        """Yield the configuration after each parameter change in the journal that is not simulated yet, in order."""
        config = self.rig.config
        for entry in self._coming:
            if entry.kind is InputKind.PARAMETER:
                with _named(entry):
                    config = from_flat(config, entry.values)
                yield config

    def finish(self, until_ns: int) -> None:
        """Simulate until all journal entries up to the rig time `until_ns` [ns] are applied, and drop the blocks.

        Afterwards `calibrations` and `configurations` contain all changes up to that time.
        """
        while self._coming and self._instant(self._coming[0]) <= until_ns:
            next(self.blocks)

    def _run(self) -> Iterator[Block]:
        rig = self.rig
        while True:
            change = self._coming[0] if self._coming else None
            until_ns = rig.block_end_ns(1) if change is None else self._instant(change)
            if change is None or rig.frontier_ns < until_ns:  # in steps: a damaged row may be arbitrarily far away
                yield from rig.advance(min(until_ns, rig.frontier_ns + NS_PER_S))
                continue
            with _named(change):
                apply(rig, self._coming.popleft())
            if change.kind is InputKind.PARAMETER:
                self.configurations.append(rig.config)
                info, before = rig.info(), self.calibrations[-1]
                if (info.stamp_ns, info.rows.tobytes()) != (before.stamp_ns, before.rows.tobytes()):
                    self.calibrations.append(info)

    def _instant(self, change: JournalEntry) -> int:
        """Return the rig time [ns] at which to apply a journal entry: the start of the tick with the entry's scan.

        A fault is applied at the time of scan 0, because the rig itself delays the fault to the entry's scan.
        """
        if change.kind is InputKind.FAULT:
            return self.rig.start_ns
        return self.rig.start_ns + change.sample * TICKS_PER_S // self.rig.rate_hz * COMMAND_GRID_NS


@contextlib.contextmanager
def _named(entry: JournalEntry) -> Iterator[None]:
    """Put a description of a journal entry in front of the message of a ConfigError or CommandError."""
    try:
        yield
    except (ConfigError, CommandError) as error:
        raise type(error)(
            f"entry {entry.sequence}, counted from 0, of the journal of inputs (`rig/journal`) cannot be simulated "
            f"again, so it was damaged or changed, or is of another version of impact_rig: {error}"
        ) from error


def apply(rig: Rig, change: JournalEntry) -> None:
    """Apply the input of a journal entry to a rig at its frontier, the first time that is not yet simulated.

    Entries of the kinds `start` and `reset`, and results of the simulation such as a trip, are skipped.

    Raises:
        ConfigError: the entry's values are invalid, or it is a command for something else than frequency or current.
        CommandError: the rig rejects the input.
    """
    if change.kind is InputKind.PARAMETER:
        rig.configure(change.values)
    elif change.kind is InputKind.COMMAND and change.name == "frequency":
        rig.accept(frequency_hz=change.number)
    elif change.kind is InputKind.COMMAND and change.name == "current":
        rig.accept(amplitude=change.number)
    elif change.kind is InputKind.PLUCK:
        rig.pluck(change.number)
    elif change.kind is InputKind.STOP:
        rig.stop()
    elif change.kind is InputKind.CLEAR_TRIP:
        rig.clear_trip()
    elif change.fault is not None:
        rig.inject(change.fault)
    elif change.kind is InputKind.CLEAR_FAULT:
        if change.value is not None and not change.value.is_integer():
            raise ConfigError(f"the number of the fault to clear must be an integer, got {change.value!r}")
        rig.clear_fault(None if change.value is None else int(change.value))
    elif change.kind is InputKind.COMMAND:
        raise ConfigError(f"a command must be for frequency or current, got {quoted(change.name)}")
