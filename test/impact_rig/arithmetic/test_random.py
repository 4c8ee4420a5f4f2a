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
"""Random number generator: distribution, numbers, and independence of how the calls are divided."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from impact_rig.arithmetic.random import Random

SIGMAS = 4.5  # two-sided chance of a false alarm per comparison: 7e-6

FIRST_NORMAL = ("0x1.59e8fdbe86efbp-1", "0x1.c6a05e995eb01p-1", "0x1.f491215715ed9p-2", "-0x1.aad284ea7f325p-1")
FIRST_UNIFORM = ("0x1.907425a697071p-1", "0x1.583fd9cd21549p-1", "0x1.eb1add046a09cp-2", "0x1.24169eb3448c0p-1")


def test_normal_numbers_are_standard_normal():
    numbers = Random(1).normal(1_000_000)
    assert abs(np.mean(numbers)) < SIGMAS / 1e3
    assert abs(np.var(numbers) - 1) < SIGMAS * math.sqrt(2 / 1e6)
    assert abs(stats.kurtosis(numbers)) < SIGMAS * math.sqrt(24 / 1e6)
    assert stats.kstest(numbers[:200_000], "norm").pvalue > 1e-4
    for lag in (1, 2, 17):
        assert abs(np.mean(numbers[lag:] * numbers[:-lag])) < SIGMAS / 1e3


def test_the_tail_of_normal_numbers_has_the_right_weight():
    numbers = Random(1).normal(2_000_000)
    beyond = np.sum(np.abs(numbers) > 3.7)  # the ziggurat's tail is code of its own
    expected = 4e6 * stats.norm.sf(3.7)
    assert abs(beyond - expected) < SIGMAS * math.sqrt(expected)


def test_uniform_numbers_are_evenly_distributed():
    numbers = Random(1).uniform(1_000_000)
    assert 0.0 <= numbers.min() < numbers.max() < 1.0
    assert abs(np.mean(numbers) - 0.5) < SIGMAS / math.sqrt(12e6)
    assert stats.kstest(numbers[:200_000], "uniform").pvalue > 1e-4
    assert (numbers * 2.0**53 == np.rint(numbers * 2.0**53)).all()


@pytest.mark.parametrize("kind", ["normal", "uniform"])
def test_a_stream_does_not_depend_on_how_it_is_divided_into_calls(kind):
    whole = getattr(Random(1), kind)(1000)
    parts = Random(1)
    np.testing.assert_array_equal(np.concatenate([getattr(parts, kind)(n) for n in (1, 0, 7, 500, 492)]), whole)
    assert not np.array_equal(getattr(Random(2), kind)(1000), whole)


def test_a_copy_is_independent_of_the_original():
    one = Random(1)
    one.normal(10)
    two = one.copy()
    np.testing.assert_array_equal(one.normal(10), two.normal(10))


def test_the_first_numbers_are_the_stored_ones():
    assert tuple(float(x).hex() for x in Random(1).normal(len(FIRST_NORMAL))) == FIRST_NORMAL
    assert tuple(float(x).hex() for x in Random(1).uniform(len(FIRST_UNIFORM))) == FIRST_UNIFORM


def test_the_bits_equal_those_of_the_reference_generator():
    """The bits are those of xoshiro256++ as its authors wrote it, here in Python integers."""
    state = [int(word) for word in np.random.SeedSequence(1).generate_state(4, np.uint64)]
    mask = 2**64 - 1

    def turned(x: int, k: int) -> int:
        return (x << k | x >> (64 - k)) & mask

    def following() -> int:
        result = (turned((state[0] + state[3]) & mask, 23) + state[0]) & mask
        t = state[1] << 17 & mask
        state[2] ^= state[0]
        state[3] ^= state[1]
        state[1] ^= state[2]
        state[0] ^= state[3]
        state[2] ^= t
        state[3] = turned(state[3], 45)
        return result

    np.testing.assert_array_equal(Random(1).uniform(100), [(following() >> 11) / 2**53 for _ in range(100)])
