# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Prove a run: published = logged = re-simulated, or name the first difference."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import codec, topics
from impact_rig.arithmetic import ARITHMETIC
from impact_rig.blocks import Table
from impact_rig.errors import CommandError, ConfigError, RecordingError, SimulationError
from impact_rig.recording import Run, arithmetic_of
from impact_rig.rig import Block, Kind, resimulate
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S

_BEGINS = (Kind.START.value.encode(), Kind.RESET.value.encode())
_NO_JOURNAL = (ConfigError, CommandError, SimulationError)
"""What a journal raises that is incomplete, or no rig's."""


@attrs.frozen
class Verification:
    """What `verify` found.

    Attributes:
        identical: True, False, or None where the run cannot be verified.
        scans: scans that were compared.
        reason: the first difference, or why the run cannot be verified; empty when identical.
    """

    identical: bool | None
    scans: int
    reason: str = ""

    def __str__(self) -> str:
        if self.identical is None:
            return f"not verifiable here: {self.reason}"
        if self.identical:
            return f"identical: {self.scans} scans re-simulated bit for bit"
        return f"different after {self.scans} identical scans: {self.reason}"


def verify(run: Run) -> Verification:
    """Re-simulate a run from its journal and compare every scan, bit for bit; a start or reset begins a new journal.

    Raises:
        RecordingError: the run holds no scans, or is damaged.
    """
    if arithmetic_of(run.provenance) not in ("", str(ARITHMETIC)):
        return Verification(None, 0, f"recorded with arithmetic {arithmetic_of(run.provenance)}, this is {ARITHMETIC}")
    scans = run.tables(topics.SCAN.name, recorded_order=True)
    try:
        journals, first = _journals(run)
    except RecordingError as error:
        return Verification(None, 0, str(error))
    if not journals:
        return Verification(None, 0, "the journal is empty")
    compared, rest = 0, None
    for number, stretch in itertools.groupby(_assigned(scans, journals, first), key=lambda pair: pair[0]):
        if rest is not None and _is_missing(rest, journals[number][0].stamp_ns):
            return _missing(rest, compared)
        found, rest = _verify(journals[number], (table for _, table in stretch))
        compared += found.scans
        if not found.identical:
            return attrs.evolve(found, scans=compared)
    return Verification(True, compared) if compared else Verification(None, 0, "the run holds no block of daq/scan")


def _journals(run: Run) -> tuple[list[list[Table]], int]:
    """Return the journals of a run, each from its start or reset on, and which of them the first scan belongs to.

    Rows before the first start or reset are a journal without its beginning.
    """
    found: list[list[Table]] = []
    for table in run.tables(topics.JOURNAL.name, recorded_order=True):
        for rows in np.split(table.rows, np.flatnonzero(np.isin(table.rows["kind"], _BEGINS))):
            if len(rows) and (not found or rows["kind"][0] in _BEGINS):
                found.append([])
            if len(rows):
                found[-1].append(Table(table.stamp_ns, rows))
    scan, journal = run.resolve(topics.SCAN.name), run.resolve(topics.JOURNAL.name)
    both = run.messages([scan, journal], recorded_order=True)
    early = itertools.takewhile(lambda message: message.topic == journal, both)
    begun = sum(int(np.isin(codec.decode(message.data).rows["kind"], _BEGINS).sum()) for message in early)
    return found, max(0, begun - 1)


def _assigned(scans: Iterable[Table], journals: list[list[Table]], first: int) -> Iterator[tuple[int, Table]]:
    """Yield every block with the number of the journal it belongs to."""
    number, before_ns = first, None
    for table in scans:
        while number + 1 < len(journals):
            following, begun_ns = journals[number + 1][0], journals[number][0].stamp_ns
            if following.rows["kind"][0] == Kind.RESET.value.encode() or following.stamp_ns > begun_ns:
                is_next = table.stamp_ns >= following.stamp_ns  # stamps go on
            else:
                is_next = before_ns is not None and table.stamp_ns <= before_ns  # the rig was started anew, at 0 again
            if not is_next:
                break
            number, before_ns = number + 1, None
        before_ns = table.stamp_ns
        yield number, table


def _verify(journal: list[Table], scans: Iterator[Table]) -> tuple[Verification, Block | None]:
    """Compare the blocks of one journal; return also the block that would come next."""
    compared = 0
    try:
        blocks = resimulate(journal)
        block = next(blocks)
        for table in scans:
            while block.scan.stamp_ns < table.stamp_ns:  # the recorder came later than the rig's first block
                if compared and not block.lost:
                    return _missing(block, compared), None
                block = next(blocks)
            difference = _difference(table, block.scan)
            if difference:
                return Verification(False, compared, difference), None
            compared += len(table.rows)
            block = next(blocks)
    except _NO_JOURNAL as error:
        return Verification(None, compared, str(error)), None
    return Verification(True, compared), block


def _is_missing(block: Block, reset_ns: int) -> bool:
    """Return whether a block should have come before a reset.

    The rig simulates whole ticks, and a reset drops what it has not yet cut into a block: less than a tick.
    """
    on_grid = (block.end_ns - block.scan.stamp_ns) % COMMAND_GRID_NS == 0
    return not block.lost and block.end_ns + (0 if on_grid else COMMAND_GRID_NS) <= reset_ns


def _missing(block: Block, compared: int) -> Verification:
    return Verification(False, compared, f"daq/scan: the block at {_s(block.scan.stamp_ns)} s is missing")


def _difference(logged: Table, again: Table) -> str:
    """Return the first difference of two blocks (topic, stamp, sample, both values), or nothing."""
    if logged.stamp_ns != again.stamp_ns or len(logged.rows) != len(again.rows):
        return (
            f"daq/scan: logged {len(logged.rows)} scans at {_s(logged.stamp_ns)} s, "
            f"re-simulated {len(again.rows)} at {_s(again.stamp_ns)} s"
        )
    for name in again.rows.dtype.names or ():
        ours, theirs = again.rows[name], logged.rows[name]
        unequal = np.flatnonzero(_bits(ours) != _bits(theirs))
        if len(unequal):
            i = int(unequal[0])
            return (
                f"daq/scan at {_s(logged.stamp_ns)} s, sample {i}, {name}: "
                f"logged {theirs[i]!r}, re-simulated {ours[i]!r}"
            )
    return ""


def _bits(column: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a column's bits as integers: NaN equals NaN, and 0.0 differs from -0.0."""
    packed = np.ascontiguousarray(column)
    return packed.view(f"u{packed.dtype.itemsize}")


def _s(time_ns: int) -> str:
    return f"{time_ns // NS_PER_S}.{time_ns % NS_PER_S:09d}"
