# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Run a rig again from its journal: the proof that nothing but the journal decided its samples."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator

from impact_rig.blocks import Table
from impact_rig.errors import ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.rig.block import Block
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.core import Rig
from impact_rig.rig.journal import RESULTS, Entry, Kind, read, values_of
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
    entries = read(journal)
    first, rest = entries[0], entries[1:]
    initial = list(itertools.takewhile(lambda entry: entry.kind is Kind.INITIAL, rest))
    rig = Rig(from_flat(base or RigConfig(), values_of(initial)), first.stamp_ns)
    for group in _changes(rest[len(initial) :]):
        if group[0].kind is not Kind.FAULT:  # a fault was ordered ahead of the scan its row names
            until_ns = rig.start_ns + _tick(group[0], rig) * COMMAND_GRID_NS
            while rig.frontier_ns < until_ns:  # in parts: nobody knows how far away a damaged row is
                yield from rig.advance(min(until_ns, rig.frontier_ns + NS_PER_S))
        apply(rig, group)
    while True:
        yield from rig.advance(rig.block_end_ns(1))


def apply(rig: Rig, group: list[Entry]) -> None:
    """Give the rig, at its frontier, one input as journaled (several rows where it was a change of parameters)."""
    entry = group[0]
    if entry.kind is Kind.PARAMETER:
        rig.configure(values_of(group))
    elif entry.kind is Kind.COMMAND and entry.key == "frequency":
        rig.accept(frequency_hz=entry.value)
    elif entry.kind is Kind.COMMAND and entry.key == "current":
        rig.accept(current_a=entry.value)
    elif entry.kind is Kind.PLUCK:
        rig.pluck(entry.value)
    elif entry.kind is Kind.STOP:
        rig.stop()
    elif entry.kind is Kind.CLEAR_TRIP:
        rig.clear_trip()
    elif entry.kind is Kind.FAULT:
        rig.inject(Fault.from_journal(entry.key, entry.value, entry.text.decode(), entry.sample))
    elif entry.kind is Kind.CLEAR_FAULT:
        if not (math.isfinite(entry.value) and entry.value == int(entry.value)):
            raise ConfigError(f"journal row {entry.sequence}: no fault has the number {entry.value!r}")
        rig.clear_fault(None if entry.value < 0 else int(entry.value))
    elif entry.kind not in RESULTS:
        raise ConfigError(f"journal row {entry.sequence}: {entry.kind.value!r} cannot be in the middle of a journal")


def _changes(entries: list[Entry]) -> Iterator[list[Entry]]:
    """Group rows that were one change: a parameter and the `more` rows after it."""
    changes = itertools.accumulate(entry.kind is not Kind.MORE for entry in entries)
    for _, group in itertools.groupby(zip(changes, entries, strict=True), lambda numbered: numbered[0]):
        yield [entry for _, entry in group]


def _tick(entry: Entry, rig: Rig) -> int:
    """Return the tick at which a row took effect: the one whose first scan it names."""
    return entry.sample * TICKS_PER_S // rig.rate_hz
