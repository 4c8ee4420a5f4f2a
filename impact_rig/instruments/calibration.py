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
"""Calibration: the real errors of a rig's instruments, and the certificate from which an analysis knows their limits.

Readings are computed as (volt − offset) / sensitivity with the *nominal* sensitivity and offset, the only ones that an
analysis knows. The true values are drawn once per seed, uniformly within the tolerances, and do not change. Standard
uncertainties follow the GUM: the limit a of a rectangular distribution counts as a/√3 (GUM 4.3.7).

The linearity error is L (c_2 P_2(x) + c_3 P_3(x)) with its limit L, Legendre polynomials, and x = −1 … 1 over the
range. (c_2, c_3) are drawn uniformly from |c_2| + |c_3| <= 1. The error is then never more than L, and no part of it is
gain or offset over the full range. Over a *small* part of the range it contains both: about the middle the slope is
−1.5 c_3 L over half of the range and the offset −0.5 c_2 L, with var c_2 = var c_3 = 1/6. The certificate includes
both.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.random import Random
from impact_rig.blocks import DAQ_INFO
from impact_rig.instruments.sensor import Adc, Sensor

_VARIANCE_C = 1.0 / 6.0


@attrs.frozen
class ChannelErrors:
    """True errors of one sensor, each divided by its tolerance and so within ± 1: gain, offset and linearity.

    c_2 and c_3 are the factors of the Legendre polynomials P_2 and P_3 in the linearity error, |c_2| + |c_3| <= 1.
    """

    gain: float = 0.0
    offset: float = 0.0
    c_2: float = 0.0
    c_3: float = 0.0


@attrs.frozen
class BoardErrors:
    """True errors of the converter's gain and offset, each divided by its tolerance and so within ± 1."""

    gain: float = 0.0
    offset: float = 0.0


def draw_channel(random: Random) -> ChannelErrors:
    """Draw the errors of one sensor at random, uniformly over the values that `ChannelErrors` allows."""
    gain, offset, total, difference = 2.0 * random.uniform(4) - 1.0
    return ChannelErrors(
        float(gain), float(offset), float(0.5 * (total + difference)), float(0.5 * (total - difference))
    )


def draw_board(random: Random) -> BoardErrors:
    """Draw the converter's errors of gain and offset, relative to their tolerances: each uniformly from −1 to 1."""
    gain, offset = 2.0 * random.uniform(2) - 1.0
    return BoardErrors(float(gain), float(offset))


def lsb_v(sensor: Sensor, adc: Adc) -> float:
    """Return the converter's step (least significant bit) with the input range of this sensor's channel [V]."""
    return float(2.0 * sensor.adc_range_v / (1 << adc.bits))


def converter_noise_v(sensor: Sensor, adc: Adc) -> float:
    """Return the converter's noise on this sensor's channel, rms [V].

    `adc.noise_v_rms` is the noise with the input range ± 10 V; it is proportional to the channel's input range.
    """
    return adc.noise_v_rms * sensor.adc_range_v / 10.0


def gain_uncertainty(sensor: Sensor, adc: Adc) -> float:
    """Return the relative standard uncertainty of the sensitivity of sensor and converter, for signals of any size.

    A small signal covers only a small part of the range, where the linearity error changes the slope. The result
    contains this change.
    """
    slope = 1.5 * sensor.linearity / sensor.half_range
    rectangular = _square(sensor.gain_tolerance) / 3.0 + _square(adc.gain_tolerance) / 3.0
    return math.sqrt(rectangular + _square(slope) * _VARIANCE_C)


def offset_uncertainty(sensor: Sensor, adc: Adc) -> float:
    """Return the standard uncertainty of the reading at zero [channel unit], from sensor, converter and linearity."""
    board = adc.offset_tolerance * sensor.adc_range_v / sensor.volt_per_unit
    middle = 0.5 * sensor.linearity
    rectangular = _square(sensor.offset_tolerance) / 3.0 + _square(board) / 3.0
    return math.sqrt(rectangular + _square(middle) * _VARIANCE_C)


def total_noise(sensor: Sensor, adc: Adc) -> float:
    """Return the rms of all random parts of a reading [channel unit]: noise and resolution of sensor and converter."""
    steps = _square(sensor.resolution) / 12.0 + _square(lsb_v(sensor, adc) / sensor.volt_per_unit) / 12.0
    return math.sqrt(_square(sensor.noise) + _square(converter_noise_v(sensor, adc) / sensor.volt_per_unit) + steps)


def _square(value: float) -> float:
    return value * value


def certificate(sensors: list[Sensor], adc: Adc, rate_hz: int, skews_s: list[float], ideal: bool) -> NDArray[np.void]:
    """Return the calibration certificate: all that an analysis may know about the instruments.

    The result has one row of `blocks.DAQ_INFO` for each sensor, in scan order.

    Args:
        sensors: sensors in scan order.
        adc: the converter.
        rate_hz: scans per second.
        skews_s: time from the start of a scan to the conversion of each channel [s].
        ideal: whether the instruments are ideal: they read the true value with sensitivity 1, in an infinite range,
            without noise, lag or uncertainty.
    """
    rows = np.zeros(len(sensors), dtype=DAQ_INFO)
    for channel, sensor in enumerate(sensors):
        low, high = sensor.measuring_range()
        row = rows[channel : channel + 1]
        row["name"], row["unit"], row["rate"] = sensor.name.encode(), sensor.unit.encode(), rate_hz
        row["range_low"], row["range_high"] = low, high
        row["skew"] = skews_s[channel]
        if ideal:
            row["sensitivity"], row["bandwidth"] = 1.0, math.inf
            row["range_low"], row["range_high"] = -math.inf, math.inf
            continue
        row["sensitivity"], row["offset"] = sensor.volt_per_unit, sensor.offset_v
        row["output_step"], row["output_noise"] = sensor.resolution, sensor.noise
        row["converter_step"] = lsb_v(sensor, adc) / abs(sensor.volt_per_unit)
        row["converter_noise"] = converter_noise_v(sensor, adc) / abs(sensor.volt_per_unit)
        row["resolution"] = max(row["output_step"], row["converter_step"])
        row["noise"] = total_noise(sensor, adc)
        row["sensitivity_uncertainty"] = gain_uncertainty(sensor, adc)
        row["offset_uncertainty"] = offset_uncertainty(sensor, adc)
        row["lag"], row["lag_order"] = sensor.low_pass.delay_s(), sensor.lag_order
        row["bandwidth"], row["linearity"] = sensor.bandwidth_hz, sensor.linearity
        row["high_pass"] = sensor.high_pass_hz
    return rows
