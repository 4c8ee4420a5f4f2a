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
"""The reduction with constant memory equals the textbook fit, and no division into blocks changes a bit."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from impact_rig.analysis.cycles import RANGE_BIT, Accumulator, Cycles, concatenate, normal_matrix, usable_harmonics

WIDE = np.full(4, np.inf)


def reduced(samples, rate_hz, frequency_hz, cuts, harmonics=3, origin=0):
    accumulator = Accumulator(rate_hz, frequency_hz, harmonics, origin, -WIDE, WIDE)
    status = np.zeros(samples.shape[1], np.uint8)
    edges = [0, *sorted(cuts), samples.shape[1]]
    for begin, end in itertools.pairwise(edges):
        accumulator.add(samples, status, begin, end)
    return accumulator.take(accumulator.pending_cycles)


@pytest.mark.parametrize("frequency_hz", [9.1, 73.3, 199.0])
def test_each_cycle_is_the_least_squares_fit_of_its_samples(frequency_hz):
    rng = np.random.default_rng(1)
    rate, harmonics = 10_000, 3
    samples = rng.standard_normal((4, 5000)) + 5.0
    cycles = reduced(samples, rate, frequency_hz, [])
    for m in (0, 1, len(cycles) - 1):
        k = cycles.first[m] + np.arange(cycles.samples[m])
        angle = 2 * np.pi * frequency_hz / rate * k
        design = np.column_stack(
            [np.ones(len(k)), *[f(h * angle) for h in range(1, harmonics + 1) for f in (np.cos, np.sin)]]
        )
        solution, residual, *_ = np.linalg.lstsq(design, samples[:, k].T, rcond=None)
        expected = (solution[1::2] - 1j * solution[2::2]).T
        assert np.allclose(cycles.phasors[m], expected, rtol=0, atol=1e-10)
        assert np.allclose(cycles.residual[m], residual, rtol=1e-8)
        assert np.allclose(cycles.mean[m], samples[:, k].mean(axis=1))
        assert np.allclose(cycles.variance[m], samples[:, k].var(axis=1), rtol=1e-9)


@settings(max_examples=30)
@given(phase=st.floats(-7, 7), step=st.floats(1e-3, 0.6), samples=st.integers(30, 400), harmonics=st.integers(1, 5))
def test_the_closed_form_of_the_normal_matrix_equals_the_sum(phase, step, samples, harmonics):
    angle = phase + step * np.arange(samples)
    design = np.column_stack(
        [np.ones(samples), *[f(h * angle) for h in range(1, harmonics + 1) for f in (np.cos, np.sin)]]
    )
    found = normal_matrix(np.array([phase]), np.array([samples]), step, harmonics)[0]
    assert np.allclose(found, design.T @ design, rtol=0, atol=1e-9 * samples)


@pytest.mark.heavy
@settings(max_examples=20)
@given(cuts=st.lists(st.integers(1, 19_999), max_size=30, unique=True), frequency_hz=st.floats(5.0, 200.0))
def test_results_do_not_depend_on_the_division_into_blocks(cuts, frequency_hz):
    samples = np.random.default_rng(2).standard_normal((4, 20_000))
    whole = reduced(samples, 10_000, frequency_hz, [])
    parts = reduced(samples, 10_000, frequency_hz, cuts)
    for name in ("first", "samples", "phasors", "mean", "variance", "residual"):
        assert getattr(whole, name).tobytes() == getattr(parts, name).tobytes(), name


def test_cycles_tile_the_stream_without_drift():
    """At 25,600 S/s and 9.1 Hz, a cycle is no whole number of scans: the k-th edge is the k-th multiple, rounded up."""
    cycles = reduced(np.ones((4, 256_000)), 25_600, 9.1, [], origin=77)
    assert np.array_equal(
        cycles.first + cycles.samples, np.append(cycles.first[1:], cycles.first[-1] + cycles.samples[-1])
    )
    assert np.array_equal(cycles.first - 77, np.ceil(np.arange(len(cycles)) * 25_600 / 9.1))


def test_cycles_taken_in_portions_equal_those_taken_at_once():
    samples = np.random.default_rng(3).standard_normal((4, 30_000))
    accumulator = Accumulator(10_000, 50.0, 2, 0, -WIDE, WIDE)
    accumulator.add(samples, np.zeros(30_000, np.uint8), 0, 30_000)
    parts = concatenate([accumulator.take(n) for n in (1, 60, 89)])
    assert isinstance(parts, Cycles)
    assert parts.phasors.tobytes() == reduced(samples, 10_000, 50.0, [], 2).phasors.tobytes()
    with pytest.raises(ValueError, match=r"count must be >= 1 and <= 0 .complete cycles., got 1"):
        accumulator.take(1)


@pytest.mark.parametrize("frequency_hz", [9.1, 50.0, 73.3])
def test_cycles_end_with_the_scan_that_completes_them(frequency_hz):
    samples, status = np.zeros((4, 30_000)), np.zeros(30_000, np.uint8)
    accumulator = Accumulator(10_000, frequency_hz, 2, 0, -WIDE, WIDE)
    done = 0
    for count in (1, 2, 7):
        end = accumulator.end(count)
        accumulator.add(samples, status, done, end - 1)
        assert accumulator.pending_cycles == count - 1, "one scan is missing"
        accumulator.add(samples, status, end - 1, end)
        assert accumulator.pending_cycles == count
        accumulator.take(count)
        done = end


def test_flags_name_the_channel_and_the_kind_of_problem():
    samples = np.zeros((4, 3000))
    samples[1, 150], samples[2, 1050], samples[0, 2050] = 2.0, np.nan, -np.inf
    status = np.zeros(3000, np.uint8)
    status[950] = 0b1000
    accumulator = Accumulator(10_000, 100.0, 1, 0, -np.ones(4), np.ones(4))
    accumulator.add(samples, status, 0, 3000)
    flags = accumulator.take(30).flags
    assert flags[1] == RANGE_BIT << 1
    assert flags[9] == 0b1000
    assert flags[10] == RANGE_BIT << 2
    assert flags[20] == RANGE_BIT << 0
    assert not flags[[0, 2, 11, 21, 29]].any(), "one bad value must not spoil the cycles after it"


@pytest.mark.parametrize(
    ("frequency_hz", "expected"),
    [(0.0, 0), (-1.0, 0), (np.nan, 0), (np.inf, 0), (1300.0, 0), (9.1, 5), (1200.0, 3), (1100.0, 4)],
)
def test_harmonics_stay_below_half_the_rate(frequency_hz, expected):
    assert usable_harmonics(10_000, frequency_hz, 5) == expected
    assert usable_harmonics(10_000, frequency_hz, 0) == 0, "never more than wanted"


@given(st.floats(8.0, 40.0), st.integers(1, 9))
@settings(deadline=None)
@example(8.9, 5)  # 8.9 scans a cycle: 0.45 of them allow 4 harmonics, but a cycle of 8 scans cannot tell 9 unknowns
def test_every_cycle_has_enough_samples_for_its_harmonics(scans_per_cycle, wanted):
    rate, count = 10_000.0, usable_harmonics(10_000.0, 10_000.0 / scans_per_cycle, wanted)
    wave = np.cos(2.0 * np.pi / scans_per_cycle * np.arange(400))
    cycles = reduced(np.tile(wave, (4, 1)), rate, rate / scans_per_cycle, [], count)
    expected = np.zeros(count)
    expected[0] = 1.0
    np.testing.assert_allclose(np.abs(cycles.phasors), np.broadcast_to(expected, cycles.phasors.shape), atol=1e-6)


def test_a_fit_without_degrees_of_freedom_has_no_variance():
    """With 11 scans per cycle, 5 harmonics and a mean, there are as many unknowns as scans."""
    n, channels, harmonics = 6, 4, 5
    cycles = Cycles(
        first=11 * np.arange(n),
        samples=np.full(n, 11),
        phasors=np.zeros((n, channels, harmonics), dtype=complex),
        mean=np.zeros((n, channels)),
        variance=np.zeros((n, channels)),
        residual=np.zeros((n, channels)),
        flags=np.zeros(n, dtype=np.int64),
        jump=np.zeros((n, channels)),
        impacts=np.zeros(n),
        strikes=np.zeros((n, 64), dtype=np.uint8),
    )
    assert cycles.degrees_of_freedom == 0
    with np.errstate(all="raise"):
        np.testing.assert_array_equal(cycles.residual_variance, np.zeros(channels))
