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
"""Calibration errors: within their tolerances, fixed per seed, and spread as the certificate claims."""

import math

import attrs
import numpy as np
import pytest
from kits.instruments import AnalyticMotion, configured, fitted, measured, sine

from impact_rig.arithmetic.random import Random
from impact_rig.instruments import Chain, calibration, conversion
from impact_rig.instruments.calibration import ChannelErrors
from impact_rig.instruments.chain import sensors
from impact_rig.kernels import with_fields

SEEDS = 400


def quiet(seed, **changes):
    """Configuration without noise and steps, but with all calibration errors."""
    return configured(
        1_000,
        seed=seed,
        laser__noise_m_rms=0,
        laser__resolution_m=0,
        base__noise_m_rms=0,
        current__noise_a_rms=0,
        accelerometer__noise_v_rms=0,
        adc__noise_v_rms=0,
        adc__bits=24,
        **changes,
    )


def curve(sensor, errors, values):
    """Return the departure of static readings from a straight line, in units of the channel."""
    channel, volts = with_fields(np.zeros(1, conversion.CHANNEL)), values.copy()
    conversion.set_output(channel, attrs.evolve(sensor, noise=0.0), errors, 1e-4)
    conversion.to_volts(channel[0], volts, np.zeros(len(values), np.bool_), np.zeros(len(values)))
    return (volts - channel["offset"]) / channel["gain"] - values


@pytest.mark.heavy
@pytest.mark.parametrize(("index", "shift"), [(1, 0.0), (2, 0.0), (1, 0.4)])
def test_the_linearity_error_is_within_its_limit_and_adds_no_gain_or_zero(index, shift):
    sensor = sensors(configured(laser__resolution_m=0))[index]
    shift *= sensor.half_range  # a range need not lie about zero
    sensor = attrs.evolve(sensor, low=sensor.low + shift, high=sensor.high + shift)
    values = np.linspace(0.995 * sensor.low, 0.995 * sensor.high, 201)  # short of where it clips
    rng = Random(5)
    largest = 0.0
    for _ in range(200):
        errors = calibration.draw_channel(rng)
        departure = curve(sensor, errors, values)
        assert np.max(np.abs(departure)) <= sensor.linearity * (1 + 1e-9)
        largest = max(largest, np.max(np.abs(departure)))
        slope, zero = np.polyfit(values, departure, 1)
        assert abs(slope) < 0.03 * sensor.linearity / sensor.half_range
        assert abs(zero) < 0.03 * sensor.linearity
    assert largest > 0.9 * sensor.linearity  # the specification is used, not only kept


@pytest.mark.heavy
def test_errors_spread_over_their_whole_tolerances():
    rng = Random(6)
    drawn = np.array([[e.gain, e.offset, e.c_2, e.c_3] for e in (calibration.draw_channel(rng) for _ in range(20_000))])
    assert np.max(np.abs(drawn)) <= 1.0
    assert np.max(np.abs(drawn[:, 2]) + np.abs(drawn[:, 3])) <= 1.0 + 1e-12
    np.testing.assert_allclose(np.var(drawn, axis=0), [1 / 3, 1 / 3, 1 / 6, 1 / 6], rtol=0.04)


@pytest.mark.repeats
def test_the_certificate_covers_gain_and_zero_of_many_rigs():
    """Small sines about zero, on many rigs: mean and spread of gain and zero agree with the certificate."""
    frequency = 10.0
    peaks = {"accelerometer": 10.0, "laser": 1e-4, "base": 1e-4, "current": 0.1}
    motion = AnalyticMotion(
        a_1=sine(frequency, peaks["accelerometer"]),
        x_1=sine(frequency, peaks["laser"]),
        x_b=sine(frequency, peaks["base"]),
        current=sine(frequency, peaks["current"]),
    )
    # a lower corner settles sooner than 1 Hz and does not matter here
    changes = {"accelerometer__high_pass_hz": 40.0}
    gains, zeros = [], []
    for seed in range(SEEDS):
        scans = measured(Chain(quiet(seed, **changes)), motion, 0.3)[100:]
        row_gain, row_zero = [], []
        for index, sensor in enumerate(sensors(quiet(seed, **changes))):
            time = scans["time"] + index * 11e-6
            expected = peaks[sensor.name] * sensor.transfer.response(frequency)
            row_gain.append(abs(fitted(time, scans[sensor.name], frequency) / expected) - 1)
            row_zero.append(np.mean(scans[sensor.name]))
        gains.append(row_gain)
        zeros.append(row_zero)
    info = Chain(quiet(0, **changes)).info()
    slack = 4.5 / math.sqrt(2 * SEEDS)
    for found, claimed in ((gains, info["sensitivity_uncertainty"]), (zeros, info["offset_uncertainty"])):
        np.testing.assert_allclose(np.std(found, axis=0), claimed, rtol=slack)
        np.testing.assert_array_less(np.abs(np.mean(found, axis=0)), 4.5 * claimed / math.sqrt(SEEDS))


def test_errors_are_the_same_for_a_seed_and_scale_with_the_tolerance():
    def gain(tolerance):
        config = quiet(3, base__linearity=0, base__gain_tolerance=tolerance, adc__gain_tolerance=0)
        scans = measured(Chain(config), AnalyticMotion(x_b=sine(10.0, 1e-3)), 0.3)[100:]
        sensor = sensors(config)[2]
        return abs(fitted(scans["time"], scans["base"], 10.0) / 1e-3 / sensor.transfer.response(10.0)) - 1

    once = gain(0.01)
    assert gain(0.01) == once
    assert gain(0.02) == pytest.approx(2 * once, rel=1e-3)
    assert gain(0.0) == pytest.approx(0.0, abs=2e-6)


def test_the_error_of_the_board_is_the_same_on_all_channels():
    config = quiet(
        4,
        base__linearity=0, base__gain_tolerance=0, base__offset_tolerance_m=0,
        current__gain_tolerance=0, current__offset_tolerance_a=0, adc__gain_tolerance=0.01, adc__offset_tolerance=0,
    )  # fmt: skip
    scans = measured(Chain(config), AnalyticMotion(x_b=sine(10.0, 1e-3), current=sine(10.0, 1.0)), 0.3)[100:]
    base = abs(fitted(scans["time"], scans["base"], 10.0)) / 1e-3
    current = abs(fitted(scans["time"], scans["current"], 10.0))
    assert base == pytest.approx(current, rel=1e-5)
    assert abs(base - 1) > 1e-4


def test_a_channel_without_errors_is_a_straight_line():
    sensor = sensors(configured())[2]
    np.testing.assert_allclose(curve(sensor, ChannelErrors(), np.linspace(-0.01, 0.01, 11)), 0.0, atol=1e-15)
