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
"""Step and frequency responses of every channel compared with their transfer functions, and the skew in a sine."""

import numpy as np
import pytest
from kits.instruments import AnalyticMotion, configured, fitted, measured, sine

from impact_rig.instruments import Chain
from impact_rig.instruments.chain import sensors
from impact_rig.instruments.section import CHANNELS

AMPLITUDES = {"accelerometer": 20.0, "laser": 5e-3, "base": 2e-3, "current": 2.0}
QUANTITIES = {"accelerometer": "a_1", "laser": "x_1", "base": "x_b", "current": "current"}


def sines(frequency_hz):
    return AnalyticMotion(**{QUANTITIES[name]: sine(frequency_hz, AMPLITUDES[name], 0.3) for name in CHANNELS})


@pytest.mark.heavy
@pytest.mark.parametrize("anti_alias", ["none", "butterworth"])
@pytest.mark.parametrize(("rate_hz", "frequency_hz"), [(10_000, 9.1), (50_000, 200.0), (10_000, 200.0), (777, 50.0)])
def test_the_frequency_response_of_a_channel_is_its_transfer_function(rate_hz, frequency_hz, anti_alias):
    config = configured(rate_hz, exact=True, adc__anti_alias=anti_alias)
    chain = Chain(config)
    scans = measured(chain, sines(frequency_hz), 5.0)[-3 * rate_hz :]  # 2 s: the 1 Hz high-pass has settled to 3e-6
    for index, sensor in enumerate(sensors(config)):
        skew = float(chain.info()[index]["skew"])
        amplitude = fitted(scans["time"] + skew, scans[sensor.name], frequency_hz)
        expected = AMPLITUDES[sensor.name] * np.exp(0.3j) * sensor.transfer.response(frequency_hz)
        assert abs(amplitude / expected - 1) < 3e-5, sensor.name


@pytest.mark.heavy
@pytest.mark.parametrize("rate_hz", [10_000, 50_000, 250_000, 12_345])
def test_the_skew_can_be_measured_with_a_sine(rate_hz):
    config = configured(rate_hz, exact=True)
    chain = Chain(config)
    scans = measured(chain, sines(20.0), 3.0)[-rate_hz:]
    interval = min(11e-6, 1.0 / rate_hz / 4)
    for index, sensor in enumerate(sensors(config)):
        expected = AMPLITUDES[sensor.name] * np.exp(0.3j) * sensor.transfer.response(20.0)
        lead = np.angle(fitted(scans["time"], scans[sensor.name], 20.0) / expected) / (2 * np.pi * 20.0)
        slack = 5e-8 if sensor.name != "accelerometer" else 2e-7  # its high-pass is still settling
        assert lead == pytest.approx(index * interval, abs=slack)
        assert float(chain.info()[index]["skew"]) == pytest.approx(index * interval, rel=1e-12)


def test_a_simultaneous_converter_has_no_skew():
    assert not np.any(Chain(configured(adc__multiplexed=False)).info()["skew"])


def test_the_laser_lags_a_step_by_its_time_constant():
    step = AnalyticMotion((0.1,), x_1=lambda t: np.where(t >= 0.1, 4e-3, -1e-3))
    config = configured(50_000, exact=True)
    scans = measured(Chain(config), step, 0.12)
    since = scans["time"] + 5e-6 - 0.1  # converted 5 µs after the scan clock
    expected = np.where(since < 0, -1e-3, 4e-3 - 5e-3 * np.exp(-since / 0.7e-3))
    np.testing.assert_allclose(scans["laser"], expected, atol=1e-8)


def test_the_step_response_of_the_base_sensor_has_two_poles():
    step = AnalyticMotion((0.1,), x_b=lambda t: np.where(t >= 0.1, 1e-3, 0.0))
    scans = measured(Chain(configured(20_000, exact=True, adc__multiplexed=False)), step, 0.12)
    since = np.maximum(scans["time"] - 0.1, 0.0)
    w = 2 * np.pi * 1e3 / np.sqrt(2)
    expected = 1e-3 * (1 - np.exp(-w * since) * (np.cos(w * since) + np.sin(w * since)))
    np.testing.assert_allclose(scans["base"], expected, atol=1e-8)


def test_displacements_start_settled_and_the_accelerometer_at_rest():
    still = AnalyticMotion(x_1=lambda t: np.full_like(t, -6e-3), a_1=lambda t: np.full_like(t, 19.0))
    scans = measured(Chain(configured(exact=True)), still, 0.05)
    np.testing.assert_allclose(scans["laser"], -6e-3, atol=1e-8)
    assert abs(scans["accelerometer"][0]) < 1e-3
    assert scans["accelerometer"][100] == pytest.approx(19.0 * np.exp(-2 * np.pi * 0.01), rel=0.01)


def test_the_anti_alias_filter_removes_what_would_alias():
    """The 25 kHz ringing after a blow would alias at 10 kS/s: a corner at 1 kHz removes it."""
    quiet = {}
    for choice in ("none", "butterworth"):
        config = configured(10_000, exact=True, adc__anti_alias=choice, adc__anti_alias_hz=1000.0)
        blow = AnalyticMotion((0.02, 0.02004), a_1=lambda t: np.where((t >= 0.02) & (t < 0.02004), 400.0, 0.0))
        scans = measured(Chain(config), blow, 0.04)["accelerometer"]
        alternating = scans[200:232] * np.hanning(32) * (-1.0) ** np.arange(32)  # 25 kHz folds onto 5 kHz
        quiet[choice] = abs(np.sum(alternating))
    assert quiet["butterworth"] < 0.02 * quiet["none"]
