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
"""Noise: variance and spectrum of every channel compared with the specification; the sample size gives the bounds."""

import math

import numpy as np
import pytest
from kits.instruments import AnalyticMotion, configured, measured
from scipy import signal

from impact_rig.instruments import Chain
from impact_rig.instruments.calibration import converter_noise_v, lsb_v
from impact_rig.instruments.chain import sensors
from impact_rig.instruments.section import CHANNELS

SIGMAS = 4.5  # two-sided chance of a false alarm per comparison: 7e-6
N = 200_000


def expected_spectrum(sensor, adc, rate_hz, frequency_hz):
    """One-sided density of sampled first-order noise, in addition to the white noise of the converter [unit²/Hz]."""
    memory = math.exp(-2 * math.pi * sensor.bandwidth_hz / rate_hz)
    shape = (1 - memory**2) / (1 - 2 * memory * np.cos(2 * np.pi * frequency_hz / rate_hz) + memory**2)
    white = (converter_noise_v(sensor, adc) ** 2 + lsb_v(sensor, adc) ** 2 / 12) / sensor.volt_per_unit**2
    return 2 / rate_hz * (sensor.noise**2 * shape + white)


@pytest.mark.parametrize("rate_hz", [10_000, 50_000])
def test_variance_and_spectrum_of_the_noise_match_the_specification(rate_hz):
    # noise is specified ahead of the converter: a gain error, which it goes through, would be seen
    config = configured(rate_hz, laser__resolution_m=0, accelerometer__gain_tolerance=0)
    adc = config.instruments.adc
    scans = measured(Chain(config), AnalyticMotion(), N / rate_hz)
    for sensor in sensors(config):
        record = scans[sensor.name] - np.mean(scans[sensor.name])
        memory = math.exp(-2 * math.pi * sensor.bandwidth_hz / rate_hz)
        white = (converter_noise_v(sensor, adc) ** 2 + lsb_v(sensor, adc) ** 2 / 12) / sensor.volt_per_unit**2
        variance = sensor.noise**2 + white
        slack = SIGMAS * math.sqrt(2 / N * (1 + memory**2) / (1 - memory**2)) + 1e-3
        assert np.var(record) == pytest.approx(variance, rel=slack), sensor.name

        frequency, density = signal.welch(record, rate_hz, nperseg=1024, noverlap=0)
        ratio = (density / expected_spectrum(sensor, adc, rate_hz, frequency))[2:-2]
        for band in np.array_split(ratio, 8):  # Hann: neighbouring lines are correlated, 1.9 lines count as one
            slack = SIGMAS * math.sqrt(1.9 / (len(band) * (N // 1024)))
            assert np.mean(band) == pytest.approx(1.0, abs=slack + 0.01), sensor.name


def test_noise_of_different_channels_is_uncorrelated():
    scans = measured(Chain(configured(10_000, laser__resolution_m=0)), AnalyticMotion(), 10.0)
    records = np.stack([scans[name] for name in CHANNELS])
    correlation = np.corrcoef(records) - np.eye(len(CHANNELS))
    assert np.max(np.abs(correlation)) < SIGMAS * math.sqrt(
        12 / 100_000
    )  # the slowest noise has a twelfth of the freedom


def test_the_published_noise_is_that_of_the_readings():
    config = configured(10_000)
    chain = Chain(config)
    # a slow ramp over many steps of the laser's output stage and of the converter
    motion = AnalyticMotion(x_1=lambda t: 1e-4 * t, x_b=lambda t: 1e-5 * t, current=lambda t: 1e-2 * t)
    scans = measured(chain, motion, 10.0)
    for row in chain.info():
        name = row["name"].decode()
        slope = np.polyfit(scans["time"], scans[name], 1)
        assert np.std(scans[name] - np.polyval(slope, scans["time"])) == pytest.approx(row["noise"], rel=0.03), name


@pytest.mark.parametrize(("range_v", "noise_v"), [(10.0, 280e-6), (1.0, 28e-6), (0.1, 2.8e-6)])
def test_the_noise_of_the_converter_scales_with_its_range(range_v, noise_v):
    config = configured(10_000, current__noise_a_rms=0, current__adc_range_v=range_v, adc__bits=24)
    scans = measured(Chain(config), AnalyticMotion(), 2.0)
    slack = SIGMAS / math.sqrt(2 * len(scans))
    assert np.std(scans["current"]) / 5.0 == pytest.approx(noise_v, rel=slack)
