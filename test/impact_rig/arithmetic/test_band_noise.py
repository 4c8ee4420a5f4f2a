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
"""Band-pass filter of the random drive, compared with that of SciPy, and the level of its noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from impact_rig.arithmetic.random import BandNoise, Random, band_pass, filter_in_place

BANDS = [(5.0, 20.0), (5.0, 5.2), (0.5, 44.0), (30.0, 31.0)]
RATE_HZ = 100.0


def sos(low: float, high: float) -> np.ndarray:
    return np.array([(1.0, 0.0, -1.0, 1.0, s["a_1"], s["a_2"]) for s in band_pass(low, high, 1.0 / RATE_HZ).sections])


@pytest.mark.parametrize(("low", "high"), BANDS)
def test_the_filter_is_the_butterworth_of_scipy(low, high):
    theirs = signal.butter(4, (low, high), "bandpass", fs=RATE_HZ, output="sos")
    ours = sos(low, high)
    w = np.linspace(0.3, 0.7, 7) * (high - low) + low
    _, expected = signal.sosfreqz(theirs, w, fs=RATE_HZ)
    _, response = signal.sosfreqz(ours, w, fs=RATE_HZ)
    np.testing.assert_allclose(response / response[3], expected / expected[3], rtol=1e-9)


@pytest.mark.heavy
@pytest.mark.parametrize(("low", "high"), BANDS)
def test_filtered_white_noise_of_unit_rms_has_unit_rms(low, high):
    impulse = np.zeros(400_000)
    impulse[0] = band_pass(low, high, 1.0 / RATE_HZ).gain
    np.testing.assert_allclose(np.sum(signal.sosfilt(sos(low, high), impulse) ** 2), 1.0, rtol=1e-9)


def test_the_kernel_filters_like_scipy():
    band = band_pass(5.0, 20.0, 1.0 / RATE_HZ)
    white = Random(1).normal(1000)
    expected = signal.sosfilt(sos(5.0, 20.0), white)
    memory = np.zeros(4, [("delayed_1", "f8"), ("delayed_2", "f8")])
    filter_in_place(band.sections, memory, white)
    np.testing.assert_allclose(white, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_a_copy_of_the_noise_is_independent_of_the_original():
    one = BandNoise(band_pass(5.0, 20.0, 1.0 / RATE_HZ), Random(1))
    one.numbers(0, 100)
    two = one.copy()
    np.testing.assert_array_equal(two.numbers(50, 1000), one.numbers(50, 1000))


def test_an_impossible_band_is_rejected():
    with pytest.raises(ValueError, match=r"the band must be 0 < low < high < 50 Hz, got 5\.0 to 60\.0 Hz"):
        band_pass(5.0, 60.0, 1.0 / RATE_HZ)
