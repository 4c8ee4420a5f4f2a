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
"""Rig time is exact at any rate, for years."""

from __future__ import annotations

from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from impact_rig.simtime import NS_PER_S, stamp_ns

rates = st.integers(100, 250_000)
indices = st.integers(0, 2**53)
years_ns = st.integers(0, 100 * 365 * 86_400 * NS_PER_S)


@given(indices, rates, years_ns)
def test_a_stamp_is_the_exact_instant_rounded_down(index, rate, start):
    exact = start + Fraction(index, rate) * NS_PER_S
    assert 0 <= exact - stamp_ns(index, rate, start) < 1


def test_stamps_with_a_period_of_fractional_nanoseconds_do_not_drift():
    """At 25,600 S/s a period is 39,062.5 ns; rounded periods would add up to an error of 12.8 µs in a second."""
    assert stamp_ns(25_600, 25_600) == NS_PER_S
    assert [stamp_ns(i, 25_600) for i in range(4)] == [0, 39_062, 78_125, 117_187]
