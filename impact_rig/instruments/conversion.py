# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""From a sensor's clean output to readings: linearity, noise, end of range, volts; codes, SI units.

A sensor's noise is as wide as the sensor: white noise behind a first-order low-pass at its bandwidth, sampled exactly.
From one conversion to the next n ← a n + σ √(1 − a²) w with a = e^{−2π f_c h} and white w: its rms σ is the
specification's at every scan rate, its spectrum a Lorentzian. With u = −1 … 1 over the range,

    value = clean + L (c_2 P_2(u) + c_3 P_3(u)) + n, rounded to the output's own step, held within its range
    volts = gain value + offset
    code  = round((g (volts + σ_c w) + o) / lsb), held within the converter's codes;   reading = code scale + zero
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import TWO_PI, exp
from impact_rig.arithmetic.random import Random, fill_normal
from impact_rig.instruments import calibration
from impact_rig.instruments.calibration import BoardErrors, Errors
from impact_rig.instruments.sensor import Adc, Sensor
from impact_rig.kernels import FLAGS, REALS, WORDS, Fields, entry


class OutputStage(NamedTuple):
    """Numbers that turn a sensor's clean output [unit] into volts."""

    middle: float
    per_half_range: float
    bend_2: float  # L c_2
    bend_3: float  # L c_3
    memory: float  # a of the noise
    noise: float
    resolution: float
    low: float
    high: float
    gain: float  # volt per unit, as it really is
    offset: float  # V, as it really is


OUTPUT_STAGE = Fields(OutputStage, 11 * (float,))


class Converter(NamedTuple):
    """Numbers that turn volts into codes and codes into SI units."""

    noise: float  # V
    gain: float
    offset: float  # V
    lsb: float
    lowest: float
    highest: float
    scale: float  # unit per code, nominal
    zero: float  # unit at code 0, nominal


CONVERTER = Fields(Converter, 8 * (float,))


def output_stage(sensor: Sensor, errors: Errors, scan_period_s: float) -> OutputStage:
    """Return the output stage of a sensor with these errors."""
    sign = -1.0 if sensor.inverted else 1.0
    gain = sign * sensor.volt_per_unit * (1.0 + errors.gain * sensor.gain_tolerance)
    return OutputStage(
        middle=sensor.middle,
        per_half_range=1.0 / sensor.half_range,
        bend_2=sensor.linearity * errors.c_2,
        bend_3=sensor.linearity * errors.c_3,
        memory=exp(-TWO_PI * sensor.bandwidth_hz * scan_period_s),
        noise=sensor.noise,
        resolution=sensor.resolution,
        low=sensor.low,
        high=sensor.high,
        gain=gain,
        offset=sensor.offset_v + gain * errors.offset * sensor.offset_tolerance,
    )


def converter(sensor: Sensor, adc: Adc, errors: BoardErrors) -> Converter:
    """Return the converter on a sensor's channel."""
    lsb = calibration.lsb_v(sensor, adc)
    return Converter(
        noise=calibration.converter_noise_v(sensor, adc),
        gain=1.0 + errors.gain * adc.gain_tolerance,
        offset=errors.offset * adc.offset_tolerance * sensor.adc_range_v,
        lsb=lsb,
        lowest=-float(1 << (adc.bits - 1)),
        highest=float((1 << (adc.bits - 1)) - 1),
        scale=lsb / sensor.volt_per_unit,
        zero=-sensor.offset_v / sensor.volt_per_unit,
    )


def to_volts(
    stage: OutputStage, clean: NDArray[np.float64], random: Random, memory: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (volts at the cable, whether the sensor was at an end of its range), both shape (n,).

    Args:
        stage: the sensor's output stage.
        clean: output of its dynamics [unit], shape (n,).
        random: the sensor's noise comes from it.
        memory: the noise's last value [unit], shape (1,), carried on.
    """
    clipped = np.empty(len(clean), dtype=np.bool_)
    volts = np.empty(len(clean))
    _to_volts(stage, clean, random.state, memory, volts, clipped)
    return volts, clipped


def to_units(
    adc: Converter, volts: NDArray[np.float64], random: Random, clipped: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the readings [unit], shape (n,), and add to `clipped` where the converter was at an end of its range."""
    readings = np.empty(len(volts))
    _to_units(adc, volts, random.state, readings, clipped)
    return readings


@entry(OUTPUT_STAGE, REALS, WORDS, REALS, REALS, FLAGS)
def _to_volts(stage, clean, random, memory, volts, clipped):  # type: ignore[no-untyped-def]  # types are inferred
    white = volts  # each number gives way to the volts it goes into
    fill_normal(random, white)
    fresh = stage.noise * math.sqrt(1.0 - stage.memory * stage.memory)
    coloured = memory[0]
    for i in range(clean.shape[0]):
        value = clean[i]
        u = min(1.0, max(-1.0, (value - stage.middle) * stage.per_half_range))
        value += stage.bend_2 * (1.5 * u * u - 0.5) + stage.bend_3 * (2.5 * u * u - 1.5) * u
        coloured = stage.memory * coloured + fresh * white[i]
        value += coloured
        if stage.resolution > 0.0:
            value = stage.resolution * np.rint(value / stage.resolution)
        clipped[i] = value <= stage.low or value >= stage.high
        volts[i] = stage.gain * min(stage.high, max(stage.low, value)) + stage.offset
    memory[0] = coloured


@entry(CONVERTER, REALS, WORDS, REALS, FLAGS)
def _to_units(adc, volts, random, readings, clipped):  # type: ignore[no-untyped-def]
    white = readings  # each number gives way to the reading it goes into
    fill_normal(random, white)
    per_lsb = 1.0 / adc.lsb
    for i in range(volts.shape[0]):
        code = np.rint((adc.gain * (volts[i] + adc.noise * white[i]) + adc.offset) * per_lsb)
        clipped[i] = clipped[i] or code <= adc.lowest or code >= adc.highest
        readings[i] = adc.scale * min(adc.highest, max(adc.lowest, code)) + adc.zero
