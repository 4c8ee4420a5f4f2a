"""Rig time is exact at any rate and for years."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S, grid_ceil, scans_before, stamp_ns

rates = st.integers(100, 250_000)
indices = st.integers(0, 2**53)
years_ns = st.integers(0, 100 * 365 * 86_400 * NS_PER_S)


@given(indices, rates, years_ns)
def test_a_stamp_is_the_exact_instant_rounded_down(index, rate, start):
    exact = start + Fraction(index, rate) * NS_PER_S
    assert 0 <= exact - stamp_ns(index, rate, start) < 1


def test_stamps_do_not_drift_where_the_period_is_no_whole_number_of_nanoseconds():
    """At 25 600 S/s a period is 39 062.5 ns; adding rounded periods would be 12.8 µs off after a second."""
    assert stamp_ns(25_600, 25_600) == NS_PER_S
    assert [stamp_ns(i, 25_600) for i in range(4)] == [0, 39_062, 78_125, 117_187]


@given(st.integers(0, 10**12), rates, years_ns)
def test_scans_before_counts_the_scans_that_lie_strictly_before(until, rate, start):
    count = scans_before(start + until, rate, start)
    assert count == 0 or Fraction(count - 1, rate) * NS_PER_S < until
    assert Fraction(count, rate) * NS_PER_S >= until


@given(rates, years_ns)
def test_no_scan_lies_before_the_start(rate, start):
    assert scans_before(start, rate, start) == 0
    assert scans_before(start - NS_PER_S, rate, start) == 0


@given(st.integers(0, 10**12), rates)
def test_cutting_time_anywhere_gives_the_same_scans(until, rate):
    """What `Rig.advance` relies on: counting up to a and then from a to b is counting up to b."""
    middle = until // 3
    assert scans_before(middle, rate) <= scans_before(until, rate)
    assert scans_before(until + 1, rate) - scans_before(until, rate) in (0, 1)


@pytest.mark.parametrize(
    ("time_ns", "grid_ns"),
    [(0, 0), (1, COMMAND_GRID_NS), (COMMAND_GRID_NS, COMMAND_GRID_NS), (COMMAND_GRID_NS + 1, 2 * COMMAND_GRID_NS)],
)
def test_a_command_takes_effect_at_the_next_instant_of_the_grid(time_ns, grid_ns):
    assert grid_ceil(time_ns) == grid_ns
