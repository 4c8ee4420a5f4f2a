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
"""Blocks: when they are complete, what they contain, and that later advances do not change them."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from kits.memory import growth
from kits.rig import START_NS, TICK, config, same

from impact_rig.rig import Rig
from impact_rig.simtime import NS_PER_S, stamp_ns


def test_a_block_is_returned_as_soon_as_it_is_complete() -> None:
    rig = Rig(config(), START_NS)
    assert rig.advance(START_NS + TICK - 1) == []
    assert [block.number for block in rig.advance(START_NS + TICK)] == [0]
    assert rig.advance(START_NS + TICK) == []
    assert rig.frontier_ns == START_NS + TICK


def test_a_long_block_is_simulated_tick_by_tick() -> None:
    """A command in realtime then waits for one tick, not for a block."""
    rig = Rig(config(daq__block_scans=10_000))
    assert rig.advance(25 * TICK + 1) == []
    assert rig.frontier_ns == 25 * TICK


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("rate_hz", "block_scans"),
    [(100, 1), (333, 3), (997, 7), (997, 1), (1_000, 13), (8_192, 82), (10_000, 100), (44_100, 1_001), (49_999, 5_000)],
)
def test_a_contact_belongs_to_the_block_in_which_it_ends(rate_hz: int, block_scans: int) -> None:
    """The calls advance by half a millisecond, by a block, by many blocks, or by everything at once."""
    chosen = config(
        daq__rate_hz=rate_hz,
        daq__block_scans=block_scans,
        instruments__ideal=True,
        drive__kind="prescribed",
        drive__amplitude=3e-3,
        shaker__ramp_s=0.0,
    )
    seconds = 2.0
    block_ns = block_scans * NS_PER_S / rate_hz
    found = []
    for step_ns in (500_000, block_ns, 7 * block_ns, 30_000_001, seconds * NS_PER_S):
        rig, until_ns, blocks = Rig(chosen), 0.0, []
        while until_ns < seconds * NS_PER_S:
            until_ns = min(until_ns + step_ns, seconds * NS_PER_S)
            blocks += rig.advance(round(until_ns))
        found.append([None if block.impacts is None else block.impacts.rows.tobytes() for block in blocks])
        ends = np.array(
            [row["time"] + row["duration"] for block in blocks if block.impacts for row in block.impacts.rows]
        )
        assert ends.max() < block_scans / rate_hz, "no impact is reported before it has ended"
        if step_ns == 500_000:
            assert len(ends) > 20
    assert all(one == found[0] for one in found)


def test_monitor_instants_are_scans_at_the_requested_rate() -> None:
    blocks = Rig(config(daq__rate_hz=25_600, daq__block_scans=256, output__monitor_rate_hz=200.0)).advance(NS_PER_S)
    indices = np.concatenate([block.first_scan + block.monitor_scans for block in blocks])
    assert np.array_equal(indices, np.arange(200) * 128)
    for block in blocks:
        assert np.array_equal(block.monitor_states["time"], block.monitor_scans / 25_600)


@pytest.mark.parametrize("then", [{"output.monitor_rate_hz": 20.0}, {"output.truth_scan": True}])
def test_a_block_has_the_monitor_instants_of_the_rate_at_its_end(then: dict[str, object]) -> None:
    """Monitor instants kept at the rate before, in the same block, are discarded."""
    rig = Rig(config(daq__block_scans=2_000, output__monitor_rate_hz=100.0))
    rig.advance(10 * TICK)
    rig.configure(then)
    first, second = rig.advance(40 * TICK)
    step = first.monitor_scans[1]
    assert step == (500 if "output.monitor_rate_hz" in then else 100)
    for block in (first, second):
        assert np.array_equal(block.monitor_scans, np.arange(0, 2_000, step))
        assert np.array_equal(block.monitor_states["time"], block.monitor_scans / 10_000)
    assert first.truth is None, "the truth of a part of its scans does not count"
    assert (second.truth is None) == ("output.truth_scan" not in then)


def test_a_change_that_is_reverted_before_the_next_tick_has_no_effect() -> None:
    rig, as_it_was = (Rig(config(daq__block_scans=2_000, output__truth_scan=True)) for _ in range(2))
    for one in (rig, as_it_was):
        one.advance(10 * TICK)
    rig.configure({"output.truth_scan": False, "output.monitor_rate_hz": 30.0})
    rig.configure({"output.truth_scan": True, "output.monitor_rate_hz": 50.0})
    (block,), (expected,) = rig.advance(20 * TICK), as_it_was.advance(20 * TICK)
    assert same(block.truth.rows, expected.truth.rows)
    assert same(block.monitor_states, expected.monitor_states)


@pytest.mark.heavy
def test_the_memory_of_the_rig_is_bounded() -> None:
    """The rig forgets blocks that it has returned: nothing in it grows with its running time."""
    rig = Rig(config(output__truth_scan=True))
    rig.advance(100 * TICK)  # allocations that happen only once
    handed_out = sum(block.scan.rows.nbytes + block.truth.rows.nbytes for block in rig.advance(200 * TICK))
    assert growth(lambda: rig.advance(500 * TICK)) < handed_out / 20


def test_later_calls_do_not_change_returned_blocks() -> None:
    """A later advance must not write into a block that has been returned."""
    rig = Rig(config())
    (block,) = rig.advance(TICK)
    before = attrs.evolve(block), block.scan.rows.copy(), block.monitor_states.copy()
    rig.advance(20 * TICK)
    assert same(block.scan.rows, before[1])
    assert same(block.monitor_states, before[2])
    assert stamp_ns(0, 10_000) == block.scan.stamp_ns
