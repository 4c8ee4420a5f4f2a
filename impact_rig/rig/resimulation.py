# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Run a rig again from its journal: the proof that nothing but the journal decided its samples."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator

from impact_rig.blocks import Table
from impact_rig.errors import ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.core import Block, Rig
from impact_rig.rig.journal import RESULTS, Change, Kind, changes, read
from impact_rig.rig.truth import TICKS_PER_S
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S


def resimulate(journal: Iterable[Table], base: RigConfig | None = None) -> Iterator[Block]:
    """Yield the blocks of the rig that wrote this journal, from its last start or reset on, without end.

    Args:
        journal: the tables of rig/journal, in order; the last `start` or `reset` in them begins.
        base: what the initial rows do not decide (`daq.block_scans` is in them): publishing options; default none.

    Raises:
        ConfigError: the journal is not whole or does not fit this version; the message says why.
    """
    yield from Resimulation(journal, base).blocks


class Resimulation:
    """The rig that wrote a journal, run again: see `resimulate`.

    Attributes:
        rig: the rig, ahead of the blocks that were taken.
        blocks: its blocks, without end.
        calibrations: `daq/info` whenever it became another one.
        configurations: the configuration at the start and after each change.
    """

    def __init__(self, journal: Iterable[Table], base: RigConfig | None = None) -> None:
        entries = read(journal)
        inputs = deque(changes(entries[1:]))
        initial = inputs.popleft().configuration if inputs and inputs[0].kind is Kind.INITIAL else {}
        self.rig = Rig(from_flat(base or RigConfig(), initial), entries[0].stamp_ns)
        self.calibrations: list[Table] = [self.rig.info()]
        self.configurations: list[RigConfig] = [self.rig.config]
        self._coming = inputs
        self.blocks = self._run()

    def finish(self, until_ns: int) -> None:
        """Give the rig what its journal says up to an instant, at which it was reset."""
        while self._coming and self._instant(self._coming[0]) <= until_ns:
            next(self.blocks)

    def _run(self) -> Iterator[Block]:
        rig = self.rig
        while self._coming:
            change = self._coming[0]
            if change.kind is not Kind.FAULT:  # a fault was ordered ahead of the scan its row names
                until_ns = self._instant(change)
                while rig.frontier_ns < until_ns:  # in parts: nobody knows how far away a damaged row is
                    yield from rig.advance(min(until_ns, rig.frontier_ns + NS_PER_S))
            apply(rig, self._coming.popleft())
            if change.kind is Kind.PARAMETER:
                self.configurations.append(rig.config)
                info, before = rig.info(), self.calibrations[-1]
                if (info.stamp_ns, info.rows.tobytes()) != (before.stamp_ns, before.rows.tobytes()):
                    self.calibrations.append(info)
        while True:
            yield from rig.advance(rig.block_end_ns(1))

    def _instant(self, change: Change) -> int:
        """Return the instant of the command grid at which an input took effect: the tick whose first scan it names."""
        return self.rig.start_ns + change.sample * TICKS_PER_S // self.rig.rate_hz * COMMAND_GRID_NS


def apply(rig: Rig, change: Change) -> None:
    """Give the rig, at its frontier, one input as journaled."""
    if change.kind is Kind.PARAMETER:
        rig.configure(change.configuration)
    elif change.kind is Kind.COMMAND and change.key == "frequency":
        rig.accept(frequency_hz=change.value)
    elif change.kind is Kind.COMMAND and change.key == "current":
        rig.accept(current_a=change.value)
    elif change.kind is Kind.PLUCK:
        rig.pluck(change.value)
    elif change.kind is Kind.STOP:
        rig.stop()
    elif change.kind is Kind.CLEAR_TRIP:
        rig.clear_trip()
    elif change.kind is Kind.FAULT:
        rig.inject(Fault.from_journal(change.key, change.value, change.text, change.sample))
    elif change.kind is Kind.CLEAR_FAULT:
        if not (math.isfinite(change.value) and change.value == int(change.value)):
            raise ConfigError(f"journal row {change.sequence}: no fault has the number {change.value!r}")
        rig.clear_fault(None if change.value < 0 else int(change.value))
    elif change.kind not in RESULTS:
        raise ConfigError(f"journal row {change.sequence}: {change.kind.value!r} cannot be in the middle of a journal")
