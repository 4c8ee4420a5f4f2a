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
"""Conversion of the output of a sensor's dynamics to readings.

The output stage of the sensor adds linearity error and noise, limits the range and gives volts. The converter turns
volts into codes, the codes become readings in SI units, and the readings of all channels become rows of scans.

A sensor's noise has the sensor's bandwidth: it is white noise behind a first-order low-pass, sampled exactly. From one
conversion to the next it becomes memory · itself + rms √(1 − memory²) · white, with memory = e^{−2π bandwidth period}
and period the time between scans. Its rms is that of the specification at every scan rate, and its spectrum is a
Lorentzian. With x = −1 … 1 over the range and Legendre's polynomials,

    value = clean + linearity_2 (3 x² − 1)/2 + linearity_3 (5 x³ − 3 x)/2 + noise,
            rounded to the output's own resolution, limited to its range
    volts = gain value + offset
    code  = round((adc_gain (volts + adc_noise white) + adc_offset) / lsb), limited to the converter's codes
    reading = code scale + zero

with the true gains and offsets of sensor (`gain`, `offset`) and converter (adc_…), and the nominal ones in `scale` and
`zero`.

The arithmetic runs over short stretches that stay in the first cache, in one simple loop after another; the compiler
then processes two scans at a time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import TWO_PI, exp, nearest
from impact_rig.arithmetic.random import fill_normal
from impact_rig.instruments import calibration
from impact_rig.instruments.calibration import BoardErrors, ChannelErrors
from impact_rig.instruments.sensor import Adc, Sensor
from impact_rig.kernels import (
    BYTES,
    INTEGERS,
    Array,
    Bytes,
    Flags,
    Integers,
    Reals,
    Record,
    Records,
    Words,
    entry,
    kernel,
)

CHANNEL = np.dtype(
    [
        ("middle", "f8"),  # middle of the sensor's range [unit]
        ("per_half_range", "f8"),  # 1 over half of that range [1/unit]
        ("linearity_2", "f8"),  # error of linearity of second order, at an end of the range [unit]
        ("linearity_3", "f8"),  # error of linearity of third order there [unit]
        ("memory", "f8"),  # part of the sensor's noise that remains after one scan period [-]
        ("fresh", "f8"),  # rms of the new part of the noise after one scan period [unit]
        ("resolution", "f8"),  # step of the sensor's own output [unit], 0 for none
        ("low", "f8"),  # lower end of the sensor's range [unit]
        ("high", "f8"),  # upper end of it [unit]
        ("gain", "f8"),  # true sensitivity [V/unit]
        ("offset", "f8"),  # true output at zero [V]
        ("adc_noise", "f8"),  # rms of the converter's noise [V]
        ("adc_gain", "f8"),  # true gain of the converter, about 1 [-]
        ("adc_offset", "f8"),  # true offset of the converter [V]
        ("lsb", "f8"),  # step of the converter [V]
        ("lowest_code", "f8"),  # smallest code [-]
        ("highest_code", "f8"),  # largest code [-]
        ("scale", "f8"),  # nominal unit per code [unit]
        ("zero", "f8"),  # nominal reading at code 0 [unit]
        ("coloured", "f8"),  # last value of the sensor's noise [unit]
        ("noise_random", "u8", (4,)),  # state of the random numbers of the sensor's noise, see `Random`
        ("adc_random", "u8", (4,)),  # state of the random numbers of the converter's noise
        ("starts_settled", "i8"),  # 1: starts as if the motion's first value had always been there; 0: starts at zero
        ("awake", "i8"),  # 1 once it has started
        ("first_mode", "i8"),  # row of its first mode, see `response`
        ("modes", "i8"),  # number of its modes
        ("due", "i8"),  # time of its next conversion in this tick [clock units]
        ("converted", "i8"),  # number of scans converted since the reset
        ("last_reading", "f8"),  # its last reading [unit]
        ("finished", "i8"),  # number of finished readings in its buffer
        ("filled", "i8"),  # number of values in its buffer; the newest are still on their way through the stages
    ],
    align=True,
)
"""Record of one channel: sensor, cable and converter, with all state that continues from tick to tick."""

STRETCH = 512
"""Largest number of scans that pass through the conversion together, few enough for the CPU's first cache."""
TWO_D_FLAGS, TWO_D_WORDS = Array(np.dtype("?"), 2), Array(np.dtype("u8"), 2)


def set_output(channel: NDArray[np.void], sensor: Sensor, errors: ChannelErrors, scan_period_s: float) -> None:
    """Set the fields of one CHANNEL record that describe the sensor's output stage, up to the volts on its cable."""
    sign = -1.0 if sensor.inverted else 1.0
    gain = sign * sensor.volt_per_unit * (1.0 + errors.gain * sensor.gain_tolerance)
    memory = exp(-TWO_PI * sensor.bandwidth_hz * scan_period_s)
    channel["middle"], channel["per_half_range"] = sensor.middle, 1.0 / sensor.half_range
    channel["linearity_2"], channel["linearity_3"] = sensor.linearity * errors.c_2, sensor.linearity * errors.c_3
    channel["memory"], channel["fresh"] = memory, sensor.noise * math.sqrt(1.0 - memory * memory)
    channel["resolution"], channel["low"], channel["high"] = sensor.resolution, sensor.low, sensor.high
    channel["gain"] = gain
    channel["offset"] = sensor.offset_v + gain * errors.offset * sensor.offset_tolerance


def set_converter(channel: NDArray[np.void], sensor: Sensor, adc: Adc, errors: BoardErrors) -> None:
    """Set the fields of one CHANNEL record that describe the converter, from the volts on the cable to readings."""
    lsb = calibration.lsb_v(sensor, adc)
    channel["adc_noise"] = calibration.converter_noise_v(sensor, adc)
    channel["adc_gain"] = 1.0 + errors.gain * adc.gain_tolerance
    channel["adc_offset"] = errors.offset * adc.offset_tolerance * sensor.adc_range_v
    channel["lsb"] = lsb
    channel["lowest_code"], channel["highest_code"] = -float(1 << (adc.bits - 1)), float((1 << (adc.bits - 1)) - 1)
    channel["scale"], channel["zero"] = lsb / sensor.volt_per_unit, -sensor.offset_v / sensor.volt_per_unit


@kernel
def clamped(value: float, low: float, high: float) -> float:
    """Return the value limited to low … high."""
    value = low if value < low else value
    return high if value > high else value


@kernel
def to_volts(channel: Record, values: Reals, clipped: Flags, white: Reals) -> None:
    """Turn the output of a sensor's dynamics [unit] into volts on the cable, at most STRETCH values, in place.

    Sets `clipped` for each value to whether the sensor was at an end of its range. `white` is scratch memory of the
    same length.
    """
    count = values.shape[0]
    fill_normal(channel.noise_random, white)
    coloured, memory, fresh = channel.coloured, channel.memory, channel.fresh
    for i in range(count):
        coloured = memory * coloured + fresh * white[i]
        white[i] = coloured
    channel.coloured = coloured
    if channel.linearity_2 != 0.0 or channel.linearity_3 != 0.0:
        middle, per_half_range = channel.middle, channel.per_half_range
        second, third = channel.linearity_2, channel.linearity_3
        for i in range(count):
            x = clamped((values[i] - middle) * per_half_range, -1.0, 1.0)
            values[i] += second * (1.5 * x * x - 0.5) + third * (2.5 * x * x - 1.5) * x
    low, high, gain, offset, resolution = channel.low, channel.high, channel.gain, channel.offset, channel.resolution
    if resolution > 0.0:
        per_resolution = 1.0 / resolution
        for i in range(count):
            values[i] = resolution * nearest((values[i] + white[i]) * per_resolution)
    else:
        for i in range(count):
            values[i] += white[i]
    for i in range(count):
        clipped[i] = (values[i] <= low) | (values[i] >= high)
    for i in range(count):
        values[i] = gain * clamped(values[i], low, high) + offset


@kernel
def to_units(channel: Record, values: Reals, clipped: Flags, white: Reals) -> None:
    """Turn volts on a channel's cable into readings [unit], at most STRETCH of them, in place.

    Also sets `clipped` where the converter was at an end of its range. `white` is scratch memory of the same length.
    """
    count = values.shape[0]
    fill_normal(channel.adc_random, white)
    noise, gain, offset, per_lsb = channel.adc_noise, channel.adc_gain, channel.adc_offset, 1.0 / channel.lsb
    lowest_code, highest_code, scale, zero = channel.lowest_code, channel.highest_code, channel.scale, channel.zero
    for i in range(count):
        code = (gain * (values[i] + noise * white[i]) + offset) * per_lsb
        values[i] = nearest(clamped(code, lowest_code - 1.0, highest_code + 1.0))
    for i in range(count):
        clipped[i] |= (values[i] <= lowest_code) | (values[i] >= highest_code)
    for i in range(count):
        values[i] = scale * clamped(values[i], lowest_code, highest_code) + zero


@entry(CHANNEL, TWO_D_WORDS, TWO_D_FLAGS, BYTES, INTEGERS, returns=int)
def take_rows(channels: Records, readings: Words, clipped: Flags, rows: Bytes, layout: Integers) -> int:
    """Fill `rows` with all scans that every channel has finished, and return their number; `time` is not filled.

    The readings of these scans are removed from the channels' buffers, `readings` and `clipped`.

    Args:
        channels: CHANNEL records.
        readings: readings of each channel as bit patterns, shape (channels, room).
        clipped: whether each reading was clipped.
        rows: rows of scans as bytes, with room for as many as there may be.
        layout: bytes per row, then the byte positions of the status and of each channel in a row.
    """
    count = rows.shape[0] // layout[0]
    for j in range(channels.shape[0]):
        count = min(count, channels[j].finished)
    size = np.uint64(layout[0])
    for j in range(channels.shape[0]):
        place = np.uint64(layout[2 + j])  # unsigned, because signed indices would count from the end if negative
        for i in range(count):
            word = readings[j, i]
            for byte in range(8):
                rows[place + np.uint64(byte)] = np.uint8((word >> np.uint64(8 * byte)) & np.uint64(255))
            place += size
    place = np.uint64(layout[1])
    for i in range(count):
        status = 0
        for j in range(channels.shape[0]):
            status |= int(clipped[j, i]) << j
        rows[place] = status
        place += size
    for j in range(channels.shape[0]):
        for i in range(count, channels[j].finished):
            readings[j, i - count], clipped[j, i - count] = readings[j, i], clipped[j, i]
        channels[j].finished -= count
        channels[j].filled -= count
    return count
