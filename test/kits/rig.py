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
"""Rig that soon hits its walls, and the parts of its blocks that can be compared bit for bit."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.lib.recfunctions import repack_fields

from impact_rig.instruments.section import CHANNELS
from impact_rig.rig import Block, resimulate
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.journal import JournalEntry
from impact_rig.simtime import COMMAND_GRID_NS

TICK = COMMAND_GRID_NS
START_NS = 1_700_000_000_123_456_789


def paper_rig(**values: object) -> RigConfig:
    """Return the default rig with some values changed; keys have `__` for the point."""
    return from_flat(RigConfig(), {name.replace("__", "."): value for name, value in values.items()})


def config(**values: object) -> RigConfig:
    """Return a rig that hits its walls within half a second: resonance, 2 mm gap; keys have `__` for the point."""
    return paper_rig(**{"barriers__gap_m": 0.002, "drive__amplitude": 0.52, **values})


def samples(blocks: list[Block]) -> np.ndarray:
    """Return all scans of the blocks without their times, as rows that can be compared by bytes."""
    rows = np.concatenate([block.scan.rows for block in blocks])
    return repack_fields(rows[[*CHANNELS, "status"]])


def impacts(blocks: list[Block]) -> np.ndarray:
    """Return all true contacts, with the columns that do not depend on the block in which they were reported."""
    parts = [block.impacts.rows for block in blocks if block.impacts is not None]
    rows = np.concatenate(parts)
    return repack_fields(rows[[name for name in rows.dtype.names if name != "time"]])


def same(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two results are equal bit for bit."""
    return one.tobytes() == other.tobytes()


def resimulated(blocks: list[Block], journal: Iterable[JournalEntry]) -> list[Block]:
    """Return the blocks that the journal gives; assert that they equal these, scan by scan and stamp by stamp."""
    copies = [copy for copy, _ in zip(resimulate(journal), blocks, strict=False)]
    for copy, block in zip(copies, blocks, strict=True):
        assert copy.scan.stamp_ns == block.scan.stamp_ns, f"block {block.number}"
        assert same(copy.scan.rows, block.scan.rows), f"block {block.number}"
    return copies
