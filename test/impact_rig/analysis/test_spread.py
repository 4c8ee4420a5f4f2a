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
"""Uncertainty of correlated means, settling and regime, for processes whose result is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from impact_rig.analysis.cycles import PHASE_BINS
from impact_rig.analysis.settling import is_stationary, transient_bias
from impact_rig.analysis.spread import (
    REGULAR_SHARE,
    SUPPORT,
    batch_variance,
    by_class_removed,
    classify,
    shortest_period,
    student_2u,
    variance_of_mean,
)
from impact_rig.states import Regime

QUIET = np.zeros((192, PHASE_BINS), np.uint8)


def ar1(rng, n, coefficient):
    return signal.lfilter([1.0], [1.0, -coefficient], rng.standard_normal(n + 200))[200:]


def test_variance_of_the_mean_is_unbiased_for_white_noise():
    rng = np.random.default_rng(1)
    estimates = [variance_of_mean(rng.standard_normal(48)) for _ in range(4000)]
    assert np.mean(estimates) == pytest.approx(1 / 48, rel=0.03)


def test_variance_of_the_mean_includes_correlation():
    """An AR(1) process of coefficient 0.5 has a long-run variance of 4; Bartlett weights see most of it."""
    rng = np.random.default_rng(2)
    estimates = [variance_of_mean(ar1(rng, 500, 0.5)) for _ in range(300)]
    assert 0.75 * 4 / 500 < np.mean(estimates) < 1.05 * 4 / 500


@pytest.mark.heavy
@pytest.mark.parametrize(("coefficient", "batches"), [(0.0, 4), (0.9, 4), (0.9, 6)])
def test_batch_means_cover_the_mean_of_a_correlated_series(coefficient, batches):
    """Coverage of ±2u is 95.45 %, although batches of 32 cycles are only 1.7 correlation times long."""
    rng = np.random.default_rng(4)
    off = []
    for _ in range(1500):
        series = ar1(rng, 192, coefficient)
        off.append(abs(series.mean()) / np.sqrt(batch_variance(series.astype(complex), batches)[0]))
    assert 0.93 < np.mean(np.array(off) < 2.0) < 0.98


@pytest.mark.heavy
def test_the_variance_of_correlated_batches_is_corrected():
    """The scatter of batches as long as the correlation is too small; 2V_b − V_2b corrects most of the error."""
    rng = np.random.default_rng(5)
    series = [ar1(rng, 192, 0.9) for _ in range(3000)]
    true = np.var([one.mean() for one in series])
    plain = [np.var(one.reshape(6, -1).mean(axis=1), ddof=1) / 6 for one in series]
    found = [batch_variance(one.astype(complex), 6)[0] / student_2u(5.0) ** 2 for one in series]
    assert np.mean(plain) < 0.8 * true
    assert np.mean(found) == pytest.approx(true, rel=0.1)


def test_a_periodic_pattern_does_not_add_to_the_spread():
    values = np.tile([1.0, 2j, -3.0], 16).astype(complex)
    assert np.allclose(by_class_removed(values, 3), 0)
    assert not np.allclose(by_class_removed(values, 2), 0)


@pytest.mark.parametrize("ratio", [0.3, 0.9, 0.8 * np.exp(0.7j), -0.5, 0.97])
@pytest.mark.parametrize("count", [8, 12, 16, 32])
def test_the_bias_of_a_single_exponential_transient_is_exact(ratio, count):
    """D_w = D + c q^w: the bias of the mean of the newest 8 windows is the mean of c q^w over them."""
    w = np.arange(count)
    windows = 40.0 + 3.0 * ratio**w
    expected = 3.0 * np.mean(ratio ** w[-8:])
    if abs(ratio) ** 2 > 0.97:
        pytest.skip("slower than the bound on q per pair")
    assert transient_bias(windows, 8) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_the_bias_estimated_from_noise_is_noise():
    rng = np.random.default_rng(7)
    biases = [abs(transient_bias(rng.standard_normal(8) + 1j * rng.standard_normal(8), 8)) for _ in range(500)]
    assert np.median(biases) < 1.5
    assert transient_bias(np.full(8, 2.0 + 0j), 8) == 0
    with pytest.raises(ValueError, match="measured must be >= 8 and <= 7"):
        transient_bias(np.ones(7, complex), 8)


def test_stationary_fluctuation_is_distinguished_from_a_trend_and_a_decaying_beat():
    rng = np.random.default_rng(8)
    w = np.arange(32)
    noise = [rng.standard_normal(32) + 1j * rng.standard_normal(32) for _ in range(200)]
    assert np.mean([is_stationary(one) for one in noise]) > 0.9
    assert not any(is_stationary(one + 0.3 * w) for one in noise)
    assert not any(is_stationary(10 * 0.85**w + 0.3 * one) for one in noise)


def cycles_noise(rng, n, rms):
    return rms / np.sqrt(2) * (rng.standard_normal(n) + 1j * rng.standard_normal(n))


@pytest.mark.parametrize("period", [1, 2, 3, 4, 5])
def test_an_orbit_that_closes_after_several_cycles_is_periodic(period):
    rng = np.random.default_rng(9)
    pattern = 0.01 * np.exp(2j * np.pi * rng.random(period)) * (period > 1)
    deviation = np.tile(pattern, 192 // period + 1)[:192] + cycles_noise(rng, 192, 1e-4)
    found = classify(deviation, 1e-8, 1e-3, QUIET)
    assert (found.regime, found.period) == (Regime.PERIODIC, period)


def repeats(deviation, strikes, limit, period):
    """Return whether amplitude and impacts repeat after some cycles, by the definition."""
    classes = [slice(start, None, period) for start in range(period)]
    scatter = sum(float(np.sum(np.abs(deviation[one] - deviation[one].mean()) ** 2)) for one in classes)
    near = strikes | np.roll(strikes, 1, axis=1) | np.roll(strikes, -1, axis=1)
    regular = sum(int(strikes[one].sum(axis=0)[near[one].mean(axis=0) >= SUPPORT].sum()) for one in classes)
    return scatter / (len(deviation) - period) <= limit, regular >= REGULAR_SHARE * int(strikes.sum())


@pytest.mark.heavy
@pytest.mark.parametrize("n", [24, 25, 400])
def test_the_shortest_period_agrees_with_its_definition(n):
    """The impacts of some cycles are missing or scattered, and the scatter is near its limit."""
    rng, found, longest = np.random.default_rng(n), set(), 6
    for _ in range(200):
        period = int(rng.integers(1, 7))
        deviation = np.resize(cycles_noise(rng, period, 1.0), n) + cycles_noise(rng, n, rng.choice([0.7, 1.3]))
        strikes = np.resize(rng.random((period, PHASE_BINS)) < 0.1, (n, PHASE_BINS)) & (rng.random((n, 1)) < 0.95)
        strikes = (strikes | (rng.random(strikes.shape) < rng.choice([0.0, 0.01, 0.02]))).astype(np.uint8)
        each = [repeats(deviation, strikes, 1.0, p) for p in range(1, longest + 1)]
        shortest = next((p for p, (amplitude, impacts) in enumerate(each, 1) if amplitude and impacts), 0)
        parts = deviation.view(float).reshape(n, 2)
        assert shortest_period(parts, strikes, 1.0, longest) == (shortest, any(amplitude for amplitude, _ in each))
        found.add(shortest)
    assert len(found) > 4


def test_a_slow_modulation_is_distinguished_from_a_logistic_map():
    k = np.arange(192)
    modulated = classify(0.02 * np.cos(0.3 * k) + 0.01j * np.sin(0.3 * k), 1e-10, 1e-3, QUIET)
    assert modulated.regime is Regime.MODULATED
    x = np.empty(192)
    x[0] = 0.3
    for i in range(191):
        x[i + 1] = 3.99 * x[i] * (1 - x[i])
    chaotic = classify(0.02 * x.astype(complex), 1e-10, 1e-3, QUIET)
    assert chaotic.regime is Regime.CHAOTIC
    assert chaotic.spread == pytest.approx(0.02 * np.std(x))
    assert np.isnan(chaotic.period)


def strikes_at(phases):
    rows = np.zeros((len(phases), PHASE_BINS), np.uint8)
    for row, own in zip(rows, phases, strict=True):
        row[[int(p * PHASE_BINS) % PHASE_BINS for p in own]] = 1
    return rows


def test_the_pattern_of_impacts_decides_the_regime_when_the_amplitude_is_steady():
    """For a light sphere, the amplitude of the structure is steady in all four cases."""
    rng = np.random.default_rng(10)
    steady = cycles_noise(rng, 48, 1e-5)

    def regime(phases):
        found = classify(steady, 1e-10, 1e-3, strikes_at(phases))
        assert found.steady
        return found

    two = regime([(0.2, 0.7)] * 48)
    assert (two.regime, two.period) == (Regime.PERIODIC, 1)
    five_in_two = regime([(0.2, 0.7), (0.25, 0.6, 0.9)] * 24)
    assert (five_in_two.regime, five_in_two.period) == (Regime.PERIODIC, 2)
    missed = regime([(0.2, 0.7) if k % 5 else (0.2,) for k in range(48)])
    assert missed.regime is Regime.PERIODIC, "a weak impact missed now and then is no chaos"
    wild = regime([tuple(rng.random(2)) for _ in range(48)])
    assert wild.regime is Regime.CHAOTIC


@pytest.mark.parametrize("deviation", [np.zeros(3, complex), np.full(48, np.nan, complex)])
def test_too_few_valid_cycles_yield_an_unknown_regime(deviation):
    assert classify(deviation, 0.0, 1e-3, QUIET[: len(deviation)]).regime is Regime.UNKNOWN
