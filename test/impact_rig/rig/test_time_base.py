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
"""One time base: neither division into calls, block length, rate nor noise change a sample or an impact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kits.rig import START_NS, TICK, config, impacts, same, samples

from impact_rig.instruments.section import CHANNELS
from impact_rig.rig import Block, Rig
from impact_rig.simtime import NS_PER_S


@pytest.mark.heavy
@given(st.lists(st.integers(1, 130_000_000), min_size=1, max_size=12))
@settings(max_examples=5)
def test_readings_do_not_depend_on_the_division_into_calls(reference: list[Block], steps: list[int]) -> None:
    rig, blocks, now = Rig(config()), [], 0
    for step in steps:
        now = min(now + step, 60 * TICK)
        blocks += rig.advance(now)
    blocks += rig.advance(60 * TICK)
    assert [block.number for block in blocks] == list(range(60))
    assert same(samples(blocks), samples(reference))
    assert same(impacts(blocks), impacts(reference))
    for one, other in zip(blocks, reference, strict=True):
        assert same(one.monitor_states, other.monitor_states)
        assert one.scan.stamp_ns == other.scan.stamp_ns


@pytest.mark.heavy
@pytest.mark.parametrize("block_scans", [1, 37, 250, 6000])
def test_block_length_changes_no_scan_and_no_impact(reference: list[Block], block_scans: int) -> None:
    rig = Rig(config(daq__block_scans=block_scans))
    blocks = rig.advance(60 * TICK)
    scans = samples(blocks)
    assert len(blocks) == 6000 // block_scans
    assert same(scans, samples(reference)[: len(scans)])
    found = impacts(blocks)
    assert len(found) > 5
    assert same(found, impacts(reference)[: len(found)])


@pytest.mark.parametrize("rate_hz", [4000, 25_600, 50_000])
def test_the_scan_rate_does_not_move_an_impact(reference: list[Block], rate_hz: int) -> None:
    blocks = Rig(config(daq__rate_hz=rate_hz)).advance(61 * TICK)
    found, expected = impacts(blocks), impacts(reference)
    assert len(expected) > 5
    assert same(found[: len(expected)], expected)


@pytest.mark.parametrize("rate_hz", [10_000, 25_600, 44_100])
def test_stamps_are_computed_from_the_index(rate_hz: int) -> None:
    """At 25,600 S/s a period is 39,062.5 ns: adding up rounded periods would drift."""
    blocks = Rig(config(daq__rate_hz=rate_hz, daq__block_scans=97), START_NS).advance(START_NS + NS_PER_S)
    assert len(blocks) == rate_hz // 97
    for k, block in enumerate(blocks):
        assert block.first_scan == 97 * k
        assert block.scan.stamp_ns == START_NS + 97 * k * NS_PER_S // rate_hz
        assert block.end_ns == START_NS + 97 * (k + 1) * NS_PER_S // rate_hz
        assert np.array_equal(block.scan.rows["time"], np.arange(97) / rate_hz)


def test_a_seed_changes_noise_and_errors_but_no_impact(reference: list[Block]) -> None:
    other = Rig(config(daq__seed=2)).advance(60 * TICK)
    assert same(impacts(other), impacts(reference))
    for name in CHANNELS:
        assert not np.array_equal(samples(other)[name], samples(reference)[name])
    for one, two in zip(other, reference, strict=True):
        assert same(one.monitor_states, two.monitor_states), "the truth knows no noise"


def test_an_error_of_the_clock_scales_the_time_of_the_physics() -> None:
    """A scan clock that is 1000 ppm slow covers more true time between scans: the drive seems 1000 ppm faster."""
    slow = Rig(config(daq__clock_error_ppm=1000.0, instruments__ideal=True, sphere__present=False))
    current = samples(slow.advance(100 * TICK))["current"][2000:]
    seconds = (np.arange(len(current)) + 2000) / 10_000
    expected = 0.52 * np.sin(2 * np.pi * 9.1 * 1.001 * seconds)
    assert np.abs(current - expected).max() < 1e-9
