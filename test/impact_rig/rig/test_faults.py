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
"""Planned faults start and end with their lines; a lost block is reported as one."""

from __future__ import annotations

import numpy as np
import pytest
from kits.rig import TICK, config, resimulated

from impact_rig.errors import ConfigError
from impact_rig.instruments.fault import MOST
from impact_rig.rig import Rig
from impact_rig.rig.journal import InputKind


def test_faults_follow_the_list_of_planned_faults() -> None:
    """Times count from when the list is set; the journal contains the faults, so that a re-simulation has them too."""
    rig = Rig(config(instruments__faults__planned=["stuck channel=base start_s=0.005"]))
    blocks = rig.advance(10 * TICK)
    rig.configure({"instruments.faults.planned": ["dropout channel=laser start_s=0.02 duration_s=0.03"]})
    blocks += rig.advance(30 * TICK)
    rows = np.concatenate([block.faults.rows for block in blocks if block.faults is not None])
    found = [(row["kind"], row["channel"], row["sample"], row["active"], row["id"]) for row in rows]
    assert found == [
        (b"stuck", b"base", 50, 1, 1),
        (b"stuck", b"base", 1000, 0, 1),
        (b"dropout", b"laser", 1200, 1, 2),
        (b"dropout", b"laser", 1500, 0, 2),
    ]
    with pytest.raises(ConfigError, match="fault kind must be one of"):
        rig.configure({"instruments.faults.planned": ["explosion"]})
    rig.configure({"instruments.faults.planned": []})  # it has ended: nothing to clear
    blocks += rig.advance(40 * TICK)
    resimulated(blocks, rig.take_journal())
    rig.reset()
    assert all(block.faults is None for block in rig.advance(rig.frontier_ns + 10 * TICK))


def test_a_blank_line_plans_no_fault() -> None:
    """A blank line has no number of the board, neither at the start nor later."""
    stuck, dropout = "stuck channel=base", "dropout channel=laser"
    rig = Rig(config(instruments__faults__planned=[" ", stuck, dropout]))
    rig.configure({"instruments.faults.planned": [" ", "  ", stuck]})
    blocks = rig.advance(20 * TICK)
    rows = np.concatenate([block.faults.rows for block in blocks if block.faults is not None])
    assert [(row["kind"], row["active"]) for row in rows] == [(b"stuck", 1)]


def test_a_fault_that_has_ended_can_be_removed_before_its_block_is_complete() -> None:
    """A re-simulation divides blocks in another way, and must still know a fault that has ended."""
    line = "dropout channel=laser duration_s=0.0004"
    rig = Rig(config(daq__block_scans=10, instruments__faults__planned=[line]))
    blocks = rig.advance(TICK // 10)  # simulates a whole tick
    rig.configure({"instruments.faults.planned": []})
    blocks += rig.advance(5 * TICK)
    resimulated(blocks, rig.take_journal())


def test_a_planned_fault_on_two_lines_is_one_entry_of_the_journal() -> None:
    """The journal keeps one item on one line, so a re-simulation must not take the lines for two faults."""
    rig = Rig(config(instruments__faults__planned=["dropout\nchannel=laser\n"]))
    resimulated(rig.advance(5 * TICK), rig.take_journal())


def test_a_planned_fault_that_would_start_too_late_changes_nothing() -> None:
    """It must be rejected before the rest of the change is active and in the journal."""
    rig = Rig(config())
    rig.advance(5 * TICK)
    before = rig.config
    late = f"dropout channel=laser start_s={MOST / rig.rate_hz!r}"
    with pytest.raises(ConfigError, match="start_sample of the fault dropout must be at most"):
        rig.configure({"instruments.faults.planned": [late], "barriers.gap_m": 0.003})
    assert rig.config == before
    assert [entry.kind for entry in rig.take_journal()] == [InputKind.START]


def test_a_lost_block_is_numbered_and_marked() -> None:
    planned = ("lost_block start_s=0.03 duration_s=0.02",)
    blocks = Rig(config(instruments__faults__planned=planned)).advance(10 * TICK)
    assert [block.number for block in blocks if block.lost] == [3, 4]
    assert len(blocks) == 10
    states = [(row["kind"], row["active"]) for block in blocks if block.faults is not None for row in block.faults.rows]
    assert states == [(b"lost_block", 1), (b"lost_block", 0)]
