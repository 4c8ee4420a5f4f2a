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
"""Convergence to a periodic motion: the kernel agrees with its definition in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rig.analysis.convergence import LASTING, settled_period
from impact_rig.analysis.cycles import PHASE_BINS
from impact_rig.analysis.spread import LONGEST_PERIOD, classify

OMEGA, TOLERANCE, REPETITION = 57.0, 5e-4, 1e-3


def settled_by_definition(rows, strikes, longest):
    """Return what `settled_period` must return, by its definition."""
    x_b, x_1 = rows[:, :4].copy().view(complex).T
    superior = abs(x_1.mean())
    series = np.array([x_b / abs(x_b.mean()), x_1 / superior, rows[:, 4] / superior, rows[:, 5] / (OMEGA * superior)])

    def halves(period):
        change = np.abs(series[:, period:] - series[:, :-period])
        half = change.shape[1] // 2
        return change[:, :half].max(axis=1), change[:, half:].max(axis=1), half

    for period in range(1, longest + 1):
        early, late, half = halves(period)
        moving = late > 1e-9
        ratio = (late[moving] / early[moving]) ** (period / half)
        decays = ratio < 1.0
        left = late[moving][decays] * np.maximum(1.0, ratio[decays] / (1.0 - ratio[decays]))
        is_near = np.abs(series[:, -1] - series[:, -1 - period]).max() <= TOLERANCE
        if is_near and decays.all() and (left <= TOLERANCE).all():
            found = classify(x_1 / x_1.mean() - 1.0, 0.0, REPETITION, strikes).period
            if np.isnan(found) or period % found:
                return 0
            early, late, _ = halves(int(found))
            return period if period == found or late.max() > LASTING * early.max() else 0
    return 0


def some_motion(rng, n):
    """Return rows and strikes of a motion that approaches a periodic one; the sphere may repeat later."""
    bases = int(rng.integers(1, 5))
    sphere = bases * int(rng.choice([1, 1, 1, 2, 3]))
    pattern = np.ones((bases, 6)) + 0.1 * rng.standard_normal((bases, 6))
    rows = np.resize(pattern, (n, 6)) * [1e-4, 3e-4, 4e-3, 1e-3, 0.0, 0.0]
    rows[:, 4:] = np.resize(rng.standard_normal((sphere, 2)), (n, 2)) * [4e-3, 0.3]
    decay = rng.choice([0.6, 0.9, 0.99, 1.01]) ** np.arange(n)[:, np.newaxis]
    rows *= 1.0 + rng.choice([0.0, 1e-4, 1e-3, 1e-1]) * decay * rng.standard_normal(6)
    alternating = rng.choice([0.0, 0.7, 1.0]) * TOLERANCE * rng.choice([0.9, 0.99, 1.0]) ** np.arange(1 - n, 1)
    rows[:, 4] += 3e-3 * alternating * (-1.0) ** np.arange(n)  # the sphere alone, which may go on for ever
    strikes = np.resize(rng.random((bases, PHASE_BINS)) < 0.1, (n, PHASE_BINS)).astype(np.uint8)
    if rng.random() < 0.1:
        strikes = (rng.random(strikes.shape) < 0.1).astype(np.uint8)
    return rows, strikes


@pytest.mark.heavy
def test_the_settled_period_agrees_with_its_definition():
    rng, found, n, longest = np.random.default_rng(1), [], 24, 6
    for _ in range(3000):
        rows, strikes = some_motion(rng, n)
        period = settled_period(rows, strikes, OMEGA, TOLERANCE, REPETITION, longest, np.empty_like(rows))
        assert period == settled_by_definition(rows, strikes, longest)
        found.append(period)
    assert {0, 1, 2, 3, 4, 6} <= {*found}
    assert longest <= LONGEST_PERIOD


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_a_base_without_a_finite_motion_has_not_settled(value):
    for column in (slice(0, 2), slice(2, 4)):
        rows = np.ones((24, 6))
        rows[:, column] = value
        strikes = np.zeros((24, PHASE_BINS), np.uint8)
        assert settled_period(rows, strikes, OMEGA, TOLERANCE, REPETITION, 6, np.empty_like(rows)) == 0
