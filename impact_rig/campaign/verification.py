"""Prove a run: published = logged = re-simulated, or name the first difference."""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic import ARITHMETIC
from impact_rig.blocks import Table
from impact_rig.errors import CommandError, ConfigError, RecordingError, SimulationError
from impact_rig.recording import Run, arithmetic_of
from impact_rig.rig import resimulate
from impact_rig.simtime import NS_PER_S

_NO_JOURNAL = (ConfigError, CommandError, SimulationError)
"""What a journal raises that is incomplete, or no rig's."""


@attrs.frozen
class Verdict:
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


def verify(run: Run) -> Verdict:
    """Re-simulate a run from its journal and compare every scan, bit for bit.

    Raises:
        RecordingError: the run holds no scans, or is damaged.
    """
    if arithmetic_of(run.provenance) not in ("", str(ARITHMETIC)):
        return Verdict(None, 0, f"recorded with arithmetic {arithmetic_of(run.provenance)}, this is {ARITHMETIC}")
    scans = iter(run.tables("daq/scan", recorded_order=True))
    try:
        journal = list(run.tables("rig/journal", recorded_order=True))
        blocks = resimulate(journal)
        block = next(blocks)
    except (RecordingError, *_NO_JOURNAL) as error:
        return Verdict(None, 0, str(error))
    compared = 0
    for table in scans:
        try:
            while block.scan.stamp_ns < table.stamp_ns:  # the recorder came later than the rig's first block
                if compared:
                    return Verdict(False, compared, f"daq/scan: the block at {_s(block.scan.stamp_ns)} s is missing")
                block = next(blocks)
        except _NO_JOURNAL as error:
            return Verdict(None, compared, str(error))
        difference = _difference(table, block.scan)
        if difference:
            return Verdict(False, compared, difference)
        compared += len(table.rows)
        try:
            block = next(blocks)
        except _NO_JOURNAL as error:
            return Verdict(None, compared, str(error))
    if compared == 0:
        return Verdict(None, 0, "the run holds no block of daq/scan")
    return Verdict(True, compared)


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
