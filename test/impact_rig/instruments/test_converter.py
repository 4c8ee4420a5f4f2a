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
"""Converter: steps, clipping, flags, ranges, and limits of its rate."""

import numpy as np
import pytest
from kits.instruments import EXACT, AnalyticMotion, configured, measured, sine

from impact_rig.errors import ConfigError
from impact_rig.instruments import Chain
from impact_rig.instruments.chain import sensors
from impact_rig.instruments.section import CHANNELS
from impact_rig.rig.config import RigConfig, from_flat

BIT = {name: 1 << index for index, name in enumerate(CHANNELS)}


def exact_16_bit(**changes):
    return from_flat(configured(10_000, exact=True, **changes), {"instruments.adc.bits": 16})


@pytest.mark.parametrize(("channel", "quantity", "peak"), [("base", "x_b", 1e-4), ("current", "current", 0.05)])
def test_readings_are_multiples_of_the_step_of_16_bits(channel, quantity, peak):
    config = exact_16_bit()
    scans = measured(Chain(config), AnalyticMotion(**{quantity: sine(3.0, peak)}), 1.0)
    sensor = next(sensor for sensor in sensors(config) if sensor.name == channel)
    step = 2 * sensor.adc_range_v / 2**16 / abs(sensor.volt_per_unit)
    codes = scans[channel] / step
    np.testing.assert_allclose(codes, np.rint(codes), atol=1e-6)
    assert set(np.unique(np.diff(np.unique(np.rint(codes))))) == {1.0}  # every code within the swing occurs


def test_the_range_of_codes_is_that_of_the_board_and_both_ends_are_flagged():
    """One more of the 2^16 codes is negative. The sine grows slowly through the ends, so some scans just reach them."""
    config = exact_16_bit()
    growing = lambda t: 1751.0 * (0.95 + 0.05 * t) * np.sin(2 * np.pi * 5.0 * t)  # noqa: E731
    scans = measured(Chain(config), AnalyticMotion(a_1=growing), 2.0)
    sensor = next(sensor for sensor in sensors(config) if sensor.name == "accelerometer")
    step = 2 * sensor.adc_range_v / 2**16 / sensor.volt_per_unit
    codes = np.rint(scans["accelerometer"] / step)
    assert (codes.min(), codes.max()) == (-(2**15), 2**15 - 1)
    ends = (codes == codes.min()) | (codes == codes.max())
    np.testing.assert_array_equal(scans["status"] & BIT["accelerometer"] > 0, ends)


def test_the_quantisation_error_is_uniform_over_one_step():
    config = exact_16_bit()
    scans = measured(Chain(config), AnalyticMotion(x_b=lambda t: 1e-4 * t), 5.0)
    step = 2 * 10.0 / 2**16 / 800.0
    error = scans["base"] - np.polyval(np.polyfit(scans["time"], scans["base"], 1), scans["time"])
    assert np.max(np.abs(error)) < 0.51 * step
    assert np.std(error) == pytest.approx(step / np.sqrt(12), rel=0.01)


def test_the_laser_reads_in_steps_of_its_resolution():
    config = from_flat(configured(10_000, exact=True), {"instruments.laser.resolution_m": 8e-6})
    scans = measured(Chain(config), AnalyticMotion(x_1=sine(3.0, 1e-4)), 1.0)
    levels = np.unique(np.round(scans["laser"] / 8e-6, 3))
    np.testing.assert_allclose(np.diff(levels), 1.0, atol=2e-3)


@pytest.mark.parametrize(
    ("channel", "quantity", "peak", "limit"),
    [
        ("accelerometer", "a_1", 2500.0, 5.0 / 28e-3 * 9.80665),  # the converter's ± 5 V
        ("laser", "x_1", 12e-3, 10e-3),  # end of the measuring range
        ("base", "x_b", 15e-3, 12.5e-3),
        ("current", "current", 40.0, 25.0),
    ],
)
def test_readings_beyond_the_range_are_clipped_and_flagged(channel, quantity, peak, limit):
    config = configured(10_000, exact=True)
    sensor = next(sensor for sensor in sensors(config) if sensor.name == channel)
    scans = measured(Chain(config), AnalyticMotion(**{quantity: sine(5.0, peak)}), 2.0)
    flagged = scans["status"] & BIT[channel] > 0
    assert np.max(np.abs(scans[channel])) == pytest.approx(limit, rel=1e-5)
    np.testing.assert_array_equal(flagged, np.abs(scans[channel]) >= limit * (1 - 1e-6))
    assert 0.1 < np.mean(flagged) < 0.6
    assert not np.any(scans["status"] & ~np.uint8(BIT[channel]))  # and no other channel's bit
    assert sensor.measuring_range()[1] == pytest.approx(limit, rel=1e-6)


def test_readings_within_the_range_are_not_flagged():
    scans = measured(Chain(configured(10_000)), AnalyticMotion(x_1=sine(9.1, 5.9e-3), a_1=sine(9.1, 20.0)), 1.0)
    assert not np.any(scans["status"])


def test_a_smaller_range_clips_earlier_and_resolves_more():
    config = exact_16_bit(current__adc_range_v=0.2)
    info = Chain(config).info()[3]
    assert info["range_high"] == pytest.approx(1.0)
    assert info["resolution"] == pytest.approx(2 * 0.2 / 2**16 * 5.0)


def test_a_range_that_the_board_lacks_is_rejected():
    with pytest.raises(
        ConfigError, match=r"laser\.adc_range_v must be one of 10, 5, 2, 1, 0\.5, 0\.2, 0\.1 V, got 3 V"
    ):
        from_flat(RigConfig(), {"instruments.laser.adc_range_v": 3})


def test_a_rate_beyond_the_conversions_of_the_board_is_rejected():
    Chain(configured(250_000))
    slow_board = configured(100_000, adc__aggregate_limit_hz=250e3)
    with pytest.raises(ConfigError, match=r"daq\.rate_hz must be <= 62500 Hz: 4 channels .* got 100000 Hz"):
        Chain(slow_board)


def test_inverted_wiring_changes_the_sign():
    straight = measured(Chain(configured(exact=True)), AnalyticMotion(x_b=sine(9.1, 1e-3)), 0.2)
    turned = measured(Chain(configured(exact=True, base__inverted=True)), AnalyticMotion(x_b=sine(9.1, 1e-3)), 0.2)
    np.testing.assert_allclose(turned["base"], -straight["base"], atol=1e-8)


def test_the_exact_instruments_of_the_kit_have_no_error():
    """Every error of the instruments has a switch in the kit, on which the other tests rely."""
    tolerances = [name for name, value in EXACT.items() if value == 0]
    assert len(tolerances) == 18
    for sensor in sensors(configured(exact=True)):
        assert sensor.gain_tolerance == sensor.offset_tolerance == sensor.noise == sensor.linearity == 0
