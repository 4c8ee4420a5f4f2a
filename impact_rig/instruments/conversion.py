# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""From a sensor's clean output to readings: linearity, noise, end of range, volts; codes, SI units; rows of scans.

A sensor's noise is as wide as the sensor: white noise behind a first-order low-pass at its bandwidth, sampled exactly.
From one conversion to the next n ← a n + σ √(1 − a²) w with a = e^{−2π f_c h} and white w: its rms σ is the
specification's at every scan rate, its spectrum a Lorentzian. With u = −1 … 1 over the range,

    value = clean + L (c_2 P_2(u) + c_3 P_3(u)) + n, rounded to the output's own step, held within its range
    volts = gain value + offset
    code  = round((g (volts + σ_c w) + o) / lsb), held within the converter's codes;   reading = code scale + zero

Everything is done in short stretches that stay in the first cache, one simple loop after another: the compiler then
does two scans at a time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import TWO_PI, exp, nearest
from impact_rig.arithmetic.random import fill_normal
from impact_rig.instruments import calibration
from impact_rig.instruments.calibration import BoardErrors, Errors
from impact_rig.instruments.sensor import Adc, Sensor
from impact_rig.kernels import BYTES, INTEGERS, Array, entry, kernel

CHANNEL = np.dtype(
    [
        ("middle", "f8"),  # of the sensor's range [unit]
        ("per_half_range", "f8"),
        ("bend_2", "f8"),  # L c_2 [unit]
        ("bend_3", "f8"),
        ("memory", "f8"),  # a of the noise
        ("fresh", "f8"),  # σ √(1 − a²) [unit]
        ("resolution", "f8"),  # step of its own output [unit], 0 for none
        ("low", "f8"),  # ends of its range
        ("high", "f8"),
        ("gain", "f8"),  # volt per unit, as it really is
        ("offset", "f8"),  # V, as it really is
        ("adc_noise", "f8"),  # [V]
        ("adc_gain", "f8"),
        ("adc_offset", "f8"),  # [V]
        ("lsb", "f8"),  # [V]
        ("lowest", "f8"),  # codes
        ("highest", "f8"),
        ("scale", "f8"),  # unit per code, nominal
        ("zero", "f8"),  # unit at code 0, nominal
        ("coloured", "f8"),  # the noise's last value [unit]
        ("noise", "u8", (4,)),  # state of the random numbers, see `Random`
        ("converter_noise", "u8", (4,)),
        ("settled", "i8"),  # whether it has watched the motion's first value for ever when it wakes
        ("awake", "i8"),
        ("first_mode", "i8"),  # its modes, see `response`
        ("modes", "i8"),
        ("due", "i8"),  # the next conversion in this tick [clock units]
        ("converted", "i8"),  # scans since the reset
        ("last", "f8"),  # its last reading [unit]
        ("begun", "i8"),  # readings of its buffer that are finished …
        ("filled", "i8"),  # … and those there are, the newest on their way through the stages
    ],
    align=True,
)
"""A channel: sensor, cable, converter, with all that goes on from tick to tick."""

STRETCH = 512
"""Scans that go through a stage together."""
TWO_D_FLAGS, TWO_D_WORDS = Array(np.dtype("?"), 2), Array(np.dtype("u8"), 2)


def set_output(channel: NDArray[np.void], sensor: Sensor, errors: Errors, scan_period_s: float) -> None:
    """Give one CHANNEL record the output stage of a sensor with these errors."""
    sign = -1.0 if sensor.inverted else 1.0
    gain = sign * sensor.volt_per_unit * (1.0 + errors.gain * sensor.gain_tolerance)
    memory = exp(-TWO_PI * sensor.bandwidth_hz * scan_period_s)
    channel["middle"], channel["per_half_range"] = sensor.middle, 1.0 / sensor.half_range
    channel["bend_2"], channel["bend_3"] = sensor.linearity * errors.c_2, sensor.linearity * errors.c_3
    channel["memory"], channel["fresh"] = memory, sensor.noise * math.sqrt(1.0 - memory * memory)
    channel["resolution"], channel["low"], channel["high"] = sensor.resolution, sensor.low, sensor.high
    channel["gain"] = gain
    channel["offset"] = sensor.offset_v + gain * errors.offset * sensor.offset_tolerance


def set_converter(channel: NDArray[np.void], sensor: Sensor, adc: Adc, errors: BoardErrors) -> None:
    """Give one CHANNEL record the converter on its cable."""
    lsb = calibration.lsb_v(sensor, adc)
    channel["adc_noise"] = calibration.converter_noise_v(sensor, adc)
    channel["adc_gain"] = 1.0 + errors.gain * adc.gain_tolerance
    channel["adc_offset"] = errors.offset * adc.offset_tolerance * sensor.adc_range_v
    channel["lsb"] = lsb
    channel["lowest"], channel["highest"] = -float(1 << (adc.bits - 1)), float((1 << (adc.bits - 1)) - 1)
    channel["scale"], channel["zero"] = lsb / sensor.volt_per_unit, -sensor.offset_v / sensor.volt_per_unit


@kernel
def held(value, low, high):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return the value within low … high."""
    value = low if value < low else value
    return high if value > high else value


@kernel
def to_volts(channel, values, clipped, white):  # type: ignore[no-untyped-def]
    """Turn what the dynamics put out [unit] into volts at the cable, at most STRETCH of them, in place.

    Notes in `clipped` whether the sensor was at an end of its range; `white` is scratch.
    """
    c, n = channel, values.shape[0]
    fill_normal(c.noise, white)
    coloured, memory, fresh = c.coloured, c.memory, c.fresh
    for i in range(n):
        coloured = memory * coloured + fresh * white[i]
        white[i] = coloured
    c.coloured = coloured
    if c.bend_2 != 0.0 or c.bend_3 != 0.0:
        middle, per_half, bend_2, bend_3 = c.middle, c.per_half_range, c.bend_2, c.bend_3
        for i in range(n):
            u = held((values[i] - middle) * per_half, -1.0, 1.0)
            values[i] += bend_2 * (1.5 * u * u - 0.5) + bend_3 * (2.5 * u * u - 1.5) * u
    low, high, gain, offset, step = c.low, c.high, c.gain, c.offset, c.resolution
    if step > 0.0:
        per_step = 1.0 / step
        for i in range(n):
            values[i] = step * nearest((values[i] + white[i]) * per_step)
    else:
        for i in range(n):
            values[i] += white[i]
    for i in range(n):
        clipped[i] = (values[i] <= low) | (values[i] >= high)
    for i in range(n):
        values[i] = gain * held(values[i], low, high) + offset


@kernel
def to_units(channel, values, clipped, white):  # type: ignore[no-untyped-def]
    """Turn volts into readings [unit], at most STRETCH of them, in place.

    Adds to `clipped` where the converter was at an end of its range.
    """
    c, n = channel, values.shape[0]
    fill_normal(c.converter_noise, white)
    noise, gain, offset, per_lsb, scale, zero = c.adc_noise, c.adc_gain, c.adc_offset, 1.0 / c.lsb, c.scale, c.zero
    lowest, highest = c.lowest, c.highest
    for i in range(n):
        code = (gain * (values[i] + noise * white[i]) + offset) * per_lsb
        values[i] = nearest(held(code, lowest - 1.0, highest + 1.0))
    for i in range(n):
        clipped[i] |= (values[i] <= lowest) | (values[i] >= highest)
    for i in range(n):
        values[i] = scale * held(values[i], lowest, highest) + zero


@entry(CHANNEL, TWO_D_WORDS, TWO_D_FLAGS, BYTES, INTEGERS, returns=int)
def take_rows(channels, readings, clipped, rows, layout):  # type: ignore[no-untyped-def]
    """Fill in the rows of all scans that every channel has finished, and forget these; return how many there are.

    Args:
        channels: CHANNEL records.
        readings: of each channel, bit by bit, shape (channels, room).
        clipped: whether each was clipped.
        rows: of scans, byte by byte, for as many as there may be.
        layout: bytes of a row, place of the status in it, and places of the channels.
    """
    count = channels[0].begun
    for j in range(channels.shape[0]):
        count = min(count, channels[j].begun)
    size = np.uint64(layout[0])
    for j in range(channels.shape[0]):
        place = np.uint64(layout[2 + j])  # of whole numbers without a sign: those are no places counted from the end
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
        for i in range(count, channels[j].begun):
            readings[j, i - count], clipped[j, i - count] = readings[j, i], clipped[j, i]
        channels[j].begun -= count
        channels[j].filled -= count
    return count
