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
"""Data for plotters: spectra whose heights are amplitudes, and envelopes that contain every impact."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from kits.rig import paper_rig

from impact_rig.analysis.blockwise import (
    HIGHEST_HZ,
    INTERVALS_HZ,
    PULSES,
    WINDOW_S,
    HighPass,
    Interval,
    Intervals,
    amplitude_spectrum,
)
from impact_rig.analysis.scans import Recent
from impact_rig.analysis.sine import fit_sine
from impact_rig.blocks import Table
from impact_rig.rig import Block, Rig
from impact_rig.simtime import NS_PER_S

RATE = 25_000
"""Every contact shows at this rate; at 10 kS/s both scans near a pulse can meet a zero: docs/reference/interface.md."""
STRONG_N = 5.0
SHOWS_M_S2, QUIET_M_S2 = 5.0, 0.5
LINE_RTOL = 0.005


@pytest.fixture(scope="module")
def blocks() -> list[Block]:
    """Blocks of a run at 10 mm gap and at resonance, with its transient."""
    rig = Rig(paper_rig(barriers__gap_m=0.01, drive__amplitude=0.52, daq__rate_hz=RATE, daq__block_scans=170))
    return rig.advance(8 * NS_PER_S)


@pytest.mark.heavy
def test_the_envelope_of_pulses_shows_every_impact_above_5_n_and_nothing_else(blocks: list[Block]) -> None:
    high_pass, intervals = HighPass(RATE, "accelerometer"), Intervals(RATE)
    found = [interval for block in blocks for interval in intervals.feed(high_pass.feed(block.scan))]
    heights = np.array([max(abs(value) for value in interval.extremes(PULSES)[:2]) for interval in found])
    tables = [block.impacts for block in blocks if block.impacts is not None]
    when = np.concatenate([table.stamp_ns + table.rows["time"] * NS_PER_S for table in tables])
    force = np.concatenate([table.rows["peak_force"] for table in tables])
    place = (when * INTERVALS_HZ / NS_PER_S).astype(int)
    seen = place < len(heights) - 1
    strong = place[(force > STRONG_N) & seen]
    assert len(strong) > 100
    assert heights[strong].min() > SHOWS_M_S2
    quiet = np.ones(len(heights), dtype=bool)
    quiet[np.concatenate([place[seen], place[seen] + 1])] = False  # a pulse rings on into the next
    assert heights[quiet].max() < QUIET_M_S2


@pytest.mark.parametrize("channel", ["laser", "accelerometer"])
def test_a_line_of_the_spectrum_is_as_high_as_the_fitted_sine(blocks: list[Block], channel: str) -> None:
    rows = np.concatenate([block.scan.rows for block in blocks])[-round(WINDOW_S * RATE) :]
    frequencies, amplitudes = amplitude_spectrum(rows[channel], RATE)
    near = np.abs(frequencies - 9.1) < 1.0
    fit = fit_sine(rows[channel], RATE, 9.1, harmonics=5)
    assert amplitudes[near].max() == pytest.approx(fit.amplitude, rel=LINE_RTOL)
    assert frequencies[-1] == HIGHEST_HZ


@pytest.mark.parametrize("frequency", np.linspace(20.0, 20.25, 6))
def test_a_line_between_two_bins_is_as_high_as_one_on_a_bin(frequency: float) -> None:
    time = np.arange(8000) / 2000.0
    frequencies, amplitudes = amplitude_spectrum(3.0 + 0.7 * np.sin(2 * np.pi * frequency * time + 1.0), 2000.0)
    assert np.diff(frequencies) == pytest.approx(1.0 / WINDOW_S)
    assert amplitudes.max() == pytest.approx(0.7, rel=2e-3)
    assert amplitudes[0] < 0.01, "the mean is no line"


def fed(intervals: Intervals, rows: np.ndarray, sizes: list[int], start_ns: int = 0) -> list[Interval]:
    found, first = [], 0
    for size in sizes:
        table = Table(start_ns + first * NS_PER_S // 1000, rows[first : first + size])
        found += list(intervals.feed(table))
        first += size
    return found


def test_intervals_do_not_depend_on_the_division_into_blocks() -> None:
    rows = np.zeros(100, dtype=[("laser", "<f8")])
    rows["laser"] = np.arange(100.0)
    cuts = [[100], [10] * 10, [7] * 14, [45, 55]]
    results = [[(i.stamp_ns, i.extremes("laser")) for i in fed(Intervals(1000), rows, cut)][:4] for cut in cuts]
    assert results[0][1] == (20_000_000, (20.0, 39.0, pytest.approx(np.sqrt(np.mean(np.arange(20.0, 40.0) ** 2)))))
    assert all(result == results[0] for result in results)


def test_an_interval_with_a_lost_block_is_left_out() -> None:
    rows = np.zeros(15, dtype=[("laser", "<f8")])
    intervals = Intervals(1000)
    assert not list(intervals.feed(Table(0, rows)))
    (only,) = intervals.feed(Table(30_000_000, np.zeros(20, rows.dtype)))
    assert only.stamp_ns == 30_000_000


def test_recent_scans_are_bounded_and_contain_no_gap() -> None:
    recent = Recent(1000, 25)
    for number in range(10):
        recent.add(Table(number * 10_000_000, np.zeros(10, dtype=[("laser", "<f8")])))
    assert (recent.count, recent.next_ns()) == (30, 100_000_000)
    gap = Table(500_000_000, np.zeros(10, dtype=[("laser", "<f8")]))
    assert not recent.follows(gap)
    recent.add(gap)
    assert (recent.count, len(recent.rows()), recent.stamp_ns(3)) == (10, 10, 503_000_000)
    assert recent.follows(attrs.evolve(gap, stamp_ns=510_000_000))
