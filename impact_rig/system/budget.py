# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What reading somebody's recording or campaign may cost, before it is refused: one budget, one way to raise it.

Memory has fixed limits; work is bounded in proportion to the size of the files. A recording that is honest stays far
below; one made to fill the memory or to run for ever is refused by the figure that gives it away.
"""

from __future__ import annotations

import math
import os

import attrs

from impact_rig.errors import ImpactRigError

VARIABLE = "IMPACT_RIG_BUDGET"
"""Environment: every limit times this number, at least 1."""

MIB = 2**20
CHUNK_BYTES = 32 * MIB
"""Of a chunk when decompressed, and of every other record of a recording."""
HELD_BYTES = 64 * MIB
"""Of decompressed chunks that are in memory at once, because their messages are not in order."""
MESSAGE_BYTES = 500
"""What a message in memory costs besides its content."""
INDEX_BYTES = 16 * MIB
"""Of the index of one file."""
DECOMPRESSED_BYTES, DECOMPRESSED_PER_BYTE = 64 * MIB, 250
"""Of all chunks together: so many, and so many per byte of the files."""
RECORDS, RECORDS_PER_BYTE = 100_000, 1
"""Records in all chunks together, messages above all: so many, and so many per byte of the files."""
TOPICS = 5000
QOS_CHARACTERS = 4 * MIB
"""Of the texts of all topics that say which quality of service was offered."""
METADATA_BYTES = 512 * 1024
"""Of `metadata.yaml`; one that lists a thousand files has half of that."""
POINTS = 20_000
"""Measurements that a campaign asks for, repetitions included."""


class BudgetError(ImpactRigError):
    """Something from outside asks for more than the budget."""


def allow(what: str, amount: float, limit: float) -> None:
    """Refuse `amount` of something if it is above `limit` times the factor in the environment.

    Raises:
        BudgetError: it is; names both and how to raise the limit.
    """
    if amount > limit and amount > limit * factor():
        now = f"{limit * factor():.0f}"
        raise BudgetError(f"{amount:.0f} {what}, more than {now}; if you trust it: {VARIABLE}=N allows N times as much")


def factor() -> float:
    """Return by how much the user has raised all limits.

    Raises:
        BudgetError: what the environment says is no number >= 1.
    """
    text = os.environ.get(VARIABLE, "1")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value >= 1.0:
        raise BudgetError(f"{VARIABLE} must be a number >= 1, got {text!r}")
    return value


@attrs.define
class Spending:
    """What one pass through the chunks of a recording has cost so far.

    Attributes:
        size: of its files [bytes].
    """

    size: int
    _decompressed: int = attrs.field(default=0, init=False)
    _records: int = attrs.field(default=0, init=False)

    def chunk(self, size: int) -> None:
        """Take a chunk of `size` bytes into account, before it is decompressed.

        Raises:
            BudgetError: it is too large, or all are too large together.
        """
        allow("bytes in a chunk", size, CHUNK_BYTES)
        self._decompressed += size
        limit = DECOMPRESSED_BYTES + DECOMPRESSED_PER_BYTE * self.size
        allow(f"bytes in the chunks of {self.size} bytes of files", self._decompressed, limit)

    def records(self, count: int) -> None:
        """Take the records of a chunk into account.

        Raises:
            BudgetError: a chunk has too many to be held in memory, or all have too many together.
        """
        allow("records in a chunk", count, HELD_BYTES // MESSAGE_BYTES)
        self._records += count
        allow(f"records in {self.size} bytes of files", self._records, RECORDS + RECORDS_PER_BYTE * self.size)
