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
"""Elementary functions compared with 40 digits: the stated error holds over the range of use and at its ends."""

from __future__ import annotations

import math

import numpy as np
import pytest

from impact_rig.arithmetic import elementary

mpmath = pytest.importorskip("mpmath")

COUNT = 4000
ULP = 1.0
BIG = 1.6e6  # up to which the reduction of angles is exact


@pytest.fixture(autouse=True)
def forty_digits():
    with mpmath.workdps(40):
        yield


def worst(function, exact, arguments):
    """Return the largest error, in units of the last place of the result."""
    found = 0.0
    for x in arguments:
        value, true = float(function(float(x))), exact(mpmath.mpf(float(x)))
        found = max(found, float(abs(mpmath.mpf(value) - true)) / math.ulp(abs(float(true))))
    return found


def spread(low, high):
    rng = np.random.default_rng(1)
    return np.concatenate([rng.uniform(low, high, COUNT), [low, high]])


def angles():
    near = [k * math.pi / 2 for k in range(-40, 41)]  # where one of both is nearly zero
    return np.concatenate([spread(-1.0, 1.0), spread(-100.0, 100.0), spread(-BIG, BIG), near])


@pytest.mark.heavy
def test_sine_and_cosine_are_accurate():
    assert worst(lambda x: elementary.sincos(x)[0], mpmath.sin, angles()) < ULP
    assert worst(lambda x: elementary.sincos(x)[1], mpmath.cos, angles()) < ULP


def test_sine_and_cosine_of_zero_are_exact():
    assert elementary.sincos(0.0) == (0.0, 1.0)


@pytest.mark.heavy
def test_the_exponential_is_accurate():
    assert worst(elementary.exp, mpmath.exp, np.concatenate([spread(-1.0, 1.0), spread(-700.0, 700.0)])) < ULP


def test_the_exponential_is_correct_at_the_ends_of_its_range():
    assert elementary.exp(-709.0) == 0.0
    assert elementary.exp(710.0) == math.inf
    assert elementary.exp(0.0) == 1.0
    assert math.isnan(elementary.exp(math.nan))


@pytest.mark.heavy
def test_the_logarithm_is_accurate():
    decades = 10.0 ** spread(-300.0, 300.0)
    assert worst(elementary.log, mpmath.log, np.concatenate([decades, spread(0.5, 2.0), [5e-324]])) < ULP
    assert elementary.log(1.0) == 0.0


@pytest.mark.parametrize("y", [0.4, 1.5, -0.125, 2.5, 7.0])
def test_powers_are_accurate(y):
    for x in 10.0 ** spread(-12.0, 12.0)[:1000]:
        true = mpmath.power(mpmath.mpf(float(x)), mpmath.mpf(y))
        error = float(abs(mpmath.mpf(float(elementary.power(float(x), y))) - true)) / math.ulp(float(true))
        assert error < 1.0 + 3.0 * abs(y * math.log(x))  # as stated
    assert elementary.power(0.0, y) == 0.0


@pytest.mark.heavy
def test_the_modulus_is_exact():
    assert elementary.modulus(3.0 - 4.0j) == 5.0
    for a, b in zip(spread(-1e3, 1e3), spread(-1.0, 1.0), strict=True):
        true = mpmath.hypot(float(a), float(b))
        assert abs(mpmath.mpf(float(elementary.modulus(complex(a, b)))) - true) <= 1.5 * math.ulp(float(true))


def test_the_constants_are_the_nearest_floats():
    assert float(mpmath.pi) == elementary.PI
    assert float(2 * mpmath.pi) == elementary.TWO_PI
