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
"""A reset starts the rig as if it were new; a pluck locks the base until the reset."""

from __future__ import annotations

import math

import numpy as np
import pytest
from kits.rig import START_NS, TICK, config, impacts, same, samples

from impact_rig.errors import CommandError
from impact_rig.rig import Block, Rig


def test_a_reset_rig_equals_a_new_one_with_later_stamps(reference: list[Block]) -> None:
    rig = Rig(config(), START_NS)
    rig.advance(START_NS + 17 * TICK)
    rig.accept(frequency_hz=20.0, amplitude=1.0)
    rig.advance(START_NS + 23 * TICK)
    rig.reset()
    assert rig.start_ns == START_NS + 23 * TICK
    blocks = rig.advance(rig.start_ns + 60 * TICK)
    assert blocks[0].scan.stamp_ns == START_NS + 23 * TICK
    assert (blocks[0].number, blocks[0].first_scan) == (0, 0)
    assert same(samples(blocks), samples(reference))
    assert same(impacts(blocks), impacts(reference))


def test_a_pluck_locks_the_base_and_lets_the_structure_ring_at_its_natural_frequency() -> None:
    rig = Rig(config(sphere__present=False, output__truth_scan=True))
    rig.advance(10 * TICK)
    rig.pluck(0.002)
    blocks = rig.advance(210 * TICK)
    truth = np.concatenate([block.truth.rows for block in blocks])
    assert np.all(truth["x_b"] == 0)
    assert truth["x_1"][0] == pytest.approx(0.002)
    crossings = np.flatnonzero(np.diff(np.signbit(truth["x_1"])))
    assert len(crossings) / 2 / 2.0 == pytest.approx(9.105, abs=0.3)
    zeta, cycles = 0.0044974, 18
    peaks = [np.abs(truth["x_1"][k * 1098 : (k + 1) * 1098]).max() for k in (0, cycles)]
    assert math.log(peaks[0] / peaks[1]) == pytest.approx(2 * math.pi * zeta * cycles, rel=0.05)
    with pytest.raises(CommandError, match="reset"):
        rig.accept(amplitude=0.5)
    rig.reset()
    rig.accept(amplitude=0.5)


def test_a_pluck_may_exceed_the_travel_of_the_table() -> None:
    rig = Rig(config())
    rig.pluck(0.008)
    assert abs(rig.advance(2 * TICK)[0].scan.rows["laser"][0]) > 0.0075
    for too_far in (math.inf, math.nan, 0.11, -0.11, 2.19e304):  # the last gave readings that were not finite
        with pytest.raises(CommandError, match=r"pluck: displacement_m must be .*0\.1"):
            rig.pluck(too_far)
