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
"""Windows of the scope: every scan is in exactly one pair, gaps stay gaps, the trigger follows the current."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kits.lab import RATE, scans

from impact_rig.blocks import WAVEFORM, Table
from impact_rig_lab.scope import LONGEST_S, Scope, spectrum


def filled(seconds: float, **columns: object) -> Scope:
    scope = Scope(RATE)
    count = round(seconds * RATE)
    for first in range(0, count, 10):
        part = {name: values[first : first + 10] for name, values in columns.items()}  # type: ignore[index]
        scope.add(scans(first, 10, **part), 0)
    return scope


@given(st.floats(0.05, LONGEST_S), st.integers(16, 2000), st.integers(0, 1999))
def test_a_pulse_of_one_scan_is_visible_at_every_zoom(span: float, columns: int, place: int) -> None:
    values = np.zeros(12_000)
    at = 11_999 - place
    values[at] = 7.0
    scope = Scope(RATE)
    scope.add(scans(0, 12_000, laser=values), 0)
    trace = scope.window(span, columns)
    assert trace is not None
    begin, step = round(trace.begin_s * RATE), round(trace.column_s * RATE)
    shown = trace.low.shape[1] * step
    inside = begin <= at < begin + shown
    assert (np.nanmax(trace.high[1]) == 7.0) == inside
    assert trace.low.shape == trace.high.shape
    assert trace.low.shape[1] <= max(2 * columns, 2)


def test_long_windows_agree_with_short_ones() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=11_000)
    scope = filled(11.0, base=values)
    trace = scope.window(LONGEST_S, 500)
    assert trace is not None
    begin, step = round(trace.begin_s * RATE), round(trace.column_s * RATE)
    cut = values[begin : begin + 500 * step].reshape(-1, step).astype(np.float32)
    whole = slice(0, len(cut) - 1)
    np.testing.assert_array_equal(trace.high[2][whole], cut.max(axis=1)[whole])
    np.testing.assert_array_equal(trace.low[2][whole], cut.min(axis=1)[whole])


def test_missing_scans_are_drawn_as_a_gap() -> None:
    scope = Scope(RATE)
    scope.add(scans(0, 500, laser=1.0), 0)
    scope.add(scans(700, 300, laser=2.0), 0)
    trace = scope.window(1.0, 100)
    assert trace is not None
    assert np.isnan(trace.low[1][50:70]).all()
    assert not np.isnan(np.delete(trace.low[1], np.s_[50:70])).any()


FAST = 10_000
"""A rate at which three levels of pairs are kept, the coarsest over 20 scans."""
BLOCKS = st.lists(st.tuples(st.integers(0, 30_000), st.integers(1_000, 40_000)), min_size=5, max_size=10)


@given(BLOCKS, st.floats(0.05, LONGEST_S), st.integers(16, 2000), st.integers(0, 99), st.booleans())
@pytest.mark.repeats
def test_every_column_shows_only_the_latest_scans(
    blocks: list[tuple[int, int]], span: float, columns: int, seed: int, watched: bool
) -> None:
    """Scans arrive in blocks with gaps before them, more than once around the ring; they are noise, some over range."""
    rng = np.random.default_rng(seed)
    came = np.full(sum(gap + count for gap, count in blocks), np.nan, np.float32)
    status = np.zeros(len(came), np.uint8)
    scope, at = Scope(FAST), 0
    for gap, count in blocks:
        at += gap
        came[at : at + count] = rng.normal(size=count)
        status[at : at + count] = rng.random(count) < 1e-3
        scope.add(scans(at, count, rate_hz=FAST, laser=came[at : at + count], status=status[at : at + count]), 0)
        at += count
        if watched:
            scope.window(LONGEST_S, 500)
    trace = scope.window(span, columns)
    assert trace is not None
    begin, step = round(trace.begin_s * FAST), round(trace.column_s * FAST)
    for column in range(trace.low.shape[1]):
        first = begin + column * step
        if scope.begin + 20 <= first and first + step <= scope.end - 20:  # whole at every level
            part = came[first : first + step]
            assert np.array_equal(trace.low[1, column], np.fmin.reduce(part), equal_nan=True)
            assert np.array_equal(trace.high[1, column], np.fmax.reduce(part), equal_nan=True)
            assert trace.status[column] == np.bitwise_or.reduce(status[first : first + step])


def test_over_range_is_marked_column_by_column() -> None:
    status = np.zeros(1000, np.uint8)
    status[503] = 2
    scope = filled(1.0, status=status)
    trace = scope.window(1.0, 100)
    assert trace is not None
    assert np.flatnonzero(trace.status).tolist() == [50]
    assert trace.status[50] == 2


def test_the_window_begins_at_an_upward_zero_crossing_of_the_current() -> None:
    time = np.arange(5000) / RATE
    noise = np.random.default_rng(2).normal(scale=2e-3, size=5000)
    scope = filled(5.0, current=0.5 * np.sin(2 * np.pi * 9.1 * time) + noise)
    trace = scope.window(0.5, 500, trigger=True)
    assert trace is not None
    cycles = trace.trigger_s * 9.1
    assert abs(cycles - round(cycles)) < 0.03
    assert trace.begin_s == pytest.approx(trace.trigger_s)
    still = filled(1.0, current=np.zeros(1000)).window(0.5, 100, trigger=True)
    assert still is not None
    assert np.isnan(still.trigger_s)


def test_a_jump_back_in_time_clears_the_scope() -> None:
    scope = filled(3.0, laser=np.ones(3000))
    scope.add(scans(100, 50, laser=2.0), 0)
    assert (scope.begin, scope.end) == (100, 150)
    assert Scope(RATE).window(1.0, 10) is None


@pytest.mark.parametrize("event", ["lost scans", "jump back", "jump ahead", "clear"])
def test_commanded_samples_that_met_no_scan_are_not_drawn_later(event: str) -> None:
    """They remain in the ring buffer, whose positions the scans of one buffer length later have."""
    scope = filled(2.0)
    rows = np.zeros(1500, WAVEFORM)
    rows["value"] = 1.0
    scope.command(Table(2 * 10**9, rows), RATE, 0)
    if event == "clear":
        scope.clear()
    first = {"lost scans": 3000, "jump back": 1000, "jump ahead": 20_000, "clear": 2000}[event]
    for block in range(first, first + 15_000, 100):
        scope.add(scans(block, 100), 0)
        is_commanded = event == "lost scans" and block < 3500
        assert (np.isfinite(scope.stretch(0.1)[-1]) == is_commanded).all(), block


def test_the_spectrum_has_the_amplitude_of_a_sine() -> None:
    time = np.arange(2000) / RATE
    resolution, found = spectrum((3.0 * np.sin(2 * np.pi * 20 * time)).astype(np.float32), RATE, 100.0)
    assert resolution == pytest.approx(0.5)
    assert found.argmax() * resolution == pytest.approx(20.0)
    assert found.max() == pytest.approx(3.0, rel=1e-3)
    assert len(spectrum(np.zeros(3, np.float32), RATE, 100.0)[1]) == 0
